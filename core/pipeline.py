"""One render, from the scene's arrays to its layers: the stages in the order in which light passes them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from .denoise import Denoiser
from .errors import SceneError
from .inspection import foresee
from .jit import CompileTimer
from .lamps import Emitters, LightGroups, build_emitters, direct_irradiance, direct_light, world_tables
from .layers import Layers
from .memory import check_memory
from .methods.area_shadows import area_lamps, direct_by_soft_maps
from .methods.fuzzy_clustering import FuzzyClustering
from .methods.glossy import Reflections, has_lobes, reflect
from .methods.importance_sampling import ImportanceSampling
from .methods.instant_radiosity import InstantRadiosity, clamp_of
from .methods.shadow_mapped import ShadowMappedRadiosity, direct_by_maps, point_lamps
from .methods.virtual_area_lights import VirtualAreaLights
from .methods.visibility_gates import VisibilityGates
from .particles import Vpls, trace_particles
from .passes import Passes
from .picture import Picture, nearest_triangles, splat
from .planning.machine import cached_machine
from .planning.planner import Planner
from .reuse import Sequence
from .reuse.sequence import ray_scene
from .scene import AREA, POINT, SPOT, Camera, Scene, Skipped
from .settings import RenderSettings
from .soundness import sound
from .threads import Cancelled, thread_count
from .topology import IN_MEMORY, Topologies, Topology, reachable_emitters, reachable_vpls, rooms_seen, without_emitters
from .transport import Transport, transport
from .view.points import ShadingPoints
from .view.primary import View, view
from .vpl_pool import vpl_pool, vpl_sequence

# progress(stage, fraction) -> True to go on, False to cancel.
StageProgress = Callable[[str, float], bool]

AVAILABLE = ("instant-radiosity", "fuzzy-clustering", "virtual-area-lights", "visibility-gates", "importance-sampling")
TURN = 32452843  # between the seeds of a sequence's turns
SINGLE_LIGHTS = 4  # of the strongest VPLs, each a debug layer
LOADED: set[str] = set()  # methods whose kernels this process has in memory, which the first pass of one pays for


@dataclass
class RenderResult:
    """Layers of one picture and the statistics of `--stats` (design.md, section 3)."""

    layers: Layers
    stats: dict


@dataclass
class Run:
    """Clock, counters and remarks of one render."""

    progress: StageProgress | None
    seconds: dict = field(default_factory=dict)
    rays: dict = field(default_factory=lambda: {"primary": 0, "light": 0, "shadow": 0})
    pairs: int = 0
    skipped: list[Skipped] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    vpls: int = 0
    clusters: FuzzyClustering | VirtualAreaLights | VisibilityGates | None = None  # whose clusters the debug layers show
    topology: Topology | None = None
    groups: LightGroups | None = None  # to be told apart, None for none
    planner: Planner | None = None
    debug: dict[str, np.ndarray] = field(default_factory=dict)
    sequence: Sequence | None = None
    turn: int = 0  # which part of the random sequence of the shading points' rays

    def skip(self, stage: str, why: str) -> None:
        """Note what was left out, once."""
        if Skipped(stage, why) not in self.skipped:
            self.skipped.append(Skipped(stage, why))

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
    scene: Scene,
    settings: RenderSettings,
    progress: StageProgress | None = None,
    *,
    extraction_seconds: float = 0.0,
    topologies: Topologies = IN_MEMORY,
    sequence: Sequence | None = None,
) -> RenderResult:
    """Compute the layers that `settings` ask for, in as many passes as its time budget or target error need.

    topologies: where the method that needs one finds the scene's.
    sequence: what the frames of a sequence share; `scene` is then as `sequence.begin` gave it.

    Raises:
        SceneError: the scene cannot be rendered with these settings.
        core.threads.Cancelled: `progress` returned False.
    """
    automatic, settings = settings.method == "auto", settings.with_defaults()
    begin = time.perf_counter()
    check_memory(scene, settings)
    scene = sound(scene) if sequence is None else scene
    denoiser = None
    if settings.denoise:
        denoiser = Denoiser() if sequence is None else sequence.denoiser
    try:
        result = _render(scene, settings, denoiser, progress, extraction_seconds, begin, topologies, sequence)
    finally:  # a cancelled render must not leave the library's threads behind
        if denoiser and sequence is None:
            denoiser.close()
    if not automatic:
        del result.stats["auto"]
    return result


def remember(
    scene: Scene,
    settings: RenderSettings,
    sequence: Sequence,
    progress: StageProgress | None = None,
    *,
    exposed: bool = False,
    topologies: Topologies = IN_MEMORY,
) -> None:
    """Compute of a frame what later ones need of it, and no layers; arguments and errors as `render`.

    exposed: it is a sub-frame of the frame that `render` will end.
    """
    settings = settings.with_defaults()
    run = Run(progress, sequence=sequence, turn=sequence.turn)
    threads = thread_count(settings.threads)
    begin = time.perf_counter()
    picture = _passes(run, scene, settings, threads, None, topologies, lambda: time.perf_counter() - begin).picture
    if exposed:
        sequence.expose(picture, threads)
    else:
        sequence.add(picture)


def _render(
    scene: Scene,
    settings: RenderSettings,
    denoiser: Denoiser | None,
    progress: StageProgress | None,
    extraction_seconds: float,
    begin: float,
    topologies: Topologies,
    sequence: Sequence | None,
) -> RenderResult:
    """The same with nothing left open in `settings`, and the denoiser that they want; begin: when the clock started."""
    method = method_of(settings)
    run = Run(progress, sequence=sequence, turn=sequence.turn if sequence else 0)
    run.seconds["extraction"] = extraction_seconds
    threads = thread_count(settings.threads)

    def elapsed() -> float:
        return extraction_seconds + time.perf_counter() - begin - run.seconds.get("jit", 0.0) - run.seconds.get("calibration", 0.0)

    if denoiser and denoiser.warning:
        run.warnings.append(denoiser.warning)
    passes = _passes(run, scene, settings, threads, denoiser, topologies, elapsed)
    picture = passes.picture
    if sequence:
        with run.stage("history"):
            picture = sequence.developed(picture, threads)
    if denoiser:
        with run.stage("denoise") as denoiser.progress:
            picture = picture.denoised(denoiser, threads, direct=settings.wants("Direct", "Combined"))
    if picture.groups and (denoiser or sequence):  # either has changed the whole
        with closing(Denoiser(quality="fast")) as quick, run.stage("groups") as quick.progress:
            picture = picture.shared_out(quick, threads)
    layers = picture.layers(scene)
    layers.update(run.debug)
    if settings.layers is not None:
        for name in [name for name in layers if name.partition("_")[0] not in settings.layers]:
            del layers[name]
            run.skip("layers", f"{name} was not asked for")
    run.seconds["jit"] = run.seconds.get("jit", 0.0)
    stats = {
        "method": method,
        "size": [picture.depth.shape[1], picture.depth.shape[0]],
        "vpls": run.vpls,
        "bounces": settings.bounces,
        "threads": threads,
        "auto": run.planner.stats(),
        "passes": passes.count,
        "error_estimate": passes.estimate,
        "seconds": run.seconds,
        "seconds_total": elapsed(),
        "rays": run.rays,
        "pairs_shaded": run.pairs,
        "skipped": [vars(s) for s in run.skipped],
        "warnings": run.warnings,
    }
    return RenderResult(layers, stats)


def _planner(run: Run, settings: RenderSettings, pixels: int, threads: int) -> Planner:
    """Who decides the passes; what this machine can do is only asked where there is something to be reached."""
    machine = None
    if settings.time_budget is not None:
        begin = time.perf_counter()
        machine, measured = cached_machine(threads)
        if measured:  # once a machine: apart from the render, as compilation is
            run.seconds["calibration"] = time.perf_counter() - begin
    images = 3 if settings.wants("Direct", "Combined") else 2
    if run.groups:  # direct and indirect light of three groups are two images, denoised in half the time
        images += -(-len(run.groups.names) // 3)
    return Planner(settings, pixels, machine, images=images, cold=settings.method not in LOADED)


def _fly(
    run: Run, planner: Planner, scene: Scene, tables: Transport, denoiser: Denoiser | None, threads: int, elapsed: Callable[[], float]
) -> None:
    """The planner's pilot, whose time is a stage of its own, and whose counts are not the render's."""
    trial = Run(run.progress, topology=run.topology, groups=run.groups)

    def work(camera: Camera, settings: RenderSettings) -> Picture:
        return _pass(trial, replace(scene, camera=camera), tables, settings, threads, 1.0)

    def clock() -> float:
        return elapsed() - trial.seconds.get("jit", 0.0)

    begin = clock()
    planner.fly(scene.camera, work, denoiser, clock)
    run.seconds["pilot"] = clock() - begin
    run.seconds["jit"] = run.seconds.get("jit", 0.0) + trial.seconds.get("jit", 0.0)


def _passes(
    run: Run,
    scene: Scene,
    settings: RenderSettings,
    threads: int,
    denoiser: Denoiser | None,
    topologies: Topologies,
    elapsed: Callable[[], float],
) -> Passes:
    """All passes of a picture, and those that stand for the frames before the first one of a sequence."""
    run.groups = _light_groups(run, scene, settings)
    with prepared(run, scene, settings, threads, topologies) as tables:
        planner = run.planner = _planner(run, settings, _pixels(scene.camera), threads)
        _fly(run, planner, scene, tables, denoiser, threads, elapsed)
        passes = Passes(threads)
        quality = planner.first(elapsed())
        while quality is not None:
            start = elapsed()
            passes.add(_pass(run, scene, tables, settings.scaled(quality, passes.count), threads, quality))
            planner.observe(quality, elapsed() - start)
            with run.stage("plan"):
                quality = planner.next(elapsed(), passes, denoiser)
        if run.sequence:
            for turn in run.sequence.first_turns:
                run.turn = turn
                run.sequence.add(_pass(run, scene, tables, settings, threads, 1.0))
    return passes


@contextmanager
def prepared(run: Run, scene: Scene, settings: RenderSettings, threads: int, topologies: Topologies = IN_MEMORY) -> Iterator[Transport]:
    """The tables of a scene, whose rays can be traced inside the block; remarks on it, and its topology, go into `run`."""
    with run.stage("rays"):
        rays = run.sequence.rays(scene) if run.sequence else ray_scene(scene)
    with nullcontext() if run.sequence else rays:
        with run.stage("emitters"):
            emitters = run.sequence.emitters(scene, run.groups) if run.sequence else build_emitters(scene, groups=run.groups)
            if not settings.skipping:
                emitters = one_by_one(emitters)
            skipped, warnings = foresee(scene, emitters)
            run.skipped = [*scene.skipped, *skipped]
            run.warnings += [*scene.warnings, *warnings]
            tables = transport(scene.geometry, scene.materials.tables, rays.tables, emitters)
        if settings.method == "visibility-gates":
            with run.stage("topology"):
                run.topology = topologies.of(scene, settings.voxels, threads)
        yield tables


def light_points(
    run: Run, scene: Scene, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int, *, direct: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Direct (zero unless wanted) and indirect irradiance, (N, 3) W/m^2 each, at points that need not belong to any view.

    points: N of them, in an order in which neighbours lie close together; without glossy lobes.
    """
    first = tables.emitters.no_light(len(points.pixel))
    if run.topology is not None:
        tables = _within_reach(run, tables, points)
    if direct:
        with run.stage("direct") as tick:
            first, _ = _direct(run, scene, tables, points, settings, threads, tick)
    sampler = _sampler(run, tables, points, settings, threads)
    indirect, vpls = _indirect(run, tables, points, None, settings, threads, sampler)
    run.vpls += len(vpls.bounce)
    return first, indirect


