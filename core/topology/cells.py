"""The empty space as a cubical complex: points, edges, faces and cubes, 64 to a word.

A cell type is a set of axes, as bits X, Y, Z: the axes along which the cell extends.  Its place is that of its lowest corner on the
lattice of voxel corners.  One lattice place more on every side stays empty, so that a cell's neighbours are found by
arithmetic on word indices alone, without a test for the border.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .bits import WORD, pack, popcount, unpack

X, Y, Z = 1, 2, 4
POINT, CUBE = 0, X | Y | Z
FACES = (X | Y, X | Z, Y | Z)
EDGES = (X, Y, Z)


class Complex(NamedTuple):
    """Cells of a volume of (nz, ny, nx) voxels.

    cells: (8, nz + 3, ny + 3, W) uint64 by cell type: lattice place (x, y, z) is bit x + 1 of slice z + 1 and row y + 1.
    shape: (nz, ny, nx).
    """

    cells: np.ndarray
    shape: tuple[int, int, int]

    def copy(self) -> Complex:
        """The same cells once more."""
        return Complex(self.cells.copy(), self.shape)

    def of_type(self, kind: int) -> np.ndarray:
        """(nz + 1, ny + 1, nx + 1) bool: which cells of one type are there."""
        nz, ny, nx = self.shape
        return unpack(self.cells[kind, 1 : nz + 2, 1 : ny + 2], nx + 2)[:, :, 1:]

    def euler_characteristic(self) -> int:
        """Points - edges + faces - cubes."""
        return sum((-1) ** int(kind).bit_count() * popcount(self.cells[kind]) for kind in range(8))


def closure(empty: np.ndarray) -> Complex:
    """The cubes of the empty voxels (Z, Y, X) bool, with all of their faces, edges and points."""
    nz, ny, nx = empty.shape
    words = -(-(nx + 3) // WORD)
    cells = np.zeros((8, nz + 3, ny + 3, words), np.uint64)
    cubes = np.zeros((nz, ny, nx + 1), bool)
    cubes[:, :, 1:] = empty
    cells[CUBE, 1 : nz + 1, 1 : ny + 1] = pack(cubes, words)
    for kind in (Y | Z, X | Z, X | Y):
        _add_facets(cells, CUBE, CUBE ^ kind, kind)
    for kind, axis in ((X, Y), (Y, X), (Z, X)):
        _add_facets(cells, kind | axis, axis, kind)
    _add_facets(cells, X, X, POINT)
    return Complex(cells, (nz, ny, nx))


def _add_facets(cells: np.ndarray, kind: int, axis: int, facet: int) -> None:
    """Both facets along an axis of all cells of a type.

    One chain of types reaches every cell: an edge of a cube is a facet of the two of its faces that lie on one side and the other.
    """
    of, to = cells[kind], cells[facet]
    to |= of
    if axis == X:
        to |= of << np.uint64(1)
        to[:, :, 1:] |= of[:, :, :-1] >> np.uint64(WORD - 1)
    elif axis == Y:
        to[:, 1:] |= of[:, :-1]
    else:
        to[1:] |= of[:-1]
