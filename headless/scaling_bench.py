"""How the seconds of a render grow with triangles, VPLs, pixels, lamps and threads: the Cornell box with one of them changed.

Rows of the suite `scaling`: a case is one value of one axis, its `value` the median of the seconds from the scene's arrays to layers,
`relative` that by the first case of the axis.  The cases of an axis take turns.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..core.pipeline import render
from ..core.scene import POINT, Geometry, Lamps, Scene
from ..core.settings import RenderSettings
from ..core.threads import thread_count
from .bench_steps import Step
from .sources import extract, open_source

SIZE = (320, 180)
TRIANGLES = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
VPLS = (256, 1024, 4096, 16384, 65536)
PIXELS = ((160, 90), (320, 180), (640, 360), (1280, 720), (1920, 1080))
LAMPS = (1, 20, 200, 2000)
REPEATS = 3


@dataclass(frozen=True)
class Case:
    """One value of an axis, and what is rendered for it."""

    value: int
    scene: Scene
    settings: RenderSettings


def scaling_steps(
    triangles: Sequence[int] = TRIANGLES,
    vpls: Sequence[int] = VPLS,
    pixels: Sequence[tuple[int, int]] = PIXELS,
    lamps: Sequence[int] = LAMPS,
    repeats: int = REPEATS,
) -> list[Step]:
    """A step for each axis."""
    cores = thread_count()
    threads = sorted({1, *(2**k for k in range(1, cores.bit_length()) if 2**k <= cores), cores})
    plain = RenderSettings()
    axes: dict[str, Callable[[Scene], list[Case]]] = {
        "triangles": lambda scene: [Case(n, with_bumps(scene, n), plain) for n in triangles],
        "VPLs": lambda scene: [Case(n, scene, replace(plain, vpls=n)) for n in vpls],
        "pixels": lambda scene: [Case(w * h, resized(scene, w, h), plain) for w, h in pixels],
        "lamps": lambda scene: [Case(n, with_lamps(scene, n), plain) for n in lamps],
        "threads": lambda scene: [Case(n, scene, replace(plain, threads=n)) for n in threads],
    }
    return [Step(f"scaling {axis}", partial(_rows, axis, cases, repeats)) for axis, cases in axes.items()]


def _rows(axis: str, cases_of: Callable[[Scene], list[Case]], repeats: int) -> list[dict]:
    cases = cases_of(extract(open_source("cornell"), camera=None, size=SIZE, frame=None))
    seconds: list[list[float]] = [[] for _ in cases]
    render(cases[0].scene, replace(cases[0].settings, pixel_samples=1, samples=1, gather=1, vpls=256))  # loads the kernels
    for seed in range(repeats):
        for case, taken in zip(cases, seconds):
            taken.append(render(case.scene, replace(case.settings, seed=seed)).stats["seconds_total"])
    medians = [statistics.median(taken) for taken in seconds]
    return [
        {
            "suite": "scaling",
            "case": f"{axis} {case.value:,}",
            "value": median,
            "unit": "s",
            "axis": axis,
            "x": case.value,
            "relative": median / medians[0],
            "least": min(taken),
            "most": max(taken),
        }
        for case, taken, median in zip(cases, seconds, medians)
    ]


def resized(scene: Scene, width: int, height: int) -> Scene:
    """The same view with other pixels."""
    return replace(scene, camera=replace(scene.camera, width=width, height=height, border=(0, 0, width, height)))


def with_bumps(scene: Scene, triangles: int) -> Scene:
    """A bumpy sheet of about so many triangles in the middle, of the first object's first material."""
    side = max(1, round((triangles / 2) ** 0.5))
    g = scene.geometry
    low, high = g.vertices.min(axis=0), g.vertices.max(axis=0)
    s, t = np.meshgrid(*[np.linspace(0.3, 0.7, side + 1, dtype=np.float32)] * 2, indexing="ij")
    height = 0.4 + 0.02 * np.sin(40 * s) * np.sin(40 * t)
    vertices = (low + np.stack([s, t, height.astype(np.float32)], -1).reshape(-1, 3) * (high - low)).astype(np.float32)
    i, j = np.meshgrid(np.arange(side, dtype=np.int32), np.arange(side, dtype=np.int32), indexing="ij")
    a = (i * (side + 1) + j).ravel()
    faces = np.concatenate([np.stack([a, a + side + 1, a + 1], 1), np.stack([a + 1, a + side + 1, a + side + 2], 1)])
    x, y, z = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(y - x, z - x)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    n = len(faces)
    return replace(
        scene,
        geometry=Geometry(
            np.concatenate([g.vertices, vertices]),
            np.concatenate([g.triangles, faces + np.int32(len(g.vertices))]),
            np.concatenate([g.corner_normals, np.repeat(normal[:, None], 3, axis=1)]),
            np.concatenate([g.attributes, np.zeros((len(g.attributes), n, *g.attributes.shape[2:]), np.float32)], axis=1),
            np.concatenate([g.material, np.full(n, g.material[0], np.int32)]),
            np.concatenate([g.object, np.full(n, g.object[0], np.int32)]),
            g.object_names,
            g.object_visibility,
        ),
    )


def with_lamps(scene: Scene, count: int) -> Scene:
    """So many point lamps spread over the upper half of the scene, which send out 1 kW in all, instead of its own."""
    low, high = scene.geometry.vertices.min(axis=0), scene.geometry.vertices.max(axis=0)
    at = np.random.default_rng(count).uniform((0.1, 0.1, 0.5), (0.9, 0.9, 0.95), (count, 3))
    f = np.float32
    lamps = Lamps(
        kind=np.full(count, POINT, np.int32),
        position=(low + at * (high - low)).astype(f),
        axes=np.tile(np.eye(3, dtype=f), (count, 1, 1)),
        emission=np.full((count, 3), 1000 / (4 * np.pi * count), f),
        radius=np.full(count, 0.01, f),
        soft_falloff=np.zeros(count, np.uint8),
        angle=np.zeros(count, f),
        blend=np.zeros(count, f),
        size=np.zeros((count, 2), f),
        shape=np.zeros(count, np.int32),
        visibility=np.full(count, 255, np.uint8),
        cast_shadow=np.ones(count, np.uint8),
        names=[f"lamp {k}" for k in range(count)],
        groups=[""] * count,
    )
    return replace(scene, lamps=lamps)
