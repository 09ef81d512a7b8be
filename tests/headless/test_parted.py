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

from .test_direct_light import look, material, quad
from .test_glass import slab
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
    halves = cached_halves(scene, identity, size=(16, 16), spp=512, bounces=4, seed=1)
    arrays = extract_scene(scene, size=(16, 16))
    ours = [render(arrays, RenderSettings(seed=seed, denoise=False, method=method, direct_samples=32)).layers for seed in range(SEEDS)]
    for name in ("Direct", "DiffuseIndirect"):
        expected, mine = ([layers[name].mean(dtype=float) for layers in some] for some in (halves, ours))
        noise = abs(expected[0] - expected[1]) / 2 + np.std(mine, ddof=1) / math.sqrt(SEEDS)
        assert np.mean(expected) > 0.02, name
        assert abs(np.mean(mine) - np.mean(expected)) <= 0.03 * np.mean(expected) + 2 * noise, name
