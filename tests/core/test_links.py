"""Light linking: which objects an emitter lights, and which hide it."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.lamps import direct_light
from lumigate.core.lamps.links import is_linked, is_unlinked, shadow_kinds
from lumigate.core.particles import trace_particles
from lumigate.core.rays import RayScene, intersect
from lumigate.core.rays.trace import ALL

from .test_lamps import RECEIVER, Lit, lamp, scene_of

SHADE = [(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
FLOOR, OVER = 0, 1  # objects


def linked(*rows, receivers=None, hides=None, **options):
    """A floor and a shade over it, each an object, and lamps that light the objects `receivers` and are hidden by the objects `hides` (None: all)."""
    scene = scene_of(*rows, quad=(RECEIVER, SHADE), material=[0, 0], **options)
    g = scene.geometry
    g.object = np.repeat(np.arange(2, dtype=np.int32), 2)
    g.object_names, g.object_visibility = ["floor", "shade"], np.full(2, sc.ALL_RAYS, np.uint32)
    if receivers is not None:
        g.receiver_sets = np.isin([[FLOOR, OVER]], receivers).astype(np.uint8)
        scene.lamps.receivers[:] = 0
    if hides is not None:
        g.object_visibility |= np.uint32(sc.FIRST_BLOCKER_SET) * np.isin([FLOOR, OVER], hides).astype(np.uint32)
        scene.lamps.blockers[:] = 0
    return scene


def irradiance(scene, points, triangle, normal=(0, 0, 1), samples=64):
    """Direct irradiance (N,) at points of a triangle, seen from above."""
    light = Lit(scene)
    position = np.array(points, np.float32)
    n = np.tile(np.float32(normal), (len(position), 1))
    seen = SimpleNamespace(
        position=position, ns=n, ng=n, error=np.full(len(position), 1e-6, np.float32), triangle=np.full(len(position), triangle, np.int32)
    )
    return direct_light(light.tables, seen, samples, 1, lobes=False)[0].irradiance[:, 0]


ROWS = {
    "point": [lamp(sc.POINT, 10, (0, 0, 3))],
    "sphere": [lamp(sc.POINT, 10, (0, 0, 3), radius=0.3)],
    "sun": [lamp(sc.SUN, 10, angle=0.1)],
    "area": [lamp(sc.AREA, 10, (0, 0, 3), size=(0.5, 0.5))],
    "many": [lamp(sc.POINT, 1, (0.1 * k, 0, 3)) for k in range(12)],  # a tree
}


@pytest.mark.parametrize("name", ROWS)
def test_what_a_lamp_lights_and_what_hides_it(name):
    rows = ROWS[name]
    beneath, above, beside = [[0.1, 0.1, 0]], [[0.1, 0.1, 1]], [[3.5, 0, 0]]
    plain = linked(*rows)
    assert irradiance(plain, beneath, 0)[0] == 0
    lit, open_ = irradiance(plain, above, 2)[0], irradiance(plain, beside, 0)[0]
    assert lit > 0
    assert open_ > 0
    for receivers in ([FLOOR], [OVER], []):
        scene = linked(*rows, receivers=receivers)
        assert irradiance(scene, above, 2)[0] == (pytest.approx(lit, rel=0.05) if OVER in receivers else 0)
        assert irradiance(scene, beside, 0)[0] == (pytest.approx(open_, rel=0.05) if FLOOR in receivers else 0)
        assert irradiance(scene, beneath, 0)[0] == 0
    without = irradiance(scene_of(*rows), beneath, 0)[0]
    assert irradiance(linked(*rows, hides=[FLOOR]), beneath, 0)[0] == pytest.approx(without, rel=0.05)
    assert irradiance(linked(*rows, hides=[OVER]), beneath, 0)[0] == 0


@pytest.mark.parametrize("name", ["sphere", "area", "sun"])
@pytest.mark.parametrize(
    ("receivers", "hides"), [(None, None), ([FLOOR], None), ([OVER], None), (None, [FLOOR]), ([OVER], [FLOOR]), ([FLOOR], [FLOOR])]
)
def test_particles_leave_what_direct_light_finds(name, receivers, hides):
    scene = linked(*ROWS[name], receivers=receivers, hides=hides)
    light = Lit(scene)  # whose rays go with it
    vpls = trace_particles(light.tables, 2**16, 1, seed=1)[0]
    height = vpls.position[:, 2]
    for level, triangle, half in ((0.0, 0, 4.0), (1.0, 2, 1.0)):
        side = 64
        s = ((np.arange(side) + 0.5) / side * 2 - 1) * half
        x, y = np.meshgrid(s, s)
        points = np.stack([x.ravel(), y.ravel(), np.full(side * side, level)], 1)
        expected = 0.5 * irradiance(scene, points, triangle, samples=16).mean(dtype=float) * (2 * half) ** 2
        found = vpls.flux[np.abs(height - level) < 0.1, 0].sum(dtype=float)
        assert found == pytest.approx(expected, rel=0.03, abs=1e-6)


def kinds_of(blockers):
    """Of the shadow rays to a lamp that this set of objects hides."""
    seen = SimpleNamespace(object_visibility=np.array([sc.ALL_RAYS], np.uint32))
    return int(shadow_kinds(np.array([blockers]), seen, np.array([False]))[0])


@pytest.mark.parametrize(
    ("visibility", "kinds"),
    [(sc.ALL_RAYS & ~sc.SHADOW, sc.DIFFUSE), (sc.ALL_RAYS & ~sc.DIFFUSE, sc.DIFFUSE), (sc.ALL_RAYS & ~sc.CAMERA, sc.SHADOW)],
)
def test_a_sky_of_one_colour_is_hidden_by_what_diffuse_rays_meet(visibility, kinds):
    """As in Cycles, which has no shadow rays to it, where these meet other objects; and so are no lamps, nor what objects of their own hide."""
    seen = SimpleNamespace(object_visibility=np.array([sc.ALL_RAYS, visibility], np.uint32))
    found = shadow_kinds(np.array([-1, -1, 0]), seen, np.array([True, False, True]))
    assert found.tolist() == [kinds, sc.SHADOW, sc.FIRST_BLOCKER_SET]


@pytest.mark.parametrize("backend", ["embree", "bvh"])
def test_rays_of_a_set_meet_its_blockers_alone(backend):
    triangles = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    vertices = np.concatenate([np.array([[-1, -1, z], [1, -1, z], [0, 1, z]], np.float32) for z in (1, 2, 3)])
    sets = [0, sc.FIRST_BLOCKER_SET, sc.FIRST_BLOCKER_SET << (sc.BLOCKER_SETS - 1)]
    with RayScene(vertices, triangles, np.array([sc.SHADOW | k for k in sets], np.uint32), backend=backend) as rays:
        for kinds, first in (
            (sc.SHADOW, 0),
            (kinds_of(0), 1),
            (kinds_of(sc.BLOCKER_SETS - 1), 2),
        ):
            hits = intersect(rays, np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32), mask=kinds, which=ALL)
            assert hits.triangle[0] == first


def test_which_are_linked():
    rows = [lamp(sc.POINT, 1), lamp(sc.POINT, 1, (1, 0, 2)), lamp(sc.POINT, 1, (2, 0, 2))]
    scene = linked(*rows, receivers=[FLOOR], hides=[FLOOR])
    scene.lamps.receivers[:], scene.lamps.blockers[:] = [-1, 0, -1], [-1, -1, 0]
    assert is_linked(scene.lamps).tolist() == [False, True, True]
    assert is_unlinked(Lit(scene).emitters).tolist() == [True, False, False]
    assert math.log2(kinds_of(sc.BLOCKER_SETS - 1)) < 30
