"""Interleaved sampling: blurring keeps to surfaces."""

import numpy as np
import pytest

from lumigate.core.methods.interleaving import blur, pixels_of
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
