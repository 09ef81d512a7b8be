"""The farm: what a task costs beside its work, one worker against two, and the model of a film shot with what was measured here."""

from __future__ import annotations

import importlib.util
import math
import os
import signal
import tempfile
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Event, Thread
from time import perf_counter, process_time

import bpy
import numpy as np

from .. import sample_scenes
from ..core.errors import SceneError
from ..core.layers import read_exr, write_exr, write_whole
from ..core.settings import RenderSettings, SequenceSettings
from .console import Terminal
from .frames import View
from .frames_bench import animate
from .sequences import Shot, ShotRenderer

TASKS = 1000
SIZE, FRAMES = (320, 180), 240  # a shot of 10 s: what each worker computes before its first frame is not most of the work
KILLED_EACH = 10.0  # s, in the run whose workers are killed
# Of that run: parts, and what comes before the first of a segment, that take less time than a worker lives, its start and Blender's in it.
SMALL, SMALL_FRAMES, SMALL_OPTIONS = (64, 36), 240, ("--history", "1", "--vpls", "512", "--pixel-samples", "4")


def farm_rows(folder: Path, frames: int = FRAMES, size: tuple[int, int] = SIZE) -> list[dict]:
    """Rows of the suite `farm`; the model's plot goes into `folder`.  SceneError where a package is missing."""
    if importlib.util.find_spec("distributed") is None:
        raise SceneError("a farm needs the package distributed, which is not installed; pip install 'lumigate[farm]'")
    from .farm.model import Shot as FilmShot
    from .farm.model import scaling

    overhead = _overhead()
    with tempfile.TemporaryDirectory() as temporary:
        file = Path(temporary) / "atrium.blend"
        animate(sample_scenes.build("atrium"), "camera", frames)
        bpy.ops.wm.save_as_mainfile(filepath=str(file))
        measured = _constants(file, size)
        farm = _Farm(file, Path(temporary), frames, size)
        seconds = {workers: farm.run(f"{workers}", workers)[0] for workers in (1, 2)}
        same = farm.same("1", "2")
        small = _Farm(file, Path(temporary), SMALL_FRAMES, SMALL, SMALL_OPTIONS)
        small.run("calm", 1)
        hunted, kills = small.run("hunted", 2, KILLED_EACH)
        whole = small.same("calm", "hunted")
    model = scaling(replace(FilmShot(), task_seconds=overhead, **measured))
    _plot(folder / "farm-model.png", model)
    rows = [("overhead of a task", overhead * 1000, "ms"), *((name, value, "") for name, value in measured.items())]
    rows += [(f"{frames} frames, {workers} workers", value, "s") for workers, value in seconds.items()]
    rows += [("two workers against one", seconds[1] / seconds[2], "x")]
    rows += [(f"of {frames} frames with the same bits by one worker and by two", same, "")]
    rows += [(f"{SMALL_FRAMES} frames, 2 workers, one killed each {KILLED_EACH:g} s", hunted, "s"), ("workers killed then", kills, "")]
    rows += [(f"of {SMALL_FRAMES} frames with the bits of a worker left alone", whole, "")]
    rows += [(f"film shot on {row['workers']} workers", row["seconds"] / 3600, "h") for row in model]
    rows += [(f"efficiency on {row['workers']} workers", row["efficiency"], "") for row in model]
    return [{"suite": "farm", "case": case, "value": value, "unit": unit} for case, value, unit in rows]


def _overhead() -> float:
    """Seconds a task that does nothing, of a thousand on two workers."""
    from .farm import job
    from .farm.parts import Part

    with job.connected(None, 2) as client:
        parts = [Part(f"{job.job_name()}-{k}", ("ping",), "cornell", None) for k in range(TASKS)]
        for count in (10, TASKS):  # the first ones warm up
            begin = perf_counter()
            done = sum(1 for _ in job.Job(client, parts[:count]).results(lambda line: None))
            seconds = perf_counter() - begin
            parts = [replace(part, key=part.key + "-again") for part in parts]
    return seconds / done


