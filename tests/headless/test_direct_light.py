"""Direct light against Cycles, lobe by lobe: floors of every roughness under lamps that are large beside their distance."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

ROUGHNESS = (0.0, 0.1, 0.3, 0.6, 1.0)
SIZE = (100, 20)
SEEDS = 16


def material(name, **inputs):
    made = bpy.data.materials.new(name)
    if made.node_tree is None:  # Blender 4.5
        made.use_nodes = True
    principled = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for key, value in inputs.items():
        principled.inputs[key.replace("_", " ")].default_value = value
    return made


def quad(scene, corners, surface, seen=True):
    mesh = bpy.data.meshes.new("Quad")
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    mesh.materials.append(surface)
    made = bpy.data.objects.new("Quad", mesh)
    made.visible_camera = seen
    scene.collection.objects.link(made)


def floors(lamp_type, metallic, **lamp):
    """A floor of each roughness, side by side in booths with black walls, each under one lamp."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    black = material("Black", Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0)
    for k, roughness in enumerate(ROUGHNESS):
        x = 2.0 * k - 4.0
        floor = material(f"Floor {k}", Roughness=roughness, Metallic=metallic, Base_Color=(0.5, 0.5, 0.5, 1))
        quad(scene, [(x - 1, -2, 0), (x + 1, -2, 0), (x + 1, 2, 0), (x - 1, 2, 0)], floor)
        quad(scene, [(x + 1, -9, -1), (x + 1, 9, -1), (x + 1, 9, 9), (x + 1, -9, 9)], black, seen=False)
        light = bpy.data.lights.new("Lamp", lamp_type)
        light.energy = 100.0
        for key, value in lamp.items():
            setattr(light, key, value)
        placed = bpy.data.objects.new("Lamp", light)
        placed.location = (x, 0.6, 0.8)
        placed.visible_camera = False
        scene.collection.objects.link(placed)
    camera = bpy.data.cameras.new("Camera")
    camera.type, camera.ortho_scale = "ORTHO", 10.0
    scene.camera = bpy.data.objects.new("Camera", camera)
    scene.camera.location, scene.camera.rotation_euler = (0, -6, 6), (math.radians(45), 0, 0)
    scene.collection.objects.link(scene.camera)
    return scene


def floor_means(direct):
    """Mean direct light of each floor, without the pixels of its walls."""
    width = SIZE[0] // len(ROUGHNESS)
    return [direct[:, width * k + 1 : width * (k + 1) - 1].mean(dtype=float) for k in range(len(ROUGHNESS))]


@pytest.mark.slow
@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize(
    "lamp",
    [
        {"lamp_type": "AREA", "size": 0.8},
        {"lamp_type": "POINT", "shadow_soft_size": 0.4, "use_soft_falloff": False},
        {"lamp_type": "SPOT", "shadow_soft_size": 0.4, "spot_size": 1.8, "spot_blend": 0.4},
    ],
    ids=lambda lamp: lamp["lamp_type"],
)
def test_lobes_of_every_roughness(lamp, metallic):
    # Large lamps: what shadow rays and rays drawn from the lobe find adds up to the lamp's light, once.
    scene = floors(**lamp, metallic=metallic)
    reference, _ = render_layers(scene, ReferenceSettings(spp=384, size=SIZE, bounces=0))
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(bounces=0, seed=seed)).layers["Direct"] for seed in range(SEEDS)]
    means, expected = np.array([floor_means(layer) for layer in ours]), np.array(floor_means(reference["Direct"]))
    noise = means.std(axis=0, ddof=1) / math.sqrt(SEEDS) / expected
    assert (noise < 0.015).all()
    assert (np.abs(means.mean(axis=0) / expected - 1) < 0.01 + 2 * noise).all()
