"""Frames of a sequence as files: a part of them has the same bits as all, and a killed job goes on."""

import json
import os
from unittest.mock import Mock

import bpy
import numpy as np
import pytest

from lumigate import sample_scenes
from lumigate.core.errors import SceneError
from lumigate.core.layers import read_exr
from lumigate.core.reuse.sequence import alike
from lumigate.headless import arguments
from lumigate.headless.cli import main
from lumigate.headless.commands import render
from lumigate.headless.frames import View
from lumigate.headless.keeping import KEPT
from lumigate.headless.motion import exposures, moving_objects, only_cameras_and_lamps_move
from lumigate.headless.sequences import ShotRenderer
from lumigate.headless.sources import open_source

SMALL = ["--size", "24x16", "--vpls", "16", "--pixel-samples", "2", "--bounces", "2", "--no-denoise", "--history", "2"]


@pytest.fixture(scope="module")
def animated(tmp_path_factory):
    """The Cornell box with a moving block and a moving camera, in a file."""
    path = tmp_path_factory.mktemp("animated") / "scene.blend"
    scene = sample_scenes.build("cornell")
    block = next(ob for ob in scene.objects if ob.type == "MESH")
    for ob, axis in ((block, 0), (scene.camera, 2)):
        ob.keyframe_insert("location", frame=1)
        ob.location[axis] += 0.3
        ob.keyframe_insert("location", frame=6)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture(scope="module")
def whole(animated, tmp_path_factory):
    """All its frames, with summary and contact sheet."""
    folder = tmp_path_factory.mktemp("whole")
    extra = ["--summary", str(folder / "all.json"), "--contact-sheet", str(folder / "all.png")]
    assert main(["render", str(animated), "-o", str(folder / "f.exr"), "--frames", "1-6", *SMALL, *extra]) == 0
    return folder


def test_summary_and_contact_sheet(whole):
    summary = json.loads((whole / "all.json").read_text())
    assert [row["frame"] for row in summary["rows"]] == [1, 2, 3, 4, 5, 6]
    assert summary["rendered"] == 6
    assert (whole / "all.png").read_bytes().startswith(b"\x89PNG")


def test_killed_job_goes_on_with_the_same_bits(animated, whole, tmp_path):
    for number in (1, 2, 5):
        (tmp_path / f"f000{number}.exr").write_bytes((whole / f"f000{number}.exr").read_bytes())
    before = (tmp_path / "f0005.exr").stat().st_mtime_ns
    extra = ["--skip-existing", "--summary", str(tmp_path / "s.json"), "--frames", "1-6"]
    assert main(["render", str(animated), "-o", str(tmp_path / "f.exr"), *SMALL, *extra]) == 0
    assert [row["existing"] for row in json.loads((tmp_path / "s.json").read_text())["rows"]] == [True, True, False, False, True, False]
    assert (tmp_path / "f0005.exr").stat().st_mtime_ns == before
    for number in (3, 4, 6):
        ours, theirs = (read_exr(folder / f"f000{number}.exr") for folder in (tmp_path, whole))
        for name in ours:
            np.testing.assert_array_equal(ours[name], theirs[name], err_msg=f"{name} of frame {number}")


@pytest.fixture
def opened(monkeypatch):
    """Scenes that are opened, and exposures that are computed without a picture, by a process that keeps its last shot."""
    found = []
    monkeypatch.setattr(KEPT, "on", True)
    monkeypatch.setattr(render, "open_source", lambda source: found.append(source) or open_source(source))
    for name in ("_scout", "_remember"):
        original = getattr(ShotRenderer, name)
        monkeypatch.setattr(ShotRenderer, name, lambda self, k, of=original, name=name, **o: found.append(name) or of(self, k, **o))
    yield found
    KEPT.drop()


def part(scene, folder, frames, *extra):
    """Status of a command line that renders a part into a folder."""
    return main(["render", str(scene), "-o", str(folder / "f.exr"), "--frames", "1-6", "--part", frames, *SMALL, *extra])


