"""Floors that show light from one side more than from another, as bumps and clay do, lit by way of a low wall, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material, quad

SIZE = (16, 9)
SEEDS = 4


def bumps(x, y, **inputs):
    """A material whose normal leans towards (x, y)."""
    made = material("Bumps", **{"Base_Color": (0.5, 0.5, 0.5, 1), "Specular_IOR_Level": 0.0} | inputs)
    lean = made.node_tree.nodes.new("ShaderNodeNormalMap")
    lean.space = "WORLD"
    lean.inputs["Color"].default_value = (0.5 + x, 0.5 + y, 0.9, 1)
    made.node_tree.links.new(lean.outputs[0], made.node_tree.nodes["Principled BSDF"].inputs["Normal"])
    return made


def clay():
    made = material("Clay", Base_Color=(0.5, 0.5, 0.5, 1), Specular_IOR_Level=0.0)
    made.node_tree.nodes["Principled BSDF"].inputs["Diffuse Roughness"].default_value = 1.0
    return made


FLOORS = {"bumps to the wall": lambda: bumps(0, 0.3), "bumps aside": lambda: bumps(0.3, 0), "clay": clay}


def before_a_wall(floor):
    """A floor of such a material before a low wall, on which alone the sun shines."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    quad(scene, [(-9, -9, 0), (9, -9, 0), (9, 3, 0), (-9, 3, 0)], floor())
    white = material("White", Base_Color=(0.8, 0.8, 0.8, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-9, 3, 0), (9, 3, 0), (9, 3, 0.6), (-9, 3, 0.6)], white, seen=False)
    lamp(scene, "SUN", (0, 0, 0), (math.pi / 2, 0, 0), energy=3.0)  # along the floor
    look(scene, (0, -4, 2.5), (math.radians(58), 0, 0), lens=85)
    return scene


@pytest.mark.parametrize("floor", FLOORS)
def test_indirect_light_counts_by_where_it_comes_from(floor):
    scene = before_a_wall(FLOORS[floor])
    reference, _ = render_layers(scene, ReferenceSettings(spp=1024, size=SIZE, bounces=1))
    arrays = extract_scene(scene, size=SIZE)
    found = [render(arrays, RenderSettings(method="importance-sampling", bounces=1, seed=seed)).layers for seed in range(SEEDS)]
    expected, mine = (np.mean([layers["DiffuseIndirect"].mean(dtype=float) for layers in some]) for some in ([reference], found))
    assert mine == pytest.approx(expected, rel=0.06 if floor == "clay" else 0.03)


@pytest.mark.parametrize("roughness", [0.5, 1.0])
def test_bumps_mirror_what_they_turn_their_backs_on(roughness):
    """The wall lies behind the leaning normal: no diffuse light comes from there, but the lobe's rays go there as Cycles' do before Blender 5."""
    scene = before_a_wall(lambda: bumps(0, -0.15, Roughness=roughness, Specular_IOR_Level=0.5))
    size = (32, 18)
    reference, _ = render_layers(scene, ReferenceSettings(spp=1024, size=size, bounces=1))
    arrays = extract_scene(scene, size=size)
    found = [render(arrays, RenderSettings(method="importance-sampling", bounces=1, seed=seed)).layers for seed in range(SEEDS)]
    expected, mine = (np.mean([layers["GlossyIndirect"].mean(dtype=float) for layers in some]) for some in ([reference], found))
    assert mine == pytest.approx(expected, rel=0.4)
