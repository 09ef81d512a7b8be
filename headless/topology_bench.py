"""The topology's speed, and visibility by gates and by guided rays beside shadow rays of the same VPLs.

Visibility gates paper (2014): Section VI.A for the thinning, Table 1 for the stages' times, Table 2 for the errors.  Thinning and stages are
timed by the wall clock; what stands beside shadow rays is CPU time of all threads, so that a busy machine does not bend it.  All after a
first run that compiles.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..core.lamps import direct_irradiance, world_tables
from ..core.layers import auto_exposure, srgb, write_png
from ..core.methods.instant_radiosity import InstantRadiosity
from ..core.methods.visibility_gates import VisibilityGates
from ..core.picture import splat
from ..core.pipeline import render
from ..core.scene import Scene
from ..core.settings import RenderSettings
from ..core.topology import Topologies, Topology, blocking_triangles
from ..core.topology.cells import closure
from ..core.topology.distance import distance_map, opening_map
from ..core.topology.thinning import Thinning
from ..core.topology.voxels import Grid, empty_voxels, voxelise
from ..core.view.primary import view
from .fuzzy_bench import LitView, brute_force, lit_view
from .sources import extract, find_scene, open_source
from .topology_pictures import draw, plot_thinning
from .topology_scenes import SPONZA, house

RESOLUTIONS = (64, 128, 256, 512)
PEER_RESOLUTION = 48  # of dgtal, whose time grows beyond patience
PAPER_SECONDS = 109.0  # thinning of Sponza at 256
PAPER_STAGES = {512: (6.1, 4.3, 12.3, 10.9), 1024: (6.1, 4.3, 24.5, 22.1), 2048: (6.1, 4.3, 49.0, 44.2)}  # ms
PAPER_ERRORS = {"direct only": (111.96, 39.7544), "no shadows": (69.1091, 170.121), "disks": (33.1041, 39.6128)}
GUIDED = ("corridor", "cathedral", "sponza-crytek")
STAND_IN = "atrium"  # where Sponza is not there
VOXELS = 256
ERROR_VPLS = 1024
OVERSIZE = 1.5
FILTER = RenderSettings().gate_filter
PICTURED = ("no shadows", "disks", "polygons, filtered")
PICTURE, PICTURE_VOXELS = (400, 225), 128


def topology_rows(
    folder: Path,
    size: tuple[int, int] = (1024, 512),
    error_size: tuple[int, int] = (240, 135),
    resolutions: tuple[int, ...] = RESOLUTIONS,
    voxels: int = VOXELS,
    vpls: tuple[int, ...] = tuple(PAPER_STAGES),
    guided: tuple[str, ...] = GUIDED,
    rooms: tuple[int, int] = (8, 5),
) -> list[dict]:
    """Rows of the suite `topology`; its plot and a picture of the atrium's topology go to `folder`."""
    sponza = _extract("sponza-crytek", size) or _extract(STAND_IN, size)
    rows = thinning_rows(sponza, resolutions)
    known = Topologies()
    topology = known.of(sponza, voxels)
    rows += error_rows(_sized(sponza, error_size), topology, ERROR_VPLS, folder / "topology-visibility.png")
    rows += stage_rows(sponza, topology, vpls)
    for name in guided:
        scene = _extract(name, error_size)
        if scene is not None:
            rows += guided_rows(name, scene, known.of(scene, voxels), ERROR_VPLS)
    rows += house_rows(rooms, error_size)
    plot_thinning(folder / "topology-thinning.png", rows)
    draw(_extract(STAND_IN, PICTURE), folder / "topology-atrium.png", PICTURE_VOXELS, known)
    return rows


def _extract(source: str, size: tuple[int, int]) -> Scene | None:
    found = find_scene(source)
    return found and extract(open_source(found), camera=None, size=size, frame=None)


def _sized(scene: Scene, size: tuple[int, int]) -> Scene:
    """The same scene at another size; the picture grows upwards and downwards where its shape differs."""
    left, right, bottom, top = scene.camera.window
    half, middle = (right - left) / 2 * size[1] / size[0], (bottom + top) / 2
    window = (left, right, middle - half, middle + half)
    return replace(scene, camera=replace(scene.camera, width=size[0], height=size[1], border=(0, 0, *size), window=window))


def _volume(scene: Scene, resolution: int) -> np.ndarray:
    """(Z, Y, X) bool, the empty voxels."""
    triangles = blocking_triangles(scene)
    used = scene.geometry.vertices[np.unique(triangles)]
    grid = Grid.around(used.min(axis=0), used.max(axis=0), resolution)
    return empty_voxels(voxelise(scene.geometry.vertices, triangles, grid), grid)


