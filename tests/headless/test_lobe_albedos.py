"""What glossy closures reflect of an even sky, by the angle of the view, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import look, material, quad

SIZE = (4, 4)
COLOR = (0.6, 0.3, 0.2, 1)
ANGLES = (0.1, 0.8, 1.3)  # of the view with the normal
PRINCIPLED = {
    "metal": {"Metallic": 1.0, "Roughness": 0.9},
    "coat": {"Roughness": 0.5, "Coat Weight": 1.0, "Coat Roughness": 0.2, "Coat Tint": (0.8, 0.9, 0.5, 1)},
    "coated metal": {"Metallic": 1.0, "Roughness": 0.5, "Coat Weight": 1.0, "Coat Roughness": 0.1},
    "tinted metal": {"Metallic": 1.0, "Roughness": 0.5, "Specular Tint": (0.2, 0.5, 0.9, 1)},
}
NODES = {
    "glossy, rough": ("ShaderNodeBsdfAnisotropic", "MULTI_GGX", {"Color": COLOR, "Roughness": 0.9}),
    "glossy": ("ShaderNodeBsdfAnisotropic", "MULTI_GGX", {"Color": COLOR, "Roughness": 0.5}),
    "glossy, scattering once": ("ShaderNodeBsdfAnisotropic", "GGX", {"Color": COLOR, "Roughness": 0.9}),
    "beckmann": ("ShaderNodeBsdfAnisotropic", "BECKMANN", {"Color": COLOR, "Roughness": 0.5}),
    "metallic": ("ShaderNodeBsdfMetallic", "MULTI_GGX", {"Roughness": 0.5}),
    "conductor": ("ShaderNodeBsdfMetallic", "MULTI_GGX", {"Roughness": 0.5}),
}


def surface(kind):
    if kind in PRINCIPLED:
        made = material("Surface")
        node = made.node_tree.nodes["Principled BSDF"]
        inputs = {"Base Color": COLOR, **PRINCIPLED[kind]}
    else:
        made = material("Surface")
        node_type, distribution, inputs = NODES[kind]
        node = made.node_tree.nodes.new(node_type)
        node.distribution = distribution
        if kind == "conductor":
            node.fresnel_type = "PHYSICAL_CONDUCTOR"
        made.node_tree.links.new(node.outputs[0], made.node_tree.get_output_node("CYCLES").inputs["Surface"])
    for key, value in inputs.items():
        node.inputs[key].default_value = value
    return made


@pytest.mark.parametrize("kind", [*PRINCIPLED, *NODES])
def test_lobes_reflect_as_much_of_a_sky_as_in_cycles(kind):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    quad(scene, [(-90, -90, 0), (90, -90, 0), (90, 90, 0), (-90, 90, 0)], surface(kind))
    scene.world = bpy.data.worlds.new("Sky")
    scene.world.color = (1, 1, 1)
    for angle in ANGLES:
        look(scene, (0, -5 * math.sin(angle), 5 * math.cos(angle)), (angle, 0, 0), type="ORTHO", ortho_scale=0.2)
        reference, _ = render_layers(scene, ReferenceSettings(spp=1024, size=SIZE, bounces=0))
        settings = RenderSettings(method="importance-sampling", bounces=0, direct_samples=256, denoise=False)
        found = render(extract_scene(scene, size=SIZE), settings).layers
        bound = 0.12 if kind == "beckmann" and angle > 1 else 0.02  # what little this distribution loses is not taken away
        ours, expected = (layers["Direct"].mean((0, 1)) for layers in (found, reference))
        np.testing.assert_allclose(ours, expected, rtol=bound, err_msg=f"{kind} seen at {angle}")
