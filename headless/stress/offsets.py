"""Scenes far from the world's origin, through Blender: extraction takes the offset off in float64."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from ...core.scene import Scene
from ...core.stages import AVAILABLE
from ..sources import extract
from .outcome import Outcome
from .rooms import irradiance, light, room_mesh
from .scales import near

# Powers of two of metres, up to a million times the size of a room of 2 m: Blender's own float32 matrices hold the lamp's and camera's places exactly.
OFFSETS = tuple(2.0**k for k in (4, 8, 12, 16, 20, 21))


def offset_room(offset: float) -> Scene:
    """The stress room with all objects moved by `offset` along x and y, extracted."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    vertices, triangles, material = room_mesh()
    mesh = bpy.data.meshes.new("Room")
    mesh.from_pydata(np.asarray(vertices).tolist(), [], np.asarray(triangles).tolist())
    for i, grey in enumerate((0.7, 0.6, 0.5, 0.4)):
        paint = bpy.data.materials.new(f"Grey {i}")
        paint.diffuse_color = (grey, grey, grey, 1)
        mesh.materials.append(paint)
    mesh.polygons.foreach_set("material_index", np.asarray(material, np.int32))
    bulb = bpy.data.lights.new("Bulb", "POINT")
    bulb.energy, bulb.shadow_soft_size = 100.0, 0.0
    for name, data, place in (
        ("Room", mesh, (0, 0, 0)),
        ("Bulb", bulb, (0.5, 0.25, 0.5)),
        ("Camera", bpy.data.cameras.new("Camera"), (0, 0, 0.75)),
    ):
        thing = bpy.data.objects.new(name, data)
        thing.location = np.add(place, (offset, offset, 0))
        scene.collection.objects.link(thing)
    scene.camera = scene.objects["Camera"]
    scene.camera.data.angle = 1.5
    return extract(scene, camera=None, size=(24, 16), frame=None)


def offsets() -> Iterator[Outcome]:
    """The light of the moved room by every method."""
    scene = offset_room(0.0)
    whole = {method: irradiance(light(scene, method)) for method in AVAILABLE}
    for offset in OFFSETS:
        scene = offset_room(offset)
        for method in AVAILABLE:
            yield near(f"room {offset:g} m from the origin: irradiance", method, irradiance(light(scene, method)), whole[method], 0.001)
