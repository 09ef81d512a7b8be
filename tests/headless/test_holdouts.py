"""Holdouts: holes in the picture that light the rest of it, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.film import Film
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import lamp, look, material, quad
from .test_smooth import box

SIZE = (32, 18)


@pytest.fixture(scope="module")
def pictures():
    """A red box and one of glass on a grey floor before a wall, all under a lamp; both boxes are held out, the first by a collection."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = material("Grey", Base_Color=(0.6, 0.6, 0.6, 1), Specular_IOR_Level=0.0, Roughness=1.0)
    quad(scene, [(-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0)], grey)
    quad(scene, [(-3, 2, 0), (3, 2, 0), (3, 2, 3), (-3, 2, 3)], grey)
    red = box(
        scene, "Red", (-0.8, 0, 0.5), (1, 1, 1), material("Red", Base_Color=(0.8, 0.05, 0.05, 1), Specular_IOR_Level=0.0, Roughness=1.0)
    )
    glass = box(scene, "Glass", (0.9, 0, 0.4), (0.8, 0.8, 0.8), material("Glass", Transmission_Weight=1.0, Roughness=0.0))
    collection = bpy.data.collections.new("Held")
    scene.collection.children.link(collection)
    collection.objects.link(red)
    scene.collection.objects.unlink(red)
    bpy.context.view_layer.layer_collection.children["Held"].holdout = True
    glass.is_holdout = True
    lamp(scene, "AREA", (0, -1, 3), energy=100.0, size=1.0)
    look(scene, (0, -5, 1.5), (math.radians(80), 0, 0), lens=35)
    arrays = extract_scene(scene, size=SIZE)
    assert not any("holdout" in warning for warning in arrays.warnings)
    reference, _ = render_layers(scene, ReferenceSettings(spp=512, size=SIZE, bounces=2))
    film = Film(transparent=True)
    ours = render(arrays, RenderSettings(method="importance-sampling", bounces=2, denoise=False, gather=64, samples=64, film=film)).layers
    return reference, ours


def test_they_are_holes(pictures):
    reference, ours = pictures
    hole = reference["Combined"][..., :3].sum(axis=2) == 0
    assert 60 < hole.sum() < 300
    assert not ours["Combined"][hole].any()
    assert (ours["Combined"][..., 3] == 0).sum() == pytest.approx(hole.sum(), abs=5)


@pytest.mark.parametrize("layer", ["Direct", "DiffuseIndirect"])
def test_they_shade_and_colour_the_rest(pictures, layer):
    reference, ours = pictures
    np.testing.assert_allclose(ours[layer].mean(axis=(0, 1)), reference[layer].mean(axis=(0, 1)), rtol=0.05)
