"""Cycles' panels of what this engine heeds, too, under names of its own: nodes, lamps' beams, ray visibility, light groups.

Cycles' own are polled for Cycles alone.  What these draw is Cycles' own; where its add-on is off, they are not there, and `compat` shows EEVEE's.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
from bl_ui.properties_object import has_geometry_visibility

from .engine import LumigateEngine

_OF_CYCLES, _OURS = "CYCLES_", "LUMIGATE_"


def _mirror(name: str, where: str, label: str, shown: Callable, *, parent: str = "", order: int = 0, closed: bool = False) -> type:
    """A panel that draws Cycles' panel `name`.

    where: the context of the properties editor.  shown: whether there is something to draw, of Blender's context.
    """

    def draw(self: bpy.types.Panel, context: bpy.types.Context) -> None:
        getattr(bpy.types, name).draw(self, context)

    def poll(_cls: type, context: bpy.types.Context) -> bool:
        return context.engine == LumigateEngine.bl_idname and hasattr(bpy.types, name) and bool(shown(context))

    own = name.replace(_OF_CYCLES, _OURS)
    attributes = {
        "__doc__": f"Cycles' {label}.",
        "__module__": __name__,
        "bl_idname": own,
        "bl_label": label,
        "bl_space_type": "PROPERTIES",
        "bl_region_type": "WINDOW",
        "bl_context": where,
        "bl_order": order,
        "bl_options": {"DEFAULT_CLOSED"} if closed else set(),
        "poll": classmethod(poll),
        "draw": draw,
    }
    if parent:
        attributes["bl_parent_id"] = parent
    return type(own, (bpy.types.Panel,), attributes)


def _is_portal(light: bpy.types.Light) -> bool:
    return light.type == "AREA" and light.cycles.is_portal


def _material(context: bpy.types.Context) -> bool:
    return context.material is not None and not context.material.grease_pencil


def _has_geometry(context: bpy.types.Context) -> bool:
    return context.object is not None and has_geometry_visibility(context.object)


CLASSES = (
    _mirror("CYCLES_MATERIAL_PT_surface", "material", "Surface", _material, order=-3),
    _mirror("CYCLES_MATERIAL_PT_displacement", "material", "Displacement", lambda c: _material(c) and c.material.node_tree, order=-2, closed=True),
    _mirror("CYCLES_WORLD_PT_surface", "world", "Surface", lambda c: c.world, order=-4),
    _mirror("CYCLES_WORLD_PT_ray_visibility", "world", "Ray Visibility", lambda c: c.world, order=-3, closed=True),
    _mirror("CYCLES_WORLD_PT_settings_light_group", "world", "Light Group", lambda c: c.world, order=-2, closed=True),
    _mirror("CYCLES_LIGHT_PT_light", "data", "Light", lambda c: c.light, order=-4),
    _mirror(
        "CYCLES_LIGHT_PT_beam_shape", "data", "Beam Shape", lambda c: c.light and c.light.type in {"SPOT", "AREA"},
        parent="LUMIGATE_LIGHT_PT_light",
    ),
    _mirror("CYCLES_LIGHT_PT_settings", "data", "Settings", lambda c: c.light, order=-3, closed=True),
    _mirror("CYCLES_LIGHT_PT_nodes", "data", "Nodes", lambda c: c.light and not _is_portal(c.light), order=-2, closed=True),
    _mirror("CYCLES_OBJECT_PT_visibility", "object", "Visibility", lambda c: c.object, closed=True),
    _mirror("CYCLES_OBJECT_PT_visibility_ray_visibility", "object", "Ray Visibility", _has_geometry, parent="LUMIGATE_OBJECT_PT_visibility"),
    _mirror("CYCLES_OBJECT_PT_lightgroup", "object", "Light Group", _has_geometry, parent="OBJECT_PT_shading", closed=True),
    _mirror("CYCLES_RENDER_PT_override", "view_layer", "Override", lambda c: c.view_layer, closed=True),  # before Blender 5
)  # fmt: skip
