"""Which of two pictures is better: found where it is so, and not where it is chance."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lumigate.core.errors import SceneError
from lumigate.core.metrics import relmse
from lumigate.core.significance import LEVEL, compare_errors

SHAPE = (96, 128, 3)
TRUTH = np.linspace(0.2, 2.0, SHAPE[1])[None, :, None] * np.ones(SHAPE)


def wrong(seed, level, blur=3.0):
    """The truth with errors that hang together over some pixels, as a denoiser leaves them."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(SHAPE), (blur, blur, 0))
    return TRUTH * (1 + level * noise / noise.std())


def noisy(seed, level):
    """The truth with a path tracer's noise."""
    return TRUTH * (1 + level * np.random.default_rng(seed).standard_normal(SHAPE))


def test_a_better_picture_is_found_and_by_how_much():
    better, worse = wrong(1, 0.1), wrong(2, 0.15)
    found = compare_errors(better, worse, noisy(3, 0.02), noisy(4, 0.02))
    assert found.verdict == "test"
    assert found.low < relmse(worse, TRUTH) - relmse(better, TRUTH) < found.high
    swapped = compare_errors(worse, better, noisy(3, 0.02), noisy(4, 0.02))
    assert swapped.verdict == "other"
    assert swapped.difference == pytest.approx(-found.difference)


def test_a_noisy_reference_tells_less():
    better, worse = wrong(1, 0.10), wrong(2, 0.11)
    clean, dirty = (compare_errors(better, worse, noisy(3, level), noisy(4, level)) for level in (0.01, 3.0))
    assert dirty.verdict == "neither"
    assert dirty.reference_noise > 10 * clean.reference_noise
    assert dirty.high - dirty.low > dirty.reference_noise


@pytest.mark.parametrize("halves", [1, 2])
def test_equally_good_pictures_are_rarely_told_apart(halves):
    runs = 100
    told = sum(
        compare_errors(wrong(4 * k, 0.1), wrong(4 * k + 1, 0.1), *(noisy(4 * k + 2 + h, 0.3) for h in range(halves))).p <= LEVEL
        for k in range(runs)
    )
    assert told <= 13  # 5 are due; 13 or more by chance once in a thousand


def test_the_reference_noise_is_not_held_against_anyone():
    # relMSE of the pictures against this reference is .25 for both; their own errors differ by a hundredth of that.
    better, worse = wrong(1, 0.02), wrong(2, 0.05)
    found = compare_errors(better, worse, noisy(3, 0.5), noisy(4, 0.5))
    assert found.low < 0.0021 < found.high
    assert found.verdict == "test"


def test_the_same_picture_twice():
    found = compare_errors(wrong(1, 0.1), wrong(1, 0.1), noisy(3, 0.1))
    assert (found.verdict, found.difference, found.p, found.reference_noise) == ("neither", 0, 1, None)


def test_pixels_that_are_not_finite_are_left_out():
    better, worse = wrong(1, 0.1), wrong(2, 0.15)
    worse[5, 7] = np.nan
    assert compare_errors(better, worse, noisy(3, 0.02)).verdict == "test"


@pytest.mark.parametrize(
    ("pictures", "said"),
    [
        ((TRUTH, TRUTH[:-1], TRUTH), "size"),
        ((TRUTH, TRUTH, 0 * TRUTH), "black"),
        ((TRUTH[:2, :2],) * 3, "too few"),
    ],
)
def test_what_cannot_be_told_is_said(pictures, said):
    with pytest.raises(SceneError, match=said):
        compare_errors(*pictures)
