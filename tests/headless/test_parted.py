"""What shadow rays and scattered rays do not meet alike (Ray Visibility: Diffuse, Shadow), under an uneven sky, against Cycles.

Cycles finds such a sky by both, each with its share; a window's pane that casts no shadow is the usual case.
"""

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
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material, quad
from .test_glass import shader, slab
from .test_glass_sheets import GLASS

SEEDS = 4
WALL = {"Base_Color": (0.7, 0.7, 0.7, 1), "Specular_IOR_Level": 0.0}
ROOFS = {"glass": GLASS, "board": WALL}


def uneven_sky(scene):
    """Bright to one side: its light is twice the mean where it is most, and 0 opposite of that."""
    world = scene.world = bpy.data.worlds.new("World")
    if world.node_tree is None:  # Blender 4.5
        world.use_nodes = True
    tree = world.node_tree
    place, parts, add = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "SeparateXYZ", "Math"))
    add.inputs[1].default_value = 1.0
    tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    tree.links.new(place.outputs["Generated"], parts.inputs[0])
    tree.links.new(parts.outputs["X"], add.inputs[0])
    tree.links.new(add.outputs[0], tree.nodes["Background"].inputs["Strength"])


def court(roof, **seen_by):
    """A light box, open above but for a roof that not all rays meet, seen from above."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    wall = material("Wall", **WALL)
    quad(scene, [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], wall)
    for x in (-1, 1):
        quad(scene, [(x, -1, 0), (x, 1, 0), (x, 1, 1), (x, -1, 1)], wall)
        quad(scene, [(-1, x, 0), (1, x, 0), (1, x, 1), (-1, x, 1)], wall)
    slab(scene, -1.01, 1.01, -1.01, 1.01, 1.0, 1.02, material("Roof", **ROOFS[roof]))
    made = scene.collection.objects[-1]
    made.visible_camera = False
    for name, seen in seen_by.items():
        setattr(made, name, seen)
    uneven_sky(scene)
    look(scene, (0, 0, 20), (0, 0, 0), type="ORTHO", ortho_scale=1.8)
    return scene


@pytest.mark.parametrize("method", ["importance-sampling", "instant-radiosity"])
@pytest.mark.parametrize(
    ("roof", "seen_by"),
    [("glass", {"visible_shadow": False}), ("board", {"visible_shadow": False}), ("board", {"visible_diffuse": False})],
    ids=["pane without shadow", "board without shadow", "board by shadow rays alone"],
)
def test_either_kind_of_ray_brings_its_share_of_the_sky(roof, seen_by, method):
    scene = court(roof, **seen_by)
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "roof": roof, "seen": seen_by}
    halves = cached_halves(scene, identity, size=(16, 16), spp=256, bounces=4, seed=1)
    arrays = extract_scene(scene, size=(16, 16))
    ours = [render(arrays, RenderSettings(seed=seed, denoise=False, method=method, direct_samples=32)).layers for seed in range(SEEDS)]
    for name in ("Direct", "DiffuseIndirect"):
        expected, mine = ([layers[name].mean(dtype=float) for layers in some] for some in (halves, ours))
        noise = abs(expected[0] - expected[1]) / 2 + np.std(mine, ddof=1) / math.sqrt(SEEDS)
        assert np.mean(expected) > 0.02, name
        assert abs(np.mean(mine) - np.mean(expected)) <= 0.03 * np.mean(expected) + 2 * noise, name


def behind_glass(lamp_type):
    """A closed room parted by a pane that is glass but to shadow rays, seen on the side without the lamp."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    wall = material("Wall", **WALL)
    for corners in (
        [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)],
        [(-1, -1, 2), (-1, 1, 2), (1, 1, 2), (1, -1, 2)],
        *([(x, -1, 0), (x, 1, 0), (x, 1, 2), (x, -1, 2)] for x in (-1, 1)),
        *([(-1, y, 0), (1, y, 0), (1, y, 2), (-1, y, 2)] for y in (-1, 1)),
    ):
        quad(scene, corners, wall)
    glass = material("Pane", **GLASS)
    nodes, links = glass.node_tree.nodes, glass.node_tree.links
    path, clear, mix = (nodes.new(f"ShaderNode{kind}") for kind in ("LightPath", "BsdfTransparent", "MixShader"))
    links.new(path.outputs["Is Shadow Ray"], mix.inputs[0])
    links.new(nodes["Principled BSDF"].outputs[0], mix.inputs[1])
    links.new(clear.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], next(node for node in nodes if node.type == "OUTPUT_MATERIAL").inputs["Surface"])
    slab(scene, -1.01, 1.01, 0.3, 0.32, -0.01, 2.01, glass)
    if lamp_type == "MESH":
        quad(
            scene,
            [(-0.3, 0.8, 0.7), (0.3, 0.8, 0.7), (0.3, 0.8, 1.3), (-0.3, 0.8, 1.3)],
            shader("Shining", "ShaderNodeEmission", Strength=10.0),
        )
    else:
        size = {"AREA": {"size": 0.5}, "POINT": {"shadow_soft_size": 0.1}}[lamp_type]
        lamp(scene, lamp_type, (0, 0.8, 1), (-math.pi / 2, 0, 0), energy=20.0, **size)
    look(scene, (0, 0.2, 1), (math.pi / 2, 0, math.pi), lens=18)
    return scene


@pytest.mark.parametrize("lamp_type", ["AREA", "POINT", "MESH"])
def test_lamps_shine_twice_through_glass_that_is_none_to_shadow_rays(lamp_type):
    """By shadow rays, which meet nothing, as direct light; and whole by rays scattered beyond the glass, as indirect light."""
    scene = behind_glass(lamp_type)
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=(16, 12), bounces=2))
    arrays = extract_scene(scene, size=(16, 12))
    ours = [
        render(arrays, RenderSettings(seed=seed, denoise=False, method="importance-sampling", bounces=2)).layers for seed in range(SEEDS)
    ]
    for name in ("Direct", "DiffuseIndirect"):
        expected, mine = (np.mean([layers[name].mean(dtype=float) for layers in some]) for some in ([reference], ours))
        assert mine == pytest.approx(expected, rel=0.05), name