def _pixels(camera: Camera) -> int:
    """Of the part that is rendered."""
    x0, y0, x1, y1 = camera.border
    return (x1 - x0) * (y1 - y0)


def _light_groups(run: Run, scene: Scene, settings: RenderSettings) -> LightGroups | None:
    """The light groups whose light gets layers of its own."""
    if scene.light_groups and settings.light_groups:
        if settings.method == "importance-sampling":
            return LightGroups.of(scene)
        run.warnings.append(f"light groups get no layers of their own from {settings.method}: use the automatic method for them")
    return None


def _pass(run: Run, scene: Scene, tables: Transport, settings: RenderSettings, threads: int, weight: float) -> Picture:
    """One picture of the view, its samples, VPLs and caches independent of those of other seeds."""
    with run.stage("view") as tick:

        def look() -> View:
            return view(scene, tables.rays, world_tables(scene.world), settings.pixel_samples, settings.seed, threads, tick, run.groups)

        seen = run.sequence.view(scene, settings, look) if run.sequence else look()
        run.rays["primary"] += seen.rays
    points = seen.points
    if run.topology is not None:
        tables = _within_reach(run, tables, points)
    nothing = tables.emitters.no_light(len(points.pixel))
    behind_glass = bool(points.behind_glass.any())
    sampler = _sampler(run, tables, points, settings, threads)
    direct = highlights = nothing
    mirrored = Reflections(nothing, nothing, 0, nothing[:, :3])
    wants = settings.wants
    if wants("Direct", "Combined") or behind_glass:
        with run.stage("direct") as tick:
            direct, highlights = _direct(run, scene, tables, points, settings, threads, tick)
    if wants("Direct", "Combined", "GlossyIndirect", "Indirect"):
        mirrored = _glossy(run, tables, points, settings, threads, sampler)
    indirect = nothing
    if wants("DiffuseIndirect", "Indirect", "Irradiance", "Combined") or (behind_glass and wants("GlossyIndirect")):
        indirect, vpls = _indirect(run, tables, points, seen.shape[1], settings, threads, sampler)
        run.vpls += len(vpls.bounce)
        if settings.debug_layers and not run.debug:
            run.debug = single_lights(tables, vpls, points, seen.shape, threads)
            if run.clusters is not None:
                run.debug |= run.clusters.debug_layers(points, seen.shape)
    LOADED.add(settings.method)
    picture = Picture.compose(seen, direct, indirect, highlights + mirrored.direct, mirrored.indirect, mirrored.albedo, weight, run.groups)
    return replace(picture, triangle=nearest_triangles(seen)) if run.sequence else picture


