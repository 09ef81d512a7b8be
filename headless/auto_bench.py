"""`--method auto` held to its word: relMSE at a target error, seconds of a time budget.

Rows of the suite `auto`: `value` is what came out, `peer_value` what was asked for, `ratio` value / peer_value.  relMSE is that of `Indirect`, net of
the reference's noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from functools import partial

from ..core.denoise import Denoiser
from ..core.settings import RenderSettings
from . import contestants
from .bench_steps import Step
from .curves_bench import REFERENCE_SAMPLES, SIZE, reference_truth
from .sources import find_scene, open_source

TARGETS = (0.05, 0.02, 0.01, 0.005)
BUDGETS = (1.0, 3.0, 10.0, 30.0)
LAYER = "Indirect"


def auto_steps(
    scenes: Sequence[str],
    size: tuple[int, int] = SIZE,
    targets: Sequence[float] = TARGETS,
    budgets: Sequence[float] = BUDGETS,
    reference_samples: int = REFERENCE_SAMPLES,
) -> list[Step]:
    """A step for each scene that is there."""
    found = {name: find_scene(name) for name in scenes}
    return [
        Step(f"auto {name}", partial(_scene_rows, name, source, size, targets, budgets, reference_samples))
        for name, source in found.items()
        if source is not None
    ]


def _scene_rows(name: str, source: str, size, targets, budgets, reference_samples: int) -> list[dict]:
    scene = open_source(source)
    with closing(Denoiser()) as denoiser:
        truth = reference_truth(scene, source, size, reference_samples, denoiser)
    contestants.ours(scene, size, RenderSettings().scaled(0.125, 0))  # loads the kernels
    rows = []
    for target in targets:
        run = contestants.ours(scene, size, RenderSettings(target_error=target))
        error = truth.errors(run.layers, LAYER)["relmse"]
        rows.append(_row(name, f"relMSE asked for {target:g}", error, "relMSE", target, run, truth.noise(LAYER)))
    for budget in budgets:
        run = contestants.ours(scene, size, RenderSettings(time_budget=budget))
        rows.append(_row(name, f"seconds asked for {budget:g}", run.seconds, "s", budget, run, truth.noise(LAYER)))
    return rows


def _row(scene: str, case: str, value: float, unit: str, asked: float, run: contestants.Timed, noise: float) -> dict:
    return {
        "suite": "auto",
        "case": f"{scene}: {case}",
        "value": value,
        "unit": unit,
        "peer_value": asked,
        "ratio": value / asked,
        "scene": scene,
        "seconds": run.seconds,
        "reference_noise": noise,
    }
