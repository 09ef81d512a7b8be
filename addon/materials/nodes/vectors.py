"""Vector and number nodes: Mapping, Math, Vector Math, Map Range, rotations, normals."""

from __future__ import annotations

from collections.abc import Callable

import mathutils

from ....core.surfaces import outlined
from ....core.surfaces import program as ops
from ..builder import ONE, ZERO, Constant, Table, Value, scalar
from ..registry import Unsupported, value
from ..requests import RAISED, TANGENT, UV, WORLD_NORMAL, WORLD_POSITION
from ..tree import NodeInput

# Of the largest coordinate (m): some hundred float32 roundings.
_SHORTEST = 2e-5
# Barycentric steps to the second and the third corner of a triangle.
_CORNERS = Constant(1, 0, 0), Constant(0, 1, 0)


@value("ShaderNodeMath")
def math(node: NodeInput, output: str) -> Value:
    """Math."""
    operation = node.node.operation
    result = node.math(operation, *(node[i] for i, s in enumerate(node.node.inputs) if s.enabled or operation == "COMPARE"))
    return node.clamp(result) if node.node.use_clamp else result


@value("ShaderNodeVectorMath")
def vector_math(node: NodeInput, output: str) -> Value:
    """Vector Math."""
    operation = node.node.operation
    if operation == "SCALE":
        return node.vector("MULTIPLY", node[0], node["Scale"])
    if operation == "REFRACT":
        return node.vector("REFRACT", node[0], node[1], node["Scale"])
    return node.vector(operation, *(node[i] for i in range(3) if node.node.inputs[i].enabled))


@value("ShaderNodeMapping")
def mapping(node: NodeInput, output: str) -> Value:
    """Mapping, of the four types (Cycles: svm_mapping)."""
    kind = node.node.vector_type
    at, rotation, scale = node["Vector"], node["Rotation"], node["Scale"]
    location = node["Location"] if kind in ("POINT", "TEXTURE") else ZERO
    if all(isinstance(x, Constant) for x in (rotation, scale, location)) and kind != "NORMAL" and 0 not in scale.rgb:
        return _mapping_matrix(node, kind, at, location, rotation, scale)
    if kind == "TEXTURE":
        turned = node.emit(outlined.ROTATE_EULER, node.vector("SUBTRACT", at, location), rotation, p=1)
        return node.vector("DIVIDE", turned, scale)
    if kind == "NORMAL":
        return node.vector("NORMALIZE", node.emit(outlined.ROTATE_EULER, node.vector("DIVIDE", at, scale), rotation))
    turned = node.emit(outlined.ROTATE_EULER, node.vector("MULTIPLY", at, scale), rotation)
    return node.vector("ADD", turned, location)


def _mapping_matrix(node: NodeInput, kind: str, at: Value, location: Constant, rotation: Constant, scale: Constant) -> Value:
    matrix = mathutils.Matrix.LocRotScale(mathutils.Vector(location.rgb), mathutils.Euler(rotation.rgb, "XYZ"), mathutils.Vector(scale.rgb))
    if kind == "TEXTURE":
        matrix.invert_safe()
    if matrix == mathutils.Matrix.Identity(4):
        return at
    return node.emit(ops.MATRIX, at, Table(tuple(tuple(row) for row in matrix[:3])))


@value("ShaderNodeVectorRotate")
def vector_rotate(node: NodeInput, output: str) -> Value:
    """Vector Rotate."""
    kind, invert = node.node.rotation_type, node.node.invert
    center = node["Center"]
    at = node.vector("SUBTRACT", node["Vector"], center)
    if kind == "EULER_XYZ":
        turned = node.emit(outlined.ROTATE_EULER, at, node["Rotation"], p=int(invert))
    else:
        axes = {"X_AXIS": Constant(1, 0, 0), "Y_AXIS": Constant(0, 1, 0), "Z_AXIS": Constant(0, 0, 1)}
        axis = axes[kind] if kind in axes else node["Axis"]
        angle = node["Angle"]
        turned = node.emit(outlined.ROTATE_AXIS, at, axis, node.math("SUBTRACT", ZERO, angle) if invert else angle)
    return node.vector("ADD", turned, center)