def method_of(settings: RenderSettings) -> str:
    """The method that runs."""
    if settings.method not in AVAILABLE:
        raise SceneError(f"method {settings.method!r} is not available; use {', '.join(AVAILABLE)} or auto")
    return settings.method


def _direct(
    run: Run, scene: Scene, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int, tick
) -> tuple[np.ndarray, np.ndarray]:
    """Direct irradiance at the points (N, 3 G), and the radiance that their lobes reflect of it (N, 3 G) by shadow rays."""
    by_maps = highlights = tables.emitters.no_light(len(points.pixel))
    lobes = has_lobes(points)
    samples, seed = settings.direct_samples, settings.seed
    if lobes:
        by_rays, highlights, rays = direct_light(tables, points, samples, seed, threads, tick, reflections=settings.reflections)
        run.rays["shadow"] += rays
    mapped = None
    if settings.visibility == "shadow-maps" and len(point_lamps(tables.emitters)):
        mapped, kinds = direct_by_maps, (POINT, SPOT)
    elif settings.soft_shadows and len(area_lamps(tables.emitters)):
        mapped, kinds = direct_by_soft_maps, (AREA,)
    if mapped is not None:
        by_maps, rays = mapped(tables, points, seed=seed, threads=threads)
        run.rays["shadow"] += rays
        others = scene.lamps.take(~np.isin(scene.lamps.kind, kinds))
        tables, lobes = tables._replace(emitters=build_emitters(replace(scene, lamps=others))), False
    if not lobes:
        by_rays, rays = direct_irradiance(tables, points, samples, seed, threads, tick)
        run.rays["shadow"] += rays
    return by_maps + by_rays, highlights


