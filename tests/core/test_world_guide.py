"""Rays to the world that are aimed by what neighbours have found of it."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.jit import kernel
from lumigate.core.lamps import direct_irradiance, direct_light, world_guide
from lumigate.core.lamps.escapes import ESCAPED, VEILED, GatherRays, gather_ray
from lumigate.core.pipeline import render
from lumigate.core.sampling.sequences import sobol
from lumigate.core.settings import RenderSettings

from .test_lamps import RECEIVER, UP, lamp, lit

HALF = 0.25  # of the window's edge
HEIGHT = 1.0


def roof(x=0.6, half=HALF, wide=40.0):
    """Quads of a wide roof with a square window at (x, 0, HEIGHT)."""
    low, high = -half, half
    z = HEIGHT
    return [
        [(-wide, -wide, z), (x + low, -wide, z), (x + low, wide, z), (-wide, wide, z)],
        [(x + high, -wide, z), (wide, -wide, z), (wide, wide, z), (x + high, wide, z)],
        [(x + low, -wide, z), (x + high, -wide, z), (x + high, low, z), (x + low, low, z)],
        [(x + low, high, z), (x + high, high, z), (x + high, wide, z), (x + low, wide, z)],
    ]


def window(x=0.6, half=HALF, wide=40.0):
    """A floor under a `roof` with a window, through which it sees an even sky."""
    return lit(world=1.0, quad=(RECEIVER, *roof(x, half, wide)))


def points_around(n, radius=0.02, seed=0):
    """n points of the floor close to the origin."""
    position = np.zeros((n, 3), np.float32)
    position[:, :2] = np.random.default_rng(seed).uniform(-radius, radius, (n, 2))
    up = np.tile(np.float32(UP), (n, 1))
    return SimpleNamespace(position=position, ns=up, ng=up, error=np.full(n, 1e-6, np.float32))


def form_factor(x=0.6, half=HALF):
    """Share of the floor's irradiance at the origin that comes through the window."""
    u, v = np.meshgrid(*(np.linspace(-half, half, 401)[:-1] + half / 400,) * 2)
    r2 = (u + x) ** 2 + v**2 + HEIGHT**2
    return float((HEIGHT**2 / (math.pi * r2**2)).mean() * (2 * half) ** 2)


def unguided(light, points, samples, seed):
    """What the same rays find at points that have no neighbours to ask."""
    parts = []
    for k in range(len(points.position)):
        one = SimpleNamespace(**{name: value[k : k + 1] for name, value in vars(points).items()})
        parts.append(direct_irradiance(light.tables, one, samples, seed + k)[0])
    return np.concatenate(parts)


def assert_right_in_the_mean(found, rel, half=HALF):
    """Irradiances (N, 3) agree with the window's form factor within four standard errors, each below `rel` of it."""
    values, expected = found[:, 0].astype(np.float64), math.pi * form_factor(half=half)
    error = values.std() / math.sqrt(len(values))
    assert abs(values.mean() - expected) < 4 * error
    assert error < rel * expected


def test_the_sky_through_a_window_is_right_in_the_mean_and_less_noisy():
    light, points = window(), points_around(4096)
    found, _ = direct_irradiance(light.tables, points, 8, 1)
    assert_right_in_the_mean(found, 0.01)
    assert found[:, 0].std() < 0.5 * unguided(light, points_around(1024), 8, 5)[:, 0].std()


def test_two_samples_are_right_in_the_mean():
    """One of them is aimed: its share must not depend on what the other has found."""
    light = window()
    assert_right_in_the_mean(
        np.concatenate([direct_irradiance(light.tables, points_around(4096, seed=s), 2, s)[0] for s in range(8)]), 0.01
    )


def test_few_neighbours_are_right_in_the_mean():
    """Points of a row of three, whose own rays are a good part of what is known: what they find is all but uncorrelated."""
    light = window()
    assert_right_in_the_mean(
        np.concatenate([direct_irradiance(light.tables, points_around(3, seed=s), 4, s)[0] for s in range(6000)]), 0.02
    )


