"""Light that glass throws elsewhere, against Cycles: below a ball and a frosted ball, and none from a lamp of no size."""

import hashlib
from pathlib import Path

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.cache import cached_halves

from .test_direct_light import lamp, look, material, quad

SIZE = (72, 24)
SPP = 1024
SEEDS = 3
LARGEST_BIAS = {"ball": 0.05, "frosted": 0.1}  # glass is frosted by lobes about the way of clear glass, which is not quite all
LARGEST_ERROR = {"ball": 0.2, "frosted": 0.3}  # root mean square
THINGS = ("ball", "frosted", "point")  # a booth of each, from left to right


def ball(x, surface):
    """A smooth ball above a floor."""
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.4, location=(x, 0, 0.8), segments=96, ring_count=48)
    made = bpy.context.object
    made.data.polygons.foreach_set("use_smooth", [True] * len(made.data.polygons))
    made.data.materials.append(surface)
    return made


def booths():
    """Three booths, seen from above, where nothing but glass and a floor is not black: what glass throws is nearly all indirect light."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.7, 0.6, 0.5, 1), Specular_IOR_Level=0.0)
    black = material("Black", Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0)
    clear = material("Glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.5, Base_Color=(1, 0.9, 0.8, 1))
    frosted = material("Frosted", Transmission_Weight=1.0, Roughness=0.3, IOR=1.5)
    for k, thing in enumerate(THINGS):
        x = 2.0 * k - 2.0
        quad(scene, [(x - 1, -1, 0), (x + 1, -1, 0), (x + 1, 1, 0), (x - 1, 1, 0)], white)
        quad(scene, [(x - 1, -1, 0), (x - 1, 1, 0), (x - 1, 1, 3), (x - 1, -1, 3)], black)
        quad(scene, [(x + 1, -1, 0), (x + 1, 1, 0), (x + 1, 1, 3), (x + 1, -1, 3)], black)
        if thing == "point":
            lamp(scene, "POINT", (x + 0.3, 0, 2.6), energy=30.0, shadow_soft_size=0.0)
        else:
            lamp(scene, "AREA", (x + 0.3, 0, 2.6), energy=30.0, size=0.5, seen=False)
            scene.collection.objects[-1].visible_glossy = False
        made = ball(x, frosted if thing == "frosted" else clear)
        made.visible_camera = made.visible_glossy = False  # the floor below it is seen
    look(scene, (0, 0, 6), (0, 0, 0), type="ORTHO", ortho_scale=6.0)
    return scene


@pytest.fixture(scope="module")
def pictures():
    """(halves of the reference, ours by several seeds)."""
    scene = booths()
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest()}
    halves = cached_halves(scene, identity, size=SIZE, spp=SPP, bounces=4, seed=1)
    extracted = extract_scene(scene, size=SIZE)
    ours = [render(extracted, RenderSettings(seed=seed, denoise=False)).layers["DiffuseIndirect"] for seed in range(SEEDS)]
    return [half["DiffuseIndirect"] for half in halves], ours


def booth(layer, thing):
    """The part of a picture that shows it."""
    width = SIZE[0] // len(THINGS)
    begin = THINGS.index(thing) * width
    return layer[:, begin + 1 : begin + width - 1]


def blocks(picture):
    """Means of 2 x 2 pixels, for the reference's sparks."""
    high, wide = picture.shape[0] // 2, picture.shape[1] // 2
    return picture.reshape(high, 2, wide, 2, 3).mean(axis=(1, 3))


@pytest.mark.parametrize("thing", ["ball", "frosted"])
def test_glass_throws_the_lamps_light_where_cycles_has_it(pictures, thing):
    halves, ours = pictures
    reference = np.mean([booth(half, thing) for half in halves], axis=0)
    mine = np.mean([booth(layer, thing) for layer in ours], axis=0)
    assert np.mean(mine) == pytest.approx(np.mean(reference), rel=LARGEST_BIAS[thing])
    error = np.sqrt(np.mean((blocks(mine) - blocks(reference)) ** 2))
    assert error < LARGEST_ERROR[thing] * np.sqrt(np.mean(blocks(reference) ** 2))


def test_a_lamp_of_no_size_throws_none(pictures):
    halves, ours = pictures
    lit = np.mean([booth(half, "ball") for half in halves])
    assert np.mean([booth(half, "point") for half in halves]) < 0.02 * lit
    assert np.mean([booth(layer, "point") for layer in ours]) < 0.02 * lit
