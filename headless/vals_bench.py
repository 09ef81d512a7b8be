"""Virtual area lights beside instant radiosity of the same VPLs: convergence, speed stage by stage, coherence in time, soft shadows.

What the paper shows in its Figs. 8 and 10 and its Tables 1 and 2 (Dong et al. 2009).  Both contestants give the light of the VPLs alone,
under one clamp.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..core.clustering.area_lights import AreaLights, cluster_area_lights
from ..core.lamps import build_emitters, direct_irradiance, world_tables
from ..core.lamps.tables import CASTS_SHADOW
from ..core.methods.area_shadows import direct_by_soft_maps
from ..core.methods.instant_radiosity import InstantRadiosity, clamp_of
from ..core.methods.virtual_area_lights import VirtualAreaLights
from ..core.metrics import relmse
from ..core.particles import Vpls
from ..core.picture import splat
from ..core.rays import RayScene
from ..core.scene import Scene
from ..core.transport import Transport, transport
from ..core.view.points import ShadingPoints
from ..core.view.primary import view
from ..core.vpl_pool import vpl_sequence
from .fuzzy_bench import LitView, brute_force, lit_view
from .sources import extract, find_scene, open_source

SCENES = (
    ("Cornell box", "cornell"),
    ("living room", "living-room-greywhite/scene.blend"),
    ("Sponza", "sponza-crytek/scene.blend"),
    ("atrium", "atrium"),
)
SIZE = (800, 800)
CONVERGENCE_SIZE = (256, 256)
VPLS = 1024
VALS = 30
CONVERGENCE = (2, 5, 10, 30, 100, 300)
REPEATS = 3
FRAMES = 60
FRAME_SIZE = (40, 40)
TRUTH = 16384  # VPLs of the true change
LAMPS = (0.5, 1.0, 3.0)  # times the size of the Cornell box's lamp
# Of the paper's Table 2, in ms.
STAGES = {"view": 0.4, "VPLs": 0.1, "clustering": 0.5, "shadow maps": 4.2, "indirect light": 35.0, "blur": 10.7}


def vals_rows(
    scenes=SCENES, size=SIZE, convergence_size=CONVERGENCE_SIZE, vpls=VPLS, vals=CONVERGENCE, repeats=REPEATS, frames=FRAMES, truth=TRUTH
) -> list[dict]:
    """Rows of the suite `vals`; scenes that are not there are left out."""
    rows = []
    for name, source in scenes:
        found = find_scene(source)
        if found is None:
            continue
        scene = open_source(found)
        with lit_view(extract(scene, camera=None, size=convergence_size, frame=None), vpls) as lit:
            rows += _convergence(name, lit, vals)
        rows += _speed(name, extract(scene, camera=None, size=size, frame=None), vpls, repeats)
    if frames:
        rows += _coherence(extract(open_source("cornell"), camera=None, size=FRAME_SIZE, frame=None), vpls, frames, truth)
    return rows + _soft_shadows(extract(open_source("cornell"), camera=None, size=convergence_size, frame=None))


def _convergence(name: str, lit: LitView, vals) -> list[dict]:
    """Error against shadow rays for rising numbers of VALs, with and without interleaving."""
    exact = InstantRadiosity(compensation=0)
    exact.prepare(lit.tables, lit.vpls, lit.points)
    reference = _picture(lit, exact.irradiance(lit.points))
    rows = []
    for interleave in (1, 8):
        for count in vals:
            solver = VirtualAreaLights(vals=count, interleave=interleave, width=lit.shape[1], compensation=0)
            solver.prepare(lit.tables, lit.vpls, lit.points)
            found = _picture(lit, solver.irradiance(lit.points))
            rays = {"rays": solver.rays, "peer_rays": exact.rays}
            rows.append(
                _row(f"{name}: relMSE of {count} VALs, interleaved {interleave}x{interleave}", relmse(found, reference), "1") | rays
            )
    return rows


def _picture(lit: LitView, irradiance: np.ndarray) -> np.ndarray:
    """Radiance (H, W, 3) that the points send to the viewer."""
    return splat(lit.points, lit.points.albedo * irradiance * np.float32(1 / np.pi), lit.shape)


def _speed(name: str, scene: Scene, vpls: int, repeats: int) -> list[dict]:
    """CPU time of each stage, and of all that comes after the VPLs against the same by shadow rays."""
    stages: dict[str, list[float]] = {}
    with lit_view(scene, vpls) as lit:
        peer = brute_force(lit)
        for _ in range(repeats + 1):
            begin = time.process_time()
            view(scene, lit.tables.rays, world_tables(scene.world), 1, 0)
            seen = time.process_time()
            vpl_sequence(lit.tables, lit.points, vpls, 1, 0)
            solver = VirtualAreaLights(vals=VALS, width=lit.shape[1], compensation=0)
            solver.seconds = {"view": seen - begin, "VPLs": time.process_time() - seen}
            cpu = time.process_time()
            solver.prepare(lit.tables, lit.vpls, lit.points)
            solver.irradiance(lit.points)
            stages.setdefault("cpu", []).append(time.process_time() - cpu)
            for stage, seconds in solver.seconds.items():
                stages.setdefault(stage, []).append(seconds)
    median = {stage: statistics.median(seconds[1:]) for stage, seconds in stages.items()}
    rows = [_row(f"{name}: {stage}", 1000 * median[stage], "CPU ms", paper) for stage, paper in STAGES.items()]
    return [
        *rows,
        _row(f"{name}: VALs against shadow rays, all of the light", median["cpu"], "CPU s", peer.seconds, peer.seconds / median["cpu"]),
    ]


class RandomStarts(VirtualAreaLights):
    """k-means that starts anew at random VPLs in every frame."""

    def group(self, vpls: Vpls) -> AreaLights:
        """The VALs of these VPLs."""
        rng = np.random.default_rng(vpls.position.view(np.uint32).sum(dtype=np.uint64))
        return cluster_area_lights(vpls.position, vpls.surface_normal, rng.permutation(len(vpls.bounce))[: self.vals], self.extent)


def moving(scene: Scene, frames: int) -> Iterator[Scene]:
    """Frames of a Cornell box whose lamp walks across the ceiling while its blocks bulge."""
    geometry = scene.geometry
    room = max(
        range(len(geometry.object_names)),
        key=lambda o: np.ptp(geometry.vertices[geometry.triangles[geometry.object == o]].reshape(-1, 3), axis=0).max(),
    )
    block = np.unique(geometry.triangles[geometry.object != room])
    for frame in range(frames):
        phase = frame / max(frames - 1, 1)
        vertices = geometry.vertices.copy()
        height = vertices[block, 2] - vertices[:, 2].min()
        vertices[block, 0] += np.float32(0.1 * np.sin(2 * np.pi * phase)) * height
        lamps = replace(
            scene.lamps, position=scene.lamps.position + np.array([0.25 * (phase - 0.5), 0.1 * np.sin(np.pi * phase), 0], np.float32)
        )
        yield replace(scene, geometry=replace(geometry, vertices=vertices), lamps=lamps)


def _coherence(scene: Scene, vpls: int, frames: int, truth: int) -> list[dict]:
    """Mean change of the irradiance from frame to frame that is not the true one, nor the VPLs' own: the paper's start against random ones."""
    pictures: dict[str, list[np.ndarray]] = {"truth": [], "same": [], "fixed": [], "random": []}
    for frame in moving(scene, frames):
        geometry = frame.geometry
        with RayScene(geometry.vertices, geometry.triangles, geometry.object_visibility[geometry.object]) as rays:
            tables = transport(geometry, frame.materials.tables, rays.tables, build_emitters(frame))
            seen = view(frame, rays.tables, world_tables(frame.world), 1, 0)
            few, many = (vpl_sequence(tables, seen.points, n, 1, 0)[0] for n in (vpls, truth))
            solvers = {
                "truth": (InstantRadiosity(compensation=0), many),
                "same": (InstantRadiosity(compensation=0), few),
                "fixed": (VirtualAreaLights(vals=VALS, compensation=0), few),
                "random": (RandomStarts(vals=VALS, compensation=0), few),
            }
            clamp = np.float32(clamp_of(few, seen.points))
            for name, (solver, lights) in solvers.items():
                solver.prepare(tables, lights, seen.points)
                solver.g_max = clamp
                pictures[name].append(splat(seen.points, solver.irradiance(seen.points), seen.shape).mean(axis=2))
    change = {name: np.diff(np.array(found), axis=0) for name, found in pictures.items()}
    scale = float(np.mean(pictures["truth"]))
    rows = []
    for base, what in (("truth", f"{truth} VPLs"), ("same", "the same VPLs with shadow rays")):
        fixed, random = (float(np.abs(change[name] - change[base]).mean()) / scale for name in ("fixed", "random"))
        case = f"Cornell box, {frames} frames: change that is not that of {what}, starts at VPL k N / M against random ones"
        rows.append(_row(case, fixed, "1", random, random / fixed))
    return rows


def _soft_shadows(scene: Scene) -> list[dict]:
    """Direct light of an area lamp by soft shadow maps against shadow rays."""
    rows = []
    for factor in LAMPS:
        lamps = replace(scene.lamps, size=scene.lamps.size * np.float32(factor))
        lit, shape = replace(scene, lamps=lamps), scene.lamps.size.max() * factor
        geometry = lit.geometry
        with RayScene(geometry.vertices, geometry.triangles, geometry.object_visibility[geometry.object]) as rays:
            tables = transport(geometry, lit.materials.tables, rays.tables, build_emitters(lit))
            points = view(lit, rays.tables, world_tables(lit.world), 1, 0).points
            rows.append(
                _row(f"area lamp of {shape:.2f} m: RMSE of its light by maps, over the mean unshadowed", _shadow_error(tables, points), "1")
            )
    return rows


def _shadow_error(tables: Transport, points: ShadingPoints) -> float:
    """RMSE over the points that the lamp can face, in units of their mean unshadowed irradiance."""
    exact, _ = direct_irradiance(tables, points, 256, 0)
    mapped, _ = direct_by_soft_maps(tables, points)
    open_, _ = direct_irradiance(
        tables._replace(emitters=tables.emitters._replace(flags=tables.emitters.flags & ~CASTS_SHADOW)), points, 64, 0
    )
    facing = open_.mean(axis=1) > 0
    return float(np.sqrt(np.mean((mapped - exact)[facing] ** 2)) / open_[facing].mean())


def _row(case: str, value: float, unit: str, peer: float | None = None, ratio: float | None = None) -> dict:
    row = {"suite": "vals", "case": case, "value": float(value), "unit": unit}
    return row if peer is None else row | {"peer_value": float(peer), "ratio": float(peer / value if ratio is None else ratio)}
