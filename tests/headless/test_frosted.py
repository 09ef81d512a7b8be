"""Frosted glass against Cycles: a pane with a lamp behind it, in a room of two colours."""

import math
from dataclasses import replace

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material, quad
from .test_glass import shader, slab

SIZE = (24, 14)
THIN = pytest.mark.skipif(bpy.app.version < (5, 2), reason="Blender 5.2 has thin walls")
LIGHT = ("Direct", "GlossyIndirect")  # what comes through a thin wall is direct light, through a pane of two sides it is not


def before_a_lamp(glass):
    """A pane of 2 cm from wall to wall; behind it a small lamp before a wall that is red on the left and white on the right."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    red, white = (
        material(name, Base_Color=(*color, 1), Specular_IOR_Level=0.0)
        for name, color in (("Red", (0.7, 0.1, 0.1)), ("White", (0.7, 0.7, 0.7)))
    )
    for left, right, surface in ((-3, 0, red), (0, 3, white)):
        quad(scene, [(left, 4, -2), (right, 4, -2), (right, 4, 2), (left, 4, 2)], surface)
    if glass == "thin":
        pane = material("Frosted", Transmission_Weight=1.0, Roughness=0.5, IOR=1.45, Base_Color=(0.8, 0.9, 1.0, 1), Thin_Wall=True)
        quad(scene, [(-3, 2, -2), (3, 2, -2), (3, 2, 2), (-3, 2, 2)], pane)
    elif glass == "principled":
        pane = material("Frosted", Transmission_Weight=1.0, Roughness=0.6, IOR=1.45, Base_Color=(0.8, 0.9, 1.0, 1))
    else:
        pane = shader("Frosted", "ShaderNodeBsdfGlass", Roughness=0.5, IOR=1.5)
    if glass != "thin":
        slab(scene, -3, 3, 2.0, 2.02, -2, 2, pane)
    lamp(scene, "POINT", (0.4, 3.2, 0.3), energy=20.0, shadow_soft_size=0.03)
    look(scene, (0, 0, 0), (math.pi / 2, 0, 0), lens=30)
    return scene


@pytest.fixture(scope="module", params=["principled", "glass", pytest.param("thin", marks=THIN)])
def pictures(request):
    scene = before_a_lamp(request.param)
    reference, _ = render_layers(scene, ReferenceSettings(spp=512, size=SIZE, bounces=1))
    arrays = extract_scene(scene, size=SIZE)
    settings = RenderSettings(method="importance-sampling", bounces=1, reflections=32, denoise=False)
    ours = [render(arrays, replace(settings, seed=seed)).layers for seed in range(2)]
    return reference, {name: np.mean([layers[name] for layers in ours], axis=0) for name in (*LIGHT, "Combined")}


def test_a_frosted_pane_passes_as_much_light_as_in_cycles(pictures):
    reference, ours = pictures
    for name in LIGHT:
        assert ours[name].mean() == pytest.approx(np.mean(reference[name]), rel=0.09)
    assert ours["Combined"].mean() == pytest.approx(np.mean(reference["Combined"]), rel=0.09)


def test_the_lamp_glows_in_the_pane_and_the_wall_is_blurred(pictures):
    """By blocks of two pixels: clear glass has less than a third of the light beside the lamp, and a hard edge between the colours."""
    reference, ours = ((some["Direct"] + some["GlossyIndirect"]).reshape(7, 2, 12, 2, 3).mean((1, 3)) for some in pictures)
    light = reference.mean(-1)
    np.testing.assert_allclose(ours.mean(-1), light, rtol=0.25, atol=0.03 * light.max())
    red, expected = ((some[..., 0] / some.sum(-1))[5:] for some in (ours, reference))
    np.testing.assert_allclose(red.mean(0), expected.mean(0), atol=0.12)


@THIN
@pytest.mark.parametrize("angle", [0.0, 0.8])
def test_a_thin_wall_has_the_tint_and_the_reflections_of_both_sides(angle):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    wall = material("Wall", Transmission_Weight=1.0, Roughness=0.0, IOR=1.5, Base_Color=(0.8, 0.5, 0.2, 1), Thin_Wall=True)
    quad(scene, [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], wall)
    quad(scene, [(-90, -90, -5), (90, -90, -5), (90, 90, -5), (-90, 90, -5)], shader("Light", "ShaderNodeEmission", Strength=1.0))
    look(scene, (0, -5 * math.sin(angle), 5 * math.cos(angle)), (angle, 0, 0), type="ORTHO", ortho_scale=0.2)
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=(4, 4), bounces=1))
    found = render(extract_scene(scene, size=(4, 4)), RenderSettings(bounces=1, denoise=False)).layers
    np.testing.assert_allclose(found["Combined"].mean((0, 1)), reference["Combined"].mean((0, 1)), rtol=0.01)


def ball(scene, surface, radius, *, inwards=False):
    """A smooth ball about the origin, whose faces look inwards or outwards."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=radius)
    made = bpy.context.object
    made.data.shade_smooth()
    if inwards:
        made.data.flip_normals()
    made.data.materials.append(surface)
    return made


