"""Node trees of lamps and worlds, as far as they do not depend on where they are evaluated."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.surfaces.textures import TexturePool
from ..materials.builder import Constant, Program
from ..materials.registry import Unsupported
from ..materials.tree import Context, Fading, Scope


class _NoBaker:
    """Lamps and worlds have no surface to bake on."""

    def bake(self, scope: Scope, socket: bpy.types.NodeSocket) -> np.ndarray:
        raise Unsupported("it varies")


@dataclass(frozen=True)
class Shader:
    """A shader node and the tree or group it stands in."""

    scope: Scope
    node: bpy.types.Node

    def source(self, name: str) -> Shader | None:
        """The node that feeds an input, None where nothing does."""
        found = self.scope.source(self.node.inputs[name])
        return Shader(found.scope, found.socket.node) if found is not None and found.is_computed else None

    def constant(self, name: str) -> np.ndarray | None:
        """(3,) float64 value of an input (a number three times), None where it is not known to be constant."""
        try:
            value = self.scope.read(self.node.inputs[name])
        except Unsupported:
            return None
        return np.array(value.rgb, np.float64) if isinstance(value, Constant) else None

    def emission(self) -> np.ndarray | None:
        """(3,) colour times strength of an Emission or Background node, None where it is not constant."""
        if self.node.type not in ("EMISSION", "BACKGROUND"):
            return None
        color, strength = self.constant("Color"), self.constant("Strength")
        return None if color is None or strength is None else color * strength


def node_tree(data: bpy.types.Light | bpy.types.World) -> bpy.types.ShaderNodeTree | None:
    """The tree that Cycles evaluates, None where nodes are off (from Blender 5.0 on they never are)."""
    return data.node_tree if bpy.app.version >= (5, 0) or data.use_nodes else None


def faded_emission(light: bpy.types.Light) -> tuple[np.ndarray | None, tuple[float, float]]:
    """(3,) emission of a lamp's nodes, None where it is not known, and its falloff as `core.scene.Lamps` has it.

    Known is what is constant, and what is in proportion to Light Falloff nodes that are all alike.
    """
    values = []
    for strength in (1.0, 0.0, 2.0):
        fading = Fading(strength)
        shader = surface(light, fading)
        value = np.zeros(3) if shader is None else shader.emission()
        if value is None or not fading.found:
            return value, (0.0, 0.0)
        values.append(value)
    own, none, double = values
    if fading.found == {(0.0, 0.0)}:
        return own, (0.0, 0.0)
    proportional = len(fading.found) == 1 and not none.any() and np.allclose(double, 2 * own)
    return (own, fading.found.pop()) if proportional else (None, (0.0, 0.0))


def surface(data: bpy.types.Light | bpy.types.World, fading: Fading | None = None) -> Shader | None:
    """The node that feeds the surface of the tree's output, None where nothing does: that is black."""
    tree = node_tree(data)
    output = tree.get_output_node("CYCLES")
    if output is None:
        return None
    context = Context(data, Program(), TexturePool(), [], _NoBaker(), fading=fading, is_lamp=isinstance(data, bpy.types.Light))
    scope = Scope(context, tree)
    return Shader(scope, output).source("Surface")
