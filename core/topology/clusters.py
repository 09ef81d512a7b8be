"""Visibility clusters: nodes whose balls make up a quasi-convex part of the empty space (paper, Section IV.B.2)."""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from .segmentation import CURVATURE, Segmented
from .skeleton import Skeleton, neighbours

ALPHA = 0.2  # how much the radii of neighbours may differ, over the cluster's largest


_STEP, _SLACK = 0.25, 0.2  # voxels: between places on a line of sight, and how near to empty space they may be solid


@kernel
def _in_sight(empty, place, a, b):
    """Whether the straight line between two nodes stays in the empty space."""
    nz, ny, nx = empty.shape
    dx, dy, dz = place[b, 0] - place[a, 0], place[b, 1] - place[a, 1], place[b, 2] - place[a, 2]
    steps = np.int64(np.ceil(np.sqrt(dx * dx + dy * dy + dz * dz) / _STEP)) + 1
    for s in range(1, steps):
        t = s / steps
        x, y, z = place[a, 0] + t * dx, place[a, 1] + t * dy, place[a, 2] + t * dz
        some = False
        for corner in range(8):
            i = np.int64(np.floor(x + (_SLACK if corner & 1 else -_SLACK)))
            j = np.int64(np.floor(y + (_SLACK if corner & 2 else -_SLACK)))
            k = np.int64(np.floor(z + (_SLACK if corner & 4 else -_SLACK)))
            some |= 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and empty[k, j, i]
        if not some:
            return False
    return True


@kernel
def _grow(order, place, radius, curved, first, to, alpha, empty, cluster):
    """Give every node its cluster; their number."""
    n = len(order)
    stack, ball = np.empty(n, np.int64), np.empty(n, np.int64)
    visited = np.full(n, -1)
    count = 0
    for start in order:
        if cluster[start] >= 0:
            continue
        largest = radius[start]
        cluster[start] = count
        stack[0] = start
        depth = 1
        while depth > 0:
            depth -= 1
            m = stack[depth]
            for a in range(first[m], first[m + 1]):
                k = to[a]
                if cluster[k] < 0 and not curved[k] and abs(radius[k] - largest) <= alpha * largest and _in_sight(empty, place, start, k):
                    cluster[k] = count
                    stack[depth] = k
                    depth += 1
            # What the ball of m holds and can be reached within it.
            ball[0] = m
            visited[m] = m
            waiting, read = 1, 0
            while read < waiting:
                here = ball[read]
                read += 1
                for a in range(first[here], first[here + 1]):
                    k = to[a]
                    if visited[k] == m or (cluster[k] >= 0 and cluster[k] != count):
                        continue
                    d2 = 0.0
                    for c in range(3):
                        d2 += (place[k, c] - place[m, c]) ** 2
                    if d2 > radius[m] * radius[m] or not _in_sight(empty, place, start, k):
                        continue
                    visited[k] = m
                    ball[waiting] = k
                    waiting += 1
                    if cluster[k] < 0:
                        cluster[k] = count
                        stack[depth] = k
                        depth += 1
        count += 1
    return count


def visibility_clusters(skeleton: Skeleton, segmented: Segmented, empty: np.ndarray, alpha: float = ALPHA) -> np.ndarray:
    """(K,) int32, the cluster of each segmented node, numbered from the largest ball on: greedy, connected parts.

    Stricter than the paper: all nodes of a cluster are in sight of its first one.  Equal radii alone lead a cluster round the corners of a
    gallery.  empty: (Z, Y, X) bool.
    """
    place = skeleton.place[segmented.node].astype(np.float64)
    radius = skeleton.radius[segmented.node]
    cluster = np.full(len(radius), -1, np.int32)
    order = np.argsort(-radius, kind="stable")
    first, to = neighbours(len(radius), segmented.edges)
    _grow(order, place, radius, segmented.kind == CURVATURE, first, to, alpha, empty, cluster)
    return cluster
