"""Kernels on a handful of inputs, small enough to run as plain Python (`tests/plain.py`), against float64 oracles that share no code."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core import vpl_pool as pool
from lumigate.core.inspection import contents
from lumigate.core.lamps import build_emitters, direct_irradiance, world_tables
from lumigate.core.lamps.emission import _focused_entry, _slabs, _spread_angle
from lumigate.core.methods.instant_radiosity import InstantRadiosity
from lumigate.core.methods.shadow_mapped import ShadowMappedRadiosity, direct_by_maps
from lumigate.core.particles import trace_particles
from lumigate.core.shadowmaps.paraboloid import paraboloid_maps
from lumigate.core.stages import Run, prepared
from lumigate.core.surfaces.layout import TRANSPARENCY
from lumigate.core.surfaces.textures import box_weights
from lumigate.core.view.corners import view_corners
from lumigate.core.view.primary import view
from lumigate.core.vpl_pool import UNSEEN, contributions, resample
from lumigate.headless.stress import arrays, rooms

F = np.float32


@pytest.fixture(scope="module")
def lit():
    """The room of the stress cases, ready for light: (tables, 12 shading points)."""
    scene = rooms.room(size=(4, 3))
    with prepared(Run(None), scene, replace(rooms.SETTINGS, method="instant-radiosity"), 1) as tables:
        yield tables, view(scene, tables.rays, world_tables(scene.world), 1, 1, 1).points


@pytest.mark.parametrize("half", [0.05, 0.7, 1.5])
def test_angles_of_a_spread_are_the_inverse_of_their_distribution(half):
    x = np.linspace(0, half, 100_001)
    density = np.cos(x) * (1 - np.tan(x) / math.tan(half)) * np.sin(x)
    below = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)])
    below /= below[-1]
    for u in (0.01, 0.3, 0.5, 0.9, 0.999):
        assert np.interp(_spread_angle(half, u), x, below) == pytest.approx(u, abs=1e-6)


@pytest.mark.parametrize("drawn", [(1 / 3, 1 / 3, 1 / 3), (0.25, 0.5, 0.25), (0.25, 0.75, 0.0)])
@pytest.mark.parametrize("direction", [(0, 0, -1), (0.6, 0, -0.8), (1 / 3, 2 / 3, -2 / 3)])
def test_focused_rays_cover_the_box_evenly(direction, drawn):
    # The mean of the inverse density is the area of the box's shadow, for a focus inside of it.
    box = np.array([(-1, -2, 0), (3, 2, 1)], F)
    focus = np.array([[(0, -1, 0.2), (1, 0, 0.4)], [(0.5, -0.5, 0.3), (2, 1, 0.9)]], F)
    area = np.abs(direction) @ [4 * 1, 4 * 1, 4 * 4]
    u = (np.stack(np.meshgrid(np.arange(48), np.arange(48)), -1).reshape(-1, 2) + 0.5) / 48
    rays = np.array([_focused_entry(box, focus, F(drawn), *F(direction), *F(pair)) for pair in u], float)
    assert rays[:, 3].mean() == pytest.approx(area, rel=0.03)
    for x, y, z, _ in rays[::17]:
        enter, leave = _slabs(box, F(x), F(y), F(z), *F(direction))
        assert enter <= leave + 1e-4 and abs(enter) < 1e-4  # it begins where it enters the box


@pytest.mark.parametrize("mix", [0.0, 0.3, 1.0])
def test_shares_of_a_boxs_sides(mix):
    rng = np.random.default_rng(2)
    for normal in np.abs(rng.normal(size=(40, 3))).astype(F):
        x, y, z = weights = box_weights(*normal, F(mix))
        assert sum(weights) == pytest.approx(1, abs=1e-5) and min(weights) > -1e-6
        assert box_weights(*normal[[1, 2, 0]], F(mix)) == pytest.approx((y, z, x), abs=1e-5)
        assert weights[normal.argmax()] == max(weights)
    assert box_weights(F(1), F(1e-3), F(0), F(mix)) == pytest.approx((1, 0, 0), abs=2e-3)
    if mix == 1:
        assert box_weights(F(1), F(1), F(1), F(1)) == pytest.approx((1 / 3, 1 / 3, 1 / 3), abs=1e-5)


def test_corners_of_triangles_look_at_their_own_third(lit):
    tables, _ = lit
    triangles = np.arange(4, dtype=np.int32)
    found = view_corners(tables, triangles, 2, 1, 1, materials=True)
    points = found.points
    assert len(points.pixel) == 4 * 3 * 2
    corners = tables.vertices[tables.triangles[points.triangle]].astype(float)
    nearest = np.linalg.norm(corners - points.position[:, None], axis=2).argmin(axis=1)
    assert np.mean(nearest == points.pixel % 3) > 0.7  # the third of a corner is not all that lies nearest to it
    np.testing.assert_allclose(found.albedo[:2], np.broadcast_to(rooms.WALLS[0], (2, 3, 3)), rtol=1e-6)
    np.testing.assert_allclose(points.ns[points.triangle < 2], np.broadcast_to((1, 0, 0), (12, 3)), atol=1e-6)


@pytest.mark.parametrize("share", [0, 1])
def test_depth_maps_see_through_what_is_not_there(share):
    floor, pane = ([(-9, -9, z), (9, -9, z), (9, 9, z), (-9, 9, z)] for z in (0, 1))
    vertices, triangles = arrays.quads(floor, pane)
    stuff = arrays.materials((0.5, 0.0), (1 - share, 0.0))
    stuff.tables.flags[1] |= sc.TRANSPARENT
    stuff.tables.constant[1, TRANSPARENCY : TRANSPARENCY + 3] = share
    scene = arrays.scene(arrays.geometry(vertices, triangles, [0, 0, 1, 1]), stuff)
    with prepared(Run(None), scene, rooms.SETTINGS, 1) as tables:
        eye, frame = np.array([(0.3, 0.2, 2)], F), np.array([[(1, 0, 0), (0, -1, 0), (0, 0, -1)]], F)
        maps, rays = paraboloid_maps(tables, eye, frame, 32, True, threads=1)
    assert rays > 600
    assert maps[0, 16, 16] == pytest.approx((1, 2)[share], rel=0.01)


def test_direct_light_by_cube_maps_is_that_of_shadow_rays(lit):
    tables, points = lit
    by_maps, _ = direct_by_maps(tables, points, resolution=32, filtering=2, threads=1)
    by_rays, _ = direct_irradiance(tables, points, 4, 1, 1)
    agree = np.isclose(by_maps, by_rays, rtol=0.01, atol=1e-5).all(axis=1)
    assert agree.mean() > 0.8  # a texel of a map is wide at a shadow's edge
    assert by_rays.any()


def test_vpls_by_cube_maps_shine_where_shadow_rays_see_them(lit):
    tables, points = lit
    vpls, _ = trace_particles(tables, 8, 1, 1, 1)
    light = []
    for solver in (ShadowMappedRadiosity(resolution=16, filtering=1, threads=1), InstantRadiosity(compensation=0, threads=1)):
        solver.prepare(tables, vpls, points)
        light.append(solver.irradiance(points))
    by_maps, by_rays = light
    assert by_maps.mean() == pytest.approx(by_rays.mean(), rel=0.15)
    assert np.isclose(by_maps, by_rays, rtol=0.05).mean() > 0.6


def test_contents_of_the_room():
    scene = rooms.room(size=(4, 3))
    held = contents(scene, build_emitters(scene))
    assert (held["triangles"], held["materials"]["count"], held["lamps"]["point"]) == (24, 4, 1)
    np.testing.assert_allclose(held["extent_m"], 2.0, rtol=1e-3)
    np.testing.assert_allclose(held["flux_w"], 4 * np.pi, rtol=1e-5)  # of 1 W/sr everywhere


def test_what_lights_give_to_a_view_is_the_sum_of_their_geometry_terms():
    # In an empty box every light is seen from everywhere.
    walls = arrays.geometry(*arrays.box((-1, -1, -1), (1, 1, 1)))
    scene = arrays.scene(walls, arrays.materials((0.5, 0.0)), lamps=rooms.bulb(), camera=rooms.view(size=(4, 3)))
    g_max = 0.5
    with prepared(Run(None), scene, rooms.SETTINGS, 1) as tables:
        points = view(scene, tables.rays, world_tables(scene.world), 1, 1, 1).points
        vpls, _ = trace_particles(tables, 8, 1, 1, 1)
        found, _ = contributions(tables, vpls, points, g_max, 1, 1)
    d = vpls.position[:, None].astype(float) - points.position[None]
    cosines = np.maximum((d * points.ns).sum(-1), 0) * np.maximum(-(d * vpls.normal[:, None]).sum(-1), 0)
    terms = np.minimum(cosines / np.maximum((d * d).sum(-1) ** 2, 1e-30), g_max).sum(1) * vpls.flux.mean(axis=1)
    np.testing.assert_allclose(found[terms > 1e-9], (terms * (1 + UNSEEN))[terms > 1e-9], rtol=1e-4)
    assert (terms > 1e-9).sum() > 3


def test_fewer_lights_carry_the_light_of_all(lit):
    tables, _ = lit
    vpls, _ = trace_particles(tables, 40, 2, 1, 1)
    importance = np.random.default_rng(1).random(len(vpls.bounce)) ** 4
    kept = [resample(vpls, importance, 12, seed) for seed in range(400)]
    assert max(len(some.bounce) for some in kept) <= 12
    mean = np.mean([some.flux.sum(axis=0, dtype=float) for some in kept], axis=0)
    np.testing.assert_allclose(mean, vpls.flux.sum(axis=0, dtype=float), rtol=0.03)


@pytest.mark.parametrize(
    ("matter", "enough", "batches", "kept"),  # 1.5 for each that is wanted
    [(400, 1, 1, 40), (15, 1, 1, 40), (14, 1, 2, 40), (4, 1, 4, 40), (0, 1, 16, 10), (14, 0.1, 2, 40), (4, 0.4, 2, 40), (1, 0.3, 5, 40), (1, 0.1, 2, 16)],
)  # fmt: skip
def test_particles_are_flown_until_enough_of_their_lights_matter(lit, monkeypatch, matter, enough, batches, kept):
    tables, points = lit
    seeds, asked = [], []

    def particles(scene, count, bounces, seed, threads):
        seeds.append(seed)
        return trace_particles(scene, 8, 1, seed, threads)[0].take(np.zeros(400, int)), 0

    importance = np.zeros(400)
    importance[:matter] = 1
    monkeypatch.setattr(pool, "drop_useless", lambda vpls, *_: vpls)
    monkeypatch.setattr(pool, "contributions", lambda *_: (importance, 0))
    monkeypatch.setattr(pool, "resample", lambda vpls, every, count, seed: asked.append(count) or vpls)
    lights, _ = pool.vpl_pool(tables, points, 10, 1, lambda *_: 1.0, 0, 1, particles=particles, kept=4, enough=enough)
    assert (len(seeds), len(set(seeds)), asked) == (batches, batches, [kept])  # eight for each that matters, at most four for each wanted
    assert len(lights.bounce) == 400 * batches


def test_lights_that_matter():
    assert pool.lights_that_matter(np.ones(7)) == pytest.approx(7)
    assert pool.lights_that_matter(np.array([1.0, 1e-9, 0])) == pytest.approx(1)
    assert pool.lights_that_matter(np.zeros(3)) == 0


def test_vpls_shine_by_the_float64_sum_of_all_pairs():
    walls = arrays.geometry(*arrays.box((-1, -1, -1), (1, 1, 1)))
    scene = arrays.scene(walls, arrays.materials((0.5, 0.0)), lamps=rooms.bulb(), camera=rooms.view(size=(4, 3)))
    with prepared(Run(None), scene, rooms.SETTINGS, 1) as tables:
        points = view(scene, tables.rays, world_tables(scene.world), 1, 1, 1).points
        vpls, _ = trace_particles(tables, 16, 1, 1, 1)
        solver = InstantRadiosity(compensation=0, threads=1)
        solver.prepare(tables, vpls, points)
        found = solver.irradiance(points)
    d = vpls.position[None].astype(float) - points.position[:, None]
    cosines = np.maximum((d * points.ns[:, None]).sum(-1), 0) * np.maximum(-(d * vpls.normal).sum(-1), 0)
    terms = np.minimum(cosines / np.maximum((d * d).sum(-1) ** 2, 1e-30), float(solver.g_max))
    np.testing.assert_allclose(found, terms @ vpls.flux.astype(float) / np.pi, rtol=1e-4, atol=1e-7)
