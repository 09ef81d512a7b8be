"""Photons that lenses bend and lobes reflect: each spreads all of its light, where its neighbours are and nothing is in its way."""

from contextlib import ExitStack
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lumigate.core import scene as sc
from lumigate.core.lamps import build_emitters
from lumigate.core.methods.caustics import NEAREST, SPARSE, Photons, add_caustics, arranged, by_lobes, keep_light, trace_photons
from lumigate.core.particles import SHINE, trace_by_power
from lumigate.core.rays import RayScene
from lumigate.core.surfaces.layout import GLOSSY_F0, GLOSSY_F90, TRANSPARENCY
from lumigate.core.transport import transport
from lumigate.core.view.points import ShadingPoints

SIDE, PITCH = 81, 0.05  # points in a grid of 4 m, so far apart (m)


def plane(normal=(0.0, 0.0, 1.0)):
    """Points of a square of the floor, z = 0."""
    x = (np.arange(SIDE) - SIDE // 2) * PITCH
    points = ShadingPoints.allocate(SIDE * SIDE)
    points.position[:, 0], points.position[:, 1] = (axis.ravel() for axis in np.meshgrid(x, x))
    points.position[:, 2] = 0
    points.ng[:] = points.ns[:] = normal
    points.error[:] = 1e-6
    return points


def spot(n, width, height=0.0):
    """Photons of 1 W in all that fall straight down, with a normal distribution."""
    photons = Photons.allocate(n)
    photons.facing[:], photons.followed[:], photons.lobes[:], photons.blur[:] = 0, 0, 1, 0
    photons.position[:, :2] = np.random.default_rng(1).normal(0, width, (n, 2))
    photons.position[:, 2] = height
    photons.normal[:], photons.direction[:], photons.flux[:], photons.side[:], photons.group[:] = (0, 0, 1), (0, 0, -1), 1 / n, 1, 0
    return photons


def tables_of(build, stack, *parts, lamps=None, materials=None, of_last=0):
    """The tables of a scene of such parts, the last of which has the material `of_last`."""
    corners, faces, n = [], [], 0
    for points, triangles in parts:
        corners.append(points)
        faces.append(np.asarray(triangles) + n)
        n += len(points)
    stuff = [0 if k < len(parts) - 1 else of_last for k, (_, triangles) in enumerate(parts) for _ in triangles]
    geometry = build.geometry(np.concatenate(corners), np.concatenate(faces), stuff)
    scene = build.scene(geometry, build.materials((0.5, 0.0)) if materials is None else materials, lamps=lamps)
    clear = (scene.materials.tables.flags[geometry.material] & sc.TRANSPARENT) != 0
    rays = stack.enter_context(RayScene(geometry.vertices, geometry.triangles, None, clear))
    return transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))


def square(build, half, height=0.0):
    """A floor of this half side (m)."""
    return build.quads([(-half, -half, height), (half, -half, height), (half, half, height), (-half, half, height)])


@pytest.fixture(scope="module")
def lit(build):
    """(photons, points) -> irradiance (N, 3)."""
    with ExitStack() as stack:
        scene = tables_of(build, stack, square(build, 1.0, height=-99.0))

        def lit(photons, points):
            out = np.zeros((len(points.pixel), 3), np.float32)
            add_caustics(scene, arranged(photons, NEAREST), points, 1, 2, out)
            return out

        yield lit


@pytest.mark.parametrize("n", [1500, 8000])
def test_all_light_arrives_and_stays_near_where_it_fell(lit, n):
    points = plane()
    found = lit(spot(n, 0.3), points)
    assert found[:, 1].sum() * PITCH**2 == pytest.approx(1, rel=0.02)
    r2 = np.einsum("nk,nk->n", points.position, points.position)
    np.testing.assert_array_equal(found[r2 > 1.8**2], 0)
    middle = found[r2 < 0.15**2, 0].mean()
    assert middle == pytest.approx((1 - np.exp(-0.125)) / (np.pi * 0.15**2), rel=0.15)


