"""Blender's world as a panorama of radiance."""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.scene import ALL_RAYS, World
from .lamps import Lamp
from .nodes import constant_emission, node_tree, surface_node


@dataclass
class ExtractedWorld:
    """The panorama, the suns taken out of it, and lines for the user."""

    world: World
    suns: list[Lamp] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def extract_world(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, graph: bpy.types.Depsgraph, rendering: bool) -> ExtractedWorld:
    """The world of a scene as evaluated in `graph`."""
    world = view_layer.world_override or scene.world
    if world is None:
        return ExtractedWorld(World(np.zeros((1, 1, 3), np.float32), ALL_RAYS))
    world = world.evaluated_get(graph)
    tree = node_tree(world)
    radiance = np.array(world.color) if tree is None else constant_emission(surface_node(tree))
    return ExtractedWorld(World(np.asarray(np.zeros(3) if radiance is None else radiance, np.float32).reshape(1, 1, 3), ALL_RAYS))
