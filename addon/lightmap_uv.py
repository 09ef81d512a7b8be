"""UV maps for lightmaps: the one that an object has, or a new one beside those that it has."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import bmesh
import bpy
import numpy as np

from ..core.errors import SceneError
from .lasting import by_uid

LAYER = "Lightmap"
MOST_LAYERS = 8  # of a mesh, Blender's own limit
# Smart UV Project keeps charts large; Lightmap Pack lays every face out by itself, which can never overlap.
UNWRAPPERS = ("smart", "pack")
_ANGLE = np.radians(66)
_WELL_FILLED = 0.4  # of the image's area


@dataclass(frozen=True)
class Unwrap:
    """How UV maps are made where they are missing.

    layer: name of the UV map.  method: one of `UNWRAPPERS`.  gap: between charts, of the image's side.
    """

    layer: str = LAYER
    method: str = "smart"
    gap: float = 0.01


def ensure_uv(objects: Iterable[bpy.types.Object], unwrap: Unwrap) -> list[bpy.types.Mesh]:
    """Give every mesh of the objects the UV map of `unwrap`, unless it has it; the meshes that got one.

    What is selected or active, other UV maps, and which of them materials read, stay as they are.

    Raises:
        SceneError: a mesh cannot get one.
    """
    made = []
    for ob in objects:
        if unwrap.layer in ob.data.uv_layers:
            continue
        check_editable(ob)
        _check_free(ob)
        set_uv(ob.data, unwrap.layer, _unwrapped(ob, unwrap))
        made.append(ob.data)
    return made


class KeptUvs:
    """The meshes and UV maps that objects have now; `restore` gives them back, whatever has been renamed, undone or edited meanwhile."""

    def __init__(self, objects: Iterable[bpy.types.Object]):
        self._kept = {
            ob.session_uid: (ob.data.session_uid, {layer.name: _coordinates(layer) for layer in ob.data.uv_layers}) for ob in objects
        }

    def restore(self) -> None:
        """Take new meshes and UV maps away, and give those that were there their coordinates; what has gone since is left out."""
        objects, meshes = by_uid(bpy.data.objects), by_uid(bpy.data.meshes)
        for uid, (mesh_uid, layers) in self._kept.items():
            ob, mesh = objects.get(uid), meshes.get(mesh_uid)
            if ob is None or mesh is None:
                continue
            own = ob.data
            if own != mesh and own.is_editmode:
                mesh = own  # with what is being edited
            elif own != mesh:
                ob.data = mesh
                if not own.users:
                    bpy.data.meshes.remove(own)
            for layer in [layer.name for layer in mesh.uv_layers if layer.name not in layers]:
                mesh.uv_layers.remove(mesh.uv_layers[layer])
            for layer, uv in layers.items():
                _put_back(mesh, layer, uv)

    def has(self, ob: bpy.types.Object, layer: str) -> bool:
        """Whether an object, one of these, has this UV map still; undo may have taken it away, and then it is made again where it fits."""
        mesh, (mesh_uid, layers) = ob.data, self._kept[ob.session_uid]
        if mesh.session_uid != mesh_uid:
            return False
        uv = layers.get(layer)
        if layer not in mesh.uv_layers and uv is not None and not mesh.is_editmode and uv.size == 2 * len(mesh.loops):
            set_uv(mesh, layer, uv)
        return layer in mesh.uv_layers


def _put_back(mesh: bpy.types.Mesh, layer: str, uv: np.ndarray) -> None:
    """Give a UV map its coordinates again, where the mesh has as many corners as it had."""
    if layer not in mesh.uv_layers:
        return
    if mesh.is_editmode:
        edited = bmesh.from_edit_mesh(mesh)
        at = edited.loops.layers.uv[layer]
        corners = [corner for face in edited.faces for corner in face.loops]
        if uv.size == 2 * len(corners):
            for corner, place in zip(corners, uv.reshape(-1, 2)):
                corner[at].uv = place
            bmesh.update_edit_mesh(mesh, loop_triangles=False, destructive=False)
        return
    there = mesh.uv_layers[layer]
    if len(there.data) * 2 == uv.size and not np.array_equal(_coordinates(there), uv):
        there.data.foreach_set("uv", uv)


def _coordinates(layer: bpy.types.MeshUVLoopLayer) -> np.ndarray:
    """(2 loops,) float32."""
    uv = np.empty(2 * len(layer.data), np.float32)
    layer.data.foreach_get("uv", uv)
    return uv


def set_uv(mesh: bpy.types.Mesh, name: str, uv: np.ndarray) -> None:
    """Write the UV map `name`, (loops, 2), made if missing; which map is active, and which materials read, stays as it is."""
    active, rendered = mesh.uv_layers.active, next((layer.name for layer in mesh.uv_layers if layer.active_render), None)
    active = active and active.name
    layer = mesh.uv_layers.get(name) or _new_layer(mesh, name)
    layer.data.foreach_set("uv", np.ascontiguousarray(uv, np.float32).ravel())
    if active is not None:
        mesh.uv_layers.active = mesh.uv_layers[active]
    if rendered is not None:
        mesh.uv_layers[rendered].active_render = True


def _new_layer(mesh: bpy.types.Mesh, name: str) -> bpy.types.MeshUVLoopLayer:
    layer = mesh.uv_layers.new(name=name, do_init=False)
    if layer is None:
        raise SceneError(f"mesh '{mesh.name}' cannot get another UV map: it has {MOST_LAYERS}; remove one")
    if layer.name == name:
        return layer
    mesh.uv_layers.remove(layer)
    if name in mesh.attributes:
        raise SceneError(
            f"mesh '{mesh.name}' has an attribute '{name}' that is no UV map: rename or remove it, or choose another name for the UV map"
        )
    raise SceneError(f"no UV map can be called '{name}'; choose {'a shorter name' if name else 'a name'} for it")


def check_editable(ob: bpy.types.Object) -> None:
    """Raises SceneError where an object's mesh is being edited: it is not read before Edit Mode ends."""
    if ob.data.is_editmode:
        raise SceneError(f"'{ob.name}' is being edited: leave Edit Mode first")


