"""F12: the passes that Blender gets are the pipeline's layers, for borders, view layers and animations, too."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from mathutils import Vector

from lumigate.addon import engine
from lumigate.addon.extract import extract_scene
from lumigate.addon.extract.film import extract_film
from lumigate.addon.job import Job
from lumigate.addon.passes import hand_over, left_out
from lumigate.core.layers import CONTRACT, exposed, read_exr
from lumigate.core.pipeline import render

SIZE = 48, 32


@pytest.fixture
def scene(cornell):
    return cornell


def computed(scene, **view):
    return render(extract_scene(scene, **view), replace(scene.lumigate.as_settings(), film=extract_film(scene))).layers


def assert_same(passes, layers, part=np.s_[:, :]):
    for name in CONTRACT:
        shown = passes[name][part][..., :3]
        np.testing.assert_allclose(shown, layers[name][part], rtol=1e-5, atol=1e-6, err_msg=name)
    assert layers["Indirect"].any()


def test_passes_are_the_pipelines_layers(scene, rendered):
    layers = computed(scene)
    passes = rendered()
    assert set(passes) == set(CONTRACT)
    assert_same(passes, layers)
    assert (passes["Combined"][..., 3] == 1).all()


def test_a_transparent_film_has_an_alpha_instead_of_the_world(scene, rendered):
    scene.world = bpy.data.worlds.new("Sky")
    scene.render.film_transparent = True
    scene.objects["Camera"].location.y -= 1.0  # the world around the box
    scene.cycles.film_exposure = 2.0
    layers = exposed(computed(scene), 2.0)
    passes = rendered()
    np.testing.assert_allclose(passes["Combined"], layers["Combined"], rtol=1e-5, atol=1e-6)
    alpha = passes["Combined"][..., 3]
    assert (alpha[0] == 0).all() and not passes["Emission"][0].any() and (alpha == 1).any()


def test_only_the_passes_of_the_view_layer_are_there(scene, rendered):
    for name in set(CONTRACT) - {"Combined", "Indirect"}:
        setattr(scene.view_layers[0].lumigate, name, False)
    assert set(rendered()) == {"Combined", "Indirect"}


def test_layers_for_debugging_are_in_the_picture(scene, rendered):
    scene.lumigate.debug_layers = True
    scene.lumigate.method = "fuzzy-clustering"
    passes = rendered()
    assert set(passes) > {*CONTRACT, "VPL0", "PointClusters"}
    assert passes["VPL0"].any() and passes["PointClusters"].shape[2] == 1


def test_passes_of_other_renderers_are_told():
    layer = bpy.context.scene.view_layers.new("Shot")
    assert left_out(layer) == []
    layer.use_pass_mist = layer.use_pass_cryptomatte_object = True
    layer.aovs.add().name = "mask"
    assert left_out(layer) == ["view layer 'Shot' asks for passes that Lumigate leaves out: Mist, Cryptomatte Object, AOV 'mask'"]


def test_a_border_shows_the_same_pixels(scene, rendered):
    border = scene.render
    border.use_border = True
    border.border_min_x, border.border_max_x, border.border_min_y, border.border_max_y = 0.25, 0.75, 0.5, 1.0
    layers = computed(scene)
    passes = rendered()
    assert layers.size == (SIZE[0] // 2, SIZE[1] // 2)
    for name in ("Combined", "Indirect", "Normal"):
        inside = passes[name][: SIZE[1] // 2, SIZE[0] // 4 : 3 * SIZE[0] // 4, :3]
        np.testing.assert_allclose(inside, layers[name], rtol=1e-5, atol=1e-6)
    assert not passes["Combined"][SIZE[1] // 2 :].any()


def test_each_view_layer_has_its_own_passes(scene, rendered, tmp_path):
    other = scene.view_layers.new("Without the tall block")
    block = scene.objects["Tall block"]
    collection = bpy.data.collections.new("Apart")
    scene.collection.children.link(collection)
    for owner in block.users_collection:
        owner.objects.unlink(block)
    collection.objects.link(block)
    other.layer_collection.children["Apart"].exclude = True
    first, second = (computed(scene, view_layer=layer.name) for layer in scene.view_layers)
    assert_same(rendered(scene.view_layers[0].name), first)
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


def test_both_eyes_of_a_stereo_camera_are_rendered(scene, monkeypatch, tmp_path):
    alone = computed(scene)
    handed = {}

    def keep(owner, layers, wanted, view):
        handed[view] = layers
        hand_over(owner, layers, wanted, view)

    monkeypatch.setattr(engine, "hand_over", keep)
    scene.render.use_multiview = True
    data = scene.camera.data
    data.stereo.pivot, data.stereo.convergence_mode, data.stereo.interocular_distance = "LEFT", "PARALLEL", 0.2
    scene.render.image_settings.views_format = "MULTIVIEW"
    scene.render.filepath = str(tmp_path / "eyes.exr")
    bpy.ops.render.render(write_still=True)
    assert list(handed) == ["left", "right"]
    np.testing.assert_array_equal(handed["left"]["Depth"], alone["Depth"])  # whose place is the camera's own
    x = scene.camera.matrix_world.to_3x3() @ Vector((0.2, 0, 0))
    scene.camera.location += x
    bpy.context.view_layer.update()
    scene.render.use_multiview = False
    np.testing.assert_allclose(handed["right"]["Depth"], computed(scene)["Depth"], rtol=1e-4)
    pictures = [handed[view]["Combined"] for view in ("left", "right")]
    assert np.abs(pictures[0] - pictures[1]).mean() > 0.02
    assert (tmp_path / "eyes.exr").is_file()


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
    with pytest.raises(RuntimeError, match=f"'{scene.camera.name}' .* only perspective, orthographic"):
        bpy.ops.render.render()


def test_the_compositor_shows_at_once_which_passes_there_are(scene):
    # A pass that was switched on had no socket before the next render.
    if hasattr(scene, "compositing_node_group"):
        scene.compositing_node_group = tree = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
    node = tree.nodes.new("CompositorNodeRLayers")
    scene.view_layers[0].lumigate.Depth = False
    assert not node.outputs["Depth"].enabled if "Depth" in node.outputs else True
    scene.view_layers[0].lumigate.Depth = True
    assert node.outputs["Depth"].enabled
