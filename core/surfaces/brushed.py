"""Brushed metal and the like: surfaces that reflect mostly by a lobe, of which a cache of light that knows no directions tells too little."""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..scene import BRUSHED, CONSTANT, GLOSSY_LOBE, METAL, Geometry, MaterialTables
from .layout import DIFFUSE, GLOSSY_F0, ROUGHNESS
from .places import some_surfaces

ROUGHEST = np.float32(0.6)  # roughness of what shows more than the cache could tell, which takes all of it as diffuse
# Times its diffuse albedo that the lobe of metal reflects: gather rays follow it, and lose some percent of what a mixture sends (-4 % in a closed
# room of half metal).
MOSTLY = np.float32(4.0)
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@inlined
def is_brushed(surface, times=_1):
    """Whether a surface (row of `surfaces.layout`) reflects more by a lobe no rougher than `ROUGHEST` than so many times what is diffuse."""
    if not surface[ROUGHNESS] < ROUGHEST:
        return False
    glossy = diffuse = _0
    for c in range(3):
        glossy += surface[GLOSSY_F0 + c]
        diffuse += surface[DIFFUSE + c]
    return glossy > times * diffuse


@kernel
def _count_brushed(surfaces, owner, count):
    """Adds to `count` (M, 3) how many of the surfaces (N, SURFACE) of each material there are, are brushed, and are metal."""
    for i in range(len(surfaces)):
        count[owner[i], 0] += 1
        count[owner[i], 1] += is_brushed(surfaces[i], _1)
        count[owner[i], 2] += is_brushed(surfaces[i], MOSTLY)


def with_brushed(materials: MaterialTables, geometry: Geometry, threads: int = 0) -> MaterialTables:
    """The tables with `BRUSHED` and `METAL` set where a material `is_brushed`: textured ones at most of the places that are looked at.

    It is told of materials, not of places, for several estimators share what they find by it and must agree.
    """
    constant = materials.flags & CONSTANT > 0
    textured = (materials.flags & GLOSSY_LOBE > 0) & ~constant
    count = np.zeros((len(materials.flags), 3), np.int64)
    alike = np.flatnonzero(constant)
    _count_brushed(np.ascontiguousarray(materials.constant[alike], np.float32), alike, count)
    if textured.any():
        _count_brushed(*some_surfaces(materials, geometry.material, geometry.attributes, textured, threads), count)
    whole, brushed, metal = count.T
    flags = np.int32(BRUSHED) * (2 * brushed > whole) | np.int32(METAL) * (2 * metal > whole)
    return materials._replace(flags=materials.flags & ~np.int32(BRUSHED | METAL) | flags)
