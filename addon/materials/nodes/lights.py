"""Nodes that lamps have beside those of materials."""

from __future__ import annotations

from ..builder import ZERO, Constant, Value, scalar
from ..registry import Unsupported, value
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