@pytest.mark.parametrize(("rays", "limit"), [(0, 10), (8, 5)])  # measured: 8.4 and 3.6; by neighbours alone 12.1 and 6.6
def test_a_small_window_that_few_have_found_is_known_from_all_that_went_before(rays, limit):
    """Of neighbours alone, whose few rays find it or not, whole rows of points saw the sky and others did not: bands in a picture."""
    light, half = window(half=0.03, wide=4000.0), 0.03
    found = []
    for seed in range(8):
        points = points_around(4096, seed=seed)
        gathered = through_window(points, rays, seed, half=half, wide=4000.0) if rays else None
        found.append(direct_light(light.tables, points, 8, seed, lobes=False, gathered=gathered)[0].irradiance)
    found = np.concatenate(found)
    assert_right_in_the_mean(found, 0.1, half)
    assert found[:, 0].std() < limit * found[:, 0].mean()


@kernel
def _directions(seed, first, out):
    for k in range(out.shape[0]):
        for s in range(out.shape[1]):
            out[k, s, 0], out[k, s, 1], out[k, s, 2], _ = gather_ray(seed, k, first + s, np.float32(0), np.float32(0), np.float32(1))


def through_window(points, rays, seed, x=0.6, veiled=False, half=HALF, wide=40.0):
    """Gather rays of points on the floor below the `window`; `veiled` ones have only met something that may let light through."""
    n = len(points.position)
    d = np.empty((n, rays, 3), np.float32)
    _directions(np.uint32(seed), 7, d)
    at = points.position[:, None, :2] + d[..., :2] * (HEIGHT / d[..., 2:])
    open_ = (np.abs(at - (x, 0)) < half).all(axis=2) | (np.abs(at) > wide).any(axis=2)
    met = np.where(veiled, VEILED, np.where(open_, ESCAPED, 0)).astype(np.uint8) * np.ones((n, rays), np.uint8)
    return GatherRays(np.full(n, rays, np.int32), met, np.arange(n, dtype=np.int32), seed, 7)


def with_gathered(light, points, samples, seed, gathered):
    return direct_light(light.tables, points, samples, seed, lobes=False, gathered=gathered)[0].irradiance


def test_gather_rays_count_for_the_sky_and_tell_where_it_is():
    light, points = window(), points_around(4096)
    found = with_gathered(light, points, 4, 1, through_window(points, 8, 5))
    assert_right_in_the_mean(found, 0.01)
    alone, _ = direct_irradiance(light.tables, points, 4, 1)
    assert found[:, 0].std() < 0.7 * alone[:, 0].std()


def test_few_points_with_gather_rays_are_right_in_the_mean():
    """Their own rays are a good part of what is known, and must have no say in their own densities."""
    light = window()
    parts = []
    for s in range(6000):
        points = points_around(3, seed=s)
        parts.append(with_gathered(light, points, 2, s, through_window(points, 4, s)))
    assert_right_in_the_mean(np.concatenate(parts), 0.02)


def test_gather_rays_that_met_a_veil_are_traced_to_their_end():
    light, points = window(), points_around(1024)
    plain, veiled = (with_gathered(light, points, 4, 1, through_window(points, 8, 5, veiled=veiled)) for veiled in (False, True))
    assert np.isclose(plain, veiled, rtol=1e-4).mean() > 0.99  # but for rays along an edge


def test_gather_rays_beside_samples_by_chance():
    """One sample goes to the sun or to the world; what gather rays find of the world is there in any case."""
    light = lit(lamp(sc.SUN, 1.0, towards=(0, 0, -1), angle=0.0), world=1.0)
    points = points_around(4096)
    n = len(points.position)
    gathered = GatherRays(np.full(n, 2, np.int32), np.full((n, 2), ESCAPED, np.uint8), np.arange(n, dtype=np.int32), 3, 0)
    found = with_gathered(light, points, 1, 1, gathered)[:, 0].astype(float)
    assert abs(found.mean() - (1 + math.pi)) < 4 * found.std() / math.sqrt(n)


