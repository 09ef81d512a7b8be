"""Interleaved sampling: every share of the VPLs is a pixel's of every block, and blurring keeps to surfaces."""

import numpy as np
import pytest

from lumigate.core.methods.interleaving import batches, blur, own_shares, pixels_of, shares_of_residues
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


@pytest.mark.parametrize("interleave", range(1, 9))
def test_a_block_holds_every_share_once(interleave):
    points, _ = picture(40, 32)
    pixels = pixels_of(points, 40, interleave)
    own = own_shares(points, pixels)
    share = np.empty(len(points.pixel), int)
    share[own.point] = np.repeat(own.share, np.diff(own.first))
    share = share.reshape(32, 40)
    for y, x in ((0, 0), (3, 5)):
        assert np.array_equal(np.sort(share[y : y + interleave, x : x + interleave].ravel()), np.arange(interleave**2))
    for s in range(interleave**2):
        assert share[pixels.down[s], pixels.across[s]] == s
    assert np.array_equal(np.sort(shares_of_residues(interleave)), np.arange(interleave**2))


@pytest.mark.parametrize("interleave", [2, 3, 8])
@pytest.mark.parametrize("edge", [None, 21])
def test_blur_against_means(interleave, edge):
    points, wall = picture(40, 32, edge)
    values = np.random.default_rng(0).uniform(0, 9, (len(wall), 3)).astype(np.float32)
    found = blur(points, pixels_of(points, 40, interleave), values, 100.0)
    x, y = points.pixel % 40, points.pixel // 40
    before, after = interleave // 2, interleave - interleave // 2
    for i in range(0, len(wall), 37):
        window = (x >= x[i] - before) & (x < x[i] + after) & (y >= y[i] - before) & (y < y[i] + after) & (wall == wall[i])
        assert np.allclose(found[i], values[window].mean(axis=0), rtol=1e-5)


def test_points_far_apart_keep_what_they_have():
    points, _ = picture(16, 16)
    points.position[:] *= 1000  # farther apart than the blur reaches
    values = np.random.default_rng(1).uniform(0, 9, (256, 3)).astype(np.float32)
    assert np.array_equal(blur(points, pixels_of(points, 16, 4), values, 1.0), values)


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
