"""Clustering by itself: one assignment pass beside SciPy's cKDTree, one k-means iteration beside scikit-learn's.

Rates are points per second of CPU time on one thread, so that a busy machine does not bend them; contestants take turns,
and the median counts.  scikit-learn is not a dependency: its rows have no peer where it is not installed.
"""

from __future__ import annotations

import importlib
import statistics
import time
from collections.abc import Callable
from contextlib import nullcontext

import numpy as np
from scipy.spatial import cKDTree

from ..core.clustering import fuzzy_assign, kmeans, nearest_plane_aware, point_blocks
from ..core.clustering.grid import Metric, build_grid, nearest
from ..core.clustering.kmeans import NORMAL_THRESHOLD
from .kernel_bench import hall, surface_samples

POINTS, CENTRES = 100_000, 2_000
FUZZINESS = 6
ITERATIONS = 6
REPEATS = 7
_CHECKED = 4096  # points compared with brute force


def clustering_rows(points: int = POINTS, centres: int = CENTRES, repeats: int = REPEATS, threads: int = 2) -> list[dict]:
    """Rows of the suite `clustering`, on samples of a hall's surfaces; a `ratio` above 1 is ours being faster."""
    samples = surface_samples(*hall(), points, 1)
    positions, normals = np.ascontiguousarray(samples[:, :3]), np.ascontiguousarray(samples[:, 3:6])
    return [
        *_pass_rows(positions, normals, centres, repeats, threads),
        *_fuzzy_rows(positions, normals, centres, repeats),
        *_iteration_rows(positions, normals, centres, repeats),
    ]


def _pass_rows(positions: np.ndarray, normals: np.ndarray, k: int, repeats: int, threads: int) -> list[dict]:
    n = len(positions)
    blocks, with_normals = point_blocks(positions), point_blocks(positions, normals)
    start = kmeans(with_normals, None, k, iterations=2, extra=0)
    centroids, means = start.centroids, start.normals
    in_order = np.ascontiguousarray(blocks.positions[:, :n].T)  # as kind to the tree's caches as to ours
    metric = Metric(NORMAL_THRESHOLD)
    seconds = _medians(
        {
            "pass": lambda: nearest(blocks, build_grid(centroids), threads=1),
            "sorted": lambda: nearest(point_blocks(positions), build_grid(centroids), threads=1),
            "normals": lambda: nearest(with_normals, build_grid(centroids, means), 1, metric, threads=1),
            "neighbourhood": lambda: nearest(with_normals, build_grid(centroids, means), 1, metric, "neighbourhood", 1),
            "tree": lambda: cKDTree(centroids).query(in_order, workers=1),
        },
        repeats,
    )
    wall = _medians({t: lambda t=t: nearest(blocks, build_grid(centroids), threads=t) for t in (1, threads)}, repeats, time.perf_counter)
    ids, _ = nearest(blocks, build_grid(centroids), threads=1)
    checked = slice(0, min(n, _CHECKED))
    wrong = float(np.mean(ids[0, checked] != _brute_force(in_order[checked], centroids)))
    tree = seconds["tree"]
    return [
        _row("assignment pass against cKDTree", n, seconds["pass"], tree),
        _row("assignment pass, sorting of the points included, against cKDTree", n, seconds["sorted"], tree),
        _row("assignment pass with normals against cKDTree without", n, seconds["normals"], tree),
        _row("assignment pass with normals, 27-cell neighbourhood, against cKDTree without", n, seconds["neighbourhood"], tree),
        {"suite": "clustering", "case": "assignment pass: share of points that differ from brute force", "value": wrong, "unit": "1"},
        _row(f"assignment pass: {threads} threads against 1", n, wall[threads], wall[1], "Mpoints/s"),
    ]


