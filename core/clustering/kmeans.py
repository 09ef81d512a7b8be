"""k-means for surface points with normals: pixels, lightmap texels and VPLs alike.

Fuzzy clustering paper, Section 3.2.1 and Algorithm 1: distance of Eq. 7 (positions, infinite beyond a threshold on
the normals' cosine), training on a sample of the points, grid over the centroids, one assignment of all points at the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..jit import kernel
from ..threads import run_chunks
from .blocks import PointBlocks, as_blocks
from .grid import ANY_NORMAL, Metric, build_grid, nearest

NORMAL_THRESHOLD = 0.75**0.5  # cosine of 30 degrees, found by the paper (Section 3.2.1)

_TRAINING_PER_CLUSTER = 4  # sampling leaves at least as many training points a cluster
_SMALLEST_WEIGHT = 1e-6  # of the mean weight: clusters of points without weight have a centroid too
_CHUNKS = 16
_SMALLEST_CHUNK = 4096
_INF = np.float32(np.inf)


@dataclass(frozen=True)
class Clustering:
    """K clusters of M points, none of them empty.

    centroids: (K, 3) float32 (m);  normals: (K, 3) float32, the members' normalised mean, zero where they cancel
        out or have none; None where no normals were given.
    assignment: (M,) int32, the nearest centroid of every point; -1 where a coordinate is not finite.
    sizes: (K,) int32, members.  representatives: (K,) int32, the member nearest to the centroid (equal
        distances: the lowest index).
    objective: mean squared distance (m^2) of the training points at each iteration, over those that have a cluster.
    unmatched: points that broke the normal threshold because the extra clusters ran out; they are with the
        nearest centroid.
    """

    centroids: np.ndarray
    normals: np.ndarray
    assignment: np.ndarray
    sizes: np.ndarray
    representatives: np.ndarray
    objective: tuple[float, ...]
    unmatched: int

    def __len__(self) -> int:
        return len(self.centroids)


def kmeans(
    positions: np.ndarray | PointBlocks,
    normals: np.ndarray | None,
    k: int,
    *,
    weights: np.ndarray | None = None,
    iterations: int = 5,
    gamma: float = 1.0,
    normal_threshold: float | None = NORMAL_THRESHOLD,
    normal_scale: float = 0.0,
    search: str = "shells",
    seed: int = 0,
    threads: int = 0,
    initial: np.ndarray | Clustering | None = None,
    extra: int | None = None,
) -> Clustering:
    """Cluster M points into about k clusters; the same bits for any number of threads.

    positions: (M, 3) (m), or PointBlocks made of positions and normals (`normals` is then not read).
    normals: (M, 3) unit vectors or None.  One that is zero or not finite goes with any other normal.
    weights: (M,), e.g. a VPL's power; at least 1e-6 of their mean is used.
    iterations: at most; ends earlier where no point moves.
    gamma: every gamma-th point trains, but at least 4 k points.
    normal_threshold: a centroid takes a point only if the cosine of their normals is larger; None: always.
    normal_scale: metres; s > 0 adds |s n - s m|^2 = 2 s^2 (1 - cos) to the squared distance, as if the normals, scaled by s,
        were three more coordinates (the metric of virtual area lights, Dong et al. 2009, Section 5.1).
    search: `shells` (exact) or `neighbourhood` (27 cells).
    initial: (k,) indices of the points to start from, or an earlier Clustering (temporal coherence); points in
        strata of equal weight along the sorting curve otherwise.
    extra: clusters that may be added beyond k for points that no centroid takes, max(8, k / 4) by default.

    There are fewer than k clusters where there are fewer distinct points, and none for no points.  A cluster without members is
    seeded anew at a point that no centroid takes, else at the farthest member of the cluster with the largest error.

    Raises:
        ValueError: k < 1, gamma < 1, weights that are negative or not finite, wrong shapes, unknown search.
    """
    blocks = as_blocks(positions, normals)
    if k < 1 or gamma < 1 or iterations < 0:
        raise ValueError(f"expected k >= 1, gamma >= 1 and iterations >= 0, got {k}, {gamma} and {iterations}")
    n = len(blocks)
    assignment = np.full(blocks.given, -1, np.int32)
    if n == 0:
        vectors, integers = np.zeros((0, 3), np.float32), np.zeros(0, np.int32)
        return Clustering(vectors, vectors, assignment, integers, integers, (), 0)
    k = min(k, n)
    extra = max(8, k // 4) if extra is None else extra
    threshold = ANY_NORMAL if normal_threshold is None else float(normal_threshold)
    metric = Metric(threshold, 2 * normal_scale**2)

    training, weights = _training(blocks, _checked_weights(weights, blocks), max(1, min(round(gamma), n // (_TRAINING_PER_CLUSTER * k))))
    centroids, means = _initial(blocks, training, weights, k, initial, np.random.default_rng(seed))
    objective = []
    added = 0
    previous = None
    for iteration in range(iterations):
        ids, squared = nearest(training, _grid(centroids, means, threshold), 1, metric, search, threads)
        sums, farthest = _cluster_sums(training, weights, ids[0], squared[0], len(centroids), threads)
        objective.append(float(sums[:, 7].sum() / max(sums[:, 0].sum(), np.finfo(float).tiny)))
        centroids, means = _means(sums, centroids, means)
        changed = _reseed(training, sums, farthest, ids[0, : len(training)], centroids, means)
        if iteration == iterations // 2:
            # Half-way, so that the other half of the iterations spreads the added centroids out.
            places = _leftover_seeds(training, ids[0], extra // 2, metric, search, threads)
            centroids, means = _append(training, places, centroids, means)
            added = len(places)
            changed |= added > 0
        if not changed and previous is not None and np.array_equal(previous, ids):
            break
        previous = ids

    ids, squared = nearest(blocks, _grid(centroids, means, threshold), 1, metric, search, threads)
    ids, squared = ids[0], squared[0]
    places = _leftover_seeds(blocks, ids, extra - added, metric, search, threads)
    if len(places):
        # All points see the new centroids: the assignment stays that of the nearest of all.
        found, squared = nearest(blocks, _grid(*_at(blocks, places), threshold), 1, metric, "shells", threads, squared)
        nearer, squared = found[0] >= 0, squared[0]
        ids[nearer] = found[0, nearer] + len(centroids)
        centroids, means = _append(blocks, places, centroids, means)
    left = np.flatnonzero(ids[:n] < 0)
    if len(left):
        grid = build_grid(centroids, means, split=False)
        found, _ = nearest(blocks.take(left), grid, 1, metric._replace(threshold=ANY_NORMAL), search, threads)
        ids[left] = found[0, : len(left)]  # their distance stays infinite: no cluster with a better member is represented by them
    return _finished(blocks, centroids, means, ids, squared, tuple(objective), len(left), assignment)


def _checked_weights(weights: np.ndarray | None, blocks: PointBlocks) -> np.ndarray:
    """(N,) float64, in sorted order."""
    if weights is None:
        return np.ones(len(blocks))
    weights = np.asarray(weights, np.float64)
    if weights.shape != (blocks.given,):
        raise ValueError(f"weights: expected shape ({blocks.given},), got {weights.shape}")
    weights = weights[blocks.order]
    if not (np.isfinite(weights) & (weights >= 0)).all():
        raise ValueError("weights: expected finite, not negative values")
    mean = weights.mean()
    return np.maximum(weights, _SMALLEST_WEIGHT * mean) if mean > 0 else np.ones(len(blocks))


def _training(blocks: PointBlocks, weights: np.ndarray, step: int) -> tuple[PointBlocks, np.ndarray]:
    return (blocks, weights) if step == 1 else (blocks.every(step), weights[step // 2 :: step])


def _grid(centroids: np.ndarray, means: np.ndarray, threshold: float):
    return build_grid(centroids, means, split=threshold > -1)


def _initial(blocks, training, weights, k, initial, rng) -> tuple[np.ndarray, np.ndarray]:
    """(k, 3) centroids and normals to start from."""
    edges = np.concatenate([[0.0], np.cumsum(weights)])
    strata = (np.arange(k) + rng.random(k)) / k * edges[-1]
    places = np.searchsorted(edges, strata, side="right") - 1
    # Heavy points fill several strata: each stratum takes the next free point, and none runs off the end.
    steps = np.arange(k)
    places = np.maximum.accumulate(places - steps) + steps
    places = np.minimum(places, len(training) - k + steps)
    centroids, means = _at(training, places)
    if initial is None:
        return centroids, means
    if isinstance(initial, Clustering):
        given, given_means = initial.centroids[:k], initial.normals[:k]
    else:
        place_of = np.full(blocks.given, -1, np.int64)
        place_of[blocks.order] = np.arange(len(blocks))
        initial = np.asarray(initial)[:k]
        if initial.ndim != 1 or ((initial < 0) | (initial >= blocks.given)).any() or (place_of[initial] < 0).any():
            raise ValueError("initial: expected indices of points with finite coordinates")
        given, given_means = _at(blocks, place_of[initial])
    centroids[: len(given)] = given
    means[: len(given)] = given_means
    return centroids, means


def _at(blocks: PointBlocks, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.ascontiguousarray(blocks.positions[:, places].T), np.ascontiguousarray(blocks.normals[:3, places].T)


def _cluster_sums(points, weights, ids, squared, k, threads) -> tuple[np.ndarray, np.ndarray]:
    """(k, 8) float64 sums over the members, in a fixed order, and (k,) the place of each cluster's farthest one.

    Columns: w, w x, w y, w z, w nx, w ny, w nz, w d^2.
    """
    chunk = max(_SMALLEST_CHUNK, -(-len(points) // _CHUNKS))

    def work(begin, end):
        sums, distance, farthest = np.zeros((k, 8)), np.full(k, -1, np.float32), np.full(k, -1, np.int64)
        _sum_members(points.positions, points.normals, weights, ids, squared, begin, end, sums, distance, farthest)
        return sums, distance, farthest

    parts = run_chunks(work, len(points), chunk, threads)
    sums, distance, farthest = parts[0]
    for part, part_distance, part_farthest in parts[1:]:
        sums += part
        further = part_distance > distance
        distance[further], farthest[further] = part_distance[further], part_farthest[further]
    return sums, farthest


@kernel(fast=False)
def _sum_members(positions, normals, weights, ids, squared, begin, end, sums, distance, farthest):
    for i in range(begin, end):
        c = ids[i]
        if c < 0:
            continue
        w = weights[i]
        row = sums[c]
        row[0] += w
        row[1] += w * positions[0, i]
        row[2] += w * positions[1, i]
        row[3] += w * positions[2, i]
        row[4] += w * normals[0, i]
        row[5] += w * normals[1, i]
        row[6] += w * normals[2, i]
        row[7] += w * squared[i]
        if squared[i] > distance[c]:
            distance[c] = squared[i]
            farthest[c] = i


def _means(sums, centroids, means) -> tuple[np.ndarray, np.ndarray]:
    """The members' mean positions and normalised mean normals; clusters without members keep theirs."""
    filled = sums[:, 0] > 0
    centroids = centroids.copy()
    centroids[filled] = sums[filled, 1:4] / sums[filled, :1]
    means = means.copy()
    length = np.linalg.norm(sums[:, 4:7], axis=1)
    # Opposite normals cancel out but for rounding: such a cluster has no normal.
    clear = length > 1e-6 * sums[:, 0]
    means[filled] = 0
    means[filled & clear] = sums[filled & clear, 4:7] / length[filled & clear, None]
    return centroids, means