def test_a_part_that_goes_on_opens_nothing_and_has_the_same_bits(animated, whole, tmp_path, opened):
    for number, frames in enumerate(("1-2", "3-3", "4-6")):
        (tmp_path / f"{number}").mkdir()
        assert part(animated, tmp_path / f"{number}", frames, "--stats", str(tmp_path / f"{number}" / "s.json")) == 0
    assert opened == [str(animated)]
    assert part(animated, tmp_path, "2-2") == 0  # back
    assert opened == [str(animated), "_remember"]
    for file in tmp_path.glob("**/*.exr"):
        ours, theirs = read_exr(file), read_exr(whole / file.name)
        for name in theirs:
            np.testing.assert_array_equal(ours[name], theirs[name], err_msg=f"{name} of {file}")


@pytest.mark.parametrize("between", ["nothing", "time", "option", "still", "bake", "failure", "interrupt", "off"])
def test_a_shot_is_kept_for_its_own_next_part_only(between, animated, whole, tmp_path, opened, monkeypatch):
    scene = tmp_path / "scene.blend"
    scene.write_bytes(animated.read_bytes())
    monkeypatch.setattr(KEPT, "on", between != "off")
    assert part(scene, tmp_path, "1-2") == 0
    kept = KEPT._shot
    match between:
        case "time":
            os.utime(scene, ns=(1, 1))
        case "option":
            assert part(scene, tmp_path, "3-3", "--seed", "1") == 0
        case "still":
            assert main(["render", "cornell", "-o", str(tmp_path / "c.exr"), *SMALL[:-2]]) == 0
        case "bake":
            argv = ["--objects", "Room", "--size", "8", "--vpls", "16", "--texel-samples", "1", "--no-denoise"]
            assert main(["bake", "cornell", "-o", str(tmp_path / "maps"), *argv]) == 0
        case "failure" | "interrupt":
            raised = SceneError("no") if between == "failure" else KeyboardInterrupt()
            with monkeypatch.context() as broken:
                broken.setattr(ShotRenderer, "frame", Mock(side_effect=raised))
                assert part(scene, tmp_path, "3-3") == (2 if between == "failure" else 130)
            assert KEPT._shot is None
    opened.clear()
    assert part(scene, tmp_path, "3-3") == 0
    if between == "nothing":
        assert (opened, KEPT._shot) == ([], kept)
    else:
        assert opened == [str(scene), "_remember", "_remember"]
        assert KEPT._shot is None if between == "off" else KEPT._shot is not kept
    ours, theirs = read_exr(tmp_path / "f0003.exr"), read_exr(whole / "f0003.exr")
    for name in theirs:
        np.testing.assert_array_equal(ours[name], theirs[name], err_msg=name)


def test_a_part_of_a_flight_has_the_bits_of_the_whole(flown, tmp_path):
    path = tmp_path / "flown.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    for name, part in (("all", "1-6"), ("part", "6-6")):
        argv = ["render", str(path), "-o", str(tmp_path / f"{name}.exr"), "--frames", "1-6", "--part", part, *SMALL]
        assert main(argv) == 0
    whole, alone = (read_exr(tmp_path / f"{name}0006.exr") for name in ("all", "part"))
    for name in whole:
        np.testing.assert_array_equal(alone[name], whole[name], err_msg=name)


