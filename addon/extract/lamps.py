"""Blender's lights in the units of `core.scene.Lamps`: what Cycles' light.cpp and kernel/light/*.h make of them.

With radiant power P (colour, exposure and node tree multiplied in), Cycles' conventions are
    point, spot   intensity P / (4 pi) in every direction of the cone; a sphere of radius r has the radiance
                  P / (4 pi^2 r^2), or P / pi where `normalize` is off
    sun           irradiance P on a plane that faces it, or radiance P where `normalize` is off
    area          radiance P / (pi A), or P / pi, times the softbox factor of its spread
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.scene import AREA, ELLIPSE, POINT, RECTANGLE, SPOT, SUN, Lamps, Skipped
from ..materials import LampProgram, LampUse
from .geometry import instance_visibility, is_shown, light_group
from .links import BLOCKERS, RECEIVERS, Links
from .nodes import faded_emission, node_tree

_KINDS = {"POINT": POINT, "SPOT": SPOT, "SUN": SUN, "AREA": AREA}
# Cycles treats a spread of zero as parallel light; the narrowest softbox here has the same power.
_MIN_SPREAD = math.radians(0.1)
# Bounces of a path up to which Cycles lets a light or world shine (`max_bounces`); as many as are traced by default matter.
FEW_BOUNCES = 4


@dataclass
class Lamp:
    """One lamp in world space, float64; the fields are those of `Lamps`."""

    name: str
    kind: int
    position: np.ndarray
    axes: np.ndarray
    emission: np.ndarray
    visibility: int
    radius: float = 0.0
    soft_falloff: bool = False
    angle: float = 0.0
    blend: float = 0.0
    size: tuple[float, float] = (0.0, 0.0)
    shape: int = RECTANGLE
    cast_shadow: bool = True
    group: str = ""
    falloff: tuple[float, float] = (0.0, 0.0)
    program: int = -1
    receivers: int = -1
    blockers: int = -1
    use: LampUse | None = None  # of its nodes, where these tell rays apart


@dataclass
class CollectedLamps:
    """What `collect_lamps` found, with lines for the user.

    portals: (3, 3) float64 each, as of `World`, in the world's coordinates.
    """

    lamps: list[Lamp] = field(default_factory=list)
    portals: list[np.ndarray] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)

    def skip(self, name: str, why: str) -> None:
        self.skipped.append(Skipped("lamps", f"lamp '{name}' {why}"))


def collect_lamps(depsgraph: bpy.types.Depsgraph, links: Links, space: bpy.types.SpaceView3D | None = None) -> CollectedLamps:
    """Every lamp that an evaluated scene shows to a render; links: of the same evaluation.  space: as in `geometry.collect`."""
    found = CollectedLamps()
    view_layer = depsgraph.view_layer_eval
    seen = set()
    places: dict[str, np.ndarray] = {}
    for instance in depsgraph.object_instances:
        ob = instance.object
        if ob.type != "LIGHT" or not instance.show_self or not is_shown(ob, depsgraph, space):
            continue
        seen.add(ob.name)
        light = ob.data
        if light.type == "AREA" and light.cycles.is_portal:
            found.skip(ob.name, "is a portal: it guides rays to the world, and shines no light of its own")
            portal = _portal(light, np.array(instance.matrix_world, np.float64))
            if portal is not None:
                found.portals.append(portal)
            continue
        visibility = instance_visibility(instance, view_layer)
        matrix = np.array(instance.matrix_world, np.float64)
        if light.type == "POINT" and not np.linalg.norm(matrix[:3, :3], axis=0).all():
            matrix[:3, :3] = np.eye(3)  # only its place matters
        if not np.isfinite(matrix).all() or not np.linalg.norm(matrix[:3, :3], axis=0).all():
            found.skip(ob.name, "has a scale of zero or an invalid position: reset its transform")
            continue
        power, falloff, is_even = _power(light)
        if not power.any():
            found.skip(ob.name, "has no power")
        elif (power < 0).any():
            found.skip(ob.name, "has negative power, which darkens in Cycles: set a positive one")
            found.warnings.append(
                f"lamp '{ob.name}' has negative power, by which Cycles takes light away, and is left out: set a positive one"
            )
        elif visibility == 0:
            found.skip(ob.name, "is invisible to every kind of ray")
        else:
            lamp = Lamp(
                name=ob.name,
                kind=_KINDS[light.type],
                position=matrix[:3, 3],
                axes=upright_axes(matrix[:3, :3], light.type == "AREA"),
                emission=power,
                visibility=visibility,
                cast_shadow=light.use_shadow,
                group=light_group(instance),
                falloff=falloff,
                receivers=links.number(ob, RECEIVERS) if links else -1,
                blockers=links.number(ob, BLOCKERS) if links else -1,
            )
            if not is_even:
                places = places or {other.name: np.array(other.matrix_world, np.float64) for other in depsgraph.objects}
                lamp.use = LampUse(light.original, ob.name, matrix, lamp.axes, places)
            _SHAPERS[light.type](lamp, light, np.linalg.norm(matrix[:3, :3], axis=0), found)
            if lamp.emission.any():
                found.lamps.append(lamp)
                if light.cycles.max_bounces < FEW_BOUNCES:
                    found.warnings.append(
                        f"lamp '{ob.name}' has Max Bounces {light.cycles.max_bounces}, which is ignored: its light bounces on as that of others"
                    )
            else:
                found.skip(ob.name, "has no size")
    for ob in depsgraph.scene.objects:
        if ob.type == "LIGHT" and ob.name not in seen:
            found.skip(ob.name, "is hidden from renders")
    return found


def upright_axes(columns: np.ndarray, flat: bool) -> np.ndarray:
    """The x, y and z axes (3, 3) of a lamp, of length 1 and at right angles, by the columns (3, 3) of its matrix, which a turned lamp below an uneven scale has sheared.

    As in Cycles, a sheared lamp shines along its z axis, but one that is `flat` lies in the plane of its x and y axes.
    """
    x, y, z = (columns / np.linalg.norm(columns, axis=0)).T
    if flat:
        y = _across(y, x)
        up = np.cross(x, y)
        z = up if up @ z > 0 else -up
    else:
        x = _across(x, z)
        side = np.cross(z, x)
        y = side if side @ y > 0 else -side
    return np.stack([x, y, z])


def _across(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """What of a vector (3,) lies across a unit axis, of length 1; any such direction where nothing does."""
    across = vector - (vector @ axis) * axis
    if not np.linalg.norm(across) > 1e-6:
        across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    return across / np.linalg.norm(across)


def with_programs(lamps: list[Lamp], programs: list[LampProgram]) -> None:
    """Give lamps what became of the nodes of those that have a `use`, in their order."""
    for lamp, compiled in zip((lamp for lamp in lamps if lamp.use is not None), programs, strict=True):
        lamp.program, lamp.falloff = compiled.number, compiled.falloff


def to_arrays(lamps: list[Lamp], origin: np.ndarray) -> Lamps:
    """The lamps as arrays, positions relative to `origin`."""
    if not lamps:
        return Lamps.empty()

    def column(name, dtype=np.float32):
        return np.array([getattr(lamp, name) for lamp in lamps], dtype)

    return Lamps(
        kind=column("kind", np.int32),
        position=(column("position", np.float64) - origin).astype(np.float32),
        axes=column("axes"),
        emission=column("emission"),
        radius=column("radius"),
        soft_falloff=column("soft_falloff", np.uint8),
        angle=column("angle"),
        blend=column("blend"),
        size=column("size"),
        shape=column("shape", np.int32),
        visibility=column("visibility", np.uint8),
        cast_shadow=column("cast_shadow", np.uint8),
        falloff=column("falloff"),
        program=column("program", np.int32),
        receivers=column("receivers", np.int32),
        blockers=column("blockers", np.int32),
        names=[lamp.name for lamp in lamps],
        groups=[lamp.group for lamp in lamps],
    )


def _power(light: bpy.types.Light) -> tuple[np.ndarray, tuple[float, float], bool]:
    """(3,) power with colour, temperature, exposure and constant nodes, the falloff that Light Falloff nodes give it, as `Lamps` has it, and
    whether that is all: else nodes that tell rays apart are not in it.
    """
    power = np.array(light.color, np.float64) * light.energy * 2.0**light.exposure
    if light.use_temperature:
        power *= np.array(light.temperature_color, np.float64)
    if node_tree(light) is None:
        return power, (0.0, 0.0), True
    factor, falloff = faded_emission(light)
    if factor is not None and light.type == "SUN":
        falloff = (falloff[0], 0.0)  # infinitely far away, where nothing is smoothed
    if factor is None or (light.type == "SUN" and falloff[0]):
        return power, (0.0, 0.0), False
    return power * factor, falloff, True


def _shape_point(lamp: Lamp, light: bpy.types.PointLight, scale: np.ndarray, found: CollectedLamps) -> None:
    lamp.radius = light.shadow_soft_size
    lamp.soft_falloff = light.use_soft_falloff
    if light.normalize:
        lamp.emission = lamp.emission / (4 * math.pi)
    else:
        lamp.emission = lamp.emission * (lamp.radius**2 if lamp.radius > 0 else 1 / math.pi)


def _shape_spot(lamp: Lamp, light: bpy.types.SpotLight, scale: np.ndarray, found: CollectedLamps) -> None:
    _shape_point(lamp, light, scale, found)
    lamp.angle, lamp.blend = light.spot_size, light.spot_blend
    if not np.allclose(scale[:2], scale[0], rtol=1e-3):
        found.warnings.append(f"the scale of spot lamp '{lamp.name}' makes its cone elliptic: it is rendered round, as wide in the mean")
    width = math.sqrt(scale[0] * scale[1])  # which keeps the solid angle, and so the light
    if lamp.angle < math.pi and width != scale[2]:
        lamp.angle = 2 * math.atan(math.tan(0.5 * lamp.angle) * width / scale[2])


def _shape_sun(lamp: Lamp, light: bpy.types.SunLight, scale: np.ndarray, found: CollectedLamps) -> None:
    lamp.angle = light.angle
    if not light.normalize and lamp.angle > 0:
        lamp.emission = lamp.emission * math.pi * math.sin(0.5 * lamp.angle) ** 2


def _area_size(light: bpy.types.AreaLight, scale: np.ndarray) -> tuple[float, float]:
    """Both edges, or diameters, of an area lamp (m)."""
    size_y = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
    return light.size * scale[0], size_y * scale[1]


def _portal(light: bpy.types.AreaLight, matrix: np.ndarray) -> np.ndarray | None:
    """A portal as `World` has them, None where it has no area: a disk's is the square around it."""
    columns = matrix[:3, :3]
    scale = np.linalg.norm(columns, axis=0)
    if not (np.isfinite(matrix).all() and scale.all()):
        return None
    size = _area_size(light, scale)
    axes = upright_axes(columns, True)
    return np.stack([matrix[:3, 3], 0.5 * size[0] * axes[0], 0.5 * size[1] * axes[1]]) if min(size) > 0 else None


