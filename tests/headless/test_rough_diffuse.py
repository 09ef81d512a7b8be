"""Rough diffuse floors under a lamp or an even sky, against Cycles."""

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


def floor(shader, roughness):
    """A clay floor seen at a low angle; the node of its material."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    clay = material("Clay", Base_Color=(0.8, 0.5, 0.2, 1), Specular_IOR_Level=0.0)
    if shader == "principled":
        clay.node_tree.nodes["Principled BSDF"].inputs["Diffuse Roughness"].default_value = roughness
    else:
        diffuse = clay.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
        diffuse.inputs["Color"].default_value = (0.8, 0.5, 0.2, 1)
        diffuse.inputs["Roughness"].default_value = roughness
        clay.node_tree.links.new(diffuse.outputs[0], clay.node_tree.get_output_node("CYCLES").inputs["Surface"])
    quad(scene, [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], clay)
    look(scene, (0, -4, 1), (math.radians(76), 0, 0), lens=85)
    return scene


@pytest.mark.parametrize("shader", ["principled", "diffuse"])
@pytest.mark.parametrize("light", ["sky", "before", "behind"])
def test_rough_floors_are_as_bright_as_in_cycles(shader, light):
    scene = floor(shader, 1.0)
    if light == "sky":
        scene.world = bpy.data.worlds.new("Sky")
        scene.world.color = (1, 1, 1)
    else:
        lamp(scene, "POINT", (0, -4 if light == "behind" else 4, 1.5), energy=500.0, shadow_soft_size=0.05)
    reference, _ = render_layers(scene, ReferenceSettings(spp=128, size=SIZE, bounces=0))
    found = render(extract_scene(scene, size=SIZE), RenderSettings(method="importance-sampling", bounces=0)).layers
    for name in ("Direct", "Albedo"):
        # Towards the lamp, with pixels as small as you like, -1.5 % of Cycles' (128x72), and one seed +- 1 %.
        assert found[name].mean() == pytest.approx(reference[name].mean(), rel=0.035 if light == "before" else 0.015)
        # Light that is scattered more than once has more colour; where it comes from one side, its share is taken to be that of grey.
        np.testing.assert_allclose(found[name].mean(axis=(0, 1)), reference[name].mean(axis=(0, 1)), rtol=0.03)
