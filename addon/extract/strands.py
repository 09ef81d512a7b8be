"""Hair curves, hair particles and point clouds as triangles: tubes and balls as wide, in the mean over all views, as Cycles' ribbons and spheres."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from math import pi

import bmesh
import bpy
import numpy as np

from ..materials.requests import INTERCEPT, IS_STRAND, LENGTH, RANDOM, THICKNESS
from .meshes import READABLE, MeshCopy, layer, read

_HAIR_RADIUS, _POINT_RADIUS = 0.005, 0.01  # m, of curves and points that have none, as in Cycles
# Sides of a tube by how many triangles that makes: a hair is narrower than a pixel where there are many.
_SIDES = ((8, 200_000), (5, 1_000_000), (4, 2_000_000), (3, np.inf))
_FINE, _FINE_TRIANGLES = 4, 300_000  # parts of a curve between two points, where it makes no more triangles than these
# Subdivisions of an icosahedron by the same.
_BALLS = ((3, 100_000), (2, 500_000), (1, 2_000_000), (0, np.inf))
_SURFACE_UV = "surface_uv_coordinate"  # of hair curves: where they grow


@dataclass
class Strands:
    """S curves of P points in all, in the space of their object.

    points: (P, 3) float32.  radius: (P,) float32.  first: (S + 1,) int, where each curve's points begin.
    layers: attributes by name, (P, 4) float32.  uv: that of a texture without a name ('' for none).
    """

    points: np.ndarray
    radius: np.ndarray
    first: np.ndarray
    layers: dict[str, np.ndarray] = field(default_factory=dict)
    uv: str = ""


def copy_curves(curves: bpy.types.Curves, wanted: Collection[str]) -> MeshCopy | None:
    """The tubes of an evaluated Curves data-block; None where it has no curve.  wanted: names of layers to copy."""
    count = len(curves.points)
    if not count or "position" not in curves.attributes:
        return None
    first = read(curves.curve_offset_data, "value", (len(curves.curves) + 1,), np.int32)
    of_curve = np.repeat(np.arange(len(first) - 1), np.diff(first))
    index = {"POINT": np.arange(count), "CURVE": of_curve}
    strands = Strands(
        points=read(curves.attributes["position"].data, "vector", (count, 3), np.float32),
        radius=_radius(curves.attributes, count, _HAIR_RADIUS),
        first=first,
        layers=_layers(curves.attributes, {*wanted, _SURFACE_UV}, index),
        uv=_SURFACE_UV if _SURFACE_UV in curves.attributes else "",
    )
    return tubes(strands, curves.name)


def copy_hair(ob: bpy.types.Object, system: bpy.types.ParticleSystem, modifier: bpy.types.Modifier, is_render: bool) -> MeshCopy | None:
    """The tubes of the hair of an evaluated object's particle system (Cycles' `blender/curves.cpp`); None where it has none.

    is_render: whether it was evaluated for a render, whose paths have their own number of steps.
    """
    settings = system.settings
    parents, children = len(system.particles), len(system.child_particles)
    begin = parents if settings.child_type != "NONE" and children else 0
    steps = 2 ** (settings.render_step if is_render else settings.display_step) + 1
    steps += settings.kink_extra_steps if settings.kink == "SPIRAL" else 0
    count = parents + children - begin
    if count <= 0 or not parents:
        return None
    points = np.array([system.co_hair(ob, particle_no=i, step=k) for i in range(begin, begin + count) for k in range(steps)], np.float64)
    to_object = np.linalg.inv(np.array(ob.matrix_world, np.float64))
    points = (points @ to_object[:3, :3].T + to_object[:3, 3]).astype(np.float32)
    t = np.linspace(0, 1, steps)
    shape = settings.shape
    taper = (1 - t) ** (1 + shape if shape < 0 else 1 / max(1 - shape, 1e-6))
    radius = 0.5 * settings.radius_scale * (taper * (settings.root_radius - settings.tip_radius) + settings.tip_radius)
    if settings.use_close_tip:
        radius[-1] = 0
    layers = {}
    for k, uv in enumerate(ob.data.uv_layers):
        at = [
            system.uv_on_emitter(modifier, particle=system.particles[i if i < parents else 0], particle_no=i, uv_no=k)
            for i in range(begin, begin + count)
        ]
        layers[uv.name] = np.repeat([(u, v, 0, 1) for u, v in at], steps, axis=0).astype(np.float32)
    strands = Strands(
        points=points,
        radius=np.tile(radius, count).astype(np.float32),
        first=np.arange(count + 1) * steps,
        layers=layers,
        uv=next((uv.name for uv in ob.data.uv_layers if uv.active_render), ""),
    )
    return tubes(strands, f"{ob.data.name}, {system.name}")


def tubes(strands: Strands, name: str) -> MeshCopy | None:
    """The curves as tubes without ends, shaded smoothly: Catmull-Rom splines where they are few, straight from point to point where many."""
    lengths = np.diff(strands.first)
    segments = int(np.maximum(lengths - 1, 0).sum())
    sides = next(sides for sides, most in _SIDES if 2 * sides * segments <= most)
    parts = _FINE if 2 * sides * segments * _FINE <= _FINE_TRIANGLES else 1
    # The mean width of a convex outline is its perimeter over pi.
    widened = pi / (sides * np.sin(pi / sides))
    made = [
        _tubes_alike(strands, np.flatnonzero(lengths == length), int(length), sides, parts, widened)
        for length in np.unique(lengths[lengths > 1])
    ]
    if not made:
        return None
    bases = np.cumsum([0, *(len(vertices) for vertices, _, _, _ in made)])
    return _copy(
        name,
        vertices=np.concatenate([vertices for vertices, _, _, _ in made]),
        normals=np.concatenate([normals for _, normals, _, _ in made]),
        corners=np.concatenate([corners + base for (_, _, corners, _), base in zip(made, bases)]),
        layers={key: np.concatenate([layers[key] for _, _, _, layers in made]) for key in made[0][3]},
        uv=strands.uv,
    )


def _tubes_alike(strands: Strands, which: np.ndarray, length: int, sides: int, parts: int, widened: float) -> tuple:
    """Curves of one number of points -> (V, 3) vertices, (V, 3) normals, (T, 3) corners, layers by vertex."""
    index = strands.first[which][:, None] + np.arange(length)
    points, radius = _splined(strands.points[index].astype(np.float64), parts), _splined(strands.radius[index][..., None], parts)
    radius = np.maximum(radius, 0)
    count, rings = points.shape[:2]
    steps = np.diff(points, axis=1)
    along = np.concatenate([np.zeros((count, 1)), np.cumsum(np.linalg.norm(steps, axis=2), axis=1)], axis=1)
    tangent = _unit(np.concatenate([steps[:, :1], steps[:, :-1] + steps[:, 1:], steps[:, -1:]], axis=1))
    across = _carried(tangent)
    other = np.cross(tangent, across)
    angle = 2 * pi * np.arange(sides) / sides
    normals = np.cos(angle)[:, None] * across[:, :, None] + np.sin(angle)[:, None] * other[:, :, None]
    vertices = points[:, :, None] + widened * radius[:, :, None] * normals
    ring = np.arange(count * rings, dtype=np.int64).reshape(count, rings)
    a, side = ring[:, :-1, None] * sides, np.arange(sides)
    b, turned = a + sides, (side + 1) % sides
    quads = np.stack([a + side, a + turned, b + turned, a + side, b + turned, b + side], axis=-1).reshape(-1, 2, 3)
    # A ring without width leaves triangles without area.
    closed = (radius[..., 0] <= 0)[:, :, None].repeat(sides, 2)
    kept = np.stack([~closed[:, :-1], ~closed[:, 1:]], axis=-1).reshape(-1, 2)
    at = np.repeat(np.repeat(index, np.r_[np.full(length - 1, parts), 1], axis=1).ravel(), sides)  # attributes stay until the next point
    by_ring = {
        IS_STRAND: np.ones((count, rings)),
        INTERCEPT: along / np.maximum(along[:, -1:], 1e-30),
        LENGTH: along[:, -1:].repeat(rings, 1),
        THICKNESS: 2 * radius[..., 0],
        RANDOM: _random(which)[:, None].repeat(rings, 1),
    }
    layers = {key: np.repeat(_wide(values.reshape(-1)), sides, axis=0) for key, values in by_ring.items()}
    layers |= {key: values[at] for key, values in strands.layers.items()}
    return vertices.reshape(-1, 3), normals.reshape(-1, 3), quads[kept], layers


def _splined(values: np.ndarray, parts: int) -> np.ndarray:
    """(S, K, C) -> (S, parts (K - 1) + 1, C) along the Catmull-Rom splines through the values, whose ends count twice, as in Cycles."""
    if parts == 1:
        return values
    padded = np.concatenate([values[:, :1], values, values[:, -1:]], axis=1)
    p0, p1, p2, p3 = (padded[:, k : k + values.shape[1] - 1, None] for k in range(4))
    t = (np.arange(parts) / parts)[:, None]
    curve = 0.5 * (2 * p1 + (p2 - p0) * t + (2 * p0 - 5 * p1 + 4 * p2 - p3) * t**2 + (3 * p1 - 3 * p2 + p3 - p0) * t**3)
    return np.concatenate([curve.reshape(len(values), -1, values.shape[2]), values[:, -1:]], axis=1)


def _carried(tangent: np.ndarray) -> np.ndarray:
    """(S, K, 3) unit vectors across the (S, K, 3) tangents, which turn no more than they must from one to the next."""
    across = np.empty_like(tangent)
    axis = np.eye(3)[np.abs(tangent[:, 0]).argmin(axis=1)]
    for k in range(tangent.shape[1]):
        t = tangent[:, k]
        turned = axis - (axis * t).sum(1, keepdims=True) * t
        short = (turned * turned).sum(1) < 1e-6  # a curve that turns by a right angle at once
        if short.any():
            other = np.eye(3)[np.abs(t[short]).argmin(axis=1)]
            turned[short] = other - (other * t[short]).sum(1, keepdims=True) * t[short]
        across[:, k] = axis = _unit(turned)
    return across


def copy_points(cloud: bpy.types.PointCloud, wanted: Collection[str]) -> MeshCopy | None:
    """The balls of an evaluated point cloud; None where it has no point.  wanted: names of layers to copy."""
    count = len(cloud.points)
    if not count:
        return None
    subdivisions = next(k for k, most in _BALLS if 20 * 4**k * count <= most)
    vertices, corners = _ball(subdivisions)
    # As much surface as a sphere: the mean area that a convex body shows is a quarter of its surface.
    edges = vertices[corners]
    area = np.linalg.norm(np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]), axis=1).sum() / 2
    widened = np.sqrt(4 * pi / area)
    centres = read(cloud.attributes["position"].data, "vector", (count, 3), np.float32)
    radius = _radius(cloud.attributes, count, _POINT_RADIUS)
    at = np.repeat(np.arange(count), len(vertices))
    layers = _layers(cloud.attributes, wanted, {"POINT": np.arange(count)})
    layers |= {THICKNESS: _wide(2 * radius), RANDOM: _wide(_random(np.arange(count)))}
    return _copy(
        cloud.name,
        vertices=(centres[:, None] + widened * radius[:, None, None] * vertices).reshape(-1, 3),
        normals=np.tile(vertices, (count, 1)),
        corners=(corners + len(vertices) * np.arange(count)[:, None, None]).reshape(-1, 3),
        layers={key: values[at] for key, values in layers.items()},
        uv="",
    )


def _ball(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) vertices of length 1 and (T, 3) corners of a subdivided icosahedron."""
    ball = bmesh.new()
    try:
        bmesh.ops.create_icosphere(ball, subdivisions=subdivisions + 1, radius=1)
        ball.verts.index_update()
        vertices = np.array([v.co for v in ball.verts], np.float64)
        return _unit(vertices), np.array([[v.index for v in face.verts] for face in ball.faces], np.int64)
    finally:
        ball.free()


