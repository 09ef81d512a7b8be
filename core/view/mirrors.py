"""Which materials may mirror: only at those need a primary sample ask for more than it hits."""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..scene import ANGLED, CONSTANT, GLOSSY_LOBE, MIRRORING, TRANSPARENT, Geometry, MaterialTables, Scene
from ..surfaces.layout import GLOSSY_F0, GLOSSY_F90, ROUGHNESS, SURFACE
from ..surfaces.lobes import NEGLIGIBLE
from ..surfaces.program import MEAN_VIEW, evaluate, new_registers
from .tile import POLISHED

LOOKS = 64  # triangles of a textured material that are looked at


@kernel
def _is_polished(surface):
    shine = np.float32(0)
    for c in range(3):
        shine = max(shine, surface[GLOSSY_F0 + c], surface[GLOSSY_F90 + c])
    return shine > NEGLIGIBLE and surface[ROUGHNESS] <= POLISHED


@kernel
def _look(materials, attributes, material, step, found):
    """Sets `found` (M,) of the textured materials that are polished at the centre of every `step[m]`-th triangle."""
    seen = np.zeros(len(found), np.int64)
    surface, rows = np.zeros(SURFACE, np.float32), new_registers(materials)
    third = np.float32(1 / 3)
    for triangle in range(len(material)):
        m = material[triangle]
        if step[m] == 0 or found[m]:
            continue
        if seen[m] % step[m] == 0:
            for view in (np.float32(MEAN_VIEW), np.float32(-MEAN_VIEW)):
                if view > np.float32(0) or (materials.flags[m] & ANGLED and not found[m]):
                    evaluate(materials, m, attributes, triangle, third, third, view, rows, surface)
                    found[m] = _is_polished(surface)
        seen[m] += 1


def with_mirrors(materials: MaterialTables, geometry: Geometry) -> MaterialTables:
    """The tables with `MIRRORING` set where a material may mirror: opaque ones with a lobe no rougher than `POLISHED`, for textured ones somewhere.

    A textured one is looked at in some places; where it mirrors elsewhere only, its lobe is sampled as any other.
    """
    lobes = (materials.flags & GLOSSY_LOBE > 0) & (materials.flags & TRANSPARENT == 0)
    constant = materials.flags & CONSTANT > 0
    found = np.array([_is_polished(surface) for surface in materials.constant], bool) & lobes & constant
    textured = lobes & ~constant
    if textured.any():
        count = np.bincount(geometry.material, minlength=len(found))
        step = np.where(textured, -(-count // LOOKS), 0)
        _look(materials, geometry.attributes, geometry.material, step, found)
    return materials._replace(flags=materials.flags | np.int32(MIRRORING) * found)


def has_mirrors(scene: Scene) -> bool:
    """Whether the camera may see in a mirror what does not lie in its view."""
    return bool((with_mirrors(scene.materials.tables, scene.geometry).flags & MIRRORING).any())
