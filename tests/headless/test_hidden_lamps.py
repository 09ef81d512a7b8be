"""Lamps and shining objects that diffuse rays do not see, which glossy surfaces reflect, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import look, material
from .test_light_linking import SIZE, light, put


def room(emitter, metallic):
    """A closed room with a glossy floor and box, a lamp for all rays and one that diffuse rays do not see."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = material("Grey", Base_Color=(0.6, 0.55, 0.5, 1), Specular_IOR_Level=0.0)
    shiny = material("Shiny", Base_Color=(0.6, 0.6, 0.6, 1), Roughness=0.3, Metallic=metallic)
    put("cube", "Room", grey, size=3, location=(0, 0, 1.5))
    put("plane", "Floor", shiny, size=2.9, location=(0, 0, 0.01))
    put("cube", "Box", shiny, size=0.7, location=(0.6, 0.5, 0.36))
    light(scene, "Other", "POINT", (-1.1, 1.1, 2.3), 30, shadow_soft_size=0.1)
    if emitter == "MESH":
        shine = material("Shine", Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0, Emission_Color=(1, 0.8, 0.6, 1), Emission_Strength=12)
        placed = put("cube", "Lamp", shine, size=0.4, location=(0.3, 1.1, 1.6))
        placed.visible_camera = False
    else:
        size = {"AREA": {"size": 0.5}, "POINT": {"shadow_soft_size": 0.05}}[emitter]
        placed = light(scene, "Lamp", emitter, (0.4, 0.9, 2.3), 60, **size)
    look(scene, (-1.2, -1.3, 1.6), (math.radians(70), 0, math.radians(-43)), lens=18)
    return scene, placed


@pytest.mark.slow
@pytest.mark.parametrize(("emitter", "metallic"), [("POINT", 0.0), ("AREA", 0.0), ("AREA", 1.0), ("MESH", 0.0)])
def test_glossy_surfaces_reflect_what_diffuse_ones_do_not_see(emitter, metallic):
    scene, placed = room(emitter, metallic)
    placed.visible_diffuse = False
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=2))
    arrays = extract_scene(scene, size=SIZE)
    assert not [line for line in arrays.warnings if "diffuse rays" in line]
    ours = [render(arrays, RenderSettings(method="importance-sampling", bounces=2, seed=seed)).layers for seed in range(4)]
    for layer, tolerance in (("Direct", 0.01), ("DiffuseIndirect", 0.02)):
        found = np.mean([layers[layer].mean(dtype=float) for layers in ours])
        assert found == pytest.approx(reference[layer].mean(dtype=float), rel=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.3, 0.55])
def test_metal_that_lights_metal_sends_the_light_where_its_lobe_does(roughness):
    """Spread over the hemisphere, what the floor reflects of the lamp would reach the box beside it: 9 % more light."""
    scene, placed = room("AREA", 1.0)
    placed.visible_diffuse = False
    bpy.data.objects.remove(bpy.data.objects["Other"])
    bpy.data.materials["Shiny"].node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = roughness
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=1))
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(method="importance-sampling", bounces=1, seed=seed)).layers for seed in range(2)]
    found = np.mean([layers["DiffuseIndirect"].mean(dtype=float) for layers in ours])
    assert found == pytest.approx(reference["DiffuseIndirect"].mean(dtype=float), rel=0.035)


@pytest.mark.slow
def test_they_light_nothing_where_nothing_is_glossy():
    scene, placed = room("AREA", 0.0)
    for name in ("Floor", "Box"):
        bpy.data.objects[name].data.materials[0] = bpy.data.materials["Grey"]
    settings = RenderSettings(method="importance-sampling", bounces=2)
    placed.visible_diffuse = False
    hidden = render(extract_scene(scene, size=SIZE), settings).layers
    bpy.data.objects.remove(placed)
    without = render(extract_scene(scene, size=SIZE), settings).layers
    for layer in ("Direct", "DiffuseIndirect"):
        np.testing.assert_array_equal(hidden[layer], without[layer])


def test_a_shader_that_hides_its_light_from_the_camera_shines_as_an_object_that_it_does_not_see():
    """Mix(Is Camera Ray; Emission, Transparent), the trick for lights out of sight."""
    scene, placed = room("MESH", 0.0)
    settings = RenderSettings(method="instant-radiosity", bounces=1, direct_samples=64)
    expected = render(extract_scene(scene, size=(24, 14)), settings).layers
    placed.visible_camera = True
    tree = placed.data.materials[0].node_tree
    end = tree.get_output_node("CYCLES").inputs["Surface"]
    shine, path, mix = end.links[0].from_socket, tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(shine, mix.inputs[1])
    tree.links.new(tree.nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], end)
    found = render(extract_scene(scene, size=(24, 14)), settings).layers
    assert not found["Emission"].any()
    for layer in ("Direct", "DiffuseIndirect"):
        assert found[layer].mean(dtype=float) == pytest.approx(expected[layer].mean(dtype=float), rel=0.02)
