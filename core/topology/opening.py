"""Closed surfaces opened: what floats in the empty space leaves a shell round itself, which no collapse can take away."""

from __future__ import annotations

import numpy as np
import scipy

from ..jit import kernel
from .cells import FACES, X, Y, Z
from .thinning import OPENED, Thinning

_NORMAL = {Y | Z: 0, X | Z: 1, X | Y: 2}  # the axis along which a face does not extend


@kernel
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _united(parent, found, label):
    """The lower root of two labels, to which the other one now points; `found` may be -1."""
    other = _root(parent, label)
    if found < 0:
        return other
    parent[max(found, other)] = min(found, other)
    return min(found, other)


@kernel
def _regions(yz, xz, xy, label, parent):
    """Label the voxels that no face keeps apart, and what lies around them; the labels' number.

    yz, xz, xy: (nz + 1, ny + 1, nx + 1) bool, the faces.  label: (nz + 2, ny + 2, nx + 2) int32, voxel v at place v + 1.
    parent: (L,) int32, room for labels (Hoshen & Kopelman 1976).
    """
    depth, height, width = label.shape
    count = 0
    for k in range(depth):
        for j in range(height):
            for i in range(width):
                found = -1
                x, y, z = 1 <= i < width - 1, 1 <= j < height - 1, 1 <= k < depth - 1
                # The face between a voxel and the one before it has the voxel's own place; outside the volume there are none.
                if i > 0 and not (y and z and yz[k - 1, j - 1, i - 1]):
                    found = _united(parent, found, label[k, j, i - 1])
                if j > 0 and not (x and z and xz[k - 1, j - 1, i - 1]):
                    found = _united(parent, found, label[k, j - 1, i])
                if k > 0 and not (x and y and xy[k - 1, j - 1, i - 1]):
                    found = _united(parent, found, label[k - 1, j, i])
                if found < 0:
                    found = parent[count] = count
                    count += 1
                label[k, j, i] = found
    return count


def _separating(faces: dict[int, np.ndarray], distance: np.ndarray) -> np.ndarray:
    """(K, 4) int64 faces (type, z, y, x) whose removal joins all regions, the widest way: a spanning tree of the regions."""
    nz, ny, nx = distance.shape
    label = np.empty((nz + 2, ny + 2, nx + 2), np.int32)
    parent = np.empty(sum(int(f.sum()) for f in faces.values()) * 2 + 2, np.int32)
    count = _regions(faces[Y | Z], faces[X | Z], faces[X | Y], label, parent)
    root = np.arange(count)
    while (root != parent[root]).any():
        root = parent[root]
    padded = np.pad(distance, 1)
    parts = []
    for kind, present in faces.items():
        at = np.argwhere(present)
        step = np.zeros(3, np.int64)
        step[2 - _NORMAL[kind]] = 1
        here, before = tuple((at + 1).T), tuple((at + 1 - step).T)
        regions = np.sort(np.stack([root[label[here]], root[label[before]]], 1), axis=1)
        width = np.maximum(padded[here], padded[before]).astype(np.int64)
        parts.append(np.column_stack([regions, width, np.full(len(at), kind), at]))
    table = np.concatenate(parts)
    table = table[table[:, 0] != table[:, 1]]
    # Of each two regions' faces the one in the widest place.
    table = table[np.lexsort((-table[:, 2], table[:, 1], table[:, 0]))]
    first = np.ones(len(table), bool)
    first[1:] = (table[1:, :2] != table[:-1, :2]).any(axis=1)
    table = table[first]
    graph = scipy.sparse.coo_array((256 - table[:, 2], (table[:, 0], table[:, 1])), (count, count))
    tree = scipy.sparse.csgraph.minimum_spanning_tree(graph.tocsr()).tocoo()
    key = table[:, 0] * count + table[:, 1]
    return table[np.isin(key, tree.row.astype(np.int64) * count + tree.col), 3:]


def open_shells(thinning: Thinning) -> int:
    """Take faces out of a thinned complex, one for each closed surface, and thin on until only curves are left; the number of faces.

    Each one lowers the Euler characteristic by 1, as a tunnel to what floats would.
    """
    taken = 0
    while True:
        faces = {kind: thinning.complex.of_type(kind) for kind in FACES}
        if not any(present.any() for present in faces.values()):
            return taken
        chosen = _separating(faces, thinning.distance)
        if not len(chosen):  # nothing is enclosed, and yet nothing is free (Bing's house): any face will do
            kind = next(kind for kind, present in faces.items() if present.any())
            chosen = np.array([[kind, *np.argwhere(faces[kind])[0]]])
        for kind, z, y, x in chosen:
            thinning.complex.cells[kind, z + 1, y + 1, (x + 1) // 64] &= ~(np.uint64(1) << np.uint64((x + 1) % 64))
        taken += len(chosen)
        thinning.collapse(OPENED)
