"""Light linking and shadow linking, against Cycles."""

import math

import bpy
import numpy as np
import pytest

from lumigate.addon.extract import extract_scene
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.reference import ReferenceSettings, render_layers

from .test_direct_light import look, material

SIZE = (48, 27)


def collection(name, **included):
    """A collection of the objects of these names, each included or excluded."""
    made = bpy.data.collections.new(name)
    for ob in included:
        made.objects.link(bpy.data.objects[ob])
    for ob, link in zip(made.objects, made.collection_objects):
        link.light_linking.link_state = "INCLUDE" if included[ob.name] else "EXCLUDE"
    return made


def put(kind, name, material, **where):
    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**where)
    bpy.context.object.name = name
    bpy.context.object.data.materials.append(material)
    return bpy.context.object


def light(scene, name, kind, location, energy, **settings):
    made = bpy.data.lights.new(name, kind)
    made.energy = energy
    for key, value in settings.items():
        setattr(made, key, value)
    placed = bpy.data.objects.new(name, made)
    placed.location, placed.visible_camera = location, False
    scene.collection.objects.link(placed)
    return placed


def room(emitter, floor=None):
    """A closed room with two boxes, a shade under the lamp that is to be linked, and a weak lamp for all -> (scene, emitter)."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = material("Grey", Base_Color=(0.6, 0.55, 0.5, 1), Specular_IOR_Level=0.0)
    put("cube", "Room", grey, size=3, location=(0, 0, 1.5))
    put("plane", "Floor", floor or grey, size=2.9, location=(0, 0, 0.01))
    put("cube", "Box", grey, size=0.7, location=(0.6, 0.5, 0.36))
    put("cube", "Small", grey, size=0.4, location=(-0.2, 0.7, 0.21))
    put("plane", "Shade", grey, size=0.8, location=(0.1, 0.1, 1.3))
    light(scene, "Other", "POINT", (-1.1, 1.1, 2.3), 15, shadow_soft_size=0.1)
    if emitter == "MESH":
        shine = material("Shine", Base_Color=(0, 0, 0, 1), Specular_IOR_Level=0.0, Emission_Color=(1, 0.8, 0.6, 1), Emission_Strength=15)
        placed = put("plane", "Lamp", shine, size=0.5, location=(0.2, 0.0, 2.5), rotation=(math.pi, 0, 0))
    else:
        size = {"AREA": {"size": 0.6}, "POINT": {"shadow_soft_size": 0.2}, "SUN": {"angle": 0.2}, "SPOT": {"spot_size": 2.0}}[emitter]
        placed = light(scene, "Lamp", emitter, (0.2, 0.0, 2.5), 3 if emitter == "SUN" else 60, **size)
    if emitter == "SUN":
        bpy.data.objects.remove(bpy.data.objects["Room"])
        placed.rotation_euler = (0.4, 0.2, 0)
    look(scene, (-1.2, -1.3, 1.6), (math.radians(70), 0, math.radians(-43)), lens=18)
    return scene, placed


def compared(scene, method="importance-sampling", spp=128, seeds=2):
    """Layers by Cycles and the mean of ours."""
    reference, _ = render_layers(scene, ReferenceSettings(spp=spp, size=SIZE, bounces=2))
    arrays = extract_scene(scene, size=SIZE)
    assert not [line for line in arrays.warnings if "linking" in line]
    ours = [render(arrays, RenderSettings(method=method, bounces=2, seed=seed)).layers for seed in range(seeds)]
    return reference, {name: np.mean([layers[name] for layers in ours], axis=0) for name in ours[0]}


RECEIVERS = {"included": dict(Box=True, Floor=True), "excluded": dict(Box=False, Room=False)}
BLOCKERS = {"included": dict(Box=True), "excluded": dict(Shade=False, Small=False)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("emitter", "receivers", "blockers"),
    [(emitter, "included", "included") for emitter in ("POINT", "SPOT", "AREA", "MESH")]
    + [(emitter, "excluded", "excluded") for emitter in ("POINT", "SPOT", "AREA", "SUN", "MESH")]
    + [("POINT", "included", None), ("SUN", "included", None), ("SUN", None, "included"), ("MESH", None, "included")],
)
def test_lamps_light_and_are_hidden_by_some_objects(emitter, receivers, blockers):
    scene, lamp = room(emitter)
    states = {name: state for name, state in RECEIVERS.get(receivers, {}).items() if name in bpy.data.objects}
    before, _ = render_layers(scene, ReferenceSettings(spp=64, size=SIZE, bounces=0))
    if receivers:
        lamp.light_linking.receiver_collection = collection("Lit", **states)
    if blockers:
        lamp.light_linking.blocker_collection = collection("Hiding", **BLOCKERS[blockers])
    reference, ours = compared(scene)
    assert abs(reference["Direct"].mean() / before["Direct"].mean() - 1) > 0.03  # the links matter
    for layer, tolerance in (("Direct", 0.01), ("DiffuseIndirect", 0.02)):
        assert ours[layer].mean(dtype=float) == pytest.approx(reference[layer].mean(dtype=float), rel=tolerance)
    assert np.abs(ours["Direct"] - reference["Direct"]).mean() < 0.08 * reference["Direct"].mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("emitter", "floor_is_lit", "roughness", "spp", "seeds"),
    [("AREA", True, 0.3, 1024, 3), ("AREA", False, 0.0, 384, 2), ("MESH", True, 0.0, 384, 2), ("MESH", False, 0.3, 384, 2)],
)
def test_reflections_on_what_is_linked(emitter, floor_is_lit, roughness, spp, seeds):

    scene, lamp = room(emitter)
    floor = bpy.data.objects["Floor"]
    floor.data.materials[0] = material("Metal", Metallic=1.0, Roughness=roughness, Base_Color=(0.9, 0.9, 0.9, 1))
    bpy.data.objects.remove(bpy.data.objects["Shade"])
    lamp.location = (0.9, -0.3, 0.9)
    lamp.light_linking.receiver_collection = collection("Lit", Floor=floor_is_lit, Box=True)
    scene.camera.rotation_euler[0] = math.radians(55)
    reference, ours = compared(scene, spp=spp, seeds=seeds)
    assert np.abs(ours["Direct"] - reference["Direct"]).mean() < 0.12 * reference["Direct"].mean()  # where a lamp is seen, and where not
    assert ours["Direct"].mean(dtype=float) == pytest.approx(reference["Direct"].mean(dtype=float), rel=0.04)
    assert ours["Indirect"].mean(dtype=float) == pytest.approx(reference["Indirect"].mean(dtype=float), rel=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["instant-radiosity", "virtual-area-lights", "visibility-gates"])
def test_other_methods(method):
    scene, lamp = room("AREA")
    lamp.light_linking.receiver_collection = collection("Lit", Room=False)
    lamp.light_linking.blocker_collection = collection("Hiding", Shade=False)
    reference, ours = compared(scene, method, seeds=3)
    assert ours["Direct"].mean(dtype=float) == pytest.approx(reference["Direct"].mean(dtype=float), rel=0.01)
    assert ours["DiffuseIndirect"].mean(dtype=float) == pytest.approx(reference["DiffuseIndirect"].mean(dtype=float), rel=0.04)


@pytest.mark.slow
def test_many_lamps_of_many_sets():
    scene, _ = room("AREA")
    for k in range(12):
        one = light(scene, f"Lamp {k}", "POINT", (-1.0 + 0.15 * k, 0.3 * (k % 4) - 0.6, 2.2), 8, shadow_soft_size=0.05)
        if k % 2:
            states = dict(Box=True, Room=True) if k % 4 == 1 else dict(Small=False, Floor=False)
            one.light_linking.receiver_collection = collection(f"Lit {k}", **states)
        if k % 3 == 0:
            one.light_linking.blocker_collection = collection(f"Hiding {k}", Shade=False)
    reference, ours = compared(scene, spp=256, seeds=3)
    assert ours["Direct"].mean(dtype=float) == pytest.approx(reference["Direct"].mean(dtype=float), rel=0.01)
    assert ours["DiffuseIndirect"].mean(dtype=float) == pytest.approx(reference["DiffuseIndirect"].mean(dtype=float), rel=0.02)
