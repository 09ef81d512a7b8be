"""Fuzzy clustering beside brute-force instant radiosity of the same VPLs: speed, error of the displayed picture, cluster borders.

The paper's three configurations (2022, Figure 1): the Cornell box, a room, and a scene with much visibility to resolve.
Both give the light of the VPLs alone, under one clamp: the noise of gather rays would drown the difference.  Brute force is timed on
whole chunks of neighbouring points, spread over the picture, and scaled by their share of it; errors are those of the same
points.  Times are CPU time of all threads, so that a busy machine does not bend them.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from ..core.lamps import build_emitters, direct_irradiance, world_tables
from ..core.layers import auto_exposure, srgb
from ..core.methods.fuzzy_clustering import FuzzyClustering
from ..core.methods.instant_radiosity import CHUNK, InstantRadiosity, clamp_of
from ..core.particles import Vpls
from ..core.rays import RayScene
from ..core.scene import TRANSPARENT, Scene
from ..core.transport import Transport, transport
from ..core.view.points import ShadingPoints
from ..core.view.primary import view
from ..core.vpl_pool import vpl_pool
from .sources import extract, find_scene, open_source

SIZE = (800, 800)
VPLS = 8192
BOUNCES = 4
REPEATS = 3  # of the paper's configurations; the others, compiled by then, run once
CLUSTERS = (1000, 2000, 4000, 8000, 20000)  # on either axis, one at a time
FUZZINESS = (1, 2, 6, 10)
CHUNKS = 48  # of points lit by brute force


@dataclass(frozen=True)
class Configuration:
    """One of the paper's configurations: its clusters, its speed-up over brute force and its MSE."""

    name: str
    source: str
    vpl_clusters: int
    point_clusters: int
    speed_up: float
    mse: float


CONFIGURATIONS = (
    Configuration("Cornell box", "cornell", 1000, 20000, 14.5, 1.10e-3),
    Configuration("living room", "living-room-greywhite/scene.blend", 4000, 8000, 5.8, 8.13e-4),
    Configuration("atrium", "atrium", 2000, 8000, 16.0, 1.80e-3),
)


@dataclass(frozen=True)
class LitView:
    """What both contestants light: N shading points, M VPLs, and the tables of the scene."""

    tables: Transport
    points: ShadingPoints
    vpls: Vpls
    shape: tuple[int, int]


@dataclass(frozen=True)
class BruteForce:
    """Instant radiosity at some of the points.

    at: their indices.  seconds: scaled to all points.  g_max: its clamp.  direct, irradiance: (S, 3) W/m^2.
    """

    at: np.ndarray
    seconds: float
    g_max: float
    direct: np.ndarray
    irradiance: np.ndarray


def fuzzy_rows(
    configurations: tuple[Configuration, ...] = CONFIGURATIONS,
    size: tuple[int, int] = SIZE,
    vpls: int = VPLS,
    repeats: int = REPEATS,
    clusters: tuple[int, ...] = CLUSTERS,
    fuzziness: tuple[int, ...] = FUZZINESS,
) -> list[dict]:
    """Rows of the suite `fuzzy`; scenes that are not there are left out."""
    rows = []
    for configuration in configurations:
        source = find_scene(configuration.source)
        if source is None:
            continue
        with lit_view(extract(open_source(source), camera=None, size=size, frame=None), vpls) as lit:
            rows += _rows_of(configuration, lit, repeats, clusters, fuzziness)
    return rows


@contextmanager
def lit_view(scene: Scene, count: int) -> Iterator[LitView]:
    """One shading point a surface of each pixel, and a pool of VPLs for them."""
    geometry = scene.geometry
    transparent = (scene.materials.tables.flags[geometry.material] & TRANSPARENT) != 0
    with RayScene(geometry.vertices, geometry.triangles, geometry.object_visibility[geometry.object], transparent) as rays:
        tables = transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))
        seen = view(scene, rays.tables, world_tables(scene.world), 1, 0)
        pool, _ = vpl_pool(tables, seen.points, count, BOUNCES, clamp_of, 0)
        yield LitView(tables, seen.points, pool, seen.shape)


