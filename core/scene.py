"""The scene as arrays: what Blender holds, in the form that the light transport reads.

Everything is relative to ``Scene.origin`` (float64, world space), which lies in the middle of the
geometry, so that float32 coordinates keep their precision however far from the world's origin the
scene was built.  Units: metres, watts, linear scene-referred RGB; Blender's axes (z up).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

# Ray kinds, as bits of `Geometry.object_visibility`, `Lamps.visibility` and `World.visibility`.
CAMERA, DIFFUSE, GLOSSY, TRANSMISSION, SHADOW = 1, 2, 4, 8, 16
ALL_RAYS = CAMERA | DIFFUSE | GLOSSY | TRANSMISSION | SHADOW
# No kind of rays: where the camera sees the object, behind no glass, there is a hole in the picture.
HOLDOUT = 32
# The bit of the first of BLOCKER_SETS sets of objects that hide an emitter which others do not hide: a kind of shadow rays of its own.
FIRST_BLOCKER_SET, BLOCKER_SETS = 256, 22

# Lamp kinds (`Lamps.kind`).
POINT, SPOT, SUN, AREA = 0, 1, 2, 3
# Shapes of an area lamp (`Lamps.shape`).
RECTANGLE, ELLIPSE = 0, 1

# Name of the light group of all that has none, so that the groups add up to the whole.
REMAINDER = "Remainder"

# Flags of a material (`Materials.flags`).  ANGLED: its nodes ask for the side or the angle that it is seen from.  MIRRORING is
# set for views alone (core/view/mirrors.py), BRUSHED and METAL for the rest of the transport (core/surfaces/brushed.py), and so is
# COVERED (core/coincident.py): a material of one triangle, which is black in parts.  TELLING: it shows shadow rays something else than diffuse ones.  PAST_NORMAL: its
# bumps mirror what they turn their backs on.  SMOOTH_COAT: they lie under a coat, which has the surface's own normal.
EMISSIVE, TRANSPARENT, GLOSSY_LOBE, CONSTANT, NORMAL_MAPPED, REFRACTIVE, TRANSLUCENT, ANGLED, MIRRORING = 1, 2, 4, 8, 16, 32, 64, 128, 256
FROSTED, COATED, BRUSHED, METAL, COVERED, TELLING, PAST_NORMAL, SMOOTH_COAT = 512, 1024, 2048, 4096, 8192, 16384, 32768, 65536


@dataclass
class Geometry:
    """World-space triangles of every instance, in one pool.

    vertices: (V, 3) float32, relative to the scene's origin.
    triangles: (T, 3) int32, into `vertices`; the geometric normal is (v1 - v0) x (v2 - v0).
    corner_normals: (T, 3, 3) float32, unit shading normals.
    attributes: (K, T, 3, 4) float32, what materials read at the corners (a UV map, a colour
        attribute, generated or object coordinates): slot k means what each material says it means.
    material: (T,) int32 into `Materials`;  object: (T,) int32 into the object lists.
    object_names: O names;  object_visibility: (O,) uint32 bits of ray kinds, of the sets of blockers that an object is in, and `HOLDOUT`.
    object_groups: O light group names ('' for none), None where no object has one.
    object_receivers, object_blockers: (O,) int32, of objects that shine: the set of those that they light, and of those that hide them; -1 for
        all, and where None is given.  receiver_sets: (K, O) uint8, 1 for the objects of each set of receivers; None for no set.
    lightmap_uv: (T, 3, 2) float32, where a bake asked for them: corners in the object's lightmap, NaN where it has none.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray
    attributes: np.ndarray
    material: np.ndarray
    object: np.ndarray
    object_names: list[str]
    object_visibility: np.ndarray
    object_groups: list[str] | None = None
    lightmap_uv: np.ndarray | None = None
    object_receivers: np.ndarray | None = None
    object_blockers: np.ndarray | None = None
    receiver_sets: np.ndarray | None = None


class MaterialTables(NamedTuple):
    """What the jitted evaluator reads (see core/surfaces/program.py for the instruction set).

    code: (I, 8) int32;  constants: (C, 4) float32;  start: (M,) int32, first instruction.
    flags: (M,) int32;  constant: (M, SURFACE) float32, the surface of a CONSTANT material.
    texture_header: (X, 16) int32;  texels_u8: (B,) uint8;  texels_f32: (F,) float32.
    functions: (3,) uint64, addresses of the rarer instructions' code (core/surfaces/outlined.py), 0 where unused.
    covers: (K, 4, 4) float32, what covers the triangles of COVERED materials in part (core/surfaces/covers.py).
    """

    code: np.ndarray
    constants: np.ndarray
    start: np.ndarray
    flags: np.ndarray
    constant: np.ndarray
    texture_header: np.ndarray
    texels_u8: np.ndarray
    texels_f32: np.ndarray
    functions: np.ndarray = np.zeros(3, np.uint64)
    covers: np.ndarray = np.zeros((0, 4, 4), np.float32)


@dataclass
class Materials:
    """M materials, compiled for the jitted evaluator."""

    names: list[str]
    tables: MaterialTables