def _reseed(points, sums, farthest, ids, centroids, means) -> bool:
    """Give clusters without members a new place, in place; True if any was moved."""
    empty = np.flatnonzero(sums[:, 0] == 0)
    if len(empty) == 0:
        return False
    leftovers = np.flatnonzero(ids < 0)
    places = leftovers[_strided(len(leftovers), min(len(empty), len(leftovers)))]
    donors = np.flatnonzero(sums[:, 7] > 0)
    donors = donors[np.argsort(-sums[donors, 7], kind="stable")][: len(empty) - len(places)]
    places = np.concatenate([places, farthest[donors]])
    moved = empty[: len(places)]
    centroids[moved], means[moved] = _at(points, places)
    return len(places) > 0


def _strided(n: int, count: int) -> np.ndarray:
    """`count` of range(n), evenly spread."""
    return (np.arange(count) * n + n // 2) // max(count, 1)


def _leftover_seeds(points, ids, extra, metric, search, threads) -> np.ndarray:
    """Places of up to `extra` points that no centroid takes, such that they take as many of the others as they can.

    ids: the points' centroids.  Half of the seeds that are left go to evenly spread leftovers at each round.
    """
    left = np.flatnonzero(ids[: len(points)] < 0)
    seeds = np.zeros(0, np.int64)
    while len(left) and len(seeds) < extra:
        chosen = left[_strided(len(left), min(len(left), -(-(extra - len(seeds)) // 2)))]
        seeds = np.concatenate([seeds, chosen])
        found, _ = nearest(points.take(left), _grid(*_at(points, chosen), metric.threshold), 1, metric, search, threads)
        left = left[found[0, : len(left)] < 0]
    return seeds


def _append(points, places, centroids, means) -> tuple[np.ndarray, np.ndarray]:
    added, added_means = _at(points, places)
    return np.concatenate([centroids, added]), np.concatenate([means, added_means])


def _finished(blocks, centroids, means, ids, squared, objective, unmatched, assignment) -> Clustering:
    """Drop clusters without members, find the representatives, and undo the sorting."""
    sizes, representatives = _members(ids, squared, blocks.order, len(centroids))
    filled = sizes > 0
    label = np.cumsum(filled, dtype=np.int32) - np.int32(1)
    assignment[blocks.order] = label[ids[: len(blocks)]]
    return Clustering(centroids[filled], means[filled], assignment, sizes[filled], representatives[filled], objective, unmatched)


@kernel(fast=False)
def _members(ids, squared, order, k):
    """Members of each cluster, and the given index of the one nearest to the centroid."""
    sizes = np.zeros(k, np.int32)
    nearest_squared = np.full(k, _INF)
    representatives = np.full(k, -1, np.int32)
    for i in range(len(order)):
        c = ids[i]
        sizes[c] += 1
        tie = squared[i] == nearest_squared[c] and (representatives[c] < 0 or order[i] < representatives[c])
        if squared[i] < nearest_squared[c] or tie:
            nearest_squared[c] = squared[i]
            representatives[c] = order[i]
    return sizes, representatives