@value("ShaderNodeClamp")
def clamp(node: NodeInput, output: str) -> Value:
    """Clamp, between minimum and maximum or over a range whose ends may be swapped."""
    low, high = node["Min"], node["Max"]
    if node.node.clamp_type == "RANGE":
        low, high = node.math("MINIMUM", low, high), node.math("MAXIMUM", low, high)
    return node.clamp(node["Value"], low, high)


@value("ShaderNodeMapRange")
def map_range(node: NodeInput, output: str) -> Value:
    """Map Range, of numbers and vectors."""
    vectors = node.node.data_type == "FLOAT_VECTOR"
    keys = ("Vector", "From_Min_FLOAT3", "From_Max_FLOAT3", "To_Min_FLOAT3", "To_Max_FLOAT3", "Steps_FLOAT3")
    if not vectors:
        keys = ("Value", "From Min", "From Max", "To Min", "To Max", "Steps")
    at, from_min, from_max, to_min, to_max = (node[k] for k in keys[:5])
    kind = node.node.interpolation_type
    if not vectors and from_min == from_max:
        return ZERO
    t = node.vector("DIVIDE", node.vector("SUBTRACT", at, from_min), node.vector("SUBTRACT", from_max, from_min))
    if kind == "STEPPED":
        steps = node[keys[5]]
        counted = node.vector("FLOOR", node.vector("MULTIPLY", t, node.vector("ADD", steps, ONE)))
        t = node.vector("DIVIDE", counted, steps)
    elif kind == "SMOOTHSTEP":
        t = node.clamp(t)
        t = node.vector("MULTIPLY", node.vector("MULTIPLY", t, t), node.vector("SUBTRACT", scalar(3), node.vector("ADD", t, t)))
    elif kind == "SMOOTHERSTEP":
        t = node.clamp(t)
        inner = node.vector("MULTIPLY_ADD", t, node.vector("MULTIPLY_ADD", t, scalar(6), scalar(-15)), scalar(10))
        t = node.vector("MULTIPLY", node.vector("MULTIPLY", node.vector("MULTIPLY", t, t), t), inner)
    result = node.emit(ops.MIX, t, to_min, to_max)
    if node.node.clamp and kind in ("LINEAR", "STEPPED"):
        result = node.clamp(result, node.vector("MINIMUM", to_min, to_max), node.vector("MAXIMUM", to_min, to_max))
    return result


@value("ShaderNodeNormal")
def normal(node: NodeInput, output: str) -> Value:
    """Normal: a fixed direction, and its cosine with the input."""
    direction = Constant(*node.node.outputs["Normal"].default_value)
    direction = node.vector("NORMALIZE", direction)
    if output == "Normal":
        return direction
    return node.vector("DOT_PRODUCT", direction, node.vector("NORMALIZE", node["Normal"]))


@value("ShaderNodeNormalMap")
def normal_map(node: NodeInput, output: str) -> Value:
    """Normal Map: the shading normal in world space."""
    space = node.node.space
    surface = node.program.attribute(WORLD_NORMAL)
    encoded = node.vector("SUBTRACT", node.vector("MULTIPLY", node["Color"], scalar(2)), ONE)
    if getattr(node.node, "convention", "OPENGL") == "DIRECTX":
        encoded = node.multiply(encoded, Constant(1, -1, 1))
    strength = node["Strength"]
    if space == "TANGENT":
        tangent = node.program.attribute(TANGENT, node.node.uv_map)
        bitangent = node.multiply(node.vector("CROSS_PRODUCT", surface, tangent), node.splat(tangent, 3))
        height = node.emit(ops.MIX, node.clamp(strength), ONE, node.splat(encoded, 2))
        direction = node.multiply(surface, height)
        direction = node.vector("MULTIPLY_ADD", bitangent, node.math("MULTIPLY", node.splat(encoded, 1), strength), direction)
        direction = node.vector("MULTIPLY_ADD", tangent, node.math("MULTIPLY", node.splat(encoded, 0), strength), direction)
        return node.vector("NORMALIZE", direction)
    if space == "BLENDER_WORLD":
        encoded = node.multiply(encoded, Constant(1, -1, -1))
    elif space != "WORLD":
        raise Unsupported(f"node '{node.node.name}' is a normal map in object space")
    direction = node.vector("NORMALIZE", encoded)
    if strength == ONE:
        return direction
    return node.vector("NORMALIZE", node.emit(ops.MIX, node.math("MAXIMUM", strength, ZERO), surface, direction))


