"""A material's displacement, shown as bumps: so does Cycles where the material's setting is Bump Only, Blender's default."""

from __future__ import annotations

import bpy

from .builder import ONE, Value, scalar
from .nodes.vectors import bent
from .registry import Unsupported
from .requests import WORLD_NORMAL
from .tree import NodeInput, Scope


def displaced_normal(scope: Scope, output: bpy.types.Node) -> Value | None:
    """The shading normal that the displacement of a material's output node bends, None where there is none.

    Bumps rise by the part of it along the normal (Cycles: `ShaderGraph::bump_from_displacement`).
    """
    found = scope.source(output.inputs["Displacement"])
    if found is None:
        return None
    node, context = NodeInput(scope, output), scope.context
    if found[1].node.bl_idname == "ShaderNodeVectorDisplacement":
        context.warn("its displacement by vectors is left out")
        return None
    if getattr(context.material, "displacement_method", "BUMP") != "BUMP":
        context.warn("its displacement is shown as bumps: the surface keeps its shape")
    surface = context.program.attribute(WORLD_NORMAL)
    try:
        normal = bent(node, surface, lambda: node.vector("DOT_PRODUCT", node["Displacement"], surface), ONE, ONE, scalar(0.1))
    except Unsupported as reason:
        context.warn(f"its displacement is left out: {reason}")
        return None
    return None if normal == surface else normal
