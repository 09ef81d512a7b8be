"""What the core cannot compute is baked by Cycles: one colour socket of a material, over all objects that wear it.

Everything happens in a temporary scene on temporary copies.  Bakes are kept in the user's cache folder
under a hash of what they depend on.
"""

from __future__ import annotations

import hashlib
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np
import platformdirs

from . import atlas
from .registry import Unsupported

if TYPE_CHECKING:
    from .tree import Scope

_SIDE, _LARGEST_SIDE = 1024, 4096
_SAMPLES = 4
_MARGIN = 2  # texels: enough for linear interpolation, and less than what would reach the next cell's polygon
_UV = "lumigate bake"


class Baker:
    """Bakes sockets of one material; all its bakes share one UV layout.

    may_bake: Cycles may run now; else only bakes that are kept from before are given.
    """

    def __init__(self, material: bpy.types.Material, objects: tuple[bpy.types.Object, ...], may_bake: bool = True):
        self._may_bake = may_bake and threading.current_thread() is threading.main_thread()
        self.material = material
        self.objects = {o.name: o for o in objects if o.type in ("MESH", "CURVE", "SURFACE", "META", "FONT")}
        self._layout: tuple[int, dict[str, np.ndarray]] | None = None

    def bake(self, scope: Scope, socket: bpy.types.NodeSocket) -> np.ndarray:
        """(S, S, 3) float32 colours of an output socket over the layout.

        Raises:
            Unsupported: nothing to bake on, or no place to do it from.
        """
        if not self.objects:
            raise Unsupported("no object wears the material")
        side, corner_uvs = self._corner_uvs()
        file = cache_folder() / f"{self._key(scope, socket, side)}.npy"
        if file.is_file():
            return np.load(file).astype(np.float32)
        if not self._may_bake:
            raise Unsupported("Cycles cannot bake while a render runs, so bake it before ('Check and Prepare Scene' in Lumigate's panel)")
        with _temporary() as scene:
            image = bpy.data.images.new("lumigate bake", side, side, alpha=False, float_buffer=True)
            material = self._emitting_copy(scope, socket, image)
            filler = _filler(image)
            for k, (name, ob) in enumerate(self.objects.items()):
                copy = _copied(ob, corner_uvs[name], scene)
                for slot in range(len(copy.data.materials)):
                    mine = copy.data.materials[slot] is not None and copy.data.materials[slot].original == self.material.original
                    copy.data.materials[slot] = material if mine else filler
                _bake_object(scene, copy, clear=k == 0)
            pixels = np.empty(side * side * image.channels, np.float32)
            image.pixels.foreach_get(pixels)
        colors = pixels.reshape(side, side, -1)[..., :3].astype(np.float16)
        _store(file, colors)
        return colors.astype(np.float32)

    def uvs(self) -> dict[str, np.ndarray]:
        """Per object (triangles, 3, 2) float32, in the order of `loop_triangles`."""
        _, corner_uvs = self._corner_uvs()
        found = {}
        for name, ob in self.objects.items():
            mesh = ob.to_mesh()
            mesh.calc_loop_triangles()
            loops = np.empty(len(mesh.loop_triangles) * 3, np.int32)
            mesh.loop_triangles.foreach_get("loops", loops)
            found[name] = corner_uvs[name][loops].reshape(-1, 3, 2)
            ob.to_mesh_clear()
        return found

    def _corner_uvs(self) -> tuple[int, dict[str, np.ndarray]]:
        """(side, per object (loops, 2) UVs); polygons of other materials have no cell and lie on one point."""
        if self._layout is None:
            counts, areas, loops, total = [], [], {}, {}
            for name, ob in self.objects.items():
                mesh = ob.to_mesh()
                chosen = self._polygons(mesh)
                start, count, area = (np.empty(len(mesh.polygons), t) for t in (np.int32, np.int32, np.float32))
                mesh.polygons.foreach_get("loop_start", start)
                mesh.polygons.foreach_get("loop_total", count)
                mesh.polygons.foreach_get("area", area)
                counts.append(count[chosen])
                areas.append(area[chosen] * abs(ob.matrix_world.determinant()) ** (2 / 3))
                loops[name] = np.concatenate([np.arange(s, s + n) for s, n in zip(start[chosen], count[chosen])] or [np.zeros(0, int)])
                total[name] = len(mesh.loops)
                ob.to_mesh_clear()
            side = _SIDE
            while True:
                try:
                    uv = atlas.layout(np.concatenate(counts), np.concatenate(areas), side)
                    break
                except ValueError as problem:
                    side *= 2
                    if side > _LARGEST_SIDE:
                        raise Unsupported("its objects have too many polygons to bake") from problem
            corner_uvs, at = {}, 0
            for name, where in loops.items():
                corner_uvs[name] = np.zeros((total[name], 2), np.float32)
                corner_uvs[name][where] = uv[at : at + len(where)]
                at += len(where)
            self._layout = side, corner_uvs
        return self._layout

    def _polygons(self, mesh: bpy.types.Mesh) -> np.ndarray:
        """Indices of the mesh's polygons that wear the material."""
        index = np.empty(len(mesh.polygons), np.int32)
        mesh.polygons.foreach_get("material_index", index)
        mine = [k for k, m in enumerate(mesh.materials) if m is not None and m.original == self.material.original]
        return np.flatnonzero(np.isin(np.clip(index, 0, max(0, len(mesh.materials) - 1)), mine))

    def _emitting_copy(self, scope: Scope, socket: bpy.types.NodeSocket, image: bpy.types.Image) -> bpy.types.Material:
        """A copy of the material that emits the socket's colour, with the image as the target of the bake."""
        material = self.material.original.copy()
        tree = material.node_tree
        levels = []
        for group_name in scope.path:
            group = tree.nodes[group_name]
            group.node_tree = group.node_tree.copy()
            levels.append((tree, group))
            tree = group.node_tree
        source = _same_socket(tree, socket)
        for outer, group in reversed(levels):
            inner = group.node_tree
            made = inner.interface.new_socket("lumigate bake", in_out="OUTPUT", socket_type="NodeSocketColor")
            end = next(n for n in inner.nodes if n.type == "GROUP_OUTPUT" and n.is_active_output)
            inner.links.new(source, next(s for s in end.inputs if s.identifier == made.identifier))
            source = next(s for s in group.outputs if s.identifier == made.identifier)
            tree = outer
        emission = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(source, emission.inputs["Color"])
        output = tree.get_output_node("CYCLES") or tree.get_output_node("ALL")
        tree.links.new(emission.outputs[0], output.inputs["Surface"])
        _aim(tree, image)
        return material

    def _key(self, scope: Scope, socket: bpy.types.NodeSocket, side: int) -> str:
        digest = hashlib.sha256(repr((bpy.app.version, side, _SAMPLES, scope.path, socket.node.name, socket.identifier)).encode())
        _hash_tree(digest, self.material.node_tree, set())
        for name, ob in sorted(self.objects.items()):
            digest.update(repr((name, [round(x, 6) for row in ob.matrix_world for x in row])).encode())
            mesh = ob.to_mesh()
            for collection, attribute, width in ((mesh.vertices, "co", 3), (mesh.loops, "vertex_index", 1)):
                values = np.empty(len(collection) * width, np.float32 if width == 3 else np.int32)
                collection.foreach_get(attribute, values)
                digest.update(values.tobytes())
            for layer in mesh.uv_layers:
                values = np.empty(len(layer.data) * 2, np.float32)
                layer.data.foreach_get("uv", values)
                digest.update(layer.name.encode() + values.tobytes())
            ob.to_mesh_clear()
        return digest.hexdigest()[:32]


