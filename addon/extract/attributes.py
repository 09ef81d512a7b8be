"""What materials read at the corners of triangles: UV maps, colours, coordinates, properties of objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..materials import AttributeRequest, CompiledMaterials, requests
from ..materials.properties import found_property
from .meshes import MeshCopy


@dataclass(frozen=True)
class Instancing:
    """What an instance has of its instancer.

    attributes: RGBA by name.  owners: data-blocks whose properties come next, in this order.  generated, uv: the place on the instancer, as Cycles has them.
    """

    attributes: dict[str, tuple[float, ...]] = field(default_factory=dict)
    owners: tuple[bpy.types.ID, ...] = ()
    generated: tuple[float, float, float] = (0.0, 0.0, 0.0)
    uv: tuple[float, float] = (0.0, 0.0)


NOT_INSTANCED = Instancing()


@dataclass
class Part:
    """One instance of a mesh: where it is and what it wears (original data-blocks; None is an empty slot).

    lightmap: the layer of its mesh that a lightmap is to be baked on ('' for none).  light_group: its name ('' for none).  instancing: what it has of its instancer.
    receivers, blockers: numbers of its sets of linked objects (-1: all).  links: the original objects whose links to receivers and to blockers it shares.
    """

    mesh: MeshCopy
    matrix: np.ndarray  # (4, 4) float64, mesh to world
    name: str
    original: bpy.types.Object
    materials: tuple[bpy.types.Material | None, ...]
    visibility: int
    random_id: int
    color: tuple[float, ...]
    pass_index: int
    lightmap: str = ""
    light_group: str = ""
    instancing: Instancing = NOT_INSTANCED
    receivers: int = -1
    blockers: int = -1
    links: tuple[bpy.types.Object, bpy.types.Object] | None = None

    @property
    def worn(self) -> list[bpy.types.Material | None]:
        """Materials of the slots that a triangle of the mesh has."""
        return [self.materials[k] for k in np.unique(self.slots())]

    def slots(self) -> np.ndarray:
        """(T,) int32 into `materials`: Blender takes the nearest slot that there is."""
        return np.clip(self.mesh.slot, 0, len(self.materials) - 1)


@dataclass
class Batch:
    """n instances of one mesh that wear the same materials, placed in the world.

    world: (n, V, 3) float64.  normals: (n, T, 3, 3) float32, world shading normals.
    normal_matrix: (n, 3, 3) float64: a row vector's normal times it is the world normal.
    warnings: lines for the user.
    """

    parts: list[Part]
    world: np.ndarray
    normals: np.ndarray
    normal_matrix: np.ndarray
    warnings: list[str]

    @property
    def mesh(self) -> MeshCopy:
        return self.parts[0].mesh


def fill(out: np.ndarray, batch: Batch, materials: np.ndarray, compiled: CompiledMaterials) -> None:
    """Write the attributes of a batch: `out` is (K, n, T, 3, 4), zeros, float32; `materials` (T,) indices."""
    for material in np.unique(materials):
        wanted = compiled.requests[material]
        mask = materials == material
        where = slice(None) if mask.all() else np.flatnonzero(mask)
        for slot, request in zip(out, wanted):
            values = _values(request, batch, compiled)
            if values is None:
                continue
            width = values.shape[-1]
            slot[:, where, :, :width] = values[:, where] if values.shape[1] > 1 else values
            if width < 4:
                slot[:, where, :, 3] = 1


def lightmap_uv(batch: Batch) -> np.ndarray:
    """(n, T, 3, 2) float32 corners in the lightmaps of a batch; NaN for parts without."""
    uv = np.full((len(batch.parts), len(batch.mesh.corners), 3, 2), np.nan, np.float32)
    for target, part in zip(uv, batch.parts):
        layer = batch.mesh.layers.get(part.lightmap)
        if layer is not None:
            target[:] = layer[..., :2]
    return uv


def _values(request: AttributeRequest, batch: Batch, compiled: CompiledMaterials) -> np.ndarray | None:
    """Values that broadcast to (n, T, 3, 3 or 4), or None for what this mesh lacks."""
    of_mesh, of_object = _OF_MESH.get(request.kind), _OF_OBJECT.get(request.kind)
    if of_mesh is not None:
        values = of_mesh(batch.mesh, request.name)
        return None if values is None else values[None]
    if of_object is not None:
        return np.array([of_object(part, request.name) for part in batch.parts], np.float32)[:, None, None, :]
    if request.kind == requests.OBJECT:
        return _object_position(batch, request.name)
    if request.kind == requests.WORLD_POSITION:
        return batch.world[:, batch.mesh.corners]
    if request.kind == requests.WORLD_NORMAL:
        return batch.normals
    if request.kind == requests.RAISED:
        to_world = np.array([part.matrix[:3, :3] for part in batch.parts])[:, None]
        return unit(batch.normals @ to_world) @ to_world.swapaxes(-1, -2)
    if request.kind == requests.FACE_NORMAL:
        return unit(np.matmul(batch.mesh.face_normals[None], batch.normal_matrix))[:, :, None, :]
    if request.kind == requests.TANGENT:
        return _tangents(batch, request.name)
    if request.kind == requests.BAKED:
        return _baked(batch, compiled.baked_uvs[request.name])
    raise ValueError(f"unknown attribute request '{request.kind}'")


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length 1 along the last axis; zero vectors stay zero."""
    length = np.sqrt(np.einsum("...k,...k->...", vectors, vectors))[..., None]
    return vectors / np.where(length > 0, length, 1)