def test_steps(animated, tmp_path):
    assert main(["render", str(animated), "-o", str(tmp_path / "f.exr"), "--frames", "1-6:4", *SMALL]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["f0001.exr", "f0005.exr"]


def test_motion_blur_smears_what_moves(animated, tmp_path):
    for count in ("1", "3"):
        argv = ["render", str(animated), "-o", str(tmp_path / f"m{count}.exr"), "--frames", "3-3", "--motion-blur", count, *SMALL]
        assert main(argv) == 0
    still, blurred = (read_exr(tmp_path / f"m{count}0003.exr")["Albedo"] for count in "13")
    assert 0.001 < np.abs(still - blurred).mean() < 0.2
    assert abs(still.mean() / blurred.mean() - 1) < 0.1


def test_what_moves_is_known(animated):
    bpy.ops.wm.open_mainfile(filepath=str(animated))
    assert len(moving_objects(bpy.context.scene)) == 1
    bpy.context.scene.render.motion_blur_shutter = 0.5
    bpy.context.scene.render.motion_blur_position = "CENTER"
    assert exposures(bpy.context.scene, 4, 2) == [3.875, 4.125]


@pytest.fixture
def flown():
    """The Cornell box with a moving camera that hangs on an empty."""
    scene = sample_scenes.build("cornell")
    crane = bpy.data.objects.new("Crane", None)
    scene.collection.objects.link(crane)
    scene.camera.parent = crane
    keyed(crane, "location", 1.0)
    return scene


def keyed(block, path, change):
    """Keys at frames 1 and 6."""
    block.keyframe_insert(path, frame=1)
    value = getattr(block, path)
    setattr(block, path, value + change if isinstance(value, float) else [value[0] + change, *value[1:]])
    block.keyframe_insert(path, frame=6)


def test_a_flown_camera_is_all_that_is_read_again(flown):
    assert only_cameras_and_lamps_move(flown)
    view = View(size=(24, 16))
    first = view.extract(flown, 1)
    quick, whole = view.extract(flown, 4.5, first), view.extract(flown, 4.5)
    assert quick.geometry is first.geometry
    for name in ("camera", "geometry", "materials", "lamps", "world", "origin"):
        assert alike(getattr(quick, name), getattr(whole, name)), name
    assert not alike(quick.camera, first.camera)


def lamp_of(scene, kind="POINT", name="Bulb"):
    """An object with a new lamp."""
    ob = bpy.data.objects.new(name, bpy.data.lights.new(name, kind))
    scene.collection.objects.link(ob)
    return ob


def test_moved_lamps_are_all_that_is_read_again(flown):
    point, sun = lamp_of(flown), lamp_of(flown, "SUN", "Sun")
    keyed(point, "location", 0.5)
    keyed(point.data, "energy", 5.0)
    keyed(sun, "rotation_euler", 0.5)
    assert only_cameras_and_lamps_move(flown)
    view = View(size=(24, 16))
    first = view.extract(flown, 1)
    quick, whole = view.extract(flown, 4.5, first), view.extract(flown, 4.5)
    assert quick.geometry is first.geometry
    for name in ("camera", "geometry", "materials", "lamps", "world", "origin"):
        assert alike(getattr(quick, name), getattr(whole, name)), name
    assert not alike(quick.lamps, first.lamps)


def test_the_sun_of_a_sky_stays_among_the_lamps(flown):
    flown.world = bpy.data.worlds.new("Sky")
    flown.world.use_nodes = True
    nodes = flown.world.node_tree
    sky = nodes.nodes.new("ShaderNodeTexSky")
    nodes.links.new(sky.outputs["Color"], nodes.nodes["Background"].inputs["Color"])
    keyed(lamp_of(flown), "location", 0.5)
    view = View(size=(24, 16))
    first = view.extract(flown, 1)
    quick = view.extract(flown, 4, first)
    assert quick.geometry is first.geometry and quick.lamps.names == first.lamps.names == ["Lamp", "Bulb", "Sky (sun)"]


@pytest.mark.parametrize("hidden", ["from renders, by keys", "in the viewport", "for want of power"])
def test_lamps_that_come_and_go_are_seen(flown, hidden):
    lamp = lamp_of(flown)
    keyed(lamp, "location", 0.5)
    view = View(size=(24, 16))
    if hidden == "from renders, by keys":
        for frame, state in ((1, False), (4, True)):
            lamp.hide_render = state
            lamp.keyframe_insert("hide_render", frame=frame)
    elif hidden == "for want of power":
        lamp.data.energy = 0.0
        lamp.data.keyframe_insert("energy", frame=4)
        lamp.data.energy = 5.0
        lamp.data.keyframe_insert("energy", frame=1)
    else:
        lamp.hide_viewport = True
    first = view.extract(flown, 1)
    quick, whole = view.extract(flown, 4, first), view.extract(flown, 4)
    assert alike(quick.lamps, whole.lamps) and quick.skipped == whole.skipped
    assert ("Bulb" in quick.lamps.names) == (hidden == "in the viewport")


def test_a_lamp_on_a_moving_object_takes_the_object_along(flown):
    keyed(next(ob for ob in flown.objects if ob.type == "MESH"), "location", 0.1)
    lamp_of(flown).parent = next(ob for ob in flown.objects if ob.type == "MESH")
    assert not only_cameras_and_lamps_move(flown)


def test_a_camera_hidden_in_the_viewport_is_found(flown):
    view = View(size=(24, 16))
    first = view.extract(flown, 1)
    flown.camera.hide_viewport = True
    np.testing.assert_allclose(view.extract(flown, 5, first).camera.matrix, view.extract(flown, 5).camera.matrix)


@pytest.mark.parametrize(
    "what", ["object", "lit object", "material", "world", "driver", "child", "follower", "physics", "movie", "handler", "view"]
)
def test_what_else_may_change_is_seen(flown, what):
    ob = next(ob for ob in flown.objects if ob.type == "MESH")
    handler = bpy.app.handlers.frame_change_post
    match what:
        case "object":
            keyed(ob, "location", 0.1)
        case "lit object":  # drawn by a lamp
            lamp = lamp_of(flown)
            keyed(lamp, "location", 0.1)
            ob.constraints.new("COPY_LOCATION").target = lamp
        case "material":
            keyed(ob.active_material.node_tree.nodes["Principled BSDF"].inputs["Roughness"], "default_value", 0.1)
        case "world":
            flown.world = flown.world or bpy.data.worlds.new("World")
            keyed(flown.world, "color", 0.1)
        case "driver":
            ob.driver_add("location", 0).driver.expression = "frame"
        case "child":
            ob.parent = flown.camera
        case "follower":
            ob.constraints.new("TRACK_TO").target = flown.camera
        case "physics":
            ob.modifiers.new("Cloth", "CLOTH")
        case "movie":
            bpy.data.images.new("Film", 4, 4).source = "SEQUENCE"
        case "handler":
            handler.append(len)
        case "view":
            tree = ob.active_material.node_tree
            distance = tree.nodes.new("ShaderNodeCameraData").outputs["View Distance"]
            tree.links.new(distance, tree.nodes["Principled BSDF"].inputs["Roughness"])
    try:
        assert not only_cameras_and_lamps_move(flown)
    finally:
        if len in handler:
            handler.remove(len)


@pytest.mark.parametrize("extra", [["--history", "3"], ["--skip-existing"], ["--contact-sheet", "x.png"]])
def test_options_of_sequences_need_frames(extra, capsys):
    with pytest.raises(SystemExit):
        arguments.parse(["render", "cornell", "-o", "x.exr", *extra])
    assert f"{extra[0]} belongs to --frames" in capsys.readouterr().err


def test_frames_are_not_cut_into_tiles(capsys):
    with pytest.raises(SystemExit):
        arguments.parse(["render", "cornell", "-o", "x.exr", "--frames", "1-2", "--tiles", "64"])
    assert "--tiles is for one still" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["1-6:0", "6-1", "1-", "a-b"])
def test_bad_ranges_are_told(text, capsys):
    with pytest.raises(SystemExit):
        arguments.parse(["render", "cornell", "-o", "x.exr", "--frames", text])
    assert capsys.readouterr().err.count("\n") == 1