def check_own(ob: bpy.types.Object) -> None:
    """Raises SceneError where an object's mesh is linked: what it gets here is not saved."""
    if ob.data.library is not None:
        raise SceneError(f"the mesh of '{ob.name}' is linked from another file and cannot be changed here: make it local, or bake it there")


def _check_free(ob: bpy.types.Object) -> None:
    mesh = ob.data
    if mesh.library is not None:
        raise SceneError(f"'{ob.name}' is linked from another file and has no UV map for a lightmap: make it local or unwrap it there")
    if len(mesh.uv_layers) >= MOST_LAYERS:
        raise SceneError(f"'{ob.name}' has {MOST_LAYERS} UV maps already: remove one")


def _unwrapped(ob: bpy.types.Object, unwrap: Unwrap) -> np.ndarray:
    """(loops, 2) float32 UV coordinates of the object's mesh, true to its scale, that lie apart and fill the image well."""
    faults = None
    for gap in (unwrap.gap, unwrap.gap / 2, unwrap.gap / 4):  # where charts are many, wide gaps leave them no room
        uv, used, found = _unwrapped_by(ob, unwrap.method, gap)
        if found is not None:
            faults = found
            break
        if used > _WELL_FILLED:
            break
    if faults is None:
        return uv
    uv, _, faults = _unwrapped_by(ob, "pack", unwrap.gap)
    if faults is None:
        return uv
    raise SceneError(f"Blender cannot unwrap '{ob.name}' for a lightmap ({faults}): unwrap it by hand into a UV map '{unwrap.layer}'")


def _unwrapped_by(ob: bpy.types.Object, method: str, gap: float) -> tuple[np.ndarray, float, str | None]:
    """UV coordinates (loops, 2) by one of Blender's operators, on a copy; the share of the image that they use; what is unfit."""
    with _lone_copy(ob) as copy:
        mesh = copy.data
        if method == "smart":
            with _edit_mode(copy):
                bpy.ops.uv.smart_project(angle_limit=_ANGLE, margin_method="FRACTION", island_margin=gap / 2, correct_aspect=False)
        else:
            bpy.ops.uv.lightmap_pack(PREF_CONTEXT="ALL_FACES", PREF_MARGIN_DIV=min(1.0, 50 * gap))
    uv = np.empty((len(mesh.loops), 2), np.float32)
    mesh.uv_layers[0].data.foreach_get("uv", uv.ravel())
    mesh.calc_loop_triangles()
    loops = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("loops", loops.ravel())
    bpy.data.meshes.remove(mesh)
    corners = uv[loops]
    edges = corners[:, 1:] - corners[:, :1]
    used = float(np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]).sum() / 2)
    return uv, used, _faults(corners, ob.name)


def _faults(corners: np.ndarray, name: str) -> str | None:
    """What of UV coordinates (T, 3, 2) is unfit for a lightmap, None if nothing."""
    from ..core.lightmaps import check_charts  # with Numba, which takes a second to import

    try:
        check_charts(corners, np.zeros(len(corners), np.int64), [name], LAYER)
    except SceneError as error:
        return str(error)
    return None


@contextmanager
def _lone_copy(ob: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """A selected copy of the object in a scene of its own, its mesh in metres with one UV map.

    The mesh outlives the block; object and scene do not.
    """
    mesh = ob.data.copy()
    mesh.materials.clear()
    while mesh.uv_layers:
        mesh.uv_layers.remove(mesh.uv_layers[-1])
    mesh.uv_layers.new(name=LAYER)
    linear = ob.matrix_world.to_3x3().to_4x4()
    if abs(linear.determinant()) > 0:
        mesh.transform(linear)
    for name in (".hide_poly", ".hide_edge", ".hide_vert"):  # hidden faces are not unwrapped
        if name in mesh.attributes:
            mesh.attributes.remove(mesh.attributes[name])
    scene = bpy.data.scenes.new("Lumigate")
    copy = bpy.data.objects.new("Lumigate", mesh)
    scene.collection.objects.link(copy)
    layer = scene.view_layers[0]
    layer.objects.active = copy
    copy.select_set(True, view_layer=layer)
    try:
        with bpy.context.temp_override(scene=scene, view_layer=layer, object=copy, active_object=copy, selected_objects=[copy]):
            yield copy
    finally:
        bpy.data.objects.remove(copy)
        bpy.data.scenes.remove(scene)


@contextmanager
def _edit_mode(ob: bpy.types.Object) -> Iterator[None]:
    """Edit Mode with every face selected."""
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        with bpy.context.temp_override(edit_object=ob):
            bpy.ops.mesh.select_all(action="SELECT")
            yield
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