def _same_socket(tree: bpy.types.NodeTree, socket: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """The socket of that node and identifier in a copied tree."""
    return next(s for s in tree.nodes[socket.node.name].outputs if s.identifier == socket.identifier)


def _aim(tree: bpy.types.NodeTree, image: bpy.types.Image) -> None:
    target = tree.nodes.new("ShaderNodeTexImage")
    target.image = image
    tree.nodes.active = target


def _filler(image: bpy.types.Image) -> bpy.types.Material:
    """For the slots of other materials: the bake wants a target in every slot."""
    material = bpy.data.materials.new("lumigate bake")
    if material.node_tree is None:
        material.use_nodes = True
    _aim(material.node_tree, image)
    return material


def _copied(ob: bpy.types.Object, corner_uvs: np.ndarray, scene: bpy.types.Scene) -> bpy.types.Object:
    """The evaluated object as a plain mesh object of the temporary scene, with the bake's UV map active."""
    mesh = bpy.data.meshes.new_from_object(ob, preserve_all_data_layers=True, depsgraph=bpy.context.evaluated_depsgraph_get())
    copy = bpy.data.objects.new(ob.name, mesh)
    copy.color, copy.pass_index = ob.color, ob.pass_index
    for key in ob.original.keys():
        copy[key] = ob.original[key]
    scene.collection.objects.link(copy)
    copy.matrix_world = ob.matrix_world
    while len(mesh.uv_layers) >= 8:
        mesh.uv_layers.remove(mesh.uv_layers[-1])
    render = next((layer.name for layer in mesh.uv_layers if layer.active_render), None)
    layer = mesh.uv_layers.new(name=_UV, do_init=False)
    layer.data.foreach_set("uv", np.ascontiguousarray(corner_uvs).ravel())
    mesh.uv_layers.active = layer
    if render is not None:
        # Shaders that name no map go on reading the object's own.
        mesh.uv_layers[render].active_render = True
    if not mesh.materials:
        mesh.materials.append(None)
    return copy


def _bake_object(scene: bpy.types.Scene, ob: bpy.types.Object, clear: bool) -> None:
    layer = scene.view_layers[0]
    with bpy.context.temp_override(scene=scene, view_layer=layer, object=ob, active_object=ob, selected_objects=[ob]):
        layer.objects.active = ob
        ob.select_set(True, view_layer=layer)
        bpy.ops.object.bake(type="EMIT", margin=_MARGIN, margin_type="EXTEND", use_clear=clear, uv_layer=_UV, target="IMAGE_TEXTURES")
        ob.select_set(False, view_layer=layer)


_COLLECTIONS = ("objects", "meshes", "materials", "images", "node_groups", "scenes")


@contextmanager
def _temporary():
    """A scene set up for baking; it and every data-block made in it are gone afterwards."""
    before = {name: set(getattr(bpy.data, name)) for name in _COLLECTIONS}
    scene = bpy.data.scenes.new("lumigate bake")
    scene.render.engine = "CYCLES"
    scene.cycles.samples = _SAMPLES
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.shading_system = getattr(bpy.context.scene.cycles, "shading_system", False)
    scene.frame_set(bpy.context.scene.frame_current)
    try:
        yield scene
    finally:
        for name in _COLLECTIONS:
            for block in set(getattr(bpy.data, name)) - before[name]:
                getattr(bpy.data, name).remove(block)


def cache_folder() -> Path:
    """Where they are kept from one run to the next."""
    return Path(platformdirs.user_cache_dir("lumigate")) / "bakes"


def _store(file: Path, colors: np.ndarray) -> None:
    """Keeps a bake; one that cannot be kept is made again next time."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{threading.get_ident()}.part.npy")
        np.save(part, colors)
        part.replace(file)
    except OSError:
        pass


_SKIPPED = frozenset({"rna_type", "location", "location_absolute", "width", "height", "select", "dimensions", "color", "name", "label"})


def _hash_tree(digest, tree: bpy.types.NodeTree, seen: set) -> None:
    """Adds what a tree says to a hash: nodes, their settings and inputs, links."""
    if tree.name_full in seen:
        return
    seen.add(tree.name_full)
    for node in tree.nodes:
        digest.update(repr((node.name, node.bl_idname, node.mute)).encode())
        _hash_settings(digest, node, seen)
        for socket in node.inputs:
            value = getattr(socket, "default_value", None)
            digest.update(repr(tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value).encode())
    for link in tree.links:
        ends = link.from_node.name, link.from_socket.identifier, link.to_node.name, link.to_socket.identifier
        digest.update(repr((ends, link.is_muted)).encode())


def _hash_settings(digest, owner, seen: set) -> None:
    for prop in owner.bl_rna.properties:
        name = prop.identifier
        if name in _SKIPPED or name.startswith("bl_"):
            continue
        value = getattr(owner, name, None)
        if isinstance(value, bpy.types.NodeTree):
            _hash_tree(digest, value, seen)
        elif isinstance(value, bpy.types.Image):
            path = Path(bpy.path.abspath(value.filepath_raw or ""))
            stamp = path.stat().st_mtime_ns if path.is_file() else 0
            packed = value.packed_file.size if value.packed_file else 0
            digest.update(repr((value.name_full, str(path), stamp, packed, tuple(value.size), value.colorspace_settings.name)).encode())
        elif isinstance(value, bpy.types.Text):
            digest.update(value.as_string().encode())
        elif isinstance(value, bpy.types.Object):
            digest.update(repr([round(x, 6) for row in value.matrix_world for x in row]).encode())
        elif isinstance(value, bpy.types.ColorRamp):
            digest.update(repr([value.evaluate(i / 32)[:] for i in range(33)]).encode())
        elif isinstance(value, bpy.types.CurveMapping):
            points = [[tuple(p.location) for p in curve.points] for curve in value.curves]
            digest.update(repr((value.extend, points)).encode())
        elif prop.type in ("BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"):
            digest.update(repr((name, tuple(value) if getattr(prop, "is_array", False) else value)).encode())