def in_a_shade(roughness):
    """A round shade of frosted glass, 8 mm thick, with a lamp of 3 cm in its middle, before a wall."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    glass = material("Frosted", Transmission_Weight=1.0, Roughness=roughness, IOR=1.45)
    wall = material("Wall", Base_Color=(0.6, 0.6, 0.6, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1)], wall)
    ball(scene, glass, 0.16)
    ball(scene, glass, 0.152, inwards=True)
    lamp(scene, "POINT", (0, 0, 0), energy=45.0, shadow_soft_size=0.03)
    look(scene, (0, -1.2, 0), (math.pi / 2, 0, 0), lens=60)
    return scene


@pytest.mark.parametrize("roughness", [0.1, 0.35])
def test_a_lamp_in_a_frosted_shade_is_as_bright_as_in_cycles_and_nowhere_brighter_than_itself(roughness):
    """Rays that end at the far side of the shade by chance had the lamp on their way with what that chance weighs: 30 times its light, which passing rays had, too."""
    scene, size = in_a_shade(roughness), (64, 64)
    reference, _ = render_layers(scene, ReferenceSettings(spp=128, size=size, bounces=2))
    arrays = extract_scene(scene, size=size)
    settings = RenderSettings(method="importance-sampling", bounces=2, denoise=False)
    ours = [render(arrays, replace(settings, seed=seed)).layers["GlossyIndirect"] for seed in range(2)]
    radiance = 45 / (4 * math.pi**2 * 0.03**2)
    assert np.max(ours) < 1.2 * radiance
    expected = reference["GlossyIndirect"]
    assert np.mean(ours) == pytest.approx(expected.mean(), rel=0.2)
    # What shines through the side before the lamp is not blurred by the side behind it as well.
    y, x = np.mgrid[:64, :64] - 31.5
    halo = (np.hypot(y, x) > 4) & (np.hypot(y, x) < 8)
    assert np.mean(ours, axis=0)[halo].mean() < 1.7 * expected[halo].mean() or roughness < 0.2


def frosted(roughness):
    return material("Frosted", Transmission_Weight=1.0, Roughness=roughness, IOR=1.45)


def in_a_ball():
    """A lamp in a ball of frosted glass, as shades are made of one ball without a thickness, before a wall."""
    scene = in_a_shade(0.35)
    bpy.data.objects.remove(scene.objects["Sphere.001"])
    return scene, "DiffuseIndirect"


def behind_a_sheet(side):
    """A room parted by frosted glass of one plane, with a lamp on the side of its front, behind which the camera is not, or on the other."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    wall = material("Wall", Base_Color=(0.6, 0.6, 0.6, 1), Specular_IOR_Level=0.0)
    corners = [(x, y, z) for z in (0, 3) for y in (0, 3) for x in (-2, 2)]
    for face in ((0, 1, 3, 2), (4, 5, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5), (2, 3, 7, 6)):
        quad(scene, [corners[k] for k in face], wall)
    quad(scene, [(-2, 2, 0), (2, 2, 0), (2, 2, 3), (-2, 2, 3)], frosted(0.3))
    lamp(scene, "POINT", (0.3, 2.5 if side == "beyond" else 0.7, 1.7), energy=60.0, shadow_soft_size=0.1)
    look(scene, (0, 0.1, 1.5), (math.pi / 2, 0, 0), lens=16)
    return scene, "DiffuseIndirect" if side == "beyond" else "GlossyIndirect"


