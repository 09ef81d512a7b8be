"""Light in colour attributes: no UV map, no image, as fine as the mesh is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bmesh
import bpy
import numpy as np

from ..core.errors import SceneError
from ..core.lightmaps import bake_corners
from ..core.scene import Scene
from ..core.settings import BakeSettings
from ..core.stages import StageProgress
from .extract import extract_scene
from .lasting import by_uid
from .lightmap_materials import without_lightmaps
from .lightmap_uv import check_editable, check_own
from .lightmaps import check_names, triangles_by_object

ATTRIBUTE = "Lightmap Color"  # attributes and UV maps of a mesh share their names
_EVERY_MESH_HAS = "position"  # a layer that marks the triangles of the chosen objects in the scene's arrays
_KIND = "FLOAT_COLOR", "CORNER"
_SAME_NORMAL = 25  # steps from 0 to 1: corners of a vertex whose normals round to the same one are one smooth surface


@dataclass(frozen=True)
class Corners:
    """The corners of an object's faces when its bake began.

    uid: the object's.  name: the object's.  vertices: (loops,) of each corner.  group: (loops,) index of the smooth vertex that it is
    part of.  loops: (T, 3) corners of the triangles.
    """

    uid: int
    name: str
    vertices: np.ndarray
    group: np.ndarray
    loops: np.ndarray

    @staticmethod
    def of(ob: bpy.types.Object) -> Corners:
        """Those of an object as it is."""
        mesh = ob.data
        loops = np.empty((len(mesh.loop_triangles), 3), np.int32)
        mesh.loop_triangles.foreach_get("loops", loops.ravel())
        if ob.matrix_world.determinant() < 0:  # extraction has turned the triangles of mirrored objects
            loops = loops[:, [0, 2, 1]]
        vertices, normals = _vertices(mesh), np.empty((len(mesh.loops), 3), np.float32)
        mesh.corner_normals.foreach_get("vector", normals.ravel())
        keys = np.column_stack([vertices, np.rint(normals * _SAME_NORMAL).astype(np.int32)])
        _, group = np.unique(keys, axis=0, return_inverse=True)
        return Corners(ob.session_uid, ob.name, vertices, group.ravel(), loops)

    def colors(self, light: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """(loops, 4) float32: light (T, 3, 3) at the corners of the triangles, averaged over smooth vertices; unlit ones (T, 3) do not count."""
        at, weight = self.group[self.loops.ravel()], lit.ravel().astype(np.float64)
        count = np.bincount(at, weight, self.group.max() + 1)
        known = count > 0
        colors = np.ones((len(self.group), 4), np.float32)
        for c in range(3):
            total = np.bincount(at, weight * light[..., c].ravel(), len(count))
            mean = total.sum() / max(count.sum(), 1)
            colors[:, c] = np.where(known, total / np.maximum(count, 1), mean)[self.group]
        return colors


@dataclass(frozen=True)
class PreparedAttributes:
    """A bake of which Blender's part is done; rows: the triangles of each object, by its name."""

    arrays: Scene
    rows: dict[str, np.ndarray]
    corners: list[Corners]
    settings: BakeSettings

    def run(self, progress: StageProgress | None = None) -> tuple[np.ndarray, np.ndarray, list[str]]:
        """What `write` wants, in any thread, and warnings; raises as `core.lightmaps.bake_corners`."""
        return bake_corners(self.arrays, np.concatenate(list(self.rows.values())), self.settings, progress)

    def write(self, light: np.ndarray, lit: np.ndarray) -> list[str]:
        """Store the light (T, 3, 3) of the corners that hold some (T, 3), whatever the objects are called by now; what could not be stored."""
        ends = np.cumsum([len(rows) for rows in self.rows.values()])[:-1]
        objects, left_out = by_uid(bpy.data.objects), []
        for corners, values, known in zip(self.corners, np.split(light, ends), np.split(lit, ends)):
            ob = objects.get(corners.uid)
            if ob is None or not _store(ob.data, corners.vertices, corners.colors(values, known)):
                change = "has gone" if ob is None else "has other faces"
                left_out.append(f"'{corners.name}' {change} since its bake began: its light is left out")
        return left_out


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
    return [*warnings, *prepared.write(light, lit)]


def prepare_attributes(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], settings: BakeSettings, view_layer: str | None = None
) -> PreparedAttributes:
    """Read the scene, and check that every object can hold its light; raises SceneError where one cannot, and why.

    view_layer: whose objects are lit; else the first one that is used for rendering.
    """
    check_names(scene, objects)
    for ob in objects:
        check_editable(ob)
        check_own(ob)
        if ob.data.users > 1:
            raise SceneError(f"'{ob.name}' shares its mesh with other objects, and a mesh holds one light: make it single-user")
        there = ob.data.attributes.get(ATTRIBUTE)
        if there is not None and (there.data_type, there.domain) != _KIND:
            raise SceneError(f"'{ob.name}' has an attribute '{ATTRIBUTE}' of another kind: rename or remove it")
    with without_lightmaps():
        arrays = extract_scene(scene, view_layer=view_layer, lightmaps={ob.name: _EVERY_MESH_HAS for ob in objects})
    rows = triangles_by_object(arrays.geometry)
    for ob in objects:
        ob.data.calc_loop_triangles()
        if ob.name not in rows or len(rows[ob.name]) != len(ob.data.loop_triangles):
            raise SceneError(f"'{ob.name}' has other faces in a render than in its mesh: apply its modifiers first")
    return PreparedAttributes(arrays, {ob.name: rows[ob.name] for ob in objects}, [Corners.of(ob) for ob in objects], settings)


def _vertices(mesh: bpy.types.Mesh) -> np.ndarray:
    """(loops,) int32 vertex of each corner."""
    vertices = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", vertices)
    return vertices


def _store(mesh: bpy.types.Mesh, vertices: np.ndarray, colors: np.ndarray) -> bool:
    """Write colours (loops, 4) into the attribute `ATTRIBUTE`, in Edit Mode, too; False where the mesh has other corners than `vertices`."""
    if mesh.is_editmode:
        edited = bmesh.from_edit_mesh(mesh)
        edited.verts.index_update()
        corners = [corner for face in edited.faces for corner in face.loops]
        if [corner.vert.index for corner in corners] != vertices.tolist():
            return False
        layer = edited.loops.layers.float_color.get(ATTRIBUTE) or edited.loops.layers.float_color.new(ATTRIBUTE)
        corners = [corner for face in edited.faces for corner in face.loops]  # a new layer has moved them
        for corner, color in zip(corners, colors):
            corner[layer] = color
        bmesh.update_edit_mesh(mesh, loop_triangles=False, destructive=False)
        return True
    if not np.array_equal(_vertices(mesh), vertices):
        return False
    attributes = mesh.color_attributes
    shown = attributes.render_color_index
    layer = attributes.get(ATTRIBUTE) or attributes.new(ATTRIBUTE, *_KIND)
    layer.data.foreach_set("color", colors.ravel())
    if shown >= 0:
        attributes.render_color_index = shown
    return True
