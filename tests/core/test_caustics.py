"""Photons through lenses: each spreads all of its light, where its neighbours are."""

import numpy as np
import pytest

from lumigate.core.methods.caustics import NEAREST, Photons, add_caustics
from lumigate.core.view.points import ShadingPoints

SIDE, PITCH = 81, 0.05  # points in a grid of 4 m, so far apart (m)


def plane(normal=(0.0, 0.0, 1.0)):
    """Points of a square of the floor, z = 0."""
    x = (np.arange(SIDE) - SIDE // 2) * PITCH
    points = ShadingPoints.allocate(SIDE * SIDE)
    points.position[:, 0], points.position[:, 1] = (axis.ravel() for axis in np.meshgrid(x, x))
    points.position[:, 2] = 0
    points.ng[:] = points.ns[:] = normal
    return points


def spot(n, width, height=0.0):
    """Photons of 1 W in all that fall straight down, with a normal distribution."""
    photons = Photons.allocate(n)
    photons.position[:, :2] = np.random.default_rng(1).normal(0, width, (n, 2))
    photons.position[:, 2] = height
    photons.normal[:], photons.direction[:], photons.flux[:], photons.group[:] = (0, 0, 1), (0, 0, -1), 1 / n, 0
    return photons


def lit(photons, points):
    """Irradiance (N, 3)."""
    out = np.zeros((len(points.pixel), 3), np.float32)
    add_caustics(photons, points, 2, out)
    return out


@pytest.mark.parametrize("n", [1500, 8000])
def test_all_light_arrives_and_stays_near_where_it_fell(n):
    points = plane()
    found = lit(spot(n, 0.3), points)
    assert found[:, 1].sum() * PITCH**2 == pytest.approx(1, rel=0.02)
    r2 = np.einsum("nk,nk->n", points.position, points.position)
    np.testing.assert_array_equal(found[r2 > 1.8**2], 0)
    middle = found[r2 < 0.15**2, 0].mean()
    assert middle == pytest.approx((1 - np.exp(-0.125)) / (np.pi * 0.15**2), rel=0.15)


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_other_sides_stay_dark(normal):
    assert not lit(spot(2000, 0.3), plane(normal)).any()


def test_what_lies_above_stays_dark():
    assert not lit(spot(2000, 0.3, height=-0.5), plane()).any()


def test_so_few_photons_tell_nothing():
    assert not lit(spot(NEAREST, 0.3), plane()).any()