def _constants(file: Path, size: tuple[int, int]) -> dict[str, float]:
    """Those of `farm.model.Shot` that are measured on one process: CPU seconds, frames and bytes."""
    bpy.ops.wm.open_mainfile(filepath=str(file))
    shot = Shot(range(1, 31), View(size=size), RenderSettings(threads=1), SequenceSettings())
    took = {}
    with ShotRenderer(bpy.context.scene, shot, Terminal.silent()) as renderer:
        for number in (1, 30, 15, 16):  # the first two compile what they need
            begin = process_time()
            frame = renderer.frame(number)
            took[number] = process_time() - begin
    # Of the whole scene, as a film's objects move: frames in which the camera alone moves do not read the others again.
    begin = process_time()
    triangles = len(shot.view.extract(bpy.context.scene, 17).geometry.triangles)
    extraction = process_time() - begin
    with tempfile.TemporaryDirectory() as temporary:
        picture = write_exr(Path(temporary) / "f.exr", frame.layers).stat().st_size
    pixels = size[0] * size[1]
    return {
        "pixel_seconds": took[16] / pixels,
        "warm_up": took[15] / took[16] - 1,
        "triangle_seconds": extraction / triangles,
        "file_bytes": file.stat().st_size / triangles,
        "pixel_bytes": picture / pixels,
    }


@contextmanager
def killing(client, every: float):
    """Kills one of a local cluster's workers each `every` seconds, in turn; yields the process numbers of those killed so far."""
    killed: list[int] = []
    over = Event()

    def kill() -> None:
        while not over.wait(every):
            alive = [nanny.pid for nanny in client.cluster.workers.values() if nanny.pid]
            if alive:
                killed.append(alive[len(killed) % len(alive)])
                with suppress(ProcessLookupError):  # it has just gone by itself
                    os.kill(killed[-1], signal.SIGKILL)

    killer = Thread(target=kill)
    killer.start()
    try:
        yield killed
    finally:
        over.set()
        killer.join()


@dataclass(frozen=True)
class _Farm:
    """One job, the frames of a file, done again and again: each run into its own folder under `root`, by workers of one thread each."""

    file: Path
    root: Path
    frames: int
    size: tuple[int, int]
    options: tuple[str, ...] = ()

    def run(self, name: str, workers: int, every: float = math.inf) -> tuple[float, int]:
        """Seconds by so many workers, once these are warm, and how many were killed, one each `every` seconds."""
        from .farm import job
        from .farm.parts import frame_parts, handicap_of, identify

        scene, digest, content = identify(str(self.file))
        folder = self.root / name
        folder.mkdir()

        def work(client, shot: range, segments: list[list[tuple[int, ...]]]) -> float:
            begin = perf_counter()
            name = job.job_name()
            made = partial(self._part, name, shot, scene=scene, digest=digest)
            parts = [made(run, segment=number) for number, runs in enumerate(segments) for run in runs]
            for _, result in job.Job(client, parts, content).results(lambda line: None):
                for file, data in result["files"].items():
                    write_whole(folder / file, lambda temporary, data=data: temporary.write_bytes(data))
            return perf_counter() - begin

        with job.connected(None, workers) as client:
            # A shot's ninth frame loads every kernel; of another shot, so that what is measured opens the scene itself.
            work(client, range(1, 10), [[(9,)]] * workers)
            numbers = range(1, self.frames + 1)
            segments = frame_parts(numbers, numbers, workers, handicap_of(SequenceSettings()))
            if every == math.inf:
                return work(client, numbers, segments), 0
            with killing(client, every) as killed:
                return work(client, numbers, segments), len(killed)

    def _part(self, name: str, shot: range, run: tuple[int, ...], *, scene: str, digest: str | None, segment: int):
        from .farm.parts import OUTPUT, SCENE, Part

        size = "x".join(map(str, self.size))
        argv = ("render", SCENE, "-o", f"{OUTPUT}/f.exr", "--size", size, "--threads", "1", *self.options)
        argv += ("--frames", f"{shot[0]}-{shot[-1]}", "--part", f"{run[0]}-{run[-1]}")
        return Part(f"{name}-{segment}-{run[0]}", argv, scene, digest, len(run), segment)

    def same(self, ours: str, theirs: str) -> int:
        """How many frames of two runs have the same bits in all layers."""

        def alike(file: str) -> bool:
            a, b = (read_exr(self.root / name / file) for name in (ours, theirs))
            return set(a) == set(b) and all(np.array_equal(a[layer], b[layer], equal_nan=True) for layer in a)

        return sum(alike(f"f{number:04d}.exr") for number in range(1, self.frames + 1))


def _plot(path: Path, model: list[dict]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    workers = [row["workers"] for row in model]
    axes.loglog(workers, [row["speedup"] for row in model], "o-", label="simulated")
    axes.loglog(workers, workers, ":", color="grey", label="ideal")
    axes.set_xlabel("workers")
    axes.set_ylabel("times as fast as one")
    axes.grid(True, which="major", alpha=0.3)
    axes.legend()
    write_whole(path, lambda temporary: figure.savefig(temporary, dpi=110))
