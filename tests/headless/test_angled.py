"""Materials that ask for the side or the angle of the view, against Cycles: panes of Mix(Fresnel), culled backs, cards of two colours."""

import hashlib
import math
from dataclasses import replace
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
from .test_glass import slab
from .test_glass_sheets import Row, roof

SEEDS = 3
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


def agree(halves, ours, within=0.03):
    """Means of a part of a layer by channel, within a part of Cycles' brightest and the noise."""
    expected, mine = (np.array([part.mean((0, 1), dtype=float) for part in some]) for some in (halves, ours))
    noise = abs(expected[0] - expected[1]) / 2 + mine.std(0, ddof=1) / math.sqrt(SEEDS)
    assert (abs(mine.mean(0) - expected.mean(0)) <= within * expected.mean(0).max() + 3 * noise).all(), (mine.mean(0), expected.mean(0))


def rendered(scene, methods, layer, size=(16, 16), **identity):
    """A layer by Cycles (two halves), and by each method with some seeds."""
    identity |= {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest()}
    halves = cached_halves(scene, identity, size=size, spp=256, bounces=4, seed=1)
    arrays = extract_scene(scene, size=size)
    settings = [RenderSettings(seed=seed, denoise=False, direct_samples=32) for seed in range(SEEDS)]
    ours = {method: [render(arrays, replace(some, method=method)).layers[layer] for some in settings] for method in methods}
    return [half[layer] for half in halves], ours


@pytest.fixture(scope="module")
def row():
    """Roofs, each over a floor in a black box that is open to the sky but for it: the row, and what `rendered` has."""
    built = Row(ROOFS)
    return built, *rendered(built.scene, METHODS, "Direct", built.size, name="row")


@pytest.mark.parametrize(
    ("over", "method"), [*((over, METHODS[0]) for over in ROOFS), *((over, METHODS[1]) for over in ("pane", "in", "culled up"))]
)
def test_the_sky_through_a_roof_is_as_cycles(row, over, method):
    built, halves, ours = row
    agree(*([built.floor(layer, over) for layer in some] for some in (halves, ours[method])))


CARDS = {
    "colours": lambda: mixed((DULL, RED), (DULL, GREEN), "ShaderNodeNewGeometry", "Backfacing"),
    "shining": lambda: mixed((DULL, RED), (SHINING, (0, 0, 3)), "ShaderNodeNewGeometry", "Backfacing"),
    "leaf": lambda: mixed((LEAF, RED), (LEAF, GREEN), "ShaderNodeNewGeometry", "Backfacing"),
    "varnish": lambda: mixed((DULL, RED), (DULL, GREEN), "ShaderNodeFresnel", IOR=1.45),
    "velvet": lambda: mixed((DULL, RED), (DULL, GREEN), "ShaderNodeLayerWeight", "Facing"),
}


@pytest.mark.parametrize("turned", [False, True], ids=["front", "back"])
@pytest.mark.parametrize("card", CARDS)
def test_a_card_colours_the_floor_as_in_cycles(card, turned):
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
    halves, ours = rendered(scene, METHODS, "DiffuseIndirect", name=card, turned=turned)
    for method in METHODS:
        agree(halves, ours[method], within=0.08 if card == "varnish" and turned else 0.03)


@pytest.mark.parametrize("turned", [False, True], ids=["up", "down"])
def test_light_goes_on_below_a_culled_roof_as_in_cycles(turned):
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
    halves, ours = rendered(scene, METHODS, "DiffuseIndirect", name="under", turned=turned)
    for method in METHODS:
        agree(halves, ours[method])


def test_what_the_inner_side_of_a_pane_mirrors_grows_by_each_bounce_as_in_cycles():
    """Beyond the critical angle all of it.  Cells of the pane knew what it mirrors to those who had met it, at other angles than the next ones: a third too much after four bounces."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.8, 0.8, 0.8, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-30, -30, 0), (30, -30, 0), (30, 30, 0), (-30, 30, 0)], white)
    quad(scene, [(-30, -30, 0.5), (30, -30, 0.5), (30, 30, 0.5), (-30, 30, 0.5)], pane())
    lamp(scene, "SUN", (0, 0, 9), (0.5, 0, 0), energy=3.0, angle=0.02)
    look(scene, (0, 0, 0.4), (1.4, 0, 0), lens=24)
    size = (16, 9)
    reference, _ = render_layers(scene, ReferenceSettings(spp=128, size=size))
    arrays = extract_scene(scene, size=size)
    settings = RenderSettings(method="importance-sampling", denoise=False)
    ours = [render(arrays, replace(settings, seed=seed)).layers["DiffuseIndirect"].mean() for seed in range(2)]
    assert np.mean(ours) == pytest.approx(reference["DiffuseIndirect"].mean(), rel=0.09)
