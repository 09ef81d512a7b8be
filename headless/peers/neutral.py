"""A scene that every renderer can show alike: Lambert surfaces, sharp lamps, one world, a pinhole camera.

It is made once of Lumigate's arrays, and all contestants render it, Lumigate and Cycles too (`blender.build`): what it leaves out is left out
for everyone.  In it

- a surface is a Lambert reflector of the material's base colour (diffuse albedo and reflectance at normal incidence, at most `LIGHTEST`),
  from an image where the colour is a function of one UV map, else constant, the mean over the material's triangles; opacity likewise;
  emission is constant; normals are interpolated, bumps left out;
- point and spot lamps are points, spots have a hard edge, suns no width; area lamps shine over the hemisphere and are seen by all rays;
- images hold linear values in 8 bits, which every renderer reads as they are.

What cannot be made so is refused by a SceneError that names the object.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace

import numpy as np

from ...core.errors import SceneError
from ...core.scene import ALL_RAYS, AREA, SPOT, TRANSLUCENT, Camera, Geometry, Lamps, MaterialTables, Scene
from ...core.surfaces import program
from ...core.surfaces.batch import evaluate_batch
from ...core.surfaces.layout import DIFFUSE, EMISSION, GLOSSY_F0, SURFACE, TRANSPARENCY
from ...core.surfaces.outlined import FIRST
from ...core.surfaces.textures import HEIGHT, WIDTH

LIGHTEST = 0.95
SAMPLES = 4096  # places of a material at which its colours are averaged and its image is tested
LARGEST_IMAGE, PROCEDURAL_IMAGE = 1024, 256  # texels a side
IMAGE_ERROR = 0.03  # mean difference of an image to the material, above which the colour is no function of the UV map
_ROWS = 64  # of an image evaluated at once
_SEEN = 0.01  # opacity, below which a texel has no colour of its own
# Of the scene's extent: how far the back of a sheet that shines on both sides lies behind its front.
_THICKNESS = 1e-5
# Relative to the mean: what varies less is constant.
_EVEN = 1e-3


@dataclass
class Surface:
    """A material: albedo (3,) or (H, W, 3), opacity () or (H, W), float32 in 0..1, rows from the bottom (v = 0); emission (3,) W/m^2/sr."""

    name: str
    albedo: np.ndarray
    opacity: np.ndarray
    emission: np.ndarray

    @property
    def is_textured(self) -> bool:
        """Whether an image gives its colour or its opacity."""
        return self.albedo.ndim > 1 or self.opacity.ndim > 0

    @property
    def is_opaque(self) -> bool:
        """Whether nothing is seen through it."""
        return bool((self.opacity >= 1).all())

    @property
    def shines(self) -> bool:
        """Whether it emits light, from both sides."""
        return bool(self.emission.any())


@dataclass
class Sheet:
    """The T triangles of one material: positions (T, 3, 3) m, unit normals (T, 3, 3), uv (T, 3, 2), float32, by corners."""

    surface: Surface
    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray


@dataclass
class Neutral:
    """The scene; `world` (3,) or (H, W, 3) as `core.scene.World.radiance`.  notes: lines on what was made simpler."""

    sheets: list[Sheet]
    lamps: Lamps
    world: np.ndarray
    camera: Camera
    notes: list[str] = field(default_factory=list)

    @property
    def has_gaps(self) -> bool:
        """Whether light passes through some surface."""
        return not all(sheet.surface.is_opaque for sheet in self.sheets)

    @property
    def extent(self) -> float:
        """Length of the bounds' diagonal (m)."""
        corners = np.array([bound for s in self.sheets for bound in (s.positions.min((0, 1)), s.positions.max((0, 1)))])
        return float(np.linalg.norm(corners.max(0) - corners.min(0)))

    def identity(self) -> dict:
        """What tells it from any other, as values of JSON."""
        digest = hashlib.sha256()
        surfaces = [array for s in self.sheets for array in (s.surface.albedo, s.surface.opacity, s.surface.emission)]
        shapes = [array for s in self.sheets for array in (s.positions, s.normals, s.uv)]
        lamps = [value for value in vars(self.lamps).values() if isinstance(value, np.ndarray)]
        camera = self.camera
        for array in (*surfaces, *shapes, *lamps, self.world, camera.matrix):
            digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
        digest.update(repr((camera.window, camera.width, camera.height, camera.near, camera.far)).encode())
        return {"neutral": digest.hexdigest()}


