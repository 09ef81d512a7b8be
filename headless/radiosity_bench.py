"""Instant radiosity against Cycles, scene by scene: energy of the indirect light, error of the direct light, alignment of the pixels.

Both sides shade the same bounces.  Means are those of a layer over the picture; what the reference's own noise leaves open stands
beside each, from its two independent halves.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..core import metrics
from ..core.denoise import Denoiser
from ..core.layers import Layers, auto_exposure, srgb, write_png
from ..core.settings import RenderSettings
from . import contestants
from .bench_steps import Step
from .curves_bench import Truth, reference_truth
from .sources import find_scene, open_source

SCENES = ("cornell", "corridor", "cornell-box/Original", "atrium", "sponza-crytek", "living-room-greywhite")
CONVERGING = "cornell"  # whose error is followed over the number of VPLs
SIZE = (240, 135)
REFERENCE_SAMPLES = 512  # of each half
SETTINGS = RenderSettings(method="instant-radiosity", vpls=4096)
VPLS = (1000, 4000, 16000)
SEEDS = (1, 2, 3)
MAP_LIMIT = 0.25  # relative error at which the error map is deepest red or blue


def radiosity_steps(
    folder: Path,
    scenes: Sequence[str] = SCENES,
    size: tuple[int, int] = SIZE,
    samples: int = REFERENCE_SAMPLES,
    settings: RenderSettings = SETTINGS,
    vpls: Sequence[int] = VPLS,
    seeds: Sequence[int] = SEEDS,
) -> list[Step]:
    """A step for each scene that is there, and one for the error over the number of VPLs; pictures go into `folder`."""
    found = {name: source for name in scenes if (source := find_scene(name)) is not None}
    steps = [
        Step(f"radiosity {name}", partial(scene_rows, folder, name, source, size, samples, settings)) for name, source in found.items()
    ]
    if CONVERGING in found:
        steps.append(Step("radiosity VPLs", partial(convergence_rows, found[CONVERGING], size, samples, settings, vpls, seeds)))
    return steps


def scene_rows(folder: Path, name: str, source: str, size, samples: int, settings: RenderSettings) -> list[dict]:
    """Rows of one scene; a picture of ours, Cycles' and their difference goes into `folder`."""
    scene = open_source(source)
    with closing(Denoiser()) as denoiser:
        truth = reference_truth(scene, source, size, samples, denoiser)
    ours = contestants.ours(scene, size, settings)
    rows = [_row(f"{name}: seconds", ours.seconds, "s")]
    for layer in ("DiffuseIndirect", "Direct"):
        rows.append(_row(f"{name}: bias of {layer}", metrics.bias(ours.layers[layer], truth.mean[layer]), "1"))
        rows.append(_row(f"{name}: standard error of the reference's mean {layer}", uncertainty(truth, layer), "1"))
        rows.append(_row(f"{name}: net relMSE of {layer}", truth.errors(ours.layers, layer)["relmse"], "1"))
    rows.append(_row(f"{name}: displacement", float(np.hypot(*displacement(ours.layers["Direct"], truth.mean["Direct"]))), "pixels"))
    folder.mkdir(parents=True, exist_ok=True)
    write_png(folder / f"radiosity-{Path(name).name}.png", picture(ours.layers, truth))
    return rows


def convergence_rows(source: str, size, samples: int, settings: RenderSettings, vpls: Sequence[int], seeds: Sequence[int]) -> list[dict]:
    """Net relMSE of `DiffuseIndirect` for each number of VPLs, mean of the seeds; the ratio is to the fewest."""
    scene = open_source(source)
    with closing(Denoiser()) as denoiser:
        truth = reference_truth(scene, source, size, samples, denoiser)
    errors = []
    for count in vpls:
        renders = [contestants.ours(scene, size, replace(settings, vpls=count, seed=seed)).layers for seed in seeds]
        errors.append(float(np.mean([truth.errors(layers, "DiffuseIndirect")["relmse"] for layers in renders])))
    return [
        _row(f"{CONVERGING}: net relMSE of DiffuseIndirect by {count} VPLs, against {vpls[0]}", error, "1", errors[0])
        for count, error in zip(vpls, errors, strict=True)
    ]


def uncertainty(truth: Truth, layer: str) -> float:
    """Standard error of the mean of a layer's reference, relative, by the difference of its halves."""
    a, b = (half[layer].astype(np.float64).mean(axis=-1) for half in truth.halves)
    return float((a - b).std() / 2 / np.sqrt(a.size) / truth.mean[layer].mean())


def displacement(test: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """(x, y) pixels by which `test` (H, W, C) is shifted against `reference`, to first order (Lucas & Kanade 1981).

    Least squares over all pixels but the border's: test - reference = -x d/dx - y d/dy of the mean of both.
    """
    test, reference = test.astype(np.float64), reference.astype(np.float64)
    rows, columns = np.gradient((test + reference) / 2, axis=(0, 1))
    inner = np.s_[1:-1, 1:-1]
    slopes = np.stack([columns[inner].ravel(), rows[inner].ravel()], axis=1)
    x, y = np.linalg.lstsq(-slopes, (test - reference)[inner].ravel(), rcond=None)[0]
    return float(x), float(y)


def picture(ours: Layers, truth: Truth) -> np.ndarray:
    """(H, 3 W, 3) display values: our DiffuseIndirect, Cycles', and the error, red where ours is too bright."""
    layer = "DiffuseIndirect"
    exposure = np.float32(2.0 ** auto_exposure([truth.mean[layer]]))
    shown = [srgb(layers[layer] * exposure) for layers in (ours, truth.mean)]
    return np.concatenate([*shown, metrics.error_map(ours[layer], truth.clean[layer], "signed", MAP_LIMIT)], axis=1)


def _row(case: str, value: float, unit: str, peer: float | None = None) -> dict:
    row = {"suite": "radiosity", "case": case, "value": value, "unit": unit}
    return row if peer is None else row | {"peer_value": peer, "ratio": value / peer}
