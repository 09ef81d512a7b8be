"""Photons through lenses: each spreads all of its light, where its neighbours are."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lumigate.core.methods.caustics import NEAREST, SPARSE, Photons, add_caustics, arranged
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
    add_caustics(None, arranged(photons, NEAREST), points, 1, 2, out)
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


def one_by_one(photons, points, radius):
    """Irradiance (N, 3), by every photon on every point."""
    out = np.zeros((len(points.pixel), 3))
    for p in range(len(radius)):
        away = (photons.position[p] - points.position).astype(np.float64)
        falls = 1 - (away**2).sum(axis=1) / radius[p] ** 2
        alike = (points.ng @ photons.normal[p] > 0.7) & (np.abs((points.ng * away).sum(axis=1)) <= 0.25 * radius[p])
        cosines = points.ns @ -photons.direction[p] / (photons.normal[p] @ -photons.direction[p])
        weight = 2 / np.pi / radius[p] ** 2 * np.maximum(falls, 0) * np.clip(cosines, 0, 2)
        out += np.where(alike, weight, 0)[:, None] * photons.flux[p]
    return out


@pytest.mark.parametrize("far", [0.0, 5000.0])
def test_what_each_photon_lights_is_found(far):
    points, rng = plane(), np.random.default_rng(2)
    photons = spot(600, 0.6)
    photons.position[300:, :2] = rng.normal(0.5, 0.002, (300, 2))  # a focus beside dim light: many sizes of disks
    slant = rng.normal((0, 0, -1), 0.3, (600, 3))
    photons.direction[:] = slant / np.linalg.norm(slant, axis=1)[:, None]
    points.position[:, 0] += np.float32(far)
    photons.position[:, 0] += np.float32(far)
    radius = cKDTree(photons.position).query(photons.position, [NEAREST + 1])[0][:, 0]
    radius = np.clip(radius, 0, SPARSE * np.median(radius)).astype(np.float32)
    assert radius.max() > 16 * radius.min()
    wanted = one_by_one(photons, points, radius)
    np.testing.assert_allclose(lit(photons, points), wanted, rtol=1e-3, atol=1e-4 * wanted.max())
