"""The world's radiance, in every direction and on a plane, against formulas and Cycles."""

import math

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

from lumigate.addon.extract import world as room
from lumigate.addon.extract.panorama import render_panorama, render_panorama_apart
from lumigate.core.scene import ALL_RAYS, CAMERA, DIFFUSE, GLOSSY, SHADOW, SUN, TRANSMISSION


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """Panoramas are kept in a folder of the test's own."""
    monkeypatch.setattr(room, "cache_folder", lambda: tmp_path / "worlds")
    return tmp_path / "worlds"


@pytest.fixture
def sky(stage):
    """A world's tree, its Background node, and a cube to look at."""
    stage.cube()
    tree = stage.nodes(stage.world())
    return tree, next(node for node in tree.nodes if node.type == "BACKGROUND")


def directions(height, width):
    """(H, W, 3) unit vectors of a panorama's pixel centres, as core/scene.py defines them."""
    theta = math.pi * (np.arange(height) + 0.5) / height
    phi = math.pi - 2 * math.pi * (np.arange(width) + 0.5) / width
    return np.stack(
        [np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi)), np.outer(np.cos(theta), np.ones(width))], axis=-1
    )


def upward_irradiance(scene):
    """(3,) irradiance of a plane that faces up, by the extracted world and its suns."""
    height, width = scene.world.radiance.shape[:2]
    d = directions(height, width)
    solid_angle = 2 * math.pi / width * (np.cos(math.pi * np.arange(height) / height) - np.cos(math.pi * (np.arange(height) + 1) / height))
    total = (scene.world.radiance * (np.maximum(d[..., 2], 0) * solid_angle[:, None])[..., None]).sum((0, 1))
    for kind, axes, emission in zip(scene.lamps.kind, scene.lamps.axes, scene.lamps.emission):
        assert kind == SUN
        total = total + emission * max(axes[2, 2], 0)
    return total


def blobs(height=64, width=128):
    """A float image with bright places that tell every direction apart."""
    d = directions(height, width)
    centres = np.array([(1, 0, 0.2), (0, 1, 0.5), (-0.5, -0.5, -0.3)])
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    return 0.1 + 5 * np.exp(20 * (d @ centres.T - 1))


def image(pixels, name="sky"):
    height, width = pixels.shape[:2]
    made = bpy.data.images.new(name, width, height, float_buffer=True)
    made.pixels.foreach_set(np.dstack([pixels[::-1], np.ones((height, width))]).astype(np.float32).ravel())
    return made


def saved(made, tmp_path):
    """The image as a file, which is what users have."""
    path = str(tmp_path / "sky.exr")
    made.filepath_raw, made.file_format = path, "OPEN_EXR"
    made.save()
    bpy.data.images.remove(made)
    return bpy.data.images.load(path)


def environment(tree, background, picture, rotation=None, kind="POINT"):
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = picture
    tree.links.new(node.outputs[0], background.inputs["Color"])
    if rotation is not None:
        mapping, coordinates = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
        mapping.vector_type = kind
        mapping.inputs["Rotation"].default_value = rotation
        tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs[0], node.inputs["Vector"])
    return node


def data_blocks():
    """Names of all that the file holds, but for the picture that every render leaves."""
    collections = [p.identifier for p in bpy.data.bl_rna.properties if p.type == "COLLECTION" and p.identifier != "all_ids"]
    return {name: sorted(set(getattr(bpy.data, name).keys()) - {"Render Result"}) for name in collections}


def test_no_world_is_black(stage):
    stage.cube()
    world = stage.extract().world
    assert world.radiance.shape == (1, 1, 3) and not world.radiance.any()


def test_constant_background(stage, sky):
    tree, background = sky
    color = tree.nodes.new("ShaderNodeRGB")
    color.outputs[0].default_value = 0.1, 0.2, 0.4, 1
    tree.links.new(color.outputs[0], background.inputs["Color"])
    background.inputs["Strength"].default_value = 2.5
    world = stage.extract().world
    assert world.radiance.shape == (1, 1, 3) and world.visibility == ALL_RAYS
    np.testing.assert_allclose(world.radiance[0, 0], (0.25, 0.5, 1.0))


def test_unlinked_surface_is_black(stage, sky):
    tree, background = sky
    tree.nodes.remove(background)
    assert not stage.extract().world.radiance.any()


def test_ray_visibility(stage, sky):
    rays = stage.scene.world.cycles_visibility
    for name, bit in dict(camera=CAMERA, diffuse=DIFFUSE, glossy=GLOSSY, transmission=TRANSMISSION).items():
        setattr(rays, name, False)
        assert stage.extract().world.visibility == ALL_RAYS & ~bit
        setattr(rays, name, True)
    assert ALL_RAYS & SHADOW


