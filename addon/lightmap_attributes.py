"""Light in colour attributes: no UV map, no image, as fine as the mesh is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.errors import SceneError
from ..core.lightmaps import bake_corners
from ..core.scene import Scene
from ..core.settings import BakeSettings
from ..core.stages import StageProgress
from .extract import extract_scene
from .lightmaps import triangles_by_object

ATTRIBUTE = "Lightmap"
_EVERY_MESH_HAS = "position"  # a layer that marks the triangles of the chosen objects in the scene's arrays
_SAME_NORMAL = 25  # steps from 0 to 1: corners of a vertex whose normals round to the same one are one smooth surface


@dataclass(frozen=True)
class PreparedAttributes:
    """A bake of which Blender's part is done; rows: the triangles of each object, by its name."""

    arrays: Scene
    rows: dict[str, np.ndarray]
    settings: BakeSettings

    def run(self, progress: StageProgress | None = None) -> tuple[np.ndarray, np.ndarray, list[str]]:
        """What `write` wants, in any thread, and warnings; raises as `core.lightmaps.bake_corners`."""
        return bake_corners(self.arrays, np.concatenate(list(self.rows.values())), self.settings, progress)

    def write(self, scene: bpy.types.Scene, light: np.ndarray, lit: np.ndarray) -> None:
        """Store the light (T, 3, 3) of the corners that hold some (T, 3)."""
        ends = np.cumsum([len(rows) for rows in self.rows.values()])[:-1]
        for name, values, known in zip(self.rows, np.split(light, ends), np.split(lit, ends)):
            write_attribute(scene.objects[name], values, known)


def bake_attributes(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], settings: BakeSettings, progress: StageProgress | None = None
) -> list[str]:
    """Bake the light at the corners of the objects' faces into the colour attribute `ATTRIBUTE` of their meshes; warnings.

    Raises:
        SceneError: an object cannot be baked, and why.
        core.threads.Cancelled: `progress` returned False; no mesh has changed.
    """
    prepared = prepare_attributes(scene, objects, settings)
    light, lit, warnings = prepared.run(progress)
    prepared.write(scene, light, lit)
    return warnings


def prepare_attributes(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], settings: BakeSettings, view_layer: str | None = None
) -> PreparedAttributes:
    """Read the scene, and check that every object can hold its light; raises SceneError where one cannot, and why.

    view_layer: whose objects are lit; else the first one that is used for rendering.
    """
    for ob in objects:
        if ob.data.users > 1:
            raise SceneError(f"'{ob.name}' shares its mesh with other objects, and a mesh holds one light: make it single-user")
        there = ob.data.color_attributes.get(ATTRIBUTE)
        if there is not None and (there.data_type, there.domain) != ("FLOAT_COLOR", "CORNER"):
            raise SceneError(f"'{ob.name}' has a colour attribute '{ATTRIBUTE}' of another kind: rename or remove it")
    arrays = extract_scene(scene, view_layer=view_layer, lightmaps={ob.name: _EVERY_MESH_HAS for ob in objects})
    rows = triangles_by_object(arrays.geometry)
    for ob in objects:
        ob.data.calc_loop_triangles()
        if ob.name not in rows or len(rows[ob.name]) != len(ob.data.loop_triangles):
            raise SceneError(f"'{ob.name}' has other faces in a render than in its mesh: apply its modifiers first")
    return PreparedAttributes(arrays, {ob.name: rows[ob.name] for ob in objects}, settings)


def write_attribute(ob: bpy.types.Object, light: np.ndarray, lit: np.ndarray) -> None:
    """Average light (T, 3, 3) at the corners of an object's triangles over its smooth vertices, and store it; unlit ones (T, 3) do not count."""
    mesh = ob.data
    loops, vertices = np.empty((len(mesh.loop_triangles), 3), np.int32), np.empty(len(mesh.loops), np.int32)
    mesh.loop_triangles.foreach_get("loops", loops.ravel())
    mesh.loops.foreach_get("vertex_index", vertices)
    if ob.matrix_world.determinant() < 0:  # extraction has turned the triangles of mirrored objects
        loops = loops[:, [0, 2, 1]]
    normals = np.empty((len(mesh.loops), 3), np.float32)
    mesh.corner_normals.foreach_get("vector", normals.ravel())
    keys = np.column_stack([vertices, np.rint(normals * _SAME_NORMAL).astype(np.int32)])
    _, group = np.unique(keys, axis=0, return_inverse=True)
    at, weight = group.ravel()[loops.ravel()], lit.ravel().astype(np.float64)
    count = np.bincount(at, weight, group.max() + 1)
    known = count > 0
    colors = np.ones((len(mesh.loops), 4), np.float32)
    for c in range(3):
        total = np.bincount(at, weight * light[..., c].ravel(), len(count))
        mean = total.sum() / max(count.sum(), 1)
        colors[:, c] = np.where(known, total / np.maximum(count, 1), mean)[group.ravel()]
    attributes = mesh.color_attributes
    shown = attributes.render_color_index
    layer = attributes.get(ATTRIBUTE) or attributes.new(ATTRIBUTE, "FLOAT_COLOR", "CORNER")
    layer.data.foreach_set("color", colors.ravel())
    if shown >= 0:
        attributes.render_color_index = shown