def test_what_frosted_glass_has_spread_is_spread_itself():
    """By half of what the glass has spread it, four times as far as others at most: its noise is gone where there is nothing sharp to be lost."""
    photons = spot(4000, 0.3)
    sharp = np.sort(arranged(photons, NEAREST).radius)
    photons.blur[:] = 1e-3
    np.testing.assert_array_equal(np.sort(arranged(photons, NEAREST).radius), sharp)
    photons.blur[:] = 4 * np.median(sharp)
    found = arranged(photons, NEAREST).radius
    assert found.min() == pytest.approx(float(min(2 * np.median(sharp), 4 * sharp.min())), rel=1e-5)
    photons.blur[:] = 1e3
    np.testing.assert_allclose(np.sort(arranged(photons, NEAREST).radius), 4 * sharp, rtol=1e-5)


def test_wide_lobes_show_what_lobes_throw_and_what_glass_bends_of_lamps_but_not_of_the_world(build):
    """Their own rays find that."""
    points, photons = plane(), spot(1500, 0.3)
    points.wo[:] = 0, 0, 1
    points.f0[:] = points.f90[:] = 0.2
    points.roughness[:] = 0.6
    shines = {}
    with ExitStack() as stack:
        scene = tables_of(build, stack, square(build, 1.0, height=-99.0))
        for name, lobes, blur in (("sky", 0, 0), ("scattered", 1, 1e-4), ("thrown", 1, 0)):
            photons.lobes[:], photons.blur[:] = lobes, blur
            out, shown = np.zeros((2, len(points.pixel), 3), np.float32)
            add_caustics(scene, arranged(photons, NEAREST), points, 1, 2, out, shown)
            shines[name] = shown.sum()
    assert shines["sky"] == 0
    assert shines["scattered"] == pytest.approx(float(shines["thrown"]), rel=1e-4) and shines["thrown"] > 0


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_other_sides_stay_dark(lit, normal):
    assert not lit(spot(2000, 0.3), plane(normal)).any()


def test_a_photon_that_a_wide_lobe_mirrors_is_left_to_the_lobes_own_rays(build):
    """It would light the whole of its disk, hundreds of times as bright as a dull surface: a patch on a wet road, of one photon.  But of what no ray follows, all stays."""
    points, photons = plane(), spot(1500, 0.3)
    low = np.float32([np.cos(0.1), 0, np.sin(0.1)])
    photons.direction[:], photons.entry[:] = low * (1, 1, -1), (-9, 0, 1)
    points.wo[:] = low
    points.f0[:] = points.f90[:] = 0.2
    points.roughness[:] = 0.4
    found = {}
    with ExitStack() as stack:
        scene = tables_of(build, stack, square(build, 1.0, height=-99.0))
        for followed in (0, 1):
            photons.followed[:] = followed
            out, shown = np.zeros((2, len(points.pixel), 3), np.float32)
            add_caustics(scene, arranged(photons, NEAREST), points, 1, 2, out, shown)
            lit = out[:, 0] > 0
            found[followed] = np.pi * shown[lit, 0] / (0.2 * out[lit, 0])
    assert found[0].min() > 50
    assert 1 < found[1].min() and found[1].max() < 40


def test_what_lies_above_stays_dark(lit):
    assert not lit(spot(2000, 0.3, height=-0.5), plane()).any()


def one_by_one(photons, points, radius):
    """Irradiance (N, 3), by every photon on every point."""
    out = np.zeros((len(points.pixel), 3))
    for p in range(len(radius)):
        away = (photons.position[p] - points.position).astype(np.float64)
        falls = 1 - (away**2).sum(axis=1) / radius[p] ** 2
        alike = (points.ng @ photons.normal[p] > 0.7) & (np.abs((points.ng * away).sum(axis=1)) <= 0.1 * radius[p])
        cosines = points.ns @ -photons.direction[p] / (photons.normal[p] @ -photons.direction[p])
        weight = 2 / np.pi / radius[p] ** 2 * np.maximum(falls, 0) * np.clip(cosines, 0, 2)
        out += np.where(alike, weight, 0)[:, None] * photons.flux[p]
    return out


@pytest.mark.parametrize("far", [0.0, 5000.0])
def test_what_each_photon_lights_is_found(lit, far):
    points, rng = plane(), np.random.default_rng(2)
    photons = spot(600, 0.6)
    photons.position[::2, :2] = rng.normal(0.5, 0.002, (300, 2))  # a focus beside dim light: many sizes of disks
    slant = rng.normal((0, 0, -1), 0.3, (600, 3))
    photons.direction[:] = slant / np.linalg.norm(slant, axis=1)[:, None]
    points.position[:, 0] += np.float32(far)
    photons.position[:, 0] += np.float32(far)
    disks = arranged(photons, NEAREST)
    assert disks.radius.max() > 16 * disks.radius.min()
    wanted = one_by_one(disks.photons, points, disks.radius)
    np.testing.assert_allclose(lit(photons, points), wanted, rtol=1e-3, atol=1e-4 * wanted.max())


