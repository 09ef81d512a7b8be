"""A panorama of a room, pixel by pixel, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material
from .test_smooth import box

SIZE = (48, 24)


@pytest.fixture(scope="module", params=["whole", "part"])
def pictures(request):
    """A room of four colours with a lamp, all around a tilted camera, or the part of it that a border cuts from a narrower panorama."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    box(scene, "Room", (0, 0, 1.5), (5, 6, 3), material("Wall", Base_Color=(0.6, 0.6, 0.6, 1), Specular_IOR_Level=0.0), inwards=True)
    for name, place, colour in (("Red", (1.5, 1, 0.5), (0.8, 0.1, 0.1, 1)), ("Blue", (-1.5, -1, 0.5), (0.1, 0.1, 0.8, 1))):
        box(scene, name, place, (0.7, 0.7, 1), material(name, Base_Color=colour, Specular_IOR_Level=0.0))
    lamp(scene, "AREA", (0.5, 0.5, 2.9), energy=60.0, size=0.8)
    look(scene, (0.3, -0.4, 1.2), (math.radians(80), math.radians(10), math.radians(30)), lens=35)
    data = scene.camera.data
    data.type = "PANO"
    view = data if hasattr(data, "panorama_type") else data.cycles
    view.panorama_type = "EQUIRECTANGULAR"
    if request.param == "part":
        view.longitude_min, view.longitude_max, view.latitude_min, view.latitude_max = -1.2, 1.9, -0.7, 1.1
        frame = scene.render
        frame.use_border, frame.border_min_x, frame.border_max_y = True, 0.25, 0.75
    reference, _ = render_layers(scene, ReferenceSettings(spp=256, size=SIZE, bounces=2))
    ours = render(extract_scene(scene, size=SIZE), RenderSettings(method="importance-sampling", bounces=2)).layers
    return reference, ours


def test_pixels_look_where_cycles_look(pictures):
    reference, ours = pictures
    assert ours["Albedo"].shape == reference["Albedo"].shape
    np.testing.assert_allclose(ours["Albedo"].mean(axis=(0, 1)), reference["Albedo"].mean(axis=(0, 1)), rtol=0.005)
    assert (np.abs(ours["Albedo"] - reference["Albedo"]).max(axis=2) > 0.05).mean() < 0.05  # edges
    assert np.median(np.abs(ours["Depth"] / reference["Depth"] - 1)) < 0.05  # of the nearest sample


@pytest.mark.parametrize("layer", ["Direct", "DiffuseIndirect", "Emission"])
def test_it_has_the_light_of_cycles(pictures, layer):
    reference, ours = pictures
    np.testing.assert_allclose(ours[layer].mean(axis=(0, 1)), reference[layer].mean(axis=(0, 1)), rtol=0.03)
