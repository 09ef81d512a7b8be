"""What glossy surfaces throw on others: the direction of the lamps' light that lobes reflect, in a cache of light.

The cache knows what a lobe reflects of the lamps, but not where to: it spreads that as a diffuse surface would.  So a wall that low sun
reaches by way of a polished floor is as bright to it as one beside, and the floor, which shows the one more than the other, too dark.
Virtual lights know the direction.  Here they light the surfaces that gather rays meet, in place of what the cells around them have
by their links to such lobes.  Light as a whole stays what it is.
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..threads import run_chunks
from .light_cache import CHUNK, DEPTH, DIFFUSE_LINK, PRIOR, LightCache, Links, Probes, add_to_cells, carry_over, smooth

LITTLE = 0.01  # of the light that links carry: below it the direction of what lobes reflect is not worth a ray
ENOUGH = 32768  # probes that get a ray: their cells and those around them share what they find
# Times the mean around it, by the coarsest cells: what a link tells beyond that is a spark, which is spread over all around.
BRIGHT = np.float32(8.0)
FEW = 16  # probes, of which no mean is told
FARTHEST = 4  # bounces after which what the direction changes is told by the bounce before
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@kernel
def _linked(probes, first, links, trust, g_max, by_photons, carried):
    """Of each probe first[i] (P,) into row i of `carried` (P, 3 G), W/m^2: light that has come from lobes over its link.

    All of it `by_photons`, else as far as virtual lights have it.
    """
    for i in range(len(first)):
        p = first[i]
        cell = links.link_cell[p]
        if cell < 0 or probes.link[p] != DIFFUSE_LINK:
            continue
        dx, dy, dz = (
            probes.link_position[p, 0] - probes.position[p, 0],
            probes.link_position[p, 1] - probes.position[p, 1],
            probes.link_position[p, 2] - probes.position[p, 2],
        )
        here = probes.normal[p, 0] * dx + probes.normal[p, 1] * dy + probes.normal[p, 2] * dz
        there = probes.link_normal[p, 0] * dx + probes.link_normal[p, 1] * dy + probes.link_normal[p, 2] * dz
        r2 = dx * dx + dy * dy + dz * dz
        part = _1 if by_photons else trust[cell] * min(_1, g_max * r2 * r2 / max(abs(here * there), np.float32(1e-30)))
        for c in range(0, carried.shape[1], 3):
            for k in range(3):
                carried[i, c + k] = part * probes.carry[p, k] * links.shine[cell, c + k]


def throwing(probes: Probes, links: Links, cache: LightCache) -> np.ndarray:
    """Rows (P,) of the probes whose surfaces are worth a ray to what lobes throw on them: none where that is next to nothing."""
    none = np.zeros(0, np.int64)
    if not len(cache.share) or len(cache.radiosity) < 2 or not links.shine.any():
        return none
    first = np.arange(0, len(probes.valid), DEPTH)
    linked = first[(probes.valid[first] > 0) & (probes.link[first] == DIFFUSE_LINK) & (links.link_cell[first] >= 0)]
    if not len(linked):
        return none
    shine, whole = (
        float(np.einsum("nk,nk->", probes.carry[linked], _grey(light[links.link_cell[linked]]), dtype=np.float64))
        for light in (links.shine, cache.radiosity[-1])
    )
    if not shine > LITTLE * whole:
        return none
    first = first[probes.valid[first] > 0]
    return first[:: -(-len(first) // ENOUGH)]


def shine_share(probes: Probes, links: Links, cache: LightCache) -> float:
    """The part of what visible points get of other surfaces which lobes reflect of the lamps, spread as by diffuse ones."""
    if not len(cache.share) or not links.shine.any():
        return 0.0
    first = np.arange(0, len(probes.valid), DEPTH)
    cells = links.cells[first[probes.valid[first] > 0], 0]
    shine, whole = (float(_grey(light)[cells].sum(dtype=np.float64)) for light in (links.shine, cache.radiosity[-1]))
    return shine / whole if whole > 0 else 0.0


def _grey(light: np.ndarray) -> np.ndarray:
    """Sum (N, 3) of all light groups (N, 3 G)."""
    return light.reshape(len(light), -1, 3).sum(axis=1)


def _spread_over(links: Links, rows: np.ndarray, values: np.ndarray, weight: np.ndarray, threads: int) -> np.ndarray:
    """Means (C, K) over cells of the probes `rows` (P,), of values (P, K) times their weights (P, 1); coarser cells stand in for finer ones."""
    count, cells = len(links.parent), np.ascontiguousarray(links.cells[rows].T)
    sums, number = np.zeros((count, values.shape[1]), np.float32), np.zeros((count, 1), np.float32)
    add_to_cells(cells, values, sums, threads)
    add_to_cells(cells, weight, number, threads)
    smooth(sums, number[:, 0], links.unit, links.parent, links.order, np.full(count, PRIOR, np.float32))
    return sums


def without_sparks(light: np.ndarray, weight: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Light (P, K) of probes in the coarsest cells `around` (P,), in which none has many times the mean of the others there; their sum stays.

    weight: (P,) that of each probe.
    """
    few, number = np.bincount(around)[around] < FEW, np.bincount(around, weight)[around]
    grey = light.mean(axis=1, dtype=np.float64)
    whole = np.average(grey, weights=weight)
    others = (np.bincount(around, weight * grey)[around] - weight * grey) / number
    usual = np.where(few, whole, others + whole / np.bincount(around)[around])
    kept = np.minimum(1, BRIGHT * usual / np.maximum(grey, 1e-30))[:, None]
    if kept.min() == 1:
        return light
    excess = weight[:, None] * (1 - kept) * light
    nearby, afar = np.where(few[:, None], 0, excess), excess[few].sum(axis=0) / weight.sum()
    shares = [np.bincount(around, nearby[:, c])[around] / number for c in range(light.shape[1])]
    return (kept * light + np.stack(shares, axis=1) + afar).astype(np.float32)


