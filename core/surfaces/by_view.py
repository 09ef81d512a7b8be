"""How bright the diffuse light of a surface is by the angle of its view.

A dielectric lobe takes its share of what a surface reflects by the angle of the view, most at grazing ones (`layout.diffuse_albedo`), and
so does the roughness of a diffuse reflection, a coat, or a mix by a Fresnel node.  Virtual lights and cells of light are means over all views;
here is, for each side of each material, how far one view differs from them.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, kernel
from ..scene import ANGLED, CONSTANT, COVERED, TRANSLUCENT, MaterialTables
from .covers import own_materials
from .layout import COAT, SHEEN_ROUGHNESS, SURFACE, diffuse_albedo, diffuse_albedo_average
from .places import some_surfaces
from .program import MEAN_VIEW, reflected_view

VIEWS = 16  # cosines, more of them at grazing views: their roots are evenly spaced
_0 = np.float32(0)
_1 = np.float32(1)


@inlined
def at_view(table, side, cosine):
    """What a table (2 M, `VIEWS`) tells of a side (`normals.surface_side`) for a view at `cosine`: by a `views` table, light over its mean over all views, less 1."""
    x = np.float32(math.sqrt(min(_1, max(_0, cosine)))) * np.float32(VIEWS - 1)
    i = min(np.int64(x), VIEWS - 2)
    low = table[side, i]
    return low + (x - np.float32(i)) * (table[side, i + 1] - low)


@kernel
def _differences(table, sides, cosine, out):
    for i in range(len(sides)):
        out[i] = at_view(table, sides[i], cosine[i])


def differences(table: np.ndarray, sides: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """`at_view` of many sides (N,) at as many cosines, (N,) float32."""
    out = np.empty(len(sides), np.float32)
    _differences(table, np.ascontiguousarray(sides, np.int32), np.ascontiguousarray(cosine, np.float32), out)
    return out


@inlined
def cosine_of(view):
    """Cosine of one of the `VIEWS` with the normal."""
    root = np.float32(view) / np.float32(VIEWS - 1)
    return root * root


@kernel
def _add_views(surfaces, owner, seen, mean):
    """Adds the diffuse albedo of surfaces (N, SURFACE) at each view to the row `owner` (N,) of `seen` (M, VIEWS) and its mean to `mean` (M,);
    sums of the channels."""
    for i in range(len(surfaces)):
        surface, m = surfaces[i], owner[i]
        for k in range(VIEWS):
            r, g, b = diffuse_albedo(surface, cosine_of(k))
            seen[m, k] += r + g + b
        r, g, b = diffuse_albedo_average(surface)
        mean[m] += r + g + b


@kernel
def _add_view(surfaces, owner, k, seen):
    """Adds the diffuse albedo of surfaces (N, SURFACE), which are as view k sees them, to the rows `owner` (N,) of `seen` (M, VIEWS)."""
    for i in range(len(surfaces)):
        r, g, b = diffuse_albedo(surfaces[i], cosine_of(k))
        seen[owner[i], k] += r + g + b


def views_of_sides(
    tables: MaterialTables, material: np.ndarray, attributes: np.ndarray, wanted: np.ndarray, threads: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surfaces (2, VIEWS, N, SURFACE) float32 of the `wanted` (M,) bool materials as both sides are to each view, and as the mean view has them, (N, SURFACE),
    at the same places; the material of each place, (N,)."""
    cosines = [reflected_view(sign * max(cosine_of(k), np.float32(1e-4))) for sign in (1, -1) for k in range(VIEWS)]
    surfaces, owner = some_surfaces(tables, material, attributes, wanted, threads, [*cosines, MEAN_VIEW])
    n = len(owner) // (len(cosines) + 1)
    return surfaces[:-n].reshape(2, VIEWS, n, SURFACE), surfaces[-n:], owner[:n]


def _over_views() -> np.ndarray:
    """Weights (VIEWS,) of the mean over the cosine-weighted hemisphere of what is linear between the views."""
    x = (np.arange(4096) + 0.5) / 4096  # roots of cosines
    weights = np.array([np.interp(x * (VIEWS - 1), np.arange(VIEWS), one) @ x**3 for one in np.eye(VIEWS)])
    return (weights / weights.sum()).astype(np.float32)


_OVER_VIEWS = _over_views()


def views(tables: MaterialTables, material: np.ndarray, attributes: np.ndarray, threads: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(2 M, VIEWS) float32 of both sides of M materials, light towards each view over its mean over all views, less 1, and the part of it that is in the surfaces which paths meet.

    Those are as the paths see them where the nodes ask for the view (ANGLED); of a coat they are the mean over all views.

    material: (T,) int32, of the triangles.  attributes: (K, T, 3, 4) float32.
    Zeros for translucent materials, which have another albedo from behind.  Of sheen there is nothing: how it shines towards a view depends on
    where its light comes from as well.
    """
    count = len(tables.flags)
    seen, mean = np.zeros((count, VIEWS), np.float32), np.zeros(count, np.float32)
    constant = np.flatnonzero(tables.flags & CONSTANT)
    _add_views(np.ascontiguousarray(tables.constant[constant], np.float32), constant, seen, mean)
    own, coated, sheened = own_materials(tables), np.zeros(count, bool), np.zeros(count, bool)
    textured = tables.flags & (CONSTANT | COVERED) == 0
    if textured.any():
        if (tables.flags & COVERED).any():  # their triangles tell of their own materials
            material = own[material]
        surfaces, owner = some_surfaces(tables, material, attributes, textured, threads)
        _add_views(surfaces, owner, seen, mean)
        coated[owner[(surfaces[:, COAT : COAT + 3] > 0).any(axis=1)]] = True
        sheened[owner[surfaces[:, SHEEN_ROUGHNESS] != 0]] = True
    plain, angled = tables.flags & (ANGLED | TRANSLUCENT) == 0, tables.flags & (ANGLED | TRANSLUCENT) == ANGLED
    by_angle = (plain & coated | angled) & ~sheened
    probed, whole = np.zeros((2, count, 2, VIEWS), np.float32)
    met = plain & (mean > 1e-6)
    probed[met] = (seen[met] / mean[met, None] - 1)[:, None]
    whole[:] = probed
    if by_angle.any():
        of_sides, of_mean, owner = views_of_sides(tables, material, attributes, by_angle, threads)
        here = np.zeros(count, np.float32)
        _add_views(of_mean, owner, np.zeros_like(seen), here)
    for side in range(2 if by_angle.any() else 0):
        light = np.zeros((count, VIEWS), np.float32)
        for k in range(VIEWS):
            _add_view(of_sides[side, k], owner, k, light)
        average = np.where(angled, light @ _OVER_VIEWS, here)
        known = by_angle & (average > 1e-6)
        whole[known, side] = light[known] / average[known, None] - 1
    probed[angled] = whole[angled]
    return whole[own].reshape(2 * count, VIEWS), probed[own].reshape(2 * count, VIEWS)
