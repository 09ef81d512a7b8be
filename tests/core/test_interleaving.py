"""Interleaved sampling: every share of the VPLs reaches every point, whatever the shares hold."""

import numpy as np
import pytest

from lumigate.core.methods.interleaving import batches, blur, missing_shares, own_shares, pixels_of
from lumigate.core.view.points import ShadingPoints


def picture(width, height, edge=None):
    """One point a pixel on the plane z = 0; from column `edge` on, on a wall across it."""
    points = ShadingPoints.allocate(width * height)
    for field in points:
        field[...] = 0
    pixel = np.arange(width * height, dtype=np.int32)
    points.pixel[:] = pixel
    points.position[:, 0], points.position[:, 1] = pixel % width * 0.01, pixel // width * 0.01
    wall = np.zeros(len(pixel), bool) if edge is None else pixel % width >= edge
    points.ns[:, 2] = points.ng[:, 2] = ~wall
    points.ns[wall, 0] = points.ng[wall, 0] = -1
    points.position[wall, 2], points.position[wall, 0] = points.position[wall, 0], (edge or 0) * 0.01
    return points, wall


@pytest.mark.parametrize("interleave", [2, 3, 8])
@pytest.mark.parametrize("edge", [None, 21])
def test_sum_over_shares_has_no_pattern(interleave, edge):
    points, wall = picture(40, 32, edge)
    pixels = pixels_of(points, 40, interleave)
    own = own_shares(points, pixels)
    of_share = np.random.default_rng(0).uniform(0, 9, (interleave**2, 2, 3)).astype(np.float32)
    light = np.zeros((len(wall), 3), np.float32)
    light[own.point] = of_share[np.repeat(own.share, np.diff(own.first)), wall[own.point].astype(int)]
    out, missing = blur(points, pixels, light, 100.0)
    assert not missing.any()  # what lacks at the edge is found a block further on
    expected = of_share.sum(axis=0)[wall.astype(int)]
    assert np.allclose(out, expected, rtol=1e-5)


def test_lonely_points_miss_all_other_shares():
    points, _ = picture(16, 16)
    points.position[:] *= 1000  # farther apart than the blur reaches
    pixels = pixels_of(points, 16, 4)
    out, missing = blur(points, pixels, np.ones((256, 3), np.float32), 1.0)
    assert np.allclose(out, 1)
    rest = missing_shares(points, pixels, missing)
    assert len(rest.point) == 256 * 15
    x, y = points.pixel % 16, points.pixel // 16
    share = np.repeat(rest.share, np.diff(rest.first))
    assert (share != (y % 4 * 4 + x % 4)[rest.point]).all()
    assert len(np.unique(rest.point.astype(np.int64) * 16 + share)) == len(rest.point)


def test_batches_hold_every_pair_once():
    rng = np.random.default_rng(2)
    point = rng.permutation(5000).astype(np.int32)
    share, x, y = rng.integers(0, 3, 5000), rng.integers(0, 200, 5000), rng.integers(0, 90, 5000)
    found = batches(point, share, x, y)
    assert np.array_equal(np.sort(found.point), np.arange(5000))
    sizes = np.diff(found.first)
    assert sizes.sum() == 5000 and sizes.min() > 0 and sizes.max() <= 128
    of_point = np.empty(5000, int)
    of_point[point] = share
    assert np.array_equal(of_point[found.point], np.repeat(found.share, sizes))
