"""One frame of a scene, from Blender's data to layers and figures."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import bpy

from ..core.errors import SceneError
from ..core.jit import CompileTimer
from ..core.layers import Layers
from ..core.scene import Scene
from ..core.settings import RenderSettings
from ..core.tiled import render_fitting
from .console import Terminal
from .sources import extract
from .topology_files import StoredTopologies

TOPOLOGIES = StoredTopologies()


@dataclass(frozen=True)
class View:
    """Who looks, at what size, when, and at what part (x0, y0, x1, y1 in pixels, y down); None is the scene's own."""

    camera: str | None = None
    size: tuple[int, int] | None = None
    frame: int | None = None
    border: tuple[int, int, int, int] | None = None

    def extract(self, scene: bpy.types.Scene, frame: float | None = None, still: Scene | None = None) -> Scene:
        """The arrays of a scene as this view shows it, at another frame where one is given; SceneError where it cannot be rendered.

        still: as in `sources.extract`.
        """
        arrays = extract(scene, camera=self.camera, size=self.size, frame=self.frame if frame is None else frame, still=still)
        if self.border is not None:
            camera = arrays.camera
            if self.border[2] > camera.width or self.border[3] > camera.height:
                raise SceneError(f"the border {self.border} does not lie in the picture of {camera.width}x{camera.height} pixels")
            arrays.camera = replace(camera, border=self.border)
        return arrays


@dataclass(frozen=True)
class Frame:
    """A rendered frame: the scene's arrays, its layers, and the statistics of design.md, section 3."""

    scene: Scene
    layers: Layers
    stats: dict


def render_frame(scene: bpy.types.Scene, view: View, settings: RenderSettings, terminal: Terminal, tiles: int | None = None) -> Frame:
    """Extract and render `scene`; the time of both is in the statistics, Numba's compile time apart under `seconds.jit`.

    tiles: pixels along their side, where the picture is wanted in tiles.
    """
    with CompileTimer() as compiling:
        begin = perf_counter()
        arrays = view.extract(scene)
        seconds = perf_counter() - begin - compiling.seconds
    with terminal.progress() as progress:
        result = render_fitting(arrays, settings, progress, extraction_seconds=seconds, topologies=TOPOLOGIES, side=tiles)
    result.stats["seconds"]["jit"] += compiling.seconds
    return Frame(arrays, result.layers, result.stats)


def numbered(path: Path, frame: int) -> Path:
    """`path` with the frame's number as Blender puts it: in place of the first `#`s, else four digits at the end of the name."""
    stem = path.stem if "#" in path.stem else path.stem + "####"
    return path.with_name(re.sub("#+", lambda hashes: f"{frame:0{len(hashes[0]) + (frame < 0)}d}", stem, count=1) + path.suffix)