@value("ShaderNodeBump")
def bump(node: NodeInput, output: str) -> Value:
    """Bump: normals bent by a height."""
    with node.program.displaced(None):
        surface = node["Normal"] if node.linked("Normal") else node.context.normal or node.program.attribute(WORLD_NORMAL)
        strength = node.math("MAXIMUM", node["Strength"], ZERO)
        if not node.linked("Height") or strength == ZERO:
            return surface
        distance = node["Distance"]
        if node.node.invert:
            distance = node.math("SUBTRACT", ZERO, distance)
        width = node["Filter Width"] if node.has("Filter Width") else scalar(0.1)
    try:
        return bent(node, surface, lambda: node["Height"], strength, distance, width)
    except Unsupported as reason:
        node.warn(f"its bump is left out: {reason}")
        return surface


def bent(node: NodeInput, surface: Value, height_here: Callable[[], Value], strength: Value, distance: Value, width: Value) -> Value:
    """The normal `surface`, bent by a height (m, before `distance`), which is evaluated at the point and a step beside it along two tangents (see `bumps`).

    height_here: computes it where the program is.  The step is Cycles': the filter width times the size of a pixel (see `footprint`).

    Raises:
        Unsupported: the height cannot be computed.
    """
    program = node.program
    with program.displaced(None):
        # Seen from behind, the height still rises towards the viewer, while all normals are turned round.
        facing = node.math("MULTIPLY_ADD", node.emit(ops.BACKFACING), scalar(-2), ONE)
        position = program.attribute(WORLD_POSITION)
        edges = []
        for corner in _CORNERS:
            with program.displaced(corner):
                edges.append(node.vector("SUBTRACT", program.attribute(WORLD_POSITION), position))
        step = node.math("MULTIPLY", node.emit(ops.FOOTPRINT, position), width)
        # Shorter ones drown in the rounding of positions.
        largest = node.vector("ABSOLUTE", position)
        largest = node.math("MAXIMUM", node.splat(largest, 0), node.math("MAXIMUM", node.splat(largest, 1), node.splat(largest, 2)))
        step = node.math("MAXIMUM", step, node.math("MULTIPLY", largest, scalar(_SHORTEST)))
        steps = node.emit(outlined.BUMP_STEP, *edges, node.pack(step, facing))
        height = height_here()
        if isinstance(height, Constant):
            return surface
    rises = []
    for u, v in ((0, 1), (2, 3)):
        with program.displaced(node.pack(node.splat(steps, u), node.splat(steps, v))):
            rises.append(node.math("SUBTRACT", height_here(), height))
    gradient = node.emit(outlined.BUMP_GRADIENT, *edges, node.pack(*rises, step, facing))
    gradient = node.multiply(gradient, node.math("MULTIPLY", distance, facing))
    gradient = node.pack(node.splat(gradient, 0), node.splat(gradient, 1), node.splat(gradient, 2), strength)
    return node.emit(outlined.BUMP_NORMAL, surface, gradient, node.vector("CROSS_PRODUCT", *edges))


@value("ShaderNodeDisplacement")
def displacement(node: NodeInput, output: str) -> Value:
    """Displacement along the normal, as a vector in world space (Cycles: svm_node_displacement)."""
    program = node.program
    height = node.math("MULTIPLY", node.math("SUBTRACT", node["Height"], node["Midlevel"]), node["Scale"])
    with program.displaced(None):
        along = RAISED if node.node.space == "OBJECT" else WORLD_NORMAL
        normal = node["Normal"] if node.linked("Normal") else program.attribute(along)
    return node.multiply(normal, height)


@value("ShaderNodeTangent")
def tangent(node: NodeInput, output: str) -> Value:
    """Tangent of a UV map; it only steers anisotropy, which is left out."""
    if node.node.direction_type == "UV_MAP":
        return node.program.attribute(TANGENT, node.node.uv_map)
    return node.program.attribute(UV)
