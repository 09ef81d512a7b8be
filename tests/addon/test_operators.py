"""What the panel's buttons do: layers as an image, the compositor's group, the scene check; and what they leave alone."""

import threading
from types import SimpleNamespace

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

import lumigate
from lumigate import sample_scenes
from lumigate.addon import operators
from lumigate.addon.compositor import GROUP_NAME, NODE_NAME
from lumigate.addon.image_layers import IMAGE_NAME, full_frame, load_layers, write_layers
from lumigate.addon.job import Job
from lumigate.addon.progress import Progress
from lumigate.core.denoise import Denoiser
from lumigate.core.layers import Layers, read_exr
from lumigate.core.pipeline import render
from lumigate.core.threads import Cancelled

SIZE = 32, 24


@pytest.fixture
def scene():
    lumigate.register()
    scene = sample_scenes.build("cornell", detail="low")
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    numbers = scene.lumigate
    numbers.vpls, numbers.pixel_samples, numbers.samples, numbers.gather = 256, 1, 2, 2
    yield scene
    lumigate.unregister()


def layers_of(image, tmp_path):
    """What an image's packed file holds."""
    path = tmp_path / "packed.exr"
    path.write_bytes(image.packed_file.data)
    return read_exr(path)


def picture(scene, path):
    """The render as Blender shows it, after compositing."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGB"
    bpy.data.images["Render Result"].save_render(str(path))
    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)


def blocks():
    """Names of all that a file holds."""
    return {
        kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in ("images", "scenes", "node_groups", "objects", "meshes")
    }


def test_layers_become_one_packed_multilayer_image(scene, tmp_path):
    layers = Layers({"Combined": np.ones((4, 6, 3)), "Indirect": np.zeros((4, 6, 3)), "Depth": np.ones((4, 6))})
    load_layers(write_layers(tmp_path, layers))
    image = load_layers(write_layers(tmp_path, layers))
    assert [i.name for i in bpy.data.images if i.name.startswith(IMAGE_NAME)] == [IMAGE_NAME]
    assert image.type == "MULTILAYER"
    assert image.packed_file is not None
    assert not list(tmp_path.glob("*.exr"))


def test_a_border_is_padded_to_the_full_frame():
    part = Layers({"Indirect": np.ones((2, 3, 3))}, offset=(1, 2), full_size=(6, 5))
    whole = full_frame(part)
    assert whole.size == (6, 5)
    assert whole["Indirect"][2:4, 1:4].all() and whole["Indirect"].sum() == 18


def test_add_indirect_light_gives_the_layers_and_keeps_the_last_render(scene, tmp_path):
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    bpy.ops.render.render()
    before = picture(scene, tmp_path / "before.exr")
    assert bpy.ops.lumigate.add_indirect_light() == {"FINISHED"}
    found = layers_of(bpy.data.images[IMAGE_NAME], tmp_path)
    assert found.size == SIZE and found["Indirect"].any()
    np.testing.assert_array_equal(picture(scene, tmp_path / "after.exr"), before)
    assert scene.render.engine == "CYCLES"


def test_the_compositors_group_adds_the_light(scene, tmp_path):
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = 1, 0, False
    scene.render.dither_intensity = 0
    bpy.ops.render.render()
    direct = picture(scene, tmp_path / "direct.exr")
    for _ in range(2):  # a second time changes the image, not the tree
        assert bpy.ops.lumigate.add_indirect_light(wire=True) == {"FINISHED"}
    tree = scene.node_tree if hasattr(scene, "node_tree") else scene.compositing_node_group
    adders = [node for node in tree.nodes if node.name.startswith(NODE_NAME) and node.type == "GROUP"]
    assert len(adders) == 1 and [g.name for g in bpy.data.node_groups if g.name.startswith(GROUP_NAME)] == [GROUP_NAME]
    adders[0].inputs["Strength"].default_value = 2.0
    bpy.ops.render.render()
    indirect = layers_of(bpy.data.images[IMAGE_NAME], tmp_path)["Indirect"]
    np.testing.assert_allclose(picture(scene, tmp_path / "sum.exr"), direct + 2 * indirect, atol=2e-3 * indirect.max())


def test_the_light_goes_to_the_scene_that_it_was_computed_for(scene, monkeypatch):
    # It went into the compositor of the scene that the window showed when it was done.
    other = bpy.data.scenes.new("Other")
    finish = operators.AddIndirectLight.finish

    def elsewhere(self, context):
        scene.name = "Renamed"
        with bpy.context.temp_override(scene=other, view_layer=other.view_layers[0]):
            finish(self, bpy.context)

    monkeypatch.setattr(operators.AddIndirectLight, "finish", elsewhere)
    assert bpy.ops.lumigate.add_indirect_light(wire=True) == {"FINISHED"}

    def tree_of(one):
        return one.node_tree if hasattr(one, "node_tree") else one.compositing_node_group

    assert tree_of(other) is None and NODE_NAME in tree_of(scene).nodes


def test_a_cancelled_job_leaves_everything_as_it_was(scene, monkeypatch):
    bpy.ops.lumigate.check_scene()  # what Blender makes at the first render is there
    before = blocks()

    def cancelled_at_once(*_arguments, **_options):
        job = Job(lambda advance: advance("view", 0.5))
        job.cancel()
        return job

    monkeypatch.setattr(operators, "render_job", cancelled_at_once)
    assert bpy.ops.lumigate.add_indirect_light(wire=True) == {"CANCELLED"}
    assert blocks() == before
    assert operators.JobOperator.running is None


def test_one_job_at_a_time(scene):
    may_end = threading.Event()
    operators.JobOperator.running = Job(lambda _advance: may_end.wait(20))
    try:
        with pytest.raises(RuntimeError, match="computing already"):
            bpy.ops.lumigate.add_indirect_light()
        assert bpy.ops.lumigate.cancel() == {"FINISHED"}
        assert operators.JobOperator.running.cancelled
    finally:
        may_end.set()
        operators.JobOperator.running = None


def test_a_file_loaded_during_a_job_gets_nothing_of_it(scene):
    arrays, _ = operators._extracted(bpy.context)
    job = operators.render_job(arrays, scene.lumigate.as_settings())
    for _ in range(20):
        bpy.ops.wm.read_factory_settings(use_empty=True)
    job.cancel()
    assert job.wait(60)
    assert job.error is None
    assert IMAGE_NAME not in bpy.data.images


def test_a_cancelled_render_lets_go_of_the_denoiser(scene, monkeypatch):
    closed = []
    monkeypatch.setattr(Denoiser, "close", lambda self: closed.append(self))
    arrays, _ = operators._extracted(bpy.context)
    with pytest.raises(Cancelled):
        render(arrays, scene.lumigate.as_settings(), lambda _stage, _fraction: False)
    assert len(closed) == 1


def test_a_scene_error_is_reported_in_one_line(scene):
    scene.camera.data.type = "PANO"
    with pytest.raises(RuntimeError, match="perspective, orthographic"):
        bpy.ops.lumigate.add_indirect_light()
    assert operators.JobOperator.running is None


def test_the_check_names_objects_and_selects_them(scene):
    curves = bpy.data.objects.new("Steam", bpy.data.volumes.new("Steam"))
    scene.collection.objects.link(curves)
    assert bpy.ops.lumigate.check_scene() == {"FINISHED"}
    remarks = bpy.context.window_manager.lumigate.remarks
    found = [remark for remark in remarks if remark.named == "Steam"]
    assert len(found) == 1 and found[0].wrong and "volume" in found[0].text
    assert bpy.ops.lumigate.select_named(name=found[0].named) == {"FINISHED"}
    assert [ob.name for ob in bpy.context.view_layer.objects.selected] == ["Steam"]
    assert bpy.context.view_layer.objects.active.name == "Steam"


def test_the_check_finds_names_with_apostrophes(scene):
    scene.collection.objects.link(bpy.data.objects.new("Kim's 'big' smoke", bpy.data.volumes.new("Steam")))
    assert bpy.ops.lumigate.check_scene() == {"FINISHED"}
    assert "Kim's 'big' smoke" in [remark.named for remark in bpy.context.window_manager.lumigate.remarks]


def test_a_materials_name_selects_who_wears_it(scene):
    material = next(slot.material for ob in scene.objects for slot in ob.material_slots)
    bpy.ops.lumigate.select_named(name=material.name)
    chosen = {ob.name for ob in bpy.context.view_layer.objects.selected}
    assert chosen == {ob.name for ob in scene.objects if material in [slot.material for slot in ob.material_slots]}


def test_clear_cache_empties_its_folders(scene, tmp_path, monkeypatch):
    (tmp_path / "bakes").mkdir()
    (tmp_path / "bakes" / "old.npy").write_bytes(b"1234")
    monkeypatch.setattr(operators, "_cache_folders", lambda: (lambda: tmp_path / "bakes", lambda: tmp_path / "worlds"))
    assert bpy.ops.lumigate.clear_cache() == {"FINISHED"}
    assert not (tmp_path / "bakes").exists()


def test_the_status_bar_of_every_workspace_is_free_again(scene, monkeypatch):
    # One that the user had left said for ever how far the job was.
    said = {}
    monkeypatch.setattr(bpy.types.WorkSpace, "status_text_set", lambda workspace, text: said.update({workspace.name: text}))
    bpy.ops.wm.read_factory_settings()
    workspaces = [bpy.data.workspaces["Layout"], bpy.data.workspaces["Animation"]]
    timers = SimpleNamespace(lumigate=SimpleNamespace(), event_timer_remove=lambda _timer: None, windows=[])
    operator = operators.JobOperator()
    operator._job, operator._timer, operator._told = SimpleNamespace(progress=Progress()), None, set()
    for workspace in workspaces:
        operator._show(SimpleNamespace(window_manager=timers, workspace=workspace))
    assert sorted(said) == ["Animation", "Layout"] and all(said.values())
    operator._hide(SimpleNamespace(window_manager=timers, workspace=workspaces[1]))
    assert said == {"Animation": None, "Layout": None}
