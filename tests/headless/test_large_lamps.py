"""Point and spot lamps so large that walls and things lie within their spheres, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

SIZE = (48, 27)


def room(lamp_type, radius, soft):
    """A closed room of 3 m with a box in it, and a lamp that reaches through what is near."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = bpy.data.materials.new("Grey")
    if grey.node_tree is None:  # Blender 4.5
        grey.use_nodes = True
    principled = next(node for node in grey.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    principled.inputs["Base Color"].default_value = (0.6, 0.5, 0.4, 1)
    principled.inputs["Specular IOR Level"].default_value = 0.0
    for size, location in ((3, (0, 0, 1.5)), (0.7, (0.6, 0.5, 0.35))):
        bpy.ops.mesh.primitive_cube_add(size=size, location=location)
        bpy.context.object.data.materials.append(grey)
    light = bpy.data.lights.new("Lamp", lamp_type)
    light.energy, light.shadow_soft_size, light.use_soft_falloff = 100, radius, soft
    if lamp_type == "SPOT":
        light.spot_size, light.spot_blend = 1.6, 0.4
    placed = bpy.data.objects.new("Lamp", light)
    placed.location, placed.visible_camera = (0.3, -0.2, 2.0), False
    scene.collection.objects.link(placed)
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.camera.location, scene.camera.rotation_euler = (-1.2, -1.3, 1.6), (math.radians(75), 0, math.radians(-43))
    scene.camera.data.lens = 18
    scene.collection.objects.link(scene.camera)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lamp_type", "radius", "soft"), [("POINT", 2.0, False), ("POINT", 5.0, True), ("SPOT", 2.0, False), ("SPOT", 2.0, True)]
)
def test_lamps_that_reach_through_walls(lamp_type, radius, soft):
    scene = room(lamp_type, radius, soft)
    reference, _ = render_layers(scene, ReferenceSettings(spp=384, size=SIZE, bounces=3))
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(method="importance-sampling", bounces=3, seed=seed)).layers for seed in range(3)]
    for layer in ("Direct", "DiffuseIndirect"):
        found = np.mean([layers[layer].mean(dtype=float) for layers in ours])
        assert found == pytest.approx(reference[layer].mean(dtype=float), rel=0.02)
