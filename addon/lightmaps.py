"""Lightmaps of a Blender scene: which objects, on which UV maps, in which images."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ..core.errors import SceneError
from ..core.jit import CompileTimer
from ..core.lightmaps import BakeResult, Target, bake, check_charts, texels_a_metre
from ..core.scene import Geometry, Scene
from ..core.settings import BakeSettings
from ..core.stages import StageProgress
from .extract import extract_scene
from .lightmap_atlas import ATLAS_LAYER, lay_out
from .lightmap_materials import without_lightmaps
from .lightmap_uv import KeptUvs, Unwrap, check_editable, check_own, ensure_uv

LARGEST_SIDE = 16384  # texels
ATLAS = "Lightmap"  # name of the one image
_GAPS = 0.001, 0.05  # between charts, of the image's side: least and most
_BLOCK = 4  # texels: sides are multiples, as block compression wants them


@dataclass(frozen=True)
class LightmapRequest:
    """What is to be baked.

    size: texels along a side of each image.  density: texels a metre, which then decides the size of each image; densities: of
    single objects, by name.
    atlas: one image for all objects; else one each.  view_layer: whose objects are lit; else the first one that is used for rendering.
    """

    bake: BakeSettings = field(default_factory=BakeSettings)
    unwrap: Unwrap = field(default_factory=Unwrap)
    size: int = 512
    density: float | None = None
    densities: Mapping[str, float] = field(default_factory=dict)
    atlas: bool = False
    view_layer: str | None = None


@dataclass(frozen=True)
class SceneLightmaps:
    """Lightmaps of a scene.

    result: images by name, and statistics.  layer: the UV map that they lie on.  objects: names of the objects of each image.
    made: meshes that got a UV map for it.
    """

    result: BakeResult
    layer: str
    objects: dict[str, list[str]]
    made: list[bpy.types.Mesh]


def choose_objects(
    scene: bpy.types.Scene, names: Sequence[str] | None = None, *, selected: bool = False, view_layer: bpy.types.ViewLayer | None = None
) -> list[bpy.types.Object]:
    """The mesh objects to bake, by name: those named, or those selected, or all that a render of the view layer shows.

    view_layer: else the first one that is used for rendering.

    Raises:
        SceneError: a name that is not there or no mesh with faces, or nothing is left.
    """
    if names is not None:
        return [_named(scene, name) for name in dict.fromkeys(names)]
    layer = view_layer or next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])
    rendered = dict.fromkeys(_rendered(layer.layer_collection))
    there = [ob for ob in rendered if ob.type == "MESH" and len(ob.data.polygons) and not ob.hide_render]
    chosen = [ob for ob in there if ob.select_get(view_layer=layer)] if selected else there
    if not chosen:
        reason = "no mesh object is selected: select some, or bake others than the selected ones" if selected else "it has no meshes"
        raise SceneError(f"scene '{scene.name}': there is nothing to bake, {reason}")
    return sorted(chosen, key=lambda ob: ob.name)


def _rendered(at: bpy.types.LayerCollection) -> Iterator[bpy.types.Object]:
    """The objects of a collection and those below it that are neither excluded nor disabled in renders."""
    if at.collection.hide_render:
        return
    if not at.exclude:
        yield from at.collection.objects
    for child in at.children:
        yield from _rendered(child)


def _named(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    ob = scene.objects.get(name)
    if ob is None:
        meshes = sorted(ob.name for ob in scene.objects if ob.type == "MESH")
        shown = ", ".join(meshes[:8]) + (", ..." if len(meshes) > 8 else "") if meshes else "none"
        raise SceneError(f"no object '{name}' in scene '{scene.name}'; its meshes are: {shown}")
    if ob.type != "MESH" or not len(ob.data.polygons):
        raise SceneError(f"'{name}' has no faces to bake on: convert it to a mesh first")
    if ob.hide_render:
        raise SceneError(f"'{name}' is hidden from renders: enable it, or leave it out")
    return ob


def check_names(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> None:
    """Raises SceneError where one of the objects shares its name with another one of the scene, which only linked ones can: lightmaps go by name."""
    counts = Counter(ob.name for ob in scene.objects)
    for ob in objects:
        if counts[ob.name] > 1:
            raise SceneError(f"scene '{scene.name}' has {counts[ob.name]} objects called '{ob.name}', linked ones among them: rename one")


@dataclass(frozen=True)
class Prepared:
    """A bake of which Blender's part is done: `run` reads arrays only and may be called in any thread.

    before, after: the UV maps that were there, and those that are.  seconds: of extraction, of unwrapping, and of compilation.
    """

    arrays: Scene
    targets: list[Target]
    request: LightmapRequest
    layer: str
    objects: dict[str, list[str]]
    made: list[bpy.types.Mesh]
    before: KeptUvs
    after: KeptUvs
    seconds: tuple[float, float, float]

    def run(self, progress: StageProgress | None = None) -> SceneLightmaps:
        """The lightmaps; raises as `core.lightmaps.bake`."""
        extraction, unwrap, jit = self.seconds
        result = bake(self.arrays, self.targets, self.request.bake, progress, extraction_seconds=extraction)
        result.stats["seconds"]["unwrap"] = unwrap
        result.stats["seconds"]["jit"] += jit
        return SceneLightmaps(result, self.layer, self.objects, self.made)


def bake_scene(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], request: LightmapRequest, progress: StageProgress | None = None
) -> SceneLightmaps:
    """Bake lightmaps of `objects`; they keep the UV maps that had to be made.  Raises as `prepare` and `Prepared.run`."""
    return prepare(scene, objects, request).run(progress)


def prepare(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], request: LightmapRequest) -> Prepared:
    """Make UV maps, read the scene, and check that every object can hold its lightmap.

    Raises:
        SceneError: an object cannot be baked, and why; meshes and UV maps are as they were.
    """
    for ob in objects:
        check_editable(ob)
        if request.atlas:
            check_own(ob)
    check_names(scene, objects)
    before = KeptUvs(objects)
    try:
        return _prepared(scene, objects, request, before)
    except BaseException:
        before.restore()
        raise


def _prepared(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], request: LightmapRequest, before: KeptUvs) -> Prepared:
    if not 1 <= request.size <= LARGEST_SIDE:
        raise SceneError(f"a lightmap of {request.size} texels a side cannot be made; choose 1 to {LARGEST_SIDE}")
    begin = time.perf_counter()
    made, layer, size = unwrap(objects, request)
    unwrapped = time.perf_counter() - begin
    with CompileTimer() as compiling:
        begin = time.perf_counter()
        with without_lightmaps():
            arrays = extract_scene(scene, view_layer=request.view_layer, lightmaps={ob.name: layer for ob in objects})
        found = triangles_by_object(arrays.geometry)
        _check_found(objects, found, layer)
        if request.atlas:
            targets = [_target(ATLAS, arrays.geometry, list(found.values()), size)]
        else:
            targets = [_target(name, arrays.geometry, [rows], _side(arrays.geometry, rows, request)) for name, rows in found.items()]
        for target in targets:
            owner = arrays.geometry.object[target.triangles]
            check_charts(target.uv, owner, arrays.geometry.object_names, layer, max(target.size))
        seconds = time.perf_counter() - begin - compiling.seconds
    members = {target.name: sorted(found) if request.atlas else [target.name] for target in targets}
    return Prepared(arrays, targets, request, layer, members, made, before, KeptUvs(objects), (seconds, unwrapped, compiling.seconds))


def unwrap(objects: Sequence[bpy.types.Object], request: LightmapRequest) -> tuple[list[bpy.types.Mesh], str, int]:
    """Give the objects the UV maps of a request where they lack them: the meshes that got one, the map's name, an image's side.

    Raises:
        SceneError: a mesh cannot get one, or an atlas has no room.
    """
    made = [mesh for ob in objects for mesh in ensure_uv([ob], replace(request.unwrap, gap=_gap(ob, request)))]
    if not request.atlas:
        return made, request.unwrap.layer, request.size
    return made, ATLAS_LAYER, lay_out(objects, request.unwrap.layer, request.size, request.density, request.bake.margin)


def _gap(ob: bpy.types.Object, request: LightmapRequest) -> float:
    """Space between new charts, of the image's side: twice the margin."""
    side = request.size
    density = request.densities.get(ob.name, request.density)
    if density is not None:
        extent = np.array(ob.dimensions)
        side = 2 * density * float(np.sqrt(extent @ np.roll(extent, 1) + 1e-12))  # about that of a box
    return float(np.clip(2 * request.bake.margin / max(side, 1), *_GAPS))