def _shape_area(lamp: Lamp, light: bpy.types.AreaLight, scale: np.ndarray, found: CollectedLamps) -> None:
    lamp.size = _area_size(light, scale)
    lamp.shape = ELLIPSE if light.shape in ("DISK", "ELLIPSE") else RECTANGLE
    lamp.angle = max(light.spread, _MIN_SPREAD)
    area = lamp.size[0] * lamp.size[1] * (0.25 * math.pi if lamp.shape == ELLIPSE else 1)
    if area <= 0:
        lamp.emission = np.zeros(3)
        return
    lamp.emission = lamp.emission * _softbox(0.5 * lamp.angle) / (math.pi * (area if light.normalize else 1))


def _softbox(half: float) -> float:
    """Radiance on the axis, relative to a lamp without a softbox, that keeps its power (Cycles: `normalize_spread`).

    The softbox dims by 1 - tan(x) / tan(half) at the angle x from the axis.
    """
    if half >= 0.5 * math.pi - 1e-6:
        return 1.0
    if half <= 0.05:
        return 3 * math.tan(half) / half**3
    return math.tan(half) / (math.tan(half) - half)


_SHAPERS = {"POINT": _shape_point, "SPOT": _shape_spot, "SUN": _shape_sun, "AREA": _shape_area}