def _thin(empty: np.ndarray) -> float:
    """Seconds of a volume's thinning: distance, opening and collapse."""
    begin = time.perf_counter()
    distance = distance_map(empty)
    Thinning(closure(empty), distance, opening_map(distance)).collapse()
    return time.perf_counter() - begin


def thinning_rows(scene: Scene, resolutions: tuple[int, ...] = RESOLUTIONS) -> list[dict]:
    """Time of the thinning by resolution, beside the paper's and dgtal's; memory of the process at the largest one."""
    _thin(_volume(scene, min(resolutions)))
    peer = _volume(scene, PEER_RESOLUTION)
    rows = [_row(f"thinning at {PEER_RESOLUTION}: seconds", _thin(peer), "s", _dgtal_seconds(peer))]
    for resolution in resolutions:
        empty = _volume(scene, resolution)
        rows.append(_row(f"thinning at {resolution}: seconds", _thin(empty), "s", PAPER_SECONDS if resolution == 256 else None))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return [*rows, _row(f"memory of the process after thinning at {max(resolutions)}", peak, "GiB")]


def _dgtal_seconds(empty: np.ndarray) -> float | None:
    """Seconds of dgtal's thinning of the same volume; None where dgtal is not installed."""
    try:
        import dgtal
    except ImportError:
        return None
    depth, height, width = empty.shape
    at = type(dgtal.Point(dim=3))
    voxels = dgtal.DigitalSet(domain=dgtal.Domain(lower_bound=at(0, 0, 0), upper_bound=at(width - 1, height - 1, depth - 1)))
    for z, y, x in np.argwhere(empty).tolist():
        voxels.insert(at(x, y, z))
    space = dgtal.KSpace(dim=3)
    space.init(lower=at(-1, -1, -1), upper=at(width, height, depth), is_closed=True)
    complex_ = dgtal._dgtal.topology.CubicalComplex3D(space)
    complex_.construct(voxels)
    begin = time.perf_counter()
    complex_.thinning(method="pardir")
    return time.perf_counter() - begin


@contextmanager
def _compared(scene: Scene, count: int) -> Iterator[tuple[LitView, np.ndarray, float]]:
    """A view, its light by shadow rays of all VPLs, and their CPU seconds."""
    with lit_view(scene, count) as lit:
        truth = InstantRadiosity(compensation=0)
        truth.prepare(lit.tables, lit.vpls, lit.points)
        truth.irradiance(lit.points.take(slice(0, 16)))  # compiles
        begin = time.process_time()
        irradiance = truth.irradiance(lit.points)
        yield lit, irradiance, time.process_time() - begin


def _gates(
    lit: LitView, topology: Topology, gates: str, oversize: float = 1.0, blend: float = 0.0
) -> tuple[VisibilityGates, np.ndarray, float]:
    """The solver, its light, and its CPU seconds."""
    solver = VisibilityGates(topology, gates=gates, oversize=oversize, blend=blend, compensation=0)
    solver.prepare(lit.tables, lit.vpls, lit.points)
    solver.irradiance(lit.points.take(slice(0, 64)))  # compiles
    solver.rays = solver.pairs = solver.saved = 0
    begin = time.process_time()
    irradiance = solver.irradiance(lit.points)
    return solver, irradiance, time.process_time() - begin


def error_rows(scene: Scene, topology: Topology, vpls: int, picture: Path | None = None) -> list[dict]:
    """Table 2: mean squared error of the displayed picture (values 0..255) against shadow rays of the same VPLs.

    picture: where to show the first and the last outlook, by shadow rays and by each of PICTURED.
    """
    rows, strips = [], []
    for number, outlook in enumerate(SPONZA):
        with _compared(outlook.of(scene), vpls) as (lit, truth, _):
            if not truth.any():
                continue
            direct, _ = direct_irradiance(lit.tables, lit.points, 16, 0)
            blind = InstantRadiosity(compensation=0, visibility="none")
            blind.prepare(lit.tables, lit.vpls, lit.points)
            light = {"direct only": 0 * truth, "no shadows": blind.irradiance(lit.points)}
            light |= {gates: _gates(lit, topology, gates)[1] for gates in ("off", "disks", "polygons", "guided")}
            light[f"disks, {OVERSIZE} times as large"] = _gates(lit, topology, "disks", OVERSIZE)[1]
            light |= {f"{gates}, filtered": _gates(lit, topology, gates, blend=FILTER)[1] for gates in ("disks", "polygons")}
            mse = partial(_displayed_mse, lit, direct, truth)
            shown = (_displayed(lit, direct, truth, irradiance) for irradiance in (truth, *(light[name] for name in PICTURED)))
            strips.append(np.concatenate([splat(lit.points, one, lit.shape) for one in shown], axis=1))
            none = mse(light["no shadows"])
            for name, irradiance in light.items():
                paper = PAPER_ERRORS.get(name, (None, None))[number % 2]
                row = _row(f"{outlook.name}, {name}: MSE", mse(irradiance), "1", paper)
                rows.append(row | {"of_no_shadows": row["value"] / none, "bias": float(irradiance.mean() / truth.mean() - 1)})
    if picture is not None and strips:
        write_png(picture, np.concatenate([strips[0], strips[-1]]))
    return rows


