"""Blender's world as a panorama of radiance."""

from __future__ import annotations

import math
import os
import tempfile
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import bpy
import numpy as np
import platformdirs

from ...core.errors import SceneError
from ...core.lamps.bright_spots import Sun, take_out_suns
from ...core.lamps.world import row_angles
from ...core.scene import ALL_RAYS, CAMERA, DIFFUSE, GLOSSY, SHADOW, SUN, TRANSMISSION, World
from .fingerprint import fingerprint
from .lamps import FEW_BOUNCES, Lamp
from .nodes import Shader, node_tree, surface
from .panorama import CAMERA_RAY, DIFFUSE_RAY, all_nodes, render_panorama, render_panorama_apart

# Where Cycles may compute: in the open file, in a process of its own (a render runs in this one), or not now.
Cycles = Literal["here", "apart", "not"]
_MAX_WIDTH = 4096
_WIDTH = 1024  # of a rendered panorama whose nodes name no larger image
_CACHE_BYTES = 2**30
_RENDERED_AS = 1  # raised where a world is rendered otherwise than before: what is kept of it then counts no more
BESIDE_A_SUN = 0.2  # of Cycles' shadow rays to a sky with one sun disc: four in five seek the disc
SUN_OF_SKY = " (sun)"  # after the world's name: the lamp that shines as its sun disc does


@dataclass
class ExtractedWorld:
    """The panorama, the suns taken out of it, and lines for the user."""

    world: World
    suns: list[Lamp] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def extract_world(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, graph: bpy.types.Depsgraph, cycles: Cycles = "here"
) -> ExtractedWorld:
    """The world of a scene as evaluated in `graph`.

    A plain background is one value; an environment image is taken as it is; any other tree is rendered
    by Cycles once and kept in the user's cache folder.
    cycles: where it may render; where it may not now, a world that it has not rendered before is black, with a warning.

    Raises:
        SceneError: Cycles could not render the world.
    """
    world = view_layer.world_override or scene.world
    if world is None:
        return ExtractedWorld(World(np.zeros((1, 1, 3), np.float32)))
    world = world.evaluated_get(graph)
    found = ExtractedWorld(World(np.zeros((1, 1, 3), np.float32), _visibility(world), world.lightgroup))
    tree = node_tree(world)
    if tree is None:
        found.world.radiance[:] = world.color
        return found
    output = tree.get_output_node("CYCLES")
    for node in all_nodes(tree):
        if node.type in ("TEX_ENVIRONMENT", "TEX_IMAGE") and node.image is not None and not node.image.size[0]:
            found.warnings.append(
                f"image '{node.image.name}' of world '{world.name}' cannot be read: relink its file ({node.image.filepath})"
            )
    if output is not None and output.inputs["Volume"].is_linked:
        found.warnings.append(f"the volume of world '{world.name}' is left out")
    if world.cycles.max_bounces < FEW_BOUNCES:
        found.warnings.append(
            f"world '{world.name}' has Max Bounces {world.cycles.max_bounces}, which is ignored: its light bounces on as that of lamps"
        )
    shader = surface(world)
    if shader is None:
        return found
    value = shader.emission()
    if value is not None:
        found.world.radiance[:] = np.maximum(value, 0)
        return found
    radiance = _environment_image(shader)
    if radiance is None:
        told = {end.name for node in all_nodes(tree) if node.type == "LIGHT_PATH" for end in node.outputs if end.is_linked}
        if told - {"Is Camera Ray"}:
            found.warnings.append(f"world '{world.name}' depends on the light path: all rays but the camera's see what diffuse rays see")
        placed = {end.name for node in all_nodes(tree) if node.type == "TEX_COORD" for end in node.outputs if end.is_linked}
        if placed & {"Window", "Camera"}:
            found.warnings.append(f"world '{world.name}' is laid out over the camera's picture, and is shown as another camera sees it")
        rendered = _rendered(scene, world, tree, cycles, DIFFUSE_RAY)
        if rendered is None:
            found.warnings.append(
                f"world '{world.name}' is black until Cycles has rendered it: check and prepare the scene in Lumigate's panel"
            )
            return found
        radiance, suns = rendered
        visibility = found.world.visibility
        if told:
            seen = _rendered(scene, world, tree, cycles, CAMERA_RAY)
            if seen is not None:
                found.world.seen = _reduced(seen[0])
                visibility &= ALL_RAYS if len(seen[1]) else ~CAMERA
        found.suns = [_sun_lamp(world, Sun(sun[:3], sun[3:6], float(sun[6])), visibility) for sun in suns]
        if len(suns) == 1:
            found.world.sought = BESIDE_A_SUN
    found.world.radiance = _reduced(radiance)
    _part_suns(found, world)
    return found


def _part_suns(found: ExtractedWorld, world: bpy.types.World) -> None:
    """Make lamps of the suns in a panorama; the camera still sees these in it."""
    whole = found.world.radiance
    found.world.radiance, suns = take_out_suns(whole)
    if not suns:
        return
    if found.world.seen is None:
        found.world.seen = whole
    found.suns += [_sun_lamp(world, sun, found.world.visibility & ~CAMERA) for sun in suns]
    if found.world.sought == 1:  # Cycles' rays to an image follow its brightness, suns and all
        light = [row_angles(*image.shape[:2]) @ image.mean(axis=(1, 2), dtype=np.float64) for image in (found.world.radiance, whole)]
        found.world.sought = float(light[0] / light[1])


def _reduced(radiance: np.ndarray) -> np.ndarray:
    """A panorama without negative light, of a single pixel where it is constant."""
    if np.ptp(radiance.reshape(-1, 3), axis=0).max() <= 1e-6 * radiance.max():
        radiance = radiance[:1, :1]
    return np.maximum(radiance, 0, dtype=np.float32)


