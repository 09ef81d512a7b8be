"""Which shining triangles bound a closed body: what they shine into it never leaves it.

Bulbs, tubes and panels are such bodies.  As all shining meshes they shine inwards as well, so half of their particles would start within
them, and half of the shadow rays to them end at their near side.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..scene import TRANSPARENT, Scene, bounds

MOST = 1 << 16  # triangles of objects that shine; of more nothing is asked
LOOKED_AT = 1 << 12  # vertices of other objects that tell whether a body holds something, at most
COMPARED = 1 << 23  # bodies times these, at most
THICK = 1e-3  # volume of a body, by that of a ball of the same surface, at least: two sheets that touch have none


def outward(scene: Scene, triangle: np.ndarray) -> np.ndarray:
    """(M,) int8 of the triangles (M,) of a scene: 1 where the geometric normal points out of a closed body, -1 where into it, 0 for others.

    A body is closed where along each edge as many triangles turn one way as the other, and none lets light through.  One that holds
    the camera, a lamp, other objects or bodies, or all there is, is a room, and counts as open.
    """
    g = scene.geometry
    members = np.flatnonzero(np.isin(g.object, np.unique(g.object[triangle])))
    if not len(members) or len(members) > MOST:
        return np.zeros(len(triangle), np.int8)
    corners, places = _welded(g.vertices[g.triangles[members]].astype(np.float64), g.object[members])
    body, n = _bodies(corners, len(places))
    closed = np.bincount(body, (scene.materials.tables.flags[g.material[members]] & TRANSPARENT) > 0, n) == 0
    closed &= ~_open(corners, body, n)
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    for corner in corners.T:
        np.minimum.at(low, body, places[corner])
        np.maximum.at(high, body, places[corner])
    a, b, c = (places[corner] - low[body] for corner in corners.T)
    cross = np.cross(b - a, c - a)
    volume = np.bincount(body, np.einsum("tc,tc->t", a, cross), n) / 6
    surface = np.bincount(body, np.linalg.norm(cross, axis=1), n) / 2
    closed &= np.abs(volume) > THICK * surface**1.5 / (6 * np.sqrt(np.pi))
    closed[closed] = ~_holding(scene, members, low, high, np.flatnonzero(closed))
    return np.where(closed, np.sign(volume), 0).astype(np.int8)[body[np.searchsorted(members, triangle)]]


def _welded(corners: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which places (P, 3) are the corners (T, 3, 3) of triangles, (T, 3): vertices of one of the objects `of` (T,) that coincide are one."""
    rows = np.concatenate([corners, np.broadcast_to(of[:, None, None], (len(of), 3, 1))], axis=2).reshape(-1, 4) + 0.0  # no -0
    found, inverse = np.unique(rows.view(np.dtype((np.void, rows.itemsize * 4))).ravel(), return_inverse=True)
    return inverse.reshape(-1, 3), found.view(np.float64).reshape(-1, 4)[:, :3]


def _bodies(corners: np.ndarray, places: int) -> tuple[np.ndarray, int]:
    """The connected part (T,) to which triangles belong by their corners (T, 3), and how many there are."""
    ends = corners[:, :2].ravel(), corners[:, 1:].ravel()
    part = connected_components(coo_array((np.ones(len(ends[0]), np.int8), ends), shape=(places, places)), directed=False)[1]
    _, body = np.unique(part[corners[:, 0]], return_inverse=True)
    return body, body.max() + 1


def _open(corners: np.ndarray, body: np.ndarray, n: int) -> np.ndarray:
    """(n,) bool, bodies with an edge along which more triangles turn one way than the other."""
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    edge = np.minimum(start, end) * (corners.max() + 1) + np.maximum(start, end)
    edges, first, inverse = np.unique(edge, return_index=True, return_inverse=True)
    balance = np.bincount(inverse, np.sign(end - start), len(edges))
    return np.bincount(np.repeat(body, 3)[first], balance != 0, n) > 0


def _holding(scene: Scene, members: np.ndarray, low: np.ndarray, high: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """Which of the bodies `closed` (K,), by boxes low, high (n, 3) of all, hold another body, the camera, a lamp or a vertex of other objects, or the whole scene."""
    g = scene.geometry
    others = np.isin(g.object, g.object[members], invert=True)
    vertices = g.triangles[others].ravel()
    step = max(1, len(vertices) // max(1, min(LOOKED_AT, COMPARED // len(low))))
    within = [g.vertices[vertices[::step]].astype(np.float64), scene.lamps.position.astype(np.float64).reshape(-1, 3)]
    if scene.camera is not None:
        within.append(scene.camera.matrix[None, :3, 3])
    within = np.concatenate(within)
    size, centre = (high - low).prod(axis=1), 0.5 * (low + high)
    first, last = bounds(g.vertices)
    found = ((low[closed] <= first) & (high[closed] >= last)).all(axis=1)
    for i, k in enumerate(closed):
        held = (centre > low[k]) & (centre < high[k])
        found[i] |= ((within > low[k]) & (within < high[k])).all(axis=1).any() or (held.all(axis=1) & (size < size[k])).any()
    return found
