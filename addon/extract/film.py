"""Blender's film: the pixel filter, whether the world shows, and the exposure."""

from __future__ import annotations

import bpy

from ...core.film import Film


def extract_film(scene: bpy.types.Scene) -> Film:
    """The film as Cycles' settings of the scene have it; where Cycles is switched off, its usual filter at the width of EEVEE's."""
    transparent = scene.render.film_transparent
    cycles = getattr(scene, "cycles", None)
    if cycles is None:
        return Film("BLACKMAN_HARRIS", scene.render.filter_size, transparent)
    width = cycles.filter_width if cycles.pixel_filter_type != "BOX" else 1.0
    return Film(cycles.pixel_filter_type, width, transparent)


def film_exposure(scene: bpy.types.Scene) -> float:
    """What Cycles' film multiplies all light by; 1 where Cycles is switched off."""
    cycles = getattr(scene, "cycles", None)
    return 1.0 if cycles is None else cycles.film_exposure