@dataclass
class Lamps:
    """L lamps. Each shines along its own -z axis (points: all around).

    kind: (L,) int32.  position: (L, 3) float32.  axes: (L, 3, 3) float32, rows = unit x, y, z.
    emission: (L, 3) float32: radiant intensity W/sr of a point or spot lamp (on the axis), irradiance
        W/m^2 on a plane that faces a sun, radiance W/m^2/sr of an area lamp (on its axis, spread
        normalisation included).
    radius: (L,) float32, of a point or spot lamp's sphere (m); 0 is a point.
    soft_falloff: (L,) uint8, Blender's option of that name.
    angle: (L,) float32: cone angle of a spot, angular diameter of a sun, spread of an area lamp (rad).
    blend: (L,) float32, of a spot.  size: (L, 2) float32, full widths of an area lamp (m).
    shape: (L,) int32.  visibility: (L,) uint8.  cast_shadow: (L,) uint8.
    names: L names;  groups: L light group names ('' for none).
    falloff: (L, 2) float32, exponent k and smoothing s (m^2): at a distance t the light is t^k t^2 / (s + t^2) times what it else were, for
        all lamps but suns; zeros where None is given.
    program: (L,) int32, number of the compiled material that says what a lamp shows each ray, times `emission`; -1 for an even one, and where
        None is given.
    receivers, blockers: (L,) int32, as of `Geometry.object_receivers` and `object_blockers`.
    """

    kind: np.ndarray
    position: np.ndarray
    axes: np.ndarray
    emission: np.ndarray
    radius: np.ndarray
    soft_falloff: np.ndarray
    angle: np.ndarray
    blend: np.ndarray
    size: np.ndarray
    shape: np.ndarray
    visibility: np.ndarray
    cast_shadow: np.ndarray
    names: list[str]
    groups: list[str]
    falloff: np.ndarray | None = None
    program: np.ndarray | None = None
    receivers: np.ndarray | None = None
    blockers: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.falloff is None:
            self.falloff = np.zeros((len(self.kind), 2), np.float32)
        for name in ("program", "receivers", "blockers"):
            if getattr(self, name) is None:
                setattr(self, name, np.full(len(self.kind), -1, np.int32))

    def __len__(self) -> int:
        return len(self.kind)

    def take(self, mask: np.ndarray) -> Lamps:
        """The lamps where `mask` (L,) bool is set."""
        arrays = {n: v[mask] if isinstance(v, np.ndarray) else [x for x, keep in zip(v, mask) if keep] for n, v in vars(self).items()}
        return Lamps(**arrays)

    def joined(self, others: Lamps) -> Lamps:
        """These lamps and others after them."""
        both = ((n, mine, getattr(others, n)) for n, mine in vars(self).items())
        return Lamps(**{n: np.concatenate([a, b]) if isinstance(a, np.ndarray) else a + b for n, a, b in both})

    @staticmethod
    def empty() -> Lamps:
        """No lamps."""
        f, z = np.float32, np.zeros
        return Lamps(
            z(0, np.int32), z((0, 3), f), z((0, 3, 3), f), z((0, 3), f), z(0, f), z(0, np.uint8),
            z(0, f), z(0, f), z((0, 2), f), z(0, np.int32), z(0, np.uint8), z(0, np.uint8), [], [],
        )  # fmt: skip


@dataclass
class World:
    """Light from infinitely far away.

    radiance: (H, W, 3) float32, equirectangular in Blender's layout: row 0 is the top (z = +1); column
        x has the azimuth atan2(d.y, d.x) = pi - 2 pi (x + .5) / W, as Cycles' direction_to_equirectangular.
        (1, 1, 3) is a constant world.
    visibility: bits of ray kinds.  group: name of its light group ('' for none).
    seen: (H, W, 3) float32, what the camera sees instead, past surfaces that let light through as well; None for the same.
    sought: part of Cycles' shadow rays to the sky that follow its brightness; the others seek a sun in it, which is a lamp here.
    portals: (P, 3, 3) float32, rectangles that the world shines in by, as windows: centre, and halves of the edges x and y (m), seen from the side
        that y cross x faces.  They guide rays, and hide nothing.
    """

    radiance: np.ndarray
    visibility: int = ALL_RAYS
    group: str = ""
    seen: np.ndarray | None = None
    sought: float = 1.0
    portals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3), np.float32))


@dataclass
class Camera:
    """A pinhole, orthographic or panoramic (equirectangular) camera.

    matrix: (4, 4) float64, camera to world minus origin, rigid (no scale); looks along -z, y up.
    orthographic: else perspective.
    window: (left, right, bottom, top) of the full frame, at distance 1 (perspective), in metres
        (orthographic) or radians (panoramic: to the right of the axis and above it); sensor fit, shift and pixel aspect are in it.
    width, height: pixels of the full frame.
    border: (x0, y0, x1, y1) in pixels, x to the right, y DOWN from the top: the part to be rendered.
    near, far: clip distances along the view axis (m), of a panorama along the rays.
    panorama: else one of the others.
    """

    matrix: np.ndarray
    orthographic: bool
    window: tuple[float, float, float, float]
    width: int
    height: int
    border: tuple[int, int, int, int]
    near: float
    far: float
    name: str = ""
    panorama: bool = False


@dataclass
class Skipped:
    """One thing left out, and why, for `--stats` and `inspect`."""

    stage: str
    reason: str


@dataclass
class Scene:
    """All that a render reads; a bake of lightmaps needs no camera.

    light_groups: names of the view layer's light groups, whose light gets layers of its own.
    """

    geometry: Geometry
    materials: Materials
    lamps: Lamps
    world: World
    camera: Camera | None
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    frame: int = 1
    view_layer: str = "ViewLayer"
    light_groups: tuple[str, ...] = ()
    warnings: list[str] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)


def bounds(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and the highest coordinates (3,) of places (N, 3), N > 0: by columns, many times as fast as along the first axis."""
    columns = places.T
    return np.array([column.min() for column in columns]), np.array([column.max() for column in columns])
