"""Blender's own panels that serve this engine, too: materials, lamps, world, objects, output, film.

A panel says in `COMPAT_ENGINES` for which engines it is shown.  What is changed here is put back as it was.
"""

from __future__ import annotations

import bpy

from .engine import LumigateEngine

# Panels that any engine may have belong to this one.
_GENERIC = "BLENDER_RENDER"
_NOT_OURS = {"VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes", "DATA_PT_light", "DATA_PT_spot"}
_SHARED = ("EEVEE_MATERIAL_PT_context_material", "MATERIAL_PT_preview", "VIEWLAYER_PT_override")
# Cycles' own, which `cycles_panels` shows, have all of it.
_LIKE_CYCLES = {"OBJECT_PT_visibility"}
# Where Cycles' add-on is switched off.
_EEVEE = ("EEVEE_MATERIAL_PT_surface", "EEVEE_WORLD_PT_surface", "DATA_PT_EEVEE_light", "DATA_PT_spot")

_before: dict[type, set[str]] = {}


def _serving() -> list[type]:
    """The panels of this Blender that are to be shown."""
    has_cycles = hasattr(bpy.types.Scene, "cycles")
    hidden = _NOT_OURS | _LIKE_CYCLES if has_cycles else _NOT_OURS
    generic = [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        # An inherited set would show every panel of the family.
        if _GENERIC in panel.__dict__.get("COMPAT_ENGINES", ()) and panel.__name__ not in hidden
    ]
    named = [getattr(bpy.types, name, None) for name in (*_SHARED, *(() if has_cycles else _EEVEE))]
    return list(dict.fromkeys([*generic, *(panel for panel in named if panel is not None)]))


def attach() -> None:
    """Show them."""
    for panel in _serving():
        _before[panel] = panel.COMPAT_ENGINES
        panel.COMPAT_ENGINES = panel.COMPAT_ENGINES | {LumigateEngine.bl_idname}


def detach() -> None:
    """Put back what each panel said."""
    for panel, engines in _before.items():
        panel.COMPAT_ENGINES = engines
    _before.clear()
