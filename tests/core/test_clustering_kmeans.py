"""k-means: defined for every input, exact at the end, falling objective, the same bits for any number of threads."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core.clustering import kmeans, point_blocks
from lumigate.core.clustering.grid import Metric

from .clustering_points import all_squared, awkward, brute_force, landscape, room

THRESHOLD = 0.75**0.5


def check(clustering, points, normals, threshold=THRESHOLD):
    """What holds for every clustering: its assignment is brute force, clusters have members, representatives are some."""
    finite = np.isfinite(points).all(axis=1)
    metric = Metric() if threshold is None else Metric(threshold)
    ids, squared = brute_force(points[finite], normals[finite], clustering.centroids, clustering.normals, 1, metric)
    assigned = clustering.assignment[finite]
    np.testing.assert_array_equal(clustering.assignment[~finite], -1)
    matched = ids[:, 0] >= 0
    assert (~matched).sum() == clustering.unmatched
    np.testing.assert_array_equal(assigned[matched], ids[matched, 0])
    anywhere, _ = brute_force(points[finite], normals[finite], clustering.centroids, clustering.normals)
    np.testing.assert_array_equal(assigned[~matched], anywhere[~matched, 0])

    np.testing.assert_array_equal(clustering.sizes, np.bincount(assigned, minlength=len(clustering)))
    assert (clustering.sizes > 0).all()
    np.testing.assert_array_equal(clustering.assignment[clustering.representatives], np.arange(len(clustering)))
    best = np.full(len(clustering), np.inf, np.float32)
    np.minimum.at(best, assigned, squared[:, 0])
    of_representative = np.full(len(points), np.inf, np.float32)
    of_representative[finite] = squared[:, 0]
    np.testing.assert_array_equal(of_representative[clustering.representatives], best)
    length = np.linalg.norm(clustering.normals, axis=1)
    assert ((length == 0) | (abs(length - 1) < 1e-5)).all()


@settings(max_examples=40, deadline=None)
@given(
    n=st.integers(1, 400), k=st.integers(1, 500), seed=st.integers(0, 10**6), make=st.sampled_from([room, awkward, landscape]),
    threshold=st.sampled_from([THRESHOLD, 0.99, None]), iterations=st.integers(0, 4), gamma=st.sampled_from([1, 3]),
    extra=st.sampled_from([None, 0, 1]),
)  # fmt: skip
def test_every_clustering_is_exact_and_without_empty_clusters(n, k, seed, make, threshold, iterations, gamma, extra):
    points, normals = make(n, seed)
    clustering = kmeans(
        points, normals, k, normal_threshold=threshold, iterations=iterations, gamma=gamma, extra=extra, seed=seed, threads=1
    )
    check(clustering, points, normals, threshold)
    assert len(clustering) <= min(n, k) + (max(8, k // 4) if extra is None else extra)


def test_neighbourhood_serves_every_point():
    points, normals = room(2000)
    clustering = kmeans(points, normals, 100, search="neighbourhood", threads=1)
    assert (clustering.assignment >= 0).all()
    assert clustering.unmatched == 0
    cos = (normals * clustering.normals[clustering.assignment]).sum(axis=1)
    assert cos.min() > THRESHOLD - 1e-5


def test_no_points():
    clustering = kmeans(np.zeros((0, 3)), np.zeros((0, 3)), 5)
    assert len(clustering) == 0 and clustering.assignment.shape == (0,) and clustering.centroids.shape == (0, 3)


def test_one_point():
    clustering = kmeans([[1, 2, 3]], [[0, 0, 1]], 5)
    np.testing.assert_array_equal(clustering.centroids, [[1, 2, 3]])
    np.testing.assert_array_equal(clustering.assignment, [0])
    np.testing.assert_array_equal(clustering.representatives, [0])


def test_more_clusters_than_points_gives_each_its_own():
    points, normals = room(50)
    clustering = kmeans(points, normals, 80)
    assert len(clustering) == 50
    assert sorted(clustering.representatives) == list(range(50))


def test_coincident_points_are_one_cluster_and_the_lowest_index_represents_it():
    clustering = kmeans(np.ones((40, 3)), np.tile([0, 0, 1], (40, 1)), 8)
    assert len(clustering) == 1
    assert list(clustering.representatives) == [0] and list(clustering.sizes) == [40]


def test_points_that_are_not_finite_have_no_cluster():
    points, normals = room(100)
    points[3], points[70, 1] = np.nan, np.inf
    clustering = kmeans(points, normals, 10)
    check(clustering, points, normals)
    assert clustering.sizes.sum() == 98
    none = kmeans(np.full((5, 3), np.nan), None, 2)
    assert len(none) == 0 and list(none.assignment) == [-1] * 5


def test_missing_normals_go_with_any_cluster():
    points, normals = room(300)
    normals[::7] = np.nan
    normals[1::7] = 0
    clustering = kmeans(points, normals, 20)
    check(clustering, points, normals)
    assert np.isfinite(clustering.normals).all() and clustering.unmatched == 0


def test_no_normals_is_plain_kmeans():
    points, _ = room(1000)
    clustering = kmeans(points, None, 30)
    check(clustering, points, np.zeros_like(points), None)
    assert len(clustering) == 30


def test_opposite_normals_cancel_to_none():
    clustering = kmeans([[0, 0, 0], [1e-3, 0, 0]], [[0, 0, 1], [0, 0, -1]], 1, normal_threshold=None)
    np.testing.assert_array_equal(clustering.normals, [[0, 0, 0]])


def test_a_thin_wall_has_clusters_on_either_side():
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.random((500, 3)) * [1, 1, 0], rng.random((500, 3)) * [1, 1, 0] + [0, 0, 1e-3]])
    normals = np.repeat([[0.0, 0, -1], [0, 0, 1]], 500, axis=0)
    clustering = kmeans(points, normals, 16)
    side = clustering.normals[clustering.assignment, 2]
    np.testing.assert_array_equal(np.sign(side), normals[:, 2])


def test_points_that_no_centroid_takes_get_clusters_of_their_own():
    points, normals = room(2000)
    direction = np.random.default_rng(1).normal(size=(60, 3))
    normals[:60] = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    few = kmeans(points, normals, 6, extra=64)
    check(few, points, normals)
    assert few.unmatched == 0 and 6 < len(few) <= 70
    none = kmeans(points, normals, 6, extra=0)
    check(none, points, normals)
    assert none.unmatched > 0 and len(none) <= 6


@pytest.mark.parametrize("scale", [0.0, 0.4])
def test_the_objective_never_rises_without_threshold(scale):
    points, normals = room(3000)
    clustering = kmeans(points, normals, 60, normal_threshold=None, normal_scale=scale, iterations=20, weights=np.arange(3000.0))
    objective = np.array(clustering.objective)
    assert len(objective) > 5
    assert (np.diff(objective) <= 1e-6 * objective[:-1]).all()
    assert objective[-1] < 0.8 * objective[0]


def test_the_objective_is_the_mean_squared_distance():
    points, normals = room(500)
    weights = np.random.default_rng(0).random(500)
    clustering = kmeans(points, normals, 500 // 4, normal_threshold=None, normal_scale=0.3, iterations=30, weights=weights)
    metric = Metric(turn=2 * 0.3**2)
    squared = all_squared(points, normals, clustering.centroids, clustering.normals, metric).min(axis=1)
    np.testing.assert_allclose(clustering.objective[-1], np.average(squared, weights=weights), rtol=1e-5)


def test_it_ends_when_nothing_moves():
    points, normals = room(300)
    clustering = kmeans(points, normals, 10, iterations=200, normal_threshold=None)
    assert len(clustering.objective) < 100
    members = [points[clustering.assignment == c].astype(float).mean(axis=0) for c in range(len(clustering))]
    np.testing.assert_allclose(clustering.centroids, members, atol=1e-5)


def test_the_normal_scale_splits_by_normal_like_six_coordinates():
    points, normals = room(800, 3)
    clustering = kmeans(points, normals, 12, normal_threshold=None, normal_scale=2.0, iterations=10)
    embedded = np.concatenate([points, 2 * normals], axis=1).astype(float)
    centres = np.concatenate([clustering.centroids, 2 * clustering.normals], axis=1).astype(float)
    squared = ((embedded[:, None] - centres[None]) ** 2).sum(axis=2)
    own = squared[np.arange(800), clustering.assignment]
    np.testing.assert_allclose(own, squared.min(axis=1), rtol=1e-4, atol=1e-4)


def test_weights_draw_the_centroids():
    points = np.zeros((100, 3))
    points[:, 0] = np.arange(100)
    weights = np.where(np.arange(100) < 10, 1000.0, 0.0)
    clustering = kmeans(points, None, 5, weights=weights, iterations=10)
    assert (clustering.centroids[:, 0] < 10.01).sum() >= 4
    uniform = kmeans(points, None, 5, weights=np.zeros(100))
    same = kmeans(points, None, 5)
    np.testing.assert_array_equal(uniform.centroids, same.centroids)


def test_the_training_sample_is_gamma_times_smaller_but_keeps_the_clusters_fed():
    points, normals = room(4000)
    whole = kmeans(points, normals, 40, iterations=8)
    sampled = kmeans(points, normals, 40, iterations=8, gamma=8)
    check(sampled, points, normals)
    own = [((points - c.centroids[c.assignment]) ** 2).sum(axis=1).mean() for c in (whole, sampled)]
    assert own[0] < own[1] < 1.3 * own[0]
    assert len(kmeans(points, normals, 1000, gamma=1e6)) > 900


def test_it_starts_from_given_points_or_an_earlier_clustering():
    points, normals = room(500)
    indices = np.arange(0, 500, 50)
    seeds = kmeans(points, normals, 10, initial=indices, iterations=0, extra=0)
    np.testing.assert_array_equal(seeds.centroids, points[indices])
    settled = kmeans(points, normals, 10, iterations=200, extra=0)
    again = kmeans(points, normals, 10, iterations=5, initial=settled, extra=0)
    np.testing.assert_array_equal(again.assignment, settled.assignment)
    assert len(kmeans(points, normals, 14, initial=indices)) >= 14


def test_the_seed_chooses_the_start_and_nothing_else_does():
    points, normals = room(600)
    a, b, c = (kmeans(points, normals, 20, seed=seed, iterations=1) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.centroids, b.centroids)
    assert (a.centroids != c.centroids).any()


def test_any_number_of_threads_gives_the_same_bits():
    points, normals = room(30000)
    weights = np.random.default_rng(0).random(30000)
    blocks = point_blocks(points, normals)
    runs = [kmeans(blocks, None, 150, weights=weights, gamma=2, threads=threads) for threads in (1, 2, 3)]
    for run in runs[1:]:
        assert run.objective == runs[0].objective
        for name in ("centroids", "normals", "assignment", "sizes", "representatives"):
            np.testing.assert_array_equal(getattr(run, name), getattr(runs[0], name))


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"k": 0}, "k >= 1"),
        ({"gamma": 0.5}, "gamma"),
        ({"weights": np.full(20, -1.0)}, "weights"),
        ({"weights": np.full(20, np.nan)}, "weights"),
        ({"weights": np.ones(3)}, "weights"),
        ({"initial": [99]}, "initial"),
        ({"search": "tree"}, "search"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    points, normals = room(20)
    with pytest.raises(ValueError, match=message):
        kmeans(points, normals, **({"k": 4} | arguments))
