"""A fuzzy-clustering preview beside Cycles at 4 samples with denoising: time, and FLIP of the indirect light against a reference."""

from __future__ import annotations

from contextlib import closing
from functools import partial

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
PREVIEW = RenderSettings(method="fuzzy-clustering", vpls=4096, vpl_clusters=1000, pixel_samples=4, direct_samples=4, reflections=1)
PEER_SAMPLES, REFERENCE_SAMPLES = 4, 256
REPEATS = 3


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
        ours = contestants.median_of(repeats, partial(contestants.ours, scene, size, settings))
        peers = ReferenceSettings(spp=PEER_SAMPLES, size=size, bounces=settings.bounces, denoise=True)
        with closing(Denoiser()) as denoiser:
            peer = contestants.median_of(repeats, partial(contestants.cycles, scene, peers, denoiser))
        rows.append(_row(f"{name}: seconds of a preview against Cycles at {PEER_SAMPLES} samples + OIDN", ours.seconds, "s", peer.seconds))
        for layer in ("Indirect", "DiffuseIndirect"):
            for metric in (flip, bias):
                values = [metric(preview.layers[layer], reference[layer]) for preview in (ours, peer)]
                rows.append(_row(f"{name}: {metric.__name__} of a preview's {layer}, ours and Cycles'", values[0], "1", values[1]))
    return rows


def _row(case: str, value: float, unit: str, peer: float) -> dict:
    return {"suite": "previews", "case": case, "value": value, "unit": unit, "peer_value": peer, "ratio": value / peer}
