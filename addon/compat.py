"""Blender's own panels that serve this engine, too: materials, lamps, world, output, film.

A panel says in `COMPAT_ENGINES` for which engines it is shown.  What is changed here is put back as it was.
"""

from __future__ import annotations

import bpy

from .engine import LumigateEngine

# Panels that any engine may have belong to this one.
_GENERIC = "BLENDER_RENDER"
_NOT_OURS = {"VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes", "RENDER_PT_simplify", "DATA_PT_light", "DATA_PT_spot"}
# The editors of materials, lamps and world that show what Cycles and EEVEE have in common, which is what is rendered here.
_EEVEE = (
    "EEVEE_MATERIAL_PT_context_material",
    "EEVEE_MATERIAL_PT_surface",
    "EEVEE_WORLD_PT_surface",
    "DATA_PT_EEVEE_light",
    "DATA_PT_EEVEE_light_distance",
    "DATA_PT_EEVEE_shadow",
    "MATERIAL_PT_preview",
)

_before: dict[type, set[str]] = {}


def _serving() -> list[type]:
    """The panels of this Blender that are to be shown."""
    generic = [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if _GENERIC in getattr(panel, "COMPAT_ENGINES", ()) and panel.__name__ not in _NOT_OURS
    ]
    named = [getattr(bpy.types, name, None) for name in _EEVEE]
    return list(dict.fromkeys([*generic, *(panel for panel in named if panel is not None)]))


def attach() -> None:
    """Show them."""
    for panel in _serving():
        own = panel.__dict__.get("COMPAT_ENGINES")
        if own is not None:  # an inherited set would show every panel of the family
            _before[panel] = own
            panel.COMPAT_ENGINES = own | {LumigateEngine.bl_idname}


def detach() -> None:
    """Put back what each panel said."""
    for panel, engines in _before.items():
        panel.COMPAT_ENGINES = engines
    _before.clear()
