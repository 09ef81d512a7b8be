"""With what chance paths follow the lobes of surfaces whose other light they look up: the share of lobes in what is reflected to a view."""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..scene import ANGLED, CONSTANT, COVERED, GLOSSY_LOBE, MaterialTables
from .brushed import ROUGHEST
from .by_view import VIEWS, cosine_of, views_of_sides
from .covers import own_materials
from .layout import ROUGHNESS, diffuse_albedo, glossy_albedo, translucency
from .places import some_surfaces

LEAST_CHANCE = np.float32(0.03)  # of what is followed: its light must not become a spark where a material reflects more than elsewhere
SOME = 0.002  # of the light that a material reflects: by fainter lobes nothing is seen


@kernel
def _add_lobes(surfaces, owner, first, end, glossy, whole):
    """Adds what lobes, and all closures, of surfaces (N, SURFACE) reflect to the views first..end-1 to the rows `owner` (N,) of `glossy` and `whole` (M, VIEWS).

    Lobes as rough as `ROUGHEST`, for which a diffuse one stands as well, do not count as such.
    """
    for i in range(len(surfaces)):
        surface, m = surfaces[i], owner[i]
        for k in range(first, end):
            r, g, b = glossy_albedo(surface, cosine_of(k))
            lobe = r + g + b
            r, g, b = diffuse_albedo(surface, cosine_of(k))
            tr, tg, tb = translucency(surface, cosine_of(k))
            if surface[ROUGHNESS] < ROUGHEST:
                glossy[m, k] += lobe
            whole[m, k] += lobe + r + g + b + tr + tg + tb


def lobe_chances(tables: MaterialTables, material: np.ndarray, attributes: np.ndarray, threads: int = 0) -> np.ndarray:
    """(2 M, VIEWS) float32 of both sides of M materials, the chance by which a path follows their lobes towards each view.

    material: (T,) int32, of the triangles.  attributes: (K, T, 3, 4) float32.
    Zeros where lobes reflect next to nothing, or are so rough that they are looked up as well; else `LEAST_CHANCE` at least.
    """
    count, own = len(tables.flags), own_materials(tables)
    glossy, whole = np.zeros((2, 2, count, VIEWS), np.float32)
    constant = np.flatnonzero(tables.flags & CONSTANT)
    known = [(np.ascontiguousarray(tables.constant[constant], np.float32), constant)]
    textured, angled = tables.flags & (CONSTANT | COVERED) == 0, tables.flags & ANGLED > 0
    material = own[material]
    if (textured & ~angled).any():
        known.append(some_surfaces(tables, material, attributes, textured & ~angled, threads))
    for side in range(2):
        for surfaces, owner in known:
            _add_lobes(surfaces, owner, 0, VIEWS, glossy[side], whole[side])
    if (textured & angled).any():
        of_sides, _, owner = views_of_sides(tables, material, attributes, textured & angled, threads)
        for side in range(2):
            for k in range(VIEWS):
                _add_lobes(of_sides[side, k], owner, k, k + 1, glossy[side], whole[side])
    share = np.divide(glossy, whole, out=np.zeros_like(glossy), where=whole > 0).transpose(1, 0, 2)  # (M, 2, VIEWS)
    followed = (tables.flags & GLOSSY_LOBE > 0)[:, None] & (share.max(axis=-1) > SOME)
    chances = np.where(followed[..., None], np.maximum(share, LEAST_CHANCE), np.float32(0))
    return chances[own].reshape(2 * count, VIEWS)
