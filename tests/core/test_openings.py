"""Openings by which sun and sky come in: they are found, and light that is drawn through them is as much as before, with less noise."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core import stages
from lumigate.core.lamps import build_emitters, find_openings
from lumigate.core.lamps.emission import SMALL, focused
from lumigate.core.lamps.openings import RAYS, Openings, no_openings
from lumigate.core.pipeline import render
from lumigate.core.rays import RayScene
from lumigate.core.settings import RenderSettings
from lumigate.core.transport import transport
from lumigate.headless.stress import arrays

from .test_portals import room

F = np.float32
SUN_UP = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1)], float)


def openings_of(made, places=None, seed=0):
    """Openings by which light comes to places (N, 3) with an upward normal, None for some of a room's floor."""
    g = made.geometry
    if places is None:
        places = np.random.default_rng(seed).uniform(-1.8, 1.8, (5000, 3)) * (1, 1, 0) - (0, 0, 0.999)
    places = np.asarray(places, F)
    up = np.tile(F([0, 0, 1]), (len(places), 1))
    with RayScene(g.vertices, g.triangles) as rays:
        tables = transport(g, made.materials.tables, rays.tables, build_emitters(made))
        return find_openings(tables, places, up, np.full(len(places), 1e-6, F), seed)


def without_portals(made):
    made.world.portals = made.world.portals[:0]
    return made


@pytest.mark.parametrize("window", [0.3, 0.8])
def test_a_window_is_found(window):
    made = room(window)
    found = openings_of(made)
    assert len(found.boxes) >= 1 and found.share[0] > 0.9 and found.outwards[0] == 1
    low, high = found.boxes[0]
    assert low[2] == pytest.approx(2, abs=0.1) and high[2] == pytest.approx(2, abs=0.1)
    np.testing.assert_allclose([low[:2], high[:2]], [[-window / 2] * 2, [window / 2] * 2], atol=0.15 * window)
    assert 0 < found.open < 0.05
    assert RAYS <= found.rays
    # It faces the room, as the window's own portal.
    for portals in (found.portals(), made.world.portals):
        facing = np.cross(portals[0, 2], portals[0, 1])
        assert facing[2] < 0 and abs(facing[:2]).max() < 1e-6
    half = np.abs(found.portals()[0, 1:]).max(axis=0)
    np.testing.assert_allclose(half[:2], 0.5 * (high - low)[:2], rtol=1e-5)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("way", [-1, 1])
def test_openings_of_all_walls_face_inwards(axis, way):
    box = np.array([[-1.0, -2, -3], [1, 2, 3]])
    box[:, axis] = way * 4
    (portal,) = Openings(box[None].astype(F), np.array([way]), np.ones(1), 0.0, 0).portals()
    facing = np.cross(portal[2], portal[1])
    assert np.argmax(np.abs(facing)) == axis and np.sign(facing[axis]) == -way
    assert portal[0, axis] == way * 4


def test_a_sun_through_a_window_is_found():
    made = without_portals(room(0.8))
    made.world.radiance = made.world.radiance * 0
    made.lamps = arrays.lamp(sc.SUN, 5.0, axes=SUN_UP, angle=0.02)
    found = openings_of(made)
    assert len(found.boxes) == 1 and found.share[0] > 0.9 and found.open == 1
    low, high = found.boxes[0]
    assert (low[:2] < -0.35).all() and (high[:2] > 0.35).all() and (high[:2] - low[:2] < 1.1).all()


def test_nothing_is_found_where_there_is_nothing():
    dark = without_portals(room())
    dark.world.radiance = dark.world.radiance * 0
    assert not len(openings_of(dark).boxes) and openings_of(dark).rays == 0
    assert not len(openings_of(room(), np.zeros((0, 3))).boxes)
    closed = arrays.scene(arrays.geometry(*arrays.box((-2, -2, -1), (2, 2, 2))), arrays.materials((0.5, 0)), world=(1, 1, 1))
    found = openings_of(closed)
    assert not len(found.boxes) and found.open < 1e-3


def test_an_open_place_has_none_that_guide_light():
    floor = arrays.quads([(-9, -9, -1), (9, -9, -1), (9, 9, -1), (-9, 9, -1)])
    made = arrays.scene(arrays.geometry(*floor), arrays.materials((0.5, 0)), world=(1, 1, 1))
    found = openings_of(made)
    assert found.open > 0.9 > stages.MOSTLY_CLOSED


def test_particles_are_drawn_through_small_openings_alone():
    made = without_portals(room())
    emitters, found = build_emitters(made), openings_of(made)
    places = np.random.default_rng(0).uniform((-2, -2, -1), (2, 2, 2), (500, 3))
    near = focused(emitters, places, found)
    assert len(near.focus) == 2 * len(found.boxes) and near.around == 0  # and what lies close to them
    assert near.drawn.sum() == pytest.approx(1) and 0.2 < near.drawn[0] < 0.5
    some = found._replace(share=np.array([0.3]), boxes=found.boxes[:1])  # others come by other ways
    near = focused(emitters, places, some)
    assert near.drawn.sum() == pytest.approx(1) and near.drawn[0] > 0.7
    large = found._replace(boxes=np.array([[[-2, -2, 2], [2, 2, 2]]], F), share=np.ones(1))
    assert 4 * 4 > SMALL * (4 * 4 + 2 * 4 * 3)
    assert len(focused(emitters, places, large).focus) == 0


@pytest.mark.parametrize("kind", ["sky", "sun"])
def test_a_room_has_the_same_light_with_less_noise(monkeypatch, kind):
    made = without_portals(room(0.3 if kind == "sky" else 0.8))
    if kind == "sun":
        made.world.radiance = made.world.radiance * 0
        made.lamps = arrays.lamp(sc.SUN, 5.0, axes=SUN_UP, angle=0.02)
    settings = RenderSettings(method="importance-sampling", denoise=False).with_defaults()
    layers = "DiffuseIndirect", "Direct"

    def lit(quality, seeds):
        found = [render(made, replace(settings.scaled(quality, 0), seed=seed)).layers for seed in seeds]
        return {name: np.array([one[name] for one in found], np.float64) for name in layers}

    truth = {name: light.mean(axis=0) for name, light in lit(16.0, range(10, 14)).items()}
    with_openings = lit(1.0, range(6))
    monkeypatch.setattr(stages, "find_openings", lambda *_: no_openings())
    without = lit(1.0, range(6))
    for name in layers:
        assert with_openings[name].mean() == pytest.approx(float(truth[name].mean()), rel=0.02 if kind == "sky" else 0.05)
        if kind == "sky":  # of a sun's one patch of light there is little noise as it is
            noise, before = (float(light[name].mean(axis=(1, 2, 3)).std()) for light in (with_openings, without))
            assert noise < 0.5 * before
