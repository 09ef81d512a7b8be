"""Materials that ask for the side or the angle of the view, against Cycles: panes of Mix(Fresnel), culled backs, cards of two colours."""

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

from .test_direct_light import lamp, look, material, quad
from .test_glass import slab
from .test_glass_sheets import open_box, roof, sky

SEEDS = 4
METHODS = ["importance-sampling", "instant-radiosity"]


def mixed(first, second, factor, output=0, **inputs):
    """Mix of two shader nodes, (type, colour) each, by an output of the node `factor`."""
    made = material("Mixed")
    tree = made.node_tree
    mix, by = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new(factor)
    for key, value in inputs.items():
        by.inputs[key].default_value = value
    tree.links.new(by.outputs[output], mix.inputs[0])
    for slot, (node_type, color) in enumerate((first, second), 1):
        node = tree.nodes.new(node_type)
        node.inputs["Color"].default_value = (*color, 1)
        if "Roughness" in node.inputs:
            node.inputs["Roughness"].default_value = 0.0
        tree.links.new(node.outputs[0], mix.inputs[slot])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    return made


WHITE, RED, GREEN = (1, 1, 1), (0.8, 0.05, 0.05), (0.05, 0.8, 0.05)
CLEAR, MIRROR, DULL, SHINING, LEAF = (
    f"ShaderNode{name}" for name in ("BsdfTransparent", "BsdfGlossy", "BsdfDiffuse", "Emission", "BsdfTranslucent")
)


def pane():
    return mixed((CLEAR, WHITE), (MIRROR, WHITE), "ShaderNodeFresnel", IOR=1.45)


def culled():
    return mixed((DULL, (0.7, 0.7, 0.7)), (CLEAR, WHITE), "ShaderNodeNewGeometry", "Backfacing")


ROOFS = {
    "pane": lambda scene: slab(scene, -1.01, 1.01, -1.01, 1.01, 1.0, 1.02, pane()),
    "out": lambda scene: roof(scene, 1, pane()),
    "in": lambda scene: roof(scene, -1, pane()),
    "facing": lambda scene: roof(scene, 1, mixed((CLEAR, WHITE), (MIRROR, WHITE), "ShaderNodeLayerWeight", "Facing")),
    "culled up": lambda scene: roof(scene, 1, culled()),
    "culled down": lambda scene: roof(scene, -1, culled()),
}


def agree(scene, name, method, layer, size=(16, 16), within=0.03, **identity):
    """Means of a layer by channel, within a part of Cycles' brightest and the noise."""
    identity |= {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "name": name}
    halves = cached_halves(scene, identity, size=size, spp=512, bounces=4, seed=1)
    arrays = extract_scene(scene, size=size)
    ours = [render(arrays, RenderSettings(seed=seed, denoise=False, method=method, direct_samples=32)).layers for seed in range(SEEDS)]
    expected, mine = (np.array([layers[layer].mean((0, 1), dtype=float) for layers in some]) for some in (halves, ours))
    noise = abs(expected[0] - expected[1]) / 2 + mine.std(0, ddof=1) / math.sqrt(SEEDS)
    assert (abs(mine.mean(0) - expected.mean(0)) <= within * expected.mean(0).max() + 3 * noise).all(), (mine.mean(0), expected.mean(0))


@pytest.mark.parametrize(
    ("over", "method"), [*((over, METHODS[0]) for over in ROOFS), *((over, METHODS[1]) for over in ("pane", "in", "culled up"))]
)
def test_the_sky_through_a_roof_is_as_cycles(over, method):
    """A floor in a black box that is open to the sky but for a roof."""
    scene = open_box()
    ROOFS[over](scene)
    scene.collection.objects[-1].visible_camera = False
    sky(scene)
    look(scene, (0, 0, 20), (0, 0, 0), type="ORTHO", ortho_scale=1.6)
    agree(scene, over, method, "Direct")


CARDS = {
    "colours": lambda: mixed((DULL, RED), (DULL, GREEN), "ShaderNodeNewGeometry", "Backfacing"),
    "shining": lambda: mixed((DULL, RED), (SHINING, (0, 0, 3)), "ShaderNodeNewGeometry", "Backfacing"),
    "leaf": lambda: mixed((LEAF, RED), (LEAF, GREEN), "ShaderNodeNewGeometry", "Backfacing"),
    "varnish": lambda: mixed((DULL, RED), (DULL, GREEN), "ShaderNodeFresnel", IOR=1.45),
    "velvet": lambda: mixed((DULL, RED), (DULL, GREEN), "ShaderNodeLayerWeight", "Facing"),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turned", [False, True], ids=["front", "back"])
@pytest.mark.parametrize("card", CARDS)
def test_a_card_colours_the_floor_as_in_cycles(card, turned, method):
    """A card stands on a floor; a lamp that lights it alone is on one side, the strip of floor that is seen on the same."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = material("Floor", Base_Color=(0.5, 0.5, 0.5, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], grey)
    corners = [(-1, 0, 0.01), (1, 0, 0.01), (1, 0, 1.5), (-1, 0, 1.5)]  # its front looks to -y
    quad(scene, corners[::-1] if turned else corners, CARDS[card]())
    lamp(scene, "AREA", (0, -1.5, 0.75), (math.pi / 2, 0, 0), energy=50.0, size=0.5)
    look(scene, (0, 1 if card == "leaf" else -1, 20), (0, 0, 0), type="ORTHO", ortho_scale=1.6)
    # A virtual light sends its mean view's colour to all sides, and the strip of floor sees the card at grazing angles.
    agree(scene, card, method, "DiffuseIndirect", within=0.08 if card == "varnish" and turned else 0.03, turned=turned)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turned", [False, True], ids=["up", "down"])
def test_light_goes_on_below_a_culled_roof_as_in_cycles(turned, method):
    """What the sun lights below the roof lights a wall: its rays pass the roof as eyes below do."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = material("Floor", Base_Color=(0.7, 0.7, 0.7, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], grey)
    quad(scene, [(-2, 2, 0), (2, 2, 0), (2, 2, 1), (-2, 2, 1)], grey)
    roof(scene, -1 if turned else 1, culled())
    scene.collection.objects[-1].scale = (3, 3, 1)
    lamp(scene, "SUN", (0, 0, 5), energy=3.0)
    look(scene, (0, 0, 0.5), (math.pi / 2, 0, 0), type="ORTHO", ortho_scale=0.9)
    agree(scene, "under", method, "DiffuseIndirect", turned=turned)
