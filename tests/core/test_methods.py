"""What every method must fulfil: closed forms, layers that add up, the same bits for any number of threads."""

import numpy as np
import pytest

from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.core.stages import AVAILABLE as METHODS
from lumigate.core.surfaces import lobes


@pytest.fixture(scope="module")
def sphere(build):
    """A closed sphere, radiance 1 W/m^2/sr, albedo 0.5, seen from its middle."""
    return build.scene(build.geometry(*build.icosphere(4)), build.materials((0.5, 1.0)), camera=build.camera(width=24, height=24))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("bounces", [1, 2, 4, 32])
def test_sphere_interior(sphere, method, bounces):
    # Every point of the wall sees radiance 1 everywhere: direct pi, and rho^k pi more after k bounces.
    settings = RenderSettings(method=method, vpls=512, bounces=bounces, pixel_samples=1, direct_samples=16, seed=3)
    layers = render(sphere, settings).layers
    expected = np.pi * sum(0.5**k for k in range(1, bounces + 1))
    assert layers["Irradiance"].mean() == pytest.approx(expected, rel=0.005)


def drawn_from_lobe(d, g, roughness):
    """Parts of the glossy and of the diffuse light of one radiance, seen at right angles, whose directions Cycles draws from the lobe."""
    row = np.zeros(lobes.LOBE, np.float32)
    up = np.float32([0, 0, 1])
    lobes.set_lobe(row, *up, *up, *up, *np.float32([roughness] + 6 * [g]))
    angle = np.geomspace(1e-6, np.pi / 2, 20000)
    values = np.array([lobes.lobe_value(row, np.float32(np.sin(a)), np.float32(0), np.float32(np.cos(a))) for a in angle], np.float64)
    diffuse = np.cos(angle) / np.pi
    share = row[lobes.ALBEDO] * values[:, 3] / np.maximum(row[lobes.ALBEDO] * values[:, 3] + d * diffuse, 1e-20)
    ring = np.sin(angle) * np.gradient(angle)
    return [np.average(share, weights=lit * ring) for lit in (values[:, 0], diffuse)]


@pytest.mark.parametrize(
    ("method", "bounces", "roughness"),
    [(method, *case) for method in METHODS for case in [(1, 0.05), (4, 0.6)]]
    + [("importance-sampling", *case) for case in [(1, 0.6), (4, 0.05)]],
)
def test_glossy_sphere_interior(build, method, bounces, roughness):
    # Diffuse albedo d and glossy albedo g: only diffuse reflections count, so that m of them stand for the sum
    # over all numbers of glossy ones between them, d^m / (1 - g)^(m + 1), times d + g for the first after the light.
    # The first reflection counts, too, unless its direction would be drawn from the lobe.
    d, g = 0.4, 0.2
    scene = build.scene(
        build.geometry(*build.icosphere(4)),
        build.glossy_materials((d, 1.0), albedo=g, roughness=roughness),
        camera=build.camera(width=24, height=24),
    )
    # Those of virtual area lights are the first of their sequence, not the best of eight times as many: more noise from as many.
    vpls = 4096 if method == "virtual-area-lights" else 1024
    # Pictures of one seed deviate by .8 %, of narrow lobes by .4 %.
    seeds = 8 if method == "importance-sampling" and roughness > 0.1 else 4
    pictures = [
        render(
            scene, RenderSettings(method=method, vpls=vpls, bounces=bounces, pixel_samples=1, direct_samples=16, reflections=8, seed=seed)
        ).layers
        for seed in range(seeds)
    ]
    irradiance, glossy = (np.mean([layers[name] for layers in pictures]) for name in ("Irradiance", "GlossyIndirect"))
    terms = [(d + g) * d**m / (1 - g) ** (m + 1) for m in range(bounces + 1)]
    of_glossy, of_diffuse = drawn_from_lobe(d, g, roughness)
    # Virtual lights alone, as of the other methods, cannot tell directions apart.
    of_diffuse *= method == "importance-sampling"
    # Each bounce is followed through its glossy reflections, the last one, too: without, importance sampling loses 1 % after four.
    lost = 0.006 if method == "importance-sampling" and bounces == 4 else 0.01
    assert irradiance == pytest.approx(np.pi * (sum(terms[:bounces]) + of_diffuse * terms[bounces]), rel=lost)
    assert glossy == pytest.approx(g * (sum(terms[:bounces]) + of_glossy * terms[bounces]), rel=0.02)


def test_sphere_interior_direct(sphere):
    # Thousands of emissive triangles, some at a grazing hair's breadth: noisy, so many samples.
    layers = render(
        sphere, RenderSettings(method="instant-radiosity", vpls=8, bounces=1, pixel_samples=1, direct_samples=1024, seed=3)
    ).layers
    assert layers["Direct"].mean() * np.pi / 0.5 == pytest.approx(np.pi, rel=0.005)


@pytest.mark.parametrize("method", METHODS)
def test_layers_add_up(sphere, method):
    layers = render(sphere, RenderSettings(method=method, vpls=64, pixel_samples=4)).layers
    total = layers["Direct"] + layers["Indirect"] + layers["Emission"]
    assert np.allclose(layers["Combined"], total, rtol=1e-6)
    assert np.allclose(layers["Indirect"], layers["DiffuseIndirect"] + layers["GlossyIndirect"], rtol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_same_bits_for_any_number_of_threads(sphere, method):
    a, b = (render(sphere, RenderSettings(method=method, vpls=128, pixel_samples=4, threads=threads, seed=7)).layers for threads in (1, 3))
    assert all(np.array_equal(a[name], b[name]) for name in a)


@pytest.mark.parametrize("method", METHODS)
def test_seeds_differ_and_agree_in_the_mean(sphere, method):
    a, b = (
        render(sphere, RenderSettings(method=method, vpls=256, pixel_samples=4, seed=seed)).layers["DiffuseIndirect"] for seed in (1, 2)
    )
    assert not np.array_equal(a, b)
    assert a.mean() == pytest.approx(b.mean(), rel=0.01)


@pytest.mark.parametrize("method", METHODS)
def test_no_light_and_no_albedo_are_skipped_not_computed(build, method):
    dark = build.scene(build.geometry(*build.icosphere(1)), build.materials((0.5, 0.0)))
    black = build.scene(build.geometry(*build.icosphere(1)), build.materials((0.0, 1.0)))
    for scene in (dark, black):
        result = render(scene, RenderSettings(method=method, vpls=64, pixel_samples=1))
        assert not result.layers["Indirect"].any()
        assert any(s["stage"] == "vpls" for s in result.stats["skipped"])
        assert result.stats["rays"]["light"] < 5000


@pytest.mark.parametrize("method", METHODS)
def test_a_scene_of_nothing_but_metal(build, method):
    # Light that only glossy lobes pass on: without a diffuse albedo in view there is no light to draw VPLs for.
    g = 0.5
    scene = build.scene(build.geometry(*build.icosphere(3)), build.glossy_materials((0.0, 1.0), albedo=g, roughness=0.4))
    seen = [
        render(scene, RenderSettings(method=method, vpls=256, pixel_samples=1, reflections=8, seed=seed, denoise=False)).layers
        for seed in range(10)
    ]
    assert not any(layers["DiffuseIndirect"].any() for layers in seen)
    # All that is reflected twice and more; one seed has a deviation of .02.
    assert float(np.mean([layers["GlossyIndirect"] for layers in seen])) == pytest.approx(g * g / (1 - g), abs=0.02)
