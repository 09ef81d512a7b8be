"""The fast part of `lumigate bench stress`: the same generators, by every method."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.particles import Vpls
from lumigate.core.stages import AVAILABLE
from lumigate.core.view.points import ShadingPoints
from lumigate.core.vpl_pool import vpl_pool
from lumigate.headless.stress import broken, numbers, rooms, scales
from lumigate.headless.stress.fuzz import judge, sample
from lumigate.headless.stress.path_tracer import path_traced
from lumigate.headless.stress.random_scenes import random_scene
from lumigate.headless.stress.suite import attempt, stress_steps


def failures(lines) -> list[str]:
    """The lines that do not hold, readable."""
    return [f"{line.case}: {line.value} is not {line.must}" for line in lines if not line.passed]


@pytest.mark.parametrize("method", AVAILABLE)
@pytest.mark.parametrize(
    "case", [scales.spikes, scales.albedos, broken.walls, broken.cracks, broken.places, numbers.few], ids=lambda case: case.__name__
)
def test_holds_by_every_method(case, method):
    assert failures(case(method)) == []


@pytest.mark.parametrize("method", AVAILABLE)
def test_light_does_not_depend_on_scale_or_power(method):
    whole = rooms.irradiance(rooms.light(rooms.room(), method))
    for settings in ({"scale": 1e-4}, {"scale": 1e5}, {"power": 1e-12}, {"power": 1e12}):
        value = rooms.irradiance(rooms.light(rooms.room(**settings), method)) / settings.get("power", 1.0)
        assert value == pytest.approx(whole, rel=0.01)


@pytest.mark.parametrize("place", numbers.PLACES)
@pytest.mark.parametrize("bad", numbers.BAD.values(), ids=numbers.BAD)
def test_no_number_spoils_no_picture(place, bad):
    scene = rooms.room(size=(9, 7))
    numbers.PLACES[place](scene, bad)
    assert failures([numbers.made_of_numbers(place, scene, "instant-radiosity")]) == []


def test_a_generator_that_raises_is_a_line_that_fails():
    def raises(method):
        yield scales.near("sound", method, 1.0, 1.0, 0.1)
        raise ZeroDivisionError(method)

    first, second = attempt(raises, "auto")
    assert first.passed and not second.passed
    assert "ZeroDivisionError" in second.case


def test_every_step_has_a_name_of_its_own_and_rows_that_say_what_must_hold(tmp_path):
    steps = {step.name: step for step in stress_steps(tmp_path, 3)}
    assert len(steps) == 24 and "3 random scenes" in steps
    rows = steps["spikes"].work()
    assert {row["method"] for row in rows} == set(AVAILABLE)
    assert all(row["suite"] == "stress" and row["must"] and row["pass"] is True for row in rows)


def test_path_tracer_finds_the_light_of_a_sphere(build):
    # Radiance 1 from everywhere: direct albedo, then albedo^2 and so on.
    scene = build.scene(build.geometry(*build.icosphere(2)), build.materials((0.5, 1.0)), camera=build.camera())
    mean, variance = path_traced(scene, 3, 200, 1)
    np.testing.assert_allclose(mean, [0.5, 0.25 + 0.125 + 0.0625], rtol=1e-9)
    assert variance.max() < 1e-12


@pytest.mark.parametrize("kind", [sc.POINT, sc.SPOT, sc.SUN, sc.AREA])
def test_path_tracer_agrees_with_direct_light(build, kind):
    # A floor under one lamp: no indirect light at all, and direct light without noise of its own but for area lamps.
    lamp = build.lamp(kind, 1.0, (0.2, 0.1, 0.0), angle={sc.SPOT: 1.5, sc.SUN: 0.0}.get(kind, np.pi), blend=0.5, size=(0.3, 0.2))
    floor = build.geometry(*build.quads([(-3, -3, -1), (3, -3, -1), (3, 3, -1), (-3, 3, -1)]))
    scene = build.scene(floor, build.materials((0.5, 0.0)), lamps=lamp, camera=build.camera((0, 0, 0.5)))
    mean, variance = path_traced(scene, 2, 20_000, 1)
    layers = rooms.light(scene, "instant-radiosity", pixel_samples=16, direct_samples=16)
    assert layers["Direct"].mean() == pytest.approx(mean[0], abs=5 * np.sqrt(variance[0]) + 0.002 * mean[0])
    assert mean[1] == 0 and not layers["Indirect"].any()


def test_random_scenes_against_the_path_tracer():
    # Scenes 0..49, dealt to all methods; the suite has 10,000.
    found = [sample(seed) for seed in range(50)]
    assert [one.fault for one in found if one.fault] == []
    for method in AVAILABLE:
        lines = judge(method, [one for one in found if one.method == method])
        assert failures(line for line in lines if "share of" not in line.case) == []


def test_a_method_that_lost_light_would_be_found():
    found = [sample(seed) for seed in range(0, 100, 5)]
    darker = [replace(one, value=0.5 * one.value) for one in found]
    assert failures(judge("instant-radiosity", darker))


def test_random_scenes_are_of_every_kind_and_repeatable():
    kinds = {random_scene(seed)[1] for seed in range(40)}
    assert kinds == {"room", "dark room", "open", "heap"}
    a, b = (random_scene(7)[0] for _ in range(2))
    assert np.array_equal(a.geometry.vertices, b.geometry.vertices)


@pytest.mark.parametrize(("wanted", "flown"), [(4, 64), (4096, 8 * 4096), (1_000_000, 2_000_000)])
def test_very_many_lights_fly_few_particles_each(wanted, flown):
    asked = []

    def particles(scene, count, *rest):
        asked.append(count)
        return Vpls.allocate(0), 0

    vpl_pool(None, ShadingPoints.allocate(0), wanted, 3, None, 0, particles=particles)
    assert asked == [flown]
