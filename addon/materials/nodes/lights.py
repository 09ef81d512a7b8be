"""Nodes that lamps have beside those of materials."""

from __future__ import annotations

from ..builder import ZERO, Value
from ..registry import Unsupported, value
from ..tree import NodeInput


@value("ShaderNodeLightFalloff")
def light_falloff(node: NodeInput, output: str) -> Value:
    """Light Falloff: 'Quadratic' is the strength; the others, and smoothing, depend on the distance."""
    if output != "Quadratic" or node["Smooth"] != ZERO:
        raise Unsupported(f"Light Falloff's '{output}' depends on the distance")
    return node["Strength"]
