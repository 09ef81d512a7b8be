"""Glass bends what is seen through it, as in Cycles: a ball shows the room upside down, a thick block and a sheet of one plane displace it.

So it does for what a glossy floor shows of it, and of the lamp beyond.
"""

import hashlib
import math
from dataclasses import replace
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
from .test_glass import slab

SIZE = (72, 32)
SPP = 512
# Where in the picture each thing lies, without its edges; of the ball, whose rim shows what is reflected within, which leaves it straight here, the middle.
THINGS = {"ball": (slice(10, 23), slice(6, 19)), "block": (slice(8, 24), slice(28, 44)), "sheet": (slice(8, 24), slice(51, 69))}


def show(roughness=0.0):
    """A ball, a block and a sheet of glass before a chequered wall."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    colours = [
        material(f"Wall {k}", Base_Color=(*rgb, 1), Specular_IOR_Level=0.0) for k, rgb in enumerate(((0.8, 0.1, 0.1), (0.7, 0.7, 0.7)))
    ]
    for k in range(8):
        for row in range(4):
            x, z = k - 4.0, row - 2.0
            quad(scene, [(x, 2, z), (x + 1, 2, z), (x + 1, 2, z + 1), (x, 2, z + 1)], colours[(k + row) % 2])
    quad(scene, [(-4, -2, -2), (4, -2, -2), (4, 2, -2), (-4, 2, -2)], colours[1])
    lamp(scene, "AREA", (0, -1.5, 2.5), (math.radians(-40), 0, 0), energy=400.0, size=2.0, seen=False)
    # What shows of it in glass, reflected inside, shadow rays find, which go straight.
    scene.collection.objects[-1].visible_glossy = scene.collection.objects[-1].visible_transmission = False
    glass = material("Glass", Transmission_Weight=1.0, Roughness=roughness, IOR=1.5)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=1.0, location=(-2.4, 0, 0), segments=64, ring_count=32)
    bpy.context.object.data.polygons.foreach_set("use_smooth", [True] * len(bpy.context.object.data.polygons))
    bpy.context.object.data.materials.append(glass)
    slab(scene, -0.9, 0.9, -0.5, 0.5, -1.1, 1.1, glass)
    block = scene.collection.objects[-1]
    block.rotation_euler = (0, 0, math.radians(15))
    quad(scene, [(1.5, -0.4, -1.1), (3.3, 0.6, -1.1), (3.3, 0.6, 1.1), (1.5, -0.4, 1.1)], glass)
    for thing in (bpy.context.object, block, scene.collection.objects[-1]):
        thing.visible_diffuse = thing.visible_shadow = False  # light comes to the wall past them, in both programs
    look(scene, (0, -6, 0), (math.pi / 2, 0, 0), type="ORTHO", ortho_scale=7.2)
    return scene


@pytest.fixture(scope="module", params=[0.0, 0.12], ids=["clear", "frosted"])
def pictures(request):
    """(halves of the reference, ours)."""
    scene = show(request.param)
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "roughness": request.param}
    halves = cached_halves(scene, identity, size=SIZE, spp=SPP, bounces=4, seed=1)
    return halves, render(extract_scene(scene, size=SIZE), RenderSettings(pixel_samples=64, denoise=False)).layers


@pytest.mark.parametrize("thing", THINGS)
def test_what_is_seen_through_glass_lies_where_cycles_has_it(pictures, thing):
    halves, ours = pictures
    a, b, mine = (layers["GlossyIndirect"][THINGS[thing]] for layers in (*halves, ours))
    assert np.mean(mine) == pytest.approx((np.mean(a) + np.mean(b)) / 2, rel=0.03)
    assert net_relmse(mine, a, b) < 0.02


def polished_floor():
    """A glossy floor below a ball of glass that the camera does not see, a lamp and boards above, seen from above."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    quad(
        scene,
        [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)],
        material("Floor", Base_Color=(0.7, 0.7, 0.7, 1), Metallic=1.0, Roughness=0.3),
    )
    for x, colour in ((-3, (0.8, 0.1, 0.1)), (0, (0.1, 0.1, 0.8))):
        board = [(x, -3, 2.5), (x + 3, -3, 2.5), (x + 3, 3, 2.5), (x, 3, 2.5)]
        quad(scene, board, material(f"Board {x}", Base_Color=(*colour, 1), Specular_IOR_Level=0.0), seen=False)
    lamp(scene, "AREA", (0.9, 0.6, 2.3), energy=40.0, size=1.2)
    lamp(scene, "AREA", (-1.5, 0, 0.5), (math.pi, 0, 0), energy=60.0, size=0.5, seen=False)
    scene.collection.objects[-1].visible_glossy = False
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, location=(0, 0, 0.9), segments=64, ring_count=32)
    ball = bpy.context.object
    ball.data.polygons.foreach_set("use_smooth", [True] * len(ball.data.polygons))
    ball.data.materials.append(material("Glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.5))
    ball.visible_camera = False
    look(scene, (0, 0, 8), (0, 0, 0), type="ORTHO", ortho_scale=1.8)
    return scene


def test_glossy_surfaces_show_what_glass_bends():
    """Straight rays have the lamp on the wrong side of the ball: an error of 10."""
    scene = polished_floor()
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "thing": "floor"}
    halves = cached_halves(scene, identity, size=(16, 16), spp=1024, bounces=4, seed=1)
    arrays = extract_scene(scene, size=(16, 16))
    settings = RenderSettings(pixel_samples=16, reflections=64, denoise=False)
    ours = np.mean([render(arrays, replace(settings, seed=seed)).layers["GlossyIndirect"] for seed in range(4)], axis=0)
    a, b, mine = (picture.reshape(4, 4, 4, 4, 3).mean(axis=(1, 3)) for picture in (*(layers["GlossyIndirect"] for layers in halves), ours))
    assert np.mean(mine) == pytest.approx(float(np.mean(a) + np.mean(b)) / 2, rel=0.04)
    assert net_relmse(mine, a, b) < 0.03


def test_lamps_show_in_both_sides_of_a_pane_at_one_place():
    """What its back mirrors is bent by its front again: found by straight rays, the lamp showed there elsewhere, as a white dot."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    glass = material("Glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.5, Base_Color=(1, 1, 1, 1))
    slab(scene, -0.02, 0, -2, 2, -2, 2, glass)
    lamp(scene, "POINT", (3, 0, -3), (0, 0, 0), energy=100.0, shadow_soft_size=0.3)
    look(scene, (3, 0, 3), (0, math.radians(45), 0), type="ORTHO", ortho_scale=1.0)
    layers = render(extract_scene(scene, size=(24, 24)), RenderSettings(pixel_samples=16, denoise=False)).layers
    within = math.asin(math.sin(math.pi / 4) / 1.5)
    across, along = (
        math.sin(math.pi / 4 - within) / math.sin(math.pi / 4 + within),
        math.tan(math.pi / 4 - within) / math.tan(math.pi / 4 + within),
    )
    mirrored = (across**2 + along**2) / 2
    assert layers["Direct"].sum() > 0
    assert layers["GlossyIndirect"].sum() / layers["Direct"].sum() == pytest.approx((1 - mirrored) ** 2, rel=0.08)


def test_glass_that_shares_normals_with_its_rim_shows_no_lamps_that_are_not_seen_in_it():
    """Cycles bends such normals until what they mirror lies above the surface, and loses what they send back: straight rays had the lamp in a wall of the tumbler."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    dull = material("Floor", Base_Color=(0.5, 0.5, 0.5, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-3, -3, -0.01), (3, -3, -0.01), (3, 3, -0.01), (-3, 3, -0.01)], dull)
    quad(scene, [(-3, 2, -1), (3, 2, -1), (3, 2, 4), (-3, 2, 4)], dull)
    profile, around = [(1e-4, 0), (0.18, 0), (0.2, 0.5), (0.185, 0.5), (0.165, 0.06), (1e-4, 0.06)], 32
    turns = [2 * math.pi * k / around for k in range(around)]
    corners = [(r * math.cos(t), r * math.sin(t), z) for r, z in profile for t in turns]
    rings = [(i * around, k, (k + 1) % around) for i in range(len(profile) - 1) for k in range(around)]
    mesh = bpy.data.meshes.new("Tumbler")
    mesh.from_pydata(corners, [], [(i + k, i + n, i + around + n, i + around + k) for i, k, n in rings])
    mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
    mesh.materials.append(material("Glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.5, Base_Color=(1, 1, 1, 1)))
    scene.collection.objects.link(bpy.data.objects.new("Tumbler", mesh))
    lamp(scene, "AREA", (0, -0.1, 2.5), (0, 0, 0), energy=60.0, size=0.8)
    look(scene, (0, -2, 0.6), (math.radians(80), 0, 0), type="ORTHO", ortho_scale=0.4)
    size = (16, 16)
    identity = {"module": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), "thing": "tumbler"}
    halves = cached_halves(scene, identity, size=size, spp=512, bounces=4, seed=1)
    expected = np.mean([layers["GlossyIndirect"] for layers in halves])
    arrays = extract_scene(scene, size=size)
    ours = np.mean([render(arrays, RenderSettings(seed=seed, denoise=False)).layers["GlossyIndirect"] for seed in range(4)])
    assert ours == pytest.approx(expected, rel=0.35)
