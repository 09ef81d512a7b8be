"""A varnished floor whose normal map leans away from the camera, under an even sky, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import look, material, quad

SIZE = (16, 9)


def leaning(y, z, **inputs):
    """A floor that looks as if its normal were (0, y, z), seen by a camera from (0, -.8, .6)."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    varnish = material("Varnish", **{"Base_Color": (0.7, 0.7, 0.7, 1), "Roughness": 0.3} | inputs)
    lean = varnish.node_tree.nodes.new("ShaderNodeNormalMap")
    lean.space = "WORLD"
    lean.inputs["Color"].default_value = (0.5, 0.5 + 0.5 * y, 0.5 + 0.5 * z, 1)
    varnish.node_tree.links.new(lean.outputs[0], varnish.node_tree.nodes["Principled BSDF"].inputs["Normal"])
    quad(scene, [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], varnish)
    scene.world = bpy.data.worlds.new("Sky")
    scene.world.color = (1, 1, 1)
    look(scene, (0, -4, 3), (math.acos(0.6), 0, 0), lens=85)
    return scene


@pytest.mark.parametrize("normal", [(0.3, 0.954), (0.6, 0.8), (0.8, 0.6)], ids=["seen", "edge on", "from below"])
def test_varnish_takes_its_share_by_the_bent_normal(normal):
    """Seen edge on, a varnish would reflect all; Cycles bends its normal until what it reflects lies above the floor."""
    scene = leaning(*normal)
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=0))
    found = render(extract_scene(scene, size=SIZE), RenderSettings(method="importance-sampling", bounces=0)).layers
    assert np.mean(found["Direct"]) == pytest.approx(np.mean(reference["Direct"]), rel=0.02)
    assert np.mean(found["Albedo"]) == pytest.approx(np.mean(reference["Albedo"]), rel=0.02)


@pytest.mark.parametrize("roughness", [0.6, 1.0])
def test_metal_mirrors_what_lies_behind_its_bumps(roughness):
    """Of what a normal that leans to the camera has behind it, Cycles' lobes show what lies above the floor, before Blender 5: 5 % of this sky."""
    scene = leaning(-0.35, 0.937, Metallic=1.0, Roughness=roughness)
    scene.camera.location, scene.camera.rotation_euler = (0, -4, 1.2), (math.atan2(4, 1.2), 0, 0)
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=0))
    arrays = extract_scene(scene, size=SIZE)
    found = [render(arrays, RenderSettings(method="importance-sampling", bounces=0, seed=seed)).layers["Direct"] for seed in range(4)]
    assert np.mean(found) == pytest.approx(np.mean(reference["Direct"]), rel=0.02)


@pytest.mark.parametrize("linked", [False, True], ids=["its own normal", "that of the bumps"])
def test_a_coat_shines_by_its_own_normal(linked):
    """A coat lies smoothly over bumps but where Coat Normal says otherwise: the sun that it mirrors is elsewhere."""
    scene = leaning(0.2, 0.98, Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0, Coat_Weight=1.0, Coat_Roughness=0.2)
    tree = bpy.data.materials["Varnish"].node_tree
    if linked:
        lean = next(node for node in tree.nodes if node.type == "NORMAL_MAP")
        tree.links.new(lean.outputs[0], tree.nodes["Principled BSDF"].inputs["Coat Normal"])
    scene.world.color = (0, 0, 0)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle, sun.rotation_euler = 1.0, 0.02, (-math.acos(0.6), 0, 0)
    scene.collection.objects.link(sun)
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=0))
    arrays = extract_scene(scene, size=SIZE)
    found = render(arrays, RenderSettings(method="importance-sampling", bounces=0, denoise=False)).layers
    assert np.mean(found["Direct"]) == pytest.approx(float(np.mean(reference["Direct"])), rel=0.03)
    assert not any("coat" in warning for warning in arrays.warnings)


def test_a_coat_with_other_bumps_than_what_lies_below_has_a_warning():
    scene = leaning(0.2, 0.98, Coat_Weight=1.0)
    tree = bpy.data.materials["Varnish"].node_tree
    other = tree.nodes.new("ShaderNodeNormalMap")
    tree.links.new(other.outputs[0], tree.nodes["Principled BSDF"].inputs["Coat Normal"])
    assert any("coat's own normal is left out" in warning for warning in extract_scene(scene, size=SIZE).warnings)
