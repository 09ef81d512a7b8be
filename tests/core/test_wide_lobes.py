"""Wide glossy lobes: what other rays find for them is the same light as their own rays find, with less noise."""

import math

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.lamps import build_emitters, world_tables
from lumigate.core.methods import caustics
from lumigate.core.methods.glossy import reflect
from lumigate.core.methods.importance_sampling import ImportanceSampling
from lumigate.core.methods.wide_lobes import sees_alike
from lumigate.core.rays import RayScene
from lumigate.core.surfaces.layout import DIFFUSE, GLOSSY_F0, GLOSSY_F90, ROUGHNESS
from lumigate.core.transport import transport
from lumigate.core.view.primary import view

SEEDS = 6


@pytest.fixture(scope="module")
def room(build):
    """(transport tables, shading points) of a diffuse room with a lamp near its ceiling; its ray scene is kept."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    lamp = [(0.2, -0.3, 0.8), (0.2, 0.3, 0.8), (0.8, 0.3, 0.8), (0.8, -0.3, 0.8)]
    quads = build.geometry(*build.quads(*([corners[k] for k in face] for face in faces), lamp), material=np.repeat([0, 1], [12, 2]))
    scene = build.scene(
        quads, build.materials((0.6, 0.0), (0.0, 10.0)), camera=build.camera(width=24, height=24, position=(-0.3, 0.1, 0.9))
    )
    rays = RayScene(scene.geometry.vertices, scene.geometry.triangles)
    tables = transport(scene.geometry, scene.materials.tables, rays.tables, build_emitters(scene))
    points = view(scene, rays.tables, world_tables(scene.world), 2, 1, 1).points
    yield tables, points
    rays.close()


def at_low_angles(room):
    """The room, whose points are seen at a tenth above the surface."""
    tables, points = room
    along = np.cross(points.ns, np.float32([0.3, 0.5, 0.81]))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return tables, points._replace(wo=np.float32(0.1) * points.ns + np.float32(0.995) * along)


def reflections(room, roughness, shared, seed):
    """Indirect light (N,) that lobes of a roughness show, by two rays of their own and, where `shared`, by the others'."""
    tables, points = room
    ones = np.ones_like(points.f0)
    points = points._replace(f0=0.1 * ones, f90=0.6 * ones, albedo=0.3 * ones, roughness=np.full(len(ones), roughness, np.float32))
    solver = ImportanceSampling(samples=4, gather=4, bounces=3, seed=seed)
    solver.cache_light(tables, points)
    solver.prepare(tables, points, 4096)
    solver.irradiance(points, reflections=2 if shared else 0)
    own = reflect(tables, points, 4, 2, 3, seed, cache=solver.cache, near=solver.near, shared=solver.shared).indirect
    return (own + solver.reflected if shared else own)[:, 0].astype(np.float64)


@pytest.mark.parametrize("roughness, quieter", [(0.4, 1.2), (0.7, 4.0), (1.0, 10.0)])
def test_other_rays_find_the_same_light_for_a_wide_lobe_with_less_noise(room, roughness, quieter):
    alone, together = (np.stack([reflections(room, roughness, shared, seed) for seed in range(SEEDS)]) for shared in (False, True))
    means = [pictures.mean(axis=1) for pictures in (alone, together)]
    deviation = np.hypot(*(mean.std() / (SEEDS - 1) ** 0.5 for mean in means))
    assert abs(means[1].mean() - means[0].mean()) < 3 * deviation
    assert deviation < 0.025 * means[0].mean()
    noise = [pictures.var(axis=0).mean() for pictures in (alone, together)]
    assert noise[0] > quieter * noise[1]


def test_a_narrow_lobe_has_its_own_rays_only(room):
    np.testing.assert_array_equal(reflections(room, 0.1, False, 1), reflections(room, 0.1, True, 1))


def mirrors(room, roughness=0.1):
    """The room, its walls of metal."""
    tables, points = room
    constant = tables.materials.constant.copy()
    constant[0, DIFFUSE : DIFFUSE + 3], constant[0, ROUGHNESS] = 0, roughness
    constant[0, GLOSSY_F0 : GLOSSY_F0 + 3] = constant[0, GLOSSY_F90 : GLOSSY_F90 + 3] = 0.9
    flags = tables.materials.flags | np.array([sc.BRUSHED | sc.METAL, 0], np.int32)
    return tables._replace(materials=tables.materials._replace(constant=constant, flags=flags)), points


def test_what_mirrors_show_is_left_to_the_lobes_own_rays(room, monkeypatch):
    monkeypatch.setattr(caustics, "WORTHWHILE", math.inf)  # no photons
    dull = reflections(room, 0.7, True, 1)
    shown, alone = (reflections(mirrors(room), 0.7, shared, 1) for shared in (True, False))
    assert dull.any() and np.array_equal(shown, alone)


@pytest.mark.parametrize("roughness, low, within", [(0.7, False, 0.02), (0.4, True, 0.03)])
def test_what_mirrors_throw_of_the_lamps_comes_by_photons_where_there_are_any(room, roughness, low, within):
    """Neither twice nor not at all; of the same seeds, for the paths after the first metal are most of the noise."""
    seen = mirrors(at_low_angles(room) if low else room, 0.3)
    alone, photons = (np.mean([reflections(seen, roughness, shared, seed) for seed in range(2)]) for shared in (False, True))
    assert photons == pytest.approx(float(alone), rel=within)


def test_what_either_kind_of_ray_alone_may_meet_is_not_shared():
    assert sees_alike(np.array([sc.ALL_RAYS, 0], np.uint8))
    assert not sees_alike(np.array([sc.ALL_RAYS, sc.ALL_RAYS & ~sc.GLOSSY], np.uint8))
    assert not sees_alike(np.array([sc.ALL_RAYS & ~sc.DIFFUSE], np.uint8))
