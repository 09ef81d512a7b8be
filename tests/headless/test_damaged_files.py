"""Files from strangers: damage ends in a line, and nothing in them runs or writes."""

import bpy
import numpy as np
import pytest

from lumigate.headless.cli import main
from lumigate.headless.stress.files import ends_with_a_line, mutate, write_originals


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """A sound .blend, .glb, .obj and EXR file, by suffix."""
    return {path.suffix: path for path in write_originals(tmp_path_factory.mktemp("originals"))}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("suffix", [".glb", ".obj", ".exr"])
def test_damage_ends_with_a_line(originals, tmp_path, capsys, suffix, seed):
    file = tmp_path / originals[suffix].name
    file.write_bytes(mutate(originals[suffix].read_bytes(), np.random.default_rng(100 + seed)))
    status = main(["compare", str(file), str(file)] if suffix == ".exr" else ["inspect", str(file)])
    out, err = capsys.readouterr()
    assert (status == 0 and out) or (status == 2 and err.startswith("lumigate: error: ") and err.count("\n") == 1)
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_a_channel_whose_name_is_no_text_is_damage(originals, tmp_path, capsys):
    file = tmp_path / "picture.exr"
    content = originals[".exr"].read_bytes()
    assert b"Indirect.R" in content
    file.write_bytes(content.replace(b"Indirect.R", b"Ind\x85\xffct.R", 1))
    assert main(["compare", str(file), str(file)]) == 2
    assert capsys.readouterr().err.startswith("lumigate: error: ")


def test_a_damaged_blend_file_ends_with_a_line(originals, tmp_path):
    # In a process of its own: Blender reads it in C, and a crash there would be the end of the tests.
    file = tmp_path / "scene.blend"
    file.write_bytes(mutate(originals[".blend"].read_bytes(), np.random.default_rng(4)))
    assert ends_with_a_line(file) == ""
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_scripts_in_a_file_do_not_run(tmp_path, capsys):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mark = tmp_path / "mark"
    text = bpy.data.texts.new("autorun.py")
    text.use_module = True
    text.write(f"open({str(mark)!r}, 'w').close()")
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    bpy.context.scene.collection.objects.link(lamp)
    lamp.driver_add("location", 0).driver.expression = f"open({str(mark)!r}, 'w').close() or 1.0"
    bpy.context.scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(bpy.context.scene.camera)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    mark.unlink(missing_ok=True)
    assert main(["inspect", str(tmp_path / "scene.blend")]) == 0
    assert not mark.exists()


def test_damage_is_repeatable_and_is_damage():
    data = bytes(range(256)) * 20
    for seed in range(20):
        one, two = (mutate(data, np.random.default_rng(seed)) for _ in range(2))
        assert one == two != data