def test_an_open_world_has_no_noise_with_gather_rays():
    light, points = lit(world=0.7), points_around(500)
    gathered = GatherRays(np.full(500, 5, np.int32), np.full((500, 5), ESCAPED, np.uint8), np.arange(500, dtype=np.int32), 3, 0)
    assert np.allclose(with_gathered(light, points, 8, 1, gathered), 0.7 * math.pi, rtol=1e-3)


@pytest.mark.parametrize("sky", ["even", "uneven", "beside a sun"])
@pytest.mark.parametrize("kind", [sc.DIFFUSE, sc.SHADOW], ids=["no shadow", "shadow only"])
def test_a_roof_that_gather_rays_and_shadow_rays_see_differently(build, kind, sky):
    """As Cycles, which finds an even sky by scattered rays alone, and an uneven one by both, each with its share (power heuristic)."""
    floor = [(-9, -9, -1), (9, -9, -1), (9, 9, -1), (-9, 9, -1)]
    roof = [(-9000, -9000, 1), (9000, -9000, 1), (9000, 9000, 1), (-9000, 9000, 1)]
    g = build.geometry(*build.quads(floor, roof), np.repeat([0, 1], 2))
    g.object[2:] = 1
    g.object_names, g.object_visibility = ["floor", "roof"], np.array([sc.ALL_RAYS, kind], np.uint8)
    world = (1, 1, 1) if sky == "even" else np.where(np.arange(16) % 2, 0.99, 1.01)[None, :, None] * np.ones((8, 16, 3))
    scene = build.scene(g, build.materials((0.5, 0.0), (0.0, 0.0)), world=world, camera=build.camera())
    if sky == "beside a sun":
        scene.world.sought = 0.2
    direct = render(scene, RenderSettings(pixel_samples=1, direct_samples=64, denoise=False)).layers["Direct"]
    # Densities s / (4 pi) and cos / pi: the integral of 2 c / (1 + (4 c / s)^2) over cosines c.
    by_shadow_rays = {"even": 0.0, "uneven": math.log(17) / 16, "beside a sun": math.log(401) / 400}[sky]
    assert direct.mean() == pytest.approx(0.5 * (by_shadow_rays if kind == sc.DIFFUSE else 1 - by_shadow_rays), abs=0.003)


def test_rays_leave_from_all_places_of_a_point():
    """Half of a point's places lie in the shadow of a wide roof's edge: its own is lit."""
    light = lit(lamp(sc.SUN, 1.0, towards=(0, 0, -1), angle=0.0), quad=(RECEIVER, [(0, -9, 1), (9, -9, 1), (9, 9, 1), (0, 9, 1)]))
    points = points_around(64, radius=0.0)
    points.position[:, 0] = -0.1
    assert np.allclose(direct_irradiance(light.tables, points, 4, 1)[0], 1, rtol=1e-4)
    points.spread = np.zeros((64, 3, 3), np.float32)
    points.spread[:, :2, 0] = 0.2
    assert np.allclose(direct_irradiance(light.tables, points, 4, 1)[0], 0.5, rtol=1e-4)


def test_an_open_world_has_no_more_noise_than_before():
    light = lit(world=0.7)
    found, _ = direct_irradiance(light.tables, points_around(500), 8, 1)
    assert np.allclose(found, 0.7 * math.pi, rtol=1e-4)


def test_cells_cover_the_sphere_evenly():
    u = np.array([[sobol(i, d, 7) for d in range(2)] for i in range(64)], np.float32)
    directions = np.array([world_guide.in_cell(np.int64(c), a, b) for c in range(world_guide.CELLS) for a, b in u])
    assert np.allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-5)
    cells = np.array([world_guide.cell_of(*np.float32(d)) for d in directions])
    assert (cells == np.repeat(np.arange(world_guide.CELLS), len(u))).mean() > 0.99  # rounding at their edges
    assert np.allclose(directions.mean(axis=0), 0, atol=0.01)
    assert np.allclose((directions[:, :, None] * directions[:, None]).mean(axis=0), np.eye(3) / 3, atol=0.01)
