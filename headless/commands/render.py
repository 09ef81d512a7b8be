"""`lumigate render`: a scene's indirect light into a multilayer EXR file."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import bpy

from ...addon.extract.film import extract_film
from ...core.layers import write_exr
from ...core.settings import RenderSettings
from ..console import Terminal
from ..contact_sheet import write_contact_sheet
from ..debug_pictures import write_debug_pictures
from ..frames import Frame, View, numbered, render_frame
from ..keeping import KEPT
from ..results import write_json
from ..sequences import Shot, ShotRenderer
from ..sources import open_source, state_of


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Render one frame, or each of `--frames` into a file of its own."""
    view = View(arguments.camera, arguments.size, arguments.frame, arguments.border)
    if arguments.frames is not None:
        _render_frames(Shot(arguments.frames, view, arguments.settings, arguments.sequence), arguments, terminal)
        return
    scene = open_source(arguments.scene)
    settings = _filmed(arguments.settings, scene, arguments)
    _save(render_frame(scene, view, settings, terminal, arguments.tiles), arguments.output, arguments.stats, terminal)


def _filmed(settings: RenderSettings, scene: bpy.types.Scene, arguments: Namespace) -> RenderSettings:
    return replace(settings, film=extract_film(scene)) if arguments.scene_film else settings


def _render_frames(shot: Shot, arguments: Namespace, terminal: Terminal) -> None:
    """The frames of a shot that are wanted, and what is left of all of them."""

    def opened() -> ShotRenderer:
        scene = open_source(arguments.scene)
        return ShotRenderer(scene, replace(shot, settings=_filmed(shot.settings, scene, arguments)), terminal)

    files = {number: numbered(arguments.output, number) for number in shot.frames}
    if arguments.part is not None:
        files = {number: files[number] for number in arguments.part}
    wanted = [number for number, file in files.items() if not (arguments.skip_existing and file.is_file())]
    rows = [{"frame": number, "file": str(file), "existing": True} for number, file in files.items() if number not in set(wanted)]
    with KEPT.shot((state_of(arguments.scene), shot, arguments.scene_film), opened) as renderer:
        renderer.terminal = terminal
        for number in wanted:
            frame = renderer.frame(number)
            stats = arguments.stats and numbered(arguments.stats, number)
            _save(frame, files[number], stats, terminal)
            rows.append({"frame": number, "file": str(files[number]), "existing": False, **frame.stats})
    write_summary(arguments, files, rows)


def write_summary(arguments: Namespace, files: dict[int, Path], rows: list[dict]) -> None:
    """What `--summary` and `--contact-sheet` ask for; rows: one a frame."""
    if arguments.summary is not None:
        seconds = [row["seconds_total"] for row in rows if not row["existing"]]
        rows = sorted(rows, key=lambda row: row["frame"])
        write_json(arguments.summary, {"frames": len(rows), "rendered": len(seconds), "seconds_total": sum(seconds), "rows": rows})
    if arguments.contact_sheet is not None:
        write_contact_sheet(arguments.contact_sheet, list(files.values()))


def _save(frame: Frame, output: Path, stats: Path | None, terminal: Terminal) -> None:
    for warning in frame.stats["warnings"]:
        terminal.warn(warning)
    with terminal.interrupts.held():
        write_exr(output, frame.layers)
        write_debug_pictures(output, frame.layers)
        if stats is not None:
            write_json(stats, frame.stats)
    width, height = frame.stats["size"]
    terminal.out.print(
        f"{output}: {width}x{height}, {frame.stats['method']}, {frame.stats['seconds_total']:.2f} s", markup=False, soft_wrap=True
    )
    plan = frame.stats.get("auto")
    for reason in plan["reasons"] if plan and plan["goal"] else ():
        terminal.out.print(f"  auto: {reason}", markup=False, soft_wrap=True)
