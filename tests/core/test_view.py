"""What the camera sees: the surface points that stand for a pixel, and the lamps in front of them."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.lamps import world_tables
from lumigate.core.picture import denoising_guides
from lumigate.core.rays import RayScene
from lumigate.core.surfaces.layout import EMISSION, GLOSSY_F0, GLOSSY_F90, REFRACTION, TRANSPARENCY
from lumigate.core.view.primary import view
from lumigate.headless.stress.arrays import camera, geometry, materials, quads, scene


def seen(s, samples=16, seed=1, threads=0):
    """The view of a scene."""
    g = s.geometry
    transparent = (s.materials.tables.flags[g.material] & sc.TRANSPARENT) != 0
    with RayScene(g.vertices, g.triangles, g.object_visibility[g.object], transparent) as rays:
        return view(s, rays.tables, world_tables(s.world), samples, seed, threads)


def test_a_surface_is_lit_wherever_its_pixel_shows_it():
    # Light that is steep within a pixel, such as a lamp's nearest spot, is right in the mean only if the points lie in
    # the pixel as its surface does: a point near the middle would always see the same light.
    floor = quads([(-9, -9, -1), (9, -9, -1), (9, 9, -1), (-9, 9, -1)])
    points = seen(scene(geometry(*floor), materials((0.5, 0.0)), camera=camera(width=48, height=48))).points
    assert len(points.pixel) == 48 * 48
    within = (points.position[:, 0] + 1) * 24 % 1  # across the pixel: one is 1/24 m wide
    assert within.mean() == pytest.approx(1 / 2, abs=0.02)
    assert within.var() == pytest.approx(1 / 12, rel=0.06)


def spheres(*rows):
    """Point lamps of (position, radius, intensity, visibility)."""
    empty, n = sc.Lamps.empty(), len(rows)
    columns = dict(
        kind=[sc.POINT] * n, position=[r[0] for r in rows], axes=[np.eye(3)] * n, emission=[(r[2],) * 3 for r in rows],
        radius=[r[1] for r in rows], soft_falloff=[0] * n, angle=[np.pi] * n, blend=[0] * n, size=[(0, 0)] * n, shape=[0] * n,
        visibility=[r[3] for r in rows], cast_shadow=[1] * n,
    )  # fmt: skip
    return sc.Lamps(
        **{k: np.array(v, getattr(empty, k).dtype) for k, v in columns.items()}, names=[f"lamp {i}" for i in range(n)], groups=[""] * n
    )


def wall(z):
    return [(-50, -50, z), (50, -50, z), (50, 50, z), (-50, 50, z)]


def veiled(share):
    """Materials: a wall of albedo .5, and one that lets `share` through and reflects half of the rest."""
    stuff = materials((0.5, 0.0), (0.5 * (1 - share), 0.0))
    stuff.tables.flags[1] |= sc.TRANSPARENT
    stuff.tables.constant[1, TRANSPARENCY : TRANSPARENCY + 3] = share
    return stuff


def test_a_lamp_in_view_adds_its_radiance_and_hides_nothing():
    # Radius 1 at distance 4 in a square view of 90 degrees: a disk of tangent 1 / sqrt(15), radiance I / (pi r^2).
    lamps = spheres(((0, 0, -4), 1.0, 3.0, sc.ALL_RAYS))
    s = scene(geometry(*quads(wall(-9))), materials((0.5, 0.0)), lamps=lamps, camera=camera(width=32, height=32))
    picture = seen(s, 64)
    share = np.pi / 15 / 4
    assert picture.emission.mean() == pytest.approx(share * 3.0 / np.pi, rel=0.005)
    assert picture.emission[16, 16] == pytest.approx(3.0 / np.pi, rel=1e-5)
    assert picture.emission[0].max() == 0
    assert picture.albedo.min() == pytest.approx(0.5)
    assert picture.depth.min() == pytest.approx(9)


@pytest.mark.parametrize(
    "row",
    [((0, 0, -12), 1.0, 3.0, sc.ALL_RAYS), ((0, 0, 4), 1.0, 3.0, sc.ALL_RAYS), ((0, 0, -4), 1.0, 3.0, sc.ALL_RAYS & ~sc.CAMERA), ((0, 0, -4), 0.0, 3.0, sc.ALL_RAYS)],
    ids=["behind a wall", "behind the camera", "invisible", "of no size"],
)  # fmt: skip
def test_a_lamp_out_of_view_is_not_seen(row):
    s = scene(geometry(*quads(wall(-9))), materials((0.5, 0.0)), lamps=spheres(row))
    assert not seen(s).emission.any()


def test_a_lamp_that_lights_nothing_is_seen_all_the_same():
    s = scene(geometry(*quads(wall(-9))), materials((0.5, 0.0)), lamps=spheres(((0, 0, -4), 1.0, 3.0, sc.CAMERA)))
    assert seen(s).emission.max() == pytest.approx(3.0 / np.pi, rel=1e-5)


def test_a_veil_dims_what_lies_behind_and_keeps_its_own_share():
    vertices, triangles = quads(wall(-9), wall(-3))
    behind, before = ((1, 0, -6), 2.5, 3.0, sc.ALL_RAYS), ((-1, 0, -2), 0.5, 3.0, sc.ALL_RAYS)
    g = geometry(vertices, triangles, np.repeat([0, 1], 2))
    s = scene(g, veiled(0.6), lamps=spheres(behind), camera=camera(width=32, height=32))
    through = seen(s, 64)
    free = seen(replace(s, geometry=geometry(*quads(wall(-9)))), 64)
    assert through.emission.mean() == pytest.approx(0.6 * free.emission.mean(), rel=0.02)
    assert through.albedo.mean() == pytest.approx(0.5, rel=0.002)
    s = replace(s, lamps=spheres(before))
    # Which pixels get more samples is told by the veil, too, whose own are shown at random.
    unveiled = seen(replace(s, geometry=geometry(*quads(wall(-9)))), 64)
    assert seen(s, 64).emission.mean() == pytest.approx(unveiled.emission.mean(), rel=0.002)
    np.testing.assert_allclose(seen(s, 64).emission, unveiled.emission, atol=0.07)


def test_the_first_veil_is_free_of_noise():
    vertices, triangles = quads(wall(-9), wall(-3))
    stuff = veiled(0.1)
    stuff.tables.constant[0, EMISSION : EMISSION + 3] = 1
    picture = seen(scene(geometry(vertices, triangles, np.repeat([0, 1], 2)), stuff), 4)
    np.testing.assert_allclose(picture.emission, 0.1, rtol=1e-5)
    np.testing.assert_allclose(picture.albedo, 0.1 * 0.5 + 0.45, rtol=1e-5)
    np.testing.assert_allclose(shown(picture, picture.points.albedo), 0.5, rtol=1e-5)


def test_further_veils_are_passed_by_even_shares_of_the_samples():
    # Of a pixel's 16 samples, 4 pass the second veil and 1 the third as well, to within one; by chance .43 of the mean would be lost or won.
    vertices, triangles = quads(wall(-9), wall(-3), wall(-4), wall(-5))
    stuff = veiled(0.25)
    stuff.tables.constant[0, EMISSION : EMISSION + 3] = 1
    s = scene(geometry(vertices, triangles, np.repeat([0, 1, 1], (2, 4, 2))), stuff, camera=camera(width=64, height=64))
    s.geometry.material[6:] = 0  # two veils before a wall
    two = seen(s, 32).emission[..., 0]
    assert two.mean() == pytest.approx(0.25**2, rel=0.01)
    assert two.std() < 0.15 * two.mean()
    s.geometry.material[6:] = 1
    three = seen(s, 32).emission[..., 0]
    assert three.mean() == pytest.approx(0.25**3, rel=0.03)
    assert three.std() < 0.6 * three.mean()


def test_glass_behind_a_veil_and_more_veils_behind_glass_are_right_in_the_mean():
    vertices, triangles = quads(wall(-9), wall(-2), wall(-3), wall(-4), wall(-5), wall(-6))
    stuff = materials((0.5, 1.0), (0.25, 0.0), (0.0, 0.0))
    for m, (at, share) in enumerate(((TRANSPARENCY, 0.5), (REFRACTION, 0.8)), 1):
        stuff.tables.flags[m] |= sc.TRANSPARENT
        stuff.tables.constant[m, TRANSPARENCY : TRANSPARENCY + 3] = stuff.tables.constant[m, at : at + 3] = share
    stuff.tables.constant[2, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[2, GLOSSY_F90 : GLOSSY_F90 + 3] = 0.2
    picture = seen(scene(geometry(vertices, triangles, np.repeat([0, 1, 2, 2, 1, 2], 2)), stuff), 64)
    assert picture.emission_behind_more.mean() == pytest.approx(0.5**2 * 0.8**3, rel=0.02)
    reflected = 0.5 * (0.2 + 0.8 * 0.2) + 0.5**2 * 0.8**2 * 0.2
    assert shown(picture, picture.points.f0).mean() == pytest.approx(reflected, rel=0.02)
    assert picture.albedo.mean() == pytest.approx(0.25, rel=0.01)


@pytest.mark.parametrize("orthographic", [False, True])
def test_lamps_are_found_from_every_tile(orthographic):
    # Tiles look only at lamps near them; the oracle looks at all of them on a fine grid of rays.
    rng = np.random.default_rng(5)
    radii = rng.uniform(0.02, 0.9, 40)
    rows = [((*rng.uniform(-6, 6, 2), -rng.uniform(1, 8)), r, r * r, sc.ALL_RAYS) for r in radii]
    width, height, fine = 37, 29, 8
    eye = camera(width=width, height=height, angle=1.4)
    eye = replace(eye, orthographic=True, window=(-6, 6, -5, 5)) if orthographic else eye
    picture = seen(scene(geometry(*quads(wall(-9))), materials((0.5, 0.0)), lamps=spheres(*rows), camera=eye), 64)
    left, right, bottom, top = eye.window
    x = left + (right - left) * (np.arange(width * fine) + 0.5) / (width * fine)
    y = top + (bottom - top) * (np.arange(height * fine) + 0.5) / (height * fine)
    ray = np.stack([*np.meshgrid(x, y), np.full((height * fine, width * fine), -1.0)], -1)
    expected = np.zeros(ray.shape[:2])
    for position, radius, intensity, _ in rows:
        if orthographic:
            aside = ((ray[..., :2] - position[:2]) ** 2).sum(-1)
        else:
            aside = (np.cross(ray, position) ** 2).sum(-1) / (ray**2).sum(-1)
        expected += (aside < radius**2) * intensity / (np.pi * radius**2)
    expected = expected.reshape(height, fine, width, fine).mean((1, 3))
    assert np.abs(picture.emission[..., 0] - expected).mean() < 0.03 * expected.mean()
    assert picture.emission.mean() == pytest.approx(expected.mean(), rel=0.005)


def test_tinted_glass_is_free_of_noise():
    # A pane that keeps nothing that could be seen lets every ray pass: each pixel has exactly its tint.
    vertices, triangles = quads(wall(-9), wall(-3))
    stuff = materials((0.5, 1.0), (0.0, 0.0))
    stuff.tables.flags[1] |= sc.TRANSPARENT
    stuff.tables.constant[1, TRANSPARENCY : TRANSPARENCY + 3] = (0.2, 0.4, 0.6)
    picture = seen(scene(geometry(vertices, triangles, np.repeat([0, 1], 2)), stuff), 4)
    np.testing.assert_allclose(picture.emission, np.broadcast_to((0.2, 0.4, 0.6), picture.emission.shape), rtol=1e-5)
    np.testing.assert_allclose(picture.albedo, 0.5 * picture.emission, rtol=1e-5)


def glazed(depths, reflects=0.0, color=(0.5, 1.0, 0.8), visibility=sc.ALL_RAYS, **rest):
    """A shining wall of albedo .5 at z = -9, and panes of glass before it that let `color` (1 - reflects) through."""
    vertices, triangles = quads(wall(-9), *map(wall, depths))
    stuff = materials((0.5, 1.0), (0.0, 0.0))
    stuff.tables.flags[1] |= sc.TRANSPARENT
    constant = stuff.tables.constant[1]
    constant[TRANSPARENCY : TRANSPARENCY + 3] = constant[REFRACTION : REFRACTION + 3] = np.array(color) * (1 - reflects)
    constant[GLOSSY_F0 : GLOSSY_F0 + 3] = constant[GLOSSY_F90 : GLOSSY_F90 + 3] = reflects
    g = geometry(vertices, triangles, np.repeat([0] + [1] * len(depths), 2))
    g.object[2:] = 1
    g.object_names, g.object_visibility = ["wall", "panes"], np.array([visibility, sc.ALL_RAYS], np.uint8)
    return scene(g, stuff, **rest)


def shown(picture, values, channel=0):
    """Sum over each pixel's points of one channel."""
    return np.bincount(picture.points.pixel, values[:, channel], picture.albedo[..., 0].size)


