"""Objects that cast no shadows, and lamps whose light casts none, light further surfaces as they do in Cycles."""

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


def room(casts):
    """A room below a roof, through which a lamp shines from above: roof, floor and a wall cast no shadows, or its light casts none."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey, red = (
        material(name, Base_Color=color, Specular_IOR_Level=0.0)
        for name, color in (("Grey", (0.7,) * 3 + (1,)), ("Red", (0.7, 0.2, 0.1, 1)))
    )
    walls = {"Floor": (0, 0, 0, 0), "Roof": (0, 0, 2.5, 0), "Left": (-2, 0, 1.25, 1), "Right": (2, 0, 1.25, 1), "Back": (0, 2, 1.25, 2)}
    for name, (x, y, z, turn) in walls.items():
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], [], [(0, 1, 2, 3)])
        mesh.materials.append(red if name == "Left" else grey)
        made = bpy.data.objects.new(name, mesh)
        made.location = x, y, z
        made.rotation_euler = ((0, 0, 0), (0, math.pi / 2, 0), (math.pi / 2, 0, 0))[turn]
        made.visible_shadow = name not in ("Roof", "Left", "Floor") or casts == "lamp"
        scene.collection.objects.link(made)
    lamp(scene, "POINT", (0.5, 0.3, 4), energy=300, shadow_soft_size=0.05, seen=False, use_shadow=casts != "lamp")
    look(scene, (0, -5, 1.2), (math.pi / 2, 0, 0), lens=30)
    return scene


@pytest.mark.parametrize("method", ["importance-sampling", "instant-radiosity"])
@pytest.mark.parametrize("casts", ["surfaces", "lamp"])
def test_light_without_shadows_bounces(casts, method):
    # The roof above is lit as well as the room below it.  Where particles only passed it, or only landed on it: -28 and -54 %.
    scene = room(casts)
    reference, _ = render_layers(scene, ReferenceSettings(spp=384, size=SIZE, bounces=2))
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(method=method, bounces=2, seed=seed)).layers["DiffuseIndirect"] for seed in range(3)]
    assert np.mean(ours) == pytest.approx(reference["DiffuseIndirect"].mean(), rel=0.02)