def brute_force(lit: LitView) -> BruteForce:
    """Instant radiosity at some whole chunks of points."""
    n = len(lit.points.pixel)
    chunks = np.linspace(0, max(n // CHUNK - 1, 0), min(CHUNKS, max(n // CHUNK, 1))).astype(np.int64)
    at = (chunks[:, None] * CHUNK + np.arange(min(CHUNK, n))).ravel()
    points = lit.points.take(at)
    solver = InstantRadiosity(compensation=0)
    solver.prepare(lit.tables, lit.vpls, lit.points)
    solver.irradiance(points.take(slice(0, 16)))  # compiles
    begin = time.process_time()
    irradiance = solver.irradiance(points)
    seconds = (time.process_time() - begin) * n / len(at)
    direct, _ = direct_irradiance(lit.tables, points, 16, 0)
    return BruteForce(at, seconds, solver.g_max, direct, irradiance)


def displayed(lit: LitView, brute: BruteForce, irradiance: np.ndarray) -> np.ndarray:
    """Display values (S, 3) of the light that the points send to the viewer; exposed by the brute force's picture."""
    scale = lit.points.albedo[brute.at] / np.float32(np.pi)
    stops = auto_exposure([scale * (brute.direct + brute.irradiance)])
    return srgb(scale * (brute.direct + irradiance) * np.float32(2.0**stops))


def mse(lit: LitView, brute: BruteForce, irradiance: np.ndarray) -> float:
    """Mean squared error of the displayed picture, values in 0..1; irradiance: (N, 3) at all points."""
    difference = displayed(lit, brute, irradiance[brute.at]) - displayed(lit, brute, brute.irradiance)
    return float(np.mean(difference**2))


def border_energy(lit: LitView, irradiance: np.ndarray, cluster: np.ndarray) -> float:
    """Energy of the steps between neighbouring pixels at cluster borders beyond that inside, over the mean irradiance squared.

    irradiance: (N, 3);  cluster: (N,) each point's.  A step is what the difference of two pixels has beyond the slopes on both
    sides, in rows and columns of four pixels in one plane; the borders that count have two pixels of one cluster on either side.
    """
    points, (height, width) = lit.points, lit.shape
    point_at = np.full(height * width, -1, np.int64)
    point_at[points.pixel] = np.arange(len(points.pixel))
    point_at = point_at.reshape(height, width)
    rows = [[p[:, k : p.shape[1] - 3 + k].ravel() for k in range(4)] for p in (point_at, point_at.T)]
    four = np.concatenate(rows, axis=1)
    four = four[:, (four >= 0).all(axis=0)]
    for k in (1, 2, 3):
        first, other = four[0], four[k]
        step = points.position[other] - points.position[first]
        flat = np.abs(np.sum(step * points.ns[first], axis=1)) < 0.02 * np.linalg.norm(step, axis=1)
        four = four[:, flat & (np.sum(points.ns[first] * points.ns[other], axis=1) > 0.999)]
    light = irradiance.mean(axis=1) / irradiance.mean()
    a, b, c, d = light[four]
    squared = ((c - b) - 0.5 * ((b - a) + (d - c))) ** 2
    of_a, of_b, of_c, of_d = cluster[four]
    halves = (of_a == of_b) & (of_c == of_d)
    return float(squared[halves & (of_b != of_c)].mean() - squared[halves & (of_b == of_c)].mean())


def _rows_of(configuration: Configuration, lit: LitView, repeats: int, clusters, fuzziness) -> list[dict]:
    brute = brute_force(lit)
    given = {
        "vpl_clusters": configuration.vpl_clusters,
        "point_clusters": configuration.point_clusters,
        "fuzziness": 6,
        "shade_with": "clusters",
    }
    settings = [given, given | {"shade_with": "vpls"}]
    settings += [given | {axis: k} for axis in ("vpl_clusters", "point_clusters") for k in clusters if k != given[axis]]
    settings += [given | {"fuzziness": f} for f in fuzziness if f != given["fuzziness"]]
    rows, borders = [], {}
    for setting in settings:
        if setting["vpl_clusters"] >= len(lit.vpls.bounce):
            continue
        seconds, irradiance, solver = _solve(lit, setting, brute.g_max, repeats if setting in settings[:2] else 0)
        label = f"{configuration.name}: {setting['vpl_clusters']} VPL clusters, {setting['point_clusters']} point clusters, " + (
            f"F = {setting['fuzziness']}, shaded with {setting['shade_with']}"
        )
        facts = setting | {"scene": configuration.name, "size": list(lit.shape[::-1]), "vpls": len(lit.vpls.bounce), "rays": solver.rays}
        error = mse(lit, brute, irradiance)
        rows.append(_row(f"{label}: time", seconds, "CPU s", brute.seconds, brute.seconds / seconds, facts))
        peer = configuration.mse if setting is given else None
        rows.append(_row(f"{label}: MSE of the displayed picture", error, "1", peer, peer and peer / error, facts))
        if setting == given | {"fuzziness": setting["fuzziness"]}:
            borders[setting["fuzziness"]] = border_energy(lit, irradiance, solver.view.fuzzy.indices[:, 0])
    if 1 in borders:
        rows += [
            _row(f"{configuration.name}: energy of cluster borders, F = {f} against 1", value, "1", borders[1], borders[1] / abs(value), {})
            for f, value in borders.items()
            if f != 1
        ]
    return rows


def _solve(lit: LitView, setting: dict, g_max: float, repeats: int) -> tuple[float, np.ndarray, FuzzyClustering]:
    """Median seconds of clustering, visibility and shading, after a first round (which counts alone where there are no repeats);
    the irradiance, and its solver."""
    seconds = []
    for _ in range(repeats + 1):
        solver = FuzzyClustering(compensation=0, **setting)
        begin = time.process_time()
        solver.prepare(lit.tables, lit.vpls, lit.points)
        solver.g_max = g_max
        irradiance = solver.irradiance(lit.points)
        seconds.append(time.process_time() - begin)
    return statistics.median(seconds[1:] or seconds), irradiance, solver


def _row(case: str, value: float, unit: str, peer: float | None, ratio: float | None, facts: dict) -> dict:
    row = {"suite": "fuzzy", "case": case, "value": value, "unit": unit} | facts
    return row if peer is None else row | {"peer_value": peer, "ratio": ratio}