@pytest.mark.parametrize("nearest", [NEAREST, 256])
def test_disks_reach_to_about_so_many_neighbours(nearest):
    photons = spot(8000, 0.6)
    radius = cKDTree(photons.position).query(photons.position, [nearest + 1])[0][:, 0]
    disks = arranged(photons, nearest)
    mine = disks.radius[np.lexsort(disks.photons.position.T)]
    true = np.minimum(radius, SPARSE * np.median(radius))[np.lexsort(photons.position.T)]
    assert np.mean((mine / true) ** 2) == pytest.approx(1, rel=0.1)
    assert np.std(np.log(mine / true)) < 0.2


def test_at_edges_no_light_is_lost(build):
    half = SIDE * PITCH / 2
    photons = spot(1500, 1.0)
    photons.position[:, :2] = np.random.default_rng(3).random((1500, 2)) * (0.2, 4.0) - (half, 2.0)  # a strip along an edge
    with ExitStack() as stack:
        scene, points = tables_of(build, stack, square(build, half)), plane()
        caustics = arranged(photons, NEAREST)
        before, after = np.zeros((2, len(points.pixel), 3), np.float32)
        add_caustics(scene, caustics, points, 1, 2, before)
        keep_light(scene, caustics, 1, 2)
        add_caustics(scene, caustics, points, 1, 2, after)
    assert before[:, 0].sum() * PITCH**2 < 0.93
    assert after[:, 0].sum() * PITCH**2 == pytest.approx(1, rel=0.03)


@pytest.mark.parametrize("tested", [False, True])
@pytest.mark.parametrize("between", ["nothing", "holes"])
def test_on_slats_no_light_is_lost(build, between, tested):
    """Slats narrower than the photons' disks, as leaves are, with nothing between them, or what a leaf's picture leaves clear."""
    half, width = SIDE * PITCH / 2, 0.1
    edges, rng = np.arange(-half, half, 0.25), np.random.default_rng(4)
    photons = spot(3000, 1.0)
    photons.position[:, 0] = rng.choice(edges, 3000) + width * rng.random(3000)
    photons.position[:, 1] = 3 * rng.random(3000) - 1.5
    photons.entry[:] = (0, 0, 5)
    slats, holes = (
        build.quads(*[[(a, -half, 0), (b, -half, 0), (b, half, 0), (a, half, 0)] for a, b in zip(starts, ends)])
        for starts, ends in ((edges, edges + width), (edges + width, edges + 0.25))
    )
    stuff = build.materials((0.5, 0.0), (0.5, 0.0))
    stuff.tables.constant[1] = 0
    stuff.tables.constant[1, TRANSPARENCY : TRANSPARENCY + 3] = 1
    stuff.tables.flags[1] |= sc.TRANSPARENT
    points = plane()
    points.position[:, :2] += np.random.default_rng(5).uniform(-PITCH / 2, PITCH / 2, (SIDE * SIDE, 2))
    on_slats = (points.position[:, 0] + half) % 0.25 < width
    found = np.zeros((len(points.pixel), 3), np.float32)
    with ExitStack() as stack:
        scene = tables_of(build, stack, slats, *([holes] if between == "holes" else []), materials=stuff, of_last=int(between == "holes"))
        caustics = arranged(photons, NEAREST, tested=tested)
        keep_light(scene, caustics, 1, 2)
        add_caustics(scene, caustics, points, 1, 2, found)
    assert found[on_slats, 0].sum() * PITCH**2 == pytest.approx(1, rel=0.05)