def _fuzzy_rows(positions: np.ndarray, normals: np.ndarray, k: int, repeats: int) -> list[dict]:
    n = len(positions)
    blocks = point_blocks(positions, normals)
    start = kmeans(blocks, None, k, iterations=2, extra=0)
    centres, means = positions[start.representatives], normals[start.representatives]
    in_order = np.ascontiguousarray(blocks.positions[:, :n].T)
    seconds = _medians(
        {
            "positions": lambda: fuzzy_assign(blocks, None, centres, means, FUZZINESS, normal_threshold=None, threads=1),
            "normals": lambda: fuzzy_assign(blocks, None, centres, means, FUZZINESS, threads=1),
            "plane": lambda: nearest_plane_aware(blocks, None, centres, means, threads=1),
            "tree": lambda: cKDTree(centres).query(in_order, FUZZINESS, workers=1),
        },
        repeats,
    )
    return [
        _row(f"fuzzy assignment, F = {FUZZINESS}, against cKDTree", n, seconds["positions"], seconds["tree"]),
        _row(f"fuzzy assignment, F = {FUZZINESS}, with normals, against cKDTree without", n, seconds["normals"], seconds["tree"]),
        _row("plane-aware neighbours, F = 4", n, seconds["plane"]),
    ]


def _iteration_rows(positions: np.ndarray, normals: np.ndarray, k: int, repeats: int) -> list[dict]:
    """Iterations by difference: what a run of more of them takes beyond a run of one."""
    blocks, with_normals = point_blocks(positions), point_blocks(positions, normals)
    initial = blocks.order[np.linspace(0, len(blocks) - 1, k).astype(int)]

    def ours(points, iterations):
        return lambda: kmeans(points, None, k, iterations=iterations, initial=initial, threads=1, extra=0)

    runs = {("ours", i): ours(blocks, i) for i in (1, ITERATIONS)} | {("normals", i): ours(with_normals, i) for i in (1, ITERATIONS)}
    peer = _scikit_learn()
    if peer is not None:
        cluster, one_thread = peer

        def theirs(iterations):
            return lambda: cluster.KMeans(
                k, init=positions[initial], n_init=1, max_iter=iterations, tol=0, algorithm="lloyd", copy_x=False
            ).fit(positions)

        runs |= {("theirs", i): theirs(i) for i in (1, ITERATIONS)}
    else:
        one_thread = nullcontext
    with one_thread():
        seconds = _medians(runs, repeats, time.process_time)
    each = {who: (seconds[who, ITERATIONS] - seconds[who, 1]) / (ITERATIONS - 1) for who, i in runs if i == 1}
    n = len(positions)
    return [
        _row("k-means iteration against scikit-learn's KMeans", n, each["ours"], each.get("theirs")),
        _row("k-means iteration with normals against scikit-learn's KMeans without", n, each["normals"], each.get("theirs")),
    ]


def _scikit_learn():
    """(sklearn.cluster, a context manager that keeps it to one thread), or None where it is not installed."""
    try:
        cluster, limits = importlib.import_module("sklearn.cluster"), importlib.import_module("threadpoolctl")
    except ImportError:
        return None
    return cluster, lambda: limits.threadpool_limits(1)


def _brute_force(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    d = [points[:, None, axis] - centres[None, :, axis] for axis in range(3)]
    return np.argmin(d[0] * d[0] + d[1] * d[1] + d[2] * d[2], axis=1)


def _medians(contestants: dict, repeats: int, clock: Callable[[], float] = time.thread_time) -> dict:
    """Median seconds of each contestant, taking turns, after one round that compiles."""
    seconds: dict = {name: [] for name in contestants}
    for turn in range(repeats + 1):
        for name, work in contestants.items():
            begin = clock()
            work()
            if turn:
                seconds[name].append(clock() - begin)
    return {name: statistics.median(values) for name, values in seconds.items()}


def _row(case: str, points: int, seconds: float, peer: float | None = None, unit: str = "Mpoints/s/core") -> dict:
    row = {"suite": "clustering", "case": case, "value": points / seconds / 1e6, "unit": unit}
    return row if peer is None else row | {"peer_value": points / peer / 1e6, "ratio": peer / seconds}
