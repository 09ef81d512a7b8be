"""Whole renders of a dozen pixels, small enough for kernels that run as plain Python (`tests/plain.py`), against the float64 path tracer."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.pipeline import render
from lumigate.core.reuse import Sequence
from lumigate.core.settings import RenderSettings, SequenceSettings
from lumigate.core.surfaces.layout import TRANSPARENCY
from lumigate.headless.stress import arrays, rooms
from lumigate.headless.stress.path_tracer import path_traced

SIZE = (4, 3)
PATHS = 1500  # of the oracle: its standard error is a thirtieth of the indirect light
SETTINGS = RenderSettings(
    vpls=128, bounces=2, pixel_samples=1, direct_samples=2, samples=4, gather=2, reflections=1, vals=1, voxels=16, vpl_clusters=4,
    point_clusters=4, fuzziness=2, interleave=2, denoise=False, threads=1, seed=3,
)  # fmt: skip
WAYS = {
    "shadow rays": {"method": "instant-radiosity"},
    "fuzzy clusters": {"method": "fuzzy-clustering"},
    "area lights": {"method": "virtual-area-lights"},
    "disks": {"method": "visibility-gates"},
    "polygons": {"method": "visibility-gates", "gates": "polygons"},
    "guided rays": {"method": "visibility-gates", "gates": "guided"},
    "sampled": {"method": "importance-sampling"},
}


def radiance(scene, **changes) -> np.ndarray:
    """Mean Direct and Indirect radiance of a picture, (2,)."""
    layers = render(scene, replace(SETTINGS, **changes)).layers
    assert all(np.isfinite(layer).all() for layer in layers.values())
    return np.array([layers[name].mean(dtype=float) for name in ("Direct", "Indirect")])


@pytest.fixture(scope="module")
def room():
    """The room of the stress cases, lit by its lamp."""
    return rooms.room(size=SIZE)


@pytest.fixture(scope="module")
def truth(room):
    """Its light and the standard error of that, (2,) each, by the path tracer."""
    mean, variance = path_traced(room, SETTINGS.bounces, PATHS, 1)
    return mean, variance**0.5


@pytest.mark.parametrize("way", WAYS)
def test_the_light_is_the_path_tracers(room, truth, way):
    mean, error = truth
    found = radiance(room, **WAYS[way])
    assert np.all(np.abs(found - mean) < 3 * error + (0.05, 0.12) * mean), (found, mean, error)


def test_shadow_maps_see_what_shadow_rays_see(room):
    # Neither gives back what the clamp takes.
    by_maps = radiance(room, method="instant-radiosity", visibility="shadow-maps")
    by_rays = radiance(room, method="instant-radiosity", compensation=False)
    np.testing.assert_allclose(by_maps, by_rays, rtol=0.2)


def yard() -> sc.Scene:
    """The room without a ceiling, under a grey sky, with lamps of every kind and a shining triangle."""
    down = np.diag([1.0, 1.0, 1.0])
    lit = (
        arrays.lamp(sc.SUN, 0.4, axes=down, angle=0.0),
        arrays.lamp(sc.SPOT, 0.5, (0.5, 0.5, 0.8), axes=down, angle=1.2, blend=0.5),
        arrays.lamp(sc.AREA, 0.3, (-0.6, 0.6, 0.6), axes=down, size=(0.4, 0.3)),
        arrays.lamp(sc.POINT, 0.05, (0.4, -0.5, 0.2)),
    )
    shining = (np.array([(0.95, -0.4, -0.8), (0.95, 0.4, -0.8), (0.95, 0.0, 0.0)]), np.array([[0, 2, 1]]), 4)
    mesh = rooms.room_mesh()
    open_room = (mesh[0], np.delete(mesh[1], (10, 11), axis=0), np.delete(mesh[2], (10, 11)))
    return arrays.scene(
        arrays.geometry(*arrays.join(open_room, shining)),
        arrays.materials(*((albedo, 0.0) for albedo in rooms.WALLS), (0.5, 0.6)),
        lamps=arrays.lamps(*lit),
        world=(0.2, 0.2, 0.2),
        camera=rooms.view(size=SIZE),
    )


@pytest.mark.parametrize("changes", [{}, {"method": "importance-sampling"}, {"soft_shadows": True}, {"skipping": False}], ids=str)
def test_the_light_of_every_lamp_is_the_path_tracers(changes):
    scene = yard()
    mean, variance = path_traced(scene, SETTINGS.bounces, PATHS, 1)
    scene.world.radiance = np.repeat(np.repeat(scene.world.radiance, 4, 0), 8, 1)  # an image for the core, which samples it
    found = radiance(scene, **({"method": "instant-radiosity", "direct_samples": 8} | changes))
    assert np.all(np.abs(found - mean) < 3 * variance**0.5 + (0.12, 0.12) * mean), (found, mean, variance**0.5)


@pytest.mark.parametrize("method", ["instant-radiosity", "importance-sampling"])
def test_glossy_walls_lose_no_light(method):
    # All walls shine with radiance 1, so that m diffuse and any number of glossy reflections give d^m / (1 - g)^(m + 1).
    d, g = 0.4, 0.2
    walls = arrays.geometry(*arrays.box((-1, -1, -1), (1, 1, 1)))
    scene = arrays.scene(walls, arrays.glossy_materials((d, 1.0), albedo=g, roughness=0.5), camera=rooms.view(size=SIZE))
    settings = replace(SETTINGS, method=method, vpls=64, direct_samples=8, reflections=8)
    pictures = [render(scene, replace(settings, seed=seed)).layers for seed in range(3)]  # one deviates by 7 to 10 %
    irradiance, glossy = (np.mean([layers[name] for layers in pictures]) for name in ("Irradiance", "GlossyIndirect"))
    terms = [(d + g) * d**m / (1 - g) ** (m + 1) for m in range(settings.bounces + 1)]
    assert irradiance == pytest.approx(np.pi * sum(terms[: settings.bounces]), rel=0.15)
    assert glossy == pytest.approx(g * sum(terms), rel=0.15)


@pytest.mark.parametrize("way", ["shadow rays", "fuzzy clusters", "sampled"])
def test_a_pane_of_nothing_changes_nothing(room, way):
    pane = (*arrays.quads([(-1, -1, 0.3), (1, -1, 0.3), (1, 1, 0.3), (-1, 1, 0.3)]), 4)
    scene = rooms.room(size=SIZE, albedos=(*rooms.WALLS, (0, 0, 0)), extra=(pane,))
    tables = scene.materials.tables
    tables.constant[4, TRANSPARENCY : TRANSPARENCY + 3] = 1
    tables.flags[4] |= sc.TRANSPARENT
    np.testing.assert_allclose(radiance(scene, **WAYS[way]), radiance(room, **WAYS[way]), rtol=0.15)


def test_the_lights_of_groups_add_up(room):
    lamps = arrays.lamps(room.lamps, rooms.bulb(power=0.5, position=(-0.7, -0.6, 0.5)))
    lamps.groups = ["key", "fill"]
    both = replace(room, lamps=lamps, light_groups=("key", "fill"))
    layers = render(both, replace(SETTINGS, method="importance-sampling")).layers
    for name in ("Direct", "Indirect"):
        np.testing.assert_allclose(layers[f"{name}_key"] + layers[f"{name}_fill"], layers[name], rtol=1e-4, atol=1e-7)
        assert layers[f"{name}_fill"].mean() > 0
    alone = render(room, replace(SETTINGS, method="importance-sampling")).layers
    assert layers["Indirect_key"].mean() == pytest.approx(alone["Indirect"].mean(), rel=0.3)


@pytest.mark.parametrize("way", ["shadow rays", "fuzzy clusters", "area lights", "disks"])
def test_debug_layers_leave_the_light_as_it_is(room, way):
    plain, shown = (render(room, replace(SETTINGS, debug_layers=wanted, **WAYS[way])).layers for wanted in (False, True))
    assert len(shown) > len(plain)
    for name, layer in shown.items():
        assert np.isfinite(layer).all()
        if name in plain:
            np.testing.assert_array_equal(layer, plain[name])


def test_frames_at_rest_become_their_mean(room):
    settings = replace(SETTINGS, method="importance-sampling")
    with Sequence(SequenceSettings(history=2), moving=[]) as sequence:
        frames = [render(sequence.begin(room, i), settings, sequence=sequence).layers["Indirect"] for i in range(5)]
    np.testing.assert_allclose(frames[4], frames[3], rtol=1e-3, atol=1e-6)
