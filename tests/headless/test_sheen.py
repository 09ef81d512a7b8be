"""Cloth and velvet under a lamp from several sides and an even sky, against Cycles."""

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


def cloth(kind):
    """A floor of cloth seen at a low angle."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    stuff = material("Cloth", Base_Color=(0.5, 0.1, 0.1, 1), Specular_IOR_Level=0.0)
    if kind == "principled":
        for key, value in {"Sheen Weight": 1.0, "Sheen Roughness": 0.5}.items():
            stuff.node_tree.nodes["Principled BSDF"].inputs[key].default_value = value
    else:
        sheen = stuff.node_tree.nodes.new("ShaderNodeBsdfSheen")
        sheen.distribution = "ASHIKHMIN"
        sheen.inputs["Color"].default_value = (0.8, 0.5, 0.2, 1)
        sheen.inputs["Roughness"].default_value = 0.6
        stuff.node_tree.links.new(sheen.outputs[0], stuff.node_tree.get_output_node("CYCLES").inputs["Surface"])
    quad(scene, [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], stuff)
    look(scene, (0, -4, 1.4), (math.radians(72), 0, 0), lens=85)
    return scene


@pytest.mark.parametrize("kind", ["principled", "velvet"])
@pytest.mark.parametrize("light", ["sky", "before", "behind"])
def test_cloth_is_as_bright_as_in_cycles(kind, light):
    scene = cloth(kind)
    if light == "sky":
        scene.world = bpy.data.worlds.new("Sky")
        scene.world.color = (1, 1, 1)
    else:
        lamp(scene, "POINT", (0, -4 if light == "behind" else 4, 1.5), energy=500.0, shadow_soft_size=0.05)
    reference, _ = render_layers(scene, ReferenceSettings(spp=128, size=SIZE, bounces=0))
    found = render(extract_scene(scene, size=SIZE), RenderSettings(method="importance-sampling", bounces=0, direct_samples=64)).layers
    # The fit of the fibres' albedo differs from Cycles' table by up to .02.
    np.testing.assert_allclose(found["Direct"].mean(axis=(0, 1)), reference["Direct"].mean(axis=(0, 1)), rtol=0.05)


def test_deeply_bumped_cloth_is_as_bright_as_in_cycles():
    """Half of what is seen are slopes that face away, whose pile shines along them, away from the lamp above."""
    scene = cloth("principled")
    tree = bpy.data.materials["Cloth"].node_tree
    shader, wave, bump = tree.nodes["Principled BSDF"], tree.nodes.new("ShaderNodeTexWave"), tree.nodes.new("ShaderNodeBump")
    wave.inputs["Scale"].default_value = 2.0
    bump.inputs["Distance"].default_value = 0.2
    wave.bands_direction = "Y"
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Object"], wave.inputs["Vector"])
    tree.links.new(wave.outputs["Fac"], bump.inputs["Height"])
    tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    lamp(scene, "POINT", (0, 0, 3), energy=500.0, shadow_soft_size=0.05)
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=0))
    found = render(
        extract_scene(scene, size=SIZE), RenderSettings(method="importance-sampling", bounces=0, direct_samples=64, pixel_samples=64)
    ).layers
    np.testing.assert_allclose(found["Direct"].mean(axis=(0, 1)), reference["Direct"].mean(axis=(0, 1)), rtol=0.12)


@pytest.mark.parametrize("light", ["sky", "lamp"])
def test_cloth_seen_in_polished_metal_is_as_bright_as_in_cycles(light):
    """A plate shows the cloth from straight above, where its pile hardly shines: it had the sheen of the mean view."""
    scene = cloth("principled")
    metal = material("Metal", Base_Color=(0.9, 0.9, 0.9, 1), Metallic=1.0, Roughness=0.15)
    quad(scene, [(-0.5, -0.3, 1.7), (0.5, -0.3, 1.7), (0.5, 0.3, 1.1), (-0.5, 0.3, 1.1)], metal)
    look(scene, (0, -4, 1.4), (math.radians(90), 0, 0), lens=200)
    if light == "sky":
        scene.world = bpy.data.worlds.new("Sky")
        scene.world.color = (1, 1, 1)
    else:
        lamp(scene, "POINT", (0, 4, 1), energy=500.0, shadow_soft_size=0.05)
    found = render(extract_scene(scene, size=SIZE), RenderSettings(method="importance-sampling", bounces=1, reflections=32)).layers
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=1))
    np.testing.assert_allclose(
        found["GlossyIndirect"].mean(axis=(0, 1)), reference["GlossyIndirect"].mean(axis=(0, 1)), rtol=0.06, atol=0.003
    )
