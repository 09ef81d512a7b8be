"""Sparks are spread, and nothing else is touched."""

import numpy as np
import pytest

from lumigate.core.methods.sparks import AROUND, KEPT, MUCH, TOGETHER, spread_sparks, spread_thrown
from lumigate.core.view.points import ShadingPoints

SHAPE = 72, 100
F = np.float32


@pytest.fixture
def points():
    """Two points in every pixel, of differing albedo."""
    rng = np.random.default_rng(1)
    n = 2 * SHAPE[0] * SHAPE[1]
    points = ShadingPoints.allocate(n)
    points.pixel[:] = np.arange(n) // 2
    points.albedo[:] = rng.uniform(0.1, 0.5, (n, 3))
    return points


def lit(n, columns=3):
    """Noisy light of about 1 and what is foreseen of it."""
    rng = np.random.default_rng(2)
    return rng.gamma(2, 0.5, (n, columns)).astype(F), rng.uniform(0.7, 1.3, n).astype(F)


def test_noise_is_not_touched(points):
    light, foreseen = lit(len(points.pixel))
    assert spread_sparks(points, light, foreseen, SHAPE) is light


@pytest.mark.parametrize("columns", [3, 6])
@pytest.mark.parametrize("strength", [200, 1e5])
def test_a_spark_is_spread_and_no_light_lost(points, columns, strength):
    light, foreseen = lit(len(points.pixel), columns)
    k = 2 * (30 * SHAPE[1] + 40)
    light[k, :2] = strength, 2 * strength
    before = light.copy()
    found = spread_sparks(points, light, foreseen, SHAPE)
    np.testing.assert_array_equal(light, before)
    albedo = np.tile(points.albedo, columns // 3)
    sent = [(albedo * x.astype(float)).sum(axis=0) for x in (light, found)]
    np.testing.assert_allclose(sent[1], sent[0], rtol=1e-5)
    assert found[k].mean() < 2.5 * KEPT
    others = np.arange(len(light)) != k
    raised = (found - light)[others] / foreseen[others, None]
    assert raised.min() >= 0
    if strength == 200:  # next to nothing is left beyond the area
        assert raised.max() < 2 * MUCH
        far = points.pixel % SHAPE[1] >= 64
        assert raised[far[others]].max() < MUCH / 5
    else:  # the whole picture takes it
        assert np.ptp(raised, axis=0).max() < 3 * MUCH < raised.max()


@pytest.mark.parametrize(("together", "spread"), [(2, True), (TOGETHER, True), (TOGETHER + 1, False)])
def test_sparks_side_by_side_do_not_vouch_for_each_other(points, together, spread):
    """Each is less than 24 times the mean around it, the others included."""
    light, foreseen = lit(len(points.pixel))
    sparks = np.array([2 * (30 * SHAPE[1] + 40 + k % 2 + k // 2 * SHAPE[1]) for k in range(together)])
    light[sparks] = 500
    found = spread_sparks(points, light, foreseen, SHAPE)
    assert (found is not light) == spread
    if spread:
        assert found[sparks].mean() < 2.5 * KEPT
        sent = [(points.albedo * x.astype(float)).sum(axis=0) for x in (light, found)]
        np.testing.assert_allclose(sent[1], sent[0], rtol=1e-5)


def test_a_photon_on_a_crumb_is_spread_with_what_lobes_reflect_of_it(points):
    """It is wide elsewhere; at 20 times what is around it other light would be left to the denoiser."""
    light, foreseen = lit(len(points.pixel))
    k = 2 * (30 * SHAPE[1] + 40)
    light[k] = 20
    shown = 0.5 * light
    assert spread_sparks(points, light, foreseen, SHAPE) is light
    found, seen = spread_thrown(points, light, shown, foreseen, SHAPE)
    sent = [(points.albedo * x.astype(float)).sum(axis=0) for x in (light, found)]
    np.testing.assert_allclose(sent[1], sent[0], rtol=1e-5)
    assert found[k].mean() < 2.5 * KEPT and seen[k].mean() < 1.25 * KEPT
    np.testing.assert_allclose(seen.sum(axis=0, dtype=float), shown.sum(axis=0, dtype=float), rtol=1e-5)
    assert spread_thrown(points, light, shown[:0], foreseen, SHAPE)[1].shape == (0, 3)
    light[k] = 5
    assert all(mine is its for mine, its in zip(spread_thrown(points, light, shown, foreseen, SHAPE), (light, shown), strict=True))


def test_a_bright_thing_is_no_spark(points):
    light, foreseen = lit(len(points.pixel))
    y, x = np.divmod(points.pixel, SHAPE[1])
    light[(abs(y - 30) <= AROUND // 2) & (abs(x - 40) <= AROUND // 2)] *= 200
    np.testing.assert_array_equal(spread_sparks(points, light, foreseen, SHAPE), light)


def test_where_nobody_can_take_it_light_stays(points):
    light, foreseen = np.zeros((len(points.pixel), 3), F), np.zeros(len(points.pixel), F)
    light[100] = 5
    np.testing.assert_array_equal(spread_sparks(points, light, foreseen, SHAPE), light)


def test_what_is_no_number_is_not_spread(points):
    light, foreseen = lit(len(points.pixel))
    light[100], light[5000] = np.inf, np.nan
    np.testing.assert_array_equal(spread_sparks(points, light, foreseen, SHAPE), light)