@pytest.mark.parametrize(
    "built", [in_a_ball, lambda: behind_a_sheet("beyond"), lambda: behind_a_sheet("before")], ids=["ball", "beyond", "before"]
)
def test_lamps_on_the_other_side_of_a_frosted_sheet_send_the_square_of_the_index(built):
    """Half of the light was missing around the ball, and half too much behind the sheet, where the lamp's light went straight through."""
    scene, layer = built()
    size = (32, 24)
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=size, bounces=2))
    arrays = extract_scene(scene, size=size)
    settings = RenderSettings(method="importance-sampling", bounces=2, denoise=False)
    ours = [render(arrays, replace(settings, seed=seed)).layers[layer] for seed in range(1)]
    assert np.mean(ours) == pytest.approx(reference[layer].mean(), rel=0.2)


def below_a_skylight(roughness, distribution):
    """The sun through a pane of frosted glass in a black lid, on a floor of which the camera sees all."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.7, 0.7, 0.7, 1), Specular_IOR_Level=0.0)
    black = material("Black", Base_Color=(0.0, 0.0, 0.0, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0)], white)
    for x0, x1, y0, y1 in ((-9, -1, -9, 9), (1, 9, -9, 9), (-1, 1, -9, -1), (-1, 1, 1, 9)):
        quad(scene, [(x0, y0, 2), (x1, y0, 2), (x1, y1, 2), (x0, y1, 2)], black)
    glass = frosted(roughness)
    next(node for node in glass.node_tree.nodes if node.type == "BSDF_PRINCIPLED").distribution = distribution
    slab(scene, -1, 1, -1, 1, 2, 2.03, glass)
    lamp(scene, "SUN", (0, 0, 5), (0, 0.6, 0), energy=4.0, angle=0.02)
    look(scene, (0, 0, 1.95), (0, 0, 0), lens=11)
    return scene


@pytest.mark.parametrize("distribution", ["MULTI_GGX", "GGX"])
def test_frosted_skylights_scatter_the_sun(distribution):
    """By straight rays there was a patch as sharp as through clear glass, of two thirds of the light."""
    scene, size = below_a_skylight(0.8, distribution), (32, 32)
    reference, _ = render_layers(scene, ReferenceSettings(spp=64, size=size, bounces=1))
    settings = RenderSettings(method="importance-sampling", bounces=1, denoise=False)
    ours = render(extract_scene(scene, size=size), settings).layers
    blocks, expected = (layers["DiffuseIndirect"].reshape(8, 4, 8, 4, 3).mean((1, 3, 4)) for layers in (ours, reference))
    assert blocks.mean() == pytest.approx(float(expected.mean()), rel=0.2)
    lit = expected > 0.2 * expected.max()
    assert (
        np.sqrt(np.mean((blocks[lit] / blocks.mean() - expected[lit] / expected.mean()) ** 2))
        < 0.25 * (expected[lit] / expected.mean()).mean()
    )


# Measured: at .8 we are 11 % too dark, and 17 where light is lost.
@pytest.mark.parametrize(("distribution", "limit"), [("MULTI_GGX", 0.14), ("GGX", 0.2)])
def test_rough_panes_are_as_clear_as_in_cycles(distribution, limit):
    """Views that look straight through panes of differing roughness at a bright plane: where no light is lost a pane of .8 showed 57 % of it, to Cycles it shows 97."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    for k, roughness in enumerate((0.1, 0.4, 0.6, 0.8)):
        glass = shader("Frosted", "ShaderNodeBsdfGlass", Roughness=roughness, IOR=1.45)
        next(node for node in glass.node_tree.nodes if node.type == "BSDF_GLASS").distribution = distribution
        slab(scene, 30 * k, 30 * k + 30, 0, 30, 2, 2.02, glass)
    quad(scene, [(-900, -900, 0), (900, -900, 0), (900, 900, 0), (-900, 900, 0)], shader("Light", "ShaderNodeEmission", Strength=1.0))
    look(scene, (60, 15, 9), (0, 0, 0), type="ORTHO", ortho_scale=120)
    size = (16, 4)
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=size, bounces=1))
    arrays = extract_scene(scene, size=size)
    ours = [render(arrays, RenderSettings(bounces=1, denoise=False, seed=seed)).layers["Combined"] for seed in range(6)]
    shown, expected = (image[..., 0].reshape(4, 4, 4).mean((0, 2)) for image in (np.mean(ours, axis=0), reference["Combined"]))
    np.testing.assert_allclose(shown, expected, rtol=limit)
