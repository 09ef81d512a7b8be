"""Faces that lie on others, beside Cycles: both show them black, where they do."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material, quad
from .test_glass import slab

SIZE = (32, 16)
LEFT, RIGHT = (slice(4, 12), slice(3, 13)), (slice(4, 12), slice(19, 29))


def tables(axis, way, boards, walls=((-2, 2),)):
    """Boards of a table across an axis under a sun, and walls behind it that light it: each from x0 to x1, every other one with its other side up."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.5, 0.5, 0.5, 1), Specular_IOR_Level=0.0)

    def place(x, y, z):
        around = [0.0, 0.0, 0.0]
        around[axis], around[(axis + 1) % 3], around[(axis + 2) % 3] = way * (1.3 + z), x, way * y
        return around

    for k, (x0, x1) in enumerate(boards):
        corners = [place(x0, -1, 0), place(x1, -1, 0), place(x1, 1, 0), place(x0, 1, 0)]
        quad(scene, corners[:: -1 if k % 2 else 1], white)
    for k, (x0, x1) in enumerate(walls):
        corners = [place(x0, 1.2, -0.5), place(x1, 1.2, -0.5), place(x1, 1.2, 2), place(x0, 1.2, 2)]
        quad(scene, corners[:: -1 if k % 2 else 1], white)
    upright = Matrix([Vector(place(*unit)) - Vector(place(0, 0, 0)) for unit in np.eye(3)]).transposed()
    lamp(scene, "SUN", place(0, 0, 4), (upright @ Matrix.Rotation(0.6, 3, "X")).to_euler(), energy=3.0)
    look(scene, place(0, 0, 4), upright.to_euler(), type="ORTHO", ortho_scale=4.0)
    return scene


@pytest.mark.parametrize(("axis", "way"), [(0, 1), (1, -1), (2, 1)])
def test_doubled_faces_are_as_black_as_in_cycles(axis, way):
    scene = tables(axis, way, ((-2, 0), (0, 2), (0, 2)))
    theirs, _ = render_layers(scene, ReferenceSettings(spp=64, size=SIZE, bounces=4))
    ours = render(extract_scene(scene, size=SIZE), RenderSettings()).layers
    for name in ("Direct", "Indirect"):
        for layers in (ours, theirs):
            assert layers[name][RIGHT].mean() < 0.02 * layers[name][LEFT].mean()
        assert ours[name][LEFT].mean() == pytest.approx(theirs[name][LEFT].mean(), rel=0.05)


@pytest.mark.parametrize(("axis", "way"), [(0, 1), (2, 1)])
def test_faces_are_black_where_others_cover_them_in_part(axis, way):
    # Two boards overlap, and end within pixels.  The wall behind the left one is doubled, and sends it less than the right one has.
    scene = tables(axis, way, ((-2, 0.63), (-0.57, 2)), walls=((-2, 2), (-3, 0)))
    theirs, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=4))
    ours = render(extract_scene(scene, size=SIZE), RenderSettings(pixel_samples=16, gather=64, denoise=False)).layers
    rows = slice(4, 12)
    for name in ("Direct", "Indirect"):
        for layers in (ours, theirs):
            assert not layers[name][rows, 13:20].any()
        for lit in (slice(1, 6), slice(6, 11), slice(22, 26), slice(26, 31)):
            assert ours[name][rows, lit].mean() == pytest.approx(theirs[name][rows, lit].mean(), rel=0.05)
    for layers in (ours, theirs):
        assert layers["Indirect"][rows, 2:7].mean() < 0.7 * layers["Indirect"][rows, 25:30].mean()
        for edge, share in ((11, 0.44), (21, 0.96)):
            assert layers["Direct"][rows, edge].mean() == pytest.approx(share * layers["Direct"][rows, 2:10].mean(), rel=0.05)
        assert np.allclose(layers["Albedo"][rows], 0.5, atol=1e-3)


@pytest.mark.parametrize("roughness", [0.0, 0.15], ids=["clear", "frosted"])
def test_glass_shows_nothing_of_the_floor_that_it_stands_on(roughness):
    # The lower part of each block shows its bottom: the left one's lies in the floor, the right one's just above.
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.6, 0.6, 0.6, 1), Specular_IOR_Level=0.0)
    quad(scene, [(-4, -4, 0), (4, -4, 0), (4, 3, 0), (-4, 3, 0)], white)
    quad(scene, [(-4, 3, 0), (4, 3, 0), (4, 3, 5), (-4, 3, 5)], white)
    glass = material("Glass", Transmission_Weight=1.0, Roughness=roughness, IOR=1.45)
    slab(scene, -1.5, -0.3, -0.6, 0.6, 0.0, 1.0, glass)
    slab(scene, 0.3, 1.5, -0.6, 0.6, 0.002, 1.002, glass)
    lamp(scene, "AREA", (0, -1, 4.5), (0, 0, 0), energy=200.0, size=2.0, seen=False)
    look(scene, (0, -6, 2.2), (1.22, 0, 0), lens=50)
    size = (64, 32)
    theirs, _ = render_layers(scene, ReferenceSettings(spp=256, size=size, bounces=4))
    ours = render(extract_scene(scene, size=size), RenderSettings(pixel_samples=16, denoise=False))
    assert any("'Slab'" in line and "lie exactly on others" in line for line in ours.stats["warnings"])
    rows, standing, above = slice(15, 18), slice(10, 26), slice(38, 54)
    for layers in (ours.layers, theirs):
        light = layers["GlossyIndirect"]
        assert light[rows, standing].mean() < 0.2 * light[rows, above].mean()
    for at in (standing, above):
        assert ours.layers["GlossyIndirect"][rows, at].mean() == pytest.approx(
            float(theirs["GlossyIndirect"][rows, at].mean()), rel=0.15, abs=0.01
        )
