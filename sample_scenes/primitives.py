"""Closed polygon shapes from NumPy arrays, and how they become Blender meshes.

A `Shape` is arrays only, so that it can be moved, repeated and joined before Blender hears of it.  UVs are in
metres; the texture's size in metres divides them when the mesh is made (see `materials.Surface`).
All shapes are closed and face outwards unless their docstring says otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .materials import Surface


@dataclass(frozen=True)
class Shape:
    """Polygons.  vertices: (V, 3) m.  corners: (C,) into vertices, face after face, counter-clockwise seen from
    outside.  sizes: (F,) corners of each face.  uv: (C, 2) m.  slots: (F,) material slot of each face."""

    vertices: np.ndarray
    corners: np.ndarray
    sizes: np.ndarray
    uv: np.ndarray
    slots: np.ndarray

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Shape:
        """The shape, shifted by metres."""
        return replace(self, vertices=self.vertices + np.array([x, y, z]))

    def scaled(self, x: float, y: float, z: float) -> Shape:
        """The shape, stretched by positive factors; the UVs stay as they are."""
        return replace(self, vertices=self.vertices * np.array([x, y, z]))

    def turned(self, angle: float, axis: str = "z") -> Shape:
        """The shape, turned about an axis through the origin by `angle` (rad)."""
        cosine, sine = np.cos(angle), np.sin(angle)
        first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
        matrix = np.eye(3)
        matrix[first, first] = matrix[second, second] = cosine
        matrix[first, second], matrix[second, first] = -sine, sine
        return replace(self, vertices=self.vertices @ matrix.T)

    def slotted(self, slot: int) -> Shape:
        """The shape with one material slot throughout."""
        return replace(self, slots=np.full(len(self.sizes), slot))

    def flipped(self) -> Shape:
        """The shape facing inwards."""
        starts = np.cumsum(self.sizes) - self.sizes
        face = np.repeat(np.arange(len(self.sizes)), self.sizes)
        within = np.arange(len(self.corners)) - starts[face]
        order = starts[face] + self.sizes[face] - 1 - within
        return replace(self, corners=self.corners[order], uv=self.uv[order])


def joined(shapes: Iterable[Shape]) -> Shape:
    """Several shapes in one."""
    shapes = list(shapes)
    offsets = np.cumsum([0] + [len(shape.vertices) for shape in shapes])
    return Shape(
        np.concatenate([shape.vertices for shape in shapes]),
        np.concatenate([shape.corners + offset for shape, offset in zip(shapes, offsets)]),
        np.concatenate([shape.sizes for shape in shapes]),
        np.concatenate([shape.uv for shape in shapes]),
        np.concatenate([shape.slots for shape in shapes]),
    )


def polygons(vertices: np.ndarray, faces: Sequence[Sequence[int]], uv: np.ndarray | None = None, slots: Sequence[int] | int = 0) -> Shape:
    """A shape from lists of corners; without `uv` every face is mapped along its dominant axis."""
    sizes = np.array([len(face) for face in faces])
    corners = np.array([corner for face in faces for corner in face])
    vertices = np.asarray(vertices, float)
    if uv is None:
        uv = box_mapping(vertices, corners, sizes)
    return Shape(vertices, corners, sizes, uv, np.broadcast_to(slots, len(sizes)).copy())


def box_mapping(vertices: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """(C, 2) UVs in metres: each face projected along the axis that its normal is nearest to."""
    starts = np.cumsum(sizes) - sizes
    face = np.repeat(np.arange(len(sizes)), sizes)
    step = np.arange(len(corners)) - starts[face]
    following = starts[face] + (step + 1) % sizes[face]
    points = vertices[corners]
    normals = np.add.reduceat(np.cross(points, points[following]), starts)  # Newell's area vector
    axis = np.argmax(np.abs(normals) + np.array([1e-12, 0, 2e-12]), axis=1)[face]
    return np.stack([np.where(axis == 0, points[:, 1], points[:, 0]), np.where(axis == 2, points[:, 1], points[:, 2])], axis=1)


def box(size: Sequence[float], centre: Sequence[float] = (0, 0, 0), chamfer: float = 0.0) -> Shape:
    """A cuboid; `chamfer` cuts its edges by that many metres."""
    x, y, z = np.asarray(size, float) / 2
    outline = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    return prism(outline, 2 * z, chamfer=chamfer).moved(*np.asarray(centre, float) - [0, 0, z])


def offset_outline(outline: np.ndarray, distance: float) -> np.ndarray:
    """A counter-clockwise outline (N, 2), each edge moved inwards by `distance`, corners mitred."""
    along = np.roll(outline, -1, axis=0) - outline
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1)
    before = np.roll(inward, 1, axis=0)
    return outline + distance * (before + inward) / (1 + np.sum(before * inward, axis=1, keepdims=True))


def chamfered_outline(outline: np.ndarray, chamfer: float) -> np.ndarray:
    """An outline whose every corner is cut, `chamfer` metres from the corner along both edges."""
    to_next = np.roll(outline, -1, axis=0) - outline
    to_next /= np.linalg.norm(to_next, axis=1, keepdims=True)
    to_last = -np.roll(to_next, 1, axis=0)
    return np.stack([outline + chamfer * to_last, outline + chamfer * to_next], axis=1).reshape(-1, 2)


def prism(outline: np.ndarray, height: float, holes: Sequence[np.ndarray] = (), chamfer: float = 0.0) -> Shape:
    """An outline (N, 2) raised along z from 0 to `height`, with holes right through.

    Outline and holes are counter-clockwise and simple.  `chamfer` cuts the edges round both caps, and the upright edges of
    a four-cornered outline.
    """
    outline = np.asarray(outline, float)
    if chamfer and len(outline) == 4:
        outline = chamfered_outline(outline, chamfer)
    loops = [outline] + [np.asarray(hole, float)[::-1] for hole in holes]  # holes clockwise: the solid is always to the left
    sections = [(0.0, 0.0), (height, 0.0)] if not chamfer else [(0.0, chamfer), (chamfer, 0.0), (height - chamfer, 0.0), (height, chamfer)]
    vertices, faces, uvs, count = [], [], [], 0
    caps: list[np.ndarray] = []
    for loop in loops:
        n = len(loop)
        length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1))])
        for level, inset in sections:
            ring = offset_outline(loop, inset) if inset else loop
            vertices.append(np.column_stack([ring, np.full(n, level)]))
        for row in range(len(sections) - 1):
            for i in range(n):
                j = (i + 1) % n
                low, high = count + row * n, count + (row + 1) * n
                faces.append([low + i, low + j, high + j, high + i])
                z0, z1 = sections[row][0], sections[row + 1][0]
                uvs += [[length[i], z0], [length[i + 1], z0], [length[i + 1], z1], [length[i], z1]]
        caps.append(np.arange(count, count + n))
        count += n * len(sections)
    points = np.concatenate(vertices)
    if len(loops) == 1:
        cap_faces = [caps[0]]
    else:
        from mathutils import Vector
        from mathutils.geometry import tessellate_polygon

        flat = np.concatenate(caps)
        cap_faces = []
        for triangle in tessellate_polygon([[Vector((*points[i, :2], 0)) for i in cap] for cap in caps]):
            a, b, c = flat[list(triangle)]
            u, v = points[b, :2] - points[a, :2], points[c, :2] - points[a, :2]
            cap_faces.append(np.array([a, b, c] if u[0] * v[1] > u[1] * v[0] else [a, c, b]))
    first = {int(i): len(loop) * (len(sections) - 1) for loop, cap in zip(loops, caps) for i in cap}
    for cap in cap_faces:
        faces.append([int(i) for i in cap[::-1]])
        uvs += points[cap[::-1], :2].tolist()
        faces.append([int(i) + first[int(i)] for i in cap])
        uvs += points[cap, :2].tolist()
    return polygons(points, faces, np.array(uvs))


def _tube(rings: np.ndarray, uv: np.ndarray, closed: bool) -> Shape:
    """Quads between consecutive rings (R, N, 3), each ring closed; uv is (R [+ 1 if closed], N + 1, 2).

    An open tube gets a cap at either end.
    """
    count, n = rings.shape[:2]
    row, column = np.meshgrid(np.arange(count if closed else count - 1), np.arange(n), indexing="ij")
    row, column = row.ravel(), column.ravel()
    above, beside = (row + 1) % count, (column + 1) % n
    quads = np.stack([row * n + column, row * n + beside, above * n + beside, above * n + column], axis=1)
    quad_uv = np.stack([uv[row, column], uv[row, column + 1], uv[row + 1, column + 1], uv[row + 1, column]], axis=1)
    corners, sizes, uvs = [quads.ravel()], [np.full(len(quads), 4)], [quad_uv.reshape(-1, 2)]
    vertices = rings.reshape(-1, 3)
    if not closed:
        for cap in (np.arange(n)[::-1], (count - 1) * n + np.arange(n)):
            corners.append(cap)
            sizes.append(np.array([n]))
            uvs.append(box_mapping(vertices, cap, np.array([n])))
    sizes = np.concatenate(sizes)
    return Shape(vertices, np.concatenate(corners), sizes, np.concatenate(uvs), np.zeros(len(sizes), int))


def _lengths(points: np.ndarray, closed: bool) -> np.ndarray:
    """Arc length at each point; one more entry than points if the line is closed."""
    line = np.concatenate([points, points[:1]]) if closed else points
    return np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def lathe(profile: np.ndarray, segments: int) -> Shape:
    """A profile (N, 2) of radius and height, from below to above, turned about z; both ends get flat caps."""
    profile = np.asarray(profile, float)
    angle = np.arange(segments) * (2 * np.pi / segments)
    rings = np.stack(
        [profile[:, :1] * np.cos(angle), profile[:, :1] * np.sin(angle), np.broadcast_to(profile[:, 1:], (len(profile), segments))], -1
    )
    around = np.arange(segments + 1) * (2 * np.pi / segments) * profile[:, 0].max()
    uv = np.stack(np.broadcast_arrays(around[None, :], _lengths(profile, False)[:, None]), axis=-1)
    return _tube(rings, uv, closed=False)


def sweep(profile: np.ndarray, path: np.ndarray, normal: Sequence[float] = (0, 0, 1), closed: bool = False) -> Shape:
    """A counter-clockwise profile (N, 2) along a planar path (M, 3), mitred at its corners.

    The profile's first axis points to the right of the path seen against `normal` (the plane's), its second along `normal`.
    """
    profile, path, normal = np.asarray(profile, float)[::-1], np.asarray(path, float), np.asarray(normal, float)
    forward = (np.roll(path, -1, axis=0) if closed else np.concatenate([path[1:], path[-1:]])) - path
    if not closed:
        forward[-1] = forward[-2]
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, normal)
    before = np.roll(right, 1, axis=0)
    if not closed:
        before[0] = right[0]
    mitre = (before + right) / (1 + np.sum(before * right, axis=1, keepdims=True))
    rings = path[:, None] + profile[None, :, :1] * mitre[:, None] + profile[None, :, 1:] * normal
    along, around = _lengths(path, closed), _lengths(profile, True)
    uv = np.stack(np.broadcast_arrays(along[:, None], around[None, :]), axis=-1)
    return _tube(rings, uv, closed)


def sheet(points: np.ndarray, uv: np.ndarray | None = None, thickness: np.ndarray | None = None) -> Shape:
    """A grid of points (R, C, 3) as quads; with a `thickness` (3,) or (R, C, 3) offset it becomes a closed slab.

    The given side faces along (next column - point) x (next row - point); the offset must lead away behind it.
    """
    rows, columns = points.shape[:2]
    if uv is None:
        across = np.cumsum(np.linalg.norm(np.diff(points, axis=1, prepend=points[:, :1]), axis=2), axis=1).mean(axis=0)
        up = np.cumsum(np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=2), axis=0).mean(axis=1)
        uv = np.stack(np.broadcast_arrays(across[None, :], up[:, None]), axis=-1)
    index = np.arange(rows * columns).reshape(rows, columns)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 4)
    flat_uv = uv.reshape(-1, 2)
    vertices = points.reshape(-1, 3)
    if thickness is not None:
        rim = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
        following = np.roll(rim, -1)
        back = rows * columns
        quads = np.concatenate([quads, back + quads[:, ::-1], np.stack([rim, rim + back, following + back, following], axis=1)])
        vertices = np.concatenate([vertices, (points + thickness).reshape(-1, 3)])
        flat_uv = np.concatenate([flat_uv, flat_uv])
    return Shape(vertices, quads.ravel(), np.full(len(quads), 4), flat_uv[quads.ravel()], np.zeros(len(quads), int))


def arc(radius: float, start: float, end: float, segments: int, centre: Sequence[float] = (0, 0)) -> np.ndarray:
    """(segments + 1, 2) points of a circle from angle `start` to `end` (rad)."""
    angle = np.linspace(start, end, segments + 1)
    return np.column_stack([np.cos(angle), np.sin(angle)]) * radius + np.asarray(centre, float)


def sphere(radius: float, segments: int, rings: int) -> Shape:
    """A sphere of quads; the poles are tiny flat caps, so that it is closed and has no degenerate face."""
    polar = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    polar[0] += 0.02
    polar[-1] -= 0.02
    return lathe(radius * np.column_stack([np.cos(polar), np.sin(polar)]), segments)


def mesh(name: str, shape: Shape, surfaces: Sequence[Surface] | Surface, sharp_angle: float | None = None):
    """A Blender mesh.  Flat shaded, or smooth except at edges sharper than `sharp_angle` (rad)."""
    import bpy

    surfaces = [surfaces] if isinstance(surfaces, Surface) else list(surfaces)
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(shape.vertices))
    data.vertices.foreach_set("co", shape.vertices.astype(np.float32).ravel())
    data.loops.add(len(shape.corners))
    data.loops.foreach_set("vertex_index", shape.corners.astype(np.int32))
    data.polygons.add(len(shape.sizes))
    data.polygons.foreach_set("loop_start", (np.cumsum(shape.sizes) - shape.sizes).astype(np.int32))
    data.polygons.foreach_set("material_index", shape.slots.astype(np.int32))
    tiles = np.array([surface.tile for surface in surfaces])
    layer = data.uv_layers.new(name="UVMap", do_init=False)
    layer.uv.foreach_set("vector", (shape.uv / np.repeat(tiles[shape.slots], shape.sizes)[:, None]).astype(np.float32).ravel())
    for surface in surfaces:
        data.materials.append(surface.material)
    data.update(calc_edges=True)
    if sharp_angle is None:
        data.shade_flat()
    else:
        data.shade_smooth()
        data.set_sharp_from_angle(angle=sharp_angle)
    return data


def place(name: str, data, location: Sequence[float] = (0, 0, 0), turn: float = 0.0, scale: float | Sequence[float] = 1.0):
    """An object of the scene that shows `data` (a mesh or a light), turned about z by `turn` (rad)."""
    import bpy

    thing = bpy.data.objects.new(name, data)
    thing.location = location
    thing.rotation_euler = (0, 0, turn)
    thing.scale = (scale, scale, scale) if np.isscalar(scale) else scale
    bpy.context.scene.collection.objects.link(thing)
    return thing
