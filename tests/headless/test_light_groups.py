"""Light groups on the command line and in Cycles' references: the same names, and the same light."""

import bpy
import numpy as np
import pytest

from lumigate import sample_scenes
from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.headless import reference
from lumigate.headless.arguments import parse

NAMES = ("Warm", "Cool", "Remainder")


@pytest.fixture
def scene():
    """Cornell's box whose lamp is Warm, with two small lamps: one is Cool, one in no group."""
    scene = sample_scenes.build("cornell", detail="low")
    for name, x, color in (("Blue", 0.1, (0.1, 0.2, 1.0)), ("Red", 0.45, (1.0, 0.2, 0.1))):
        light = bpy.data.lights.new(name, "POINT")
        light.energy, light.color, light.shadow_soft_size = 1.0, color, 0.02
        lamp = bpy.data.objects.new(name, light)
        lamp.location, lamp.visible_camera = (x, 0.1, 0.3), False
        scene.collection.objects.link(lamp)
    for name in NAMES[:2]:
        scene.view_layers[0].lightgroups.add(name=name)
    scene.objects["Lamp"].lightgroup, scene.objects["Blue"].lightgroup = NAMES[:2]
    return scene


def test_groups_are_those_of_cycles(scene):
    # Of each group a Cycles render by the name of its pass, which has no light of other lamps in it.
    theirs, _ = reference.render_layers(scene, reference.ReferenceSettings(spp=256, size=(32, 32)))
    ours = render(extract_scene(scene, size=(32, 32)), parse(["render", "cornell", "-o", "x.exr"]).settings).layers
    for name in NAMES:
        got, expected = ours[f"Combined_{name}"], theirs[f"Combined_{name}"]
        assert got.mean(axis=(0, 1)) == pytest.approx(expected.mean(axis=(0, 1)), rel=0.05), name
        assert np.abs(got - expected).mean() < 0.2 * expected.mean(), name
        np.testing.assert_allclose(ours[f"Direct_{name}"] + ours[f"Indirect_{name}"], got, atol=1e-4 * got.max() + ours["Emission"].max())
    for layers in (ours, theirs):
        total = sum(layers[f"Combined_{name}"] for name in NAMES)
        np.testing.assert_allclose(total, layers["Combined"], rtol=1e-3, atol=1e-4 * total.mean())


def test_groups_can_be_switched_off_on_the_command_line():
    assert not parse(["render", "cornell", "-o", "x.exr", "--no-light-groups"]).settings.light_groups
    assert parse(["render", "cornell", "-o", "x.exr"]).settings.light_groups
