"""Baking of lightmaps, and the way back, as operators."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..core.errors import SceneError
from .job import Job, computing
from .lightmap_materials import original_of, set_up, take_down
from .operators import JobOperator, NoRender
from .preserved import kept_render_result

if TYPE_CHECKING:
    from ..core.lightmaps import Lightmap
    from .lightmaps import LightmapRequest, SceneLightmaps

_PREFIX = "Lightmap "


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
            self._scene, self._prepared = context.scene, prepare(context.scene, objects, request_of(context, objects))
        return computing(self._prepared.run)

    def abandon(self) -> None:
        """Meshes and UV maps made for a bake that was not go again."""
        if self._prepared is not None:
            self._prepared.before.restore(self._scene)

    def finish(self, context: bpy.types.Context) -> None:
        """Load the images; what was wrong is reported."""
        result = self._job.result.result
        load_lightmaps(context.scene, self._job.result)
        for warning in result.stats["warnings"]:
            self.report({"WARNING"}, warning)
        count = len(result.lightmaps)
        self.report({"INFO"}, f"{count} lightmap{'s' * (count > 1)}: {result.stats['seconds_total']:.1f} s")


class BakeAttributes(NoRender, JobOperator, bpy.types.Operator):
    """Bake the light at the corners of faces into the colour attribute 'Lightmap' of the chosen objects' meshes"""

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
        self._prepared.write(context.scene, light, lit)
        for warning in warnings:
            self.report({"WARNING"}, warning)
        count = len(self._prepared.rows)
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
    changed = [ob for ob in objects if ob.lumigate_lightmap.stamp != stamp_of(ob)]
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


def load_lightmaps(scene: bpy.types.Scene, baked: SceneLightmaps) -> list[bpy.types.Image]:
    """Write the lightmaps where the scene's settings say, load them, and show them on the objects if asked to."""
    settings = scene.lumigate_lightmaps
    images = []
    for lightmap in baked.result.lightmaps:
        image, scale = _loaded(lightmap, settings)
        images.append(image)
        for name in baked.objects[lightmap.name]:
            ob = scene.objects[name]
            take_down([ob])
            ob.lumigate_lightmap.stamp = stamp_of(ob)
            if settings.materials:
                set_up(ob, image, baked.layer, settings.content, scale)
    return images


def _loaded(lightmap: Lightmap, settings: bpy.types.PropertyGroup) -> tuple[bpy.types.Image, float]:
    """The image `Lightmap <name>` of this file, and what its values are to be multiplied by."""
    from .lightmap_files import write_lightmap

    with tempfile.TemporaryDirectory(dir=bpy.app.tempdir) as temporary:
        folder = Path(temporary) if settings.packed else _folder(settings.folder)
        written = write_lightmap(folder, lightmap, settings.content, settings.format)
        image = bpy.data.images.load(str(folder / written["file"]))
        if settings.packed:
            image.pack()
        elif bpy.data.filepath:
            image.filepath = bpy.path.relpath(image.filepath)
    before = bpy.data.images.get(_PREFIX + lightmap.name)
    if before is not None:
        before.user_remap(image)
        bpy.data.images.remove(before)
    image.name = _PREFIX + lightmap.name
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


def stamp_of(ob: bpy.types.Object) -> str:
    """A hash of what an object is by itself: mesh, place, materials, size of its lightmap; not of the light around it."""
    settings = ob.lumigate_lightmap
    materials = [material.name for slot in ob.material_slots if (material := original_of(slot.material)) is not None]
    digest = hashlib.sha256(
        repr((settings.density, materials, [tuple(row) for row in ob.matrix_world], [m.name for m in ob.modifiers])).encode()
    )
    for values, name, width, dtype in (
        (ob.data.vertices, "co", 3, np.float32),
        (ob.data.loops, "vertex_index", 1, np.int32),
        (ob.data.polygons, "material_index", 1, np.int32),
    ):
        array = np.empty(len(values) * width, dtype)
        values.foreach_get(name, array)
        digest.update(array.tobytes())
    return digest.hexdigest()[:16]


CLASSES = (BakeLightmaps, BakeAttributes, RestoreMaterials)