def test_what_glass_shows_is_apart_from_the_pane():
    picture = seen(glazed([-3]), 4)
    assert picture.points.behind_glass.all()
    np.testing.assert_allclose(shown(picture, picture.points.albedo), 0.25, rtol=1e-5)
    np.testing.assert_allclose(picture.emission_behind_one, np.broadcast_to((0.5, 1.0, 0.8), picture.emission.shape), rtol=1e-5)
    for layer in (picture.albedo, picture.emission, picture.emission_behind_more):
        assert not layer.any()
    np.testing.assert_allclose(picture.depth, 3, rtol=1e-5)
    np.testing.assert_allclose(picture.position[..., 2], -3, rtol=1e-5)


def test_a_pane_shows_what_it_reflects_beside_what_lies_behind():
    # Two surfaces, of which every sample shows all three: no noise.  Only the light of the first is the pane's own.
    picture = seen(glazed([-3, -4], reflects=0.1), 4)
    first = picture.points.behind_glass == 0
    np.testing.assert_allclose(shown(picture, picture.points.f0 * first[:, None]), 0.1, rtol=1e-5)
    np.testing.assert_allclose(shown(picture, picture.points.f0 * ~first[:, None]), 0.45 * 0.1, rtol=1e-5)
    np.testing.assert_allclose(shown(picture, picture.points.albedo), 0.5 * 0.45**2, rtol=1e-5)
    np.testing.assert_allclose(picture.emission_behind_more[..., 0], 0.45**2, rtol=1e-5)
    assert not picture.emission_behind_one.any()


