"""Shares of visibility clusters around a point, by which light is blended across their borders.

Visibility gates paper, Section VII: "attenuate these artifacts using filtering strategies".  What is filtered is the map of the clusters, over a
disk on the surface, so that light keeps its own edges; only what a straight line through the empty space reaches counts: no wall is crossed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from .bits import pack
from .lines import free_line
from .nearest import SOLID, empty_voxel

MOST = 4  # clusters of a point
_PLACES = 24  # of the disk
_SPREAD = np.sqrt((np.arange(_PLACES) + 0.5) / _PLACES).astype(np.float32)
_ANGLE = (np.arange(_PLACES) * np.pi * (3 - np.sqrt(5))).astype(np.float32)
# Vogel's spiral: even over the disk (Vogel 1979); those near its middle count more, so that a blend has no edge of its own.
_DISK = np.stack([_SPREAD * np.cos(_ANGLE), _SPREAD * np.sin(_ANGLE), 1 - _SPREAD], axis=1).astype(np.float32)


class Shares(NamedTuple):
    """E shares of N points in visibility clusters, point by point.

    item: (E,) int64, the point.  cluster: (E,) int32, SOLID where none is known.  share: (E,) float32; those of a point add up to 1.
    """

    item: np.ndarray
    cluster: np.ndarray
    share: np.ndarray


def whole(cluster: np.ndarray) -> Shares:
    """Each point in its own cluster (N,) alone."""
    return Shares(np.arange(len(cluster)), cluster, np.ones(len(cluster), np.float32))


@kernel
def _look_around(node_of, empty, cluster_of, low, scale, points, normals, radius, disk, found, share):
    """Clusters (N, MOST) int32 of the places of `disk` around each point and their shares (N, MOST) float32.

    empty: bits of the voxels that have a node.  points, normals: (N, 3) (m).  low, scale: corner of the grid (m) and voxels per metre.  radius: of the disk, in voxels.
    """
    nz, ny, nx = node_of.shape
    for p in range(len(points)):
        found[p] = SOLID
        share[p] = np.float32(0.0)
        x, y, z = (points[p, 0] - low[0]) * scale, (points[p, 1] - low[1]) * scale, (points[p, 2] - low[2]) * scale
        n0, n1, n2 = np.float64(normals[p, 0]), np.float64(normals[p, 1]), np.float64(normals[p, 2])
        i, j, k = empty_voxel(node_of, x, y, z, n0, n1, n2)
        if i < 0:
            share[p, 0] = np.float32(1.0)
            continue
        found[p, 0] = cluster_of[node_of[k, j, i]]
        # Two directions in the surface (Duff et al. 2017, "Building an Orthonormal Basis, Revisited").
        sign = 1.0 if n2 >= 0 else -1.0
        a = -1.0 / (sign + n2)
        b = n0 * n1 * a
        total = np.float32(0.0)
        for q in range(len(disk)):
            u, v = disk[q, 0] * radius, disk[q, 1] * radius
            fx = i + 0.5 + u * (1.0 + sign * n0 * n0 * a) + v * b
            fy = j + 0.5 + u * sign * b + v * (sign + n1 * n1 * a)
            fz = k + 0.5 - u * sign * n0 - v * n1
            ci, cj, ck = np.int64(np.floor(fx)), np.int64(np.floor(fy)), np.int64(np.floor(fz))
            if not (0 <= ci < nx and 0 <= cj < ny and 0 <= ck < nz) or node_of[ck, cj, ci] < 0:
                continue
            if not free_line(empty, i, j, k, ci, cj, ck):
                continue
            c = cluster_of[node_of[ck, cj, ci]]
            for place in range(MOST):
                if found[p, place] == c or found[p, place] == SOLID:
                    found[p, place] = c
                    share[p, place] += disk[q, 2]
                    total += disk[q, 2]
                    break
        if total > 0:
            share[p] /= total
        else:
            share[p, 0] = np.float32(1.0)


def shares_around(node_of, cluster, low, scale, points, normals, radius) -> Shares:
    """The shares of the clusters within `radius` voxels of surface points (N, 3), on the side of their normals (N, 3).

    node_of: (Z, Y, X) int32, cluster: (K,) int32, as of `Topology`; low, scale: the grid's corner (m) and voxels per metre.
    """
    found, share = np.empty((len(points), MOST), np.int32), np.empty((len(points), MOST), np.float32)
    _look_around(node_of, pack(node_of >= 0), cluster, low, scale, points, normals, float(radius), _DISK, found, share)
    item, place = np.nonzero(share > 0)
    return Shares(item, found[item, place], share[item, place])
