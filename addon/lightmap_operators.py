"""Baking of lightmaps, and the way back, as operators."""

from __future__ import annotations

import hashlib
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..core.errors import SceneError
from .job import Job, computing
from .lasting import by_uid
from .lightmap_materials import can_wear, is_shown_by_others, original_of, set_up, take_down
from .operators import JobOperator, NoRender
from .preserved import kept_render_result

if TYPE_CHECKING:
    from ..core.lightmaps import Lightmap
    from .lightmap_uv import KeptUvs
    from .lightmaps import LightmapRequest, SceneLightmaps

_PREFIX = "Lightmap "
_OF = "lumigate_lightmap"  # of an image: the name of what it is the lightmap of, which may be too long for the image's own


class BakeLightmaps(NoRender, JobOperator, bpy.types.Operator):
    """Bake the light on the surfaces of objects into images; missing UV maps are made beside those that are there"""

    bl_idname = "lumigate.bake_lightmaps"
    bl_label = "Bake Lightmaps"
    bl_options = {"REGISTER", "UNDO"}

    _prepared = None

    def begin(self, context: bpy.types.Context) -> Job | None:
        """Make UV maps, read the scene, and start to bake."""
        from .lightmaps import prepare

        objects = _chosen(self, context)
        if not objects:
            return None
        settings = context.scene.lumigate_lightmaps
        if not settings.packed:  # before the work, which would be lost
            _folder(settings.folder)
        with kept_render_result():
            self._prepared = prepare(context.scene, objects, request_of(context, objects))
        self._order = Order.of(settings, objects)
        return computing(self._prepared.run)

    def abandon(self) -> None:
        """Meshes and UV maps made for a bake that was not go again."""
        if self._prepared is not None:
            self._prepared.before.restore()

    def finish(self, context: bpy.types.Context) -> None:
        """Load the images; what was wrong is reported."""
        result = self._job.result.result
        images, left_out = load_lightmaps(self._order, self._job.result, self._prepared.after)
        for warning in (*result.stats["warnings"], *left_out):
            self.report({"WARNING"}, warning)
        count = len(images)
        self.report({"INFO"}, f"{count} lightmap{'s' * (count != 1)}: {result.stats['seconds_total']:.1f} s")


class BakeAttributes(NoRender, JobOperator, bpy.types.Operator):
    """Bake the light at the corners of faces into the colour attribute 'Lightmap Color' of the chosen objects' meshes"""

    bl_idname = "lumigate.bake_attributes"
    bl_label = "Bake Colour Attributes"
    bl_options = {"REGISTER", "UNDO"}

    def begin(self, context: bpy.types.Context) -> Job | None:
        """Read the scene, and start to bake."""
        from .lightmap_attributes import prepare_attributes

        objects = _chosen(self, context)
        if not objects:
            return None
        with kept_render_result():
            bake = request_of(context, objects).bake
            self._prepared = prepare_attributes(context.scene, objects, bake, context.view_layer.name)
        return computing(self._prepared.run)

    def finish(self, context: bpy.types.Context) -> None:
        """Store the light; what was wrong is reported."""
        light, lit, warnings = self._job.result
        left_out = self._prepared.write(light, lit)
        for warning in (*warnings, *left_out):
            self.report({"WARNING"}, warning)
        count = len(self._prepared.rows) - len(left_out)
        self.report({"INFO"}, f"{count} colour attribute{'s' * (count != 1)}")


class RestoreMaterials(bpy.types.Operator):
    """Give every object the materials from before its lightmap was set up; the images stay"""

    bl_idname = "lumigate.restore_materials"
    bl_label = "Restore Materials"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """All objects of the scene, in one click."""
        count = take_down(context.scene.objects)
        self.report({"INFO"}, f"{count} object{'s' * (count != 1)} restored")
        return {"FINISHED"}


def _chosen(operator: bpy.types.Operator, context: bpy.types.Context) -> list[bpy.types.Object]:
    objects = chosen_objects(context.scene, context.view_layer)
    if not objects:
        operator.report({"INFO"}, "No object has changed since its last bake")
    return objects


def chosen_objects(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer | None = None) -> list[bpy.types.Object]:
    """The objects that the scene's settings ask for; SceneError as `lightmaps.choose_objects`."""
    from .lightmaps import choose_objects

    settings = scene.lumigate_lightmaps
    objects = choose_objects(scene, selected=settings.objects == "SELECTED", view_layer=view_layer)
    if settings.objects != "CHANGED":
        return objects
    changed = [ob for ob in objects if ob.lumigate_lightmap.stamp != stamp_of(ob, settings)]
    # An atlas is laid out anew, and the others lie in it, too.
    return objects if changed and settings.atlas else changed


def request_of(context: bpy.types.Context, objects: list[bpy.types.Object]) -> LightmapRequest:
    """The request that the settings of the scene and its objects make, for the view layer that the window shows."""
    from .lightmaps import LightmapRequest

    settings = context.scene.lumigate_lightmaps
    return LightmapRequest(
        bake=settings.bake_settings(context.scene.lumigate.as_settings()),
        unwrap=settings.unwrapping(),
        size=settings.size,
        density=settings.density if settings.use_density else None,
        densities={ob.name: ob.lumigate_lightmap.density for ob in objects if ob.lumigate_lightmap.density > 0},
        atlas=settings.atlas,
        view_layer=context.view_layer.name,
    )


