"""Mirrors against Cycles: a mirror on the wall, a chrome ball and a polished block show the room as it is, lamps and all."""

import hashlib
import math
from pathlib import Path

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.metrics import net_relmse
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.cache import cached_halves

from .test_direct_light import lamp, look, material, quad
from .test_glass import shader

SIZE = (96, 54)
SPP = 128
SEEDS = 3


def room(roughness):
    """A corner with red and grey walls, a mirror, a ball and a block of one roughness, a bright sign behind the camera, and a lamp in view."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = material("Grey", Base_Color=(0.6, 0.5, 0.4, 1), Specular_IOR_Level=0.0)
    red = material("Red", Base_Color=(0.8, 0.1, 0.1, 1), Specular_IOR_Level=0.0)
    mirror = material("Mirror", Base_Color=(0.9, 0.85, 0.8, 1), Metallic=1.0, Roughness=roughness)
    black = material("Polish", Base_Color=(0.05, 0.05, 0.1, 1), Roughness=roughness)
    quad(scene, [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], grey)
    quad(scene, [(-2, 2, 0), (2, 2, 0), (2, 2, 3), (-2, 2, 3)], grey)
    quad(scene, [(-2, -2, 3), (2, -2, 3), (2, 2, 3), (-2, 2, 3)], grey)
    quad(scene, [(-2, -2, 0), (-2, 2, 0), (-2, 2, 3), (-2, -2, 3)], red)
    quad(scene, [(2, -2, 0), (2, 2, 0), (2, 2, 3), (2, -2, 3)], grey)
    quad(scene, [(-2, -2, 0), (2, -2, 0), (2, -2, 3), (-2, -2, 3)], grey)
    quad(scene, [(-1.3, 1.98, 0.7), (0.7, 1.98, 0.7), (0.7, 1.98, 2.4), (-1.3, 1.98, 2.4)], mirror)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.4, location=(1.1, 1.0, 0.4), segments=32, ring_count=16)
    ball = bpy.context.object
    ball.data.materials.append(mirror)
    ball.data.polygons.foreach_set("use_smooth", [True] * len(ball.data.polygons))
    bpy.ops.mesh.primitive_cube_add(size=0.6, location=(-0.9, 0.6, 0.3))
    bpy.context.object.data.materials.append(black)
    quad(
        scene,
        [(-0.8, -1.7, 1.2), (0.2, -1.7, 1.2), (0.2, -1.7, 1.9), (-0.8, -1.7, 1.9)],
        shader("Sign", "ShaderNodeEmission", Strength=4.0),
        seen=False,
    )
    lamp(scene, "POINT", (1.2, -0.9, 2.3), energy=40.0, shadow_soft_size=0.15, use_soft_falloff=False)
    # In a pixel of a less than perfect ball few of many normals show it: all noise, to whoever looks.
    scene.collection.objects[-1].visible_glossy = roughness == 0
    look(scene, (-0.2, -1.6, 1.5), (math.radians(84), 0, math.radians(-3)), lens=20.0)
    return scene


def pictures_of(roughness):
    """(halves of the reference, ours of some seeds)."""
    scene = room(roughness)
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "roughness": roughness}
    halves = cached_halves(scene, identity, size=SIZE, spp=SPP, bounces=4, seed=1)
    arrays = extract_scene(scene, size=SIZE)
    return halves, [render(arrays, RenderSettings(seed=seed)).layers for seed in range(SEEDS)]


@pytest.fixture(scope="module")
def perfect():
    return pictures_of(0.0)


def assert_energy(pictures, name):
    halves, ours = ([layers[name].mean((0, 1), dtype=float) for layers in some] for some in pictures)
    expected = np.mean(halves, axis=0)
    noise = np.abs(halves[0] - halves[1]) / 2 + np.std(ours, axis=0, ddof=1) / math.sqrt(SEEDS)
    assert (np.abs(np.mean(ours, axis=0) - expected) <= 0.015 * expected + 2 * noise).all()
    assert (noise <= 0.015 * expected).all()


def error(pictures, name):
    halves, ours = pictures
    return np.mean([net_relmse(layers[name], *(half[name] for half in halves)) for layers in ours])


@pytest.mark.parametrize("name", ["Direct", "GlossyIndirect", "Combined"])
def test_the_light_in_a_mirror_is_that_of_cycles(perfect, name):
    assert_energy(perfect, name)


@pytest.mark.parametrize(("name", "bound"), [("Direct", 0.008), ("GlossyIndirect", 0.012)])
def test_a_mirror_shows_a_sharp_picture(perfect, name, bound):
    # Where few rays from the lobe find it, and the denoiser sees no edge in it, it is .05 and .06.
    assert error(perfect, name) < bound


def test_the_light_in_a_less_than_perfect_mirror_is_that_of_cycles():
    assert_energy(pictures_of(0.06), "GlossyIndirect")
