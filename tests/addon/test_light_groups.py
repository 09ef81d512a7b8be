"""Light groups in Blender: read from objects and world, given as passes, mixed in the compositor and in the panel."""

from dataclasses import replace

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

from lumigate.addon.compositor import compositor_of
from lumigate.addon.extract import extract_scene
from lumigate.addon.extract.film import extract_film
from lumigate.addon.image_layers import IMAGE_NAME
from lumigate.addon.light_mixer import NODE_NAME, controls, mixer
from lumigate.core.layers import read_exr
from lumigate.core.pipeline import render

SIZE = 32, 32
NAMES = ["Key", "Fill", "Remainder"]


@pytest.fixture
def scene(cornell):
    """Cornell's box with its lamp in Key, a small one in Fill, and a third in no group."""
    scene = cornell
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.dither_intensity = 0
    for name, x, color in (("Blue", 0.1, (0.1, 0.2, 1.0)), ("Red", 0.45, (1.0, 0.2, 0.1))):
        light = bpy.data.lights.new(name, "POINT")
        light.energy, light.color = 0.5, color
        lamp = bpy.data.objects.new(name, light)
        lamp.location = x, 0.1, 0.3
        scene.collection.objects.link(lamp)
    for name in NAMES[:2]:
        scene.view_layers[0].lightgroups.add(name=name)
    scene.objects["Lamp"].lightgroup, scene.objects["Blue"].lightgroup = NAMES[:2]
    return scene


def test_groups_are_read_from_lamps_meshes_instances_and_world(scene):
    scene.world = bpy.data.worlds.new("Sky")
    scene.world.lightgroup = "Fill"
    scene.objects["Tall block"].lightgroup = "Key"
    parts = bpy.data.collections.new("Parts")
    inside = bpy.data.objects.new("Inside", scene.objects["Red"].data)
    parts.objects.link(inside)
    parent = bpy.data.objects.new("Parent", None)
    parent.instance_type, parent.instance_collection, parent.lightgroup = "COLLECTION", parts, "Key"
    scene.collection.objects.link(parent)
    arrays = extract_scene(scene)
    assert arrays.light_groups == ("Key", "Fill")
    assert dict(zip(arrays.lamps.names, arrays.lamps.groups)) == {"Lamp": "Key", "Blue": "Fill", "Red": "", "Inside": "Key"}
    named = dict(zip(arrays.geometry.object_names, arrays.geometry.object_groups))
    assert named["Tall block"] == "Key" and named["Short block"] == ""
    assert arrays.world.group == "Fill"


def test_passes_of_the_groups_are_the_pipelines_and_add_up(scene, rendered):
    layers = render(extract_scene(scene), replace(scene.lumigate.as_settings(), film=extract_film(scene))).layers
    passes = rendered()
    for kind in ("Combined", "Direct", "Indirect"):
        for name in NAMES:
            assert passes[f"{kind}_{name}"].any()
            np.testing.assert_allclose(passes[f"{kind}_{name}"], layers[f"{kind}_{name}"], rtol=1e-5, atol=1e-6)
        whole = passes[kind][..., :3]
        np.testing.assert_allclose(sum(passes[f"{kind}_{name}"] for name in NAMES), whole, rtol=1e-4, atol=1e-5 * whole.max())


def test_groups_can_be_switched_off(scene, rendered):
    scene.lumigate.light_groups = False
    assert not [name for name in rendered() if "_" in name]
    assert not bpy.ops.lumigate.mix_light_groups.poll()