def test_many_panes_are_right_in_the_mean():
    picture = seen(glazed([-2, -3, -4, -5, -6], reflects=0.2, color=(1, 1, 1)), 64)
    assert picture.emission_behind_more.mean() == pytest.approx(0.8**5, rel=0.01)
    assert shown(picture, picture.points.f0).mean() == pytest.approx(1 - 0.8**5, rel=0.01)


def test_a_veil_before_glass_stays_a_veil():
    # Mixed half and half with glass: what passes straight is booked as without it.
    s = glazed([-3], color=(0.8, 0.8, 0.8))
    s.materials.tables.constant[1, REFRACTION : REFRACTION + 3] = 0.4
    picture = seen(s, 64)
    for layer in (picture.emission, picture.emission_behind_one):
        assert layer.mean() == pytest.approx(0.4, rel=0.02)
    assert picture.albedo.mean() == pytest.approx(0.2, rel=0.02)


@pytest.mark.parametrize("kind", [sc.CAMERA, sc.TRANSMISSION], ids=["camera", "transmission"])
@pytest.mark.parametrize("panes", [[], [-3]], ids=["free", "through glass"])
def test_who_may_see_surfaces_lamps_and_world(panes, kind):
    met = (kind == sc.TRANSMISSION) == bool(panes)
    layer = "emission_behind_one" if panes else "emission"
    assert getattr(seen(glazed(panes, visibility=kind)), layer).any() == met
    lamp = spheres(((0, 0, -6), 1.0, 3.0, kind))
    assert getattr(seen(glazed(panes, visibility=0, lamps=lamp)), layer).any() == met
    nothing = glazed(panes, visibility=0)
    assert getattr(seen(replace(nothing, world=sc.World(np.ones((1, 1, 3), np.float32), kind))), layer).any() == met


