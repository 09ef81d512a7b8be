"""`lumigate reference`: the layers of the contract by Cycles."""

from __future__ import annotations

from argparse import Namespace

from ..console import Terminal
from ..reference import render_reference
from ..sources import open_source


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Render the reference and say what it cost."""
    scene = open_source(arguments.scene)
    names = ("spp", "size", "bounces", "seed", "camera", "frame", "denoise")
    with terminal.waiting("Cycles"):
        stats = render_reference(scene, arguments.output, **{name: getattr(arguments, name) for name in names})
    for warning in stats["warnings"]:
        terminal.warn(warning)
    width, height = stats["size"]
    terminal.out.print(
        f"{arguments.output}: {width}x{height}, {stats['method']}, {stats['seconds_total']:.2f} s", markup=False, soft_wrap=True
    )
