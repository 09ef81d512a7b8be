"""The metrics against their formulas, and what noise of the reference does to them."""

import sys

import numpy as np
import pytest

from lumigate.core import metrics
from lumigate.core.errors import SceneError


@pytest.fixture
def reference():
    return np.random.default_rng(5).gamma(2.0, 0.5, (24, 32, 3))


def test_formulas_by_hand():
    r = np.array([[[1.0], [3.0]]])
    x = np.array([[[2.0], [3.0]]])
    e = 0.01 * 2.0**2
    assert metrics.relmse(x, r) == pytest.approx(1 / (1 + e) / 2)
    assert metrics.rmse(x, r) == pytest.approx(np.sqrt(0.5) / 2)
    assert metrics.bias(x, r) == pytest.approx(0.25)


def test_equal_pictures_have_no_error(reference):
    result = metrics.compare(reference, reference)
    assert (result["relmse"], result["rmse"], result["bias"], result["invalid"]) == (0, 0, 0, 0)
    assert result["flip"] == pytest.approx(0, abs=1e-6)
    assert result["warnings"] == []


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_errors_do_not_depend_on_exposure(reference, scale):
    x = reference * 1.1
    result = metrics.compare(x * scale, reference * scale)
    expected = metrics.compare(x, reference)
    assert result["bias"] == pytest.approx(0.1)
    for name in ("relmse", "rmse"):
        assert result[name] == pytest.approx(expected[name])
    assert result["flip"] == pytest.approx(expected["flip"], rel=1e-3)


def test_bias_keeps_its_sign(reference):
    assert metrics.compare(reference * 0.8, reference)["bias"] == pytest.approx(-0.2)


def test_flip_is_that_of_the_package(reference):
    import flip_evaluator

    x = reference + np.random.default_rng(1).random(reference.shape) * 0.2
    expected = flip_evaluator.evaluate(reference.astype(np.float32), x.astype(np.float32), "HDR", applyMagma=False)[1]
    assert metrics.flip(x, reference) == pytest.approx(expected, rel=1e-6)


def test_missing_flip_is_none_with_a_warning(reference, monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    result = metrics.compare(reference * 1.1, reference)
    assert result["flip"] is None
    assert any("flip-evaluator" in line for line in result["warnings"])
    assert result["relmse"] > 0


def test_invalid_pixels_are_counted_and_left_out(reference):
    x = reference * 1.1
    expected = metrics.compare(x[1:], reference[1:])
    x[0, :, 0], r = np.nan, reference.copy()
    r[0, :3] = np.inf
    result = metrics.compare(x, r)
    assert result["invalid"] == 32
    assert "32 of 768" in result["warnings"][0]
    for name in ("relmse", "rmse", "bias"):
        assert result[name] == pytest.approx(expected[name])
    assert 0 < result["flip"] < 1


def test_black_reference_and_no_valid_pixel_are_undefined(reference):
    black = metrics.compare(reference, np.zeros_like(reference))
    assert [black[n] for n in ("relmse", "rmse", "bias", "flip")] == [None] * 4
    assert "black" in black["warnings"][0]
    nothing = metrics.compare(reference * np.nan, reference)
    assert nothing["relmse"] is None and nothing["invalid"] == 768


def test_different_sizes_are_one_line(reference):
    with pytest.raises(SceneError, match=r"31x24.*32x24"):
        metrics.compare(reference[:, 1:], reference)


def test_net_relmse_removes_the_noise_of_the_reference():
    rng = np.random.default_rng(11)
    truth = rng.gamma(2.0, 0.5, (200, 200, 3))
    half_a, half_b = (truth * (1 + 0.1 * rng.normal(size=truth.shape)) for _ in range(2))
    x = truth * (1 + 0.05 * rng.normal(size=truth.shape))
    true_error = metrics.relmse(x, truth)
    # Over 40 seeds: net / true = 1.000, standard deviation .015; the plain relMSE is 3.1 times the true one.
    assert metrics.relmse(x, (half_a + half_b) / 2) > 2.5 * true_error
    assert metrics.net_relmse(x, half_a, half_b, denoised_reference=truth) == pytest.approx(true_error, rel=0.06)
    # The truth itself has no error: standard deviation .012 of the test's error.
    assert metrics.net_relmse(truth, half_a, half_b, truth) == pytest.approx(0, abs=0.05 * true_error)
    # The halves' mean has the variance .1² / 2: standard deviation .005 of it.
    expected = 0.1**2 / 2 * np.mean(truth**2 / (truth**2 + 0.01 * truth.mean() ** 2))
    assert metrics.reference_noise(half_a, half_b, truth) == pytest.approx(expected, rel=0.02)


def test_doubt_is_how_far_net_errors_scatter():
    rng = np.random.default_rng(6)
    truth = np.linspace(0.1, 1, 24 * 24).reshape(24, 24, 1).repeat(3, axis=2)
    test = truth * (1 + rng.normal(0, 0.02, truth.shape))

    def measured(samples):
        # One error for all channels, as light has it, and now and then a large one.
        errors = [rng.normal(0, 0.5, (24, 24, 1)) * rng.choice((1, 4), (24, 24, 1), p=(0.95, 0.05)) / samples**0.5 for _ in range(2)]
        halves = [truth * (1 + error) for error in errors]
        return metrics.net_relmse(test, *halves, truth), metrics.reference_doubt(*halves, truth)

    few, many = (np.array([measured(samples) for _ in range(300)]) for samples in (1, 4))
    for found in (few, many):
        assert found[:, 0].std() == pytest.approx(found[:, 1].mean(), rel=0.2)
    assert few[:, 1].mean() == pytest.approx(4 * many[:, 1].mean(), rel=0.2)


def test_net_relmse_without_noise_is_relmse(reference):
    x = reference * 1.2
    assert metrics.net_relmse(x, reference, reference) == pytest.approx(metrics.relmse(x, reference))


def test_error_maps_say_where_and_which_way(reference):
    x = reference.copy()
    x[0], x[1], x[2, 0] = reference[0] * 3, 0, np.nan
    signed = metrics.error_map(x, reference, "signed")
    assert (signed[0, :, 0] > signed[0, :, 2]).all()  # too bright is red
    assert (signed[1, :, 2] > signed[1, :, 0]).all()  # too dark is blue
    np.testing.assert_allclose(signed[3:], 1)
    np.testing.assert_array_equal(signed[2, 0], [0, 1, 0])
    relative = metrics.error_map(x, reference, "relative")
    assert relative[0].sum(axis=1).min() > relative[3:].sum(axis=2).max()
    with pytest.raises(ValueError, match="kind"):
        metrics.error_map(x, reference, "other")
