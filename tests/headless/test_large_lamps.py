"""Point and spot lamps so large that walls and things lie within their spheres, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material

SIZE = (48, 27)


def room(lamp_type, radius, soft):
    """A closed room of 3 m with a box in it, and a lamp that reaches through what is near."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = material("Grey", Base_Color=(0.6, 0.5, 0.4, 1), Specular_IOR_Level=0.0)
    for size, location in ((3, (0, 0, 1.5)), (0.7, (0.6, 0.5, 0.35))):
        bpy.ops.mesh.primitive_cube_add(size=size, location=location)
        bpy.context.object.data.materials.append(grey)
    cone = {"spot_size": 1.6, "spot_blend": 0.4} if lamp_type == "SPOT" else {}
    lamp(scene, lamp_type, (0.3, -0.2, 2.0), energy=100, seen=False, shadow_soft_size=radius, use_soft_falloff=soft, **cone)
    look(scene, (-1.2, -1.3, 1.6), (math.radians(75), 0, math.radians(-43)), lens=18)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lamp_type", "radius", "soft"), [("POINT", 2.0, False), ("POINT", 5.0, True), ("SPOT", 2.0, False), ("SPOT", 2.0, True)]
)
def test_lamps_that_reach_through_walls(lamp_type, radius, soft):
    scene = room(lamp_type, radius, soft)
    reference, _ = render_layers(scene, ReferenceSettings(spp=128, size=SIZE, bounces=3))
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(method="importance-sampling", bounces=3, seed=seed)).layers for seed in range(2)]
    for layer in ("Direct", "DiffuseIndirect"):
        found = np.mean([layers[layer].mean(dtype=float) for layers in ours])
        assert found == pytest.approx(reference[layer].mean(dtype=float), rel=0.02)
