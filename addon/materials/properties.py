"""Properties of data-blocks as colours, as Attribute nodes read them."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np


def found_property(name: str, *owners: bpy.types.ID | None) -> tuple[float, ...]:
    """RGBA of the first custom or RNA property of that name, as Attribute nodes find it; zeros if no owner has it."""
    for owner in owners:
        if owner is None:
            continue
        value = owner.get(name)
        if value is None:
            try:
                value = owner.path_resolve(name)
            except ValueError:
                continue
        color = _as_color(value)
        if color is not None:
            return color
    return (0, 0, 0, 0)


def _as_color(value: Any) -> tuple[float, ...] | None:
    """A number or an array of up to four numbers as RGBA, None for anything else."""
    try:
        values = np.atleast_1d(np.asarray(value, np.float32))
    except (TypeError, ValueError):
        return None
    if values.ndim != 1 or not 1 <= len(values) <= 4:
        return None
    if len(values) == 1:
        return (*values.repeat(3), 1)
    return (*values, *(0, 0, 1)[len(values) - 1 :]) if len(values) < 4 else tuple(values)
