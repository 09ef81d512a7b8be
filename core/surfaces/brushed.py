"""Which materials reflect mostly by a lobe, as brushed metal does: a cache of light takes all light for diffuse, and cannot tell where to they send it."""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..scene import BRUSHED, CONSTANT, GLOSSY_LOBE, MaterialTables
from .layout import DIFFUSE, GLOSSY_F0, ROUGHNESS, SURFACE
from .program import MEAN_VIEW, evaluate, new_registers

BRUSHED_ROUGHNESS = np.float32(0.6)  # below it such a lobe shows more than a cell of the cache could tell
LOOKS = 64  # triangles of a textured material that are looked at
_0 = np.float32(0.0)


@inlined
def is_brushed(surface):
    """Whether a surface (row of `layout`) reflects mostly by a lobe, narrow enough to show more than the cache could tell."""
    if not surface[ROUGHNESS] < BRUSHED_ROUGHNESS:
        return False
    glossy = diffuse = _0
    for c in range(3):
        glossy += surface[GLOSSY_F0 + c]
        diffuse += surface[DIFFUSE + c]
    return glossy > diffuse


@kernel
def _look(materials, attributes, material, step, found):
    """Adds up in `found` (M,) how many of every `step[m]`-th triangle's centres are brushed, and how many are not are taken off."""
    seen = np.zeros(len(found), np.int64)
    surface, rows = np.zeros(SURFACE, np.float32), new_registers(materials)
    third = np.float32(1 / 3)
    for triangle in range(len(material)):
        m = material[triangle]
        if step[m] == 0:
            continue
        if seen[m] % step[m] == 0:
            evaluate(materials, m, attributes, triangle, third, third, np.float32(MEAN_VIEW), rows, surface)
            found[m] += 1 if is_brushed(surface) else -1
        seen[m] += 1


@kernel
def _look_at_constant(constant, found):
    for m in range(len(found)):
        found[m] = 1 if is_brushed(constant[m]) else 0


def with_brushed(materials: MaterialTables, material: np.ndarray, attributes: np.ndarray) -> MaterialTables:
    """The tables with `BRUSHED` set where a material `is_brushed`; a textured one is where most of the places looked at are.

    material: (T,) int32, of the triangles.  attributes: (K, T, 3, 4) float32.
    """
    found = np.zeros(len(materials.flags), np.int64)
    _look_at_constant(materials.constant, found)
    textured = (materials.flags & CONSTANT == 0) & (materials.flags & GLOSSY_LOBE > 0)
    found[materials.flags & CONSTANT == 0] = 0
    if textured.any():
        count = np.bincount(material, minlength=len(found))
        _look(materials, attributes, material, np.where(textured, -(-count // LOOKS), 0), found)
    others = materials.flags & ~np.int32(BRUSHED)
    return materials._replace(flags=np.where(found > 0, others | np.int32(BRUSHED), others).astype(materials.flags.dtype))
