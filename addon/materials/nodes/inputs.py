"""Input nodes: constants, attributes, geometry, the view."""

from __future__ import annotations

from ....core.scene import CAMERA, DIFFUSE, GLOSSY, SHADOW, TRANSMISSION
from ....core.surfaces import program as ops
from ..builder import ONE, ZERO, Constant, Value, scalar
from ..properties import found_property
from ..registry import Unsupported, value
from ..requests import (
    ATTRIBUTE,
    COLOR,
    FACE_NORMAL,
    GENERATED,
    INCOMING,
    INSTANCER_ATTRIBUTE,
    INSTANCER_GENERATED,
    INSTANCER_UV,
    INTERCEPT,
    IS_STRAND,
    LENGTH,
    NORMAL,
    OBJECT,
    OBJECT_ATTRIBUTE,
    OBJECT_COLOR,
    OBJECT_INDEX,
    OBJECT_LOCATION,
    OBJECT_RANDOM,
    PARAMETRIC,
    RANDOM,
    THICKNESS,
    UV,
    WORLD_NORMAL,
    WORLD_POSITION,
)
from ..tree import NodeInput

_OF_HAIR = {"Is Strand": IS_STRAND, "Intercept": INTERCEPT, "Length": LENGTH, "Thickness": THICKNESS, "Random": RANDOM}


@value("ShaderNodeValue")
def number(node: NodeInput, output: str) -> Value:
    """Value."""
    return scalar(node.node.outputs[0].default_value)


@value("ShaderNodeRGB")
def rgb(node: NodeInput, output: str) -> Value:
    """RGB."""
    return Constant(*node.node.outputs[0].default_value)


@value("ShaderNodeUVMap")
def uv_map(node: NodeInput, output: str) -> Value:
    """UV Map."""
    if node.node.from_instancer:
        return node.program.attribute(INSTANCER_UV)
    return node.program.attribute(UV, node.node.uv_map)


@value("ShaderNodeTexCoord")
def texture_coordinate(node: NodeInput, output: str) -> Value:
    """Texture Coordinate, but for Reflection."""
    if node.node.from_instancer and output in ("Generated", "UV"):
        return node.program.attribute(INSTANCER_GENERATED if output == "Generated" else INSTANCER_UV)
    if output == "UV":
        return node.program.attribute(UV)
    if output == "Generated":
        return node.program.attribute(GENERATED)
    if output == "Normal":
        return node.program.attribute(NORMAL)
    if output == "Object":
        other = node.node.object
        return node.program.attribute(OBJECT, other.name if other else "")
    if output == "Camera":
        return _camera_position(node)
    if output == "Window":
        shot, at = node.context.shot, _camera_position(node)
        left, right, bottom, top = shot.window
        if not shot.orthographic:
            at = node.vector("DIVIDE", at, node.splat(at, 2))
        scale = Constant(1 / (right - left), 1 / (top - bottom), 0.0)
        return node.vector("MULTIPLY_ADD", at, scale, Constant(-left * scale.x, -bottom * scale.y, 0.0))
    raise Unsupported(f"node '{node.node.name}' reads the output '{output}' of Texture Coordinate, which depends on the view")


def _camera_position(node: NodeInput) -> Value:
    """The point as the camera has it: to the right, up, and away from it (m)."""
    if not node.context.shot.camera or node.context.is_lamp:
        raise Unsupported(f"node '{node.node.name}' asks for the camera, and there is none that stays where it is")
    return node.vector("MULTIPLY", node.program.attribute(OBJECT, node.context.shot.camera), Constant(1.0, 1.0, -1.0))


@value("ShaderNodeCameraData")
def camera_data(node: NodeInput, output: str) -> Value:
    """Camera Data."""
    at = _camera_position(node)
    if output == "View Vector":
        return node.vector("NORMALIZE", at)
    return node.splat(at, 2) if output == "View Z Depth" else node.vector("LENGTH", at)


@value("ShaderNodeAttribute")
def attribute(node: NodeInput, output: str) -> Value:
    """Attribute: of the geometry, the object or its instancer."""
    kind, name = node.node.attribute_type, node.node.attribute_name
    if kind == "VIEW_LAYER":
        found = Constant(*found_property(name, *node.context.shot.owners))
        return node.emit(ops.AVERAGE, found) if output == "Fac" else node.splat(found, 3) if output == "Alpha" else found
    if kind == "GEOMETRY":
        read = node.program.attribute(ATTRIBUTE, name)
    else:
        read = node.program.attribute(OBJECT_ATTRIBUTE if kind == "OBJECT" else INSTANCER_ATTRIBUTE, name)
    if output == "Fac":
        # Cycles reads the first component of a UV map, the mean of anything else.
        is_uv = any(name in getattr(o.data, "uv_layers", ()) for o in node.context.objects)
        return node.splat(read, 0) if is_uv else node.emit(ops.AVERAGE, read)
    return node.splat(read, 3) if output == "Alpha" else read


@value("ShaderNodeVertexColor")
def color_attribute(node: NodeInput, output: str) -> Value:
    """Color Attribute."""
    read = node.program.attribute(COLOR, node.node.layer_name)
    return node.splat(read, 3) if output == "Alpha" else read