def triangles_by_object(geometry: Geometry) -> dict[str, np.ndarray]:
    """Triangles (T,) int32 that have a place in a lightmap, by object."""
    if geometry.lightmap_uv is None:
        return {}
    rows = np.flatnonzero(~np.isnan(geometry.lightmap_uv[:, 0, 0])).astype(np.int32)
    owner = geometry.object[rows]
    return {geometry.object_names[i]: rows[owner == i] for i in np.unique(owner)}


def _check_found(objects: Iterable[bpy.types.Object], found: dict[str, np.ndarray], layer: str) -> None:
    for ob in objects:
        if ob.name not in found:
            raise SceneError(
                f"'{ob.name}' cannot be baked: a render shows nothing of it, or its modifiers take the UV map '{layer}' away; "
                "enable it for renders, or apply its modifiers"
            )


def _side(geometry: Geometry, rows: np.ndarray, request: LightmapRequest) -> int:
    """Texels along a side of one object's image."""
    name = geometry.object_names[geometry.object[rows[0]]]
    density = request.densities.get(name, request.density)
    if density is None:
        return request.size
    side = density * texels_a_metre(geometry.vertices[geometry.triangles[rows]], geometry.lightmap_uv[rows])
    if side > LARGEST_SIDE:
        raise SceneError(f"'{name}' needs {side:.0f} texels a side at {density:g} texels a metre; choose fewer than that")
    return max(_BLOCK, -int(-side // _BLOCK) * _BLOCK)


def _target(name: str, geometry: Geometry, parts: list[np.ndarray], side: int) -> Target:
    rows = np.concatenate(parts)
    return Target(name, rows, geometry.lightmap_uv[rows], (side, side))
