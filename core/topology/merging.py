"""Visibility clusters joined where what lies in two of them sees each other: quasi-convex by looking, not by radii alone.

The paper's clusters (core/topology/clusters.py) break a room into its middle and a fringe of small parts along walls and in corners, where
balls shrink, and disks between these let little through.  Neighbours are joined here, the best first, as long as lines between
surfaces of both that face each other meet no solid voxel.
"""

from __future__ import annotations

import heapq

import numpy as np

from .lines import SAMPLES, Samples, free_shares, samples_of

SHARE = 0.65  # of the lines between two clusters that must be free


def _neighbours(label: np.ndarray) -> np.ndarray:
    """(P, 2) int64 pairs of labels (Z, Y, X) that share a voxel's face, lower first."""
    found = []
    for axis in range(3):
        low, high = np.moveaxis(label, axis, 0)[:-1], np.moveaxis(label, axis, 0)[1:]
        at = (low != high) & (low >= 0) & (high >= 0)
        found.append(np.stack([np.minimum(low[at], high[at]), np.maximum(low[at], high[at])], 1))
    return np.unique(np.concatenate(found), axis=0).astype(np.int64)


def _pour(samples: Samples, a: int, b: int, random: np.random.Generator) -> None:
    """Let the samples of part a stand for b, too: each comes from one of them, by its size."""
    voxels, sizes = samples
    na, nb = min(sizes[a], SAMPLES), min(sizes[b], SAMPLES)
    both = sizes[a] + sizes[b]
    if both <= SAMPLES:
        voxels[a, na:both] = voxels[b, :nb]
    else:
        from_b = random.random(SAMPLES) * both < sizes[b]
        kept, taken = voxels[a, random.integers(0, na, SAMPLES)], voxels[b, random.integers(0, nb, SAMPLES)]
        voxels[a] = np.where(from_b[:, None], taken, kept)
    sizes[a] = both


def merged(label: np.ndarray, count: int, share: float = SHARE) -> np.ndarray:
    """(count,) int32: the joined cluster of each of `count` clusters, numbered from the one with most surface on.

    label: (Z, Y, X) int32, the cluster of each voxel, negative in solid ones.  share: of free lines, above which two neighbours are joined.
    """
    samples = samples_of(label, count)
    sizes = samples.sizes
    pairs = _neighbours(label)
    around: list[set[int]] = [set() for _ in range(count)]
    for a, b in pairs.tolist():
        around[a].add(b)
        around[b].add(a)
    heap: list[tuple[float, int, int, int, int]] = []
    version, parent = [0] * count, np.arange(count)

    def look(pairs: np.ndarray) -> None:
        for value, (a, b) in zip(free_shares(label, samples, pairs).tolist(), pairs.tolist()):
            if value >= share:
                heapq.heappush(heap, (-value, a, b, version[a], version[b]))

    look(pairs)
    random = np.random.default_rng(0)
    while heap:
        _, a, b, version_a, version_b = heapq.heappop(heap)
        if version[a] != version_a or version[b] != version_b:
            continue
        _pour(samples, a, b, random)
        parent[b] = a
        version[a] += 1
        version[b] = -1
        around[a] = (around[a] | around[b]) - {a, b}
        for c in around[b] - {a}:
            around[c].discard(b)
            around[c].add(a)
        if around[a]:
            look(np.array([(min(a, c), max(a, c)) for c in sorted(around[a])]))
    while (parent != parent[parent]).any():
        parent = parent[parent]
    kept = np.unique(parent)
    rank = np.empty(count, np.int32)
    rank[kept[np.argsort(-sizes[kept], kind="stable")]] = np.arange(len(kept))
    return rank[parent]
