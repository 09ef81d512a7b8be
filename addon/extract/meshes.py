"""Copies of evaluated meshes: arrays that outlive Blender's evaluation."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cached_property

import bpy
import numpy as np

from .tangents import tangents

# Attribute types that a shader can read: name of the value in RNA, its number of components.
READABLE = {
    "FLOAT": ("value", 1),
    "INT": ("value", 1),
    "INT8": ("value", 1),
    "BOOLEAN": ("value", 1),
    "QUATERNION": ("value", 4),
    "FLOAT2": ("vector", 2),
    "FLOAT_VECTOR": ("vector", 3),
    "FLOAT_COLOR": ("color", 4),
    "BYTE_COLOR": ("color", 4),  # linear, as `color_srgb` is not
}
# Properties by which shader nodes name a layer of the mesh.
_NAMING = ("attribute_name", "layer_name", "uv_map")


@dataclass
class MeshCopy:
    """One evaluated mesh of T triangles and V vertices, loose vertices left out.

    vertices: (V, 3) float32, local.  corners: (T, 3) int32 into the vertices.
    slot: (T,) int32, the material slot, not clamped.
    normals: (T, 3, 3) float32, shading normals; (T, 1, 3) where the mesh is flat.
    layers: attributes by name, (T, 3, 4) float32.  uv, color: those active for render ('' for none).
    """

    name: str
    vertices: np.ndarray
    corners: np.ndarray
    slot: np.ndarray
    normals: np.ndarray
    undeformed: np.ndarray
    texture_location: np.ndarray
    texture_size: np.ndarray
    layers: dict[str, np.ndarray] = field(default_factory=dict)
    uv: str = ""
    color: str = ""

    @cached_property
    def face_normals(self) -> np.ndarray:
        """(T, 3) float32 geometric normals in the mesh's space, not normalised."""
        return face_normals(self.vertices, self.corners)

    @cached_property
    def generated(self) -> np.ndarray:
        """(T, 3, 3) float32 generated texture coordinates: 0..1 across the texture space (Cycles' `mesh_texture_space`)."""
        size = np.where(self.texture_size != 0, 0.5 / np.where(self.texture_size != 0, self.texture_size, 1), 0)
        return ((self.undeformed - self.texture_location) * size + 0.5).astype(np.float32)[self.corners]

    def tangents(self, uv: str) -> np.ndarray | None:
        """(T, 3, 4) float32 local tangents of a UV map ('' is the one active for render), the bitangent's sign in w."""
        layer = self.layers.get(uv or self.uv)
        if layer is None:
            return None
        shape = (len(self.corners), 3, 3)
        return tangents(self.vertices[self.corners], np.broadcast_to(self.normals, shape), layer[..., :2])