def _object_position(batch: Batch, name: str) -> np.ndarray | None:
    """Positions in the space of the batch's own objects, or of another object."""
    if not name:
        return batch.mesh.vertices[batch.mesh.corners][None]
    other = bpy.data.objects.get(name)
    if other is None or np.linalg.det(to_world := np.array(other.matrix_world, np.float64)) == 0:
        return None
    to_object = np.linalg.inv(to_world)
    return (batch.world @ to_object[:3, :3].T + to_object[:3, 3])[:, batch.mesh.corners]


def _tangents(batch: Batch, uv: str) -> np.ndarray | None:
    """World-space tangents, (n, T, 3, 4); mirroring turns the bitangent."""
    local = batch.mesh.tangents(uv)
    if local is None:
        return None
    world = np.empty((len(batch.parts), *local.shape), np.float32)
    # Cycles maps the perturbed normal, not the tangent, to the world: hence the matrix of normals.
    world[..., :3] = unit(np.matmul(local[None, ..., :3].reshape(1, -1, 3), batch.normal_matrix)).reshape(world[..., :3].shape)
    world[..., 3] = local[..., 3] * np.where(np.linalg.det(batch.normal_matrix) < 0, -1, 1)[:, None, None]
    return world


def _baked(batch: Batch, by_object: dict[str, np.ndarray]) -> np.ndarray:
    """UVs of a baked texture, which every object has of its own: (n, T, 3, 3)."""
    uv = np.zeros((len(batch.parts), len(batch.mesh.corners), 3, 3), np.float32)
    for target, part in zip(uv, batch.parts):
        baked = by_object.get(part.name)
        if baked is not None and len(baked) == len(target):
            target[..., :2] = baked
        else:
            line = f"'{part.name}' has other faces in a render than in the viewport: its baked textures are wrong; give its modifiers the same levels"
            if line not in batch.warnings:
                batch.warnings.append(line)
    return uv


def _property(part: Part, name: str) -> tuple[float, ...]:
    """A custom or RNA property of an object or else its data, as an Attribute node of type Object finds it; zeros if there is none."""
    return found_property(name, part.original, part.original.data)


def _of_instancer(part: Part, name: str) -> tuple[float, ...]:
    """The same of type Instancer: what the instance has, its instancer, or else the object."""
    if name in part.instancing.attributes:
        return part.instancing.attributes[name]
    return found_property(name, *part.instancing.owners, part.original, part.original.data)


_OF_MESH: dict[str, Callable[[MeshCopy, str], np.ndarray | None]] = {
    requests.UV: lambda mesh, name: mesh.layers.get(name or mesh.uv),
    requests.COLOR: lambda mesh, name: mesh.layers.get(name or mesh.color),
    requests.ATTRIBUTE: lambda mesh, name: mesh.layers.get(name),
    requests.GENERATED: lambda mesh, name: mesh.generated,
    requests.NORMAL: lambda mesh, name: unit(mesh.normals),
}
_OF_OBJECT: dict[str, Callable[[Part, str], tuple[float, ...]]] = {
    requests.OBJECT_LOCATION: lambda part, name: tuple(part.matrix[:3, 3]),
    requests.OBJECT_COLOR: lambda part, name: part.color,
    requests.OBJECT_INDEX: lambda part, name: (part.pass_index,) * 3,
    requests.OBJECT_RANDOM: lambda part, name: (part.random_id / 2**32,) * 3,
    requests.OBJECT_ATTRIBUTE: _property,
    requests.INSTANCER_ATTRIBUTE: _of_instancer,
    requests.INSTANCER_GENERATED: lambda part, name: part.instancing.generated,
    requests.INSTANCER_UV: lambda part, name: (*part.instancing.uv, 0.0),
}
