"""Thin sheets: pieces of surface without thickness that part no two rooms, as curtains, banners and leaves.

What hangs in a room is no wall: one can walk round it.  So a piece of surface with an open border is a sheet if, wherever there is empty space on both
sides of it, this is one and the same room.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .nearest import SOLID, look_up
from .voxels import Grid

SAMPLES = 256  # of a piece, even over its area
AGREE = 0.95  # of those with empty space on both sides, that lie in one room
_SEED = 5


def pieces_of(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T,) int64 numbers of the pieces that triangles (T, 3) of vertices (V, 3) hang together in, and (P,) bool, which of P have open borders.

    Vertices at one place are one.
    """
    _, welded = np.unique(np.ascontiguousarray(vertices[triangles.ravel()]), axis=0, return_inverse=True)
    corners = welded.reshape(-1, 3)
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    links = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(corners.max() + 1,) * 2)
    count, of_vertex = connected_components(links, directed=False)
    edges, uses = np.unique(edges[edges[:, 0] != edges[:, 1]], axis=0, return_counts=True)
    is_open = np.zeros(count, bool)
    is_open[of_vertex[edges[uses == 1, 0]]] = True
    return of_vertex[corners[:, 0]], is_open


def thin_sheets(vertices: np.ndarray, triangles: np.ndarray, empty: np.ndarray, grid: Grid) -> np.ndarray:
    """(T,) bool: the triangles (T, 3) of vertices (V, 3) that belong to thin sheets; empty: (Z, Y, X) bool voxels that no triangle touches."""
    piece, is_open = pieces_of(vertices, triangles)
    corners = vertices[triangles].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(across, axis=1)
    asked = np.flatnonzero(is_open[piece] & (twice > 0))
    asked = asked[np.argsort(piece[asked], kind="stable")]
    if not len(asked):
        return np.zeros(len(triangles), bool)
    # SAMPLES places a piece, systematic along the sum of its triangles' areas.
    pieces, begin = np.unique(piece[asked], return_index=True)
    area = np.cumsum(twice[asked])
    before = np.append(0.0, area)[begin]
    whole = np.append(before[1:], area[-1]) - before
    at = before[:, None] + (np.arange(SAMPLES) + 0.5) / SAMPLES * whole[:, None]
    chosen = asked[np.minimum(np.searchsorted(area, at.ravel()), len(asked) - 1)]
    u, v = np.random.default_rng(_SEED).random((2, len(chosen), 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    places = corners[chosen, 0] * (1 - u - v) + corners[chosen, 1] * u + corners[chosen, 2] * v
    normal = across[chosen] / twice[chosen, None]
    rooms = label(empty)[0].astype(np.int32) - 1  # SOLID in the others
    front, back = np.empty(len(chosen), np.int32), np.empty(len(chosen), np.int32)
    look_up(rooms, grid.low, 1.0 / grid.size, places, normal, front)
    look_up(rooms, grid.low, 1.0 / grid.size, places, -normal, back)
    between = ((front != SOLID) & (back != SOLID)).reshape(-1, SAMPLES)
    same = (between & (front == back).reshape(-1, SAMPLES)).sum(axis=1)
    sheet = np.zeros(len(is_open), bool)
    sheet[pieces] = (same > 0) & (same >= AGREE * between.sum(axis=1))
    return sheet[piece]