@dataclass(frozen=True)
class Order:
    """What became of a bake was asked when it began: the scene's settings and its objects may be others when it ends.

    folder: None where the images are packed.  uids, stamps: of the objects, by name.
    """

    content: str
    format: str
    folder: Path | None
    materials: bool
    uids: dict[str, int]
    stamps: dict[str, str]

    @staticmethod
    def of(settings: bpy.types.PropertyGroup, objects: list[bpy.types.Object]) -> Order:
        """The present settings, and the objects with the UV maps that they are baked on."""
        return Order(
            settings.content,
            settings.format,
            None if settings.packed else _folder(settings.folder),
            settings.materials,
            {ob.name: ob.session_uid for ob in objects},
            {ob.name: stamp_of(ob, settings) for ob in objects},
        )


def load_lightmaps(order: Order, baked: SceneLightmaps, maps: KeptUvs) -> tuple[list[bpy.types.Image], list[str]]:
    """Write the lightmaps where they were ordered, load them, and show them on the objects if asked to; warnings of what could not be.

    maps: the UV maps that they were baked on.
    """
    images, warnings = [], []
    for lightmap in baked.result.lightmaps:
        there = by_uid(bpy.data.objects)
        objects = {name: there[order.uids[name]] for name in baked.objects[lightmap.name] if order.uids[name] in there}
        gone = [name for name in baked.objects[lightmap.name] if name not in objects]
        warnings += [f"'{name}' has gone since its bake began: its light is left out" for name in gone]
        if not objects:
            continue
        try:
            image, scale = _loaded(lightmap, order, list(objects.values()))
        except (SceneError, OSError) as error:
            if order.folder is None:
                raise
            warnings.append(f"{' '.join(str(error).split())}: the lightmaps are packed into the file instead")
            order = replace(order, folder=None)
            image, scale = _loaded(lightmap, order, list(objects.values()))
        images.append(image)
        take_down(objects.values())
        for name, ob in objects.items():
            ob.lumigate_lightmap.stamp = order.stamps[name]
            if not order.materials:
                continue
            if not can_wear(ob):
                warnings.append(
                    f"'{name}' is linked, and its materials cannot be changed here: make a library override to show its lightmap"
                )
            elif not maps.has(ob, baked.layer):
                warnings.append(f"'{name}' has lost the UV map '{baked.layer}' since its bake began: bake it again to see its lightmap")
            else:
                set_up(ob, image, baked.layer, order.content, scale)
    return images, warnings


def _loaded(lightmap: Lightmap, order: Order, objects: list[bpy.types.Object]) -> tuple[bpy.types.Image, float]:
    """The image `Lightmap <name>` of this file, for these objects, and what its values are to be multiplied by.

    One from before makes room, and its file in that folder, too, unless other objects, which this bake left out, still show it: their charts
    have no place in the new one.
    """
    from .lightmap_files import free_path, write_lightmap

    before = next((image for image in bpy.data.images if image.get(_OF) == lightmap.name and image.library is None), None)
    if before is not None and is_shown_by_others(before, objects):
        before.name = f"{_PREFIX}{lightmap.name} before"
        del before[_OF]
        before = None
    with tempfile.TemporaryDirectory(dir=order.folder or bpy.app.tempdir, prefix=".lumigate-") as temporary:
        written = write_lightmap(Path(temporary), lightmap, order.content, order.format)
        path = Path(temporary) / written["file"]
        if order.folder is not None:
            file = Path(bpy.path.abspath(before.filepath)) if before is not None and before.packed_file is None else path
            replaces = file.parent.resolve() == order.folder.resolve() and file.suffix == path.suffix
            path = path.replace(file if replaces else free_path(order.folder, lightmap.name, order.format))
        image = bpy.data.images.load(str(path))
        if order.folder is None:
            image.pack()
        elif bpy.data.filepath:
            image.filepath = bpy.path.relpath(image.filepath)
    if before is not None:
        before.user_remap(image)
        bpy.data.images.remove(before)
    image.name, image[_OF] = _PREFIX + lightmap.name, lightmap.name
    return image, written["scale"]


def _folder(chosen: str) -> Path:
    """The folder for images on disk, made if missing."""
    if chosen.startswith("//") and not bpy.data.filepath:
        raise SceneError("the lightmaps' folder is relative to a file that is not saved yet: save it, choose another folder, or pack them")
    folder = Path(bpy.path.abspath(chosen))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):  # only the attempt tells
            pass
    except OSError as error:
        raise SceneError(f"cannot write into the folder '{folder}' ({error.strerror}): choose another one for the lightmaps") from error
    return folder


def stamp_of(ob: bpy.types.Object, settings: bpy.types.PropertyGroup) -> str:
    """A hash of what an object's lightmap is of: its evaluated mesh and charts, place, materials, content and size; not the light around it."""
    from .extract.fingerprint import fingerprint
    from .lightmap_atlas import ATLAS_LAYER
    from .lightmap_uv import LAYER

    asked = settings.content, settings.size, settings.use_density and settings.density, settings.atlas, ob.lumigate_lightmap.density
    trees = [original.node_tree for slot in ob.material_slots if (original := original_of(slot.material)) is not None]
    digest = hashlib.sha256(repr((asked, [tuple(row) for row in ob.matrix_world], [tree and fingerprint(tree) for tree in trees])).encode())
    evaluated = ob.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    charts = mesh.uv_layers.get(ATLAS_LAYER if settings.atlas else LAYER)
    for values, name, width, dtype in (
        (mesh.vertices, "co", 3, np.float32),
        (mesh.loops, "vertex_index", 1, np.int32),
        (mesh.polygons, "material_index", 1, np.int32),
        (charts.data if charts else (), "uv", 2, np.float32),
    ):
        array = np.empty(len(values) * width, dtype)
        if len(array):
            values.foreach_get(name, array)
        digest.update(array.tobytes())
    evaluated.to_mesh_clear()
    return digest.hexdigest()[:16]


CLASSES = (BakeLightmaps, BakeAttributes, RestoreMaterials)
