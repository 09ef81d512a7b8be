"""Light of a small picture in a large one, where there is no time to light every pixel."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lumigate.core.enlarged import LINES, Guides, _interpolate, _place
from lumigate.core.film import Film
from lumigate.core.pipeline import render
from lumigate.core.planning.machine import Machine
from lumigate.core.planning.planner import FEWEST, LEAST, QUICKEST, Planner, reduced, sides
from lumigate.core.scene import SUN
from lumigate.core.settings import RenderSettings
from lumigate.core.sharp_shadows import in_penumbras

MACHINE = Machine(ray=1e-6, denoiser=0.01, denoiser_pixel=1e-6, threads=2)


@pytest.fixture(scope="module")
def sphere(build):
    """A closed sphere, radiance 1 W/m^2/sr, albedo 0.5, seen from its middle."""
    return build.scene(build.geometry(*build.icosphere(3)), build.materials((0.5, 1.0)), camera=build.camera(width=96, height=64))


def flat(shape, side):
    """Guides of two half planes that meet at `side` (0..1), the right one turned away from the left one."""
    height, width = shape
    x = (np.arange(width) + 0.5) / width
    right = x > side
    normal = np.zeros((height, width, 3), np.float32)
    normal[:, ~right, 2], normal[:, right, 0] = 1, 1
    position = np.zeros((height, width, 3), np.float32)
    position[..., 0], position[..., 1] = x, ((np.arange(height) + 0.5) / height)[:, None]
    return Guides.of(normal, position, np.ones(shape, np.float32), np.full_like(normal, 0.5), np.zeros_like(normal))


def interpolated(build, shape, factor, side, values):
    """`values` of a picture of so many times fewer pixels, of `flat`, in one of that shape."""
    camera = build.camera(width=shape[1], height=shape[0])
    small = reduced(camera, factor)
    out = np.zeros((*shape, 1), np.float32)
    width = np.full(shape, 1 / small.width, np.float32)
    found = values(small.height, small.width)
    for top in range(0, shape[0], LINES):
        _interpolate(
            flat(shape, side), flat(found.shape[:2], side), found, _place(small, camera), width, top, min(top + LINES, shape[0]), out
        )
    return out[..., 0]


@pytest.mark.parametrize("factor", [1.5, 2.0, 3.7])
def test_light_stays_on_its_side_of_an_edge(build, factor):
    def values(height, width):
        light = np.ones((height, width, 1), np.float32)
        light[:, (np.arange(width) + 0.5) / width > 0.52] = 5
        return light

    found = interpolated(build, (40, 60), factor, 0.52, values)
    right = (np.arange(60) + 0.5) / 60 > 0.52
    assert found[:, ~right] == pytest.approx(np.ones((40, (~right).sum())), abs=0.03)
    assert found[:, right] == pytest.approx(np.full((40, right.sum()), 5.0), abs=0.03)


@pytest.mark.parametrize("factor", [1.5, 2.0, 3.7])
def test_a_gradient_is_a_gradient_and_lies_where_it_lay(build, factor):
    def values(height, width):
        return np.broadcast_to(((np.arange(width) + 0.5) / width)[None, :, None], (height, width, 1)).astype(np.float32)

    found = interpolated(build, (40, 60), factor, 2.0, values)
    x = (np.arange(60) + 0.5) / 60
    inside = (x > 0.2) & (x < 0.8)
    assert np.abs(found[:, inside] - x[inside]).max() < 0.25 * factor / 60
    assert abs((found[:, inside] - x[inside]).mean()) < 0.02 * factor / 60


def test_places_of_a_border(build):
    camera = replace(build.camera(width=640, height=360), border=(100, 50, 500, 250))
    small = reduced(camera, 2.0)
    down, across, top, left = _place(small, camera)
    assert (down, across) == (0.5, 0.5)
    # The middle of the first pixel of the border is a quarter of a small one beyond the small border's first edge.
    assert (top, left) == (-0.25, -0.25)


def lit(budget, build, size=(640, 360)):
    camera = build.camera(width=size[0], height=size[1])
    planner = Planner(RenderSettings(time_budget=budget).with_defaults(), size[0] * size[1], MACHINE)
    return planner, camera, planner.lit_camera(camera, 0.1)


def test_what_fits_is_lit_whole(build):
    planner, camera, small = lit(30.0, build)
    assert small is camera and planner.lit is None and planner.pixels == 640 * 360


def test_the_less_time_the_fewer_pixels_are_lit(build):
    whole = lit(30.0, build)[0]._seconds_of(640 * 360, QUICKEST)
    numbers = []
    for part in (0.9, 0.6, 0.4):
        planner, camera, small = lit(part * whole, build)
        assert planner.pixels == np.prod(sides(small)) < 640 * 360
        assert planner.lit == sides(small) and "enlarged" in planner.reasons[-1]
        assert small.window == camera.window
        assert 0.1 + planner._seconds_of(planner.pixels) < part * whole
        assert planner.first(0.2) >= LEAST
        numbers.append(planner.pixels)
    assert numbers == sorted(numbers, reverse=True) and numbers[0] > numbers[2]


def test_a_picture_does_not_vanish(build):
    _, _, small = lit(0.01, build)
    assert min(sides(small)) >= FEWEST
    assert lit(0.01, build, (FEWEST, FEWEST))[0].lit is None


def test_a_furnace_without_time_is_as_bright_as_it_is(sphere, no_time):
    settings = RenderSettings(time_budget=0.2, vpls=512)
    result = render(sphere, settings)
    auto = result.stats["auto"]
    assert auto["lit"] and auto["lit"][0] < 96 and result.stats["size"] == [96, 64]
    json.dumps(auto, allow_nan=False)
    layers = result.layers
    assert {layer.shape[:2] for layer in layers.values()} == {(64, 96)}
    np.testing.assert_allclose(layers["Direct"] + layers["Indirect"] + layers["Emission"], layers["Combined"], rtol=1e-5)
    exact = np.pi * sum(0.5**k for k in range(1, 5))
    assert float(layers["Irradiance"].mean()) == pytest.approx(exact, rel=0.05)
    assert float(np.abs(layers["Irradiance"] / exact - 1).max()) < 0.5
    assert float(layers["Emission"].min()) == pytest.approx(1)


def test_a_transparent_film_has_the_alpha_of_the_whole_picture(build, no_time):
    ball = build.geometry(*build.icosphere(3, inward=False))
    wide = build.scene(ball, build.materials((0.5, 0.0)), world=(1, 1, 1), camera=build.camera(width=64, height=64, position=(0, 0, 3)))
    settings = RenderSettings(vpls=512, film=Film(transparent=True))
    quick = render(wide, replace(settings, time_budget=0.2))
    assert quick.stats["auto"]["lit"]
    alpha, exact = quick.layers["Combined"][..., 3], render(wide, settings).layers["Combined"][..., 3]
    assert np.abs(alpha - exact).mean() < 0.02


def test_a_quick_scene_is_lit_whole_after_all(build):
    whole = lit(30.0, build)[0]._seconds_of(640 * 360)
    planner, camera, _ = lit(0.5 * whole, build)
    assert planner.larger_camera(camera, 0.1) is None  # nothing was seen yet that would say so
    planner.observe(LEAST, 0.02 * planner.cost.seconds(planner.pixels, LEAST))
    assert planner.larger_camera(camera, 0.15) is camera
    assert planner.lit is None and planner.pixels == 640 * 360


def test_a_scene_as_slow_as_foreseen_stays_as_it_is(build):
    whole = lit(30.0, build)[0]._seconds_of(640 * 360)
    planner, camera, small = lit(0.5 * whole, build)
    seconds = planner.cost.seconds(planner.pixels, LEAST)
    planner.observe(LEAST, seconds)
    assert planner.larger_camera(camera, 0.2 + seconds) is None
    assert planner.lit == sides(small)


def test_what_is_next_to_enlarging_is_left_of_a_budget(build):
    whole = lit(30.0, build)[0]._seconds_of(640 * 360)
    planner, *_ = lit(0.5 * whole, build)
    assert planner.finishing(LEAST) > planner.denoising_seconds("fast")
    assert planner.denoising_quality(LEAST, planner.settings.time_budget, "fast") == "fast"


@pytest.fixture(scope="module")
def stripes(build):
    """A floor in the slanting light of a sun of half a degree, under a grating of eight bars just above it."""
    floor = build.quads([(-2, -2, -2), (2, -2, -2), (2, 2, -2), (-2, 2, -2)])
    bars = build.quads(*([(x, -0.8, -1.9), (x + 0.1, -0.8, -1.9), (x + 0.1, 0.8, -1.9), (x, 0.8, -1.9)] for x in np.linspace(-0.8, 0.7, 8)))
    slant = np.array([0.6, 0.0, 0.8])
    axes = np.stack([(0.8, 0, -0.6), (0, 1, 0), slant], axis=1)
    sun = build.lamp(SUN, (3.0, 3.0, 3.0), axes=axes, angle=np.radians(0.5))
    geometry = build.geometry(*build.join((*floor, 0), (*bars, 1)))
    return build.scene(geometry, build.materials((0.5, 0.0), (0.5, 0.0)), lamps=sun, camera=build.camera(width=96, height=96, angle=0.9))


@pytest.mark.parametrize("method", ["fuzzy-clustering", "importance-sampling"])
def test_downsampling_leaves_the_shadows_of_small_lamps_sharp(stripes, method):
    settings = RenderSettings(method=method, vpls=256, vpl_clusters=64, point_clusters=200, pixel_samples=4, seed=1)
    whole, small = (render(stripes, replace(settings, downsampling=factor)) for factor in (1, 4))
    assert small.stats["size"] == [96, 96] and small.stats["rays"]["shadow"] < whole.stats["rays"]["shadow"]
    sharp, found = whole.layers["Direct"], small.layers["Direct"]
    # .023; .27 where shadows come from 24 x 24 pixels, .027 by another seed of all pixels.
    assert np.abs(found - sharp).mean() < 0.05 * sharp.mean()
    assert found.mean() == pytest.approx(float(sharp.mean()), rel=0.02)
    assert small.layers["Indirect"].mean() == pytest.approx(float(whole.layers["Indirect"].mean()), rel=0.1)
    combined = small.layers["Direct"] + small.layers["Indirect"] + small.layers["Emission"]
    np.testing.assert_allclose(combined, small.layers["Combined"], rtol=1e-5)


def test_penumbras_are_where_the_lit_part_changes():
    part = np.array([[1, 1, 1, 0.5, 0, 0, 0, 0], [1, 1, 1, 0.5, 0, 0, 0, 0]], float)
    clear = np.array([[2, 3, 2, 2, 2, 2, 0, 1], [2, 3, 2, 2, 2, 2, 0, 1]], float)  # no light at all in the last but one
    pixel = np.arange(16).repeat(2)  # two points a pixel
    found = in_penumbras((part * clear).ravel().repeat(2), clear.ravel().repeat(2), pixel, (2, 8)).reshape(2, 8)
    assert found.tolist() == 2 * [[False, False, True, True, True, False, False, False]]
    even = in_penumbras(np.full(16, 0.5), np.ones(16), np.arange(16), (2, 8))
    assert not even.any()


def test_a_furnace_of_fewer_pixels_is_as_bright_as_it_is(sphere):
    result = render(
        sphere, RenderSettings(method="fuzzy-clustering", downsampling=3, vpls=512, vpl_clusters=128, point_clusters=200, seed=1)
    )
    assert float(result.layers["Irradiance"].mean()) == pytest.approx(np.pi * sum(0.5**k for k in range(1, 5)), rel=0.02)


def test_as_few_pixels_are_lit_as_are_asked_for(build):
    camera = build.camera(width=480, height=270)
    planner = Planner(RenderSettings(downsampling=3).with_defaults(), 480 * 270, None)
    assert sides(planner.lit_camera(camera, 0.1)) == (160, 90) == planner.lit
    assert "160x90" in planner.reasons[-1] and planner.larger_camera(camera, 0.2) is None
    assert planner.first(0.2) == 1.0


@pytest.mark.parametrize("goal", [{"time_budget": 30.0}, {"target_error": 0.01}])
def test_a_goal_decides_alone_how_many_pixels_are_lit(build, goal):
    camera = build.camera(width=480, height=270)
    planner = Planner(RenderSettings(downsampling=3, **goal).with_defaults(), 480 * 270, MACHINE)
    assert planner.lit_camera(camera, 0.1) is camera and planner.lit is None


def test_a_picture_of_few_pixels_does_not_vanish(build):
    camera = build.camera(width=2 * FEWEST, height=FEWEST)
    planner = Planner(RenderSettings(downsampling=8).with_defaults(), 2 * FEWEST**2, None)
    assert sides(planner.lit_camera(camera, 0.1)) == (2 * FEWEST, FEWEST) and planner.lit is None


def test_a_view_of_nothing_needs_no_light(stripes, build):
    away = replace(stripes, camera=build.camera(position=(0, 0, -9), width=64, height=48))
    assert not render(away, RenderSettings(method="fuzzy-clustering", downsampling=2, vpls=32)).layers["Combined"].any()


def test_debug_layers_are_of_all_pixels(stripes):
    settings = RenderSettings(method="fuzzy-clustering", vpls=32, vpl_clusters=16, point_clusters=50, pixel_samples=1)
    result = render(stripes, replace(settings, debug_layers=True, downsampling=2))
    assert result.layers["PointClusters"].shape[:2] == (96, 96)
    assert any("downsampling" in line for line in result.stats["warnings"])
