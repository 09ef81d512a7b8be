"""Small scenes made of arrays alone, without Blender: for stress cases and for the tests of the core."""

from __future__ import annotations

from itertools import chain

import numpy as np

from ...core import scene as sc
from ...core.surfaces.layout import DIFFUSE, EMISSION, GLOSSY_F0, GLOSSY_F90, ROUGHNESS, SURFACE, TRANSLUCENCY
from ...core.surfaces.program import ATTRIBUTE, DIFFUSE_CLOSURE, END, REGISTERS, TEXTURE, empty_tables
from ...core.surfaces.textures import LINEAR, REPEAT, TexturePool


def materials(*surfaces) -> sc.Materials:
    """Materials of constant (albedo, emission) pairs; a number is a grey."""
    constant = np.zeros((len(surfaces), SURFACE), np.float32)
    flags = np.full(len(surfaces), sc.CONSTANT, np.int32)
    for i, (albedo, emission) in enumerate(surfaces):
        constant[i, DIFFUSE : DIFFUSE + 3] = albedo
        constant[i, EMISSION : EMISSION + 3] = emission
        if np.any(np.asarray(emission) > 0):
            flags[i] |= sc.EMISSIVE
    tables = empty_tables()._replace(flags=flags, constant=constant, start=np.zeros(len(surfaces), np.int32))
    return sc.Materials([f"material {i}" for i in range(len(surfaces))], tables)


def glossy_materials(*surfaces, albedo, roughness) -> sc.Materials:
    """`materials`, each with a glossy lobe of one albedo from every side."""
    stuff = materials(*surfaces)
    stuff.tables.constant[:, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[:, GLOSSY_F90 : GLOSSY_F90 + 3] = albedo
    stuff.tables.constant[:, ROUGHNESS] = roughness
    stuff.tables.flags[:] |= sc.GLOSSY_LOBE
    return stuff


def translucent_materials(*surfaces, transmittance) -> sc.Materials:
    """`materials`, each of which lets light through diffusely where its transmittance (one of each, a number or rgb) is above 0."""
    stuff = materials(*surfaces)
    for i, value in enumerate(transmittance):
        stuff.tables.constant[i, TRANSLUCENCY : TRANSLUCENCY + 3] = value
        stuff.tables.flags[i] |= sc.TRANSLUCENT * bool(np.any(np.asarray(value) > 0))
    return stuff


def textured(stuff: sc.Materials, which: int, texels: np.ndarray) -> sc.Materials:
    """`stuff`, one of whose materials shows a float texture (H, W, 3) by attribute 0 instead of its constant albedo."""
    pool = TexturePool()
    texture = pool.add("texture", lambda: texels, REPEAT, LINEAR, 0)
    header, _, texels_f32 = pool.tables()
    zero, one = REGISTERS, REGISTERS + 1  # rows of constants
    code = [
        [END, *[0] * 7],
        [ATTRIBUTE, 0, *[zero] * 5, 0],
        [TEXTURE, 1, 0, *[zero] * 4, texture],
        [DIFFUSE_CLOSURE, 2, 1, zero, zero, one, zero, 0],
        [END, *[0] * 7],
    ]
    tables = stuff.tables._replace(
        code=np.array(code, np.int32),
        constants=np.array([[0, 0, 0, 1], [1, 1, 1, 1]], np.float32),
        texture_header=header,
        texels_f32=texels_f32,
    )
    tables.start[which], tables.flags[which] = 1, 0
    return sc.Materials(stuff.names, tables)


def geometry(vertices, triangles, material=None, corner_normals=None) -> sc.Geometry:
    """One object of triangles with flat normals unless others are given."""
    vertices = np.ascontiguousarray(vertices, np.float32)
    triangles = np.ascontiguousarray(triangles, np.int32)
    n = len(triangles)
    if corner_normals is None:
        a, b, c = (vertices[triangles[:, k]].astype(np.float64) for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        corner_normals = np.repeat(normal[:, None], 3, axis=1)
    return sc.Geometry(
        vertices,
        triangles,
        np.ascontiguousarray(corner_normals, np.float32),
        np.zeros((1, n, 3, 4), np.float32),
        np.zeros(n, np.int32) if material is None else np.asarray(material, np.int32),
        np.zeros(n, np.int32),
        ["object"],
        np.full(1, sc.ALL_RAYS, np.uint8),
    )


def quads(*corners) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of quads, each given by its 4 corners; the normal follows the right hand."""
    vertices = np.concatenate([np.asarray(c, float) for c in corners])
    base = np.arange(len(corners))[:, None] * 4
    triangles = np.stack([base + np.array([0, 1, 2]), base + np.array([0, 2, 3])], 1).reshape(-1, 3)
    return vertices, triangles


def icosphere(subdivisions, radius=1.0, inward=True) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of triangles; `inward` turns the normals to its middle."""
    t = (1 + 5**0.5) / 2
    v = np.array([(-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0), (0, -1, t), (0, 1, t), (0, -1, -t), (0, 1, -t), (t, 0, -1), (t, 0, 1), (-t, 0, -1), (-t, 0, 1)], float)  # fmt: skip
    f = np.array([(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)])  # fmt: skip
    for _ in range(subdivisions):
        corners = v[f]
        middle = (corners + np.roll(corners, -1, axis=1)) / 2
        a, b, c = (corners[:, k] for k in range(3))
        ab, bc, ca = (middle[:, k] for k in range(3))
        soup = np.stack([np.stack(x, 1) for x in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))], 1).reshape(-1, 3)
        v, inverse = np.unique(np.round(soup, 9), axis=0, return_inverse=True)
        f = inverse.reshape(-1, 3)
    v = radius * v / np.linalg.norm(v, axis=1, keepdims=True)
    return v, f[:, ::-1] if inward else f


