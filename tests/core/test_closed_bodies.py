"""Bulbs and panels: closed bodies that shine are found, and their light stays what it is."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.jit import kernel
from lumigate.core.lamps import build_emitters, direct_irradiance
from lumigate.core.lamps.closed import outward
from lumigate.core.lamps.emission import emit
from lumigate.core.lamps.tables import BACK_OUT, FRONT_OUT, INWARDS, NORMAL
from lumigate.core.particles import trace_particles
from lumigate.core.rays import RayScene
from lumigate.core.sampling.sequences import sobol
from lumigate.core.surfaces.layout import SURFACE
from lumigate.core.surfaces.program import new_registers
from lumigate.core.transport import transport
from lumigate.headless.stress.arrays import camera, geometry, icosphere, lamp, materials, quads

BULB = icosphere(2, 0.3, inward=False)
FLOOR = quads([(-2, -2, -1), (2, -2, -1), (2, 2, -1), (-2, 2, -1)])


def scene_of(*parts, position=(0, 0, 5)):
    """A scene of parts (vertices, triangles, material), each an object; material 0 is grey, 1 shines."""
    vertices, triangles, material, first = [], [], [], 0
    for v, t, m in parts:
        vertices.append(v)
        triangles.append(np.asarray(t) + first)
        material.append(np.full(len(t), m))
        first += len(v)
    g = geometry(np.concatenate(vertices), np.concatenate(triangles), np.concatenate(material))
    g.object = np.repeat(np.arange(len(parts)), [len(m) for m in material]).astype(np.int32)
    g.object_names, g.object_visibility = [f"object {k}" for k in range(len(parts))], np.full(len(parts), sc.ALL_RAYS, np.uint8)
    return sc.Scene(
        g, materials((0.5, 0.0), (0.0, (4.0, 2.0, 1.0))), sc.Lamps.empty(), sc.World(np.zeros((1, 1, 3), np.float32)), camera(position)
    )


def sides(scene):
    """What `outward` says of all triangles of shining material."""
    return outward(scene, np.flatnonzero(scene.geometry.material == 1))


def over_a_floor(*parts, **options):
    """`sides` of a scene of these parts and a floor."""
    return sides(scene_of(*parts, (*FLOOR, 0), **options))


def split(vertices, triangles):
    """The same with vertices of its own for each triangle, as files with hard edges have them."""
    return vertices[triangles.ravel()], np.arange(3 * len(triangles)).reshape(-1, 3)


def test_bodies_know_their_outside():
    vertices, triangles = BULB
    assert (over_a_floor((*BULB, 1)) == 1).all()
    assert (over_a_floor((vertices, triangles[:, ::-1], 1)) == -1).all()
    assert (over_a_floor((*split(vertices, triangles), 1)) == 1).all()
    apart = np.concatenate([vertices, vertices + np.array([2, 0, 0])]), np.concatenate([triangles, triangles[:, ::-1] + len(vertices)])
    found = over_a_floor((*apart, 1))
    assert (found[: len(triangles)] == 1).all()
    assert (found[len(triangles) :] == -1).all()


def test_what_is_open_or_holds_something_is_no_body():
    vertices, triangles = BULB
    assert not over_a_floor((vertices, triangles[1:], 1)).any()
    assert not over_a_floor((0.1 * FLOOR[0], FLOOR[1], 1)).any()
    two_sheets = np.concatenate([0.5 * FLOOR[0], 0.5 * FLOOR[0]]), np.concatenate([FLOOR[1], FLOOR[1][:, ::-1] + 4])
    assert not over_a_floor((*two_sheets, 1)).any()
    assert not over_a_floor((*BULB, 1), position=(0.1, 0, 0)).any()
    assert not over_a_floor((*BULB, 1), (0.1 * FLOOR[0], FLOOR[1], 0)).any()
    assert not sides(scene_of((*BULB, 1))).any()  # all there is
    nested = over_a_floor((*BULB, 1), (0.2 * vertices, triangles, 1))
    assert not nested[: len(triangles)].any()
    assert (nested[len(triangles) :] == 1).all()
    clear, lit = (scene_of((*BULB, 1), (*FLOOR, 0)) for _ in range(2))
    clear.materials.tables.flags[1] |= sc.TRANSPARENT
    lit.lamps = lamp(sc.POINT, 1.0, (0.1, 0, 0))
    assert not sides(clear).any()
    assert not sides(lit).any()


@kernel
def _flux_through(emitters, count, seed, out):
    rows = new_registers(emitters.materials)
    surface = np.zeros(SURFACE, np.float32)
    for i in range(count):
        p = emit(emitters, rows, surface, (i + 0.5) / count, sobol(i, 1, seed), sobol(i, 2, seed), sobol(i, 3, seed), sobol(i, 4, seed))
        n = emitters.shapes[p[0] - emitters.first_triangle, NORMAL:]
        side = 0 if n[0] * p[4] + n[1] * p[5] + n[2] * p[6] > 0 else 1
        out[side, 0] += 1
        out[side, 1] += p[7] / count


@pytest.mark.parametrize("inverted", [False, True])
def test_few_particles_start_into_a_body(inverted):
    vertices, triangles = BULB
    emitters = build_emitters(scene_of((vertices, triangles[:, ::-1] if inverted else triangles, 1), (*FLOOR, 0)))
    assert (emitters.flags & (BACK_OUT if inverted else FRONT_OUT)).all()
    found = np.zeros((2, 2))
    _flux_through(emitters, 1 << 16, np.uint32(3), found)
    found = found[::-1] if inverted else found
    assert found[1, 0] == pytest.approx(float(INWARDS) * found[0, 0], rel=0.02)
    np.testing.assert_allclose(found[:, 1], 0.5 * emitters.flux[:, 0].sum(), rtol=0.01)


@pytest.mark.parametrize("held", [False, True])
def test_bodies_shine_as_open_meshes_do(held, monkeypatch):
    """Direct light and virtual lights on the floor under a bulb and, where one is wrongly taken for a body, within a dome."""
    dome = icosphere(2, 4.0, inward=True)
    scene = scene_of((*(dome if held else BULB), 1), (*FLOOR, 0))
    g = scene.geometry
    lights = []
    for side in (0, -1 if held else 1):
        monkeypatch.setattr("lumigate.core.lamps.build.outward", lambda scene, triangle, side=side: np.full(len(triangle), side, np.int8))
        rays = RayScene(g.vertices, g.triangles, g.object_visibility[g.object], np.zeros(len(g.triangles), bool))
        tables = transport(g, scene.materials.tables, rays.tables, build_emitters(scene))
        up = np.tile(np.float32((0, 0, 1)), (4096, 1))
        place = np.concatenate([np.random.default_rng(1).uniform(-1, 1, (4096, 2)), np.full((4096, 1), -1)], 1).astype(np.float32)
        points = type("Points", (), dict(position=place, ns=up, ng=up, error=np.full(4096, 1e-6, np.float32)))
        direct, _ = direct_irradiance(tables, points, 16, 1)
        vpls, _ = trace_particles(tables, 1 << 19, 1, 5)
        lights.append((direct.mean(0), vpls.flux.sum(0)))
    for plain, closed in zip(*lights):
        np.testing.assert_allclose(closed, plain, rtol=0.04)


def test_rays_are_not_spent_on_the_insides_of_bodies():
    """With as many rays the light of a bulb is told better than that of the same mesh with one triangle missing, whose inside counts."""
    vertices, triangles = BULB
    spread = []
    for part in (triangles, triangles[:-1]):
        scene = scene_of((vertices, part, 1), (*FLOOR, 0))
        g = scene.geometry
        rays = RayScene(g.vertices, g.triangles, g.object_visibility[g.object], np.zeros(len(g.triangles), bool))
        tables = transport(g, scene.materials.tables, rays.tables, build_emitters(scene))
        up = np.tile(np.float32((0, 0, 1)), (200, 1))
        points = type(
            "Points", (), dict(position=np.tile(np.float32((0.4, 0.1, -1)), (200, 1)), ns=up, ng=up, error=np.full(200, 1e-6, np.float32))
        )
        direct, _ = direct_irradiance(tables, points, 4, 1)
        spread.append(direct[:, 0].std() / direct[:, 0].mean())
    assert spread[0] < 0.7 * spread[1]
