"""A fuzzy-clustering preview beside Cycles at 4 samples with denoising: time, and FLIP of the indirect light against a reference."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from time import perf_counter

from ..core.denoise import Denoiser
from ..core.jit import CompileTimer
from ..core.layers import Layers, read_exr
from ..core.metrics import bias, flip
from ..core.pipeline import render
from ..core.settings import RenderSettings
from .cache import cached_reference, scene_identity
from .fuzzy_bench import find_scene
from .reference import ReferenceSettings, render_layers
from .sources import extract, open_source

SIZE = (480, 270)
SCENES = (("atrium", "atrium"), ("living room", "living-room-greywhite/scene.blend"), ("Cornell box", "cornell"))
PREVIEW = RenderSettings(method="fuzzy-clustering", vpls=4096, vpl_clusters=1000, pixel_samples=4, direct_samples=4, reflections=2)
PEER_SAMPLES, REFERENCE_SAMPLES = 4, 256
REPEATS = 3


@dataclass(frozen=True)
class Preview:
    """Median seconds from the evaluated scene to layers, and the layers."""

    seconds: float
    layers: Layers


def preview_rows(scenes=SCENES, size=SIZE, settings=PREVIEW, reference_samples=REFERENCE_SAMPLES, repeats=REPEATS) -> list[dict]:
    """Rows of time and FLIP, ours and the peer's; scenes that are not there are left out."""
    rows = []
    for name, source in scenes:
        found = find_scene(source)
        if found is None:
            continue
        scene = open_source(found)
        request = {"spp": reference_samples, "size": size, "bounces": settings.bounces, "seed": 1, "denoise": True}
        reference = read_exr(cached_reference(scene, scene_identity(found), **request))
        ours, peer = _ours(scene, size, settings, repeats), _cycles(scene, size, settings.bounces, repeats)
        rows.append(_row(f"{name}: seconds of a preview against Cycles at {PEER_SAMPLES} samples + OIDN", ours.seconds, "s", peer.seconds))
        for layer in ("Indirect", "DiffuseIndirect"):
            for metric in (flip, bias):
                values = [metric(preview.layers[layer], reference[layer]) for preview in (ours, peer)]
                rows.append(_row(f"{name}: {metric.__name__} of a preview's {layer}, ours and Cycles'", values[0], "1", values[1]))
    return rows


def _ours(scene, size, settings: RenderSettings, repeats: int) -> Preview:
    seconds = []
    for _ in range(repeats + 1):
        with CompileTimer() as compiling:
            begin = perf_counter()
            arrays = extract(scene, camera=None, size=size, frame=None)
            extraction = perf_counter() - begin - compiling.seconds
        result = render(arrays, settings, extraction_seconds=extraction)
        seconds.append(result.stats["seconds_total"])
    return Preview(statistics.median(seconds[1:]), result.layers)


def _cycles(scene, size, bounces: int, repeats: int) -> Preview:
    denoiser = Denoiser()
    request = ReferenceSettings(spp=PEER_SAMPLES, size=size, bounces=bounces, denoise=True)
    seconds = []
    for _ in range(repeats + 1):
        layers, stats = render_layers(scene, request, denoiser=denoiser)
        seconds.append(stats["seconds_total"])
    denoiser.close()
    return Preview(statistics.median(seconds[1:]), layers)


def _row(case: str, value: float, unit: str, peer: float) -> dict:
    return {"suite": "previews", "case": case, "value": value, "unit": unit, "peer_value": peer, "ratio": value / peer}