def _copy(name: str, vertices: np.ndarray, normals: np.ndarray, corners: np.ndarray, layers: dict[str, np.ndarray], uv: str) -> MeshCopy:
    """normals, layers: by vertex."""
    vertices, corners = vertices.astype(np.float32), corners.astype(np.int32)
    low, high = vertices.min(0), vertices.max(0)
    return MeshCopy(
        name=name,
        vertices=vertices,
        corners=corners,
        slot=np.zeros(len(corners), np.int32),
        normals=normals.astype(np.float32)[corners],
        undeformed=vertices,
        texture_location=(low + high) / 2,
        texture_size=(high - low) / 2,
        layers={key: values[corners] for key, values in layers.items()},
        uv=uv,
    )


def _radius(attributes: bpy.types.AttributeGroup, count: int, default: float) -> np.ndarray:
    found = attributes.get("radius")
    if found is None or found.domain != "POINT" or found.data_type != "FLOAT":
        return np.full(count, default, np.float32)
    return read(found.data, "value", (count,), np.float32)


def _layers(attributes: bpy.types.AttributeGroup, wanted: Collection[str], index: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The wanted attributes at the points, (P, 4); index: those of a domain's values at each point."""
    there = (attribute for attribute in attributes if attribute.name in wanted)
    return {a.name: layer(a, index[a.domain]) for a in there if a.data_type in READABLE and a.domain in index}


def _wide(values: np.ndarray) -> np.ndarray:
    """(N,) numbers as a shader sees them: (N, 4) float32."""
    wide = np.ones((len(values), 4), np.float32)
    wide[:, :3] = values[:, None]
    return wide


def _random(index: np.ndarray) -> np.ndarray:
    """(N,) the random number that Cycles has for curve or point `index`."""
    return hashed(index) / float(0xFFFFFFFF)


def hashed(values: np.ndarray) -> np.ndarray:
    """(N,) uint32: hash_uint2(value, 0) of Cycles' util/hash.h (Jenkins' lookup3)."""
    state = [np.full(len(values), (0xDEADBEEF + (2 << 2) + 13) & 0xFFFFFFFF, np.uint32) for _ in range(3)]
    state[0] += values.astype(np.uint32)
    for i, j, k in ((2, 1, 14), (0, 2, 11), (1, 0, 25), (2, 1, 16), (0, 2, 4), (1, 0, 14), (2, 1, 24)):
        rotated = (state[j] << np.uint32(k)) | (state[j] >> np.uint32(32 - k))
        state[i] = (state[i] ^ state[j]) - rotated
    return state[2]


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), (0.0, 0.0, 1.0))