def test_the_camera_sees_a_world_of_its_own():
    world = sc.World(np.full((1, 1, 3), 2, np.float32), seen=np.full((1, 1, 3), 5, np.float32))
    for panes, layer, light in (([], "emission", 5), ([-3], "emission_behind_one", 2)):
        picture = getattr(seen(replace(glazed(panes, visibility=0), world=world)), layer)
        assert picture.max() == pytest.approx(light, rel=1e-3)


def test_glass_is_the_same_for_any_number_of_threads():
    s = glazed([-2, -3, -4, -5], reflects=0.2, camera=camera(width=96, height=64))
    one, two = seen(s, 4, threads=1), seen(s, 4, threads=2)
    for a, b in zip(one.points, two.points):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(one.emission_behind_more, two.emission_behind_more)


def test_the_denoiser_is_told_what_glass_shows():
    free, behind = (seen(glazed(panes), 4) for panes in ([], [-3]))
    albedo, normal = denoising_guides(behind)
    np.testing.assert_allclose(albedo, free.albedo * behind.emission_behind_one, rtol=1e-5)
    np.testing.assert_allclose(normal, free.normal, atol=1e-5)
    assert denoising_guides(free)[0] is free.albedo
    assert denoising_guides(free)[1] is free.mean_normal


def test_edges_and_thin_things_get_more_samples_and_keep_their_share():
    # A pole of a fortieth of a pixel before a wall: half of the pixels' samples miss it, and it must not fade for that.
    pole = [(-0.001, -9, -2), (0.001, -9, -2), (0.001, 9, -2), (-0.001, 9, -2)]
    s = scene(geometry(*quads(wall(-9), pole), np.repeat([0, 1], 2)), materials((0.5, 0.0), (0.0, 1.0)), camera=camera(width=50, height=50))
    pictures = [seen(s, 16, seed) for seed in range(40)]
    share = 0.002 / 4  # of the view, 4 m wide at the pole
    assert np.mean([p.emission.mean() for p in pictures]) == pytest.approx(share, rel=0.1)
    rays = [p.rays / (50 * 50) for p in pictures]
    assert 8 < np.mean(rays) < 12 and seen(replace(s, geometry=geometry(*quads(wall(-9)))), 16).rays == 8 * 50 * 50


def test_a_border_shows_the_very_pixels_of_the_whole_picture():
    pole = [(-0.7, -9, -2), (0.1, -9, -2), (0.6, 9, -2), (-0.1, 9, -2)]
    s = scene(geometry(*quads(wall(-9), pole), np.repeat([0, 1], 2)), materials((0.5, 0.0), (0.2, 1.0)), camera=camera(width=46, height=38))
    whole, part = seen(s), seen(replace(s, camera=replace(s.camera, border=(5, 7, 30, 29))))
    np.testing.assert_array_equal(part.albedo, whole.albedo[7:29, 5:30])
    np.testing.assert_array_equal(part.emission, whole.emission[7:29, 5:30])
