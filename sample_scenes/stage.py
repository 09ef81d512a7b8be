"""What surrounds the shapes of every scene: the empty file, camera, lamps, world and render settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .materials import image
from .primitives import place


@dataclass(frozen=True)
class Detail:
    """How finely a scene is built: `full` for pictures, otherwise light enough for tests."""

    full: bool

    def segments(self, full: int, low: int) -> int:
        """The number of subdivisions of a curve."""
        return full if self.full else low

    def chamfer(self, width: float) -> float:
        """The chamfer of an edge (m): none in a light scene."""
        return width if self.full else 0.0


def empty_scene(width: int = 960, height: int = 540, exposure: float = 0.0):
    """The only scene of a new, empty file, set up for Cycles and the Standard view transform.

    The user's preferences (and so the enabled add-ons) stay as they are.
    """
    import bpy

    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    scene.cycles.samples = 128
    scene.cycles.diffuse_bounces = 8
    scene.cycles.max_bounces = 12
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.exposure = exposure
    return scene


def camera(location: Sequence[float], target: Sequence[float], lens: float, name: str = "Camera", active: bool = True):
    """A level camera (uprights stay upright) with a 36 mm sensor; what it looks up or down it gets by lens shift.

    location, target: m; the target is in the middle of the picture.  lens: mm.
    """
    import bpy

    data = bpy.data.cameras.new(name)
    data.sensor_fit, data.sensor_width, data.lens = "HORIZONTAL", 36.0, lens
    data.clip_start, data.clip_end = 0.05, 500.0
    across = np.asarray(target, float) - np.asarray(location, float)
    level = np.hypot(across[0], across[1])
    data.shift_y = across[2] / level * lens / data.sensor_width
    thing = place(name, data, location)
    thing.rotation_euler = (np.pi / 2, 0, np.arctan2(-across[0], across[1]))
    if active:
        bpy.context.scene.camera = thing
    return thing


def _light(kind: str, name: str, location: Sequence[float], direction: Sequence[float], energy: float, colour: Sequence[float]):
    """A lamp that shines along `direction`; energy in W (a sun: W/m^2)."""
    import bpy
    from mathutils import Vector

    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = energy, colour
    thing = place(name, data, location)
    thing.rotation_euler = Vector(direction).to_track_quat("-Z", "Y").to_euler()
    return data


def sun(direction: Sequence[float], irradiance: float, colour: Sequence[float] = (1, 1, 1), angle: float = np.radians(0.53)) -> None:
    """A sun; `direction` is where its light goes."""
    _light("SUN", "Sun", (0, 0, 10), direction, irradiance, colour).angle = angle


def area(
    name: str,
    location: Sequence[float],
    direction: Sequence[float],
    size: Sequence[float],
    watts: float,
    colour: Sequence[float] = (1, 1, 1),
) -> None:
    """A rectangular area lamp of `size` metres."""
    data = _light("AREA", name, location, direction, watts, colour)
    data.shape, data.size, data.size_y = "RECTANGLE", size[0], size[1]


def point(name: str, location: Sequence[float], watts: float, colour: Sequence[float] = (1, 1, 1), radius: float = 0.05) -> None:
    """A point lamp with the radius of its bulb."""
    _light("POINT", name, location, (0, 0, -1), watts, colour).shadow_soft_size = radius


def spot(
    name: str, location: Sequence[float], direction: Sequence[float], watts: float, cone: float, colour: Sequence[float] = (1, 1, 1),
    blend: float = 0.3, radius: float = 0.03,
) -> None:  # fmt: skip
    """A spot lamp with the full cone angle `cone` (rad)."""
    data = _light("SPOT", name, location, direction, watts, colour)
    data.spot_size, data.spot_blend, data.shadow_soft_size = cone, blend, radius


def world(radiance: np.ndarray | Sequence[float]) -> None:
    """The light from far away: one radiance (3,), or an equirectangular map (H, W, 3) whose row 0 is straight down."""
    import bpy

    data = bpy.data.worlds.new("World")
    if data.node_tree is None:
        data.use_nodes = True
    tree = data.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputWorld")
    background = tree.nodes.new("ShaderNodeBackground")
    background.inputs["Strength"].default_value = 1.0
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    radiance = np.asarray(radiance, float)
    if radiance.ndim == 1:
        background.inputs["Color"].default_value = (*radiance, 1)
    else:
        texture = tree.nodes.new("ShaderNodeTexEnvironment")
        texture.image = image("Sky", radiance, linear=True)
        tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    bpy.context.scene.world = data


def clear_sky(to_sun: Sequence[float], zenith: Sequence[float], height: int = 128) -> np.ndarray:
    """(height, 2 height, 3) radiance of a clear sky without its sun, over a dull ground.

    The relative luminance is the CIE standard clear sky (CIE S 011/E:2003, type 12); its colour pales towards horizon and sun.
    zenith: radiance straight up (W/m^2/sr).  to_sun: direction towards the sun.
    """
    width = 2 * height
    elevation = (np.arange(height) + 0.5) / height * np.pi - np.pi / 2
    azimuth = np.pi - (np.arange(width) + 0.5) / width * 2 * np.pi
    x, y = np.cos(elevation)[:, None] * np.cos(azimuth), np.cos(elevation)[:, None] * np.sin(azimuth)
    z = np.broadcast_to(np.sin(elevation)[:, None], x.shape)
    to_sun = np.asarray(to_sun, float) / np.linalg.norm(to_sun)
    from_sun = np.arccos(np.clip(x * to_sun[0] + y * to_sun[1] + z * to_sun[2], -1, 1))
    a, b, c, d, e = -1.0, -0.32, 10.0, -3.0, 0.45

    def gradation(height_above):
        return 1 + a * np.exp(b / np.maximum(height_above, 0.01))

    def scattering(angle):
        return 1 + c * (np.exp(d * angle) - np.exp(d * np.pi / 2)) + e * np.cos(angle) ** 2

    luminance = gradation(z) * scattering(from_sun) / (gradation(1.0) * scattering(np.arccos(to_sun[2])))
    blue = np.asarray(zenith, float)
    pale = np.full(3, blue @ [0.2126, 0.7152, 0.0722])
    paleness = np.clip(0.75 * np.exp(-4 * np.maximum(z, 0)) + 0.5 * np.exp(-4 * from_sun), 0, 1)[..., None]
    sky = luminance[..., None] * (blue * (1 - paleness) + pale * paleness)
    ground = 0.6 * pale * [1.0, 0.9, 0.75]
    return np.where(z[..., None] > 0, sky, ground).astype(np.float32)
