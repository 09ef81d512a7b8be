"""Translucent surfaces against Cycles: a lamp in a closed paper box lights a room."""

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

from .test_direct_light import lamp, look, material, quad
from .test_glass import slab

SIZE = (48, 27)
SPP = 1024
SEEDS = 8


def paper():
    """Half of the light that it does not absorb comes through."""
    made = material("Paper")
    tree = made.node_tree
    mix, diffuse, through = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("MixShader", "BsdfDiffuse", "BsdfTranslucent"))
    diffuse.inputs["Color"].default_value = (0.8, 0.75, 0.6, 1)
    through.inputs["Color"].default_value = (0.9, 0.7, 0.4, 1)
    for k, node in enumerate((diffuse, through)):
        tree.links.new(node.outputs[0], mix.inputs[1 + k])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    return made


def room():
    """A room without a front wall, with a box on its floor; the only lamp is inside."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.7, 0.6, 0.5, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], white)
    quad(scene, [(-2, -2, 3), (2, -2, 3), (2, 2, 3), (-2, 2, 3)], white)
    quad(scene, [(-2, 2, 0), (2, 2, 0), (2, 2, 3), (-2, 2, 3)], white)
    for x in (-2, 2):
        quad(scene, [(x, -2, 0), (x, 2, 0), (x, 2, 3), (x, -2, 3)], white)
    slab(scene, -0.6, 0.6, -0.2, 1.0, 0.5, 1.5, paper())
    lamp(scene, "POINT", (0.1, 0.3, 0.9), energy=200.0, shadow_soft_size=0.1)
    look(scene, (0, -6, 1.5), (math.pi / 2, 0, 0), lens=42)
    return scene


@pytest.fixture(scope="module")
def pictures():
    """(halves of the reference, ours of some seeds)."""
    scene = room()
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest()}
    halves = cached_halves(scene, identity, size=SIZE, spp=SPP, bounces=4, seed=1)
    arrays = extract_scene(scene, size=SIZE)
    assert not any("ranslucent" in line for line in arrays.warnings)
    return halves, [render(arrays, RenderSettings(seed=seed, denoise=False)).layers for seed in range(SEEDS)]


BOX, WALLS = "box", "walls"


@pytest.mark.parametrize("name", ["Direct", "DiffuseIndirect", "Albedo"])
@pytest.mark.parametrize("where", [BOX, WALLS])
def test_a_lamp_in_a_paper_box_lights_the_room_as_in_cycles(pictures, where, name):
    albedo = pictures[1][0]["Albedo"]
    box = np.abs(albedo - (0.85, 0.725, 0.5)).max(axis=2) < 0.01
    seen = box if where == BOX else np.abs(albedo - (0.7, 0.6, 0.5)).max(axis=2) < 0.01
    assert seen.sum() > 80
    halves, ours = ([layers[name][seen].mean(0, dtype=float) for layers in some] for some in pictures)
    expected = np.mean(halves, axis=0)
    noise = np.abs(halves[0] - halves[1]) / 2 + np.std(ours, axis=0, ddof=1) / math.sqrt(SEEDS)
    assert (np.abs(np.mean(ours, axis=0) - expected) <= 0.015 * expected + 2 * noise).all()
    assert (noise <= 0.02 * expected).all()
    assert (expected > 0.01).all() == (name != "Direct" or where == BOX)
