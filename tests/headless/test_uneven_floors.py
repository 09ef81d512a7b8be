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


def bumps(x, y):
    """A material whose normal leans towards (x, y)."""
    made = material("Bumps", Base_Color=(0.5, 0.5, 0.5, 1), Specular_IOR_Level=0.0)
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


@pytest.mark.parametrize("floor", FLOORS)
def test_indirect_light_counts_by_where_it_comes_from(floor):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    quad(scene, [(-9, -9, 0), (9, -9, 0), (9, 3, 0), (-9, 3, 0)], FLOORS[floor]())
    white = material("White", Base_Color=(0.8, 0.8, 0.8, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-9, 3, 0), (9, 3, 0), (9, 3, 0.6), (-9, 3, 0.6)], white, seen=False)
    lamp(scene, "SUN", (0, 0, 0), (math.pi / 2, 0, 0), energy=3.0)  # along the floor, so that it shines on the wall alone
    look(scene, (0, -4, 2.5), (math.radians(58), 0, 0), lens=85)
    reference, _ = render_layers(scene, ReferenceSettings(spp=1024, size=SIZE, bounces=1))
    arrays = extract_scene(scene, size=SIZE)
    found = [render(arrays, RenderSettings(method="importance-sampling", bounces=1, seed=seed)).layers for seed in range(SEEDS)]
    expected, mine = (np.mean([layers["DiffuseIndirect"].mean(dtype=float) for layers in some]) for some in ([reference], found))
    assert mine == pytest.approx(expected, rel=0.06 if floor == "clay" else 0.03)
