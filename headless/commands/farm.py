"""`lumigate farm`: frames, tiles of a still or lightmaps on many machines, by Dask distributed."""

from __future__ import annotations

import importlib.util
import json
import tempfile
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import bpy

from ...addon.lightmap_files import free_path
from ...addon.lightmaps import choose_objects, unwrap
from ...core.errors import SceneError
from ...core.layers import read_exr, write_exr, write_whole
from ..console import Terminal, quiet
from ..frames import numbered
from ..outputs import whole_folder
from ..sources import open_source
from .bake import LIST, request_of
from .bake import SCENE as PREPARED
from .render import write_summary


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
    from ..farm.parts import OUTPUT, SCENE, Part, frame_parts, handicap_of, identify

    scene, digest, content = identify(arguments.scene)
    files = {number: numbered(arguments.output, number) for number in arguments.frames}
    wanted = [number for number, file in files.items() if not (arguments.skip_existing and file.is_file())]
    segments = frame_parts(wanted, arguments.frames, len(client.nthreads()), handicap_of(arguments.sequence))
    text = f"{arguments.frames[0]}-{arguments.frames[-1]}:{arguments.frames.step}"
    name = job_name()
    parts = []
    outputs = ("-o", f"{OUTPUT}/f.exr", "--stats", f"{OUTPUT}/f.json")
    for segment, runs in enumerate(segments):
        for run_of in runs:
            only = f"{run_of[0]}-{run_of[-1]}:{arguments.frames.step}"
            argv = ("render", SCENE, *outputs, "--frames", text, "--part", only, *arguments.rest)
            parts.append(Part(f"{name}-frames-{only}", argv, scene, digest, len(run_of), segment))
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

    name, listed = job_name(), []
    with whole_folder(arguments.output) as folder:
        groups, made = _unwrapped(arguments, folder / PREPARED)
        scene, digest, content = identify(str(folder / PREPARED) if made else arguments.scene)
        parts = {}
        for k, group in enumerate(groups):
            argv = ("bake", SCENE, "-o", f"{OUTPUT}/maps", "--objects", ",".join(group), *["--atlas"] * (len(group) > 1), *arguments.rest)
            parts[f"{name}-{k}"] = k, Part(f"{name}-{k}", argv, scene, digest, len(group))
        several = sum(len(group) > 1 for group in groups) > 1
        for part, result in _results(client, [part for _, part in parts.values()], content, terminal):
            files = {Path(file).name: data for file, data in result["files"].items()}
            found = json.loads(files[LIST])
            for image in found["images"]:
                data = files[image["file"]]
                if several and len(image["objects"]) > 1:
                    file = Path(image["file"])
                    image["file"] = f"{file.stem}-{parts[part.key][0] + 1}{file.suffix}"
                path = free_path(folder, Path(image["file"]).stem, image["file"].rpartition(".")[2])  # workers do not know of each other's
                path.write_bytes(data)
                image["file"] = path.name
            listed.append(found)
        images = sorted((image for found in listed for image in found["images"]), key=lambda image: image["objects"])
        (folder / LIST).write_text(json.dumps({**listed[0], "images": images}, indent=2) + "\n", encoding="utf-8")
    terminal.out.print(f"{arguments.output}: {len(images)} lightmaps", markup=False, soft_wrap=True)


def _unwrapped(arguments: Namespace, file: Path) -> tuple[list[list[str]], bool]:
    """Names of the objects of each image; whether some needed a UV map: the scene with all of them is in `file` then.

    Workers that unwrapped them by themselves would each leave a scene with the UV maps of its own objects only.
    """
    scene = open_source(arguments.scene)
    groups = [[text] if text in scene.objects else text.split("+") for text in arguments.bake]
    request, made = request_of(arguments.baking), False
    for group in groups:
        made |= bool(unwrap(choose_objects(scene, group), replace(request, atlas=len(group) > 1))[0]) or len(group) > 1
    if made:
        with quiet():
            bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True, compress=True)
    return groups, made
