"""The grid search equals brute force, index for index and bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core.clustering.blocks import LANES, point_blocks, radix_order
from lumigate.core.clustering.grid import ANY_NORMAL, Metric, build_grid, nearest

from .clustering_points import awkward, brute_force, distant_line, landscape, room

METRICS = [Metric(), Metric(0.5), Metric(0.75**0.5), Metric(ANY_NORMAL, 0.3), Metric(0.5**0.5, 0.02, 16.0)]


def search(points, normals, centres, centre_normals, count, metric, mode="shells", threads=1):
    """`nearest`, in the given order."""
    blocks = point_blocks(points, normals)
    grid = build_grid(centres, centre_normals, split=metric.threshold > -1)
    ids, squared = nearest(blocks, grid, count, metric, mode, threads)
    out_ids, out = np.full((len(points), count), -2, np.int32), np.zeros((len(points), count), np.float32)
    out_ids[blocks.order], out[blocks.order] = ids.T[: len(blocks)], squared.T[: len(blocks)]
    return out_ids, out


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 300), k=st.integers(1, 120), count=st.integers(1, 7), metric=st.sampled_from(METRICS), seed=st.integers(0, 10**6),
    make=st.sampled_from([room, awkward, landscape, distant_line]), with_normals=st.booleans(),
)  # fmt: skip
def test_shells_equal_brute_force(n, k, count, metric, seed, make, with_normals):
    points, normals = make(n, seed)
    centres, centre_normals = make(k, seed + 1)
    if not with_normals:
        normals = centre_normals = None
    ids, squared = search(points, normals, centres, centre_normals, count, metric)
    expected_ids, expected = brute_force(points, normals, centres, centre_normals, count, metric)
    np.testing.assert_array_equal(ids, expected_ids)
    np.testing.assert_array_equal(squared, expected)


@pytest.mark.parametrize("make", [room, landscape, distant_line])
@pytest.mark.parametrize("metric", METRICS)
def test_shells_equal_brute_force_with_many_centres(metric, make):
    points, normals = make(2000, 1)
    centres, centre_normals = make(1500, 2)
    ids, squared = search(points, normals, centres, centre_normals, 6, metric)
    expected_ids, expected = brute_force(points, normals, centres, centre_normals, 6, metric)
    np.testing.assert_array_equal(ids, expected_ids)
    np.testing.assert_array_equal(squared, expected)


def test_points_far_from_all_centres():
    centres, _ = room(200)
    points = np.concatenate([centres[:50] + np.float32(1e6), centres[:50] - np.float32(3e9)])
    ids, squared = search(points, None, centres, None, 3, Metric())
    expected_ids, expected = brute_force(points, None, centres, None, 3)
    np.testing.assert_array_equal(ids, expected_ids)
    np.testing.assert_array_equal(squared, expected)


def test_one_far_centre_does_not_hide_the_others():
    points, _ = room(500)
    centres = np.concatenate([room(300, 5)[0], np.full((1, 3), 1e5, np.float32)])
    ids, _ = search(points, None, centres, None, 2, Metric())
    np.testing.assert_array_equal(ids, brute_force(points, None, centres, None, 2)[0])


def test_extents_near_the_smallest_float_are_one_point():
    centres = np.array([[0, 0, 0], [1e-44, 0, 0], [0, 3e-42, 0]])
    ids, _ = search(centres, None, centres, None, 3, Metric())
    np.testing.assert_array_equal(ids, [[0, 1, 2]] * 3)


def test_crowds_get_finer_grids():
    centres, normals = landscape(2000)
    grid = build_grid(centres, normals, split=False)
    assert len(grid.cell) > 1 and (np.diff(grid.cell) < 0).all()
    for g, (begin, end) in enumerate(zip(grid.first, [*grid.first[1:], len(grid.start)])):
        members = np.diff(grid.start[begin:end])
        assert (members >= 0).all() and (g == len(grid.cell) - 1 or members.max() <= 4)
    assert sorted(grid.ids) == list(range(2000))


def test_centres_must_stay_below_the_given_distance():
    points, normals = room(500, 3)
    centres, centre_normals = room(60, 4)
    blocks, grid = point_blocks(points, normals), build_grid(centres, centre_normals)
    metric = Metric(0.75**0.5)
    ids, squared = nearest(blocks, grid, 1, metric)
    within = np.full(squared.shape[1], np.median(squared[0]), np.float32)
    near_ids, near = nearest(blocks, grid, 1, metric, within=within)
    np.testing.assert_array_equal(near, np.minimum(squared, within))
    np.testing.assert_array_equal(near_ids, np.where(squared < within, ids, -1))


def test_neighbourhood_finds_what_lies_within_a_cell_and_never_nothing():
    points, normals = room(2000, 3)
    centres, centre_normals = room(400, 4)
    metric = Metric(0.75**0.5)
    ids, squared = search(points, normals, centres, centre_normals, 1, metric, "neighbourhood")
    expected_ids, expected = brute_force(points, normals, centres, centre_normals, 1, metric)
    np.testing.assert_array_equal(ids < 0, expected_ids < 0)
    assert (squared >= expected).all()
    # A 27-cell neighbourhood holds everything within one cell, whose edge is at least the smallest of all grids.
    grid = build_grid(centres, centre_normals)
    close = np.sqrt(expected) < 0.99 * grid.cell[grid.cell > 0].min()
    assert close.mean() > 0.3
    np.testing.assert_array_equal(ids[close], expected_ids[close])


def test_any_number_of_threads_gives_the_same_bits():
    points, normals = room(20000, 6)
    centres, centre_normals = room(300, 7)
    runs = [search(points, normals, centres, centre_normals, 4, Metric(0.5), threads=threads) for threads in (1, 2, 3)]
    for ids, squared in runs[1:]:
        np.testing.assert_array_equal(ids, runs[0][0])
        np.testing.assert_array_equal(squared, runs[0][1])


def test_blocks_hold_the_finite_points_and_pad_with_the_last():
    points, normals = room(101)
    points[[0, 50, 100]] = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 2e18]]
    normals[7] = np.nan
    blocks = point_blocks(points, normals)
    assert sorted(blocks.order) == [i for i in range(101) if i not in (0, 50, 100)]
    assert blocks.positions.shape[1] == 7 * LANES
    np.testing.assert_array_equal(blocks.positions[:, :98].T, points[blocks.order])
    np.testing.assert_array_equal(blocks.positions[:, 98:].T, np.repeat(points[blocks.order[-1:]], 14, axis=0))
    assert list(blocks.order[np.flatnonzero(blocks.normals[3, :98])]) == [7]


def test_blocks_are_small_in_space():
    points, normals = room(16000)
    blocks = point_blocks(points, normals)
    corners = blocks.positions.reshape(3, -1, LANES)
    extent = np.linalg.norm(corners.max(axis=2) - corners.min(axis=2), axis=0)
    assert np.median(extent) < 0.5  # of a room whose diagonal is 5.6 m


@given(st.lists(st.integers(0, 2**48 - 1), max_size=200))
def test_radix_order_is_the_stable_order(keys):
    keys = np.array(keys, np.int64)
    np.testing.assert_array_equal(radix_order(keys), np.argsort(keys, kind="stable"))


def test_bad_arguments_are_named():
    blocks, grid = point_blocks(*room(10)), build_grid(*room(5))
    with pytest.raises(ValueError, match="search"):
        nearest(blocks, grid, search="kd-tree")
    with pytest.raises(ValueError, match="centres"):
        build_grid(np.zeros((0, 3)))
    with pytest.raises(ValueError, match="positions"):
        point_blocks(np.zeros((4, 2)))
    with pytest.raises(ValueError, match="rows"):
        point_blocks(np.zeros((4, 3)), np.zeros((3, 3)))
