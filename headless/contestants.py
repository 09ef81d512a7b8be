"""One render of each contestant of a benchmark, timed alike: wall clock from the evaluated scene to layers, compilation apart."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import bpy

from ..core.denoise import Denoiser
from ..core.jit import CompileTimer
from ..core.layers import Layers
from ..core.pipeline import render
from ..core.settings import RenderSettings
from ..core.topology import Topologies
from .reference import ReferenceSettings, denoise_layers, render_layers
from .sources import extract


@dataclass(frozen=True)
class Timed:
    """Layers, and the seconds that they took."""

    seconds: float
    layers: Layers


def ours(scene: bpy.types.Scene, size: tuple[int, int], settings: RenderSettings) -> Timed:
    """A render of Lumigate by itself: extraction included, and the topology of a method that needs one."""
    with CompileTimer() as compiling:
        begin = perf_counter()
        arrays = extract(scene, camera=None, size=size, frame=None)
        extraction = perf_counter() - begin
    result = render(arrays, settings, extraction_seconds=extraction - compiling.seconds, topologies=Topologies())
    return Timed(result.stats["seconds_total"], result.layers)


def cycles(scene: bpy.types.Scene, request: ReferenceSettings, denoiser: Denoiser) -> Timed:
    """A render of Cycles with the denoising that `request` asks for."""
    layers, stats = render_layers(scene, request, denoiser=denoiser)
    return Timed(stats["seconds_total"], layers)


def denoised(raw: Timed, request: ReferenceSettings, denoiser: Denoiser) -> Timed:
    """A picture of Cycles, denoised afterwards: the same as, and for the time of, a render with denoising."""
    layers = replace(raw.layers, arrays=dict(raw.layers))
    return Timed(raw.seconds + denoise_layers(layers, request, denoiser)["denoise"], layers)
