"""The benchmark of sequences: its measures are those that its docstring names."""

import bpy
import numpy as np
import pytest

from lumigate import sample_scenes
from lumigate.headless import frames_bench, moved_bench
from lumigate.headless.frames_bench import Contestant, animate, error, temporal_error, write_animation


@pytest.fixture
def halves():
    rng = np.random.default_rng(1)
    truth = 1 + rng.random((1, 20, 20, 3)) * np.ones((40, 1, 1, 1))
    return truth, tuple(truth + 0.1 * rng.normal(size=truth.shape) for _ in range(2))


def test_flicker_is_what_varies_and_not_what_is_wrong_all_the_time(halves):
    truth, pair = halves
    rng = np.random.default_rng(2)
    square = truth.mean() ** 2
    assert temporal_error(truth, pair) == pytest.approx(0, abs=1e-4)
    assert temporal_error(truth + 0.5, pair) == pytest.approx(0, abs=1e-4)
    assert temporal_error(truth + 0.2 * rng.normal(size=truth.shape), pair) == pytest.approx(0.04 / square, rel=0.05)
    assert error(truth, pair) == pytest.approx(0, abs=1e-3)
    assert error(truth + 0.5, pair) > 0.05


@pytest.mark.parametrize("move", ["camera", "lamp"])
def test_moves_move(move):
    scene = sample_scenes.build("atrium", detail="low")
    moved = scene.camera if move == "camera" else next(ob for ob in scene.objects if ob.type == "LIGHT")
    animate(scene, move, 10)
    places = []
    for number in (1, 10):
        scene.frame_set(number)
        places.append(np.array(moved.matrix_world))
    assert np.abs(places[1] - places[0]).max() > 0.05


def test_rows_of_a_small_run(tmp_path, monkeypatch):
    def small(name, detail="full"):
        scene = sample_scenes.build("cornell")
        light = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
        scene.collection.objects.link(light)
        return scene

    monkeypatch.setattr(frames_bench, "sample_scenes", type("Scenes", (), {"build": staticmethod(small)}))
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path / "cache"))  # this is not the scene whose name it has
    monkeypatch.setattr(frames_bench, "MOST_SAMPLES", 2)
    monkeypatch.setattr(frames_bench, "EQUAL_SAMPLES", (1, 2))
    rows = frames_bench.frames_rows(tmp_path, size=(32, 24), frames=3, reference_samples=4, moves=("camera",))
    cases = [row["case"] for row in rows]
    assert "camera, sequence: temporal error of Indirect" in cases
    assert sum("cycles+oidn" in case for case in cases) == 12
    assert all(np.isfinite(row["value"]) for row in rows)
    (equal,) = [row for row in rows if "at our error" in row["case"]]
    assert equal["ratio"] == pytest.approx(equal["peer_value"] / equal["value"])


def test_time_to_an_error_lies_on_the_curve():
    curve = [(1.0, 0.4), (2.0, 0.1), (8.0, 0.05)]
    assert frames_bench.seconds_at(curve, 0.2) == (pytest.approx(2**0.5), "")
    assert frames_bench.seconds_at(curve, 0.05) == (pytest.approx(8.0), "")
    assert frames_bench.seconds_at(curve, 0.01) == (8.0, ">")
    assert frames_bench.seconds_at(curve, 0.5) == (1.0, "<")


def test_animation_is_small(tmp_path):
    frames = Contestant("x")
    frames.layers = [{"Indirect": np.random.default_rng(k).random((30, 40, 3), np.float32)} for k in range(5)]
    write_animation(tmp_path / "a.webp", [frames, frames])
    assert (tmp_path / "a.webp").read_bytes()[:4] == b"RIFF"


def test_one_moved_object_leaves_the_hierarchies_of_the_rest(monkeypatch):
    monkeypatch.setattr(moved_bench, "FRAMES", 2)
    hierarchies, whole = moved_bench.moved_rows((24, 16), objects=40)
    assert "one of 40 moved: hierarchies" in hierarchies["case"]
    assert whole["ratio"] == pytest.approx(whole["peer_value"] / whole["value"])
