"""Random scenes against a path tracer: none crashes, is no number, leaks or is brighter or darker than it should be.

Each scene is rendered by one of the methods, twice, and its mean direct and indirect radiance compared with the path
tracer's.  The scenes are dealt to processes, so that a crash is a line of the table and not the end.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace

import numpy as np

from ...core.pipeline import render
from ...core.settings import RenderSettings
from ...core.stages import AVAILABLE
from ...core.threads import thread_count
from .outcome import Outcome
from .path_tracer import path_traced
from .random_scenes import random_scene

SCENES = 10_000
PATHS = 3000
PART = 250  # scenes a task
DARKNESS = 1e-9  # W/m2/sr that may be in a closed room without a lamp: rounding of shadow maps
DARK = 1e-3  # mean radiance that counts as none where scenes are compared by their ratio

# Mean deviation of the indirect light of all scenes that a method may have beside its noise: of those that trace a ray to all
# that shines, and of those that share visibility between neighbours in pictures of 6 x 4 pixels.
DEVIATION = {
    "instant-radiosity": 0.01,
    "importance-sampling": 0.015,
    "visibility-gates": 0.015,
    "fuzzy-clustering": 0.05,
    "virtual-area-lights": 0.05,
}
DIRECT_DEVIATION = 0.01  # of the direct light, which all have from the same rays


@dataclass(frozen=True)
class Sample:
    """What one random scene gave: (2,) arrays for Direct and Indirect radiance, mean of picture and channels.

    value: mean of two renders, spread: their squared difference / 4;  true, variance: of the path tracer.
    """

    seed: int
    kind: str
    method: str
    value: np.ndarray
    spread: np.ndarray
    true: np.ndarray
    variance: np.ndarray
    invalid: int
    fault: str = ""


def settings_of(seed: int) -> RenderSettings:
    """A small request for the scene of number `seed`, whose method it picks."""
    return RenderSettings(
        method=AVAILABLE[seed % len(AVAILABLE)], vpls=64, bounces=1 + seed // len(AVAILABLE) % 4, pixel_samples=4, direct_samples=4,
        gather=4, samples=4, vals=4, voxels=24, vpl_clusters=16, point_clusters=64, denoise=False, threads=1, seed=seed,
        layers=("Direct", "Indirect"),
    )  # fmt: skip


def sample(seed: int) -> Sample:
    """Render one random scene twice, and trace its paths."""
    scene, kind = random_scene(seed)
    settings = settings_of(seed)
    nothing = np.zeros(2)
    try:
        twice = [render(scene, replace(settings, seed=settings.seed + 104729 * k)).layers for k in range(2)]
    except Exception as error:  # any fault is a finding, and named
        return Sample(seed, kind, settings.method, nothing, nothing, nothing, nothing, 0, f"{type(error).__name__}: {error}")
    invalid = sum(int(np.count_nonzero(~np.isfinite(layers[name]))) for layers in twice for name in ("Direct", "Indirect"))
    a, b = (np.array([layers[name].mean(dtype=float) for name in ("Direct", "Indirect")]) for layers in twice)
    true, variance = path_traced(scene, settings.bounces, PATHS, seed)
    return Sample(seed, kind, settings.method, (a + b) / 2, (a - b) ** 2 / 4, true, variance, invalid)


def samples(seeds: Iterable[int]) -> list[Sample]:
    """`sample` of each, in this process."""
    return [sample(seed) for seed in seeds]


def random_scenes(count: int = SCENES) -> list[Outcome]:
    """What must hold over `count` random scenes, one line a method and property."""
    parts = [range(start, min(start + PART, count)) for start in range(0, count, PART)]
    found, crashed = [], 0
    with ProcessPoolExecutor(thread_count(), multiprocessing.get_context("spawn")) as pool:
        for future in [pool.submit(samples, part) for part in parts]:
            try:
                found += future.result()
            except BrokenProcessPool:
                crashed += 1
    lines = [Outcome(f"{count} random scenes: processes that died", "all", "0", crashed, crashed == 0)]
    for method in AVAILABLE:
        lines += judge(method, [one for one in found if one.method == method])
    return lines


def judge(method: str, found: list[Sample]) -> list[Outcome]:
    """Lines of the table for one method's scenes."""
    name = f"{len(found)} random scenes"
    faults = [one for one in found if one.fault]
    sound = [one for one in found if not one.fault]
    invalid = sum(one.invalid for one in sound)
    dark = [one for one in sound if one.kind == "dark room"]
    leak = max((one.value.max() for one in dark), default=0.0)
    lines = [
        Outcome(
            f"{name}: faults" + (f" (first: scene {faults[0].seed}, {faults[0].fault})" if faults else ""),
            method,
            "0",
            len(faults),
            not faults,
        ),
        Outcome(f"{name}: values that are no number", method, "0", invalid, invalid == 0),
        Outcome(f"{name}: light in {len(dark)} closed rooms without a lamp", method, f"<= {DARKNESS:g} W/m2/sr", leak, leak <= DARKNESS),
    ]
    for layer, label in enumerate(("direct", "indirect")):
        deviation, error, tails = statistics(sound, layer)
        most = DEVIATION[method] if layer else DIRECT_DEVIATION
        must = f"|mean| <= {most:g} + 3 x {error:.4f}"
        lines.append(Outcome(f"{name}: {label} light over the path tracer's", method, must, deviation, abs(deviation) <= most + 3 * error))
        lines.append(Outcome(f"{name}: {label} light, share of |t| beyond the 99 % quantile", method, "<= 0.05", tails, tails <= 0.05))
    return lines


def statistics(found: list[Sample], layer: int) -> tuple[float, float, float]:
    """Mean relative deviation of `layer`, its standard error, and the share of scenes with |t| above the 99 % quantile.

    A scene's own t has one degree of freedom (two renders), two where the path tracer's variance rules; scenes are weighed
    by the mean of both estimates of their light: weighed by the path tracer's alone, those that it happens to find too dark would
    count for more, and every method seem too bright.
    """
    value, spread, true, variance = (
        np.array([getattr(one, name)[layer] for one in found]) for name in ("value", "spread", "true", "variance")
    )
    middle = (np.maximum(value, 0) + np.maximum(true, 0)) / 2
    weight = 1 / (middle + DARK)
    total = (middle * weight).sum()
    lit = true > DARK
    error = np.sqrt(((value - true) ** 2 * weight**2).sum()) / total
    quantile = 63.66  # of |t| with one degree of freedom
    t = np.abs(value - true)[lit] / np.sqrt(spread + variance + (1e-3 * true) ** 2)[lit]
    return float(((value - true) * weight).sum() / total), float(error), float((t > quantile).mean()) if lit.any() else 0.0
