"""What Blender sees of this extension, registered in order and undone in reverse."""

from __future__ import annotations

import bpy

from . import lightmap_operators, lightmap_panel, lightmap_properties, operators, panels, properties

# Each module lists its CLASSES; properties first, for the others show them.
MODULES = (properties, lightmap_properties, operators, lightmap_operators, panels, lightmap_panel)
CLASSES = tuple(cls for module in MODULES for cls in module.CLASSES)


def register() -> None:
    """Register every class, then the settings of each scene; an error undoes what was done before it."""
    done = []
    try:
        for cls in CLASSES:
            bpy.utils.register_class(cls)
            done.append(cls)
        properties.attach()
        lightmap_properties.attach()
    except Exception:
        for cls in reversed(done):
            bpy.utils.unregister_class(cls)
        raise


def unregister() -> None:
    """Leave nothing behind."""
    lightmap_properties.detach()
    properties.detach()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
