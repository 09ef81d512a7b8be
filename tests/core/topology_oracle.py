"""Slow, readable doubles of the topology's kernels."""

import itertools

import numpy as np
from scipy import ndimage


def touches(triangle, low, high):
    """Whether a triangle (3, 3) and a box share a point: all 13 separating axes."""
    centre, half = (low + high) / 2, (high - low) / 2
    corners = np.asarray(triangle, float) - centre
    edges = np.roll(corners, -1, axis=0) - corners
    axes = [*np.eye(3), np.cross(edges[0], edges[1]), *(np.cross(e, a) for e in edges for a in np.eye(3))]
    for axis in axes:
        along, reach = corners @ axis, np.abs(axis) @ half
        if along.min() > reach + 1e-12 or along.max() < -reach - 1e-12:
            return False
    return True


def closure(empty):
    """(8, Z + 1, Y + 1, X + 1) bool: the cells of the empty voxels by type, bits 1, 2, 4 for x, y, z."""
    nz, ny, nx = empty.shape
    cells = np.zeros((8, nz + 1, ny + 1, nx + 1), bool)
    for kind in range(8):
        # A cell of fewer dimensions bounds the voxels on both sides of it.
        for dz, dy, dx in itertools.product(*(range(1 if kind & bit else 2) for bit in (4, 2, 1))):
            cells[kind, dz : dz + nz, dy : dy + ny, dx : dx + nx] |= empty
    return cells


def cells_of(complex_):
    """(8, Z, Y, X) bool: the cells of a complex by type."""
    return np.stack([complex_.of_type(kind) for kind in range(8)])


def components(cells):
    """Connected components of a complex: cells touch those one dimension up and down."""
    grid = np.zeros([2 * n for n in cells.shape[1:]], bool)
    for kind in range(8):
        grid[kind >> 2 & 1 :: 2, kind >> 1 & 1 :: 2, kind & 1 :: 2] |= cells[kind]
    return ndimage.label(grid)[1]


def euler(cells):
    """Points - edges + faces - cubes."""
    return sum((-1) ** int(kind).bit_count() * int(cells[kind].sum()) for kind in range(8))


def _at(volume, axis, step):
    """The values `step` places further along x, y or z (0, 1, 2); False beyond the border."""
    out = np.zeros_like(volume)
    to, of = [slice(None)] * 3, [slice(None)] * 3
    to[2 - axis], of[2 - axis] = (slice(None, -1), slice(1, None)) if step > 0 else (slice(1, None), slice(None, -1))
    out[tuple(to)] = volume[tuple(of)]
    return out


def _around(values, axis):
    """The largest of `values` (Z, Y, X) over the voxels around the edges along an axis."""
    padded = np.pad(values.astype(int), 1)
    shape = [n + 1 for n in values.shape]
    most = np.zeros(shape, int)
    for step in itertools.product((0, 1), repeat=3):  # z, y, x
        if step[2 - axis]:
            part = padded[tuple(slice(s, s + n) for s, n in zip(step, shape))]
            most = np.maximum(most, part)
    return most


def thin(cells, distance, opening, kept):
    """Sweep over the whole complex until nothing goes; kept(iteration, birth, O, D) -> which edges stay, arrays in and out."""
    cells = cells.copy()
    birth = {axis: np.full(cells.shape[1:], -1) for axis in range(3)}
    wide = {axis: (_around(opening, axis), _around(distance, axis)) for axis in range(3)}
    for iteration in itertools.count(1):
        removed = False
        for axis, high, kind in itertools.product(range(3), (False, True), (7, 3, 5, 6, 1, 2, 4)):
            if not kind & 1 << axis:
                continue
            facet = kind & ~(1 << axis)
            # All cells one dimension up around the facet of each cell, as they lie from the cell.
            free = cells[kind] & ~_at(cells[kind], axis, 1 if high else -1)
            for b in range(3):
                if not kind & 1 << b:
                    other = cells[facet | 1 << b]
                    around = other | _at(other, b, -1)
                    free &= ~(_at(around, axis, 1) if high else around)
            if kind == 1 << axis:
                free &= ~((birth[axis] >= 0) & kept(iteration, birth[axis], *wide[axis]))
            cells[kind] &= ~free
            cells[facet] &= ~(_at(free, axis, -1) if high else free)
            removed |= free.any()
        if not removed:
            return cells
        for axis in range(3):
            faces = np.zeros(cells.shape[1:], bool)
            for b in range(3):
                if b != axis:
                    face = cells[1 << axis | 1 << b]
                    faces |= face | _at(face, b, -1)
            birth[axis][cells[1 << axis] & ~faces & (birth[axis] < 0)] = iteration