@value("ShaderNodeObjectInfo")
def object_info(node: NodeInput, output: str) -> Value:
    """Object Info."""
    if output == "Location":
        return node.program.attribute(OBJECT_LOCATION)
    if output in ("Color", "Alpha"):
        read = node.program.attribute(OBJECT_COLOR)
        return node.splat(read, 3) if output == "Alpha" else read
    if output == "Object Index":
        return node.program.attribute(OBJECT_INDEX)
    if output == "Random":
        return node.program.attribute(OBJECT_RANDOM)
    return scalar(node.context.material.pass_index)


@value("ShaderNodeHairInfo")
def hair_info(node: NodeInput, output: str) -> Value:
    """Hair Info; all is 0 on what is no hair, as in Cycles."""
    if output not in _OF_HAIR:
        raise Unsupported(f"node '{node.node.name}' reads the output '{output}' of Hair Info")
    return node.program.attribute(ATTRIBUTE, _OF_HAIR[output])


@value("ShaderNodePointInfo")
def point_info(node: NodeInput, output: str) -> Value:
    """Point Info; all is 0 on what is no point, as in Cycles."""
    if output == "Position":  # of the ball's surface, not its centre
        return node.program.attribute(WORLD_POSITION)
    read = node.program.attribute(ATTRIBUTE, THICKNESS if output == "Radius" else RANDOM)
    return node.multiply(read, scalar(0.5)) if output == "Radius" else read


@value("ShaderNodeNewGeometry")
def geometry(node: NodeInput, output: str) -> Value:
    """Geometry; Tangent, Pointiness and Random Per Island are not known to the core, Incoming and Parametric of lamps alone."""
    if output == "Position":
        return node.program.attribute(WORLD_POSITION)
    if output == "Normal":
        return node.program.attribute(WORLD_NORMAL)
    if output == "True Normal":
        return node.program.attribute(FACE_NORMAL)
    if output == "Backfacing":
        return node.emit(ops.BACKFACING)
    if node.context.is_lamp and output in ("Incoming", "Parametric"):
        return node.program.attribute(INCOMING if output == "Incoming" else PARAMETRIC)
    raise Unsupported(f"node '{node.node.name}' reads the output '{output}' of Geometry")


@value("ShaderNodeFresnel")
def fresnel(node: NodeInput, output: str) -> Value:
    """Fresnel; of the shading normal, a linked normal is left out."""
    if node.linked("Normal"):
        node.warn("Fresnel uses the surface's own normal")
    return node.emit(ops.FRESNEL, node["IOR"])


@value("ShaderNodeLayerWeight")
def layer_weight(node: NodeInput, output: str) -> Value:
    """Layer Weight (Cycles: svm_node_layer_weight)."""
    if node.linked("Normal"):
        node.warn("Layer Weight uses the surface's own normal")
    blend = node["Blend"]
    if output == "Fresnel":
        eta = node.math("MAXIMUM", node.complement(blend), scalar(1e-5))
        return node.emit(ops.FRESNEL, node.math("DIVIDE", ONE, eta))
    blend = node.clamp(blend, ZERO, scalar(1 - 1e-5))
    low = node.math("MULTIPLY", scalar(2), blend)
    high = node.math("DIVIDE", scalar(0.5), node.complement(blend))
    return node.emit(ops.FACING, node.emit(ops.MIX, node.math("LESS_THAN", blend, scalar(0.5)), high, low))


_ANY = CAMERA | DIFFUSE | GLOSSY | TRANSMISSION | SHADOW
# For which rays an output is 1.  Lengths and depths are those of the first bounce.
_RAYS = {
    "Is Camera Ray": CAMERA,
    "Is Diffuse Ray": DIFFUSE,
    "Is Glossy Ray": GLOSSY,
    "Is Reflection Ray": DIFFUSE | GLOSSY,
    "Is Shadow Ray": SHADOW,
    "Is Singular Ray": GLOSSY | TRANSMISSION,
    "Is Transmission Ray": TRANSMISSION,
    "Ray Length": _ANY,
    "Ray Depth": _ANY & ~CAMERA,
    "Diffuse Depth": DIFFUSE,
    "Glossy Depth": GLOSSY,
    "Transmission Depth": TRANSMISSION,
}


@value("ShaderNodeLightPath")
def light_path(node: NodeInput, output: str) -> Value:
    """Light Path, which tells the rays that the camera's view takes by mirrors and through glass, and lamps' shadow rays; all light that is reflected on is diffuse."""
    if node.context.is_lamp:  # for whose light Cycles runs them without a kind of ray
        if "Is " in output:
            return ZERO
        raise Unsupported(f"node '{node.node.name}' reads the output '{output}' of Light Path")
    rays = _RAYS.get(output, 0)
    if output not in ("Is Camera Ray", "Is Shadow Ray"):
        node.warn(
            f"Light Path ('{output}') knows what the camera sees, what mirrors and glass show it, rays of reflections and lamps' shadow rays, and takes all other rays for diffuse ones"
        )
    return node.emit(ops.VIEWED, p=rays) if rays not in (0, _ANY) else ONE if rays else ZERO
