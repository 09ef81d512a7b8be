"""Fuzzy assignment: every point belongs to several clusters, with weights that add up to one.

Fuzzy clustering paper, Section 3.2.2, Eqs. 8-10 and Algorithm 2; and the plane-aware neighbours of the accurate
method, which takes a point's distance from its neighbour's tangent plane (and back) four times as seriously.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..threads import run_chunks
from .blocks import PointBlocks, as_blocks, as_vectors
from .grid import ANY_NORMAL, BY_POSITION, Metric, build_grid, nearest
from .kmeans import NORMAL_THRESHOLD

WEIGHTINGS = ("distance", "plain", "smooth")
PLANE_THRESHOLD = 0.5**0.5  # cosine of 45 degrees
PLANE_FACTOR = 4.0

_CHUNK = 16384
_SMALLEST_DISTANCE = 1e-4  # of the farthest of the F: nearer clusters weigh alike, and a point on a centre has finite weights


class FuzzyAssignment(NamedTuple):
    """The F clusters of each of M points, nearest first.

    indices: (M, F) int32, always valid indices: where a point has fewer than F clusters, its nearest one
        is repeated with weight 0 (and infinite distance).
    weights: (M, F) float32, add up to 1; all 0 for a point whose coordinates are not finite.
    distances: (M, F) float32, in the metric of the search (m).
    """

    indices: np.ndarray
    weights: np.ndarray
    distances: np.ndarray


def fuzzy_assign(
    positions: np.ndarray | PointBlocks,
    normals: np.ndarray | None,
    centres: np.ndarray,
    centre_normals: np.ndarray | None,
    fuzziness: int = 6,
    *,
    weighting: str = "distance",
    normal_threshold: float | None = NORMAL_THRESHOLD,
    search: str = "shells",
    threads: int = 0,
) -> FuzzyAssignment:
    """The `fuzziness` nearest centres of each point: 1 is hard clustering.

    positions: (M, 3) (m), or PointBlocks made of positions and normals;  normals: (M, 3) unit vectors or None.
    centres, centre_normals: (K, 3) each, centroids or representatives of clusters.
    weighting: `distance` is 1/d (Eqs. 9, 10);  `plain` is 1/F (Eq. 8);  `smooth` is 1/d - 1/d', d' being the distance
        of the next centre after the F: it falls to 0 where a centre leaves the list, so that no border is left.
    normal_threshold: centres whose normal's cosine is not larger do not count. A point that no centre takes
        has the nearest one, whatever its normal.

    Raises:
        ValueError: fuzziness < 1, unknown weighting or search, no centres, wrong shapes.
    """
    if fuzziness < 1:
        raise ValueError(f"fuzziness: expected at least 1, got {fuzziness}")
    if weighting not in WEIGHTINGS:
        raise ValueError(f"weighting: expected one of {', '.join(WEIGHTINGS)}, got {weighting!r}")
    blocks = as_blocks(positions, normals)
    metric = Metric(ANY_NORMAL if normal_threshold is None else float(normal_threshold))
    return _assign(blocks, centres, centre_normals, fuzziness, metric, weighting, search, threads)


def nearest_plane_aware(
    points: np.ndarray | PointBlocks,
    normals: np.ndarray | None,
    representatives: np.ndarray,
    representative_normals: np.ndarray,
    F: int = 4,
    d0: float | None = None,
    *,
    threads: int = 0,
) -> FuzzyAssignment:
    """The F nearest representatives by m^2 = d^2 + (4 h)^2 + 2 d0^2 (1 - cos), weights proportional to 1/m.

    points, normals: as in `fuzzy_assign`;  representatives, representative_normals: (K, 3).
    h: the larger of the distances of the point to the representative's plane and back.  Only representatives with
        cos > cos 45 degrees count; a point that has none gets the nearest one, whatever its normal.
    d0: metres, the representatives' median spacing by default.

    Raises:
        ValueError: F < 1, no representatives.
    """
    if F < 1:
        raise ValueError(f"F: expected at least 1, got {F}")
    blocks = as_blocks(points, normals)
    d0 = median_spacing(representatives, threads=threads) if d0 is None else d0
    metric = Metric(PLANE_THRESHOLD, 2 * d0**2, PLANE_FACTOR**2)
    return _assign(blocks, representatives, representative_normals, F, metric, "distance", "shells", threads)


def median_spacing(positions: np.ndarray, *, threads: int = 0) -> float:
    """The median distance of (N, 3) points to their nearest neighbour (m); 0 for fewer than two."""
    positions = as_vectors(positions, "positions")
    blocks = as_blocks(positions, None)
    if len(blocks) < 2:
        return 0.0
    _, squared = nearest(blocks, build_grid(positions[blocks.order]), 2, threads=threads)
    return float(np.median(np.sqrt(squared[1, : len(blocks)])))


def _assign(blocks, centres, centre_normals, count, metric, weighting, search, threads) -> FuzzyAssignment:
    wanted = count + 1 if weighting == "smooth" else count
    grid = build_grid(centres, centre_normals, split=metric.threshold > -1)
    ids, squared = nearest(blocks, grid, wanted, metric, search, threads)
    alone = np.flatnonzero(ids[0, : len(blocks)] < 0)
    if len(alone):
        anywhere = build_grid(centres, centre_normals, split=False)
        found, found_squared = nearest(blocks.take(alone), anywhere, 1, BY_POSITION, search, threads)
        ids[0, alone], squared[0, alone] = found[0, : len(alone)], found_squared[0, : len(alone)]
    shape = (blocks.given, count)
    result = FuzzyAssignment(np.zeros(shape, np.int32), np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32))

    def work(begin, end):
        _weigh(WEIGHTINGS.index(weighting), blocks.order, ids, squared, begin, end, *result)

    run_chunks(work, len(blocks), _CHUNK, threads)
    return result


@kernel(fast=False)
def _weigh(weighting, order, ids, squared, begin, end, indices, weights, distances):
    """Weights of the sorted points [begin, end), written in the given order."""
    count = indices.shape[1]
    for i in range(begin, end):
        found = 0
        while found < count and ids[found, i] >= 0:
            found += 1
        m = order[i]
        last = np.sqrt(squared[found - 1, i])
        smallest = max(last * np.float32(_SMALLEST_DISTANCE), np.float32(1e-30))
        beyond = np.float32(0)  # 1 / distance of the next centre
        if weighting == 2 and found == count and ids[count, i] >= 0:
            # Kept above the farthest of the F, so that equal distances leave it some weight.
            beyond = np.float32(1) / max(np.sqrt(squared[count, i]), last * np.float32(1 + 1e-4), smallest * np.float32(1 + 1e-4))
        total = np.float32(0)
        for f in range(found):
            distance = np.sqrt(squared[f, i])
            w = np.float32(1) if weighting == 1 else np.float32(1) / max(distance, smallest) - beyond
            indices[m, f], weights[m, f], distances[m, f] = ids[f, i], w, distance
            total += w
        for f in range(found):
            weights[m, f] /= total
        for f in range(found, count):
            indices[m, f] = ids[0, i]
