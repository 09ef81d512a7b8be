"""The farm: what a task costs beside its work, one worker against two, and the model of a film shot with what was measured here."""

from __future__ import annotations

import importlib.util
import tempfile
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

import bpy

from .. import sample_scenes
from ..core.errors import SceneError
from ..core.layers import write_exr, write_whole
from ..core.settings import RenderSettings, SequenceSettings
from .console import Terminal
from .frames import View
from .frames_bench import animate
from .sequences import Shot, ShotRenderer

TASKS = 1000
SIZE, FRAMES = (320, 180), 16


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
        seconds = {workers: _job(file, Path(temporary) / str(workers), frames, size, workers) for workers in (1, 2)}
    model = scaling(replace(FilmShot(), task_seconds=overhead, **measured))
    _plot(folder / "farm-model.png", model)
    rows = [("overhead of a task", overhead * 1000, "ms"), *((name, value, "") for name, value in measured.items())]
    rows += [(f"{frames} frames, {workers} workers", value, "s") for workers, value in seconds.items()]
    rows += [("two workers against one", seconds[1] / seconds[2], "x")]
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
    """Those of `farm.model.Shot` that are measured on one process: CPU seconds and bytes."""
    bpy.ops.wm.open_mainfile(filepath=str(file))
    shot = Shot(range(1, 6), View(size=size), RenderSettings(threads=1), SequenceSettings())
    with ShotRenderer(bpy.context.scene, shot, Terminal.silent()) as renderer:
        for number in shot.frames:
            begin = process_time()
            frame = renderer.frame(number)
            whole = process_time() - begin
        triangles = len(frame.scene.geometry.triangles)
        extraction = frame.stats["seconds"]["extraction"]
    with tempfile.TemporaryDirectory() as temporary:
        picture = write_exr(Path(temporary) / "f.exr", frame.layers).stat().st_size
    pixels = size[0] * size[1]
    return {
        "pixel_seconds": max(whole - extraction, 0.0) / pixels,
        "triangle_seconds": extraction / triangles,
        "file_bytes": file.stat().st_size / triangles,
        "pixel_bytes": picture / pixels,
    }


def _job(file: Path, folder: Path, frames: int, size: tuple[int, int], workers: int) -> float:
    """Seconds of a job on so many workers with one thread each, once these are warm."""
    from .farm import job
    from .farm.parts import OUTPUT, SCENE, Part, frame_parts, identify

    scene, digest, content = identify(str(file))
    text, pixels = f"1-{frames}", "x".join(map(str, size))
    folder.mkdir()
    with job.connected(None, workers) as client:

        def parts(runs: list[tuple[int, ...]]) -> list[Part]:
            name = job.job_name()
            common = ("render", SCENE, "-o", f"{OUTPUT}/f.exr", "--size", pixels, "--threads", "1", "--frames", text, "--part")
            return [Part(f"{name}-{run[0]}", (*common, f"{run[0]}-{run[-1]}"), scene, digest, len(run)) for run in runs]

        warm = [(1,)] * workers
        for runs in (warm, frame_parts(range(1, frames + 1), workers)):
            begin = perf_counter()
            for part, result in job.Job(client, parts(runs), content).results(lambda line: None):
                for name, data in result["files"].items():
                    write_whole(folder / f"{part.key}-{name}", lambda temporary, data=data: temporary.write_bytes(data))
            seconds = perf_counter() - begin
    return seconds


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