def box(low, high, inward=True) -> tuple[np.ndarray, np.ndarray]:
    """The six quads of a box, -x +x -y +y -z +z; `inward` turns the normals to its middle."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    sides = (
        [(x0, y0, z0), (x0, y1, z0), (x0, y1, z1), (x0, y0, z1)],
        [(x1, y0, z0), (x1, y0, z1), (x1, y1, z1), (x1, y1, z0)],
        [(x0, y0, z0), (x0, y0, z1), (x1, y0, z1), (x1, y0, z0)],
        [(x0, y1, z0), (x1, y1, z0), (x1, y1, z1), (x0, y1, z1)],
        [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)],
        [(x0, y0, z1), (x0, y1, z1), (x1, y1, z1), (x1, y0, z1)],
    )
    return quads(*(side if inward else side[::-1] for side in sides))


def join(*parts) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and materials of (vertices, triangles, material) parts; a material is one index or (T,)."""
    starts = np.cumsum([0, *(len(v) for v, _, _ in parts)])
    triangles = np.concatenate([np.asarray(t) + start for start, (_, t, _) in zip(starts, parts)])
    material = np.concatenate([np.broadcast_to(m, len(t)) for _, t, m in parts])
    return np.concatenate([v for v, _, _ in parts]), triangles, material


def camera(position=(0, 0, 0), width=16, height=16, angle=np.pi / 2, near=1e-3, far=1e3) -> sc.Camera:
    """A square-pixelled camera that looks along -z."""
    matrix = np.eye(4)
    matrix[:3, 3] = position
    half = np.tan(angle / 2)
    window = (-half, half, -half * height / width, half * height / width)
    return sc.Camera(matrix, False, window, width, height, (0, 0, width, height), near, far)


def lamp(kind, emission, position=(0, 0, 0), axes=None, radius=0.0, angle=np.pi, blend=0.0, size=(0, 0), shape=sc.RECTANGLE) -> sc.Lamps:
    """One lamp; angle: of a spot's cone, a sun's disk or an area lamp's spread."""
    f = np.float32
    axes = np.eye(3) if axes is None else axes
    return sc.Lamps(
        np.array([kind], np.int32), np.array([position], f), np.array([axes], f), np.broadcast_to(f(emission), (1, 3)).copy(),
        np.array([radius], f), np.zeros(1, np.uint8), np.array([angle], f), np.array([blend], f), np.array([size], f),
        np.array([shape], np.int32), np.full(1, sc.ALL_RAYS, np.uint8), np.ones(1, np.uint8), ["lamp"], [""],
    )  # fmt: skip


def lamps(*single: sc.Lamps) -> sc.Lamps:
    """Many lamps in one table."""
    if not single:
        return sc.Lamps.empty()
    columns = zip(*(vars(one).items() for one in single))
    merged = {column[0][0]: [value for _, value in column] for column in columns}
    return sc.Lamps(**{name: list(chain(*v)) if isinstance(v[0], list) else np.concatenate(v) for name, v in merged.items()})


def scene(geometry, materials, *, lamps=None, world=(0, 0, 0), camera=None) -> sc.Scene:
    """A whole scene; world: one radiance, or (H, W, 3) of them."""
    radiance = np.asarray(world, np.float32)
    radiance = radiance.reshape(1, 1, 3) if radiance.ndim == 1 else radiance
    return sc.Scene(geometry, materials, lamps or sc.Lamps.empty(), sc.World(radiance), camera or default_camera())


def default_camera() -> sc.Camera:
    """At the origin, 16 x 16 pixels."""
    return camera()