def _displayed(lit: LitView, direct: np.ndarray, truth: np.ndarray, irradiance: np.ndarray) -> np.ndarray:
    """Values (N, 3) of 0 to 1 that a screen shows of the points' light, exposed as `truth` is."""
    scale = lit.points.albedo / np.float32(np.pi)
    stops = np.float32(2.0 ** auto_exposure([scale * (direct + truth)]))
    return srgb(scale * (direct + irradiance) * stops)


def _displayed_mse(lit: LitView, direct: np.ndarray, truth: np.ndarray, irradiance: np.ndarray) -> float:
    shown, true = (255 * _displayed(lit, direct, truth, light) for light in (irradiance, truth))
    return float(np.mean((shown - true) ** 2))


def stage_rows(scene: Scene, topology: Topology, vpls: tuple[int, ...]) -> list[dict]:
    """Table 1: milliseconds of the stages beside the paper's, and the sum beside shadow rays for the same VPLs."""
    rows = []
    for count in vpls:
        with lit_view(scene, count) as lit:
            seconds = brute_force(lit).seconds
            begin = time.perf_counter()
            view(scene, lit.tables.rays, world_tables(scene.world), 1, 0)
            gp = {"GP": time.perf_counter() - begin}
            for gates in ("disks", "polygons"):
                solver, _, own = _gates(lit, topology, gates)
                label = f"{len(lit.vpls.bounce)} of {count} VPLs, {gates}"
                paper = dict(zip(("GP", "IUGC", "LA", "IL"), PAPER_STAGES.get(count, (None,) * 4)))
                for stage, value in (gp | solver.seconds).items():
                    rows.append(_row(f"{label}: {stage}", 1000 * value, "ms", paper.get(stage)))
                rows.append(_row(f"{label}: all stages beside shadow rays", own, "CPU s", seconds))
    return rows


def guided_rows(name: str, scene: Scene, topology: Topology, vpls: int) -> list[dict]:
    """Gate-guided visibility beside shadow rays of all VPLs: rays saved, relMSE, time."""
    with _compared(scene, vpls) as (lit, truth, seconds):
        solver, irradiance, own = _gates(lit, topology, "guided")
    share = solver.saved / max(1, solver.saved + solver.rays)
    relmse = float(np.mean((irradiance - truth) ** 2 / (truth**2 + 0.01 * truth.mean() ** 2)))
    return [
        _row(f"{name}, guided: share of the shadow rays saved", share, "1"),
        _row(f"{name}, guided: relMSE against all rays", relmse, "1"),
        _row(f"{name}, guided: bias against all rays", float(irradiance.mean() / truth.mean() - 1), "1"),
        _row(f"{name}, guided: seconds beside all rays", own, "CPU s", seconds),
    ]


def house_rows(rooms: tuple[int, int], size: tuple[int, int]) -> list[dict]:
    """A house seen from one of its rooms, beside that room alone; the topology is known before."""
    seconds = {}
    settings = RenderSettings(method="visibility-gates", vpls=1024, pixel_samples=1, voxels=VOXELS)
    for label, (columns, rows) in (("room", (1, 1)), ("house", rooms)):
        scene = extract(house(columns, rows), camera=None, size=size, frame=None)
        known = Topologies()
        runs = [render(scene, settings, topologies=known).stats for _ in range(4)][1:]
        seconds[label] = sorted(run["seconds_total"] for run in runs)[1]
    return [_row(f"house of {rooms[0] * rooms[1]} rooms: seconds beside one of them alone", seconds["house"], "s", seconds["room"])]


def _row(case: str, value: float, unit: str, peer: float | None = None) -> dict:
    row = {"suite": "topology", "case": case, "value": value, "unit": unit}
    return row if peer is None else row | {"peer_value": peer, "ratio": value / peer if value else 0.0}