def face_normals(vertices: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(v1 - v0) x (v2 - v0) of every triangle: (T, 3), as long as twice the area."""
    a, b, c = (vertices[corners[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def read(collection: bpy.types.bpy_prop_collection, name: str, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """`foreach_get` into a fresh array of that shape."""
    values = np.empty(shape, dtype)
    collection.foreach_get(name, values.ravel())
    return values


def node_trees() -> list[bpy.types.NodeTree]:
    """All shader node trees of the file, those of groups, too."""
    trees = [tree for owner in (bpy.data.materials, bpy.data.worlds, bpy.data.lights) for data in owner if (tree := data.node_tree)]
    return trees + [tree for tree in bpy.data.node_groups if tree.type == "SHADER"]


def layer_names() -> set[str]:
    """The layers that shader nodes of the file name: only these (and the active ones) are copied."""
    return {getattr(node, key) for tree in node_trees() for node in tree.nodes for key in _NAMING if hasattr(node, key)} - {""}


def copy_mesh(ob: bpy.types.Object, wanted: Collection[str]) -> MeshCopy | None:
    """The triangles of an evaluated mesh object, or None where it has no faces.

    wanted: names of layers to copy besides the active ones.
    """
    deformed = bool(ob.modifiers) or ob.data.shape_keys is not None  # generated coordinates come from the mesh before its modifiers
    if not ob.data.is_editmode:
        return _copied(ob.data, wanted, deformed)
    try:  # while it is edited, a mesh is empty for all but the editor
        return _copied(ob.to_mesh(), wanted, deformed)
    finally:
        ob.to_mesh_clear()


def _copied(mesh: bpy.types.Mesh, wanted: Collection[str], deformed: bool) -> MeshCopy | None:
    if len(mesh.polygons) == 0:
        return None
    loops, polygon = _triangulation(mesh)
    corners = read(mesh.attributes[".corner_vert"].data, "value", (len(mesh.loops),), np.int32)[loops]
    vertices = read(mesh.attributes["position"].data, "vector", (len(mesh.vertices), 3), np.float32)
    undeformed = read(mesh.vertices, "undeformed_co", vertices.shape, np.float32) if deformed else vertices
    slots = mesh.attributes.get("material_index")
    copy = MeshCopy(
        name=mesh.name,
        vertices=vertices,
        corners=corners,
        slot=read(slots.data, "value", (len(mesh.polygons),), np.int32)[polygon] if slots else np.zeros(len(corners), np.int32),
        normals=_normals(mesh, vertices, corners, loops, polygon),
        undeformed=undeformed,
        texture_location=np.array(mesh.texspace_location),
        texture_size=np.array(mesh.texspace_size),
    )
    copy.uv = next((layer.name for layer in mesh.uv_layers if layer.active_render), "")
    colors = mesh.color_attributes
    if 0 <= colors.render_color_index < len(colors):
        copy.color = colors[colors.render_color_index].name
    index = {"POINT": corners, "CORNER": loops, "FACE": np.broadcast_to(polygon[:, None], corners.shape)}
    for name in {copy.uv, copy.color, *wanted} - {""}:
        attribute = mesh.attributes.get(name)
        if attribute is None or attribute.data_type not in READABLE:
            continue
        if attribute.domain in index:
            copy.layers[name] = layer(attribute, index[attribute.domain])
        elif attribute.domain == "EDGE":
            copy.layers[name] = _mean_of_edges(mesh, attribute)[corners]
    _drop_loose(copy)
    return copy


def _triangulation(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3) int32 loops and (T,) int32 polygon of every triangle."""
    count = len(mesh.loop_triangles)
    if count == len(mesh.polygons):  # all faces are triangles: loops are in their order, and reading them is slow
        return np.arange(3 * count, dtype=np.int32).reshape(count, 3), np.arange(count, dtype=np.int32)
    loops = read(mesh.loop_triangles, "loops", (count, 3), np.int32)
    return loops, read(mesh.loop_triangle_polygons, "value", (count,), np.int32)


def _normals(mesh: bpy.types.Mesh, vertices: np.ndarray, corners: np.ndarray, loops: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Shading normals as Cycles chooses them (`create_mesh` of its blender/mesh.cpp).

    A flat face has its triangles' own, the others those of their vertices, or of their corners where
    edges are sharp or normals are set by hand.  Where flat faces alone make edges sharp, Blender 4 still
    smooths across them.
    """
    domain = mesh.normals_domain
    if domain == "CORNER" and (bpy.app.version >= (5, 0) or _has_sharp_edges(mesh) or "custom_normal" in mesh.attributes):
        return read(mesh.corner_normals, "vector", (len(mesh.loops), 3), np.float32)[loops]
    flat = face_normals(vertices, corners)
    length = np.linalg.norm(flat, axis=1, keepdims=True)
    flat = (flat / np.where(length > 0, length, 1))[:, None]
    if domain == "FACE":
        return flat
    smooth = read(mesh.vertex_normals, "vector", vertices.shape, np.float32)[corners]
    if domain == "POINT":
        return smooth
    sharp = read(mesh.attributes["sharp_face"].data, "value", (len(mesh.polygons),), np.bool_)[polygon]
    return np.where(sharp[:, None, None], flat, smooth)


def _has_sharp_edges(mesh: bpy.types.Mesh) -> bool:
    sharp = mesh.attributes.get("sharp_edge")
    return sharp is not None and bool(read(sharp.data, "value", (len(mesh.edges),), np.bool_).any())


def layer(attribute: bpy.types.Attribute, index: np.ndarray) -> np.ndarray:
    """Values of an attribute at the triangles' corners, widened to four components as a shader sees them."""
    key, components = READABLE[attribute.data_type]
    dtype = {"INT": np.int32, "INT8": np.int32, "BOOLEAN": np.bool_}.get(attribute.data_type, np.float32)
    values = read(attribute.data, key, (len(attribute.data), components), dtype)
    wide = np.zeros((*index.shape, 4), np.float32)
    wide[..., 3] = 1
    wide[..., : 3 if components == 1 else components] = values[index]
    return wide


def _mean_of_edges(mesh: bpy.types.Mesh, attribute: bpy.types.Attribute) -> np.ndarray:
    """(vertices, 4) float32: at each vertex the mean of its edges' values, whole for whole numbers, and whether one is true, as Blender has them."""
    ends = read(mesh.edges, "vertices", (len(mesh.edges), 2), np.int32).ravel()
    values = layer(attribute, np.arange(len(mesh.edges))).repeat(2, axis=0)
    count = np.bincount(ends, minlength=len(mesh.vertices))
    sums = [np.bincount(ends, column, len(mesh.vertices)) for column in values.T]
    mean = (np.stack(sums, 1) / np.maximum(count, 1)[:, None]).astype(np.float32)
    if attribute.data_type == "BOOLEAN":
        return (mean > 0).astype(np.float32)
    return np.floor(mean + np.float32(0.5)) if attribute.data_type in ("INT", "INT8") else mean


def _drop_loose(copy: MeshCopy) -> None:
    """Take out vertices that no triangle uses: they would stretch the scene's bounds."""
    used = np.zeros(len(copy.vertices), bool)
    used[copy.corners] = True
    if used.all():
        return
    renumbered = np.cumsum(used, dtype=np.int32) - 1
    same = copy.undeformed is copy.vertices
    copy.vertices = copy.vertices[used]
    copy.undeformed = copy.vertices if same else copy.undeformed[used]
    copy.corners = renumbered[copy.corners]
