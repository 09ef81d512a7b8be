"""What Blender sees of this extension, registered in order and undone in reverse."""

from __future__ import annotations

import bpy

from . import operators, panels, properties

# Each module lists its CLASSES; properties first, for the others show them.
CLASSES = (*properties.CLASSES, *operators.CLASSES, *panels.CLASSES)


def register() -> None:
    """Register every class, then the settings of each scene; an error undoes what was done before it."""
    done = []
    try:
        for cls in CLASSES:
            bpy.utils.register_class(cls)
            done.append(cls)
        properties.attach()
    except Exception:
        for cls in reversed(done):
            bpy.utils.unregister_class(cls)
        raise


def unregister() -> None:
    """Leave nothing behind."""
    properties.detach()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
