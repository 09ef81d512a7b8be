"""Which voxels the surfaces touch: conservative voxelisation by exact triangle-box overlap.

Separating axes (Akenine-Moller 2001, "Fast 3D Triangle-Box Overlap Testing"), in the form of Schwarz & Seidel 2010, "Fast
Parallel Surface and Solid Voxelization on GPUs", Section 3: a plane and three projections, set up once a triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import SceneError
from ..jit import kernel
from .bits import WORD, unpack

SMALLEST, LARGEST = 4, 1024  # voxels along the longest side
_MARGIN = 1e-6  # of the extent: surfaces on the border of the box lie inside it
_ROUNDING = 1e-9  # of a voxel: touching counts as overlap in spite of rounding


@dataclass(frozen=True)
class Grid:
    """Cubical voxels over a box.

    low: (3,) float64, corner of the box (m).  size: side of a voxel (m).  shape: (nx, ny, nz).
    """

    low: np.ndarray
    size: float
    shape: tuple[int, int, int]

    @staticmethod
    def around(low: np.ndarray, high: np.ndarray, resolution: int) -> Grid:
        """The grid over a box with `resolution` voxels along its longest side.

        Raises:
            SceneError: the resolution is out of bounds, or the box is empty or not finite.
        """
        if not SMALLEST <= resolution <= LARGEST:
            raise SceneError(f"{resolution} voxels: the topology needs {SMALLEST} to {LARGEST} along the longest side")
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        longest = float((high - low).max())
        if not (np.isfinite(longest) and longest > 0):
            raise SceneError("the scene has no extent: its topology needs surfaces")
        margin = _MARGIN * longest
        size = (longest + 2 * margin) / resolution
        shape = np.maximum(1, np.ceil((high - low + 2 * margin) / size - 1e-9)).astype(int)
        # The short sides' spare voxels are shared out, so that a closed box stays in the middle.
        low = (low + high) / 2 - shape * size / 2
        return Grid(low, size, tuple(int(n) for n in shape))

    def cell_of(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) int64 voxels (x, y, z) that hold points (N, 3) in metres; beyond the box they are out of range."""
        return np.floor((np.asarray(points, np.float64) - self.low) / self.size).astype(np.int64)

    def position_of(self, lattice: np.ndarray) -> np.ndarray:
        """(N, 3) float64 metres of lattice corners (N, 3), corner (0, 0, 0) being the box's."""
        return self.low + np.asarray(lattice, np.float64) * self.size


@kernel
def _edge_functions(u, v, sign, normals, offsets):
    """The three edges of a projected triangle as half-planes n . p + offset >= 0 for the low corners p of unit boxes it may touch."""
    for k in range(3):
        j = (k + 1) % 3
        nu, nv = -(v[j] - v[k]) * sign, (u[j] - u[k]) * sign
        normals[k, 0], normals[k, 1] = nu, nv
        offsets[k] = -(nu * u[k] + nv * v[k]) + max(0.0, nu) + max(0.0, nv) + _ROUNDING


@kernel
def _inside(normals, offsets, u, v):
    for k in range(3):
        if normals[k, 0] * u + normals[k, 1] * v + offsets[k] < 0:
            return False
    return True


@kernel
def _voxelise(vertices, triangles, low, scale, shape, words):
    """Set the bits of all voxels that triangles touch in `words` (Z, Y, W)."""
    corner = np.empty((3, 3))  # vertex, axis: in voxels
    normals, offsets = np.empty((3, 3, 2)), np.empty((3, 3))  # the projections along x, y, z
    normal = np.empty(3)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    cell = np.empty(3, np.int64)
    for t in range(len(triangles)):
        finite = True
        for k in range(3):
            for a in range(3):
                corner[k, a] = (np.float64(vertices[triangles[t, k], a]) - low[a]) * scale
                finite &= np.isfinite(corner[k, a])
        if not finite:
            continue
        for a in range(3):
            least = min(corner[0, a], corner[1, a], corner[2, a]) - _ROUNDING
            most = max(corner[0, a], corner[1, a], corner[2, a]) + _ROUNDING
            first[a] = max(0, np.int64(np.floor(least)))
            last[a] = min(shape[a] - 1, np.int64(np.floor(most)))
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            normal[a] = (corner[1, b] - corner[0, b]) * (corner[2, c] - corner[0, c]) - (corner[1, c] - corner[0, c]) * (
                corner[2, b] - corner[0, b]
            )
            _edge_functions(corner[:, b], corner[:, c], 1.0 if normal[a] >= 0 else -1.0, normals[a], offsets[a])
        # Columns run along the axis that the triangle faces: few of their voxels are tested in vain.
        main = 0
        for a in range(1, 3):
            if abs(normal[a]) > abs(normal[main]):
                main = a
        b, c = (main + 1) % 3, (main + 2) % 3
        plane = normal[0] * corner[0, 0] + normal[1] * corner[0, 1] + normal[2] * corner[0, 2]
        # Corners of a box between which the plane must pass, as offsets of the plane's equation.
        lower = min(0.0, normal[0]) + min(0.0, normal[1]) + min(0.0, normal[2])
        upper = max(0.0, normal[0]) + max(0.0, normal[1]) + max(0.0, normal[2])
        slack = _ROUNDING * (abs(normal[0]) + abs(normal[1]) + abs(normal[2]))
        for ib in range(first[b], last[b] + 1):
            for ic in range(first[c], last[c] + 1):
                if not _inside(normals[main], offsets[main], ib, ic):
                    continue
                begin, end = first[main], last[main]
                if normal[main] != 0.0:
                    rest = plane - normal[b] * ib - normal[c] * ic
                    one, other = (rest - upper - slack) / normal[main], (rest - lower + slack) / normal[main]
                    begin = max(begin, np.int64(np.ceil(min(one, other))))
                    end = min(end, np.int64(np.floor(max(one, other))))
                cell[b], cell[c] = ib, ic
                for i in range(begin, end + 1):
                    cell[main] = i
                    # Projection along axis b reads (c, main), that along c reads (main, b).
                    if _inside(normals[b], offsets[b], ic, i) and _inside(normals[c], offsets[c], i, ib):
                        words[cell[2], cell[1], cell[0] >> 6] |= np.uint64(1) << np.uint64(cell[0] & 63)


def voxelise(vertices: np.ndarray, triangles: np.ndarray, grid: Grid) -> np.ndarray:
    """(Z, Y, W) uint64: the voxels that share a point with a triangle, bit-packed.

    vertices: (V, 3) float32, metres.  triangles: (T, 3) int32; those with a corner that is not finite touch nothing, those of no area
    the voxels that their segment or point touches.
    """
    nx, ny, nz = grid.shape
    words = np.zeros((nz, ny, -(-nx // WORD)), np.uint64)
    vertices = np.ascontiguousarray(vertices, np.float32)
    triangles = np.ascontiguousarray(triangles, np.int32)
    _voxelise(vertices, triangles, grid.low, 1.0 / grid.size, np.array(grid.shape, np.int64), words)
    return words


def empty_voxels(solid: np.ndarray, grid: Grid) -> np.ndarray:
    """(Z, Y, X) bool: the voxels that no surface touches."""
    return ~unpack(solid, grid.shape[0])