@pytest.mark.parametrize("tested", [False, True])
def test_what_is_turned_the_other_way_beside_it_gets_no_more(build, tested):
    """A floor in strips whose triangles face up and down in turn, as imported models and panes before a wall have them."""
    half, photons = SIDE * PITCH / 2, spot(1500, 0.3)
    photons.entry[:] = (0.1, 0.2, 2.0)
    edges = np.linspace(-half, half, 21)
    strips = [[(a, -half, 0), (b, -half, 0), (b, half, 0), (a, half, 0)][:: 1 - 2 * (k % 2)] for k, (a, b) in enumerate(pairwise(edges))]
    photons.side[:] = 1 - 2 * (np.searchsorted(edges, photons.position[:, 0]) % 2 == 0)
    points, found = plane(), np.zeros((SIDE * SIDE, 3), np.float32)
    with ExitStack() as stack:
        scene = tables_of(build, stack, build.quads(*strips))
        caustics = arranged(photons, NEAREST, tested=tested)
        keep_light(scene, caustics, 1, 2)
        add_caustics(scene, caustics, points, 1, 2, found)
    assert found[:, 0].sum() * PITCH**2 == pytest.approx(1, rel=0.03)


def test_nothing_shines_through_walls(build):
    wall = build.quads([(0, -2, 0), (0, 2, 0), (0, 2, 1), (0, -2, 1)])
    points, photons = plane(), spot(1500, 0.3)
    photons.position[:, 0] = -np.abs(photons.position[:, 0]) - 0.02
    photons.entry[:] = (-1, 0, 0.5)
    half = SIDE * PITCH / 2
    with ExitStack() as stack:
        scene = tables_of(build, stack, square(build, half), wall)
        caustics = arranged(photons, NEAREST, tested=True, every=2)
        keep_light(scene, caustics, 1, 2)
        found = np.zeros((len(points.pixel), 3), np.float32)
        add_caustics(scene, caustics, points, 1, 2, found)
    behind = points.position[:, 0] > 0
    assert not found[behind].any()
    assert found[:, 0].sum() * PITCH**2 == pytest.approx(1, rel=0.05)


