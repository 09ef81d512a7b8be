"""What glossy surfaces throw on others: the direction of the lamps' light that lobes reflect, in a cache of light.

The cache knows what a lobe reflects of the lamps, but not where to: it spreads that as a diffuse surface would.  So a wall that low sun
reaches by way of a polished floor is as bright to it as one beside, and the floor, which shows the one more than the other, too dark.
Virtual lights know the direction, and photons, which fly on from lobe to lobe.  Here they light the surfaces that gather rays meet, in place of what
the cells around them have by their links to such lobes: the cache is solved again with the one and without the other.
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..references import Reference
from .exchange import DEPTH, DIFFUSE_LINK, PRIOR, Probes, Thrown, add_to_cells, smooth
from .light_cache import CacheBuilder, LightCache, Links

LITTLE = 0.01  # of the light that links carry: below it the direction of what lobes reflect is not worth a ray
ENOUGH = 65536  # probes that get a ray: their cells and those around them share what they find
# Times the mean around it, by the coarsest cells: what a link tells beyond that is a spark, which is spread over all around.
BRIGHT = np.float32(8.0)
FEW = 16  # probes, of which no mean is told
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@kernel
def _parts(probes, link_cell, trust, g_max, by_photons, part):
    """Of the light from lobes that comes over the links of N probes the part that is thrown, (N,): all `by_photons`, else as far as lights have it."""
    for p in range(len(link_cell)):
        cell = link_cell[p]
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
        part[p] = _1 if by_photons else trust[cell] * min(_1, g_max * r2 * r2 / max(abs(here * there), np.float32(1e-30)))


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
    known = np.flatnonzero(probes.valid)
    return known[:: -(-len(known) // ENOUGH) | 1]  # odd: first and second probes of paths


def shine_share(probes: Probes, links: Links, cache: LightCache) -> float:
    """The part of what visible points get of other surfaces which lobes, one or several, reflect of the lamps, spread as by diffuse ones."""
    if not len(cache.share) or not links.shine.any():
        return 0.0
    first = np.arange(0, len(probes.valid), DEPTH)
    cells = links.cells[first[probes.valid[first] > 0], 0]
    shine, whole = (float(_grey(light)[cells].sum(dtype=np.float64)) for light in (links.shone, cache.radiosity[-1]))
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


def redirected(
    builder: CacheBuilder,
    cache: LightCache,
    links: Links,
    rows: np.ndarray,
    irradiance: np.ndarray,
    g_max: np.float32,
    threads: int = 0,
    *,
    by_photons: bool = False,
) -> tuple[LightCache, Links]:
    """The cache with what lobes throw on the probes `rows` (P,) where it falls, and its links.

    builder: what has made the cache and its `links`.  irradiance: (P, 3 G) W/m^2, by virtual lights that stand for lamps' light that lobes reflect, or
    `by_photons`: these know what several lobes have reflected, one after the other, too.  g_max: the clamp of the lights' geometry term.
    """
    probes = builder.probes
    part = np.zeros(len(probes.valid), np.float32)
    _parts(Reference(probes), links.link_cell, cache.trust, g_max, by_photons, part)
    weight = links.weight[rows, None]
    irradiance_of = _spread_over(links, rows, weight * irradiance, weight, threads)
    shone, groups = links.shone if by_photons else links.shine, links.shine.shape[1] // 3
    new, others = builder.solve(thrown=Thrown(irradiance_of, part, by_photons))
    # The irradiance itself is added to what paths find, which leave out what photons bring, but not what lights do: less what their links tell of that.
    gain = irradiance_of
    if not by_photons:
        albedo, carry = (np.tile(values[rows], groups) for values in (probes.albedo, probes.carry))
        told = part[rows, None] * carry * shone[np.maximum(links.link_cell[rows], 0)]
        # Those that meet no spark must not lack its light.
        told = without_sparks(np.divide(told, albedo, out=np.zeros_like(told), where=albedo > 0), weight[:, 0], links.cells[rows, -1])
        gain = _spread_over(links, rows, weight * (irradiance - told), weight, threads)
    lit, dull = cache.trust[:, None] * new.lit, new.sent
    if by_photons:
        lit, dull = np.maximum(_0, lit - cache.trust[:, None] * links.shine), np.maximum(_0, dull - shone)
    return cache._replace(radiosity=new.radiosity, sent=new.sent, dull=dull, lit=lit, gain=np.ascontiguousarray(gain)), others
