"""A fuzzy-clustering preview beside Cycles at 4 samples with denoising: time, and FLIP of the indirect light against a reference.

Turn about, each turn with a seed of its own, for a preview's error hangs on it: medians of the seconds, means of the errors.
"""

from __future__ import annotations

import statistics
from contextlib import closing
from dataclasses import replace
from functools import partial

import bpy

from ..core.denoise import Denoiser
from ..core.layers import read_exr
from ..core.metrics import bias, flip
from ..core.settings import RenderSettings
from . import contestants
from .cache import cached_reference, scene_identity
from .reference import ReferenceSettings
from .sources import find_scene, open_source

SIZE = (480, 270)
SCENES = (("atrium", "atrium"), ("living room", "living-room-greywhite/scene.blend"), ("Cornell box", "cornell"))
PREVIEW = RenderSettings(
    method="fuzzy-clustering", vpls=4096, vpl_clusters=1000, point_clusters=2000, downsampling=3, pixel_samples=3, direct_samples=4,
    reflections=6, gather=6,
)  # fmt: skip
PEER_SAMPLES, REFERENCE_SAMPLES = 4, 256
REPEATS = 6


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
        peers = ReferenceSettings(spp=PEER_SAMPLES, size=size, bounces=settings.bounces, denoise=True)
        with closing(Denoiser()) as denoiser:
            sides = partial(_preview, scene, size, settings), partial(_peer, scene, peers, denoiser)
            for side in sides:  # warms up
                side(0)
            turns = list(zip(*([side(seed) for side in sides] for seed in range(repeats)), strict=True))
        seconds = [statistics.median(run.seconds for run in runs) for runs in turns]
        rows.append(_row(f"{name}: seconds of a preview against Cycles at {PEER_SAMPLES} samples + OIDN", seconds[0], "s", seconds[1]))
        for layer in ("Indirect", "DiffuseIndirect", "Combined"):
            for metric in (flip, bias):
                values = [statistics.fmean(metric(run.layers[layer], reference[layer]) for run in runs) for runs in turns]
                rows.append(_row(f"{name}: {metric.__name__} of a preview's {layer}, ours and Cycles'", values[0], "1", values[1]))
    return rows


def _preview(scene: bpy.types.Scene, size: tuple[int, int], settings: RenderSettings, seed: int) -> contestants.Timed:
    return contestants.ours(scene, size, replace(settings, seed=seed))


def _peer(scene: bpy.types.Scene, request: ReferenceSettings, denoiser: Denoiser, seed: int) -> contestants.Timed:
    return contestants.cycles(scene, replace(request, seed=seed), denoiser)


def _row(case: str, value: float, unit: str, peer: float) -> dict:
    return {"suite": "previews", "case": case, "value": value, "unit": unit, "peer_value": peer, "ratio": value / peer}
