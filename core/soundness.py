"""A scene made of numbers: what holds NaN or infinity is set right or left out, with a line that names it.

Kernels compute with whatever they are given: one NaN in an albedo is in every pixel after two bounces, and one in a density
is an index out of bounds.  Extraction drops broken triangles; everything else that is no number ends here, whoever made the arrays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .scene import Geometry, Lamps, Materials, Scene, World

# Largest magnitude of a light or colour: three bounces of it still fit into float32.
LARGEST = np.float32(1e20)


def sound(scene: Scene) -> Scene:
    """`scene`, or a copy of it without the numbers that are none, whose `warnings` say what was changed."""
    warnings: list[str] = []
    made = replace(
        scene,
        geometry=_sound_geometry(scene.geometry),
        materials=_sound_materials(scene.materials, warnings),
        lamps=_sound_lamps(scene.lamps, warnings),
        world=_sound_world(scene.world, warnings),
    )
    made.warnings = [*scene.warnings, *warnings]
    return made


def _is_sound(values: np.ndarray) -> bool:
    """Whether all are numbers of a magnitude that can be computed with; NaN fails the comparison."""
    return not values.size or bool(-LARGEST <= values.min() and values.max() <= LARGEST)


def _within(values: np.ndarray, low: float = 0.0) -> np.ndarray:
    """A copy with NaN and infinity as zero, and the rest from `low` to `LARGEST`."""
    finite = np.where(np.isfinite(values), values, 0)
    return np.clip(finite, low, LARGEST).astype(values.dtype)


def _sound_geometry(geometry: Geometry) -> Geometry:
    """Corner normals that are no number become zero, which shading takes for the triangle's own; attributes become 0."""
    wrong = {
        name: _within(values, -LARGEST)
        for name, values in (("corner_normals", geometry.corner_normals), ("attributes", geometry.attributes))
        if not _is_sound(values)
    }
    return replace(geometry, **wrong) if wrong else geometry


def _sound_materials(materials: Materials, warnings: list[str]) -> Materials:
    """Colours and texels that are no number count as 0."""
    tables = materials.tables
    changes = {}
    if not _is_sound(tables.constant):
        bad = ~(np.abs(tables.constant) <= LARGEST).all(axis=1)
        changes["constant"] = _within(tables.constant, -LARGEST)
        warnings += [_line("material", materials.names[i], "a colour or value") for i in np.flatnonzero(bad)]
    if not _is_sound(tables.constants):
        changes["constants"] = _within(tables.constants, -LARGEST)
        warnings.append(
            "materials hold values that are no number (NaN or infinite): they count as 0; look for a division by zero in their nodes"
        )
    if not _is_sound(tables.texels_f32):
        number = int(np.count_nonzero(~(np.abs(tables.texels_f32) <= LARGEST)))
        changes["texels_f32"] = _within(tables.texels_f32, -LARGEST)
        warnings.append(
            f"{number:,} values of image textures are no number (NaN or infinite): they count as 0; save the images again without them"
        )
    return replace(materials, tables=tables._replace(**changes)) if changes else materials


def _sound_lamps(lamps: Lamps, warnings: list[str]) -> Lamps:
    """Lamps of which anything is no number are left out; those without finite emission are named where they are built."""
    keep = np.ones(len(lamps), bool)
    for values in (lamps.position, lamps.axes, lamps.radius, lamps.angle, lamps.blend, lamps.size, lamps.falloff):
        keep &= (np.abs(values) <= LARGEST).all(axis=tuple(range(1, values.ndim)))
    if keep.all():
        return lamps
    warnings += [
        f"lamp '{lamps.names[i]}' is left out: its place, turn or size is no number (NaN or infinite); reset its transform"
        for i in np.flatnonzero(~keep)
    ]
    return lamps.take(keep)


def _sound_world(world: World, warnings: list[str]) -> World:
    """Pixels that are no number are black."""
    panoramas = [panorama for panorama in (world.radiance, world.seen) if panorama is not None]
    number = sum(int(np.count_nonzero(~(np.abs(panorama) <= LARGEST).all(axis=-1))) for panorama in panoramas if not _is_sound(panorama))
    if not number:
        return world
    warnings.append(f"{number:,} pixels of the world are no number (NaN or infinite): they are black; save its image again without them")
    return replace(world, radiance=_within(world.radiance), seen=None if world.seen is None else _within(world.seen))


def _line(kind: str, name: str, what: str) -> str:
    return f"{kind} '{name}' has {what} that is no number (NaN or infinite): it counts as 0; set it again"
