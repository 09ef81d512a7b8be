"""One render, from the scene's arrays to its layers: the stages in the order in which light passes them."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from .errors import SceneError
from .inspection import foresee
from .jit import CompileTimer
from .lamps import build_emitters, direct_irradiance, world_tables
from .layers import Layers
from .methods.instant_radiosity import InstantRadiosity, clamp_of
from .rays import RayScene
from .scene import TRANSPARENT, Scene, Skipped
from .settings import RenderSettings
from .threads import Cancelled, thread_count
from .transport import Transport, transport
from .view.points import ShadingPoints
from .view.primary import View, view
from .vpl_pool import vpl_pool

# progress(stage, fraction) -> True to go on, False to cancel.
StageProgress = Callable[[str, float], bool]


@dataclass
class RenderResult:
    """Layers of one picture and the statistics of `--stats` (design.md, section 3)."""

    layers: Layers
    stats: dict


@dataclass
class _Run:
    """Clock, counters and remarks of one render."""

    progress: StageProgress | None
    seconds: dict = field(default_factory=dict)
    rays: dict = field(default_factory=lambda: {"primary": 0, "light": 0, "shadow": 0})
    pairs: int = 0
    skipped: list[Skipped] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str):
        """Times a stage, its compilation apart, and hands out its progress function."""
        if self.progress is not None and not self.progress(name, 0.0):
            raise Cancelled
        begin = time.perf_counter()
        with CompileTimer() as compiling:
            yield None if self.progress is None else (lambda fraction: self.progress(name, fraction))
        jit = compiling.seconds
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin - jit
        self.seconds["jit"] = self.seconds.get("jit", 0.0) + jit


def render(
    scene: Scene, settings: RenderSettings, progress: StageProgress | None = None, *, extraction_seconds: float = 0.0
) -> RenderResult:
    """Compute the layers that `settings` ask for.

    Raises:
        SceneError: the scene cannot be rendered with these settings.
        core.threads.Cancelled: `progress` returned False.
    """
    method = _method(settings)
    run = _Run(progress)
    run.seconds["extraction"] = extraction_seconds
    begin = time.perf_counter()
    threads = thread_count(settings.threads)
    with run.stage("rays"):
        geometry = scene.geometry
        transparent = (scene.materials.tables.flags[geometry.material] & TRANSPARENT) != 0
        ray_scene = RayScene(geometry.vertices, geometry.triangles, geometry.object_visibility[geometry.object], transparent)
    with ray_scene:
        with run.stage("emitters"):
            emitters = build_emitters(scene)
            skipped, warnings = foresee(scene, emitters)
            run.skipped, run.warnings = [*scene.skipped, *skipped], [*scene.warnings, *warnings]
            tables = transport(geometry, scene.materials.tables, ray_scene.tables, emitters)
        with run.stage("view") as tick:
            seen = view(scene, ray_scene.tables, world_tables(scene.world), settings.pixel_samples, settings.seed, threads, tick)
            run.rays["primary"] = seen.rays
        points = seen.points
        with run.stage("direct") as tick:
            direct, rays = direct_irradiance(tables, points, settings.direct_samples, settings.seed, threads, tick)
            run.rays["shadow"] += rays
        indirect, vpls = _indirect(run, tables, points, settings, method, threads)
    layers = compose(seen, direct, indirect, scene)
    run.seconds["jit"] = run.seconds.get("jit", 0.0)
    stats = {
        "method": method,
        "size": [seen.shape[1], seen.shape[0]],
        "vpls": vpls,
        "bounces": settings.bounces,
        "threads": threads,
        "seconds": run.seconds,
        "seconds_total": extraction_seconds + time.perf_counter() - begin - run.seconds["jit"],
        "rays": run.rays,
        "pairs_shaded": run.pairs,
        "skipped": [vars(s) for s in run.skipped],
        "warnings": run.warnings,
    }
    return RenderResult(layers, stats)


def _method(settings: RenderSettings) -> str:
    """The method that runs: `auto` takes the most accurate one there is."""
    if settings.method in ("auto", "instant-radiosity"):
        return "instant-radiosity"
    raise SceneError(f"method {settings.method!r} is not available; use instant-radiosity or auto")


def _indirect(
    run: _Run, tables: Transport, points: ShadingPoints, settings: RenderSettings, method: str, threads: int
) -> tuple[np.ndarray, int]:
    """Indirect irradiance at the points (N, 3), and the number of VPLs used."""
    nothing = np.zeros((len(points.pixel), 3), np.float32)
    if settings.bounces < 1 or settings.vpls < 1:
        run.skipped.append(Skipped("vpls", "no bounces or no VPLs asked for"))
        return nothing, 0
    if not points.albedo.any():
        run.skipped.append(Skipped("vpls", "every visible albedo is black"))
        return nothing, 0
    with run.stage("vpls") as tick:
        vpls, counts = vpl_pool(tables, points, settings.vpls, settings.bounces, clamp_of, settings.seed, threads, tick)
        run.rays["light"] += counts["light"]
        run.rays["shadow"] += counts["shadow"]
        if counts["useless"]:
            run.skipped.append(Skipped("vpls", f"{counts['useless']} of {counts['traced']} VPLs lie behind every visible point"))
    if len(vpls.bounce) == 0:
        run.skipped.append(Skipped("vpls", "no lamp's light reaches a surface"))
        return nothing, 0
    with run.stage("indirect") as tick:
        compensation = settings.gather if settings.compensation and settings.visibility == "rays" else 0
        solver = InstantRadiosity(
            visibility=settings.visibility, compensation=compensation, bounces=settings.bounces, seed=settings.seed, threads=threads
        )
        solver.prepare(tables, vpls, points)
        irradiance = solver.irradiance(points, tick)
        run.rays["shadow"] += solver.rays
        run.pairs += solver.pairs
    return irradiance, len(vpls.bounce)


def splat(points: ShadingPoints, irradiance: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Outgoing diffuse radiance of the pixels, (H, W, 3): the sum of albedo * irradiance / pi over their points."""
    radiance = points.albedo * irradiance * np.float32(1 / np.pi)
    n = shape[0] * shape[1]
    out = np.empty((n, 3), np.float32)
    for c in range(3):
        out[:, c] = np.bincount(points.pixel, radiance[:, c], n)
    return out.reshape(*shape, 3)


