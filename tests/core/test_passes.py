"""How many passes a picture takes, and how well their own estimate of the error holds."""

import numpy as np
import pytest

from lumigate.core.passes import GROUPS, LEAST, MOST, Passes
from lumigate.core.picture import Picture
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings


def picture(indirect, weight=1.0):
    """A picture of diffuse indirect light alone."""
    zero = np.zeros_like(indirect)
    one = np.ones_like(indirect)
    return Picture(zero, indirect, zero, one, zero, one, one, one, zero, zero[..., 0], weight)


def noisy(level, seed, shape=(48, 64, 3)):
    """One over the picture, and noise of a relative deviation."""
    return (1 + level * np.random.default_rng(seed).standard_normal(shape)).astype(np.float32)


def test_one_pass_without_a_budget():
    passes = Passes(None, None, 1000, 2)
    assert passes.first() == 1
    passes.add(picture(noisy(0.1, 1)))
    assert passes.next(1.0, 1.0, 1.0, None) is None
    assert passes.estimate is None


def test_pictures_are_averaged_by_their_weights():
    whole = picture(np.full((2, 2, 3), 1.0, np.float32), 1.0).blend(picture(np.full((2, 2, 3), 4.0, np.float32), 3.0))
    np.testing.assert_allclose(whole.indirect, 3.25)
    assert whole.weight == 4


def test_estimate_is_the_error_of_the_mean():
    # Noise of .3 in each of nine passes: the mean's squared error is .09 / 9.
    passes = Passes(None, 1e-9, 1000, 1)
    for k in range(9):
        passes.add(picture(noisy(0.3, k)))
    assert passes.error(None) == pytest.approx(0.09 / 9, rel=0.1)


def test_estimate_sees_what_the_denoiser_does_wrong():
    tilt = np.linspace(0.8, 1.2, 64, dtype=np.float32)[None, :, None]

    class Tilted:
        """Every time wrong in the same way, which the difference of two of its pictures would not show."""

        def denoise(self, image, *guides, **options):
            return tilt * image

    passes = Passes(None, 1e-9, 1000, 1)
    for k in range(3):
        passes.add(picture(noisy(0.01, k)))
    wrong = ((tilt - 1) ** 2).mean()
    assert 0.5 * wrong < passes.error(Tilted()) < 1.1 * wrong


@pytest.mark.parametrize("seconds", [0.5, 3.0, 20.0, 300.0])
def test_time_is_used_up_and_not_overrun(seconds):
    # A pass takes .2 s and 2 s for each unit of quality.
    passes = Passes(seconds, None, 100_000, 2)
    quality, elapsed = passes.first(), 0.0
    while quality is not None:
        assert LEAST <= quality <= MOST
        took = 0.2 + 2 * quality
        elapsed += took
        passes.add(picture(noisy(0.1, 0, (2, 2, 3))))
        quality = passes.next(elapsed, took, quality, None)
    assert elapsed > 0.6 * seconds
    assert elapsed < 1.05 * seconds or passes.count == 1


def test_passes_go_on_until_the_error_is_met():
    passes = Passes(None, 0.001, 1000, 1)
    quality, qualities = passes.first(), []
    while quality is not None:
        qualities.append(quality)
        passes.add(picture(noisy(0.1 / quality**0.5, len(qualities)), quality))
        quality = passes.next(1.0, 1.0, quality, None)
    assert len(qualities) % GROUPS == 0
    assert sorted(qualities) == qualities  # they grow
    assert passes.estimate <= 0.001
    assert ((passes.picture.indirect - 1) ** 2).mean() < 0.0015


@pytest.fixture(scope="module")
def sphere(build):
    """A closed sphere, radiance 1 W/m^2/sr, albedo 0.5, seen from its middle."""
    return build.scene(build.geometry(*build.icosphere(3)), build.materials((0.5, 1.0)), camera=build.camera(width=24, height=24))


def test_a_render_meets_its_target(sphere):
    result = render(sphere, RenderSettings(vpls=256, target_error=0.003))
    assert result.stats["passes"] >= GROUPS
    assert result.stats["error_estimate"] <= 0.003
    exact = np.pi * sum(0.5**k for k in range(1, 5))
    assert ((result.layers["Irradiance"] / exact - 1) ** 2).mean() < 0.0045


def test_a_budget_makes_further_passes(sphere):
    result = render(sphere, RenderSettings(vpls=64, time_budget=3.0))
    assert result.stats["passes"] > 1
    assert result.stats["error_estimate"] is None


def test_only_what_the_wanted_layers_need_is_computed(sphere):
    result = render(sphere, RenderSettings(vpls=64, layers=("DiffuseIndirect",)))
    assert set(result.layers) == {"DiffuseIndirect"}
    assert not {"direct", "glossy"} & set(result.stats["seconds"])
    direct = render(sphere, RenderSettings(vpls=64, layers=("Direct",)))
    assert "indirect" not in direct.stats["seconds"]
