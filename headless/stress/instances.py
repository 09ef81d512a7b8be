"""A million instances, through Blender: extraction copies each, and the light of the room stays what it was."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from ...core.scene import Scene
from ...core.stages import AVAILABLE
from ..sources import extract
from .broken import BLOCK_LIGHT
from .offsets import offset_room
from .outcome import Outcome
from .rooms import irradiance, light
from .scales import near

INSTANCES = 1_000_000
_SIDE = 0.2  # metres: of the cube in which they lie, beyond a corner of the room


def crowded_room(count: int) -> Scene:
    """The stress room, and one small triangle instanced on `count` vertices outside of it, extracted."""
    offset_room(0.0)
    scene = bpy.context.scene
    cloud = bpy.data.meshes.new("Cloud")
    cloud.from_pydata(np.random.default_rng(1).uniform(1.1, 1.1 + _SIDE, (count, 3)), [], [])
    speck = bpy.data.meshes.new("Speck")
    speck.from_pydata([(0, 0, 0), (1e-3, 0, 0), (0, 1e-3, 0)], [], [(0, 1, 2)])
    parent, child = bpy.data.objects.new("Cloud", cloud), bpy.data.objects.new("Speck", speck)
    parent.instance_type, child.parent = "VERTS", parent
    for thing in (parent, child):
        scene.collection.objects.link(thing)
    return extract(scene, camera=None, size=(24, 16), frame=None)


def instances(count: int = INSTANCES) -> Iterator[Outcome]:
    """The light of the room with its crowd by every method."""
    empty, crowded = offset_room(0.0), crowded_room(count)
    more = len(crowded.geometry.triangles) - len(empty.geometry.triangles)
    yield Outcome(f"{count:,} instances: triangles extracted", "all", f"{count}", more, more == count)
    for method in AVAILABLE:
        whole = irradiance(light(empty, method))
        yield near(f"{count:,} instances: irradiance", method, irradiance(light(crowded, method)), whole, BLOCK_LIGHT)
