"""Smooth shading over hard edges against Cycles, whose shadow rays leave from the surface that the normals tell of."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material

SIZE = (32, 18)


def box(scene, name, location, size, surface, *, inwards=False):
    """A box: smooth, with eight normals away from its middle, or seen from within, with flat sides."""
    mesh = bpy.data.meshes.new(name)
    corners = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh.from_pydata(corners, [], [face[::-1] for face in faces] if inwards else faces)
    mesh.materials.append(surface)
    mesh.polygons.foreach_set("use_smooth", [not inwards] * len(mesh.polygons))
    made = bpy.data.objects.new(name, mesh)
    made.location, made.scale = location, size
    scene.collection.objects.link(made)
    return made


@pytest.fixture(scope="module")
def pictures():
    """A white box in a grey room, and a lamp close to a wall, just below the top of the box: only a smooth surface has its light there."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey, white = (
        material(name, Base_Color=(c, c, c, 1), Specular_IOR_Level=0.0, Roughness=1.0) for name, c in (("Grey", 0.3), ("White", 0.8))
    )
    box(scene, "Room", (0, 0, 1.5), (4, 4, 3), grey, inwards=True)
    box(scene, "Box", (0, 0.2, 0.5), (1.6, 1.4, 0.96), white).rotation_euler[2] = 0.4
    lamp(
        scene,
        "SPOT",
        (1.9, 0.6, 0.93),
        (0, math.radians(92), 0),
        energy=200.0,
        shadow_soft_size=0.02,
        spot_size=math.radians(40),
        spot_blend=0.2,
    )
    look(scene, (-0.4, -1.9, 2.2), (math.radians(58), 0, 0), lens=22)
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=2))
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(method="importance-sampling", bounces=2, seed=seed, denoise=False)).layers for seed in range(4)]
    return reference, {name: np.mean([layers[name] for layers in ours], axis=0) for name in ("Direct", "DiffuseIndirect")}


def test_direct_light_of_a_lamp_beside_a_wall(pictures):
    """Rays that left from above went past the lamp, into the wall behind it."""
    reference, ours = pictures
    assert ours["Direct"].mean() == pytest.approx(np.mean(reference["Direct"]), rel=0.05)


def test_light_from_below_a_facet_is_reflected_on(pictures):
    """Neither particles nor rays along paths found it."""
    reference, ours = pictures
    assert ours["DiffuseIndirect"].mean() == pytest.approx(np.mean(reference["DiffuseIndirect"]), rel=0.08)
