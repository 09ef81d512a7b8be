"""Faces that lie on others, beside Cycles: both show them black."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material, quad

SIZE = (32, 16)
LEFT, RIGHT = (slice(4, 12), slice(3, 13)), (slice(4, 12), slice(19, 29))


def tables(axis, way):
    """Two tables across an axis under a sun, the right one doubled with its other side up; a wall lights both."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    white = material("White", Base_Color=(0.5, 0.5, 0.5, 1), Specular_IOR_Level=0.0)

    def place(x, y, z):
        around = [0.0, 0.0, 0.0]
        around[axis], around[(axis + 1) % 3], around[(axis + 2) % 3] = way * (1.3 + z), x, way * y
        return around

    for x0, x1 in ((-2, 0), (0, 2)):
        corners = [place(x0, -1, 0), place(x1, -1, 0), place(x1, 1, 0), place(x0, 1, 0)]
        quad(scene, corners, white)
        if x0 == 0:
            quad(scene, corners[::-1], white)
    quad(scene, [place(-2, 1.2, -0.5), place(2, 1.2, -0.5), place(2, 1.2, 2), place(-2, 1.2, 2)], white)
    upright = Matrix([Vector(place(*unit)) - Vector(place(0, 0, 0)) for unit in np.eye(3)]).transposed()
    lamp(scene, "SUN", place(0, 0, 4), (upright @ Matrix.Rotation(0.6, 3, "X")).to_euler(), energy=3.0)
    look(scene, place(0, 0, 4), upright.to_euler(), type="ORTHO", ortho_scale=4.0)
    return scene


@pytest.mark.parametrize(("axis", "way"), [(0, 1), (1, -1), (2, 1)])
def test_doubled_faces_are_as_black_as_in_cycles(axis, way):
    scene = tables(axis, way)
    theirs, _ = render_layers(scene, ReferenceSettings(spp=64, size=SIZE, bounces=4))
    ours = render(extract_scene(scene, size=SIZE), RenderSettings()).layers
    for name in ("Direct", "Indirect"):
        for layers in (ours, theirs):
            assert layers[name][RIGHT].mean() < 0.02 * layers[name][LEFT].mean()
        assert ours[name][LEFT].mean() == pytest.approx(theirs[name][LEFT].mean(), rel=0.05)
