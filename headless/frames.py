"""One frame of a scene, from Blender's data to layers and figures."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import bpy

from ..core.jit import CompileTimer
from ..core.layers import Layers
from ..core.pipeline import render
from ..core.scene import Scene
from ..core.settings import RenderSettings
from .console import Terminal
from .sources import extract
from .topology_files import StoredTopologies

TOPOLOGIES = StoredTopologies()


@dataclass(frozen=True)
class View:
    """Who looks, at what size and when; None is the scene's own."""

    camera: str | None = None
    size: tuple[int, int] | None = None
    frame: int | None = None


@dataclass(frozen=True)
class Frame:
    """A rendered frame: the scene's arrays, its layers, and the statistics of design.md, section 3."""

    scene: Scene
    layers: Layers
    stats: dict


def render_frame(scene: bpy.types.Scene, view: View, settings: RenderSettings, terminal: Terminal) -> Frame:
    """Extract and render `scene`; the time of both is in the statistics, Numba's compile time apart under `seconds.jit`."""
    with CompileTimer() as compiling:
        begin = perf_counter()
        arrays = extract(scene, camera=view.camera, size=view.size, frame=view.frame)
        seconds = perf_counter() - begin - compiling.seconds
    with terminal.progress() as progress:
        result = render(arrays, settings, progress, extraction_seconds=seconds, topologies=TOPOLOGIES)
    result.stats["seconds"]["jit"] += compiling.seconds
    return Frame(arrays, result.layers, result.stats)


def numbered(path: Path, frame: int) -> Path:
    """`path` with the frame's number as Blender puts it: in place of the first `#`s, else four digits at the end of the name."""
    stem = path.stem if "#" in path.stem else path.stem + "####"
    return path.with_name(re.sub("#+", lambda hashes: f"{frame:0{len(hashes[0]) + (frame < 0)}d}", stem, count=1) + path.suffix)