def back_of(sheet: Sheet, extent: float) -> Sheet:
    """The other side of a sheet, a little behind it in a scene of that extent (m): emitters of the peers shine on their front alone."""
    edges = sheet.positions[:, 1:] - sheet.positions[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    behind = sheet.positions - np.float32(_THICKNESS * extent) * normal[:, None]
    return Sheet(sheet.surface, *(np.ascontiguousarray(array[:, ::-1]) for array in (behind, -sheet.normals, sheet.uv)))


def neutral_scene(scene: Scene) -> Neutral:
    """Of the arrays of a scene.

    Raises:
        SceneError: something in it has no like in one of the renderers.
    """
    camera = _camera(scene.camera)
    _refuse_objects(scene.geometry)
    notes: dict[str, None] = {}
    lamps = _lamps(scene.lamps, notes)
    if scene.world.visibility != ALL_RAYS or scene.world.seen is not None:
        raise SceneError("the world is not the same for all rays, which no peer can do; make it visible to all of them")
    radiance = scene.world.radiance
    world = radiance[0, 0] if radiance.shape[:2] == (1, 1) else radiance
    sheets = [_sheet(scene, number, notes) for number in np.unique(scene.geometry.material)]
    if not (lamps.emission.any() or world.any() or any(sheet.surface.shines for sheet in sheets)):
        raise SceneError("the scene has no light; add a lamp")
    return Neutral(sheets, lamps, np.ascontiguousarray(world, np.float32), camera, list(notes))


def _camera(camera: Camera) -> Camera:
    left, right, bottom, top = camera.window
    if camera.orthographic:
        raise SceneError(f"camera '{camera.name}' is orthographic; the peers' scene takes a perspective one")
    if abs((right - left) / (top - bottom) * camera.height / camera.width - 1) > 1e-4:
        raise SceneError(f"the pixels of camera '{camera.name}' are not square; set the pixel aspect to 1")
    return replace(camera, border=(0, 0, camera.width, camera.height))


def _refuse_objects(geometry: Geometry) -> None:
    partly = np.flatnonzero((geometry.object_visibility & ALL_RAYS) != ALL_RAYS)
    if len(partly):
        name = geometry.object_names[partly[0]]
        raise SceneError(f"object '{name}' is hidden from some kinds of rays, which no peer can do; show it to all or hide it from renders")
    for links in (geometry.object_receivers, geometry.object_blockers):
        if links is not None and (links >= 0).any():
            raise SceneError(f"object '{geometry.object_names[np.argmax(links >= 0)]}' has light linking, which no peer can do; remove it")


def _lamps(lamps: Lamps, notes: dict[str, None]) -> Lamps:
    for number, name in enumerate(lamps.names):
        if lamps.program[number] >= 0:
            raise SceneError(f"lamp '{name}' has nodes that tell rays apart, which no peer can do; remove them")
        if lamps.falloff[number].any():
            raise SceneError(f"lamp '{name}' has a falloff that no peer can do; remove its Light Falloff node")
        if not lamps.cast_shadow[number]:
            raise SceneError(f"lamp '{name}' casts no shadow, which no peer can do; let it cast shadows")
        if lamps.receivers[number] >= 0 or lamps.blockers[number] >= 0:
            raise SceneError(f"lamp '{name}' has light linking, which no peer can do; remove it")
    area = lamps.kind == AREA
    for changed, what in (
        (lamps.radius.any(), "spheres of lamps are points"),
        (lamps.blend.any(), "spots have a hard edge"),
        (lamps.angle[lamps.kind == 2].any(), "suns have no width"),
        ((lamps.angle[area] < np.pi - 1e-3).any(), "area lamps shine over the hemisphere"),
    ):
        if changed:
            notes[what] = None
    # Radiance on the axis stays: a lamp without its softbox only sends more light to the side.
    angle = np.where(area, np.float32(np.pi), np.where(lamps.kind == SPOT, lamps.angle, 0)).astype(np.float32)
    zeros = np.zeros(len(lamps), np.float32)
    return replace(
        lamps,
        radius=zeros,
        soft_falloff=zeros.astype(np.uint8),
        blend=zeros,
        angle=angle,
        visibility=np.full(len(lamps), ALL_RAYS, np.uint8),
    )


def _sheet(scene: Scene, number: int, notes: dict[str, None]) -> Sheet:
    geometry, tables, name = scene.geometry, scene.materials.tables, scene.materials.names[number]
    mine = np.flatnonzero(geometry.material == number)
    positions = geometry.vertices[geometry.triangles[mine]]
    if tables.flags[number] & TRANSLUCENT:
        notes[f"material '{name}' lets no light through to its other side"] = None
    triangle, u, v = _places(mine, positions)
    truth = evaluate_batch(tables, geometry.material, geometry.attributes, triangle, u, v)
    constant = _constant(truth)
    surface = Surface(name, *constant)
    slots = _attribute_slots(tables, number)
    varies = any((np.std(value, 0) > _EVEN * max(1e-3, float(np.mean(value)))).any() for value in _colors(truth)[:2])
    if np.std(truth[:, EMISSION : EMISSION + 3], 0).max() > _EVEN * max(1e-3, surface.emission.max()):
        notes[f"the emission of material '{name}' is its mean"] = None
    uv = np.zeros((len(mine), 3, 2), np.float32)
    if varies and len(slots) == 1:
        uv = geometry.attributes[slots[0], mine, :, :2]
        albedo, opacity = _image(tables, number, geometry.attributes.shape[0], slots[0])
        there = np.einsum("nk,nkc->nc", np.stack([1 - u - v, u, v], 1), geometry.attributes[slots[0], triangle, :, :2])
        albedo = np.where(opacity[..., None] > _SEEN, albedo, constant[0])
        wanted = _colors(truth)
        colour_error = np.abs(_looked_up(albedo, there) - wanted[0]) * wanted[1][:, None]
        if max(colour_error.mean(), np.abs(_looked_up(opacity, there) - wanted[1]).mean()) <= IMAGE_ERROR:
            surface = Surface(name, _simplified(albedo, constant[0]), _simplified(opacity, constant[1]), surface.emission)
    if varies and not surface.is_textured:
        notes[f"the colour of material '{name}' is its mean"] = None
    return Sheet(surface, positions, geometry.corner_normals[mine], np.ascontiguousarray(uv, np.float32))


def _simplified(image: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """An image that varies, in 8 bits; else the mean."""
    image = np.round(image * 255) / np.float32(255)
    return image.astype(np.float32) if np.ptp(image, (0, 1)).max() > 1.5 / 255 else mean


def _places(triangles: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`SAMPLES` triangles, chosen by their area, and barycentric coordinates (u, v) in them."""
    random = np.random.default_rng(0)
    area = np.linalg.norm(np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]), axis=1).astype(float)
    share = area / area.sum() if area.any() else None
    u, v = random.random((2, SAMPLES), np.float32)
    outside = u + v > 1
    return random.choice(triangles, SAMPLES, p=share), np.where(outside, 1 - u, u), np.where(outside, 1 - v, v)


def _colors(surfaces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Albedo (N, 3) and opacity (N,) of evaluated surfaces (N, SURFACE)."""
    opacity = np.clip(1 - surfaces[:, TRANSPARENCY : TRANSPARENCY + 3].mean(1), 0, 1)
    base = surfaces[:, DIFFUSE : DIFFUSE + 3] + surfaces[:, GLOSSY_F0 : GLOSSY_F0 + 3]
    # A mix with transparency weighs its colour by the opacity, which the peers do themselves.
    return np.clip(base / np.maximum(opacity, 1e-3)[:, None], 0, LIGHTEST), opacity


def _constant(surfaces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    albedo, opacity = _colors(surfaces)
    whole = max(float(opacity.sum()), 1e-6)
    mean = (albedo * opacity[:, None]).sum(0) / whole
    emission = surfaces[:, EMISSION : EMISSION + 3].mean(0)
    return tuple(np.asarray(value, np.float32) for value in (mean, opacity.mean(), emission))


def _attribute_slots(tables: MaterialTables, number: int) -> list[int]:
    """Attribute slots that a material's program reads; none of one that reads the view or has more than colours."""
    slots, at = set(), int(tables.start[number])
    while tables.code[at, 0] != program.END:
        operation, parameter = tables.code[at, 0], tables.code[at, 7]
        if operation in (program.ATTRIBUTE, program.DISPLACED) and operation < FIRST:
            slots.add(int(parameter))
        at += 1
    return sorted(slots)


def _image_size(tables: MaterialTables, number: int) -> tuple[int, int]:
    """(width, height) of the largest texture that a material's program reads, within bounds."""
    sizes, at = [], int(tables.start[number])
    while tables.code[at, 0] != program.END:
        if tables.code[at, 0] == program.TEXTURE:
            sizes.append(tables.texture_header[tables.code[at, 7], [WIDTH, HEIGHT]])
        at += 1
    width, height = np.max(sizes, 0) if sizes else (PROCEDURAL_IMAGE, PROCEDURAL_IMAGE)
    return tuple(int(np.clip(side, 1, LARGEST_IMAGE)) for side in (width, height))


def _image(tables: MaterialTables, number: int, slots: int, slot: int) -> tuple[np.ndarray, np.ndarray]:
    """Albedo (H, W, 3) and opacity (H, W) of a material over the unit square of the UV map in `slot`, at the middles of texels."""
    width, height = _image_size(tables, number)
    surfaces = np.empty((height, width, SURFACE), np.float32)
    u = (np.arange(width, dtype=np.float32) + 0.5) / width
    for row in range(0, height, _ROWS):
        v = (np.arange(row, min(row + _ROWS, height), dtype=np.float32) + 0.5) / height
        count = len(v) * width
        attributes = np.zeros((slots, count, 3, 4), np.float32)
        attributes[slot, ..., 0] = np.tile(u, len(v))[:, None]
        attributes[slot, ..., 1] = np.repeat(v, width)[:, None]
        attributes[slot, ..., 3] = 1
        places, zero = np.arange(count, dtype=np.int32), np.zeros(count, np.float32)
        rows = evaluate_batch(tables, np.full(count, number, np.int32), attributes, places, zero, zero)
        surfaces[row : row + len(v)] = rows.reshape(len(v), width, SURFACE)
    albedo, opacity = _colors(surfaces.reshape(-1, SURFACE))
    return albedo.reshape(height, width, 3), opacity.reshape(height, width)


def _looked_up(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """The image, repeated and linearly interpolated, at (N, 2) places."""
    height, width = image.shape[:2]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    s, t = ((value - low).reshape(-1, *(1,) * (image.ndim - 2)) for value, low in ((x, i), (y, j)))
    texel = [[image[(j + b) % height, (i + a) % width] for a in (0, 1)] for b in (0, 1)]
    return (1 - t) * ((1 - s) * texel[0][0] + s * texel[0][1]) + t * ((1 - s) * texel[1][0] + s * texel[1][1])
