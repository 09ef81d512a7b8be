"""Blender's last picture is kept while the scene is evaluated, which is a render to Blender."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

_SLOT = "Lumigate"


@contextmanager
def kept_render_result() -> Iterator[None]:
    """What renders inside the block goes to a render slot of its own; the user's slots and their pictures stay.

    The slot stays, too, empty: Blender does not let go of the one that was rendered last.
    """
    image = bpy.data.images.get("Render Result")
    if image is None:
        yield
        return
    slots = image.render_slots
    chosen = slots.active_index
    names = [slot.name for slot in slots]
    if _SLOT not in names:
        slots.new(name=_SLOT)
        names.append(_SLOT)
    slots.active_index = names.index(_SLOT)
    try:
        yield
    finally:
        slots.active_index = chosen