def compose(seen: View, direct: np.ndarray, indirect: np.ndarray, scene: Scene) -> Layers:
    """The layers of the contract from irradiances at the shading points."""
    shape = seen.shape
    diffuse_direct = splat(seen.points, direct, shape)
    diffuse_indirect = splat(seen.points, indirect, shape)
    glossy_indirect = np.zeros_like(diffuse_indirect)
    total = diffuse_indirect + glossy_indirect
    with np.errstate(divide="ignore", invalid="ignore"):
        irradiance = np.where(seen.albedo > 0, np.float32(np.pi) * diffuse_indirect / seen.albedo, np.float32(0))
    position = np.where(seen.depth[..., None] < 1e9, seen.position + scene.origin.astype(np.float32), np.float32(0))
    camera = scene.camera
    return Layers(
        {
            "Combined": diffuse_direct + total + seen.emission,
            "Direct": diffuse_direct,
            "Indirect": total,
            "DiffuseIndirect": diffuse_indirect,
            "GlossyIndirect": glossy_indirect,
            "Irradiance": irradiance,
            "Albedo": seen.albedo,
            "Emission": seen.emission,
            "Normal": seen.normal,
            "Position": position,
            "Depth": seen.depth,
        },
        view_layer=scene.view_layer,
        offset=(camera.border[0], camera.border[1]),
        full_size=(camera.width, camera.height),
    )
