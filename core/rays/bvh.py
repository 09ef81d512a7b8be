"""The fallback where there is no Embree: two binary BVHs in Numba (see bvh_build and bvh_traversal)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from . import bvh_build as bb
from .bvh_traversal import intersect1, intersect_packet, occluded1, occluded_packet
from .partition import Partition
from .trace import register_backend


class BvhTables(NamedTuple):
    """What kernels need to trace.

    roots: (2,) int32, root node of the opaque and the cutout set (-1: empty).
    nodes: (N, 16) float32;  words: the same as int32 (see bvh_build).
    corners: (P, 9) float32, corners 0, 1, 2 of the triangles in the order of the leaves.
    visibility: (P,) int32.  triangle: (P,) int32, the caller's indices.
    """

    roots: np.ndarray
    nodes: np.ndarray
    words: np.ndarray
    corners: np.ndarray
    visibility: np.ndarray
    triangle: np.ndarray


class BvhBackend:
    """Two trees (opaque, cutout) over the valid triangles of a partition."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, partition: Partition):
        n = len(partition.triangle)
        corners = vertices[triangles[partition.triangle]]
        low, high = corners.min(axis=1), corners.max(axis=1)
        visibility = np.zeros(n, np.int32)
        order = np.arange(n, dtype=np.int32)
        nodes = np.zeros((max(2, n), bb.NODE_WORDS), np.float32)
        words = nodes.view(np.int32)
        roots = np.full(2, -1, np.int32)
        used = 0
        for s, groups in enumerate((partition.opaque, partition.cutout)):
            for group in groups:
                visibility[group.begin : group.end] = group.visibility
            if groups:
                begin, end = groups[0].begin, groups[-1].end
                roots[s] = used
                used += bb.build(low, high, order[begin:end], begin, used, nodes[used:], words[used:])
        nodes = nodes[:used].copy()
        self.tables = BvhTables(
            roots,
            nodes,
            nodes.view(np.int32),
            corners[order].reshape(n, 9),
            visibility[order],
            partition.triangle[order],
        )

    def close(self) -> None:
        """Drop the arrays."""
        self.tables = None


register_backend(BvhTables, occluded_packet, intersect_packet, occluded1, intersect1)
