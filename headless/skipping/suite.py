"""Time, rays and memory of a picture with and without leaving out what it does not need.

With: lamps are drawn from a tree by what they can send to a point, VPLs from a pool by what they give to the view.  Without: every
lamp gets a shadow ray at every point, and every particle that lands is a VPL, so many that as many of them matter to the view.
How many matter is Kish's effective size of what each gives to it, (sum of w)^2 / sum of w^2.
"""

from __future__ import annotations

import time
import tracemalloc
from dataclasses import dataclass, replace

import numpy as np

from ...core.lamps import world_tables
from ...core.methods.instant_radiosity import clamp_of
from ...core.particles import Vpls, trace_particles
from ...core.pipeline import render
from ...core.scene import Scene
from ...core.settings import RenderSettings
from ...core.stages import Run, prepared
from ...core.view.primary import view
from ...core.vpl_pool import contributions, view_subset, vpl_pool
from .scenes import SCENES

WITH = RenderSettings(method="instant-radiosity", vpls=512, bounces=3, pixel_samples=4, direct_samples=16, reflections=0, gather=4, denoise=False, seed=1)  # fmt: skip
SUBSET = 256  # points that stand for the view where VPLs are weighed
MOST = 64  # times the VPLs: what would need more gets no more, and its ratios are bounds


@dataclass(frozen=True)
class Measured:
    """One picture: CPU seconds of all threads, rays from points and lamps, VPLs, mean indirect radiance, MiB of arrays at its peak."""

    seconds: float
    rays: int
    vpls: int
    light: float
    memory: float


def measure(scene: Scene, settings: RenderSettings) -> Measured:
    """Render twice: for the time, and for the memory, whose counting takes time; compiling was done before."""
    begin = time.process_time()
    result = render(scene, settings)
    seconds = time.process_time() - begin
    stats, light = result.stats, float(result.layers["Indirect"].mean(dtype=float))
    tracemalloc.start()
    try:
        render(scene, settings)
        memory = tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()
    return Measured(seconds, stats["rays"]["light"] + stats["rays"]["shadow"], stats["vpls"], light, memory)


def lights_that_matter(scene: Scene, settings: RenderSettings) -> float:
    """Effective number of the VPLs of a request, weighed by what they give to the view."""
    with prepared(Run(None), scene, settings, 0) as tables:
        points = view(scene, tables.rays, world_tables(scene.world), 1, settings.seed).points
        flown = (tables, settings.vpls, settings.bounces, settings.seed)
        if settings.skipping:
            vpls, _ = vpl_pool(tables, points, *flown[1:3], clamp_of, settings.seed)
        else:
            vpls, _ = trace_particles(*flown)
        weight, _ = contributions(tables, vpls, view_subset(points, SUBSET, 0), clamp_of(vpls, points), 0)
    return float(weight.sum() ** 2 / max((weight**2).sum(), np.finfo(float).tiny))


def without(scene: Scene, least: RenderSettings) -> tuple[RenderSettings, bool]:
    """The request without skipping of which as many VPLs matter, in powers of two, and whether it is that or only `MOST`."""
    wanted = lights_that_matter(scene, least)
    settings = replace(least, skipping=False, direct_samples=max(least.direct_samples, len(scene.lamps)))
    while settings.vpls < MOST * least.vpls:
        if lights_that_matter(scene, settings) >= wanted:
            return settings, True
        settings = replace(settings, vpls=2 * settings.vpls)
    return settings, False


def _vpl_memory(measured: Measured) -> float:
    """MiB of the VPLs that are kept."""
    return measured.vpls * sum(array.nbytes for array in Vpls.allocate(1)) / 2**20


def skipping_rows(scenes: dict = SCENES, size: tuple[int, int] = (160, 90)) -> list[dict]:
    """Rows of `bench skipping`."""
    rows = []
    for name, build in scenes.items():
        scene = build(*size)
        render(scene, replace(WITH, vpls=4))  # compiles
        settings, enough = without(scene, WITH)
        few, many = measure(scene, WITH), measure(scene, settings)
        note = f"{many.vpls:,} VPLs without" + ("" if enough else ", too few: at least")
        for what, unit, value, peer in (
            (f"CPU seconds ({note})", "s", few.seconds, many.seconds),
            ("rays", "1", few.rays, many.rays),
            ("mean indirect radiance", "W/m2/sr", few.light, many.light),
            ("memory of arrays", "MiB", few.memory, many.memory),
            ("memory of VPLs", "MiB", _vpl_memory(few), _vpl_memory(many)),
        ):
            row = {"suite": "skipping", "case": f"{name}: {what}, with and without skipping", "value": value, "unit": unit}
            rows.append(row | {"peer_value": peer, "ratio": peer / value if value else float("nan")})
    return rows
