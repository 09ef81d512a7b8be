"""Which parts of large lamps are seen: rays that neighbours have sent to a lamp tell where on it to send more.

Through a window, blinds or leaves a point sees a small part of a large lamp, of the sphere of a far one or of a wide sun, and most of its rays end at a
wall.  So half of a point's rays to it are drawn as ever, and the others where those of its neighbours have found light, by a histogram over the two random
numbers that place a sample on the lamp, which mean nearly the same to neighbours.  Both halves are combined by the balance heuristic, as `world_guide` does
for the world, which says why a point's own finds do not count for it and what went before does.  (Histograms over the numbers instead of over directions:
Müller et al. 2019, "Neural importance sampling", Section 6; Guo et al. 2018, "Primary sample space path guiding".)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel, leaf
from ..scene import AREA, POINT, SPOT, SUN
from .tables import RADIUS, SHARP, TRIANGLE
from .world_guide import MOST_FINDS, NEAR, NOTHING, REACH, TOLD, find_cell

MOST = 8  # lamps of a block that are guided
_SIDE = 8
CELLS = _SIDE * _SIDE  # of the square of the two random numbers
SENT, FINDS = CELLS, CELLS + 1  # columns after the cells
_OPEN = np.float32(0.3)  # where more of a lamp than this is seen, next to nothing is gained
_0 = np.float32(0.0)
_1 = np.float32(1.0)


class LampGuide(NamedTuple):
    """What B points have found of L lamps by their first samples, T at most.

    slot: (G,) int64, row of a group here, -1 where it is not guided.
    seen, around: (L, B / NEAR, CELLS + 2) float32, light that a row of points has found in each cell, what it would have found with nothing in the way, and how
        many samples have found some; and the same of the row's neighbours.
    before: (L, CELLS + 2) float32, the same of all points that went before.
    sent: (L, B) float32, what a point would have found.
    cell: (L, B, T) int32, of a sample, -1 where nothing arrives.  light: (L, B, T) float32, what it has added to `seen`.
    share: (L, B, T) float32, what of it counts beside all others, where its weight is that of one of all.
    cdf: (CELLS,) float32, of the point that was last aimed for.
    """

    slot: np.ndarray
    seen: np.ndarray
    around: np.ndarray
    before: np.ndarray
    sent: np.ndarray
    cell: np.ndarray
    light: np.ndarray
    share: np.ndarray
    cdf: np.ndarray


@kernel
def new_lamp_guide(emitters, points, samples):
    """Room for so many points and samples, and those of the lamps that have a size."""
    f = np.float32
    slot = np.full(len(emitters.groups), -1)
    lamps = 0
    for g in range(len(emitters.groups)):
        e = emitters.groups[g]
        if e < 0 or lamps == MOST or emitters.flags[e] & SHARP:
            continue
        kind = emitters.kind[e]
        if kind == AREA or kind == TRIANGLE or kind == SUN or ((kind == POINT or kind == SPOT) and emitters.lamps[e, RADIUS] > _0):
            slot[g] = lamps
            lamps += 1
    rows = (points + NEAR - 1) // NEAR
    return LampGuide(
        slot, np.zeros((lamps, rows, CELLS + 2), f), np.zeros((lamps, rows, CELLS + 2), f), np.zeros((lamps, CELLS + 2), f),
        np.zeros((lamps, points), f), np.full((lamps, points, samples), -1, np.int32), np.zeros((lamps, points, samples), f),
        np.ones((lamps, points, samples), f), np.empty(CELLS, f),
    )  # fmt: skip


@inlined
def cell_on_lamp(u1, u2):
    """Cell of two random numbers."""
    return min(np.int64(u1 * np.float32(_SIDE)), _SIDE - 1) * _SIDE + min(np.int64(u2 * np.float32(_SIDE)), _SIDE - 1)


@leaf
def forget_lamps(guide):
    """Before the first sample of other points."""
    guide.seen[:] = _0
    guide.sent[:] = _0
    guide.cell[:] = -1
    guide.share[:] = _1


@inlined
def remember_lamp(guide, lamp, k, sample, cell, light, through):
    """A sample of point k has gone to the lamp, and this part of its light (sum of the channels) gets `through`."""
    guide.sent[lamp, k] += light
    guide.seen[lamp, k // NEAR, SENT] += light
    if through > _0:
        guide.cell[lamp, k, sample], guide.light[lamp, k, sample] = cell, through * light
        guide.seen[lamp, k // NEAR, cell] += through * light
        guide.seen[lamp, k // NEAR, FINDS] += _1


@leaf
def look_around_lamps(guide, points):
    """After the last sample of the first so many points."""
    rows = (points + NEAR - 1) // NEAR
    for lamp in range(len(guide.seen)):
        for row in range(rows):
            guide.around[lamp, row, :] = _0
            for other in range(max(0, row - REACH), min(row + REACH + 1, rows)):
                for column in range(CELLS + 2):
                    guide.around[lamp, row, column] += guide.seen[lamp, other, column]


@leaf
def keep_lamps_in_mind(guide, points):
    """After the last use of the first so many points: what they have seen is what went before others, the finds of each row as those of a few."""
    for lamp in range(len(guide.seen)):
        for row in range((points + NEAR - 1) // NEAR):
            part = min(_1, MOST_FINDS / max(guide.seen[lamp, row, FINDS], _1))
            for column in range(CELLS + 2):
                guide.before[lamp, column] += part * guide.seen[lamp, row, column]


@leaf
def aim_at_lamp(guide, lamp, k, first, later):
    """Get ready to draw for point k; whether its neighbours, or those before, have found any light of the lamp, but not most of it.

    first, later: how many samples it has and will get.  `share` is set for what it has.
    """
    cdf = guide.cdf
    row = k // NEAR
    sent = guide.around[lamp, row, SENT] - guide.sent[lamp, k]
    finds = guide.around[lamp, row, FINDS]
    total = _0
    for cell in range(CELLS):
        cdf[cell] = guide.around[lamp, row, cell]
        total += cdf[cell]
    for s in range(first):
        if guide.cell[lamp, k, s] >= 0:
            cdf[guide.cell[lamp, k, s]] -= guide.light[lamp, k, s]
            total -= guide.light[lamp, k, s]
            finds -= _1
    if not (later > 0 and _0 < sent < np.float32(np.inf) and total <= _OPEN * sent):
        return False
    own, others = _1, _0
    if guide.before[lamp, FINDS] > _0:
        own = finds / (finds + TOLD)
        others = (_1 - own) * sent / guide.before[lamp, SENT]
    total = _0
    for cell in range(CELLS):
        total += own * max(_0, cdf[cell]) + others * guide.before[lamp, cell]
        cdf[cell] = total
    if not (total > _0 and total >= NOTHING * sent and total <= _OPEN * sent):
        return False
    for s in range(first):
        if guide.cell[lamp, k, s] >= 0:
            guide.share[lamp, k, s] = np.float32(first + later) / (
                np.float32(first) + np.float32(later) * _density(cdf, guide.cell[lamp, k, s])
            )
    return True


@inlined
def _density(cdf, cell):
    return np.float32(CELLS) * (cdf[cell] - (cdf[cell - 1] if cell > 0 else _0)) / cdf[CELLS - 1]


@inlined
def draw_on_lamp(guide, u1, u2):
    """Two random numbers for the point that `aim_at_lamp` was called for, and their density."""
    cell, inside = find_cell(guide.cdf, u1)
    inside = min(inside, np.float32(0.999999))  # 1 itself is no such number
    side = np.float32(1 / _SIDE)
    return side * (np.float32(cell // _SIDE) + inside), side * (np.float32(cell % _SIDE) + u2), _density(guide.cdf, cell)
