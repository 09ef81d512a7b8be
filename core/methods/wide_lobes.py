"""Glossy lobes so wide that the rays of diffuse light serve them as well: how three ways to find the same light share it.

A wide lobe sees what a diffuse surface sees, and rays drawn from it alone are as noisy as so few gather rays.  So all rays of a point count for
its lobe, too: of the light that a surface y sends to a point x from direction d, virtual lights carry what they carry to the diffuse lobe
(`importance_sampling`), but no more than `bound` of it, for their shadow rays are not drawn where the lobe is bright.  The rest is left to
gather rays and rays from the lobe, by the balance heuristic (Veach & Guibas 1995).

Surfaces nearer than the lobe's blur of a cell of the cache, and mirrors (`surfaces.brushed`), whose light a cell does not know, are left to the rays
from the lobe alone; but for what these throw of the lamps' light where there are photons of it (`caustics`), which bring it to wide lobes, too, as far
as `by_photons` has it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined
from ..scene import BRUSHED, DIFFUSE, GLOSSY
from ..surfaces.lobes import ALBEDO, ALPHA, NEGLIGIBLE, WIDE_ALPHA
from ..view.points import ShadingPoints

NARROW = np.float32(0.35)  # roughness of what shows more than a cell of the cache could tell
MOST = np.float32(3.0)  # times a lobe's albedo, as a diffuse one: brighter directions are left to its own rays in part
# The same where photons bring the light: seen at a low angle even a wide lobe mirrors, and hundreds of times as bright.
MOST_BY_PHOTONS = np.float32(16.0)
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_THIRD = np.float32(1 / 3)
_INV_PI = np.float32(1 / np.pi)


class SharedRays(NamedTuple):
    """The other rays of N points that count for their lobes.

    gather: (N,) int32, gather rays of each.  lights: whether virtual lights carry their part.  g_max: clamp of their geometry term.
    """

    gather: np.ndarray
    lights: bool
    g_max: np.float32


def no_sharing(n: int) -> SharedRays:
    """Of n points whose lobes have rays of their own only."""
    return SharedRays(np.zeros(n, np.int32), False, _1)


def sees_alike(visibility: np.ndarray) -> bool:
    """Whether rays of diffuse and of glossy light may meet the same objects, of a `visibility` (O,) each: else they cannot stand for each other."""
    return bool((((visibility & DIFFUSE) > 0) == ((visibility & GLOSSY) > 0)).all())


@inlined
def is_mirror(materials, material):
    """Whether gather rays and reflections that meet a material follow its lobe, as that of a mirror."""
    return materials.flags[material] & BRUSHED > 0


@inlined
def is_wide(lobe):
    """Whether other rays than its own serve a lobe (row of `surfaces.lobes`)."""
    return lobe[ALPHA] > WIDE_ALPHA


def wide_part(points: ShadingPoints) -> float:
    """The part of N points whose lobes, if they reflect anything, are wide."""
    wide = (np.maximum(points.f0, points.f90) > NEGLIGIBLE).any(axis=1) & (points.roughness**2 > WIDE_ALPHA)
    return np.count_nonzero(wide) / max(1, len(wide))


@inlined
def bound(lobe, cosine, r, g, b):
    """The part, 0 to 1, of what virtual lights carry to the diffuse lobe that they carry to this one, towards a direction.

    cosine: of the direction with the shading normal.  (r, g, b): the lobe times its cosine there, 1/sr.
    """
    value = _THIRD * (r + g + b)
    return min(_1, MOST * lobe[ALBEDO] * max(_0, cosine) * _INV_PI / max(value, np.float32(1e-20)))


@inlined
def by_photons(lobe, cosine, r, g, b):
    """The part, 0 to 1, of what photons bring from a direction that this lobe reflects of them; the rest is left to its own rays.

    As for `bound`.  There are few photons beside a lobe's own rays where it is bright: one that meets the mirrored direction of a view along a wet
    road is hundreds of times as strong as those around it, and lights the whole of its disk.
    """
    value = _THIRD * (r + g + b)
    return min(_1, MOST_BY_PHOTONS * lobe[ALBEDO] * max(_0, cosine) * _INV_PI / max(value, np.float32(1e-20)))


@inlined
def balance(mine, others):
    """Balance heuristic: the share of a way whose rays have the density `mine`, beside `others`."""
    return mine / max(mine + others, np.float32(1e-20))


@inlined
def gather_density(rays, cosine):
    """Density (1/sr) of so many cosine-distributed rays."""
    return np.float32(rays) * max(_0, cosine) * _INV_PI


@inlined
def drawn_share(lobe, albedo, density, cosine):
    """Share, 0 to 1, of Cycles' paths towards a direction that it drew from a lobe (row of `surfaces.lobes`), not from the diffuse one beneath.

    albedo: of the diffuse lobe, mean of the channels, on the scale of the lobe's.  density: of `sample_lobe` there, 1/sr.  cosine: of the
    direction with the shading normal.

    Cycles picks one closure by its albedo and draws the direction from it.  That one's kind tells whether a diffuse bounce is counted, but
    what the path finds is split into passes by what either closure reflects: to diffuse and to glossy light alike, this share of
    it has one diffuse bounce more than the rest.
    """
    return balance(lobe[ALBEDO] * density, albedo * max(_0, cosine) * _INV_PI)


@inlined
def known_light(cache, cell, c, share, carried, more):
    """What a cell of a `light_cache.LightCache` sends to a lobe in channel c (W/m^2), less the part `carried` of what virtual lights carry of it,
    and less what photons bring, or lobes that are followed.

    share: of it that may have left one surface more than what gather rays look up, `drawn_share`.  more: `more_by_view` of the cell.
    """
    row = len(cache.radiosity) - 1
    light = cache.matte[cell, c] + share * (cache.radiosity[row, cell, c] - cache.radiosity[row - 1, cell, c])
    if len(cache.chains) > 0:
        light += cache.chains[cell, c]
    return light - carried * cache.matte_lit[cell, c] + more * (_1 - carried * cache.share[cell]) * cache.first[cell, c]