def _sampler(run: Run, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int) -> ImportanceSampling | None:
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
    run: Run, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int, sampler: ImportanceSampling | None
) -> Reflections:
    """What rays drawn from the points' lobes find."""
    nothing = tables.emitters.no_light(len(points.pixel))
    if not has_lobes(points) or settings.reflections < 1:
        run.skip("glossy", "no visible surface is glossy" if settings.reflections > 0 else "no reflections asked for")
        return Reflections(nothing, nothing, 0, nothing[:, :3])
    with run.stage("glossy") as tick:
        found = reflect(
            tables, points, settings.direct_samples, settings.reflections, settings.bounces, settings.seed + TURN * run.turn, threads, tick,
            cache=sampler.cache if sampler else None, near=sampler.near if sampler else np.inf,
        )  # fmt: skip
        run.rays["reflected"] = run.rays.get("reflected", 0) + found.rays
    return found


def _indirect(
    run: Run,
    tables: Transport,
    points: ShadingPoints,
    width: int | None,
    settings: RenderSettings,
    threads: int,
    sampler: ImportanceSampling | None,
) -> tuple[np.ndarray, Vpls]:
    """Indirect irradiance at the points (N, 3 G), and the VPLs that it came from; width: of the picture in pixels,
    None where the points are not of one."""
    nothing = tables.emitters.no_light(len(points.pixel))
    if settings.bounces < 1 or settings.vpls < 1:
        run.skip("vpls", "no bounces or no VPLs asked for")
        return nothing, Vpls.allocate(0)
    if not points.albedo.any():
        run.skip("vpls", "every visible albedo is black")
        return nothing, Vpls.allocate(0)
    with run.stage("vpls") as tick:
        if sampler:
            particles = run.sequence.particles if run.sequence else trace_particles
            vpls, counts = sampler.prepare(tables, points, settings.vpls, tick, particles=particles)
        elif settings.method == "virtual-area-lights":
            vpls, counts = vpl_sequence(tables, points, settings.vpls, settings.bounces, settings.seed, threads)
        elif not settings.skipping:
            vpls, rays = trace_particles(tables, settings.vpls, settings.bounces, settings.seed, threads, tick)
            counts = {"light": rays, "shadow": 0, "traced": len(vpls.bounce), "useless": 0}
        else:
            wanted = run.topology and partial(reachable_vpls, run.topology, rooms_seen(run.topology, points))
            vpls, counts = vpl_pool(tables, points, settings.vpls, settings.bounces, clamp_of, settings.seed, threads, tick, share=wanted)
        run.rays["light"] += counts["light"]
        run.rays["shadow"] += counts["shadow"]
        if counts["useless"]:
            run.skip("vpls", f"{counts['useless']} of {counts['traced']} VPLs lie behind every visible point")
    if len(vpls.bounce) == 0 and sampler is None:
        run.skip("vpls", "no lamp's light reaches a surface")
        return nothing, Vpls.allocate(0)
    with run.stage("indirect") as tick:
        if sampler:
            irradiance = sampler.irradiance(points, tick, first=run.turn * max(settings.samples, settings.gather))
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
        elif settings.method == "virtual-area-lights":
            solver = run.clusters = VirtualAreaLights(
                vals=settings.vals,
                interleave=settings.interleave,
                width=width,
                compensation=settings.gather,
                bounces=settings.bounces,
                seed=settings.seed,
                threads=threads,
            )
        elif run.topology is not None:
            solver = run.clusters = VisibilityGates(
                run.topology,
                gates=settings.gates,
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


def one_by_one(emitters: Emitters) -> Emitters:
    """The same emitters without their tree: direct light looks at each of them from every point."""
    return emitters._replace(groups=np.arange(len(emitters.kind), dtype=np.int32))


def _within_reach(run: Run, tables: Transport, points: ShadingPoints) -> Transport:
    """The tables without the light of what lies in rooms that no path joins to those that are seen."""
    kept = reachable_emitters(run.topology, rooms_seen(run.topology, points), tables.emitters)
    if kept.all():
        return tables
    run.skip("lamps", f"{np.count_nonzero(~kept)} lamps and shining triangles are in rooms with no way to what is seen")
    return tables._replace(emitters=without_emitters(tables.emitters, kept))


def single_lights(tables: Transport, vpls: Vpls, points: ShadingPoints, shape: tuple[int, int], threads: int) -> dict[str, np.ndarray]:
    """Debug layers: the light of the strongest VPLs, one by one."""
    found = {}
    for rank, j in enumerate(np.argsort(-vpls.flux.mean(axis=1), kind="stable")[:SINGLE_LIGHTS]):
        solver = InstantRadiosity(compensation=0, threads=threads)
        solver.prepare(tables, vpls.take([j]), points)
        found[f"VPL{rank}"] = splat(points, points.albedo * solver.irradiance(points) * np.float32(1 / np.pi), shape)
    return found
