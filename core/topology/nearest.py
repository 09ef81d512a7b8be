"""Which skeleton node every empty voxel belongs to, by the way through the empty space; and which one a surface point looks at."""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel

SOLID = -1
_STEPS = 12  # along the normal, of half a voxel each


@kernel
def _seed(place, owner, empty, label, front):
    """Label the empty voxels around each node; the number of voxels in the front."""
    nz, ny, nx = empty.shape
    count = 0
    for n in range(len(place)):
        for k in range(max(0, place[n, 2] - 1), min(nz, place[n, 2] + 1)):
            for j in range(max(0, place[n, 1] - 1), min(ny, place[n, 1] + 1)):
                for i in range(max(0, place[n, 0] - 1), min(nx, place[n, 0] + 1)):
                    if empty[k, j, i] and label[k, j, i] < 0:
                        label[k, j, i] = owner[n]
                        front[count] = (k * ny + j) * nx + i
                        count += 1
    return count


@kernel
def _expand(empty, label, front, count, diagonal, fresh, at):
    """Label what the front's voxels touch, by faces alone or by edges and corners, too; voxels in `fresh` from `at` on, then."""
    nz, ny, nx = empty.shape
    for f in range(count):
        code = np.int64(front[f])
        z, y, x = code // (ny * nx), code // nx % ny, code % nx
        for k in range(max(0, z - 1), min(nz, z + 2)):
            for j in range(max(0, y - 1), min(ny, y + 2)):
                for i in range(max(0, x - 1), min(nx, x + 2)):
                    if not diagonal and abs(k - z) + abs(j - y) + abs(i - x) > 1:
                        continue
                    if empty[k, j, i] and label[k, j, i] < 0:
                        label[k, j, i] = label[z, y, x]
                        fresh[at] = (k * ny + j) * nx + i
                        at += 1
    return at


@kernel
def _flood(empty, label, front, count, fresh):
    """Breadth-first search by faces and by all neighbours in turn: an octagon's distance, near to Euclid's."""
    while count > 0:
        fresh[:count] = front[:count]
        both = _expand(empty, label, front, count, False, fresh, count)
        count = _expand(empty, label, fresh, both, True, front, 0)
        # Those reached by faces alone in this round have looked at all their neighbours by now.


def nodes_of_voxels(empty: np.ndarray, place: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """(Z, Y, X) int32: the label of the node that is nearest to each empty voxel, by the way through empty voxels; SOLID in others.

    empty: (Z, Y, X) bool.  place: (N, 3) int32 lattice corners.  owner: (N,) int32, labels.
    """
    label = np.full(empty.shape, SOLID, np.int32)
    front, fresh = np.empty(empty.size, np.int32), np.empty(empty.size, np.int32)
    count = _seed(place, np.ascontiguousarray(owner, np.int32), empty, label, front)
    _flood(empty, label, front, count, fresh)
    return label


@inlined
def empty_voxel(label, x, y, z, nx, ny, nz):
    """The voxel (i, j, k) that a surface point looks at, found along its normal: surfaces lie in solid voxels; (-1, -1, -1) where there is none.

    Where a few voxels' walk meets none, the nearest in the voxels around that lie on the normal's side is taken.
    x, y, z: of the point, in voxels.  nx, ny, nz: the normal.
    """
    depth, height, width = label.shape
    for step in range(1, _STEPS + 1):
        t = 0.5 * step
        i, j, k = np.int64(np.floor(x + t * nx)), np.int64(np.floor(y + t * ny)), np.int64(np.floor(z + t * nz))
        if 0 <= i < width and 0 <= j < height and 0 <= k < depth and label[k, j, i] >= 0:
            return i, j, k
    i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
    best = np.inf
    found = np.int64(-1), np.int64(-1), np.int64(-1)
    for c in range(max(0, k - 3), min(depth, k + 4)):
        for b in range(max(0, j - 3), min(height, j + 4)):
            for a in range(max(0, i - 3), min(width, i + 4)):
                dx, dy, dz = a + 0.5 - x, b + 0.5 - y, c + 0.5 - z
                if label[c, b, a] < 0 or dx * nx + dy * ny + dz * nz <= 0:
                    continue
                d2 = dx * dx + dy * dy + dz * dz
                if d2 < best:
                    best, found = d2, (a, b, c)
    return found


@kernel
def look_up(label, low, scale, points, normals, out):
    """The label of the voxel that each point looks at; SOLID if it looks at none.

    points, normals: (N, 3) (m).  low, scale: corner (m) and voxels per metre.  out: (N,) int32.
    """
    for p in range(len(points)):
        x, y, z = (points[p, 0] - low[0]) * scale, (points[p, 1] - low[1]) * scale, (points[p, 2] - low[2]) * scale
        i, j, k = empty_voxel(label, x, y, z, normals[p, 0], normals[p, 1], normals[p, 2])
        out[p] = label[k, j, i] if i >= 0 else SOLID


@kernel
def voxels_at(label, low, scale, points, normals, out):
    """The voxel (x, y, z) that each point looks at, into `out` (N, 3) int32; -1 if it looks at none.  The rest as in `look_up`."""
    for p in range(len(points)):
        x, y, z = (points[p, 0] - low[0]) * scale, (points[p, 1] - low[1]) * scale, (points[p, 2] - low[2]) * scale
        out[p, 0], out[p, 1], out[p, 2] = empty_voxel(label, x, y, z, normals[p, 0], normals[p, 1], normals[p, 2])