def test_directions_of_a_rendered_world(stage, sky):
    tree, background = sky
    coordinates, scaled = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeVectorMath")
    scaled.operation = "MULTIPLY_ADD"
    scaled.inputs[1].default_value = scaled.inputs[2].default_value = 0.5, 0.5, 0.5
    tree.links.new(coordinates.outputs["Generated"], scaled.inputs[0])
    tree.links.new(scaled.outputs[0], background.inputs["Color"])
    scene = stage.extract()
    height, width = scene.world.radiance.shape[:2]
    assert not scene.warnings
    np.testing.assert_allclose(scene.world.radiance, 0.5 + 0.5 * directions(height, width), atol=2 * math.pi / width)


@pytest.mark.parametrize(("turn", "kind"), [(None, "POINT"), ((0, 0, 1.0), "POINT"), ((0, 0, -2.5), "TEXTURE")])
def test_environment_image_is_taken_as_it_is(stage, sky, tmp_path, turn, kind):
    tree, background = sky
    environment(tree, background, saved(image(blobs()), tmp_path), turn, kind)
    background.inputs["Strength"].default_value = 2
    scene = stage.extract()
    assert scene.world.radiance.shape == (64, 128, 3)
    assert not (tmp_path / "worlds").exists()
    by_cycles, _ = render_panorama(stage.scene.world, 1, 128, 64)
    np.testing.assert_allclose(scene.world.radiance, by_cycles, atol=0.05)
    np.testing.assert_allclose(scene.world.radiance.mean((0, 1)), by_cycles.mean((0, 1)), rtol=2e-3)


def test_large_environment_image_is_averaged_down(stage, sky, tmp_path, monkeypatch):
    monkeypatch.setattr(room, "_MAX_WIDTH", 32)
    tree, background = sky
    picture = saved(image(blobs()), tmp_path)
    environment(tree, background, picture)
    radiance = stage.extract().world.radiance
    assert radiance.shape == (16, 32, 3)
    whole = np.array(picture.pixels).reshape(-1, 4)[:, :3]
    np.testing.assert_allclose(radiance.mean((0, 1)), whole.mean(0), rtol=1e-4)


def sunny(height=256, width=512):
    """A dim sky with one pixel that gives half of its light."""
    pixels = np.full((height, width, 3), 0.5)
    pixels[60, 100] = 4 * math.pi * 0.5 / (2 * math.pi / width * (math.cos(math.pi * 60 / height) - math.cos(math.pi * 61 / height)))
    return pixels


@pytest.mark.slow
@pytest.mark.parametrize("turn", [None, (0.5, 0.3, 0.2)])
def test_the_sun_of_an_image_becomes_a_lamp_of_the_same_light(stage, sky, tmp_path, cycles_irradiance, turn):
    tree, background = sky
    path = str(tmp_path / "sunny.exr")  # what Blender saves has no such peak
    file = oiio.ImageOutput.create(path)
    file.open(path, oiio.ImageSpec(512, 256, 3, oiio.FLOAT))
    file.write_image(sunny().astype(np.float32))
    file.close()
    environment(tree, background, bpy.data.images.load(path), turn)
    stage.scene.world.cycles_visibility.glossy = False
    scene = stage.extract()
    assert scene.lamps.kind.tolist() == [SUN] and scene.lamps.names == ["World (sun)"]
    assert scene.lamps.visibility[0] == ALL_RAYS & ~(CAMERA | GLOSSY | SHADOW)  # the camera sees it in the sky
    assert scene.world.radiance.max() < 1 < 1000 < scene.world.seen.max()
    assert scene.world.sought == pytest.approx(0.5, abs=0.02)
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    stage.receiver()
    np.testing.assert_allclose(upward_irradiance(scene), cycles_irradiance(256).mean(0), rtol=0.02)


