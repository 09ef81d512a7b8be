"""A farm of two processes gives one machine's bits, whatever becomes of its workers, and says in a line what is wrong."""

import gc
import json
import os
import signal
import subprocess
from pathlib import Path
from types import SimpleNamespace

import bpy
import dask
import numpy as np
import pytest
from distributed import Client, LocalCluster

from lumigate import sample_scenes
from lumigate.core.errors import SceneError
from lumigate.core.layers import read_exr
from lumigate.core.settings import SequenceSettings
from lumigate.headless import arguments
from lumigate.headless.cli import main
from lumigate.headless.farm import job, parts
from lumigate.headless.farm.worker import PING, FarmError, FarmWorker, command_line, do_part, own_environment, versions
from lumigate.headless.farm_bench import killing

SMALL = ["--vpls", "16", "--pixel-samples", "2", "--bounces", "2", "--no-denoise", "--threads", "1"]
FRAMES = ["--frames", "1-6", "--history", "1", "--size", "24x16", *SMALL]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The Cornell box with a moving camera, in a file."""
    path = tmp_path_factory.mktemp("scene") / "scene.blend"
    camera = sample_scenes.build("cornell").camera
    camera.keyframe_insert("location", frame=1)
    camera.location.x += 0.2
    camera.keyframe_insert("location", frame=6)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture(scope="module")
def farm():
    """A client of two workers."""
    with job.connected(None, 2) as client:
        yield client


def address(client: Client) -> str:
    return client.scheduler.address


def assert_same(ours: Path, theirs: Path) -> None:
    a, b = read_exr(ours), read_exr(theirs)
    assert set(a) == set(b)
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_frames_have_the_bits_of_one_machine_though_a_worker_is_killed(farm, scene, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(parts, "FEWEST", 1)
    monkeypatch.setattr(parts, "RUN", 1)
    killed = []
    original = job.Job.results

    def results(self, tell):
        for part, result in original(self, tell):
            if not killed:
                killed.append(next(iter(farm.cluster.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)
            yield part, result

    monkeypatch.setattr(job.Job, "results", results)
    monkeypatch.setattr(job, "connected", lambda scheduler, workers: _open(farm))
    argv = [str(scene), "-o", str(tmp_path / "farm.exr"), "--summary", str(tmp_path / "s.json"), *FRAMES]
    assert main(["farm", *argv]) == 0
    assert killed
    assert json.loads((tmp_path / "s.json").read_text())["rendered"] == 6
    assert main(["render", str(scene), "-o", str(tmp_path / "one.exr"), *FRAMES]) == 0
    for number in range(1, 7):
        assert_same(tmp_path / f"farm000{number}.exr", tmp_path / f"one000{number}.exr")


class _open:
    """A context that leaves the client open."""

    def __init__(self, client):
        self.client = client

    def __enter__(self):
        return self.client

    def __exit__(self, *_):
        pass


def test_tiles_make_the_still(farm, scene, tmp_path):
    argv = ["farm", str(scene), "-o", str(tmp_path / "still.exr"), "--tiles", "64", "--size", "96x48", *SMALL]
    assert main([*argv, "--scheduler", address(farm)]) == 0
    still = read_exr(tmp_path / "still.exr")
    assert still.size == (96, 48)
    assert main(["render", str(scene), "-o", str(tmp_path / "one.exr"), "--tiles", "64", "--size", "96x48", *SMALL]) == 0
    assert_same(tmp_path / "still.exr", tmp_path / "one.exr")
    assert main(["render", str(scene), "-o", str(tmp_path / "whole.exr"), "--size", "96x48", *SMALL]) == 0
    np.testing.assert_allclose(still["Albedo"], read_exr(tmp_path / "whole.exr")["Albedo"], atol=1e-6)


def test_lightmaps_and_atlases_have_the_bits_of_one_machine(farm, tmp_path):
    options = ["--vpls", "16", "--texel-samples", "1", "--no-denoise", "--threads", "1"]
    blocks = ["Tall block", "Short block"]
    argv = ["farm", "cornell", "-o", str(tmp_path / "farm"), "--bake", f"Room,{'+'.join(blocks)}", "--size", "32x32", *options]
    assert main([*argv, "--scheduler", address(farm)]) == 0
    images = json.loads((tmp_path / "farm" / "lightmaps.json").read_text())["images"]
    assert [image["objects"] for image in images] == [["Room"], sorted(blocks)]
    for objects, image in ((["--objects", "Room"], images[0]), (["--objects", ",".join(blocks), "--atlas"], images[1])):
        alone = tmp_path / image["objects"][0]
        assert main(["bake", "cornell", "-o", str(alone), *objects, "--size", "32", *options]) == 0
        ours, theirs = (read_exr(folder / image["file"]) for folder in (tmp_path / "farm", alone))
        assert set(ours) == set(theirs)
        for name in theirs:
            np.testing.assert_array_equal(ours[name], theirs[name])
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "farm" / "scene.blend"))
    assert "Lightmap" in bpy.data.objects["Room"].data.uv_layers
    assert all("Lightmap Atlas" in bpy.data.objects[name].data.uv_layers for name in blocks)


def test_names_are_no_paths_and_files_of_one_name_stay_apart(farm, tmp_path):
    # A slash in a name was taken for a path, and of two images that are called alike on disk the later one replaced the other.
    scene = sample_scenes.build("cornell", detail="low")
    scene.objects["Tall block"].name, scene.objects["Short block"].name = "Block/1", "Block:1"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    options = ["--size", "16x16", "--vpls", "16", "--texel-samples", "1", "--no-denoise", "--threads", "1"]
    argv = ["farm", str(tmp_path / "scene.blend"), "-o", str(tmp_path / "maps"), "--bake", "Block/1,Block:1", *options]
    assert main([*argv, "--scheduler", address(farm)]) == 0
    images = json.loads((tmp_path / "maps" / "lightmaps.json").read_text())["images"]
    assert {image["file"] for image in images} == {"Block_1.exr", "Block_1-2.exr"}
    for option in ("-o", "--stats"):
        with pytest.raises(FarmError, match="no path under"):
            command_line(parts.Part("x", ("bake", parts.SCENE, option, "/etc/1"), "cornell", None), "cornell", tmp_path)
    with pytest.raises(FarmError, match="no path under"):
        command_line(parts.Part("x", ("bake", parts.SCENE, "--objects", "-o/etc/1"), "cornell", None), "cornell", tmp_path)


def test_worker_does_our_work_only(farm):
    with pytest.raises(FarmError, match="parts of Lumigate's jobs only"):
        farm.submit(os.getcwd).result()
    with pytest.raises(Exception, match="parts of Lumigate's jobs only"):
        farm.run(os.getcwd)


def test_other_versions_are_told(farm):
    part = parts.Part("other-version", ("render",), "cornell", None)
    with pytest.raises(FarmError, match=r"worker tcp.* has numpy .* instead of 0\.1; install the same there"):
        farm.submit(do_part, part, versions() | {"numpy": "0.1"}, pure=False).result()


def test_what_is_wrong_with_a_part_is_one_line(farm, scene, tmp_path, capsys):
    argv = ["farm", str(scene), "-o", str(tmp_path / "f.exr"), "--camera", "Nobody", "--scheduler", address(farm), *FRAMES]
    assert main(argv) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("lumigate: error: no camera") or "Nobody" in error
    assert list(tmp_path.iterdir()) == []


def _clients():
    """Those that Dask still has to end."""
    return [found for found in gc.get_objects() if issubclass(type(found), Client) and found.status not in ("newly-created", "closed")]


def test_a_damaged_scene_is_called_as_the_user_calls_it(farm, tmp_path, capsys):
    damaged = tmp_path / "kitchen.blend"
    damaged.write_bytes(b"BLENDER damaged")
    capsys.readouterr()
    argv = ["farm", str(damaged), "-o", str(tmp_path / "f.exr"), "--frames", "1-1", "--size", "16x16"]
    assert main([*argv, "--scheduler", address(farm)]) == 2
    assert "cannot read 'kitchen.blend'" in capsys.readouterr().err


def test_unreachable_scheduler_is_one_line(tmp_path, capsys, monkeypatch):
    before = _clients()
    monkeypatch.setattr(job, "CONNECT", 1)
    assert main(["farm", "cornell", "-o", str(tmp_path / "f.exr"), "--scheduler", "127.0.0.1:9", *FRAMES]) == 2
    assert "no scheduler answers at '127.0.0.1:9'" in capsys.readouterr().err
    # Ended by the garbage collector at some later time, a client can hold up Dask for ever.
    assert not [found for found in _clients() if not any(found is known for known in before)]


@pytest.mark.parametrize(
    ("setting", "where", "told"),
    [
        ({"distributed.comm.require-encryption": True}, "127.0.0.1:9", "encryption required"),
        ({}, "tls://127.0.0.1:9", "TLS configuration"),
    ],
)
def test_missing_certificates_are_one_line(setting, where, told, tmp_path, capsys):
    before = _clients()
    with dask.config.set(setting):
        assert main(["farm", "cornell", "-o", str(tmp_path / "f.exr"), "--scheduler", where, *FRAMES]) == 2
    error = capsys.readouterr().err.strip()
    assert "\n" not in error
    assert told in error
    assert not [found for found in _clients() if not any(found is known for known in before)]


def test_a_scheduler_without_workers_is_one_line(scene, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(job, "CONNECT", 1)
    with LocalCluster(n_workers=0, dashboard_address=":0", silence_logs=50) as empty:
        where = empty.scheduler_address
        assert main(["farm", str(scene), "-o", str(tmp_path / "f.exr"), "--scheduler", where, *FRAMES]) == 2
    assert f"no worker has come to the scheduler at '{where}'" in capsys.readouterr().err


@pytest.mark.parametrize("segments", [0, 2])
def test_a_part_on_a_worker_that_hangs_is_done_by_another(segments, farm, monkeypatch):
    monkeypatch.setattr(job, "LOOK", 0.05)
    monkeypatch.setattr(job, "FETCHED", 2)
    render = ("render", parts.SCENE, "-o", f"{parts.OUTPUT}/f.exr", "--size", "16x16", *SMALL)
    todo = [
        parts.Part(f"{job.job_name()}-{k}", PING if k < 4 else render, "cornell", None, 1.0, k % segments if segments else None)
        for k in range(8)
    ]
    said, done, stopped = [], {}, []
    try:
        for part, result in job.Job(farm, todo).results(said.append):
            done[part.key] = list(result["files"])
            if not stopped:
                stopped.append(next(iter(farm.cluster.workers.values())).pid)
                os.kill(stopped[0], signal.SIGSTOP)
    finally:
        os.kill(stopped[0], signal.SIGCONT)
    assert done == {part.key: [] if part.argv == PING else ["f.exr"] for part in todo}
    assert any("is slow: another worker tries it, too" in line for line in said)


def test_a_command_line_runs_in_a_folder_of_its_own(farm):
    part = parts.Part(job.job_name(), ("render", parts.SCENE, "-osmall.exr", "--size", "16x16", *SMALL), "cornell", None)
    assert list(farm.submit(do_part, part, versions(), key=part.key).result()["files"]) == ["small.exr"]


def test_blender_has_the_users_environment_not_dasks():
    given = dask.config.get("distributed.nanny.pre-spawn-environ")
    assert "MALLOC_TRIM_THRESHOLD_" in given
    dasks = {name: str(value) for name, value in given.items()}
    assert own_environment({**dasks, "HOME": "/home/me"}) == {"HOME": "/home/me"}
    assert own_environment({**dasks, "OMP_NUM_THREADS": "7"}) == {"OMP_NUM_THREADS": "7"}


def test_no_scene_of_the_workers_machine_is_opened(farm, scene):
    part = parts.Part(job.job_name(), ("render", parts.SCENE, "-o", f"{parts.OUTPUT}/f.exr"), str(scene), None)
    with pytest.raises(FarmError, match="is no sample scene, and its file was not sent"):
        farm.submit(do_part, part, versions(), key=part.key).result()


@pytest.mark.parametrize("text", ["/etc/passwd", "../x.exr", "{output}/../x.exr"])
def test_paths_stay_under_the_root(text, tmp_path):
    with pytest.raises(FarmError, match="no path under the worker's folder"):
        command_line(parts.Part("p", ("render", parts.SCENE, "-o", text), "cornell", None), "cornell", tmp_path)
    with pytest.raises(FarmError, match="not among a worker's commands"):
        command_line(parts.Part("p", ("demo",), "cornell", None), "cornell", tmp_path)


def lengths(segments):
    return [[len(run) for run in runs] for runs in segments]


def test_a_segment_for_each_worker_in_runs_without_gaps():
    shot = range(1, 101)
    assert parts.frame_parts([1, 2, 3, 7, 8], shot, workers=1) == [[(1, 2, 3), (7, 8)]]
    assert lengths(parts.frame_parts(shot, shot, workers=2)) == [[9, 9, 9, 9, 9, 5], [9, 9, 9, 9, 9, 5]]
    assert parts.frame_parts([1, 3, 5], range(1, 6, 2), 1) == [[(1, 3, 5)]]
    assert lengths(parts.frame_parts(range(1, 21), range(1, 21), workers=50)) == [[10], [10]]
    assert parts.frame_parts([], shot, 2) == []


@pytest.mark.parametrize("workers", [1, 2, 3, 7, 40])
@pytest.mark.parametrize("wanted", [range(1, 101), [1, 2, 9, *range(40, 101)], range(50, 101)])
def test_every_frame_is_in_one_run(workers, wanted):
    segments = parts.frame_parts(wanted, range(1, 101), workers, handicap=3)
    assert [number for runs in segments for run in runs for number in run] == list(wanted)
    assert len(segments) <= workers
    assert all(sum(map(len, runs)) >= parts.FEWEST for runs in segments)


def test_the_segment_that_begins_the_shot_is_longer():
    sizes = [sum(map(len, runs)) for runs in parts.frame_parts(range(1, 121), range(1, 121), 2, handicap=3)]
    assert sizes in ([61, 59], [62, 58])
    later = [sum(map(len, runs)) for runs in parts.frame_parts(range(61, 121), range(1, 121), 2, handicap=3)]
    assert later == [30, 30]
    assert parts.handicap_of(SequenceSettings(history=0)) == 0


def test_a_worker_goes_on_with_its_segment_and_then_takes_the_end_of_the_longest():
    rows = parts.Segments([[1, 2, 3, 4, 5, 6, 7], [11, 12]])
    assert [rows.take("a"), rows.take("b"), rows.take("a"), rows.take("b")] == [1, 11, 2, 12]
    assert [rows.take("b") for _ in range(2)] == [6, 7]
    assert [rows.take("a") for _ in range(2)] == [3, 4]
    assert rows.take("b") is None  # the last one is its owner's, who has it done as soon
    assert (rows.take("a"), len(rows)) == (5, 0)
    assert rows.take("a") is None


def test_the_segment_of_a_lost_worker_is_taken_whole():
    rows = parts.Segments([[1, 2, 3], [11]])
    assert (rows.take("a"), rows.take("b")) == (1, 11)
    rows.keep(["b", "c"])
    assert [rows.take("b"), rows.take("c"), rows.take("b"), rows.take("b")] == [2, None, 3, None]


def test_each_worker_is_given_a_segment_in_order(farm, monkeypatch):
    asked: dict[str, list[tuple[int, int]]] = {}
    submit = job.Job._submit

    def noted(self, running, key, **options):
        (worker,) = options["workers"]
        asked.setdefault(worker, []).append((running.part.segment, int(key.rsplit("-", 1)[1])))
        assert options["allow_other_workers"]  # or a lost worker's would wait for it for ever
        submit(self, running, key, **options)

    monkeypatch.setattr(job.Job, "_submit", noted)
    todo = [parts.Part(f"{job.job_name()}-{k}", PING, "cornell", None, 1.0, k // 6) for k in range(12)]
    assert sorted(part.key for part, _ in job.Job(farm, todo).results(print)) == sorted(part.key for part in todo)
    assert sorted(rows[0] for rows in asked.values()) == [(0, 0), (1, 6)]
    for worker, rows in asked.items():
        own = [k for segment, k in rows if segment == rows[0][0]]
        assert own == sorted(own), worker


@pytest.mark.parametrize(
    ("extra", "told"),
    [
        (["--tiles", "64"], "--tiles needs --size"),
        (["--frames", "1-2", "--stats", "x.json"], "--stats cannot be given to a farm"),
        (["--tiles", "64", "--size", "8x8", "--summary", "s.json"], "belong to --frames"),
        (["--frames", "1-2", "--nonsense"], "--nonsense"),
    ],
)
def test_bad_usage_is_told_before_anything_runs(extra, told, capsys):
    with pytest.raises(SystemExit):
        arguments.parse(["farm", "cornell", "-o", "x.exr", *extra])
    assert told in capsys.readouterr().err


def test_sample_scenes_need_no_file():
    assert parts.identify("cornell") == ("cornell", None, None)
    assert issubclass(FarmWorker, object)
    assert not issubclass(FarmError, SceneError)  # it must be unpickled wherever it arrives


def test_a_benchmark_kills_its_workers_one_after_the_other():
    victims = [subprocess.Popen(["sleep", "600"]) for _ in range(2)]
    nannies = {k: SimpleNamespace(pid=victim.pid) for k, victim in enumerate(victims)}
    with killing(SimpleNamespace(cluster=SimpleNamespace(workers=nannies)), 0.05) as killed:
        assert [victim.wait(timeout=30) for victim in victims] == [-signal.SIGKILL] * 2
    assert set(killed) <= {victim.pid for victim in victims}
