"""Brushed metal and the like: surfaces that reflect mostly by a lobe, of which a cache of light that knows no directions tells too little."""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..scene import BRUSHED, CONSTANT, GLOSSY_LOBE, Geometry, MaterialTables
from .layout import DIFFUSE, GLOSSY_F0, ROUGHNESS
from .places import some_surfaces

ROUGHEST = np.float32(0.6)  # roughness of what shows more than the cache could tell, which takes all of it as diffuse
_0 = np.float32(0.0)


@inlined
def is_brushed(surface):
    """Whether a surface (row of `surfaces.layout`) reflects mostly by a lobe no rougher than `ROUGHEST`."""
    if not surface[ROUGHNESS] < ROUGHEST:
        return False
    glossy = diffuse = _0
    for c in range(3):
        glossy += surface[GLOSSY_F0 + c]
        diffuse += surface[DIFFUSE + c]
    return glossy > diffuse


@kernel
def _count_brushed(surfaces, owner, count):
    """Adds to `count` (M, 2) how many of the surfaces (N, SURFACE) of each material are brushed, and how many there are."""
    for i in range(len(surfaces)):
        count[owner[i], 0] += is_brushed(surfaces[i])
        count[owner[i], 1] += 1


def with_brushed(materials: MaterialTables, geometry: Geometry, threads: int = 0) -> MaterialTables:
    """The tables with `BRUSHED` set where a material `is_brushed`: textured ones at most of the places that are looked at.

    It is told of materials, not of places, for several estimators share what they find by it and must agree.
    """
    constant = materials.flags & CONSTANT > 0
    textured = (materials.flags & GLOSSY_LOBE > 0) & ~constant
    count = np.zeros((len(materials.flags), 2), np.int64)
    alike = np.flatnonzero(constant)
    _count_brushed(np.ascontiguousarray(materials.constant[alike], np.float32), alike, count)
    if textured.any():
        _count_brushed(*some_surfaces(materials, geometry.material, geometry.attributes, textured, threads), count)
    found = 2 * count[:, 0] > count[:, 1]
    return materials._replace(flags=(materials.flags & ~np.int32(BRUSHED)) | np.int32(BRUSHED) * found)
