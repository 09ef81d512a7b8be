"""How bright the diffuse light of a surface is by the angle of its view.

A dielectric lobe takes its share of what a surface reflects by the angle of the view, most at grazing ones (`layout.diffuse_albedo`), and
so does the roughness of a diffuse reflection, and a coat, by a closure that knows the view.  Virtual lights and cells of light are means over
all views; here is, for each material, how far one view differs from them.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, kernel
from ..scene import ANGLED, CONSTANT, COVERED, TRANSLUCENT, MaterialTables
from .covers import own_materials
from .layout import COAT, SHEEN_ROUGHNESS, diffuse_albedo, diffuse_albedo_average
from .places import some_surfaces
from .program import reflected_view

VIEWS = 16  # cosines, more of them at grazing views: their roots are evenly spaced
_0 = np.float32(0)
_1 = np.float32(1)


@inlined
def difference(table, material, cosine):
    """Light towards a view at `cosine` over its mean over all views, less 1, of a material of a `views` table."""
    x = np.float32(math.sqrt(min(_1, max(_0, cosine)))) * np.float32(VIEWS - 1)
    i = min(np.int64(x), VIEWS - 2)
    low = table[material, i]
    return low + (x - np.float32(i)) * (table[material, i + 1] - low)


@kernel
def _differences(table, materials, cosine, out):
    for i in range(len(materials)):
        out[i] = difference(table, materials[i], cosine[i])


def differences(table: np.ndarray, materials: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """`difference` of many materials (N,) at as many cosines, (N,) float32."""
    out = np.empty(len(materials), np.float32)
    _differences(table, np.ascontiguousarray(materials, np.int32), np.ascontiguousarray(cosine, np.float32), out)
    return out


@inlined
def _cosine(view):
    """Of one of the `VIEWS` with the normal."""
    root = np.float32(view) / np.float32(VIEWS - 1)
    return root * root


@kernel
def _add_views(surfaces, owner, seen, mean):
    """Adds the diffuse albedo of surfaces (N, SURFACE) at each view to the row `owner` (N,) of `seen` (M, VIEWS) and its mean to `mean` (M,);
    sums of the channels."""
    for i in range(len(surfaces)):
        surface, m = surfaces[i], owner[i]
        for k in range(VIEWS):
            r, g, b = diffuse_albedo(surface, _cosine(k))
            seen[m, k] += r + g + b
        r, g, b = diffuse_albedo_average(surface)
        mean[m] += r + g + b


@kernel
def _add_view(surfaces, owner, k, seen):
    """Adds the diffuse albedo of surfaces (N, SURFACE), which are as view k sees them, to the rows `owner` (N,) of `seen` (M, VIEWS)."""
    for i in range(len(surfaces)):
        r, g, b = diffuse_albedo(surfaces[i], _cosine(k))
        seen[owner[i], k] += r + g + b


def views(tables: MaterialTables, material: np.ndarray, attributes: np.ndarray, threads: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(M, VIEWS) float32 `difference` of M materials, and the part of it that their mean surfaces tell, which paths meet; they differ for coats.

    material: (T,) int32, of the triangles.  attributes: (K, T, 3, 4) float32.
    Zeros where the nodes ask for the view themselves, and for translucent materials, which have another albedo from behind.
    With sheen there is only what the mean surface tells: how that shines towards a view depends on where its light comes from as well.
    """
    count = len(tables.flags)
    seen, mean = np.zeros((count, VIEWS), np.float32), np.zeros(count, np.float32)
    constant = np.flatnonzero(tables.flags & CONSTANT)
    _add_views(np.ascontiguousarray(tables.constant[constant], np.float32), constant, seen, mean)
    own, topped = own_materials(tables), np.zeros(count, bool)
    textured = tables.flags & (CONSTANT | COVERED) == 0
    if textured.any():
        if (tables.flags & COVERED).any():  # their triangles tell of their own materials
            material = own[material]
        surfaces, owner = some_surfaces(tables, material, attributes, textured, threads)
        _add_views(surfaces, owner, seen, mean)
        topped[owner[(surfaces[:, COAT : COAT + 3] > 0).any(axis=1)]] = True
        topped[owner[surfaces[:, SHEEN_ROUGHNESS] != 0]] = False
    known = (mean > 1e-6) & (tables.flags & (ANGLED | TRANSLUCENT) == 0)
    topped &= known
    whole = np.where(topped[:, None], np.float32(0), seen)
    for k in range(VIEWS if topped.any() else 0):
        _add_view(*some_surfaces(tables, material, attributes, topped, threads, reflected_view(_cosine(k))), k, whole)

    def over_mean(light: np.ndarray) -> np.ndarray:
        out = np.zeros((count, VIEWS), np.float32)
        out[known] = light[known] / mean[known, None] - 1
        return out[own]

    return over_mean(whole), over_mean(seen)
