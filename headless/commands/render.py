"""`lumigate render`: a scene's indirect light into a multilayer EXR file."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from ...core.layers import write_exr
from ..console import Terminal
from ..debug_pictures import write_debug_pictures
from ..frames import Frame, View, numbered, render_frame
from ..results import write_json
from ..sources import open_source


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Render one frame, or each of `--frames` into a file of its own."""
    scene = open_source(arguments.scene)
    view = View(arguments.camera, arguments.size, arguments.frame)
    if arguments.frames is None:
        _save(render_frame(scene, view, arguments.settings, terminal), arguments.output, arguments.stats, terminal)
        return
    for number in arguments.frames:
        frame = render_frame(scene, view.at(number), arguments.settings, terminal)
        stats = arguments.stats and numbered(arguments.stats, number)
        _save(frame, numbered(arguments.output, number), stats, terminal)


def _save(frame: Frame, output: Path, stats: Path | None, terminal: Terminal) -> None:
    for warning in frame.stats["warnings"]:
        terminal.warn(warning)
    write_exr(output, frame.layers)
    write_debug_pictures(output, frame.layers)
    if stats is not None:
        write_json(stats, frame.stats)
    width, height = frame.stats["size"]
    terminal.out.print(
        f"{output}: {width}x{height}, {frame.stats['method']}, {frame.stats['seconds_total']:.2f} s", markup=False, soft_wrap=True
    )
