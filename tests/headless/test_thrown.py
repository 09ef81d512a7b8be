"""Low sun on a polished floor against Cycles: what the floor throws on the walls is seen again in it."""

import hashlib
import math
from pathlib import Path

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.cache import cached_halves
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material, quad

SIZE = (48, 27)
SPP = 1024
SEEDS = 6
PARTS = {"left": np.s_[:9, :16], "far": np.s_[:9, 16:32], "right": np.s_[:9, 32:]}  # of the picture, floor apart


def room(walls=None):
    """A long room with a semi-gloss floor; sun comes in by the window behind the camera.  walls: their inputs, None for dull ones."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    wall = material("Wall", Base_Color=(0.7, 0.7, 0.7, 1), **(walls or {"Specular_IOR_Level": 0.0}))
    floor = material("Floor", Base_Color=(0.5, 0.5, 0.5, 1), Roughness=0.3)
    quad(scene, [(-2.5, 0, 0), (2.5, 0, 0), (2.5, 8, 0), (-2.5, 8, 0)], floor)
    quad(scene, [(-2.5, 0, 3), (-2.5, 8, 3), (2.5, 8, 3), (2.5, 0, 3)], wall)
    quad(scene, [(-2.5, 8, 0), (2.5, 8, 0), (2.5, 8, 3), (-2.5, 8, 3)], wall)
    for x in (-2.5, 2.5):
        quad(scene, [(x, 0, 0), (x, 8, 0), (x, 8, 3), (x, 0, 3)], wall)
    for x0, x1, z0, z1 in ((-2.5, 2.5, 0, 0.8), (-2.5, 2.5, 2.4, 3), (-2.5, -1, 0.8, 2.4), (1, 2.5, 0.8, 2.4)):
        quad(scene, [(x0, 0, z0), (x1, 0, z0), (x1, 0, z1), (x0, 0, z1)], wall)
    lamp(scene, "SUN", (0, 0, 0), (math.radians(65), 0, 0), energy=5.0, angle=math.radians(0.5))
    look(scene, (0, 0.3, 1.6), (math.radians(80), 0, 0), lens=24.0)
    return scene


@pytest.mark.slow
def test_floor_shows_what_it_throws_on_the_walls():
    scene = room()
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest()}
    halves = cached_halves(scene, identity, size=SIZE, spp=SPP, bounces=4, seed=1)
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(seed=seed, denoise=False)).layers for seed in range(SEEDS)]
    for name, bound in {"DiffuseIndirect": 0.015, "GlossyIndirect": 0.05}.items():
        expected = np.mean([half[name].mean(dtype=float) for half in halves])
        found = [layers[name].mean(dtype=float) / expected - 1 for layers in ours]
        noise = np.std(found, ddof=1) / math.sqrt(SEEDS) + abs(halves[0][name].mean() - halves[1][name].mean()) / 2 / expected
        # Without `thrown` -3.4 and -28 %.
        assert abs(np.mean(found)) < bound + 2 * noise, (name, np.mean(found), noise)
        assert noise < bound, (name, noise)


def test_wide_lobes_show_what_the_floor_throws_at_them():
    """Spread as by a dull floor, of one bounce the far wall showed a quarter of it, the others a sixth too much."""
    scene = room({"Roughness": 0.8})
    arrays = extract_scene(scene, size=SIZE)
    reference, _ = render_layers(scene, ReferenceSettings(spp=1024, size=SIZE, bounces=1))
    expected = reference["GlossyIndirect"].mean(axis=-1)
    ours = [
        render(arrays, RenderSettings(method="importance-sampling", bounces=1, seed=seed, denoise=False)).layers for seed in range(SEEDS)
    ]
    found = np.stack([layers["GlossyIndirect"].mean(axis=-1) for layers in ours])
    for name, part in PARTS.items():
        ratio = found[:, *part].mean(axis=(1, 2)) / expected[part].mean()
        noise = ratio.std(ddof=1) / math.sqrt(SEEDS)
        assert noise < 0.03, (name, noise)
        assert float(ratio.mean()) == pytest.approx(1, abs=0.07 + 2 * float(noise)), name


@pytest.mark.parametrize("roughness", [0.55, 0.9])
def test_ceiling_shows_what_a_rough_floor_throws_where_it_throws_it(roughness):
    """Spread as by a diffuse floor, or by lights about the directions in which particles fly on, the far end was 12 % too dark."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    floor = material("Floor", Base_Color=(0.2, 0.2, 0.2, 1), Roughness=roughness)
    quad(scene, [(-0.8, -0.8, 0), (0.8, -0.8, 0), (0.8, 0.8, 0), (-0.8, 0.8, 0)], floor)
    ceiling = material("Ceiling", Base_Color=(0.5, 0.5, 0.5, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-7, -7, 2.5), (-7, 7, 2.5), (7, 7, 2.5), (7, -7, 2.5)], ceiling)
    down = math.radians(32)
    towards = (0, math.pi / 2 - down, 0)
    lamp(
        scene,
        "SPOT",
        (3 * math.cos(down), 0, 3 * math.sin(down)),
        towards,
        energy=1000.0,
        spot_size=math.radians(10),
        shadow_soft_size=0.02,
    )
    look(scene, (0, 0, 0.9), (math.pi, 0, 0), lens=8.4)
    size = (96, 16)
    reference, _ = render_layers(scene, ReferenceSettings(spp=1024, size=size, bounces=1))
    arrays = extract_scene(scene, size=size)
    ours = [render(arrays, RenderSettings(method="importance-sampling", bounces=1, seed=seed)).layers for seed in range(4)]
    found, expected = (
        light.mean(axis=-1).mean(axis=0).reshape(12, 8).mean(axis=1)
        for light in (np.mean([layers["DiffuseIndirect"] for layers in ours], axis=0), reference["DiffuseIndirect"])
    )
    np.testing.assert_allclose(found, expected, rtol=0.04)
