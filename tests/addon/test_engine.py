"""F12: the passes that Blender gets are the pipeline's layers, for borders, view layers and animations, too."""

import bpy
import numpy as np
import pytest

import lumigate
from lumigate import sample_scenes
from lumigate.addon import engine
from lumigate.addon.engine import LumigateEngine
from lumigate.addon.extract import extract_scene
from lumigate.addon.job import Job
from lumigate.core.layers import CONTRACT, read_exr
from lumigate.core.pipeline import render

SIZE = 48, 32


@pytest.fixture
def scene():
    lumigate.register()
    scene = sample_scenes.build("cornell", detail="low")
    settings = scene.render
    settings.engine = LumigateEngine.bl_idname
    settings.resolution_x, settings.resolution_y = SIZE
    settings.resolution_percentage = 100
    image = settings.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    numbers = scene.lumigate
    numbers.vpls, numbers.pixel_samples, numbers.samples, numbers.gather = 256, 2, 2, 2
    yield scene
    lumigate.unregister()


def rendered(tmp_path, view_layer=None):
    """The passes of a render by Blender's own button."""
    assert bpy.ops.render.render() == {"FINISHED"}
    path = tmp_path / "passes.exr"
    bpy.data.images["Render Result"].save_render(str(path))
    return read_exr(path, view_layer)


def computed(scene, **view):
    return render(extract_scene(scene, **view), scene.lumigate.as_settings()).layers


def assert_same(passes, layers, part=np.s_[:, :]):
    for name in CONTRACT:
        shown = passes[name][part][..., :3]
        np.testing.assert_allclose(shown, layers[name][part], rtol=1e-5, atol=1e-6, err_msg=name)
    assert layers["Indirect"].any()


def test_passes_are_the_pipelines_layers(scene, tmp_path):
    layers = computed(scene)
    passes = rendered(tmp_path)
    assert set(passes) == set(CONTRACT)
    assert_same(passes, layers)
    assert (passes["Combined"][..., 3] == 1).all()


def test_only_the_passes_of_the_view_layer_are_there(scene, tmp_path):
    for name in set(CONTRACT) - {"Combined", "Indirect"}:
        setattr(scene.view_layers[0].lumigate, name, False)
    assert set(rendered(tmp_path)) == {"Combined", "Indirect"}


def test_a_border_shows_the_same_pixels(scene, tmp_path):
    border = scene.render
    border.use_border = True
    border.border_min_x, border.border_max_x, border.border_min_y, border.border_max_y = 0.25, 0.75, 0.5, 1.0
    layers = computed(scene)
    passes = rendered(tmp_path)
    assert layers.size == (SIZE[0] // 2, SIZE[1] // 2)
    for name in ("Combined", "Indirect", "Normal"):
        inside = passes[name][: SIZE[1] // 2, SIZE[0] // 4 : 3 * SIZE[0] // 4, :3]
        np.testing.assert_allclose(inside, layers[name], rtol=1e-5, atol=1e-6)
    assert not passes["Combined"][SIZE[1] // 2 :].any()


def test_each_view_layer_has_its_own_passes(scene, tmp_path):
    other = scene.view_layers.new("Without the tall block")
    block = scene.objects["Tall block"]
    collection = bpy.data.collections.new("Apart")
    scene.collection.children.link(collection)
    for owner in block.users_collection:
        owner.objects.unlink(block)
    collection.objects.link(block)
    other.layer_collection.children["Apart"].exclude = True
    first, second = (computed(scene, view_layer=layer.name) for layer in scene.view_layers)
    assert_same(rendered(tmp_path, scene.view_layers[0].name), first)
    assert_same(read_exr(tmp_path / "passes.exr", other.name), second)
    assert not np.array_equal(first["Depth"], second["Depth"])


def test_an_animation_renders_every_frame(scene, tmp_path):
    camera = scene.camera
    for frame, shift in ((1, 0.0), (2, 0.3)):
        camera.data.shift_x = shift
        camera.data.keyframe_insert("shift_x", frame=frame)
    scene.frame_start, scene.frame_end = 1, 2
    scene.render.filepath = str(tmp_path / "frame")
    frames = [computed(scene, frame=frame) for frame in (1, 2)]
    bpy.ops.render.render(animation=True)
    for frame, layers in zip((1, 2), frames):
        assert_same(read_exr(tmp_path / f"frame{frame:04d}.exr"), layers)
    assert not np.array_equal(frames[0]["Depth"], frames[1]["Depth"])


def test_a_cancelled_render_hands_nothing_over(scene, monkeypatch):
    def cancelled_at_once(*_arguments, **_options):
        job = Job(lambda advance: advance("view", 0.5))
        job.cancel()
        return job

    handed = []
    monkeypatch.setattr(engine, "render_job", cancelled_at_once)
    monkeypatch.setattr(engine, "hand_over", lambda *given: handed.append(given))
    bpy.ops.render.render()
    assert not handed


def test_a_scene_that_cannot_be_rendered_is_refused_in_one_line(scene):
    scene.camera.data.type = "PANO"
    with pytest.raises(RuntimeError, match=f"'{scene.camera.name}' .* only perspective and orthographic"):
        bpy.ops.render.render()
