"""Small scenes made of arrays, for all tests of the core."""

from types import SimpleNamespace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.surfaces.layout import DIFFUSE, EMISSION, GLOSSY_F0, GLOSSY_F90, ROUGHNESS, SURFACE
from lumigate.core.surfaces.program import empty_tables


def materials(*surfaces):
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


def glossy_materials(*surfaces, albedo, roughness):
    """`materials`, each with a glossy lobe of one albedo from every side."""
    stuff = materials(*surfaces)
    stuff.tables.constant[:, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[:, GLOSSY_F90 : GLOSSY_F90 + 3] = albedo
    stuff.tables.constant[:, ROUGHNESS] = roughness
    stuff.tables.flags[:] |= sc.GLOSSY_LOBE
    return stuff


def geometry(vertices, triangles, material=None, corner_normals=None):
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


def quads(*corners):
    """Vertices and triangles of quads, each given by its 4 corners; the normal follows the right hand."""
    vertices = np.concatenate([np.asarray(c, float) for c in corners])
    base = np.arange(len(corners))[:, None] * 4
    triangles = np.stack([base + np.array([0, 1, 2]), base + np.array([0, 2, 3])], 1).reshape(-1, 3)
    return vertices, triangles


def icosphere(subdivisions, radius=1.0, inward=True):
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


def camera(position=(0, 0, 0), width=16, height=16, angle=np.pi / 2):
    """A square-pixelled camera that looks along -z."""
    matrix = np.eye(4)
    matrix[:3, 3] = position
    half = np.tan(angle / 2)
    return sc.Camera(
        matrix, False, (-half, half, -half * height / width, half * height / width), width, height, (0, 0, width, height), 1e-3, 1e3
    )


def default_camera():
    """At the origin, 16 x 16 pixels."""
    return camera()


def scene(geometry, materials, *, lamps=None, world=(0, 0, 0), camera=None):
    """A whole scene."""
    radiance = np.array(world, np.float32).reshape(1, 1, 3)
    return sc.Scene(geometry, materials, lamps or sc.Lamps.empty(), sc.World(radiance), camera or default_camera())


@pytest.fixture(scope="session")
def build():
    """The builders above, by name."""
    return SimpleNamespace(
        materials=materials,
        glossy_materials=glossy_materials,
        geometry=geometry,
        quads=quads,
        icosphere=icosphere,
        camera=camera,
        scene=scene,
    )
