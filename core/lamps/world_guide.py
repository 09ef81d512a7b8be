"""Where the world is seen: rays that neighbours have sent to it tell where to send more.

Through windows, between columns and under eaves a point sees little of the sky, and most rays drawn from its radiance or
the cosine end at a wall.  So half of the rays to the world are aimed at where the first half of all neighbours' rays
have found it, which costs no ray of its own; both halves are combined by the balance heuristic (Veach 1997, Section 9.2),
so that what the neighbours have missed is found as before.  A point's own rays have no say in where its later ones go, or
these would be right in the mean only together with all others.  Where neighbours have found next to nothing, as of a small window, their few finds are no
density (next to the cell that one of them lies in others see the window in another); so what all that went before have found counts by as much as is lacking.  (Path guiding by directional histograms: Jensen 1995,
"Importance driven path tracing using the photon map".)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel, leaf

NEAR = 64  # points that follow each other and share what they see of the world
REACH = 4  # of these rows, how many to either side count as neighbours
_ROWS, _COLUMNS = 8, 16
CELLS = _ROWS * _COLUMNS  # of the sphere of directions, all of one size
LOW = np.float32(0.1)  # cosines below it count as this: a cell is seen under many
SENT, FINDS = CELLS, CELLS + 1  # columns after the cells
TOLD = np.float32(32.0)  # so many finds of the neighbours count as much as what has been found before
MOST_FINDS = np.float32(8.0)  # of a row, that count for others
_OPEN = np.float32(0.5)  # where more of the world than this is open, nothing is gained
NOTHING = np.float32(1e-5)  # less than this is the rounding error of taking a point's own light out
_PER_AREA = np.float32(CELLS / (4 * math.pi))
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)
_INV_PI = np.float32(1 / math.pi)
_SPHERICAL = np.float32(6.0)  # an even sky, all channels, without the cosine, over the mean irradiance by it


class WorldGuide(NamedTuple):
    """What B points have found of the world by T samples each.

    seen, around: (B / NEAR, CELLS + 2) float32, light that the points of a row have found in each cell, about all that they would have found
        if nothing stood in the way, and how many samples have found some; and the same of the row's neighbours.
    before: (CELLS + 2,) float32, the same of all points that went before.
    sent: (B,) float32, about what one point would have found.
    cell: (B, T) int32, of a sample, -1 where nothing arrives.  light: (B, T) float32, what it has added to `seen`.
    density, cosine: (B, T) float32, with which it was or might have been drawn from the world (per sr), and its cosine.
    share: (B, T) float32, what of it counts for diffuse light beside all other samples, where its weight is that of one of all; for gather rays the
        weight itself.  shine: (B, T) float32, the same for lobes, to which gather rays do not count.
    cdf: (CELLS,) float32, of the point that was last aimed for.
    """

    seen: np.ndarray
    around: np.ndarray
    before: np.ndarray
    sent: np.ndarray
    cell: np.ndarray
    light: np.ndarray
    density: np.ndarray
    cosine: np.ndarray
    share: np.ndarray
    shine: np.ndarray
    cdf: np.ndarray


@kernel
def new_world_guide(points, samples):
    """Room for so many points and samples."""
    f, rows = np.float32, (points + NEAR - 1) // NEAR
    return WorldGuide(
        np.empty((rows, CELLS + 2), f), np.empty((rows, CELLS + 2), f), np.zeros(CELLS + 2, f), np.empty(points, f),
        np.empty((points, samples), np.int32), np.empty((points, samples), f), np.empty((points, samples), f), np.empty((points, samples), f),
        np.ones((points, samples), f), np.ones((points, samples), f), np.empty(CELLS, f),
    )  # fmt: skip


def _middles() -> np.ndarray:
    """(3, CELLS) float32: the direction in the middle of each cell."""
    plain = getattr(in_cell, "py_func", in_cell)  # it is one where Numba is switched off
    return np.array([plain(cell, _HALF, _HALF) for cell in range(CELLS)], np.float32).T.copy()


@inlined
def cell_of(dx, dy, dz):
    """Cell of a unit direction."""
    row = np.int64((dz + _1) * np.float32(_ROWS / 2))
    column = np.int64((np.float32(math.atan2(dy, dx)) * np.float32(0.5 / math.pi) + _HALF) * np.float32(_COLUMNS))
    return min(max(row, 0), _ROWS - 1) * _COLUMNS + min(max(column, 0), _COLUMNS - 1)


@inlined
def in_cell(cell, u, v):
    """Unit direction at (u, v) in a cell, uniform where these are."""
    z = (np.float32(cell // _COLUMNS) + v) * np.float32(2 / _ROWS) - _1
    phi = ((np.float32(cell % _COLUMNS) + u) * np.float32(1 / _COLUMNS) - _HALF) * np.float32(2 * math.pi)
    r = np.float32(math.sqrt(max(_0, _1 - z * z)))
    return r * np.float32(math.cos(phi)), r * np.float32(math.sin(phi)), z


_MIDDLES = _middles()


@leaf
def forget(guide):
    """Before the first sample of other points."""
    guide.seen[:] = _0
    guide.sent[:] = _0
    guide.cell[:] = -1
    guide.share[:] = _0
    guide.shine[:] = _0


@leaf
def expect(guide, k, irradiance):
    """The world gives point k about this (mean of the channels) where nothing stands in its way."""
    guide.sent[k] = _SPHERICAL * irradiance
    guide.seen[k // NEAR, SENT] += guide.sent[k]


@leaf
def remember(guide, k, turn, dx, dy, dz, light, density, cosine, first, gathered):
    """Sample `turn` of point k finds `light` (radiance, sum of the channels) in the direction d.

    density: with which the world's own `first` samples find it; the `gathered` others follow the cosine.
    """
    if not light > _0:
        return
    cell = cell_of(dx, dy, dz)
    # Cells are seen under many cosines.
    light /= np.float32(first) * density + np.float32(gathered) * _INV_PI * max(cosine, LOW)
    guide.cell[k, turn], guide.light[k, turn], guide.density[k, turn], guide.cosine[k, turn] = cell, light, density, cosine
    guide.seen[k // NEAR, cell] += light
    guide.seen[k // NEAR, FINDS] += _1


@inlined
def own_density(density, aimed, first, later, number, guided):
    """Density of all shadow rays of a point: `first` and `later` ones, or `number` on average, of which none is aimed."""
    return np.float32(first) * density + np.float32(later) * aimed if guided else number * density


@leaf
def look_around(guide, points):
    """After the last sample of the first so many points."""
    rows = (points + NEAR - 1) // NEAR
    for row in range(rows):
        guide.around[row, :] = _0
        for other in range(max(0, row - REACH), min(row + REACH + 1, rows)):
            for column in range(CELLS + 2):
                guide.around[row, column] += guide.seen[other, column]


@leaf
def keep_in_mind(guide, points):
    """After the last use of the first so many points: what they have seen is what went before others.

    Rows in and at a window see most of it, but in other directions than those that know too little of it: what many finds tell counts as that of a few.
    """
    for row in range((points + NEAR - 1) // NEAR):
        part = min(_1, MOST_FINDS / max(guide.seen[row, FINDS], _1))
        for column in range(CELLS + 2):
            guide.before[column] += part * guide.seen[row, column]


@leaf
def aim(guide, k, sx, sy, sz, first, later, number, gathered):
    """Get ready to draw for point k, normal s; whether its neighbours, or those before, have found any light, but not most of what there is.

    first, later: how many shadow rays it has and will get, `number` of them on average.  gathered: gather rays, which lie after the first.
    `share` and `shine` are set for what it has.
    """
    cdf = guide.cdf
    row = k // NEAR
    finds = guide.around[row, FINDS]
    for cell in range(CELLS):
        cdf[cell] = guide.around[row, cell]
    for s in range(first + gathered):
        if guide.cell[k, s] >= 0:
            cdf[guide.cell[k, s]] -= guide.light[k, s]
            finds -= _1
    sent = guide.around[row, SENT] - guide.sent[k]
    own, others = _1, _0
    if guide.before[FINDS] > _0:
        own = finds / (finds + TOLD)
        others = (_1 - own) * sent / guide.before[SENT]
    total = found = _0
    for cell in range(CELLS):
        light = own * max(_0, cdf[cell]) + others * guide.before[cell]
        found += light
        cosine = sx * _MIDDLES[0, cell] + sy * _MIDDLES[1, cell] + sz * _MIDDLES[2, cell]
        total += light * max(cosine, LOW)
        cdf[cell] = total
    guided = later > 0 and total > _0 and found >= NOTHING * sent and found <= _OPEN * sent
    for s in range(first + gathered):
        if guide.cell[k, s] < 0:
            continue
        density = guide.density[k, s]
        own = own_density(density, _density(cdf, guide.cell[k, s]) if guided else _0, first, later, number, guided)
        both = own + np.float32(gathered) * _INV_PI * max(_0, guide.cosine[k, s])
        if s < first:
            guide.share[k, s], guide.shine[k, s] = number * density / both, number * density / own
        else:
            guide.share[k, s] = _1 / both
    return guided


@inlined
def _density(cdf, cell):
    return _PER_AREA * (cdf[cell] - (cdf[cell - 1] if cell > 0 else _0)) / cdf[CELLS - 1]


@inlined
def find_cell(cdf, u):
    """The cell that u falls into by unnormalised sums (CELLS,) of the cells' shares, and where in it, 0 to 1."""
    last = len(cdf) - 1
    target = u * cdf[last]
    low, high = 0, last
    while low < high:
        middle = (low + high) // 2
        if cdf[middle] > target:
            high = middle
        else:
            low = middle + 1
    below = cdf[low - 1] if low > 0 else _0
    return low, min((target - below) / max(cdf[low] - below, np.float32(1e-30)), _1)


@inlined
def draw(guide, u, v):
    """Direction and density (per sr) for the point that `aim` was called for."""
    cell, inside = find_cell(guide.cdf, u)
    dx, dy, dz = in_cell(cell, inside, v)
    return dx, dy, dz, _density(guide.cdf, cell)
