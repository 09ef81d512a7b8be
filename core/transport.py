"""All tables that a light path reads, in one argument for the kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .references import Reference
from .scene import TRANSLUCENT, Geometry, MaterialTables


class Transport(NamedTuple):
    """What a kernel needs to trace, evaluate surfaces and sample lamps.

    rays: `RayScene.tables`.  vertices, triangles, corner_normals, attributes, material, object,
    object_visibility: as in `Geometry`.  materials: `MaterialTables`.  emitters: `lamps.Emitters`.
    """

    rays: tuple
    vertices: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray
    attributes: np.ndarray
    material: np.ndarray
    object: np.ndarray
    object_visibility: np.ndarray
    materials: MaterialTables
    emitters: tuple


def transport(geometry: Geometry, materials: MaterialTables, rays, emitters) -> Transport:
    """The tables of a scene whose rays and emitters are built."""
    g = geometry
    return Reference(
        Transport(
            rays,
            g.vertices,
            g.triangles,
            g.corner_normals,
            g.attributes,
            g.material,
            g.object,
            g.object_visibility.astype(np.uint32),
            materials,
            emitters,
        )
    )


def is_translucent(scene: Transport) -> bool:
    """Whether any material lets light through diffusely."""
    return bool((scene.materials.flags & TRANSLUCENT).any())
