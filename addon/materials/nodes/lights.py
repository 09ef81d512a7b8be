"""Nodes that lamps have beside those of materials."""

from __future__ import annotations

import math
from pathlib import Path

import bpy

from ....core.surfaces import ies, textures
from ....core.surfaces import program as ops
from ..builder import ZERO, Constant, Value, scalar
from ..registry import Unsupported, value
from ..requests import LOCAL_INCOMING, NORMAL
from ..tree import NodeInput

_EXPONENTS = {"Quadratic": 0.0, "Linear": 1.0, "Constant": 2.0}


@value("ShaderNodeLightFalloff")
def light_falloff(node: NodeInput, output: str) -> Value:
    """Light Falloff: 'Quadratic' is the strength; what the others, and smoothing, make of it with the distance is put down for lamps."""
    strength, smooth, fading = node["Strength"], node["Smooth"], node.context.fading
    if fading is None:
        if output == "Quadratic" and smooth == ZERO:
            return strength
        raise Unsupported(f"Light Falloff's '{output}' depends on the distance")
    if not isinstance(strength, Constant) or not isinstance(smooth, Constant):
        raise Unsupported("Light Falloff has inputs that vary")
    fading.found.add((_EXPONENTS[output], max(0.0, smooth.rgb[0])))
    return scalar(strength.rgb[0] * fading.strength)


@value("ShaderNodeTexIES")
def ies_texture(node: NodeInput, output: str) -> Value:
    """IES Texture, of a file or a text."""
    try:
        text = _ies_text(node.node)
        lamp = ies.parse(text)
    except (OSError, ies.BadIes) as reason:
        node.warn(f"its IES file cannot be read ({reason}): it shines as Cycles' own mark for that, {ies.UNREADABLE:.0f}")
        return node.multiply(node["Strength"], scalar(ies.UNREADABLE))
    continued = bpy.app.version >= (5, 0)
    index = node.context.textures.add(("ies", text), lambda: ies.image(lamp, continued=continued), textures.EXTEND, textures.LINEAR, 0)
    if node.linked("Vector"):
        direction = node["Vector"]
    else:
        direction = node.program.attribute(LOCAL_INCOMING if node.context.is_lamp else NORMAL)
    about = node.math("ARCTAN2", node.splat(direction, 0), node.splat(direction, 1))
    about = node.math("MULTIPLY_ADD", about, scalar(0.5 / math.pi), scalar(0.5))
    down = node.splat(node.vector("NORMALIZE", direction), 2)
    down = node.math("MULTIPLY_ADD", node.math("ARCCOSINE", node.clamp(down, scalar(-1), scalar(1))), scalar(-1 / math.pi), scalar(1))
    return node.multiply(node["Strength"], node.splat(node.emit(ops.TEXTURE, node.pack(about, down), p=index), 0))


def _ies_text(node: bpy.types.ShaderNodeTexIES) -> str:
    if node.mode == "INTERNAL":
        if node.ies is None:
            raise ies.BadIes("no text is chosen")
        return node.ies.as_string()
    library = node.id_data.library
    return Path(bpy.path.abspath(node.filepath, library=library)).read_text(encoding="utf-8", errors="replace")
