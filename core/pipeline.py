"""One render, from the scene's arrays to its layers: the stages in the order in which light passes them."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from .denoise import Denoiser, mean_factor
from .errors import SceneError
from .inspection import foresee
from .jit import CompileTimer
from .lamps import build_emitters, direct_irradiance, direct_light, world_tables
from .layers import Layers
from .methods.fuzzy_clustering import FuzzyClustering
from .methods.glossy import has_lobes, reflect
from .methods.importance_sampling import ImportanceSampling
from .methods.instant_radiosity import InstantRadiosity, clamp_of
from .methods.shadow_mapped import ShadowMappedRadiosity, direct_by_maps, point_lamps
from .particles import Vpls
from .rays import RayScene
from .scene import POINT, SPOT, TRANSPARENT, Scene, Skipped
from .settings import RenderSettings
from .threads import Cancelled, thread_count
from .transport import Transport, transport
from .view.points import ShadingPoints
from .view.primary import View, view
from .vpl_pool import vpl_pool

# progress(stage, fraction) -> True to go on, False to cancel.
StageProgress = Callable[[str, float], bool]

AVAILABLE = ("instant-radiosity", "fuzzy-clustering", "importance-sampling")
SINGLE_LIGHTS = 4  # of the strongest VPLs, each a debug layer


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
    clusters: FuzzyClustering | None = None  # whose clusters the debug layers show

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
    settings = settings.with_defaults()
    method = _method(settings)
    run = _Run(progress)
    run.seconds["extraction"] = extraction_seconds
    if settings.time_budget is not None or settings.target_error is not None:
        run.warnings.append(f"{method} has no error estimate: the time budget and the target error are not used; set --vpls instead")
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
        sampler = _sampler(run, tables, points, settings, threads)
        with run.stage("direct") as tick:
            direct, highlights = _direct(run, scene, tables, points, settings, threads, tick)
        shown, reflected = _glossy(run, tables, points, settings, threads, sampler)
        indirect, vpls = _indirect(run, tables, points, settings, threads, sampler)
        debug = single_lights(tables, vpls, points, seen.shape, threads) if settings.debug_layers else {}
        if settings.debug_layers and run.clusters is not None:
            debug |= run.clusters.debug_layers(points, seen.shape)
    layers = compose(seen, direct, indirect, highlights + shown, reflected, scene)
    if settings.denoise:
        with run.stage("denoise"):
            denoise(layers, *denoising_guides(seen), threads, run.warnings)
    if settings.debug_layers:
        layers.update(debug)
    if settings.layers is not None:
        for name in [name for name in layers if name not in settings.layers]:
            del layers[name]
            run.skipped.append(Skipped("layers", f"{name} was not asked for"))
    run.seconds["jit"] = run.seconds.get("jit", 0.0)
    stats = {
        "method": method,
        "size": [seen.shape[1], seen.shape[0]],
        "vpls": len(vpls.bounce),
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
    """The method that runs."""
    if settings.method not in AVAILABLE:
        raise SceneError(f"method {settings.method!r} is not available; use {', '.join(AVAILABLE)} or auto")
    return settings.method


def _direct(
    run: _Run, scene: Scene, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int, tick
) -> tuple[np.ndarray, np.ndarray]:
    """Direct irradiance at the points (N, 3), and the radiance that their lobes reflect of it (N, 3) by shadow rays."""
    by_maps = highlights = np.zeros((len(points.pixel), 3), np.float32)
    lobes = has_lobes(points)
    samples, seed = settings.direct_samples, settings.seed
    if lobes:
        by_rays, highlights, rays = direct_light(tables, points, samples, seed, threads, tick, reflections=settings.reflections)
        run.rays["shadow"] += rays
    if settings.visibility == "shadow-maps" and len(point_lamps(tables.emitters)):
        by_maps, rays = direct_by_maps(tables, points, seed=seed, threads=threads)
        run.rays["shadow"] += rays
        others = scene.lamps.take(~np.isin(scene.lamps.kind, (POINT, SPOT)))
        tables, lobes = tables._replace(emitters=build_emitters(replace(scene, lamps=others))), False
    if not lobes:
        by_rays, rays = direct_irradiance(tables, points, samples, seed, threads, tick)
        run.rays["shadow"] += rays
    return by_maps + by_rays, highlights


def _sampler(run: _Run, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int) -> ImportanceSampling | None:
    """The accurate method with its cache of light filled, which reflections use, too."""
    if settings.method != "importance-sampling" or settings.bounces < 1 or not tables.emitters.flux.any():
        return None
    if not points.albedo.any() and not has_lobes(points):
        return None
    with run.stage("cache") as tick:
        sampler = ImportanceSampling(
            samples=settings.samples, gather=settings.gather, bounces=settings.bounces, seed=settings.seed, threads=threads
        )
        run.rays["light"] += sampler.cache_light(tables, points, tick)
    return sampler


def _glossy(
    run: _Run, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int, sampler: ImportanceSampling | None
) -> tuple[np.ndarray, np.ndarray]:
    """Direct and indirect radiance (N, 3) that rays drawn from the points' lobes find."""
    nothing = np.zeros((len(points.pixel), 3), np.float32)
    if not has_lobes(points) or settings.reflections < 1:
        run.skipped.append(Skipped("glossy", "no visible surface is glossy" if settings.reflections > 0 else "no reflections asked for"))
        return nothing, nothing
    with run.stage("glossy") as tick:
        shown, reflected, rays = reflect(
            tables, points, settings.direct_samples, settings.reflections, settings.bounces, settings.seed, threads, tick,
            cache=sampler.cache if sampler else None, near=sampler.near if sampler else np.inf,
        )  # fmt: skip
        run.rays["reflected"] = rays
    return shown, reflected


