"""`lumigate demo`: the main job on the built-in atrium."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from rich.table import Table

from ...core.layers import Layers, auto_exposure, write_exr, write_preview
from ...core.settings import RenderSettings
from ..console import Terminal
from ..frames import View, render_frame
from ..results import write_json
from ..sources import open_source

SCENE = "atrium"
SIZE = (640, 360)
SETTINGS = RenderSettings()
LIGHT = ("Combined", "Direct", "Indirect", "Irradiance")


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Render the atrium; leave its layers, a preview of each, and the statistics in a folder."""
    folder = arguments.output
    folder.mkdir(parents=True, exist_ok=True)
    frame = render_frame(open_source(SCENE), View(size=arguments.size or SIZE), SETTINGS, terminal)
    with terminal.interrupts.held():
        write_exr(folder / f"{SCENE}.exr", frame.layers)
        write_json(folder / f"{SCENE}.json", frame.stats)
        previews = write_previews(folder, frame.layers)
    _print(frame.stats, folder, previews, terminal)


def write_previews(folder: Path, layers: Layers) -> list[Path]:
    """A PNG of each layer that is a picture; those of light are exposed alike, so that they can be compared."""
    exposure = auto_exposure([layers["Combined"]])
    previews = []
    for name in (*LIGHT, "Albedo"):
        if name == "Irradiance":
            stops = auto_exposure([layers[name]])
        else:
            stops = 0.0 if name == "Albedo" else exposure
        previews.append(write_preview(folder / f"{SCENE}-{name}.png", layers[name], stops))
    return previews


def _print(stats: dict, folder: Path, previews: list[Path], terminal: Terminal) -> None:
    table = Table(title=f"{SCENE}, {'x'.join(map(str, stats['size']))} pixels, {stats['method']}", title_justify="left", show_header=False)
    table.add_column()
    table.add_column(justify="right")
    for stage, seconds in stats["seconds"].items():
        if stage != "jit":
            table.add_row(stage, f"{seconds:.2f} s")
    table.add_row("whole", f"{stats['seconds_total']:.2f} s", style="bold")
    table.add_row("compilation (first run only)", f"{stats['seconds']['jit']:.2f} s")
    table.add_row("VPLs", f"{stats['vpls']:,}")
    for kind, count in stats["rays"].items():
        table.add_row(f"{kind} rays", f"{count:,}")
    table.add_row("pairs shaded", f"{stats['pairs_shaded']:,}")
    terminal.out.print(table)
    for warning in stats["warnings"]:
        terminal.warn(warning)
    names = ", ".join(path.name for path in previews)
    terminal.out.print(
        f"layers: {folder / f'{SCENE}.exr'}\npictures: {names}\nfigures: {folder / f'{SCENE}.json'}", markup=False, soft_wrap=True
    )
