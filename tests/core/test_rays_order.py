"""Morton order against bit-by-bit oracles."""

import numpy as np
import pytest

from lumigate.core.rays.order import BITS, morton_codes, morton_order, radix_argsort


def _interleave(cells):
    codes = np.zeros(len(cells), np.uint64)
    for bit in range(BITS):
        for axis in range(3):
            codes |= ((cells[:, axis].astype(np.uint64) >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return codes


def test_codes_interleave_the_bits():
    rng = np.random.default_rng(1)
    cells = rng.integers(0, 2**BITS, (500, 3))
    cells[0], cells[1] = 0, 2**BITS - 1  # they span the cube, so that cells are units
    assert np.array_equal(morton_codes(cells.astype(np.float64)), _interleave(cells))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_order_is_stable(dtype):
    rng = np.random.default_rng(2)
    points = rng.integers(0, 5, (2000, 3)).astype(dtype)
    order = morton_order(points)
    assert order.dtype == np.int64
    assert np.array_equal(order, np.argsort(morton_codes(points), kind="stable"))


def test_neighbours_follow_each_other():
    rng = np.random.default_rng(3)
    points = rng.random((20000, 3)).astype(np.float32)
    steps = np.linalg.norm(np.diff(points[morton_order(points)], axis=0), axis=1)
    assert steps.mean() < 2 * len(points) ** (-1 / 3)


def test_normals_sort_by_octant_first():
    rng = np.random.default_rng(4)
    points, normals = rng.random((3000, 3)), rng.normal(size=(3000, 3))
    order = morton_order(points, normals)
    octant = ((normals < 0) * [1, 2, 4]).sum(1)[order]
    assert np.all(np.diff(octant) >= 0)
    codes = morton_codes(points)[order]
    for k in range(8):
        assert np.all(np.diff(codes[octant == k].astype(np.int64)) >= 0)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((5, 3)), np.full((3, 3), np.nan), [[0, 0, 0], [np.inf, 1, 1], [1, 1, 1]]])
def test_odd_points(points):
    order = morton_order(np.asarray(points, np.float64))
    assert sorted(order) == list(range(len(points)))


def test_radix_argsort_is_argsort():
    rng = np.random.default_rng(5)
    keys = rng.integers(0, 2**37, 5000).astype(np.uint64)
    assert np.array_equal(radix_argsort(keys, 37), np.argsort(keys, kind="stable"))
