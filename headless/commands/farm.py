"""`lumigate farm`: frames, tiles of a still or lightmaps on many machines, by Dask distributed."""

from __future__ import annotations

import importlib.util
import json
import tempfile
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path

from ...core.errors import SceneError
from ...core.layers import read_exr, write_exr, write_whole
from ..console import Terminal
from ..frames import numbered
from ..outputs import whole_folder
from .render import write_summary

LIST = "lightmaps.json"


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Do the job on the workers of a scheduler, or on some of this machine's own."""
    if importlib.util.find_spec("distributed") is None:
        raise SceneError("a farm needs the package distributed, which is not installed; pip install 'lumigate[farm]'")
    from ..farm import job

    with job.connected(arguments.scheduler, arguments.workers) as client:
        link = job.dashboard(client)
        if link:
            terminal.say(f"lumigate: dashboard {link}")
        if arguments.scheduler is None and not any(text == "--threads" for text in arguments.rest):
            arguments.rest += ["--threads", str(job.local_threads(arguments.workers))]
        work = {"frames": _frames, "tiles": _tiles, "bake": _lightmaps}[arguments.kind]
        work(arguments, client, terminal)


def _results(client, parts, content, terminal: Terminal) -> Iterator[tuple]:
    from ..farm import job

    with terminal.progress() as progress:
        for part, result in job.run_job(client, parts, content, progress, terminal.warn):
            for line in dict.fromkeys(result["said"].splitlines()):
                terminal.say(line)
            yield part, result


def _frames(arguments: Namespace, client, terminal: Terminal) -> None:
    from ..farm.job import job_name
    from ..farm.parts import OUTPUT, SCENE, Part, frame_parts, identify

    scene, digest, content = identify(arguments.scene)
    files = {number: numbered(arguments.output, number) for number in arguments.frames}
    wanted = [number for number, file in files.items() if not (arguments.skip_existing and file.is_file())]
    workers = len(client.scheduler_info()["workers"])
    text = f"{arguments.frames[0]}-{arguments.frames[-1]}:{arguments.frames.step}"
    name = job_name()
    parts = []
    for run_of in frame_parts(wanted, workers, arguments.frames.step):
        only = f"{run_of[0]}-{run_of[-1]}:{arguments.frames.step}"
        argv = ("render", SCENE, "-o", f"{OUTPUT}/f.exr", "--stats", f"{OUTPUT}/f.json", "--frames", text, "--part", only, *arguments.rest)
        parts.append(Part(f"{name}-frames-{only}", argv, scene, digest, len(run_of)))
    rows = [{"frame": number, "file": str(files[number]), "existing": True} for number in files if number not in set(wanted)]
    for part, result in _results(client, parts, content, terminal):
        for number in _numbers(part.argv):
            data = result["files"][numbered(Path("f.exr"), number).name]
            write_whole(files[number], lambda temporary, data=data: temporary.write_bytes(data))
            stats = json.loads(result["files"][numbered(Path("f.json"), number).name])
            rows.append({"frame": number, "file": str(files[number]), "existing": False, **stats})
            terminal.out.print(f"{files[number]}: {stats['seconds_total']:.2f} s on its worker", markup=False, soft_wrap=True)
    write_summary(arguments, files, rows)


def _numbers(argv: tuple[str, ...]) -> range:
    from ..sequence_arguments import frame_range

    return frame_range(argv[argv.index("--part") + 1])


def _tiles(arguments: Namespace, client, terminal: Terminal) -> None:
    from ...core.tiles import Mosaic, tiles, with_halo
    from ..farm.job import job_name
    from ..farm.parts import OUTPUT, SCENE, Part, identify

    scene, digest, content = identify(arguments.scene)
    width, height = arguments.size
    picture = (0, 0, width, height)
    name = job_name()
    parts = {}
    for tile in tiles(picture, arguments.tiles):
        border = ",".join(map(str, with_halo(tile, picture)))
        argv = ("render", SCENE, "-o", f"{OUTPUT}/tile.exr", "--size", f"{width}x{height}", "--border", border, *arguments.rest)
        parts[f"{name}-tile-{','.join(map(str, tile))}"] = tile, argv
    jobs = [Part(key, argv, scene, digest, (t[2] - t[0]) * (t[3] - t[1])) for key, (t, argv) in parts.items()]
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for part, result in _results(client, jobs, content, terminal):
            file = Path(folder) / "tile.exr"
            file.write_bytes(result["files"]["tile.exr"])
            found[part.key] = read_exr(file)
    mosaic = Mosaic((tile for tile, _ in parts.values()), picture)
    for key, (tile, _) in parts.items():  # in this order, whichever came first: the same bits
        mosaic.add(tile, found[key])
    write_exr(arguments.output, mosaic.picture())
    terminal.out.print(f"{arguments.output}: {width}x{height}, {len(parts)} tiles", markup=False, soft_wrap=True)


def _lightmaps(arguments: Namespace, client, terminal: Terminal) -> None:
    from ..farm.job import job_name
    from ..farm.parts import OUTPUT, SCENE, Part, identify

    scene, digest, content = identify(arguments.scene)
    name = job_name()
    parts = [
        Part(f"{name}-{object_}", ("bake", SCENE, "-o", f"{OUTPUT}/maps", "--objects", object_, *arguments.rest), scene, digest)
        for object_ in arguments.bake
    ]
    listed: list[dict] = []
    with whole_folder(arguments.output) as folder:
        for part, result in _results(client, parts, content, terminal):
            files = {Path(file).name: data for file, data in result["files"].items()}
            if any(file.endswith(".blend") for file in files):
                raise SceneError(
                    f"object {part.argv[5]!r} has no UV map to bake on; run `lumigate bake` once and use the scene.blend it leaves"
                )
            listed.append(json.loads(files.pop(LIST)))
            for file, data in files.items():
                (folder / file).write_bytes(data)
        images = sorted((image for found in listed for image in found["images"]), key=lambda image: image["objects"])
        (folder / LIST).write_text(json.dumps({**listed[0], "images": images}, indent=2) + "\n", encoding="utf-8")
    terminal.out.print(f"{arguments.output}: lightmaps of {len(parts)} objects", markup=False, soft_wrap=True)
