"""Fuzzy assignment and plane-aware neighbours against their formulas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core.clustering import fuzzy_assign, kmeans, median_spacing, nearest_plane_aware, point_blocks
from lumigate.core.clustering.grid import Metric

from .clustering_points import all_squared, awkward, brute_force, landscape, room

THRESHOLD = 0.75**0.5


@settings(max_examples=30, deadline=None)
@given(
    n=st.integers(1, 200), k=st.integers(1, 60), count=st.integers(1, 7), seed=st.integers(0, 10**6),
    make=st.sampled_from([room, awkward, landscape]), weighting=st.sampled_from(["distance", "plain", "smooth"]),
)  # fmt: skip
def test_indices_are_the_nearest_and_weights_add_up_to_one(n, k, count, seed, make, weighting):
    points, normals = make(n, seed)
    centres, centre_normals = make(k, seed + 1)
    fuzzy = fuzzy_assign(points, normals, centres, centre_normals, count, weighting=weighting, threads=1)
    ids, squared = brute_force(points, normals, centres, centre_normals, count, Metric(THRESHOLD))
    anywhere, anywhere_squared = brute_force(points, normals, centres, centre_normals)
    alone = ids[:, 0] < 0
    ids[alone, 0], squared[alone, 0] = anywhere[alone, 0], anywhere_squared[alone, 0]
    np.testing.assert_array_equal(fuzzy.indices, np.where(ids < 0, ids[:, :1], ids))
    np.testing.assert_array_equal(fuzzy.distances, np.sqrt(squared))
    np.testing.assert_allclose(fuzzy.weights.sum(axis=1, dtype=float), 1, atol=1e-6)
    assert (fuzzy.weights >= 0).all() and (fuzzy.weights[ids < 0] == 0).all()
    assert (np.diff(fuzzy.weights, axis=1) <= 1e-7).all()


def test_weights_are_the_inverse_distances_of_equation_10():
    points, normals = room(400, 1)
    centres, centre_normals = room(200, 2)
    fuzzy = fuzzy_assign(points, normals, centres, centre_normals, 6)
    inverse = 1 / fuzzy.distances.astype(float)
    np.testing.assert_allclose(fuzzy.weights, inverse / inverse.sum(axis=1, keepdims=True), rtol=1e-5, atol=1e-7)


def test_the_plain_average_of_equation_8():
    points, normals = room(100, 1)
    fuzzy = fuzzy_assign(points, normals, points[:30], normals[:30], 6, weighting="plain")
    found = np.isfinite(fuzzy.distances)
    np.testing.assert_allclose(fuzzy.weights, found / found.sum(axis=1, keepdims=True), rtol=1e-6)


def test_one_cluster_is_hard_clustering():
    points, normals = room(3000)
    clustering = kmeans(points, normals, 50)
    fuzzy = fuzzy_assign(points, normals, clustering.centroids, clustering.normals, 1)
    np.testing.assert_array_equal(fuzzy.indices[:, 0], clustering.assignment)
    np.testing.assert_array_equal(fuzzy.weights, 1)


@pytest.mark.parametrize("weighting", ["distance", "smooth"])
def test_a_point_on_a_representative_is_that_one(weighting):
    points, normals = room(200)
    fuzzy = fuzzy_assign(points[:50], normals[:50], points, normals, 6, weighting=weighting)
    np.testing.assert_array_equal(fuzzy.indices[:, 0], np.arange(50))
    assert np.isfinite(fuzzy.weights).all() and fuzzy.weights[:, 0].min() > 0.99


@pytest.mark.parametrize("weighting", ["distance", "plain", "smooth"])
def test_coincident_representatives_share_evenly(weighting):
    fuzzy = fuzzy_assign(np.zeros((1, 3)), None, np.zeros((8, 3)), None, 4, weighting=weighting)
    np.testing.assert_array_equal(fuzzy.indices, [[0, 1, 2, 3]])
    np.testing.assert_allclose(fuzzy.weights, 0.25, rtol=1e-6)


def test_smooth_weights_leave_no_jump_where_a_representative_leaves_the_list():
    rng = np.random.default_rng(0)
    centres = np.concatenate([rng.random((200, 2)), np.zeros((200, 1))], axis=1)
    visible = rng.random(200)
    line = np.zeros((20001, 3))
    line[:, 0], line[:, 1] = np.linspace(0.1, 0.9, 20001), 0.5
    jump = {}
    for weighting in ("plain", "distance", "smooth"):
        fuzzy = fuzzy_assign(line, None, centres, None, 6, weighting=weighting)
        jump[weighting] = np.abs(np.diff((fuzzy.weights * visible[fuzzy.indices]).sum(axis=1))).max()
    assert jump["distance"] < 0.8 * jump["plain"]
    assert jump["smooth"] < 0.1 * jump["distance"]


def test_interpolation_stays_within_the_values_and_is_exact_for_constants():
    points, normals = room(2000)
    clustering = kmeans(points, normals, 60)
    representatives = clustering.representatives
    fuzzy = fuzzy_assign(points, normals, points[representatives], normals[representatives])
    visible = np.random.default_rng(0).integers(0, 2, len(clustering))
    blended = (fuzzy.weights * visible[fuzzy.indices]).sum(axis=1)
    assert blended.min() >= 0 and blended.max() <= 1 + 1e-6
    np.testing.assert_allclose((fuzzy.weights * np.ones(len(clustering))[fuzzy.indices]).sum(axis=1), 1, atol=1e-6)


def test_points_that_are_not_finite_weigh_nothing():
    points, normals = room(40)
    points[5] = np.nan
    fuzzy = fuzzy_assign(points, normals, points[10:20], normals[10:20])
    assert (fuzzy.weights[5] == 0).all() and (fuzzy.indices[5] == 0).all()
    assert len(fuzzy_assign(np.zeros((0, 3)), None, points[:1], normals[:1]).weights) == 0


def test_any_number_of_threads_gives_the_same_bits():
    points, normals = room(40000)
    blocks = point_blocks(points, normals)
    runs = [fuzzy_assign(blocks, None, points[:300], normals[:300], weighting="smooth", threads=threads) for threads in (1, 2, 3)]
    for run in runs[1:]:
        for a, b in zip(run, runs[0]):
            np.testing.assert_array_equal(a, b)


@settings(max_examples=20, deadline=None)
@given(n=st.integers(1, 200), k=st.integers(1, 80), seed=st.integers(0, 10**6), make=st.sampled_from([room, awkward, landscape]))
def test_plane_aware_neighbours_equal_the_formula(n, k, seed, make):
    points, normals = make(n, seed)
    centres, centre_normals = make(k, seed + 1)
    fuzzy = nearest_plane_aware(points, normals, centres, centre_normals, 4, 0.3, threads=1)
    metric = Metric(0.5**0.5, 2 * 0.3**2, 16.0)
    ids, squared = brute_force(points, normals, centres, centre_normals, 4, metric)
    served = ids[:, 0] >= 0
    np.testing.assert_array_equal(fuzzy.indices[served], np.where(ids < 0, ids[:, :1], ids)[served])
    np.testing.assert_array_equal(fuzzy.distances[served], np.sqrt(squared)[served])
    np.testing.assert_array_equal(fuzzy.indices[~served], np.repeat(brute_force(points, None, centres, None)[0][~served], 4, axis=1))
    np.testing.assert_allclose(fuzzy.weights.sum(axis=1, dtype=float), 1, atol=1e-6)


def test_plane_aware_distance_of_one_pair():
    point, normal = [[0.0, 0, 0]], [[0.0, 0, 1]]
    tilt = np.deg2rad(30)
    other, other_normal = [[0.3, 0, 0.1]], [[np.sin(tilt), 0, np.cos(tilt)]]
    h = max(0.1, abs(0.3 * np.sin(tilt) + 0.1 * np.cos(tilt)))
    expected = np.sqrt(0.3**2 + 0.1**2 + (4 * h) ** 2 + 2 * 0.5**2 * (1 - np.cos(tilt)))
    fuzzy = nearest_plane_aware(point, normal, other, other_normal, 1, 0.5)
    np.testing.assert_allclose(fuzzy.distances, [[expected]], rtol=1e-6)


def test_plane_aware_neighbours_stay_on_their_step_of_a_stair():
    x = np.linspace(0, 4, 401)
    steps = np.stack([x, np.zeros_like(x), np.floor(x) * 0.2], axis=1)
    normals = np.tile([0.0, 0, 1], (401, 1))
    fuzzy = nearest_plane_aware(steps, normals, steps[5::40], normals[5::40], 1)
    plain = fuzzy_assign(steps, normals, steps[5::40], normals[5::40], 1)
    other_step = [(steps[5::40][f.indices[:, 0], 2] != steps[:, 2]).mean() for f in (fuzzy, plain)]
    assert other_step[0] < 0.5 * other_step[1]


def test_the_default_d0_is_the_median_spacing():
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(10), [0]), -1).reshape(-1, 3) * 0.25
    assert median_spacing(grid) == pytest.approx(0.25)
    assert median_spacing(grid[:1]) == 0
    points, normals = room(100)
    centres, centre_normals = room(30, 1)
    default = nearest_plane_aware(points, normals, centres, centre_normals)
    named = nearest_plane_aware(points, normals, centres, centre_normals, 4, median_spacing(centres))
    np.testing.assert_array_equal(default.distances, named.distances)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda p, n: fuzzy_assign(p, n, p, n, 0), "fuzziness"),
        (lambda p, n: fuzzy_assign(p, n, p, n, weighting="gaussian"), "weighting"),
        (lambda p, n: fuzzy_assign(p, n, p[:0], n[:0]), "centres"),
        (lambda p, n: nearest_plane_aware(p, n, p, n, 0), "F"),
        (lambda p, n: nearest_plane_aware(p, n, p, n[:3], d0=1.0), "centre normals"),
    ],
)
def test_bad_arguments_are_named(call, message):
    with pytest.raises(ValueError, match=message):
        call(*room(20))


def test_distances_are_those_of_the_metric():
    points, normals = room(50)
    fuzzy = fuzzy_assign(points, normals, points, normals, 3, normal_threshold=None)
    np.testing.assert_array_equal(fuzzy.distances[:, 0], 0)
    squared = np.sort(all_squared(points, normals, points, normals), axis=1)[:, :3]
    np.testing.assert_array_equal(fuzzy.distances, np.sqrt(squared))
