"""Voxelisation against separating axes; distance and opening against their definitions."""

import numpy as np
import pytest

from lumigate.core.errors import SceneError
from lumigate.core.topology import bits
from lumigate.core.topology.distance import distance_map, opening_map
from lumigate.core.topology.voxels import Grid, empty_voxels, voxelise

from .topology_oracle import touches


def _triangles(rng, count, spread):
    """Slender, small, large and axis-parallel ones."""
    corners = rng.random((count, 1, 3)) + spread * (rng.random((count, 3, 3)) - 0.5)
    corners[::5, :, rng.integers(0, 3)] = 0.37
    return np.clip(corners, 0, 1).astype(np.float32)


@pytest.mark.parametrize("spread", [0.05, 0.4, 1.5])
def test_voxels_are_those_that_a_triangle_touches(spread):
    rng = np.random.default_rng(int(10 * spread))
    grid = Grid(np.zeros(3), 1 / 7, (7, 7, 7))
    for corners in _triangles(rng, 15, spread):
        solid = ~empty_voxels(voxelise(corners, np.array([[0, 1, 2]]), grid), grid)
        cells = np.argwhere(np.ones(solid.shape))[:, ::-1]
        triangle, solid = corners.astype(float) / grid.size, solid.ravel()
        # A hair's breadth either way is rounding.
        assert not any(touches(triangle, c + 1e-6, c + 1 - 1e-6) and not s for c, s in zip(cells, solid))
        assert all(touches(triangle, c - 1e-6, c + 1 + 1e-6) for c in cells[solid])


def test_rows_longer_than_a_word():
    grid = Grid(np.zeros(3), 1.0, (150, 2, 2))
    corners = np.array([[0.5, 0.5, 0.5], [149.5, 0.5, 0.5], [149.5, 0.6, 0.5]], np.float32)
    empty = empty_voxels(voxelise(corners, np.array([[0, 1, 2]]), grid), grid)
    assert not empty[0, 0].any() and empty[1].all() and empty[0, 1].all()


def test_what_is_not_finite_touches_nothing():
    grid = Grid(np.zeros(3), 1.0, (4, 4, 4))
    corners = np.array([[np.nan, 0, 0], [1, 1, 1], [2, 1, 1]], np.float32)
    assert not voxelise(corners, np.array([[0, 1, 2]]), grid).any()


def test_the_grid_holds_the_box():
    grid = Grid.around(np.array([-3.0, 1, 7]), np.array([5.0, 2, 7.5]), 64)
    assert grid.shape == (64, 9, 5)
    inside = grid.cell_of(np.array([[-3.0, 1, 7], [5.0, 2, 7.5]]))
    assert (inside >= 0).all() and (inside < grid.shape).all()
    for bad in ((np.zeros(3), np.zeros(3), 64), (np.zeros(3), np.ones(3), 2), (np.full(3, np.inf), np.full(3, -np.inf), 64)):
        with pytest.raises(SceneError):
            Grid.around(*bad)


def test_bits_come_back_as_packed():
    volume = np.random.default_rng(0).random((3, 4, 131)) < 0.5
    words = bits.pack(volume)
    assert words.shape == (3, 4, 3)
    assert np.array_equal(bits.unpack(words, 131), volume)
    assert bits.popcount(words) == volume.sum()


@pytest.mark.parametrize("closed", [True, False])
def test_distance_and_opening_by_definition(closed):
    empty = np.random.default_rng(1).random((7, 9, 11)) < 0.97
    distance = distance_map(empty, closed=closed)
    solid = np.argwhere(~np.pad(empty, 1)) - 1 if closed else np.argwhere(~empty)
    for voxel in np.argwhere(empty):
        assert distance[tuple(voxel)] == np.abs(solid - voxel).max(axis=1).min()
    assert not distance[~empty].any()
    expected = np.zeros_like(distance)
    for voxel in np.argwhere(empty):
        r = int(distance[tuple(voxel)])
        ball = tuple(slice(max(0, c - r + 1), c + r) for c in voxel)
        expected[ball] = np.maximum(expected[ball], r)
    assert np.array_equal(opening_map(distance), expected)
