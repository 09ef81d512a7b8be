"""What mirrors show: shading points of their own, as what lies behind glass has."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.view.mirrors import with_mirrors
from lumigate.headless.stress.arrays import camera, geometry, glossy_materials, quads, scene

from .test_view import seen, shown, spheres, wall

SHINE = 0.8


def before_a_mirror(roughness=0.0, albedo=0.0, mirror=(0.0, 0.0), **rest):
    """A camera that looks at a mirror 2 m before it, in which it sees a shining wall 3 m behind it."""
    stuff = glossy_materials((0.5, 0.25), (albedo, 0.0), albedo=SHINE, roughness=roughness)
    stuff.tables.flags[0] &= ~sc.GLOSSY_LOBE
    stuff.tables.constant[0] = np.where(np.arange(stuff.tables.constant.shape[1]) < 16, stuff.tables.constant[0], 0)
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
    tables.constant[1, 22] = 0.05
    assert (with_mirrors(tables, s.geometry).flags & sc.MIRRORING > 0).tolist() == [False, True]
    tables.flags[1] |= sc.TRANSPARENT  # glass has its own way
    assert not (with_mirrors(tables, s.geometry).flags & sc.MIRRORING).any()
