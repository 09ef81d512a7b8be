"""Lamps whose nodes make them shine unevenly, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import look, material

SIZE = (48, 27)
# A lamp of two beams, one of which leans to a side.
IES = """IESNA:LM-63-1995
TILT=NONE
1 1000 1 7 5 1 2 0 0 0
1 1 100
0 15 30 45 60 75 90
0 45 90 135 180
60 45 9 3 1 0 0
54 39 15 6 2 0 0
30 39 39 30 12 3 0
15 24 21 15 6 3 0
9 9 6 3 1 0 0
"""


def picture():
    """An image of stripes and a spot, as a gobo."""
    y, x = np.mgrid[0:32, 0:32] / 32
    pixels = np.stack([np.sin(12 * x) > 0, y, 2.0 * ((x - 0.3) ** 2 + (y - 0.6) ** 2 < 0.05), np.ones_like(x)], -1)
    image = bpy.data.images.new("Gobo", 32, 32, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(pixels.astype(np.float32).ravel())
    image.pack()
    return image


def gobo(node, output):
    """Emission by an image, where `output` of `node` says; None for where it is looked up by itself."""

    def build(tree, emission):
        texture = tree.nodes.new("ShaderNodeTexImage")
        texture.image = picture()
        if node is not None:
            tree.links.new(tree.nodes.new(node).outputs[output], texture.inputs["Vector"])
        tree.links.new(texture.outputs["Color"], emission.inputs["Color"])

    return build


def ies(tree, emission):
    """Emission by an IES texture of an internal text."""
    texture = tree.nodes.new("ShaderNodeTexIES")
    texture.mode = "INTERNAL"
    texture.ies = bpy.data.texts.new("IES")
    texture.ies.write(IES)
    tree.links.new(texture.outputs[0], emission.inputs["Strength"])


def facing(tree, emission):
    """Emission by the angle with the lamp's normal, through a ramp, faded by the distance."""
    weight, ramp, falloff = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("LayerWeight", "ValToRGB", "LightFalloff"))
    falloff.inputs["Strength"].default_value, falloff.inputs["Smooth"].default_value = 2, 0.2
    tree.links.new(weight.outputs["Facing"], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], emission.inputs["Color"])
    tree.links.new(falloff.outputs["Linear"], emission.inputs["Strength"])


def room(kind, build, *, shiny=False, seen=False, **settings):
    """A closed room of 3 m with a box in it, and a lamp."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = material("Grey", Base_Color=(0.6, 0.55, 0.5, 1), Specular_IOR_Level=0.0)
    for size, location in ((3, (0, 0, 1.5)), (0.7, (0.6, 0.5, 0.35))):
        bpy.ops.mesh.primitive_cube_add(size=size, location=location)
        bpy.context.object.data.materials.append(grey)
    if shiny:
        mirror = material("Mirror", Metallic=1.0, Roughness=0.0, Base_Color=(0.9, 0.9, 0.9, 1))
        bpy.ops.mesh.primitive_plane_add(size=2.8, location=(0, 0, 0.01))
        bpy.context.object.data.materials.append(mirror)
    light = bpy.data.lights.new("Lamp", kind)
    light.energy = 100
    for name, value in settings.items():
        setattr(light, name, value)
    if bpy.app.version < (5, 0):
        light.use_nodes = True
    tree = light.node_tree
    tree.nodes.clear()
    output, emission = tree.nodes.new("ShaderNodeOutputLight"), tree.nodes.new("ShaderNodeEmission")
    tree.links.new(emission.outputs[0], output.inputs[0])
    build(tree, emission)
    placed = bpy.data.objects.new("Lamp", light)
    placed.location, placed.rotation_euler, placed.visible_camera = (0.1, -0.1, 2.2), (0.3, -0.2, 0.7), seen
    scene.collection.objects.link(placed)
    if seen:
        placed.location = (0.9, -0.3, 0.9)
    look(scene, (-1.2, -1.3, 1.6), (math.radians(55 if seen else 75), 0, math.radians(-43)), lens=18)
    return scene


def compared(scene, spp=256, seeds=2):
    """Layers by Cycles and the mean of ours."""
    reference, _ = render_layers(scene, ReferenceSettings(spp=spp, size=SIZE, bounces=2))
    arrays = extract_scene(scene, size=SIZE)
    assert not [line for line in arrays.warnings if "nodes" in line]
    ours = [render(arrays, RenderSettings(method="importance-sampling", bounces=2, seed=seed)).layers for seed in range(seeds)]
    return reference, {name: np.mean([layers[name] for layers in ours], axis=0) for name in ours[0]}


LAMPS = {
    "ies": ("POINT", ies, dict(shadow_soft_size=0.05, use_soft_falloff=False)),
    "ies on an area": ("AREA", ies, dict(shape="RECTANGLE", size=0.6, size_y=0.3)),
    "gobo by the normal": ("POINT", gobo("ShaderNodeTexCoord", "Normal"), dict(shadow_soft_size=0.2, use_soft_falloff=False)),
    "gobo of a point": ("POINT", gobo(None, None), dict(shadow_soft_size=0.05)),
    "gobo of a spot": ("SPOT", gobo(None, None), dict(shadow_soft_size=0.0, spot_size=1.9, spot_blend=0.3)),
    "gobo by the direction": ("SPOT", gobo("ShaderNodeNewGeometry", "Incoming"), dict(shadow_soft_size=0.05, spot_size=1.9)),
    "picture": ("AREA", gobo("ShaderNodeNewGeometry", "Parametric"), dict(shape="ELLIPSE", size=0.8, size_y=0.5)),
    "by the place": ("AREA", gobo("ShaderNodeTexCoord", "Object"), dict(shape="SQUARE", size=0.8, spread=2.0)),
    "ramp": ("AREA", facing, dict(shape="DISK", size=0.5)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LAMPS)
def test_the_light_of_each_lamp(name):
    kind, build, settings = LAMPS[name]
    reference, ours = compared(room(kind, build, **settings), seeds=4 if name == "by the place" else 2)  # noisier than the others
    for layer, tolerance in (("Direct", 0.01), ("DiffuseIndirect", 0.02)):
        assert ours[layer].mean(dtype=float) == pytest.approx(reference[layer].mean(dtype=float), rel=tolerance)
        for c in range(3):
            assert ours[layer][..., c].mean(dtype=float) == pytest.approx(reference[layer][..., c].mean(dtype=float), rel=0.03)
    # It falls where it falls by Cycles.
    error = np.abs(ours["Direct"] - reference["Direct"]).mean() / reference["Direct"].mean()
    assert error < (0.15 if "place" in name or name == "picture" else 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["POINT", "AREA"])
def test_what_is_seen_of_a_lamp(kind):
    size = dict(shadow_soft_size=0.3, use_soft_falloff=False) if kind == "POINT" else dict(size=0.8)
    build = gobo("ShaderNodeTexCoord", "Normal") if kind == "POINT" else gobo(None, None)
    reference, ours = compared(room(kind, build, shiny=True, seen=True, **size), spp=512, seeds=3)
    assert reference["Direct"].max() > 5  # the mirror shows it
    for layer in ("Direct", "Emission", "GlossyIndirect"):
        for c in range(3):
            assert ours[layer][..., c].mean(dtype=float) == pytest.approx(reference[layer][..., c].mean(dtype=float), rel=0.04, abs=1e-3)
