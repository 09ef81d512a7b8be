"""Procedural textures that the core computes as Cycles does."""

from __future__ import annotations

import bpy

from ....core.surfaces import outlined
from ....core.surfaces import program as ops
from ....core.surfaces.procedural import GRADIENT_KINDS
from ..builder import ZERO, Value, scalar
from ..registry import value
from ..requests import GENERATED
from ..tree import NodeInput


def _point(node: NodeInput) -> Value:
    """The texture's coordinates, moved by its own (hidden) mapping where a file has one."""
    return node["Vector"] if node.linked("Vector") else node.program.attribute(GENERATED)


@value("ShaderNodeTexChecker")
def checker(node: NodeInput, output: str) -> Value:
    """Checker Texture."""
    at = node.vector("MULTIPLY", _point(node), node["Scale"])
    cell = node.emit(outlined.CHECKER, at, node["Color1"], node["Color2"])
    return cell if output == "Color" else node.splat(cell, 3)


@value("ShaderNodeTexGradient")
def gradient(node: NodeInput, output: str) -> Value:
    """Gradient Texture."""
    return node.emit(outlined.GRADIENT, _point(node), p=GRADIENT_KINDS.index(node.node.gradient_type))


def _dimensions(node: NodeInput) -> int:
    return int(node.node.noise_dimensions[0])


@value("ShaderNodeTexWhiteNoise")
def white_noise(node: NodeInput, output: str) -> Value:
    """White Noise Texture."""
    dimensions = _dimensions(node)
    at = node["Vector"] if dimensions > 1 else ZERO  # the only texture without coordinates of its own
    w = node["W"] if dimensions in (1, 4) else ZERO
    noise = node.emit(outlined.WHITE_NOISE, at, w, p=dimensions)
    return noise if output == "Color" else node.splat(noise, 3)


@value("ShaderNodeTexNoise")
def noise(node: NodeInput, output: str) -> Value:
    """Noise Texture, of every type and dimension."""
    dimensions = _dimensions(node)
    scale = node["Scale"]
    at = node.vector("MULTIPLY", _point(node), scale) if dimensions > 1 else ZERO
    w = node.math("MULTIPLY", node["W"], scale) if dimensions in (1, 4) else ZERO
    at = node.pack(node.splat(at, 0), node.splat(at, 1), node.splat(at, 2), w)
    shape = node.pack(node["Detail"], node["Roughness"], node["Lacunarity"], node["Offset"])
    colored = output == "Color"
    p = outlined.noise_parameter(node.node.noise_type, node.node.normalize, dimensions, colored)
    result = node.emit(outlined.NOISE, at, shape, node.pack(node["Gain"], node["Distortion"]), p=p)
    return result if colored else node.splat(result, 0)


@value("ShaderNodeTexVoronoi")
def voronoi(node: NodeInput, output: str) -> Value:
    """Voronoi Texture, of every feature, metric and dimension."""
    settings = node.node
    dimensions = int(settings.voronoi_dimensions[0])
    feature = settings.feature
    scale = node["Scale"]
    at = node.vector("MULTIPLY", _point(node), scale) if dimensions > 1 else ZERO
    w = node.math("MULTIPLY", node["W"], scale) if dimensions in (1, 4) else ZERO
    at = node.pack(node.splat(at, 0), node.splat(at, 1), node.splat(at, 2) if dimensions > 2 else ZERO, w)
    shape = node.pack(node["Detail"], node["Roughness"], node["Lacunarity"], node["Smoothness"])
    metric = settings.distance if dimensions > 1 and feature in ("F1", "F2", "SMOOTH_F1") else "EUCLIDEAN"
    wanted = "Position" if output == "W" else output
    p = outlined.voronoi_parameter(feature, metric, dimensions, settings.normalize, wanted, bpy.app.version < (5, 0))
    found = node.emit(outlined.VORONOI, at, shape, node.pack(node["Exponent"], node["Randomness"]), p=p)
    if output == "W":
        return node.math("DIVIDE", node.splat(found, 3), scale)
    return node.vector("DIVIDE", found, scale) if output == "Position" else found


_DIRECTIONS = {"X": 0, "Y": 1, "Z": 2, "DIAGONAL": 3, "SPHERICAL": 3}
_PROFILES = {"SIN": 0, "SAW": 1, "TRI": 2}


@value("ShaderNodeTexWave")
def wave(node: NodeInput, output: str) -> Value:
    """Wave Texture."""
    rings = node.node.wave_type == "RINGS"
    direction = node.node.rings_direction if rings else node.node.bands_direction
    at = node.vector("MULTIPLY", _point(node), node["Scale"])
    shape = node.pack(node["Distortion"], node["Detail"], node["Detail Scale"], node["Detail Roughness"])
    p = rings + 2 * _DIRECTIONS[direction] + 8 * _PROFILES[node.node.wave_profile]
    return node.emit(outlined.WAVE, at, shape, node["Phase Offset"], p=p)


@value("ShaderNodeTexMagic")
def magic(node: NodeInput, output: str) -> Value:
    """Magic Texture; from Blender 5 on the scale is applied before the coordinates are wrapped, not after."""
    at, scale = _point(node), node["Scale"]
    if bpy.app.version >= (5, 0):
        at, scale = node.vector("MULTIPLY", at, scale), scalar(1)
    color = node.emit(outlined.MAGIC, at, node.pack(scale, node["Distortion"]), p=node.node.turbulence_depth)
    return color if output == "Color" else node.emit(ops.AVERAGE, color)


@value("ShaderNodeTexBrick")
def brick(node: NodeInput, output: str) -> Value:
    """Brick Texture."""
    settings = node.node
    at = node.vector("MULTIPLY", _point(node), node["Scale"])
    mortar = node.pack(node["Mortar Size"], node["Mortar Smooth"], node["Bias"], node["Brick Width"])
    rows = node.pack(node["Row Height"], scalar(settings.offset), scalar(settings.squash))
    bricks = node.emit(outlined.BRICK, at, mortar, rows, p=settings.offset_frequency + 256 * settings.squash_frequency)
    share = node.splat(bricks, 1)
    if output == "Fac":
        return share
    color = node.emit(ops.MIX, node.splat(bricks, 0), node["Color1"], node["Color2"])
    return node.emit(ops.MIX, share, color, node["Mortar"])