@pytest.mark.parametrize("wide", [False, True])
def test_what_lobes_reflect_is_the_light_of_the_virtual_lights(build, wide):
    """In a closed room; the disk of the wide lamp is cut by a sheet, which hides no half of it from what is far."""
    below, above = square(build, 2), build.quads([(-2, -2, 2), (-2, 2, 2), (2, 2, 2), (2, -2, 2)])
    sides = [build.quads([(-2, y, 0), (2, y, 0), (2, y, 2), (-2, y, 2)][::turn]) for y, turn in ((-2, -1), (2, 1))] + [
        build.quads([(x, -2, 0), (x, 2, 0), (x, 2, 2), (x, -2, 2)][::turn]) for x, turn in ((-2, 1), (2, -1))
    ]
    sheet = [build.quads([(0.3, -1, 0.3), (0.3, 1, 0.3), (0.3, 1, 1.7), (0.3, -1, 1.7)])] if wide else []
    stuff = build.glossy_materials((0.5, 0.5), (0.5, 0.0), albedo=0.3, roughness=0.3)
    if wide:
        stuff.tables.constant[1, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[1, GLOSSY_F90 : GLOSSY_F90 + 3] = 0
        stuff.tables.flags[1] &= ~sc.GLOSSY_LOBE
    lamp = build.lamps(build.lamp(sc.POINT, 5.0, position=(0.3, 0.2, 0.7), radius=0.25 if wide else 0.1))
    lamp.soft_falloff[:] = wide
    with ExitStack() as stack:
        scene = tables_of(build, stack, below, above, *sides, *sheet, lamps=lamp, materials=stuff, of_last=int(wide))
        photons, _ = trace_photons(scene, np.float32([(-2, -2, 0), (2, 2, 2)]), 20000, 1 << 17, 4, seed=1, threads=2, lobes=True)
        photons = photons.take(photons.lobes == 1)
        vpls, _ = trace_by_power(scene, 1 << 15, 1, seed=2)
    shines = vpls.take(vpls.shine == SHINE)
    along = np.einsum("nk,nk->n", shines.normal, shines.surface_normal)
    cut = along / np.sqrt(along**2 + (1 - along**2) / (1 + shines.sharpness))
    leaving = (shines.flux[:, 1] * (1 + cut) / 2).sum()
    assert leaving > 0.5
    assert photons.flux[:, 1].sum() == pytest.approx(leaving, rel=0.03)
    np.testing.assert_allclose(np.linalg.norm(photons.direction, axis=1), 1, rtol=1e-4)
    assert (np.einsum("nk,nk->n", photons.normal, photons.direction) < 0).all()
    # They fly straight from where they were reflected.
    away = photons.position - photons.entry
    np.testing.assert_allclose(away / np.linalg.norm(away, axis=1)[:, None], photons.direction, atol=0.01)


@pytest.mark.parametrize("opacity", [1e-4, 0.5])
def test_the_rim_of_a_leaf_keeps_no_sparks(build, opacity):
    """What is left on a card that is all but clear lights all around it: as few photons as end there, none may have a thousand times the light."""
    card = build.quads([(0.5, -1, 0.2), (0.5, 1, 0.2), (0.5, 1, 1.8), (0.5, -1, 1.8)])
    ceiling = build.quads([(-2, -2, 2), (-2, 2, 2), (2, 2, 2), (2, -2, 2)])
    stuff = build.glossy_materials((0.5, 0.0), (0.5 * opacity, 0.0), albedo=0.3, roughness=0.3)
    stuff.tables.constant[1, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[1, GLOSSY_F90 : GLOSSY_F90 + 3] = 0
    stuff.tables.constant[1, TRANSPARENCY : TRANSPARENCY + 3] = 1 - opacity
    stuff.tables.flags[1] = stuff.tables.flags[1] & ~sc.GLOSSY_LOBE | sc.TRANSPARENT
    lamp = build.lamps(build.lamp(sc.POINT, 5.0, position=(-0.5, 0.2, 0.7), radius=0.1))
    corners = np.float32([(-2, -2, 0), (2, 2, 2)])
    with ExitStack() as stack:
        scene = tables_of(build, stack, square(build, 2), ceiling, card, lamps=lamp, materials=stuff, of_last=1)
        photons, _ = trace_photons(scene, corners, 20000, 1 << 17, 4, seed=1, threads=2, lobes=True)
        bare = tables_of(build, stack, square(build, 2), ceiling, lamps=lamp, materials=stuff)
        without, _ = trace_photons(bare, corners, 20000, 1 << 17, 4, seed=1, threads=2, lobes=True)
    on_card = np.abs(photons.position[:, 0] - 0.5) < 1e-3
    assert np.count_nonzero(on_card & (photons.position[:, 2] > 0.1)) > 100
    assert photons.flux[:, 1].max() < 10 * np.median(photons.flux[:, 1])
    # What falls on the ceiling has come through the card, in part.
    above, all_of_it = (p.flux[p.position[:, 2] > 1.99, 1].sum() for p in (photons, without))
    assert (1 - opacity) * all_of_it < above * 1.03
    assert above < all_of_it * 1.03


@pytest.mark.parametrize(("leaves", "roughness", "photons"), [(True, 0.4, False), (True, 0.05, True), (False, 0.4, True)])
def test_wide_lobes_have_photons_where_these_light_more_than_crumbs(build, leaves, roughness, photons):
    """A heap of leaves much smaller than photons lie apart, or the same light in a room; what narrow lobes throw there is no other way in any case."""
    rng, size = np.random.default_rng(7), 0.05
    corners = rng.uniform((-1, -1, 0.2), (1, 1, 1.8), (2000, 3))
    edges = rng.normal(size=(2000, 2, 3))
    edges *= size / np.linalg.norm(edges, axis=2, keepdims=True)
    cards = build.quads(*[[c, c + a, c + a + b, c + b] for c, (a, b) in zip(corners, edges)]) if leaves else square(build, 2)
    lamp = build.lamps(build.lamp(sc.POINT, 5.0, position=(0, 0, 1.9), radius=0.1))
    wall = build.quads([(-2, -2, 2), (-2, 2, 2), (2, 2, 2), (2, -2, 2)])
    with ExitStack() as stack:
        stuff = build.glossy_materials((0.5, 0.5), albedo=0.3, roughness=roughness)
        scene = tables_of(build, stack, cards, *([] if leaves else [wall]), lamps=lamp, materials=stuff)
        points = np.float32([(-1, -1, 0.2), (1, 1, 1.8)] if leaves else [(-2, -2, 0), (2, 2, 2)])
        found, _, _ = by_lobes(scene, points, 0.3, 0.0, 4096, 4, seed=1, threads=2)
    assert (found is not None) == photons


def test_light_leaves_a_polished_can_by_several_lobes(build):
    """A lamp in a box that mirrors, open below.  In a row of such boxes, each its neighbours' mirror image, a ray is straight: how many walls it meets is
    known, and how much is left of it."""
    floor = build.quads([(-9, -9, -4), (9, -9, -4), (9, 9, -4), (-9, 9, -4)])
    ceiling = build.quads([(-9, -9, 9), (-9, 9, 9), (9, 9, 9), (9, -9, 9)])
    walls = [
        build.quads([(-9, -9, -4), (-9, -9, 9), (9, -9, 9), (9, -9, -4)]),
        build.quads([(9, 9, -4), (9, 9, 9), (-9, 9, 9), (-9, 9, -4)]),
        build.quads([(-9, 9, -4), (-9, 9, 9), (-9, -9, 9), (-9, -9, -4)]),
        build.quads([(9, -9, -4), (9, -9, 9), (9, 9, 9), (9, 9, -4)]),
    ]
    can = build.quads(
        [(-1, -1, 1), (-1, 1, 1), (1, 1, 1), (1, -1, 1)],
        [(-1, -1, -1), (-1, -1, 1), (1, -1, 1), (1, -1, -1)],
        [(1, 1, -1), (1, 1, 1), (-1, 1, 1), (-1, 1, -1)],
        [(-1, 1, -1), (-1, 1, 1), (-1, -1, 1), (-1, -1, -1)],
        [(1, -1, -1), (1, -1, 1), (1, 1, 1), (1, 1, -1)],
    )
    stuff = build.glossy_materials((0.5, 0.0), (0.0, 0.0), albedo=0.0, roughness=0.05)
    stuff.tables.constant[0, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[0, GLOSSY_F90 : GLOSSY_F90 + 3] = 0
    stuff.tables.flags[0] &= ~sc.GLOSSY_LOBE
    stuff.tables.constant[1, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[1, GLOSSY_F90 : GLOSSY_F90 + 3] = 0.8
    lamp = build.lamps(build.lamp(sc.POINT, 5.0, position=(0, 0, 0), radius=0.1))
    with ExitStack() as stack:
        scene = tables_of(build, stack, floor, ceiling, *walls, can, lamps=lamp, materials=stuff, of_last=1)
        lit, _ = trace_by_power(tables_of(build, stack, floor, ceiling, *walls, lamps=lamp, materials=stuff), 1 << 14, 1, seed=2)
        power = lit.flux[:, 1].sum() / 0.5
        photons, _ = trace_photons(scene, np.float32([(-9, -9, -4), (9, 9, 9)]), 20000, 1 << 17, 4, seed=1, threads=2, lobes=True)
    assert (np.abs(photons.position).max(axis=1) > 3.9).all()  # none is told of within
    several = photons.flux[photons.lobes > 1, 1].sum() / photons.flux[:, 1].sum()
    dx, dy, dz = np.random.default_rng(1).normal(size=(3, 200000))
    down = np.where(dz < 0, 1, 3) / np.abs(dz)
    met = (np.abs(dx) * down + 1) // 2 + (np.abs(dy) * down + 1) // 2 + (dz > 0)
    left = np.where(met > 0, 0.8**met, 0)
    assert several == pytest.approx(left[met > 1].sum() / left.sum(), abs=0.02)
    assert photons.flux[:, 1].sum() == pytest.approx(power * left.mean(), rel=0.02)


def test_small_pictures_have_fewer_photons(build):
    """By powers of two, and no fewer than a quarter; the light is the same."""
    lamp = build.lamps(build.lamp(sc.POINT, 5.0, position=(0, 0, 1.9), radius=0.1))
    wall = build.quads([(-2, -2, 2), (-2, 2, 2), (2, 2, 2), (2, -2, 2)])
    corners = np.float32([(-2, -2, 0), (2, 2, 2)])
    with ExitStack() as stack:
        scene = tables_of(
            build, stack, square(build, 2), wall, lamps=lamp, materials=build.glossy_materials((0.5, 0.5), albedo=0.3, roughness=0.2)
        )
        found = [
            by_lobes(scene, np.tile(corners, (n, 1)), 0.3, 0.0, 4096, 4, seed=1, threads=2)[0].photons
            for n in (1, 1 << 14, 1 << 16, 1 << 18)
        ]
    few, fewer, all_of_them, no_more = (len(photons.group) for photons in found)
    assert all_of_them == pytest.approx(4 * few, rel=0.05)
    assert all_of_them == pytest.approx(2 * fewer, rel=0.05)
    assert all_of_them == no_more
    light = [float(photons.flux.sum()) for photons in found]
    assert light == pytest.approx([light[2]] * 4, rel=0.05)
