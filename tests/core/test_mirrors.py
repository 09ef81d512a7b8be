"""What mirrors show: shading points of their own, as what lies behind glass has."""

from itertools import pairwise

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.surfaces.layout import GLOSSY_F0, GLOSSY_F90, ROUGHNESS
from lumigate.core.view.mirrors import with_mirrors
from lumigate.core.view.primary import MOST_MIRRORED
from lumigate.headless.stress.arrays import camera, geometry, glossy_materials, quads, scene

from .test_view import seen, shown, spheres, wall

SHINE = 0.8


def before_a_mirror(roughness=0.0, albedo=0.0, mirror=(0.0, 0.0), **rest):
    """A camera that looks at a mirror 2 m before it, in which it sees a shining wall 3 m behind it."""
    stuff = glossy_materials((0.5, 0.25), (albedo, 0.0), albedo=SHINE, roughness=roughness)
    stuff.tables.flags[0] &= ~sc.GLOSSY_LOBE
    stuff.tables.constant[0, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[0, GLOSSY_F90 : GLOSSY_F90 + 3] = 0
    g = geometry(*quads(wall(3), wall(-2)), np.repeat([0, 1], 2))
    g.object[2:] = 1
    g.object_names, g.object_visibility = ["wall", "mirror"], np.full(2, sc.ALL_RAYS, np.uint8)
    return scene(g, stuff, camera=camera(), **rest)


def test_a_mirror_shows_points_of_its_own():
    picture = seen(before_a_mirror())
    points = picture.points
    assert points.behind_glass.all() and len(points.pixel) == 16 * 16
    np.testing.assert_allclose(points.position[:, 2], 3, rtol=1e-5)
    np.testing.assert_allclose(points.ns, np.broadcast_to((0, 0, -1), points.ns.shape), atol=1e-5)
    assert (points.wo[:, 2] < 0).all()  # they are seen from the mirror
    np.testing.assert_allclose(shown(picture, points.albedo), 0.5 * SHINE, rtol=0.02)
    np.testing.assert_allclose(picture.emission_behind_one, 0.25 * SHINE, rtol=0.02)
    assert not picture.emission.any() and not picture.emission_behind_more.any() and not points.f0.any()
    np.testing.assert_allclose(picture.depth, 2, rtol=1e-5)


def test_the_point_of_a_pixel_lies_where_the_mirror_shows_it():
    points = seen(before_a_mirror()).points
    # Mirrored at z = -2 the wall lies 7 m away: the middle of the pixel, with what its samples spread.
    middle = (points.pixel % 16 + 0.5) / 8 - 1
    assert np.abs(points.position[:, 0] / 7 - middle).max() < 1 / 16 + 1e-4


def test_a_mirror_with_a_colour_of_its_own_has_both():
    picture = seen(before_a_mirror(albedo=0.1))
    own = picture.points.behind_glass == 0
    np.testing.assert_allclose(shown(picture, picture.points.albedo * own[:, None]), 0.1, rtol=1e-4)
    np.testing.assert_allclose(shown(picture, picture.points.albedo * ~own[:, None]), 0.5 * SHINE, rtol=0.02)
    assert not picture.points.f0.any()


def test_what_shines_in_a_less_than_perfect_mirror_is_left_to_its_lobe():
    # Shadow rays and rays from the lobe share the lamps; only the surfaces are found by the view.
    picture = seen(before_a_mirror(roughness=0.06), 64)
    mirror = picture.points.shown > 0
    np.testing.assert_allclose(shown(picture, picture.points.f0 * mirror[:, None]), SHINE, rtol=0.02)
    assert shown(picture, picture.points.albedo).mean() == pytest.approx(0.5 * SHINE, rel=0.02)
    assert not picture.emission_behind_one.any()


def test_of_many_surfaces_in_a_mirror_a_few_are_drawn_by_their_light():
    # Strips of three colours, each as bright as its albedo and an object of its own: about twelve of them lie in a pixel.
    n, edges = 800, np.linspace(-30, 30, 801)
    strips = [[(a, -50, 3), (b, -50, 3), (b, 50, 3), (a, 50, 3)] for a, b in pairwise(edges)]
    colours = np.float32([(0.1, 0.1, 0.1), (0.9, 0.2, 0.1), (0.1, 0.3, 0.8)])
    stuff = glossy_materials(*((c, c) for c in colours), (0.0, 0.0), albedo=SHINE, roughness=0.0)
    stuff.tables.flags[:3] &= ~sc.GLOSSY_LOBE
    stuff.tables.constant[:3, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[:3, GLOSSY_F90 : GLOSSY_F90 + 3] = 0
    g = geometry(*quads(*strips, wall(-2)), np.repeat([*np.arange(n) % 3, 3], 2))
    g.object[:] = np.repeat(np.arange(n + 1), 2)
    g.object_names, g.object_visibility = [f"strip {i}" for i in range(n)] + ["mirror"], np.full(n + 1, sc.ALL_RAYS, np.uint8)
    found, whole = np.zeros(3), np.zeros(3)
    for seed in range(8):
        picture = seen(scene(g, stuff, camera=camera()), 32, seed)
        counts = np.bincount(picture.points.pixel)
        assert counts.max() == MOST_MIRRORED and counts.mean() > MOST_MIRRORED - 1
        points = np.stack([shown(picture, picture.points.albedo, c) for c in range(3)], axis=1)
        every = picture.emission_behind_one.reshape(-1, 3)
        np.testing.assert_allclose(points.sum(axis=1), every.sum(axis=1), rtol=1e-4)  # of each pixel all that they send together
        found, whole = found + points.mean(axis=0), whole + every.mean(axis=0)
    np.testing.assert_allclose(found, whole, rtol=0.02)  # and each colour in the mean


@pytest.mark.parametrize(("roughness", "albedo"), [(0.3, 0.0), (0.0, 3.0)], ids=["rough", "faint"])
def test_other_lobes_are_not_looked_into(roughness, albedo):
    picture = seen(before_a_mirror(roughness=roughness, albedo=albedo))
    assert not picture.points.behind_glass.any() and not picture.points.shown.any()
    np.testing.assert_allclose(shown(picture, picture.points.f0), SHINE, rtol=1e-4)


@pytest.mark.parametrize("kind", [sc.CAMERA, sc.GLOSSY], ids=["camera", "glossy"])
def test_who_may_be_seen_in_a_mirror(kind):
    met = kind == sc.GLOSSY
    s = before_a_mirror()
    s.geometry.object_visibility[0] = kind
    assert bool(seen(s).points.behind_glass.any()) == met
    s.geometry.object_visibility[0] = 0
    s.lamps = spheres(((0, 0, 4), 1.0, 3.0, kind))
    assert seen(s).emission_behind_one.any() == met
    s.lamps = sc.Lamps.empty()
    s.world = sc.World(np.ones((1, 1, 3), np.float32), kind)
    assert seen(s).emission_behind_one.any() == met


def test_mirrors_are_the_same_for_any_number_of_threads():
    s = before_a_mirror(roughness=0.03)
    one, two = seen(s, 8, threads=1), seen(s, 8, threads=2)
    for a, b in zip(one.points, two.points):
        np.testing.assert_array_equal(a, b)


def test_two_mirrors_end():
    # Face to face they would go on for ever.
    s = before_a_mirror()
    s.materials.tables.constant[0] = s.materials.tables.constant[1]
    s.materials.tables.flags[0] = s.materials.tables.flags[1]
    picture = seen(s)
    np.testing.assert_allclose(shown(picture, picture.points.f0), SHINE**3, rtol=0.05)  # the third keeps its lobe


def test_only_polished_materials_are_asked():
    s = before_a_mirror(roughness=0.3)
    tables = s.materials.tables
    assert not (with_mirrors(tables, s.geometry).flags & sc.MIRRORING).any()
    tables.constant[1, ROUGHNESS] = 0.05
    assert (with_mirrors(tables, s.geometry).flags & sc.MIRRORING > 0).tolist() == [False, True]
    tables.flags[1] |= sc.TRANSPARENT  # glass has its own way
    assert not (with_mirrors(tables, s.geometry).flags & sc.MIRRORING).any()