@pytest.mark.slow
def test_tilted_environment_is_rendered(stage, sky, tmp_path, monkeypatch, cycles_irradiance):
    monkeypatch.setattr(room, "_WIDTH", 256)
    tree, background = sky
    environment(tree, background, saved(image(blobs()), tmp_path), (0.5, 0.3, 0.2))
    scene = stage.extract()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    stage.receiver()
    np.testing.assert_allclose(upward_irradiance(scene), cycles_irradiance(256).mean(0), rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("where", ["plain", "turned", "grouped"])
def test_sun_disc_of_a_sky_becomes_a_lamp_of_the_same_light(stage, sky, monkeypatch, cycles_irradiance, where):
    monkeypatch.setattr(room, "_WIDTH", 256)
    tree, background = sky
    within = bpy.data.node_groups.new("group", "ShaderNodeTree") if where == "grouped" else tree
    node = within.nodes.new("ShaderNodeTexSky")
    node.sky_type = "NISHITA" if bpy.app.version < (5, 0) else "SINGLE_SCATTERING"
    node.sun_elevation, node.sun_rotation = 0.7, 2.0
    color = node.outputs[0]
    if where == "turned":  # which these models ignore
        tree.links.new(tree.nodes.new("ShaderNodeMapping").outputs[0], node.inputs[0])
    elif where == "grouped":
        within.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
        within.links.new(color, within.nodes.new("NodeGroupOutput").inputs[0])
        group = tree.nodes.new("ShaderNodeGroup")
        group.node_tree = within
        color = group.outputs[0]
    tree.links.new(color, background.inputs["Color"])
    background.inputs["Strength"].default_value = 0.1
    scene = stage.extract()
    assert scene.lamps.kind.tolist() == [SUN]
    assert scene.lamps.angle[0] == pytest.approx(node.sun_size)
    assert scene.world.sought == 0.2  # Cycles seeks the sun disc four times as often as the sky
    assert node.sun_disc  # the user's node is as it was
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    stage.receiver()
    np.testing.assert_allclose(upward_irradiance(scene), cycles_irradiance(256).mean(0), rtol=0.02)


def test_rendering_a_world_leaves_nothing_behind_and_is_done_once(stage, sky, cache, monkeypatch):
    tree, background = sky
    tree.links.new(tree.nodes.new("ShaderNodeTexGradient").outputs[0], background.inputs["Color"])
    before = data_blocks()
    stage.extract()
    assert data_blocks() == before
    assert len(list(cache.iterdir())) == 1

    first = stage.extract().world.radiance
    monkeypatch.setattr(room, "render_panorama", None)
    np.testing.assert_array_equal(stage.extract().world.radiance, first)

    for changed in (
        lambda: setattr(background.inputs["Strength"], "default_value", 3),
        lambda: setattr(tree.nodes["Gradient Texture"], "gradient_type", "RADIAL"),
    ):
        changed()
        with pytest.raises(TypeError):  # not in the cache any more
            stage.extract()


@pytest.mark.parametrize("grouped", [False, True])
@pytest.mark.parametrize("ray", ["Is Camera Ray", "Is Glossy Ray"])
def test_light_path_shows_what_the_camera_and_what_diffuse_rays_see(stage, sky, ray, grouped):
    tree, background = sky
    within = bpy.data.node_groups.new("group", "ShaderNodeTree") if grouped else tree
    path = within.nodes.new("ShaderNodeLightPath")
    fac = path.outputs[ray]
    if grouped:
        within.interface.new_socket("Fac", in_out="OUTPUT", socket_type="NodeSocketFloat")
        within.links.new(fac, within.nodes.new("NodeGroupOutput").inputs[0])
        group = tree.nodes.new("ShaderNodeGroup")
        group.node_tree = within
        fac = group.outputs[0]
    mix = tree.nodes.new("ShaderNodeMixRGB")
    mix.inputs[1].default_value, mix.inputs[2].default_value = (0.3, 0.2, 0.1, 1), (9, 8, 7, 1)
    tree.links.new(fac, mix.inputs[0])
    tree.links.new(mix.outputs[0], background.inputs["Color"])
    before = data_blocks()
    scene = stage.extract()
    assert data_blocks() == before
    assert any("'World' depends on the light path" in warning for warning in scene.warnings) == (ray == "Is Glossy Ray")
    assert scene.world.radiance.shape == scene.world.seen.shape == (1, 1, 3)  # constant after all
    np.testing.assert_allclose(scene.world.radiance[0, 0], (0.3, 0.2, 0.1), rtol=1e-5)
    np.testing.assert_allclose(scene.world.seen[0, 0], (9, 8, 7) if ray == "Is Camera Ray" else (0.3, 0.2, 0.1), rtol=1e-5)
    assert path.outputs[ray].is_linked


def test_window_coordinates_are_named_in_a_warning(stage, sky):
    tree, background = sky
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Window"], background.inputs["Color"])
    assert any("'World' is laid out over the camera's picture" in warning for warning in stage.extract().warnings)


def test_volume_is_named_in_a_warning(stage, sky):
    tree, _ = sky
    output = next(node for node in tree.nodes if node.type == "OUTPUT_WORLD")
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])
    assert any("volume of world 'World'" in warning for warning in stage.extract().warnings)


def test_a_limit_of_bounces_is_named_in_a_warning(stage, sky):
    stage.cube()
    stage.scene.world.cycles.max_bounces = 0
    assert any("world 'World' has Max Bounces 0" in warning for warning in stage.extract().warnings)


def test_missing_image_is_named_in_a_warning(stage, sky, tmp_path):
    tree, background = sky
    picture = saved(image(blobs()), tmp_path)
    (tmp_path / "sky.exr").unlink()
    picture.reload()
    environment(tree, background, picture)
    assert any("sky.exr" in warning and "'World'" in warning for warning in stage.extract().warnings)


@pytest.mark.slow
def test_a_process_of_its_own_renders_the_same(stage, sky, tmp_path):
    tree, background = sky
    environment(tree, background, image(blobs()), (0.5, 0.3, 0.2)).image.pack()
    here, _ = render_panorama(stage.scene.world, 1, 64, 32)
    apart, _ = render_panorama_apart(stage.scene.world, 1, 64, 32)
    np.testing.assert_allclose(apart, here, atol=1e-6)
