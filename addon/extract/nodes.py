"""Reading of node trees whose result does not depend on where they are evaluated."""

from __future__ import annotations

import bpy
import numpy as np

_MATH = {"ADD": np.add, "SUBTRACT": np.subtract, "MULTIPLY": np.multiply, "POWER": np.power, "MINIMUM": np.minimum, "MAXIMUM": np.maximum}


def node_tree(data: bpy.types.Light | bpy.types.World) -> bpy.types.ShaderNodeTree | None:
    """The tree that Cycles evaluates, None where nodes are off (from Blender 5.0 on they never are)."""
    return data.node_tree if bpy.app.version >= (5, 0) or data.use_nodes else None


def surface_node(tree: bpy.types.ShaderNodeTree) -> bpy.types.Node | None:
    """The node that feeds the surface of the output which Cycles renders; None where nothing does."""
    output = tree.get_output_node("CYCLES")
    link = source(output.inputs["Surface"]) if output is not None else None
    return link.from_node if link is not None else None


def source(socket: bpy.types.NodeSocket) -> bpy.types.NodeLink | None:
    """The valid link into an input, followed back through reroutes."""
    while socket.is_linked:
        link = socket.links[0]
        if link.is_muted or not link.is_valid:
            return None
        if link.from_node.type != "REROUTE":
            return link
        socket = link.from_node.inputs[0]
    return None


def constant(socket: bpy.types.NodeSocket) -> np.ndarray | None:
    """The value of an input as a float64 array of shape () or (3,), None where it is not known to be constant."""
    link = source(socket)
    if link is None:
        return _value(socket)
    node = link.from_node
    if node.mute:
        return None
    if node.type in ("RGB", "VALUE"):
        return _value(node.outputs[0])
    if node.type == "LIGHT_FALLOFF" and link.from_socket.name == "Quadratic":
        smooth = constant(node.inputs["Smooth"])
        return constant(node.inputs["Strength"]) if smooth is not None and smooth == 0 else None
    if node.type == "MATH" and node.operation in _MATH and not node.use_clamp:
        a, b = (constant(i) for i in node.inputs[:2])
        return None if a is None or b is None else _MATH[node.operation](a.mean(), b.mean())
    return None


def constant_emission(node: bpy.types.Node | None) -> np.ndarray | None:
    """(3,) colour times strength of an Emission or Background node (zeros for no node), None where it is not constant."""
    if node is None:
        return np.zeros(3)
    if node.type not in ("EMISSION", "BACKGROUND") or node.mute:
        return None
    color, strength = constant(node.inputs["Color"]), constant(node.inputs["Strength"])
    return None if color is None or strength is None else np.broadcast_to(color, 3) * strength.mean()


def _value(socket: bpy.types.NodeSocket) -> np.ndarray:
    return np.array(socket.default_value, np.float64)[..., :3] if socket.type == "RGBA" else np.array(socket.default_value, np.float64)
