"""Which triangles a ray can meet: the valid ones, apart by transparency and by visibility."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import kernel

KIND_BITS, OBJECT_BITS = 30, 31


class Group(NamedTuple):
    """Triangles begin..end-1 of `Partition.triangle`, all of one visibility, that move together; object 0 does not."""

    begin: int
    end: int
    visibility: int
    object: int = 0


class Partition(NamedTuple):
    """The triangles that rays can meet, grouped.

    triangle: (P,) int32, indices into the caller's triangles, ascending within a group.
    opaque, cutout: the groups of each set, one per distinct visibility (and moving object).
    """

    triangle: np.ndarray
    opaque: list[Group]
    cutout: list[Group]


def valid_triangles(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T,) bool: finite corners and an area that is not zero."""
    valid = np.empty(len(triangles), np.bool_)
    _valid(vertices, triangles, valid)
    return valid


@kernel
def _valid(vertices, triangles, valid):
    corner = np.empty((3, 3), np.float64)
    for t in range(len(triangles)):
        finite = True
        for k in range(3):
            for c in range(3):
                corner[k, c] = vertices[triangles[t, k], c]
                finite &= np.isfinite(corner[k, c])
        area = False
        for i in range(3):
            j = (i + 1) % 3
            first, second = corner[1, i] - corner[0, i], corner[1, j] - corner[0, j]
            area |= first * (corner[2, j] - corner[0, j]) != second * (corner[2, i] - corner[0, i])
        valid[t] = finite and area


def partition(
    vertices: np.ndarray, triangles: np.ndarray, visibility: np.ndarray, transparent: np.ndarray, moving: np.ndarray | None = None
) -> Partition:
    """Group the triangles that can be hit at all (see `RayScene` for the arguments)."""
    index = np.flatnonzero(valid_triangles(vertices, triangles) & (visibility != 0)).astype(np.int32)
    key = transparent[index].astype(np.int64) << KIND_BITS | visibility[index]
    key = key << OBJECT_BITS | (0 if moving is None else moving[index])
    order = np.argsort(key, kind="stable")
    index, key = index[order], key[order]
    border = np.concatenate(([0], np.flatnonzero(np.diff(key)) + 1, [len(key)])) if len(key) else np.zeros(1, np.int64)
    sets: tuple[list[Group], list[Group]] = ([], [])
    for begin, end in zip(border[:-1].tolist(), border[1:].tolist()):
        kind, which = divmod(int(key[begin]), 1 << OBJECT_BITS)
        which_set, visible = divmod(kind, 1 << KIND_BITS)
        sets[which_set].append(Group(begin, end, visible, which))
    return Partition(np.ascontiguousarray(index), *sets)