def _visibility(world: bpy.types.World) -> int:
    rays = world.cycles_visibility
    return CAMERA * rays.camera | DIFFUSE * rays.diffuse | GLOSSY * rays.glossy | TRANSMISSION * rays.transmission | SHADOW


def _environment_image(background: Shader) -> np.ndarray | None:
    """The panorama of an equirectangular float image that at most turns about the vertical axis, None for anything else."""
    if background.node.type != "BACKGROUND":
        return None
    strength, environment = background.constant("Strength"), background.source("Color")
    if strength is None or environment is None or environment.node.type != "TEX_ENVIRONMENT":
        return None
    image = environment.node.image
    if image is None or environment.node.projection != "EQUIRECTANGULAR" or image.source != "FILE" or not image.is_float:
        return None
    turn = _turn(environment)
    width, height = image.size
    if turn is None or width * height == 0 or image.channels < 3:
        return None
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, image.channels)[::-1, :, :3]
    return _shrink(_shift(pixels, turn / (2 * math.pi) * width), _MAX_WIDTH) * strength.astype(np.float32)


def _turn(environment: Shader) -> float | None:
    """Angle about z by which the lookup of an environment texture is turned, None where it is more than that."""
    origin = environment.source("Vector")
    if origin is None or _is_direction(environment):
        return 0.0
    mapping = origin.node
    if mapping.type != "MAPPING" or mapping.vector_type not in ("POINT", "TEXTURE", "VECTOR") or not _is_direction(origin):
        return None
    location, rotation, scale = (origin.constant(name) for name in ("Location", "Rotation", "Scale"))
    if location is None or rotation is None or scale is None or rotation[:2].any() or (scale != 1).any():
        return None
    if location.any() and mapping.vector_type != "VECTOR":
        return None
    return float(-rotation[2] if mapping.vector_type == "TEXTURE" else rotation[2])


def _is_direction(reader: Shader) -> bool:
    """Whether the input 'Vector' of a node gets the direction of the ray."""
    found = reader.scope.source(reader.node.inputs["Vector"])
    return found is not None and found[1].node.type == "TEX_COORD" and found[1].name == "Generated"


def _shift(pixels: np.ndarray, columns: float) -> np.ndarray:
    """Move a panorama to the right by a number of columns, interpolating between two."""
    whole = math.floor(columns)
    part = np.float32(columns - whole)
    moved = np.roll(pixels, whole, axis=1)
    return moved if part < 1e-4 else (1 - part) * moved + part * np.roll(moved, 1, axis=1)


def _shrink(pixels: np.ndarray, width: int) -> np.ndarray:
    """Average blocks of pixels until the panorama is at most `width` wide."""
    factor = -(-pixels.shape[1] // width)
    if factor == 1:
        return pixels
    for axis in (0, 1):
        starts = np.arange(0, pixels.shape[axis], factor)
        counts = np.diff([*starts, pixels.shape[axis]]).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        pixels = np.add.reduceat(pixels, starts, axis=axis) / counts.astype(np.float32)
    return pixels


def _rendered(
    scene: bpy.types.Scene, world: bpy.types.World, tree: bpy.types.NodeTree, cycles: Cycles, ray: dict[str, float]
) -> tuple[np.ndarray, np.ndarray] | None:
    """The panorama and suns (K, 7), as `render_panorama`, of any world as a ray sees them, from the cache or by Cycles, if that may run."""
    widths = [node.image.size[0] for node in all_nodes(tree) if node.type == "TEX_ENVIRONMENT" and node.image is not None]
    width = min(max([_WIDTH, *widths]), _MAX_WIDTH)
    stored = cache_folder() / f"{fingerprint(tree, width, _RENDERED_AS, ray)}.npz"
    with suppress(OSError, ValueError, KeyError), np.load(stored) as kept:  # a damaged file is rendered again
        return kept["radiance"], kept["suns"].reshape(-1, 7)
    if cycles == "not":
        return None
    render = render_panorama_apart if cycles == "apart" else render_panorama
    try:
        radiance, suns = render(world.original, scene.frame_current, width, width // 2, ray)
    except (RuntimeError, OSError) as error:
        raise SceneError(f"Cycles cannot render world '{world.name}': {error}") from error
    with suppress(OSError):  # without a writable folder it is rendered each time
        _store(stored, radiance, suns)
    return radiance, suns


def cache_folder() -> Path:
    """Where they are kept from one run to the next."""
    return Path(platformdirs.user_cache_dir("lumigate")) / "worlds"


def _store(path: Path, radiance: np.ndarray, suns: np.ndarray) -> None:
    """Keep a panorama, and forget the oldest ones beyond a gigabyte."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
        np.savez(file, radiance=radiance, suns=suns)
    os.replace(file.name, path)
    total = 0
    for old in sorted(path.parent.glob("*.npz"), key=lambda p: p.stat().st_mtime, reverse=True):
        total += old.stat().st_size
        if total > _CACHE_BYTES and old != path:
            old.unlink()


def _sun_lamp(world: bpy.types.World, sun: Sun, visibility: int) -> Lamp:
    """The lamp that shines as a sky's sun disc does."""
    z = sun.direction
    x = np.cross([0, 0, 1] if abs(z[2]) < 0.9 else [1, 0, 0], z)
    x /= np.linalg.norm(x)
    return Lamp(
        name=world.name + SUN_OF_SKY,
        kind=SUN,
        position=np.zeros(3),
        axes=np.array([x, np.cross(z, x), z]),
        emission=sun.irradiance,
        visibility=visibility & ~SHADOW,
        angle=sun.angle,
        group=world.lightgroup,
    )
