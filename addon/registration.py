"""What Blender sees of this extension, registered in order and undone in reverse."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import bpy

from . import (
    compat,
    cycles_panels,
    engine,
    job,
    lightmap_operators,
    lightmap_panel,
    lightmap_properties,
    operators,
    panels,
    passes,
    properties,
    state,
)

# Properties first, for the others show them; each module lists its CLASSES.
MODULES = (properties, lightmap_properties, passes, state, engine, operators, lightmap_operators, panels, lightmap_panel, cycles_panels)
# What is hung onto Blender's own types, once the classes are there.
ATTACHED = (properties, lightmap_properties, passes, state, compat)


def register() -> None:
    """Register every class, then attach the rest; an error undoes what was done before it."""
    undo: list[Callable[[], None]] = []
    try:
        for cls in (cls for module in MODULES for cls in module.CLASSES):
            bpy.utils.register_class(cls)
            undo.append(partial(bpy.utils.unregister_class, cls))
        for module in ATTACHED:
            module.attach()
            undo.append(module.detach)
    except Exception:
        for step in reversed(undo):
            step()
        raise


def unregister() -> None:
    """Leave nothing behind, no thread either."""
    job.end_all()
    for module in reversed(ATTACHED):
        module.detach()
    for cls in (cls for module in reversed(MODULES) for cls in reversed(module.CLASSES)):
        bpy.utils.unregister_class(cls)