def _indirect(
    run: _Run, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int, sampler: ImportanceSampling | None
) -> tuple[np.ndarray, Vpls]:
    """Indirect irradiance at the points (N, 3), and the VPLs that it came from."""
    nothing = np.zeros((len(points.pixel), 3), np.float32)
    if settings.bounces < 1 or settings.vpls < 1:
        run.skipped.append(Skipped("vpls", "no bounces or no VPLs asked for"))
        return nothing, Vpls.allocate(0)
    if not points.albedo.any():
        run.skipped.append(Skipped("vpls", "every visible albedo is black"))
        return nothing, Vpls.allocate(0)
    with run.stage("vpls") as tick:
        if sampler:
            vpls, counts = sampler.prepare(tables, points, settings.vpls, tick)
        else:
            vpls, counts = vpl_pool(tables, points, settings.vpls, settings.bounces, clamp_of, settings.seed, threads, tick)
        run.rays["light"] += counts["light"]
        run.rays["shadow"] += counts["shadow"]
        if counts["useless"]:
            run.skipped.append(Skipped("vpls", f"{counts['useless']} of {counts['traced']} VPLs lie behind every visible point"))
    if len(vpls.bounce) == 0 and sampler is None:
        run.skipped.append(Skipped("vpls", "no lamp's light reaches a surface"))
        return nothing, Vpls.allocate(0)
    with run.stage("indirect") as tick:
        if sampler:
            irradiance = sampler.irradiance(points, tick)
            run.rays["shadow"] += sampler.rays
            run.pairs += sampler.pairs
            return irradiance, vpls
        if settings.method == "fuzzy-clustering":
            solver = run.clusters = FuzzyClustering(
                vpl_clusters=settings.vpl_clusters,
                point_clusters=settings.point_clusters,
                fuzziness=settings.fuzziness,
                weighting=settings.weighting,
                shade_with=settings.shade_with,
                compensation=settings.gather if settings.compensation else 0,
                bounces=settings.bounces,
                seed=settings.seed,
                threads=threads,
            )
        elif settings.visibility == "shadow-maps":
            solver = ShadowMappedRadiosity(seed=settings.seed, threads=threads)
        else:
            compensation = settings.gather if settings.compensation and settings.visibility == "rays" else 0
            solver = InstantRadiosity(
                visibility=settings.visibility, compensation=compensation, bounces=settings.bounces, seed=settings.seed, threads=threads
            )
        solver.prepare(tables, vpls, points)
        irradiance = solver.irradiance(points, tick)
        run.rays["shadow"] += solver.rays
        run.pairs += solver.pairs
    return irradiance, vpls


