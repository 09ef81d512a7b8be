"""What polished dielectrics reflect has a direction, which neither gather rays nor reflections lose that look surfaces up, as in Cycles."""

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material, quad

SIZE = (48, 24)
SEEDS = 8


def compared(scene, layer, spp, quality=1):
    """Light in a layer after one bounce, mean of the channels: ours of several seeds, (SEEDS, H, W), and Cycles', (H, W)."""
    reference, _ = render_layers(scene, ReferenceSettings(spp=spp, size=SIZE, bounces=1))
    arrays = extract_scene(scene, size=SIZE)
    settings = RenderSettings(method="importance-sampling", bounces=1, denoise=False).with_defaults().scaled(quality, 0)
    ours = [render(arrays, replace(settings, seed=seed)).layers for seed in range(SEEDS)]
    return np.stack([layers[layer].mean(axis=-1) for layers in ours]), reference[layer].mean(axis=-1)


def check(found, expected, bound):
    """The mean of a few pictures' light (SEEDS,) is the one expected up to a bound and twice the noise, which is no more than the bound."""
    ratio = found / expected
    noise = ratio.std(ddof=1) / math.sqrt(SEEDS)
    assert noise < bound
    assert float(ratio.mean()) == pytest.approx(1, abs=bound + 2 * float(noise))


def test_wall_is_lit_by_way_of_a_polished_floor():
    """What the floor mirrors of a bright wall lies where mirrored light falls, behind a board that hides the bright wall itself."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    wall = material("Wall", Base_Color=(0.8, 0.8, 0.8, 1), Specular_IOR_Level=0.0)
    floor = material("Floor", Base_Color=(0.05, 0.05, 0.05, 1), Roughness=0.2, Specular_IOR_Level=1.0)
    black = material("Board", Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-4, -6, 0), (4, -6, 0), (4, 6, 0), (-4, 6, 0)], floor)
    quad(scene, [(-4, -6, 0), (-4, 6, 0), (-4, 6, 4), (-4, -6, 4)], wall)
    quad(scene, [(4, -6, 0), (4, -6, 4), (4, 6, 4), (4, 6, 0)], wall)
    quad(scene, [(0, -6, 0.7), (0, 6, 0.7), (0, 6, 9), (0, -6, 9)], black)
    lamp(scene, "SPOT", (-0.5, 0, 3), (0, math.radians(90), 0), energy=2000.0, spot_size=math.radians(40), shadow_soft_size=0.05)
    look(scene, (1, 0, 2), (math.radians(90), 0, math.radians(-90)), type="ORTHO", ortho_scale=8.0)
    found, expected = compared(scene, "DiffuseIndirect", 2048, 4)
    for part in (np.s_[:8], np.s_[8:16]):
        check(found[:, part].mean(axis=(1, 2)), expected[part].mean(), 0.05)


def test_rough_floor_shows_varnish_without_the_highlight_that_flies_over_it():
    """A lamp on the floor lights a board; spread as by a diffuse board, what flies up from it stood in for what the floor sees."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    floor = material("Floor", Base_Color=(0, 0, 0, 1), Roughness=0.6)
    board = material("Board", Base_Color=(0.05, 0.05, 0.05, 1), Roughness=0.2)
    quad(scene, [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)], floor)
    quad(scene, [(-3, 3, 0.1), (3, 3, 0.1), (3, 3, 3), (-3, 3, 3)], board)
    lamp(scene, "AREA", (0, 1.5, 0.02), (math.radians(135), 0, 0), energy=200.0, size=0.4, seen=False)
    look(scene, (0, -3, 2.0), (math.radians(60), 0, 0), lens=24.0)
    found, expected = compared(scene, "GlossyIndirect", 1024)
    check(found.mean(axis=(1, 2)), expected.mean(), 0.08)


def test_board_shows_the_highlight_of_a_rough_floor_to_the_floor():
    """Of the lamp's light that flies from a floor to a glossy board and back a half was missing: it was spread as by a diffuse floor."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    floor, board = (material(name, Base_Color=(0, 0, 0, 1), Roughness=roughness) for name, roughness in (("Floor", 0.7), ("Board", 0.2)))
    quad(scene, [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)], floor)
    quad(scene, [(-3, 3, 0.1), (3, 3, 0.1), (3, 3, 3), (-3, 3, 3)], board)
    lamp(scene, "AREA", (0, -1, 0.8), (math.radians(70), 0, 0), energy=200.0, size=0.6, seen=False)
    look(scene, (0, -3, 2.0), (math.radians(70), 0, 0), lens=24.0)
    found, expected = compared(scene, "GlossyIndirect", 1024)
    check(found.mean(axis=(1, 2)), expected.mean(), 0.08)