def test_the_mixer_dims_and_colours_each_group(scene, rendered, tmp_path):
    passes = rendered()
    for _ in range(2):  # a second time changes nothing
        assert bpy.ops.lumigate.mix_light_groups() == {"FINISHED"}
    tree = scene.node_tree if hasattr(scene, "node_tree") else scene.compositing_node_group
    assert [node.name for node in tree.nodes if node.name.startswith(NODE_NAME)] == [NODE_NAME]
    sockets = {name: (gain, color) for name, gain, color in controls(mixer(scene))}
    assert list(sockets) == NAMES
    sockets["Key"][0].default_value = 2.5
    sockets["Fill"][1].default_value = (0.5, 0.25, 1.0, 1.0)
    sockets["Remainder"][0].default_value = 0.0
    bpy.ops.render.render()
    composited = composite(tmp_path)
    expected = 2.5 * passes["Combined_Key"] + np.float32((0.5, 0.25, 1.0)) * passes["Combined_Fill"]
    np.testing.assert_allclose(composited, expected, atol=2e-3 * expected.max())


def composite(tmp_path):
    """What the compositor makes of the last render."""
    image = bpy.context.scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_depth, image.color_mode = "OPEN_EXR", "32", "RGB"
    path = tmp_path / "composite.exr"
    bpy.data.images["Render Result"].save_render(str(path))
    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)


def test_a_mixer_keeps_what_it_was_set_to_when_groups_come_and_go(scene):
    bpy.ops.lumigate.mix_light_groups()
    {name: gain for name, gain, _ in controls(mixer(scene))}["Fill"].default_value = 3.0
    scene.view_layers[0].lightgroups.add(name="Rim")
    bpy.ops.lumigate.mix_light_groups()
    gains = {name: gain.default_value for name, gain, _ in controls(mixer(scene))}
    assert gains == {"Key": 1.0, "Fill": 3.0, "Rim": 1.0, "Remainder": 1.0}
    assert len([group for group in bpy.data.node_groups if group.name.startswith(NODE_NAME)]) == 1


def test_add_indirect_light_goes_through_a_mixer(scene, tmp_path):
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = 1, 0, False
    assert bpy.ops.lumigate.add_indirect_light(wire=True) == {"FINISHED"}
    bpy.ops.render.render()
    one = composite(tmp_path)
    for _, gain, _ in controls(mixer(scene)):
        gain.default_value = 0.0
    bpy.ops.render.render()
    direct = composite(tmp_path)
    {name: gain for name, gain, _ in controls(mixer(scene))}["Fill"].default_value = 4.0
    bpy.ops.render.render()
    fill = composite(tmp_path) - direct
    path = tmp_path / "layers.exr"
    path.write_bytes(bpy.data.images[IMAGE_NAME].packed_file.data)
    layers = read_exr(path)
    np.testing.assert_allclose(fill, 4 * layers["Indirect_Fill"], atol=2e-3 * fill.max())
    np.testing.assert_allclose(one - direct, layers["Indirect"], atol=2e-3 * one.max())


def test_groups_that_are_new_are_mixed_of_their_own_scene(scene):
    # The node that was there had no sockets of groups made since, a KeyError, or was that of another scene.
    tree = compositor_of(scene)
    for node in list(tree.nodes):
        if node.type == "R_LAYERS":
            tree.nodes.remove(node)
    stranger = tree.nodes.new("CompositorNodeRLayers")
    stranger.scene = bpy.data.scenes.new("Other")
    own = tree.nodes.new("CompositorNodeRLayers")
    own.scene, own.layer = scene, scene.view_layers[0].name
    scene.view_layers[0].lightgroups.add(name="Rim")
    assert bpy.ops.lumigate.mix_light_groups() == {"FINISHED"}
    assert {link.from_node for socket in mixer(scene).inputs for link in socket.links} == {own}


def test_a_group_whose_passes_blender_cannot_name_is_left_out(scene, rendered):
    # Names were cut off: two parts of one name in the file, which Blender 5 did not write then.
    scene.view_layers[0].lightgroups.add(name="x" * 40)
    scene.view_layers[0].lightgroups.add(name="y" * 55)
    passes = rendered()
    assert "Combined_" + "x" * 40 in passes and not [name for name in passes if "yyy" in name]
    with pytest.raises(RuntimeError, match="shorten it to 54 bytes"):
        bpy.ops.lumigate.mix_light_groups()