def splat(points: ShadingPoints, irradiance: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Outgoing diffuse radiance of the pixels, (H, W, 3): the sum of albedo * irradiance / pi over their points."""
    return splat_radiance(points, points.albedo * irradiance * np.float32(1 / np.pi), shape)


def splat_radiance(points: ShadingPoints, radiance: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Sum of the radiance (N, 3) of each pixel's points, (H, W, 3)."""
    n = shape[0] * shape[1]
    out = np.empty((n, 3), np.float32)
    for c in range(3):
        out[:, c] = np.bincount(points.pixel, radiance[:, c], n)
    return out.reshape(*shape, 3)


def compose(
    seen: View, direct: np.ndarray, indirect: np.ndarray, glossy_direct: np.ndarray, glossy_indirect: np.ndarray, scene: Scene
) -> Layers:
    """The layers of the contract from irradiances and glossy radiances (N, 3) at the shading points.

    Glass is a bounce, as in Cycles: all light of the surfaces behind it is indirect, and specular, whatever it is to them.
    What shines behind it is direct light after one surface of glass, indirect light after more.
    """
    shape, points = seen.shape, seen.points
    diffuse = points.albedo * np.float32(1 / np.pi)
    first, later = diffuse * direct + glossy_direct, diffuse * indirect
    behind = points.behind_glass[:, None] > 0
    all_direct = splat_radiance(points, first * ~behind, shape) + seen.emission_behind_one
    diffuse_indirect = splat_radiance(points, later * ~behind, shape)
    glossy_indirect = splat_radiance(points, glossy_indirect + (first + later) * behind, shape) + seen.emission_behind_more
    total = diffuse_indirect + glossy_indirect
    with np.errstate(divide="ignore", invalid="ignore"):
        irradiance = np.where(seen.albedo > 0, np.float32(np.pi) * diffuse_indirect / seen.albedo, np.float32(0))
    position = np.where(seen.depth[..., None] < 1e9, seen.position + scene.origin.astype(np.float32), np.float32(0))
    camera = scene.camera
    return Layers(
        {
            "Combined": all_direct + total + seen.emission,
            "Direct": all_direct,
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


def denoising_guides(seen: View) -> tuple[np.ndarray, np.ndarray]:
    """Albedo and normal (H, W, 3) that tell the denoiser where edges are: where there is glass, those of what it shows."""
    behind = seen.points.take(seen.points.behind_glass > 0)
    if len(behind.pixel) == 0:
        return seen.albedo, seen.normal
    through = splat_radiance(behind, behind.albedo, seen.shape)
    shown = behind.albedo.mean(axis=1, keepdims=True)
    normal = seen.albedo.mean(axis=2, keepdims=True) * seen.normal + splat_radiance(behind, shown * behind.ns, seen.shape)
    length = np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), np.float32(1e-9))
    return seen.albedo + through, np.where(through.any(axis=2, keepdims=True), normal / length, seen.normal)


def denoise(layers: Layers, albedo: np.ndarray, normal: np.ndarray, threads: int, warnings: list[str]) -> None:
    """Denoise the light in place; the diffuse indirect light free of albedo, so that textures and edges stay as sharp as they were.

    albedo, normal: of `denoising_guides`.
    """
    denoiser = Denoiser()
    if denoiser.warning:
        warnings.append(denoiser.warning)

    def cleaned(image: np.ndarray, **options) -> np.ndarray:
        return denoiser.denoise(image, albedo, normal, position=layers["Position"], threads=threads, **options)

    irradiance = np.where(layers["Albedo"] > 0, cleaned(layers["Irradiance"]), np.float32(0))
    diffuse = irradiance * layers["Albedo"] * np.float32(1 / np.pi)
    # What counts is the mean of the picture, not of the irradiance.
    factor = mean_factor(layers["DiffuseIndirect"], diffuse)
    layers["Irradiance"], layers["DiffuseIndirect"] = factor * irradiance, factor * diffuse
    for name in ("GlossyIndirect", "Direct"):
        if layers[name].any():
            layers[name] = cleaned(layers[name], preserve_mean=True)
    denoiser.close()
    layers["Indirect"] = layers["DiffuseIndirect"] + layers["GlossyIndirect"]
    layers["Combined"] = layers["Direct"] + layers["Indirect"] + layers["Emission"]


def single_lights(tables: Transport, vpls: Vpls, points: ShadingPoints, shape: tuple[int, int], threads: int) -> dict[str, np.ndarray]:
    """Debug layers: the light of the strongest VPLs, one by one."""
    found = {}
    for rank, j in enumerate(np.argsort(-vpls.flux.mean(axis=1), kind="stable")[:SINGLE_LIGHTS]):
        solver = InstantRadiosity(compensation=0, threads=threads)
        solver.prepare(tables, vpls.take([j]), points)
        found[f"VPL{rank}"] = splat(points, solver.irradiance(points), shape)
    return found
