"""Light that glass and polished metal throw elsewhere, against Cycles: below balls and before plates, and none through glass from a lamp of no size."""

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

SIZE = (72, 24)
SPP = 1024
SEEDS = 3
LARGEST_BIAS = {"ball": 0.05, "frosted": 0.1}  # glass is frosted by lobes about the way of clear glass, which is not quite all
LARGEST_ERROR = {"ball": 0.2, "frosted": 0.3}  # root mean square
THINGS = ("ball", "frosted", "point")  # a booth of each, from left to right
PLATES = {"polished": 0.2, "brushed": 0.4, "pipe": 0.25}  # roughness of a plate or a pipe in a booth of each
LARGEST_METAL_BIAS = {"polished": 0.05, "brushed": 0.05, "pipe": 0.07}  # eight seeds: +1 +- 1, +1 +- .5 and -4 +- 1 %
# Root mean square, net of the reference's noise: of the polished plate .22 by virtual lights alone, .12 by photons.
LARGEST_METAL_ERROR = 0.17


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


def metal_booths():
    """Three booths whose lamp lights nothing but a plate or a pipe, which throw its light on the floor."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.7, 0.6, 0.5, 1), Specular_IOR_Level=0.0)
    black = material("Black", Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0)
    for k, (thing, roughness) in enumerate(PLATES.items()):
        x = 2.0 * k - 2.0
        metal = material(thing, Metallic=1.0, Roughness=roughness, Base_Color=(0.9, 0.8, 0.6, 1))
        quad(scene, [(x - 1, -1, 0), (x + 1, -1, 0), (x + 1, 1, 0), (x - 1, 1, 0)], white)
        quad(scene, [(x - 1, -1, 0), (x - 1, 1, 0), (x - 1, 1, 3), (x - 1, -1, 3)], black)
        quad(scene, [(x + 1, -1, 0), (x + 1, -1, 3), (x + 1, 1, 3), (x + 1, 1, 0)], black)
        if thing == "pipe":
            bpy.ops.mesh.primitive_cylinder_add(radius=0.3, depth=1.0, vertices=64, end_fill_type="NOTHING", location=(x - 0.4, 0, 0.9))
            made = bpy.context.object
            made.rotation_euler = (math.radians(90), 0, 0)
            made.data.polygons.foreach_set("use_smooth", [True] * len(made.data.polygons))
            made.data.materials.append(metal)
        else:
            quad(scene, [(x - 0.65, -0.3, 0.6), (x - 0.25, -0.3, 1.0), (x - 0.25, 0.3, 1.0), (x - 0.65, 0.3, 0.6)], metal)
            made = scene.collection.objects[-1]
        made.visible_camera = made.visible_glossy = False
        lamp(scene, "SPOT", (x + 0.9, 0, 0.8), (0, math.radians(90), 0), energy=200.0, spot_size=math.radians(25), shadow_soft_size=0.1)
    look(scene, (0, 0, 6), (0, 0, 0), type="ORTHO", ortho_scale=6.0)
    return scene


def rendered(scene, name):
    """(halves of the reference, ours by several seeds)."""
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "scene": name}
    halves = cached_halves(scene, identity, size=SIZE, spp=SPP, bounces=4, seed=1)
    extracted = extract_scene(scene, size=SIZE)
    ours = [render(extracted, RenderSettings(seed=seed, denoise=False)).layers["DiffuseIndirect"] for seed in range(SEEDS)]
    return [half["DiffuseIndirect"] for half in halves], ours


@pytest.fixture(scope="module")
def pictures():
    """Of glass: what `rendered` has."""
    return rendered(booths(), "glass")


@pytest.fixture(scope="module")
def metal_pictures():
    """Of metal: what `rendered` has."""
    return rendered(metal_booths(), "metal")


def booth(layer, thing):
    """The part of a picture that shows it."""
    things = THINGS if thing in THINGS else tuple(PLATES)
    width = SIZE[0] // len(things)
    begin = things.index(thing) * width
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


@pytest.mark.parametrize("thing", list(PLATES))
def test_metal_throws_the_lamps_light_where_cycles_has_it(metal_pictures, thing):
    halves, ours = metal_pictures
    reference = np.mean([booth(half, thing) for half in halves], axis=0)
    mine = np.mean([booth(layer, thing) for layer in ours], axis=0)
    assert np.mean(mine) == pytest.approx(np.mean(reference), rel=LARGEST_METAL_BIAS[thing])
    one, other = (blocks(mine) - blocks(booth(half, thing)) for half in halves)  # whose noise is not the other's
    assert np.mean(one * other) < LARGEST_METAL_ERROR**2 * np.mean(blocks(reference) ** 2)
