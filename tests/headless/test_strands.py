"""Hair curves, hair particles and points in a room, against Cycles."""

import math
from itertools import pairwise

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material, quad

SIZE = (32, 24)


def tinted():
    """Dark at the root, red or pale at the tip."""
    made = material("Hair", Roughness=0.6)
    tree = made.node_tree
    info, ramp = tree.nodes.new("ShaderNodeHairInfo"), tree.nodes.new("ShaderNodeMixRGB")
    other = tree.nodes.new("ShaderNodeMixRGB")
    other.inputs["Color1"].default_value, other.inputs["Color2"].default_value = (0.8, 0.1, 0.05, 1), (0.8, 0.7, 0.5, 1)
    ramp.inputs["Color1"].default_value = 0.1, 0.05, 0.03, 1
    tree.links.new(info.outputs["Random"], other.inputs["Fac"])
    tree.links.new(info.outputs["Intercept"], ramp.inputs["Fac"])
    tree.links.new(other.outputs[0], ramp.inputs["Color2"])
    tree.links.new(ramp.outputs[0], tree.nodes["Principled BSDF"].inputs["Base Color"])
    return made


def curves(scene, has_radius):
    rng = np.random.default_rng(5)
    root = rng.uniform(-0.8, 0.8, (250, 1, 2))
    t = np.linspace(0, 1, 4)[:, None]
    points = np.concatenate([root + 0.3 * t**2 * np.sin(9 * root[..., ::-1]), np.broadcast_to(0.7 * t, (250, 4, 1))], axis=2)
    data = bpy.data.hair_curves.new("Grass")
    data.add_curves([4] * 250)
    data.attributes["position"].data.foreach_set("vector", points.astype(np.float32).ravel())
    if has_radius:
        width = np.broadcast_to(0.02 - 0.016 * t[:, 0], (250, 4)).astype(np.float32)
        data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", width.ravel())
    data.materials.append(tinted())
    scene.collection.objects.link(bpy.data.objects.new("Grass", data))


def particles(scene):
    quad(scene, [(-0.8, -0.8, 0.02), (0.8, -0.8, 0.02), (0.8, 0.8, 0.02), (-0.8, 0.8, 0.02)], material("Ground"))
    ground = scene.objects[-1]
    ground.data.materials.append(tinted())
    ground.modifiers.new("Fur", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length, settings.material = "HAIR", 200, 0.5, 2
    settings.radius_scale, settings.child_type, settings.rendered_child_count = 0.03, "INTERPOLATED", 3


def points(scene):
    rng = np.random.default_rng(6)
    mesh = bpy.data.meshes.new("Pebbles")
    mesh.from_pydata(rng.uniform((-0.9, -0.9, 0.05), (0.9, 0.9, 0.8), (150, 3)).tolist(), [], [])
    ob = bpy.data.objects.new("Pebbles", mesh)
    scene.collection.objects.link(ob)
    group = bpy.data.node_groups.new("Pebbles", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeMeshToPoints", "GeometryNodeSetMaterial", "NodeGroupOutput")
    made = [group.nodes.new(kind) for kind in kinds]
    made[1].inputs["Radius"].default_value = 0.06
    stuff = material("Pebble")
    info = stuff.node_tree.nodes.new("ShaderNodePointInfo")
    stuff.node_tree.links.new(info.outputs["Random"], stuff.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    made[2].inputs["Material"].default_value = stuff
    for a, b in pairwise(made):
        group.links.new(a.outputs[0], b.inputs[0])
    ob.modifiers.new("Pebbles", "NODES").node_group = group


KINDS = {"curves": lambda s: curves(s, True), "thin curves": lambda s: curves(s, False), "particles": particles, "points": points}


@pytest.mark.parametrize("kind", KINDS)
def test_strands_and_points_are_lit_as_in_cycles(kind):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.7, 0.7, 0.7, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], white)
    quad(scene, [(-2, 2, 0), (2, 2, 0), (2, 2, 2), (-2, 2, 2)], white)
    lamp(scene, "AREA", (0.5, -1, 2.5), energy=100.0, size=1.0, seen=False)
    look(scene, (0, -2.6, 1.6), (math.radians(62), 0, 0), lens=32)
    KINDS[kind](scene)
    reference, _ = render_layers(scene, ReferenceSettings(spp=128, size=SIZE))
    found = render(
        extract_scene(scene, size=SIZE), RenderSettings(method="importance-sampling", samples=32, gather=32, direct_samples=32)
    ).layers
    blocks = [layers["Combined"].reshape(3, 8, 4, 8, 3).mean(axis=(1, 3)) for layers in (found, reference)]
    np.testing.assert_allclose(blocks[0].mean(axis=(0, 1)), blocks[1].mean(axis=(0, 1)), rtol=0.02)
    np.testing.assert_allclose(*blocks, rtol=0.06, atol=0.02 * blocks[1].mean())
    # As much of every pixel is hair.
    np.testing.assert_allclose(found["Albedo"].mean(axis=(0, 1)), reference["Albedo"].mean(axis=(0, 1)), rtol=0.02)