def _reflected(probes: Probes, links: Links, more: np.ndarray, bounces: int, threads: int) -> np.ndarray:
    """By how much cells send more after each bounce (B, C, 3 G), where the second surface sends `more` (C, 3 G)."""
    rows = np.zeros((bounces, *more.shape), np.float32)
    rows[1:] = more
    known = np.flatnonzero((probes.valid > 0) & (links.link_cell != -1))
    weight, free = links.weight[known, None], probes.link[known] != DIFFUSE_LINK
    link, carry = np.maximum(links.link_cell[known], 0), np.where(links.link_cell[known, None] >= 0, weight * probes.carry[known], _0)
    carried = np.empty((len(known), more.shape[1]), np.float32)
    for bounce in range(2, min(bounces, FARTHEST)):

        def work(begin: int, end: int, bounce: int = bounce) -> None:
            carry_over(link, carry, free, rows, bounce, begin, end, carried)

        run_chunks(work, len(known), CHUNK, threads)
        rows[bounce:] = more + _spread_over(links, known, carried, weight, threads)
    return rows


def redirected(
    cache: LightCache,
    probes: Probes,
    links: Links,
    first: np.ndarray,
    irradiance: np.ndarray,
    g_max: np.float32,
    bounces: int,
    threads: int = 0,
    *,
    by_photons: bool = False,
) -> LightCache:
    """The cache with what lobes throw on the probes `first` (P,) where it falls.

    irradiance: (P, 3 G) W/m^2, by virtual lights that stand for lamps' light that lobes reflect, or `by_photons`.  g_max: the clamp of the lights'
    geometry term.
    bounces: surfaces that the light has left which gather rays look up, at most.
    """
    groups = irradiance.shape[1] // 3
    carried = np.zeros_like(irradiance)
    _linked(probes, first, links, cache.trust, g_max, by_photons, carried)
    albedo, weight = np.tile(probes.albedo[first], groups), links.weight[first, None]
    # What cells reflect of it, and the irradiance itself, which is added to what paths find: those that meet no spark must not lack its light.
    told = without_sparks(np.divide(carried, albedo, out=np.zeros_like(carried), where=albedo > 0), weight[:, 0], links.cells[first, -1])
    gains = [albedo * irradiance - carried, irradiance - told]
    found = _spread_over(links, first, weight * np.hstack(gains), weight, threads)
    more, gain = np.hsplit(found, 2)
    rows = _reflected(probes, links, np.ascontiguousarray(more), len(cache.radiosity), threads)
    radiosity = np.maximum(_0, cache.radiosity + rows)
    more = np.maximum(rows[bounces - 1], -cache.sent)
    lit = np.maximum(_0, cache.lit + cache.later * cache.share[:, None] * more)
    return cache._replace(radiosity=radiosity, sent=cache.sent + more, dull=cache.dull + more, lit=lit, gain=np.ascontiguousarray(gain))
