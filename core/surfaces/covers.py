"""Which parts of a triangle others of its plane cover (see `core.coincident`), in its own barycentric weights u, v of corners 1 and 2.

A coverer is 4 rows of 4: the box of it (least u, largest u, least v, largest v), then, for each of its corners, (a, b, c, 0) of the weight
a u + b v + c that the corner has at a place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, leaf
from ..scene import COVERED, MaterialTables
from .layout import NORMAL, SURFACE

BARE, WHOLE = -1, -2  # states of a triangle
SLACK = np.float32(-1e-5)  # weight of a corner, least: places on the edge between two coverers are not left out by rounding


class CoveredPlaces(NamedTuple):
    """What of T triangles others cover; without rows where nothing is.

    state: (T,) int32, BARE, WHOLE, or its number among the L that are covered in part.  first: (L + 1,) int64, where its coverers begin.
    covers: (C, 4, 4) float32.  seen: (T,) uint8, set to 1 where a covered place is looked at.
    """

    state: np.ndarray
    first: np.ndarray
    covers: np.ndarray
    seen: np.ndarray

    @staticmethod
    def none() -> CoveredPlaces:
        """Of no triangles."""
        return CoveredPlaces(np.zeros(0, np.int32), np.zeros(1, np.int64), np.zeros((0, 4, 4), np.float32), np.zeros(0, np.uint8))


def coverers(own: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(P, 4, 4) float32: the triangles `other` as coverers of the triangles `own`, both (P, 3, 2) float64 in one plane and not without area."""
    e, f, p = own[:, 1] - own[:, 0], own[:, 2] - own[:, 0], other - own[:, :1]
    area = (e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0])[:, None]
    u = (p[..., 0] * f[:, None, 1] - p[..., 1] * f[:, None, 0]) / area
    v = (e[:, None, 0] * p[..., 1] - e[:, None, 1] * p[..., 0]) / area
    u1, u2, v1, v2 = (np.roll(a, -k, axis=1) for a in (u, v) for k in (1, 2))
    rows = np.zeros((len(own), 4, 4))
    rows[:, 0] = np.stack([u.min(1), u.max(1), v.min(1), v.max(1)], axis=1)
    rows[:, 1:, :3] = np.stack([v1 - v2, u2 - u1, u1 * v2 - u2 * v1], axis=2)
    rows[:, 1:] /= rows[:, 1:, 2].sum(axis=1)[:, None, None]  # whose sum is the area
    return rows.astype(np.float32)


def own_materials(tables: MaterialTables) -> np.ndarray:
    """(M,) the material that each one is where nothing covers it: itself, but for COVERED ones."""
    own = np.arange(len(tables.flags))
    covered = np.flatnonzero(tables.flags & COVERED)
    own[covered] = tables.code[tables.start[covered], 7]
    return own


@leaf
def is_covered(covers, begin, end, u, v):
    """Whether one of the coverers begin..end-1 of `covers` (K, 4, 4) holds the place."""
    for k in range(begin, end):
        if u < covers[k, 0, 0] or u > covers[k, 0, 1] or v < covers[k, 0, 2] or v > covers[k, 0, 3]:
            continue
        if (
            covers[k, 1, 0] * u + covers[k, 1, 1] * v + covers[k, 1, 2] > SLACK
            and covers[k, 2, 0] * u + covers[k, 2, 1] * v + covers[k, 2, 2] > SLACK
            and covers[k, 3, 0] * u + covers[k, 3, 1] * v + covers[k, 3, 2] > SLACK
        ):
            return True
    return False


@inlined
def looks_covered(places, triangle, u, v):
    """Whether the place on a triangle is covered, which `CoveredPlaces.seen` is told."""
    if len(places.state) == 0 or places.state[triangle] == BARE:
        return False
    part = places.state[triangle]
    if part == WHOLE or is_covered(places.covers, places.first[part], places.first[part + 1], u, v):
        places.seen[triangle] = 1
        return True
    return False


@leaf
def blacken(surface):
    """Takes from a surface all but its normal."""
    for k in range(SURFACE):
        if k < NORMAL or k >= NORMAL + 3:
            surface[k] = np.float32(0)
