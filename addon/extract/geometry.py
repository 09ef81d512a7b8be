"""Meshes and instances of an evaluated scene as one pool of world-space triangles.

Two steps, because materials are compiled between them and must be outside of Blender's render:
`collect` copies what lives only as long as the evaluation, `assemble` places it in the world.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.scene import CAMERA, DIFFUSE, GLOSSY, HOLDOUT, SHADOW, TRANSMISSION, Geometry, Skipped
from ..materials import CompiledMaterials
from .attributes import NOT_INSTANCED, Batch, Instancing, Part, fill, lightmap_uv, unit
from .instances import InstanceAttributes, asked_of_instancers
from .links import BLOCKERS, RECEIVERS, Links, blocker_bits
from .meshes import MeshCopy, copy_mesh, face_normals, layer_names
from .strands import copy_curves, copy_hair, copy_points, hashed

# Coordinates beyond this are taken for invalid: their squares overflow float32.
_LIMIT = 1e18
# So many vertices, at most, tell where nearly all lie: all but this share at either end, within less than this part of the bounds.
_LOOKED_AT, _STRAY, _SMALL = 1 << 16, 0.05, 1 / 64
# A singular value below this share of the largest one counts as zero: the instance is squashed.
_SINGULAR = 1e-7
_MAX_TRIANGLES = 50_000_000

# What Cycles renders and triangles cannot hold.
_NOT_TRIANGLES = {
    "VOLUME": "volume",
    "GREASEPENCIL": "grease pencil",
    "GPENCIL": "grease pencil",
}


@dataclass
class Collected:
    """What `collect` found; `warnings` are lines for the user, `hidden` names of objects that no ray can see, `links` those of emitters to objects."""

    parts: list[Part] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    hidden: list[str] = field(default_factory=list)
    links: Links = field(default_factory=Links)

    @cached_property
    def materials(self) -> list[bpy.types.Material | None]:
        """Materials on any triangle in order of appearance, each once (original data-blocks; None is Blender's default grey)."""
        return list(dict.fromkeys(m for members in self.batches for m in self.parts[members[0]].worn))

    @cached_property
    def batches(self) -> list[list[int]]:
        """Indices of the parts that share a mesh and its materials, in order of appearance."""
        groups: dict[tuple, list[int]] = {}
        for i, part in enumerate(self.parts):
            groups.setdefault((id(part.mesh), part.materials), []).append(i)
        return list(groups.values())

    @property
    def skipped(self) -> list[Skipped]:
        """What is left out without a difference: neither read nor compiled, its textures not loaded."""
        named = dict.fromkeys(m for members in self.batches for m in self.parts[members[0]].materials if m is not None)
        return [
            *(Skipped("objects", f"object '{name}' is hidden from every ray") for name in self.hidden),
            *(Skipped("materials", f"material '{m.name}' is on no triangle") for m in named if m not in self.materials),
        ]


def ray_visibility(ob: bpy.types.Object) -> int:
    """The ray kinds that an object's switches let see it, as bits."""
    return (
        CAMERA * ob.visible_camera
        | DIFFUSE * ob.visible_diffuse
        | GLOSSY * ob.visible_glossy
        | TRANSMISSION * ob.visible_transmission
        | SHADOW * ob.visible_shadow
    )


def instance_visibility(instance: bpy.types.DepsgraphObjectInstance, view_layer: bpy.types.ViewLayer) -> int:
    """Visibility of an instance as Cycles combines it: its own, its parent's, and indirect-only and holdout collections."""
    visibility = ray_visibility(instance.object)
    parent = instance.parent if instance.is_instance else instance.object
    if instance.is_instance:
        visibility &= ray_visibility(parent)
    if parent.holdout_get(view_layer=view_layer):
        visibility |= HOLDOUT * (visibility > 0)
    elif parent.indirect_only_get(view_layer=view_layer):
        visibility &= ~CAMERA
    return visibility


def is_shown(ob: bpy.types.Object, depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None) -> bool:
    """Whether an evaluated object is to be seen: of a viewport's evaluation, what a render shows, too, and the viewport `space` does."""
    if depsgraph.mode == "VIEWPORT" and ob.hide_render:
        return False
    return space is None or ob.visible_in_viewport_get(space)


def light_group(instance: bpy.types.DepsgraphObjectInstance) -> str:
    """Name of the light group of an instance, as Cycles finds it: its own, else its parent's; '' for none."""
    return instance.object.lightgroup or (instance.parent.lightgroup if instance.is_instance else "")


def collect(
    depsgraph: bpy.types.Depsgraph,
    lightmaps: Mapping[str, str] | None = None,
    links: Links | None = None,
    space: bpy.types.SpaceView3D | None = None,
) -> Collected:
    """Copy every mesh of an evaluated scene once, and list its instances.

    lightmaps: the UV map of each object, by name, that a lightmap is to be baked on.  links: of the same evaluation, None for none.
    space: the viewport whose local view and collections count.
    """
    lightmaps = lightmaps or {}
    links = Links() if links is None else links
    found = Collected(links=links)
    notes: dict[str, None] = {}  # an ordered set: one line for a thing, however often it is instanced
    hidden: dict[str, None] = {}
    meshes: dict[tuple, MeshCopy | None] = {}
    wanted = layer_names() | set(lightmaps.values())
    names, is_asked = asked_of_instancers()
    attributes = InstanceAttributes(names)
    view_layer = depsgraph.view_layer_eval
    override = view_layer.material_override
    for instance in depsgraph.object_instances:
        ob = instance.object
        if not is_shown(ob, depsgraph, space):
            continue
        notes.update(dict.fromkeys(_notes(instance, view_layer)))
        visibility = instance_visibility(instance, view_layer)
        for key, copied, slot in _shapes(instance, wanted, depsgraph.mode == "RENDER"):
            if not visibility:
                hidden[ob.name] = None
                continue
            if key not in meshes:
                meshes[key] = copied()
            if meshes[key] is None:
                continue
            slots = [s.material for s in ob.material_slots] if override is None else [override]
            if slot is not None:
                slots = slots[min(slot, len(slots) - 1) :][:1]
            found.parts.append(
                Part(
                    mesh=meshes[key],
                    matrix=np.array(instance.matrix_world, np.float64),
                    name=ob.name,
                    original=ob.original,
                    materials=tuple(m and m.original for m in slots) or (None,),
                    visibility=visibility,
                    random_id=instance.random_id & 0xFFFFFFFF if instance.is_instance else _hash(ob.name),
                    color=tuple(ob.color),
                    pass_index=ob.pass_index,
                    lightmap="" if instance.is_instance or slot is not None else lightmaps.get(ob.name, ""),
                    light_group=light_group(instance),
                    instancing=_instancing(instance, attributes) if is_asked and instance.is_instance else NOT_INSTANCED,
                    **(_linked(instance, links) if links else {}),
                )
            )
    found.warnings.extend(notes)
    shown = {part.name for part in found.parts}
    found.hidden.extend(name for name in hidden if name not in shown)
    if not found.parts:
        found.warnings.append("the scene has no meshes that a render shows")
    return found


def _shapes(
    instance: bpy.types.DepsgraphObjectInstance, wanted: Collection[str], is_render: bool
) -> Iterator[tuple[tuple, Callable[[], MeshCopy | None], int | None]]:
    """What an instance shows: what tells its shape from others, what copies it, and the slot of its material (None: by face)."""
    ob = instance.object
    copies = {
        "MESH": lambda: copy_mesh(ob, wanted),
        "CURVES": lambda: copy_curves(ob.data, wanted),
        "POINTCLOUD": lambda: copy_points(ob.data, wanted),
    }
    if instance.show_self and ob.type in copies:
        yield (ob.data.as_pointer(),), copies[ob.type], None
    if instance.show_particles and ob.type == "MESH":
        for modifier in ob.modifiers:
            if modifier.type == "PARTICLE_SYSTEM" and (modifier.show_render if is_render else modifier.show_viewport):
                system = modifier.particle_system
                if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
                    key = ob.original.as_pointer(), system.name
                    yield key, partial(copy_hair, ob, system, modifier, is_render), system.settings.material - 1


def _instancing(instance: bpy.types.DepsgraphObjectInstance, attributes: InstanceAttributes) -> Instancing:
    parent, system = instance.parent.original, instance.particle_system
    owners = (system and system.settings.original, parent, parent.data)
    return Instancing(
        attributes=attributes.of(instance),
        owners=tuple(owner for owner in owners if owner is not None),
        generated=tuple(0.5 * x - 0.5 for x in instance.orco),
        uv=tuple(instance.uv),
    )


def _linked(instance: bpy.types.DepsgraphObjectInstance, links: Links) -> dict:
    """The fields of `Part` that say what an instance is linked to."""
    ob, parent = instance.object, instance.parent if instance.is_instance else None
    return {
        "receivers": links.number(ob, RECEIVERS),
        "blockers": links.number(ob, BLOCKERS),
        "links": (links.key(ob, parent, RECEIVERS), links.key(ob, parent, BLOCKERS)),
    }


def _notes(instance: bpy.types.DepsgraphObjectInstance, view_layer: bpy.types.ViewLayer) -> Iterator[str]:
    """What of an instance is left out or rendered otherwise than by Cycles."""
    ob = instance.object
    if ob.type in _NOT_TRIANGLES and instance.show_self:
        yield f"{_NOT_TRIANGLES[ob.type]} '{ob.name}' is left out: convert it to a mesh to see it"
    if ob.type == "MESH" and ob.is_shadow_catcher:  # lamps are by default
        yield f"'{ob.name}' is a shadow catcher: it is rendered as an ordinary object"


def _hash(name: str) -> int:
    """`random_id` of an object that is no instance: hash_uint2(hash_string(name), 0) of Cycles."""
    value = 0
    for byte in name.encode():
        value = (value * 37 + byte) & 0xFFFFFFFF
    return int(hashed(np.array([value]))[0])


def assemble(found: Collected, compiled: CompiledMaterials) -> tuple[Geometry, np.ndarray, list[str]]:
    """The triangles of all parts, the float64 origin that was taken off, and warnings.

    `compiled` are the materials of `found.materials`, in that order.

    Raises:
        SceneError: more triangles than memory is likely to hold.
    """
    parts, warnings = found.parts, []
    vertex_counts = [len(part.mesh.vertices) for part in parts]
    counts = [len(part.mesh.corners) for part in parts]
    total = sum(counts)
    if total > _MAX_TRIANGLES:
        biggest = parts[int(np.argmax(counts))]
        raise SceneError(
            f"the scene has {total:,} triangles, instances counted, and at most {_MAX_TRIANGLES:,} fit: "
            f"hide or simplify objects (the largest is '{biggest.name}' with {max(counts):,})"
        )
    geometry = Geometry(
        vertices=np.empty((sum(vertex_counts), 3), np.float32),
        triangles=np.empty((total, 3), np.int32),
        corner_normals=np.empty((total, 3, 3), np.float32),
        attributes=np.zeros((compiled.slots, total, 3, 4), np.float32),
        material=np.empty(total, np.int32),
        object=np.empty(total, np.int32),
        object_names=[part.name for part in parts],
        object_visibility=np.array([part.visibility for part in parts], np.uint32),
        object_groups=[part.light_group for part in parts],
        lightmap_uv=np.empty((total, 3, 2), np.float32) if any(part.lightmap for part in parts) else None,
    )
    if found.links:
        receivers, blockers = ([part.links[k] for part in parts] for k in range(2))
        geometry.receiver_sets = found.links.members(RECEIVERS, receivers)
        geometry.object_visibility = blocker_bits(geometry.object_visibility, found.links.members(BLOCKERS, blockers))
        geometry.object_receivers = np.array([part.receivers for part in parts], np.int32)
        geometry.object_blockers = np.array([part.blockers for part in parts], np.int32)
    world = np.empty((sum(vertex_counts), 3), np.float64)
    index = {material: i for i, material in enumerate(found.materials)}
    placed = np.stack([part.matrix for part in parts]) if parts else np.zeros((0, 4, 4))
    normal_matrices, mirrored, broken = _normal_matrices(placed[:, :3, :3])
    v = t = 0
    for members in found.batches:
        mesh, n = parts[members[0]].mesh, len(members)
        vertices, triangles = slice(v, v + n * len(mesh.vertices)), slice(t, t + n * len(mesh.corners))
        matrices, normal_matrix = placed[members], normal_matrices[members]
        batch = Batch(
            parts=[parts[i] for i in members],
            world=world[vertices].reshape(n, -1, 3),
            normals=geometry.corner_normals[triangles].reshape(n, -1, 3, 3),
            normal_matrix=normal_matrix,
            warnings=warnings,
        )
        with np.errstate(all="ignore"):  # invalid coordinates are looked for below
            np.matmul(mesh.vertices.astype(np.float64), matrices[:, :3, :3].transpose(0, 2, 1), out=batch.world)
            batch.world += matrices[:, None, :3, 3]
            normals = np.matmul(mesh.normals.reshape(1, -1, 3), normal_matrix.astype(np.float32))
            batch.normals[:] = unit(normals).reshape(n, len(mesh.corners), -1, 3)
        bases = v + len(mesh.vertices) * np.arange(n, dtype=np.int32)
        np.add(mesh.corners, bases[:, None, None], out=geometry.triangles[triangles].reshape(n, -1, 3))
        slots = np.array([index.get(m, 0) for m in batch.parts[0].materials], np.int32)
        material = slots[batch.parts[0].slots()]
        geometry.material[triangles].reshape(n, -1)[:] = material
        geometry.object[triangles].reshape(n, -1)[:] = np.array(members, np.int32)[:, None]
        if geometry.lightmap_uv is not None:
            geometry.lightmap_uv[triangles].reshape(n, -1, 3, 2)[:] = lightmap_uv(batch)
        fill(geometry.attributes[:, triangles].reshape(-1, n, len(mesh.corners), 3, 4), batch, material, compiled)
        v, t = vertices.stop, triangles.stop

    _flip(geometry, np.flatnonzero(mirrored[geometry.object]))
    warnings += _drop_invalid(geometry, world, broken)
    if geometry.lightmap_uv is None:
        _drop_unseen(geometry, world, compiled)
    origin = _origin(world)
    np.subtract(world, origin, out=geometry.vertices, casting="same_kind")
    _repair_normals(geometry)
    return geometry, origin, warnings


def _origin(world: np.ndarray) -> np.ndarray:
    """(3,) the middle of the bounds on a grid of an eighth to a quarter of them: it stays where it is while a part of the scene moves.

    Where nearly all lies in a small part of the bounds, these are its own: about a thing that somebody has left far away the rest would have no float32 to spare.
    """
    if not len(world):
        return np.zeros(3)
    low, high = world.min(0), world.max(0)
    bulk = np.quantile(world[:: 1 + len(world) // _LOOKED_AT], (_STRAY, 1 - _STRAY), axis=0)
    if (bulk[1] - bulk[0]).max() < _SMALL * (high - low).max():
        low, high = bulk
    cell = 2.0 ** (np.floor(np.log2(max((high - low).max(), 1e-30))) - 2)
    return np.round(0.5 * (low + high) / cell) * cell


def _normal_matrices(linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of (n, 3, 3) matrices: inverses up to a positive factor, which are mirrored, which leave no area at all.

    A matrix squashed flat gives a zero matrix: its normals come from the triangles.
    """
    with np.errstate(all="ignore"):
        finite = np.isfinite(linear).all((1, 2))
        safe = np.where(finite[:, None, None], linear, np.eye(3))
        _, s, _ = np.linalg.svd(safe)
        flat = s[:, 2] <= _SINGULAR * s[:, 0]
        collapsed = s[:, 1] <= _SINGULAR * s[:, 0]
        scaled = safe / np.where(s[:, :1, None] > 0, s[:, :1, None], 1)
        # By the adjugate: NumPy's `inv` wakes LAPACK's threads for each batch, milliseconds on a busy machine.
        a, b, c = scaled[:, 0], scaled[:, 1], scaled[:, 2]
        adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
        mirrored = ~flat & (np.einsum("ni,ni->n", a, adjugate[:, :, 0]) < 0)
    inverse = np.where(mirrored[:, None, None], -adjugate, adjugate)
    inverse[flat] = 0
    return inverse, mirrored, collapsed | ~finite


def _flip(geometry: Geometry, triangles: np.ndarray) -> None:
    """Swap two corners of the triangles: mirroring turned their winding, but not the side that Cycles calls the front."""
    if len(triangles):
        a, b = np.s_[triangles, 1], np.s_[triangles, 2]
        maps = () if geometry.lightmap_uv is None else (geometry.lightmap_uv,)
        for corners in (geometry.triangles, geometry.corner_normals, *maps, *geometry.attributes):
            corners[a], corners[b] = corners[b], corners[a]


def _drop_invalid(geometry: Geometry, world: np.ndarray, broken: np.ndarray) -> list[str]:
    """Remove triangles with NaN, infinite or huge vertices and those of broken objects; `world` is made finite. Warnings."""
    with np.errstate(invalid="ignore"):
        if -_LIMIT < world.min(initial=0) and world.max(initial=0) < _LIMIT and not broken.any():  # a NaN fails this too
            return []
        valid = (np.abs(world) < _LIMIT).all(1)
    bad = broken[geometry.object] | ~valid[geometry.triangles].all(1)
    dropped = np.bincount(geometry.object[bad], minlength=len(geometry.object_names))
    _drop(geometry, world, bad)
    return [
        f"'{geometry.object_names[i]}': {dropped[i]} triangles dropped, "
        + ("its scale is zero or invalid: apply or reset it" if broken[i] else "they have invalid coordinates (NaN, infinite or huge)")
        for i in np.flatnonzero(dropped)
    ]


def _drop_unseen(geometry: Geometry, world: np.ndarray, compiled: CompiledMaterials) -> None:
    """Remove triangles of materials that do nothing to light, as the domain of a volume: fog around a scene would stretch its bounds."""
    bad = np.isin(geometry.material, compiled.unseen)
    if bad.any():
        _drop(geometry, world, bad)


def _drop(geometry: Geometry, world: np.ndarray, bad: np.ndarray) -> None:
    """Remove triangles, and what their vertices alone say of the bounds."""
    used = np.zeros(len(world), bool)
    used[geometry.triangles[~bad]] = True
    world[~used] = world[used][0] if used.any() else 0
    for name in ("triangles", "corner_normals", "material", "object", "lightmap_uv"):
        if getattr(geometry, name) is not None:
            setattr(geometry, name, getattr(geometry, name)[~bad])
    geometry.attributes = np.ascontiguousarray(geometry.attributes[:, ~bad])


def _repair_normals(geometry: Geometry) -> None:
    """Give the geometric normal to corners that have none (squashed objects, broken custom normals)."""
    normals = geometry.corner_normals
    squared = np.einsum("tkc,tkc->tk", normals, normals)
    bad = ~((squared > 0.5) & (squared < 2))
    if bad.any():
        triangles, corner = np.nonzero(bad)
        faces = unit(face_normals(geometry.vertices, geometry.triangles[triangles]))
        faces[~faces.any(1)] = (0, 0, 1)
        normals[triangles, corner] = faces
