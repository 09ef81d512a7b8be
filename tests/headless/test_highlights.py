"""Highlights of a sun and a small lamp on balls and handles of ten pixels, against Cycles."""

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material

SIZE = (120, 40)


def small_things():
    """A row of steel balls over a row of steel handles, of roughness .1 to .3, and nothing else to be seen."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    for k in range(8):
        steel = material(f"Steel {k}", Base_Color=(0.8, 0.8, 0.8, 1), Metallic=1.0, Roughness=(0.1, 0.15, 0.2, 0.3)[k % 4])
        x = 0.3 * k - 1.05
        bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=0.1, location=(x, 0, 0.15))
        bpy.ops.object.shade_smooth()
        bpy.context.object.data.materials.append(steel)
        bpy.ops.mesh.primitive_cylinder_add(vertices=32, radius=0.03, depth=0.2, location=(x, 0, -0.15), rotation=(0.2 * k, 0.7, 0.3 * k))
        bpy.ops.object.shade_smooth()
        bpy.context.object.data.materials.append(steel)
    lamp(scene, "SUN", (0, 0, 5), (0.6, 0.4, 0.0), energy=3.0, angle=math.radians(0.53))
    lamp(scene, "POINT", (-1.5, -3, 0.5), energy=100.0, shadow_soft_size=0.01)
    look(scene, (0, -4, 0), (math.pi / 2, 0, 0), type="ORTHO", ortho_scale=2.4)
    return scene


@pytest.mark.slow
def test_small_things_shine():
    scene = small_things()
    reference, _ = render_layers(scene, ReferenceSettings(spp=1024, size=SIZE, bounces=0))
    expected = reference["Direct"].astype(float)
    arrays = extract_scene(scene, size=SIZE)
    ours = [render(arrays, RenderSettings(method="importance-sampling", bounces=0, seed=seed)).layers["Direct"] for seed in range(4)]
    # Before, most of it was smoothed away.
    assert np.mean(ours) == pytest.approx(expected.mean(), rel=0.08)
    for found in ours:
        assert np.sqrt(np.mean((found - expected) ** 2)) < 0.6 * np.sqrt(np.mean(expected**2))


def test_a_lamp_shows_in_every_small_mirror():
    """In parts of the pixels of a ball of 12 pixels, each of which turns by ten degrees: by one normal a pixel showed all of it or nothing (+- 81 %)."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=0.4, location=(0, 0, 0))
    bpy.ops.object.shade_smooth()
    bpy.context.object.data.materials.append(material("Chrome", Base_Color=(0.9, 0.9, 0.9, 1), Metallic=1.0, Roughness=0.05))
    lamp(scene, "AREA", (0.4, -1.5, 1.5), (math.radians(45), 0, 0), energy=50.0, shape="DISK", size=0.6)
    look(scene, (0, -2, 0), (math.pi / 2, 0, 0), lens=45)
    size = (24, 16)
    reference, _ = render_layers(scene, ReferenceSettings(spp=1024, size=size, bounces=0))
    arrays = extract_scene(scene, size=size)
    settings = RenderSettings(method="importance-sampling", bounces=0, denoise=False)
    found = [render(arrays, replace(settings, seed=seed)).layers["Direct"].mean() for seed in range(16)]
    expected = float(reference["Direct"].mean())
    assert np.mean(found) == pytest.approx(expected, rel=0.08)
    assert np.std(found) < 0.55 * expected


@pytest.mark.parametrize("roughness", [0.1, 0.3])
def test_rods_shine_in_light_from_aside(roughness):
    """Legs of steel of one to two pixels, whose lamp shows in none of their normals, or behind their mean: of such light a half to two thirds were lacking."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    for k in range(10):
        bpy.ops.mesh.primitive_cylinder_add(
            vertices=32, radius=0.02 + 0.002 * k, depth=1, location=(0.2 * k - 0.9, 0, 0), end_fill_type="NOTHING"
        )
        bpy.ops.object.shade_smooth()
        bpy.context.object.data.materials.append(material(f"Steel {k}", Base_Color=(0.8, 0.8, 0.8, 1), Metallic=1.0, Roughness=roughness))
    lamp(scene, "SUN", (0, 0, 5), (math.radians(70), 0, math.radians(75)), energy=3.0, angle=math.radians(0.53))
    look(scene, (0, -4, 0), (math.pi / 2, 0, 0), type="ORTHO", ortho_scale=2.1)
    size = (64, 24)
    reference, _ = render_layers(scene, ReferenceSettings(spp=512, size=size, bounces=0))
    arrays = extract_scene(scene, size=size)
    settings = RenderSettings(method="importance-sampling", bounces=0, denoise=False, layers=("Direct",))
    found = np.mean([render(arrays, replace(settings, seed=seed)).layers["Direct"].mean() for seed in range(4)])
    assert found == pytest.approx(float(reference["Direct"].mean()), rel=0.06)
