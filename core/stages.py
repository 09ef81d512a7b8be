"""The stages of a render, each from arrays to arrays: what is traced and lit, and what is skipped, clocked and counted."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from .coincident import Coincident, coincident, without_reflection
from .errors import SceneError
from .inspection import foresee, savings
from .jit import CompileTimer
from .lamps import DirectLight, Emitters, LightGroups, Openings, build_emitters, direct_light, find_openings, highlights, sharp_emitters
from .lamps.emission import is_small
from .lamps.escapes import shadows_alike
from .lamps.links import is_linked
from .lamps.world import portal_table
from .methods.area_shadows import area_lamps, direct_by_soft_maps
from .methods.caustics import add_caustics, bends_light, by_lenses
from .methods.fuzzy_clustering import FuzzyClustering
from .methods.glossy import Reflections, has_lobes, lamps_by_rays, reflect
from .methods.importance_sampling import ImportanceSampling, cache_paths
from .methods.instant_radiosity import InstantRadiosity, clamp_of
from .methods.probes import trace_probes
from .methods.shadow_mapped import ShadowMappedRadiosity, direct_by_maps, point_lamps
from .methods.virtual_area_lights import VirtualAreaLights
from .methods.visibility_gates import VisibilityGates
from .particles import Vpls, trace_by_power, trace_particles
from .picture import splat
from .planning.planner import Planner
from .rays import RayScene
from .reuse import Sequence
from .reuse.sequence import ray_scene
from .scene import AREA, POINT, REFRACTIVE, SPOT, Scene, Skipped
from .settings import RenderSettings
from .sharp_shadows import in_penumbras
from .surfaces.brushed import with_brushed
from .surfaces.program import with_viewer
from .threads import PROGRESS_SECONDS, Cancelled, Progress
from .topology import IN_MEMORY, Topologies, Topology, reachable_emitters, reachable_vpls, rooms_seen, without_emitters
from .transport import Transport, is_translucent, transport
from .view.points import ShadingPoints
from .view.primary import View
from .vpl_pool import MOST_BATCHES, vpl_pool, vpl_sequence

# progress(stage, fraction) -> True to go on, False to cancel.
StageProgress = Callable[[str, float], bool]
Here, Aside = TypeVar("Here"), TypeVar("Aside")

AVAILABLE = ("instant-radiosity", "fuzzy-clustering", "virtual-area-lights", "visibility-gates", "importance-sampling")
TURN = 32452843  # between the seeds of a sequence's turns
FEW_BATCHES = 2  # of particles, for lights that are clustered: more of them cost time and leave the picture as it is
CLUSTER_GATHER = 2  # gather rays of a cluster, for each that a point would get: its many points share what they find
GATHER_POINTS = (
    1 << 15
)  # points that all get their gather rays where a denoiser lets each have its own; more of them share so many, one at least
SHARERS = 8  # neighbouring clusters that share a shadow ray to a light which gives them little
# Shadow rays to each lamp with sharp shadows, of a point in a picture that takes its other light from a smaller one, and more of one in a penumbra.
SHARP_RAYS, PENUMBRA_RAYS = 1, 8
SMALL_CACHE = 0.25  # times the paths of the accurate method's smallest cache of light are a preview's
# Small openings guide direct light as portals do where less of the rays from the places escape than this (of a room with a window of 1 m one in 130, of the
# living room one in thirty: there neighbours tell as much), and openings have most of those.
MOSTLY_CLOSED, MOSTLY = 0.025, 0.9
SINGLE_LIGHTS = 4  # of the strongest VPLs, each a debug layer
# What only a render can count.
LEFT_OUT = {
    "pixels": "pixels that show no surface that could be lit",
    "lamps": "lamps and shining triangles in rooms with no way to what is seen",
    "vpls": "VPLs behind every visible point",
}


class IndirectLight(NamedTuple):
    """Indirect irradiance at N points, (N, 3 G) for G light groups, the part of it that has noise where the rest has none, (N, 3) or None, and the VPLs that it came from."""

    irradiance: np.ndarray
    noisy: np.ndarray | None
    vpls: Vpls


@dataclass
class Run:
    """Clock, counters and remarks of one render."""

    progress: StageProgress | None
    seconds: dict = field(default_factory=dict)
    rays: dict = field(default_factory=lambda: {"primary": 0, "light": 0, "shadow": 0})
    pairs: int = 0
    black: Coincident = field(default_factory=Coincident.none)
    skipped: list[Skipped] = field(default_factory=list)
    foreseen: list[dict] = field(default_factory=list)  # `core.inspection.savings` of the scene
    left_out: dict[str, tuple[int, int]] = field(default_factory=dict)  # by the keys of LEFT_OUT: so many of so many
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

    def warn(self, line: str) -> None:
        """Note what is wrong with the scene; of lines that differ in their figures the first."""
        if not any(line.lstrip("0123456789,") == other.lstrip("0123456789,") for other in self.warnings):
            self.warnings.append(line)

    def add(self, other: Run) -> None:
        """Take over what another run of the same render has counted and remarked."""
        for stage, seconds in other.seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
        for kind, rays in other.rays.items():
            self.rays[kind] = self.rays.get(kind, 0) + rays
        self.pairs, self.vpls, self.debug = self.pairs + other.pairs, self.vpls + other.vpls, self.debug | other.debug
        for remark in other.skipped:
            self.skip(remark.stage, remark.reason)
        for line in other.warnings:
            self.warn(line)
        for stage, counts in other.left_out.items():
            self.leave_out(stage, *counts)

    def leave_out(self, stage: str, left: int, of: int) -> None:
        """Count `left` of `of` things that cost nothing, for `savings`."""
        before = self.left_out.get(stage, (0, 0))
        self.left_out[stage] = (before[0] + left, before[1] + of)

    def savings(self) -> list[dict]:
        """Work that was left out: `core.inspection.savings`, and what only the render could count: `left` of `of` things."""
        counted = [
            {"stage": stage, "what": LEFT_OUT[stage], "left": left, "of": of, "share": left / of}
            for stage, (left, of) in self.left_out.items()
            if left
        ]
        return [*self.foreseen, *counted]

    def in_turn(self, settings: RenderSettings) -> bool:
        """Whether frames share work by turns: not where each takes as many passes as it needs."""
        return self.sequence is not None and self.sequence.window > 0 and settings.time_budget is None and settings.target_error is None

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


def side_by_side(run: Run, threads: int, here: Callable[[Run], Here], aside: Callable[[Run], Aside]) -> tuple[Here, Aside]:
    """`here(run)` and `aside(another run)`, on a thread of its own, whose counts are added to those of `run`.

    Neither may read what the other writes: results are then those of one after the other, which is what one thread gives.
    Stages that run at once share the cores; their seconds add up to more than the time that passes.

    Raises:
        Cancelled: the progress function of `run` returned False; `aside` hears of it as it would of its own.
    """
    if threads < 2:
        return here(run), aside(run)
    stopped, latest = False, ("", 0.0)

    def listen(stage: str, done: float) -> bool:
        nonlocal latest
        latest = stage, done
        return not stopped

    other = replace(
        run, progress=listen, seconds={}, rays=dict.fromkeys(run.rays, 0), pairs=0, vpls=0, skipped=[], warnings=[], left_out={}, debug={}
    )
    before = run.seconds.get("jit", 0.0)
    with ThreadPoolExecutor(1, thread_name_prefix="lumigate-beside") as thread, CompileTimer() as compiling:
        pending = thread.submit(aside, other)
        try:
            found = here(run)
            while wait([pending], timeout=PROGRESS_SECONDS).not_done:  # the timeout lets Ctrl-C and a cancel button through
                if run.progress is not None and latest[0] and not run.progress(*latest):
                    raise Cancelled
        finally:
            stopped = True  # nobody may go on once the caller has closed the scene: leaving the block waits
        result = pending.result()
    run.add(other)
    run.seconds["jit"] = before + compiling.seconds  # each of the two has counted what either compiled
    return found, result


def method_of(settings: RenderSettings) -> str:
    """The method that runs."""
    if settings.method not in AVAILABLE:
        raise SceneError(f"method {settings.method!r} is not available; use {', '.join(AVAILABLE)} or auto")
    return settings.method


@contextmanager
def prepared(run: Run, scene: Scene, settings: RenderSettings, threads: int, topologies: Topologies = IN_MEMORY) -> Iterator[Transport]:
    """The tables of a scene, whose rays can be traced inside the block; remarks on it, and its topology, go into `run`."""
    with ExitStack() as opened:

        def trees(run: Run) -> RayScene:
            with run.stage("rays"):
                return run.sequence.rays(scene) if run.sequence else opened.enter_context(ray_scene(scene))

        def lights(run: Run):
            with run.stage("emitters"):
                emitters = run.sequence.emitters(scene, run.groups) if run.sequence else build_emitters(scene, groups=run.groups)
                if not settings.skipping:
                    emitters = one_by_one(emitters)
                remarks = *foresee(scene, emitters), savings(scene, emitters, settings.direct_samples)
                return emitters, with_brushed(with_viewer(scene, directly=False), scene.geometry), coincident(scene), remarks

        at_once = 1 if run.sequence else threads
        rays, (emitters, materials, run.black, (skipped, warnings, run.foreseen)) = side_by_side(run, at_once, trees, lights)
        run.skipped = [*scene.skipped, *skipped]
        run.warnings += [*scene.warnings, *warnings]
        tables = without_reflection(transport(scene.geometry, materials, rays.tables, emitters), run.black)
        if settings.method == "visibility-gates":
            with run.stage("topology"):
                space = {"closed": settings.outside == "closed", "cutouts": settings.cutouts, "sheets": settings.sheets == "walls"}
                run.topology = topologies.of(scene, settings.voxels, threads, **space)
        yield tables


def one_by_one(emitters: Emitters) -> Emitters:
    """The same emitters without their tree: direct light looks at each of them from every point."""
    return emitters._replace(groups=np.arange(len(emitters.kind), dtype=np.int32))


def within_reach(run: Run, tables: Transport, points: ShadingPoints) -> Transport:
    """The tables without the light of what lies in rooms that no path joins to those that are seen."""
    if is_translucent(tables):  # it may come through walls
        return tables
    kept = reachable_emitters(run.topology, rooms_seen(run.topology, points), tables.emitters)
    run.leave_out("lamps", np.count_nonzero(~kept), len(kept))
    if kept.all():
        return tables
    run.skip("lamps", f"{np.count_nonzero(~kept)} lamps and shining triangles are in rooms with no way to what is seen")
    return tables._replace(emitters=without_emitters(tables.emitters, kept))


def light_points(
    run: Run,
    scene: Scene,
    tables: Transport,
    points: ShadingPoints,
    settings: RenderSettings,
    threads: int,
    *,
    direct: bool = True,
) -> DirectLight:
    """Light at points that need not belong to any view: direct irradiance, zero unless it is wanted, and as `irradiance_by_glass` all that is indirect.

    points: N of them, in an order in which neighbours lie close together; without glossy lobes.
    """
    none = by_glass = tables.emitters.no_light(len(points.pixel))
    if run.topology is not None:
        tables = within_reach(run, tables, points)
    tables, openings = with_openings(run, tables, points, settings, threads)
    sampler = cache_stage(run, tables, points, settings, threads, texels=len(np.unique(points.pixel)), openings=openings)
    found = indirect_stage(run, tables, points, None, settings, threads, sampler)
    indirect = found.irradiance
    run.vpls += len(found.vpls.bounce)
    if direct or refractive(tables):
        with run.stage("direct") as tick:
            light = direct_stage(run, scene, tables, points, settings, threads, tick, sampler)
        if direct:
            return light._replace(irradiance_by_glass=indirect + light.irradiance_by_glass)
        by_glass = light.irradiance_by_glass
    return DirectLight(none, none, indirect + by_glass, none)


def refractive(tables: Transport) -> bool:
    """Whether lamps may shine through glass, which makes their light indirect light."""
    return bool((tables.materials.flags & REFRACTIVE).any())


def is_view_dependent(points: ShadingPoints) -> bool:
    """Whether what some of the points send of direct light depends on the side from which they are seen."""
    return has_lobes(points) or bool(points.rough.any() or points.sheen.any())


def direct_stage(
    run: Run, scene: Scene, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int, tick,
    sampler: ImportanceSampling | None = None, picked: np.ndarray | None = None,
) -> DirectLight:  # fmt: skip
    """Direct light at the points: irradiance, and what their lobes reflect of it by shadow rays.

    sampler: whose gather rays have gone out from these points, and count for what they have found of the world and of shining surfaces.
    picked: (M,), which of the points these were, None for all.
    """
    samples, seed, every = settings.direct_samples, settings.seed, tables
    gathered = sampler.gathered if sampler and shadows_alike(scene.geometry, scene.materials.tables) else None
    if gathered and picked is not None:
        gathered = gathered.spread(picked, len(points.pixel))

    def by_rays(tables: Transport, lobes: bool) -> DirectLight:
        light, rays = direct_light(
            tables, points, samples, seed, threads, tick, reflections=settings.reflections, lobes=lobes, apart=settings.denoise,
            gathered=gathered,
        )  # fmt: skip
        run.rays["shadow"] += rays
        found = highlights(tables, points, seed, threads) if lobes else None
        if found is not None:
            shine, by_glass, rays = found
            light = light._replace(glossy=light.glossy + shine, glossy_by_glass=light.glossy_by_glass + by_glass, shine=shine)
            run.rays["shadow"] += rays
        if settings.bounces > 0 and bends_light(tables):
            # The cache's emitters are aimed at what is seen.
            sources = tables._replace(emitters=sampler.emitters) if sampler and tables is every else tables
            caustics, rays = by_lenses(
                sources, points.position, settings.vpls, settings.bounces, seed, threads, tick and (lambda _: tick(1.0))
            )
            if caustics:
                lit = light.irradiance_by_glass, light.glossy_by_glass if lobes else None
                add_caustics(tables, caustics, points, seed, threads, *lit)
            run.rays["light"] += rays
        if lobes and settings.reflections > 0:
            backs = lamps_by_rays(tables, points)
            for shown in (light.glossy, light.glossy_by_glass, light.shine):
                if shown is not None:
                    shown[backs] = 0
        if settings.bounces == 0:  # glass is a bounce
            nothing = np.zeros_like(light.irradiance_by_glass)
            return light._replace(irradiance_by_glass=nothing, glossy_by_glass=nothing)
        return light

    lobes = is_view_dependent(points)
    if settings.visibility == "shadow-maps" and len(point_lamps(tables.emitters)):
        mapped, kinds = direct_by_maps, (POINT, SPOT)
    elif settings.soft_shadows and len(area_lamps(tables.emitters)):
        mapped, kinds = direct_by_soft_maps, (AREA,)
    else:
        return by_rays(tables, lobes)
    by_maps, rays = mapped(tables, points, seed=seed, threads=threads)
    run.rays["shadow"] += rays
    others = scene.lamps.take(~np.isin(scene.lamps.kind, kinds) | is_linked(scene.lamps))
    rest = by_rays(tables._replace(emitters=build_emitters(replace(scene, lamps=others))), False)
    lit = rest._replace(irradiance=by_maps + rest.irradiance)
    if not lobes:
        return lit
    # Maps know no lobes.
    shown = by_rays(tables, True)
    return lit._replace(glossy=shown.glossy, glossy_by_glass=shown.glossy_by_glass, shine=shown.shine)


def with_openings(
    run: Run, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int
) -> tuple[Transport, Openings | None]:
    """The openings by which sun and world shine on the points, and tables of lamps whose world has them as portals if they are small and it has none."""
    if settings.method != "importance-sampling" or run.sequence is not None or not (len(points.pixel) and tables.emitters.flux.any()):
        return tables, None
    with run.stage("cache"):
        openings = find_openings(tables, points.position, points.ng, points.error, settings.seed, threads)
    run.rays["light"] += openings.rays
    emitters = tables.emitters
    few = openings.open <= MOSTLY_CLOSED and openings.share.sum() >= MOSTLY and is_small(openings.boxes, emitters.box)
    if not few or len(emitters.world.portals):
        return tables, openings
    world = emitters.world._replace(portals=portal_table(openings.portals()))
    return tables._replace(emitters=emitters._replace(world=world)), openings


def cache_stage(
    run: Run, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int, *, texels: int | None = None,
    openings: Openings | None = None,
) -> ImportanceSampling | None:  # fmt: skip
    """The accurate method with its cache of light filled, which reflections use, too; of other methods only previews take a small one.

    texels, openings: as of `ImportanceSampling.cache_light`.
    """
    accurate = settings.method == "importance-sampling"
    if not (accurate or settings.method == "fuzzy-clustering") or settings.bounces < 1 or not tables.emitters.flux.any():
        return None
    reflects = has_lobes(points) and (accurate or settings.reflections > 0)
    if not (points.albedo.any() and (accurate or settings.compensation)) and not reflects:
        return None
    with run.stage("cache") as tick:
        sampler = ImportanceSampling(
            samples=settings.samples, gather=settings.gather, bounces=settings.bounces, seed=settings.seed, threads=threads
        )
        tracer = run.sequence.probes if accurate and run.in_turn(settings) else trace_probes
        paths = None if accurate else int(SMALL_CACHE * cache_paths(len(points.pixel), 2))
        run.rays["light"] += sampler.cache_light(
            tables, points, tick, paths=paths, texels=texels, tracer=tracer, focus=run.sequence is None, openings=openings
        )
    return sampler


def sharp_light(run: Run, tables: Transport, seen: View, settings: RenderSettings, threads: int) -> np.ndarray | None:
    """Direct irradiance at the points seen by lamps with sharp shadows, (N, 3), as `direct_stage` tells it apart; None where it does not."""
    if not (settings.denoise and settings.wants("Direct", "Combined")) or settings.visibility == "shadow-maps" or settings.soft_shadows:
        return None
    sharp = sharp_emitters(tables.emitters, settings.direct_samples)
    if sharp is None:
        return None
    groups = tables.emitters.groups
    groups = groups[(groups >= 0) & sharp[groups]]
    only = tables._replace(emitters=tables.emitters._replace(groups=groups))
    points, lobes = seen.points, is_view_dependent(seen.points)

    def lit(points: ShadingPoints, rays: int, seed: int, tick: Progress | None = None) -> tuple[np.ndarray, np.ndarray]:
        light, traced = direct_light(
            only, points, rays * len(groups), seed, threads, tick, reflections=settings.reflections, lobes=lobes, apart=True
        )
        run.rays["shadow"] += traced
        return light.irradiance.reshape(len(points.pixel), light.irradiance.shape[1] // 3, 3).sum(axis=1), light.unshadowed

    with run.stage("direct") as tick:
        found, clear = lit(points, SHARP_RAYS, settings.seed, tick)
        at = np.flatnonzero(in_penumbras(found.sum(axis=1), clear.sum(axis=1), points.pixel, seen.shape)[points.pixel])
        if len(at):
            more, _ = lit(points.take(at), PENUMBRA_RAYS, settings.seed + 1)
            found[at] += np.float32(PENUMBRA_RAYS / (PENUMBRA_RAYS + SHARP_RAYS)) * (more - found[at])
    return found


def glossy_stage(
    run: Run, tables: Transport, points: ShadingPoints, settings: RenderSettings, threads: int, sampler: ImportanceSampling | None
) -> Reflections:
    """What rays drawn from the points' lobes find, and those of diffuse light before them, where these serve wide lobes, too."""
    nothing = tables.emitters.no_light(len(points.pixel))
    if not has_lobes(points) or settings.reflections < 1:
        run.skip("glossy", "no visible surface is glossy" if settings.reflections > 0 else "no reflections asked for")
        return Reflections(nothing, nothing, 0, nothing[:, :3])
    with run.stage("glossy") as tick:
        found = reflect(
            tables, points, settings.direct_samples, settings.reflections, settings.bounces, settings.seed + TURN * run.turn, threads, tick,
            cache=sampler.cache if sampler else None, near=sampler.near if sampler else np.inf, shared=sampler.shared if sampler else None,
        )  # fmt: skip
        if sampler and sampler.shared:
            found = found._replace(indirect=found.indirect + sampler.reflected)
        run.rays["reflected"] = run.rays.get("reflected", 0) + found.rays
    return found


def indirect_stage(
    run: Run,
    tables: Transport,
    points: ShadingPoints,
    width: int | None,
    settings: RenderSettings,
    threads: int,
    sampler: ImportanceSampling | None,
    *,
    glossy: bool = False,
    denoised: bool = False,
) -> IndirectLight:
    """Indirect light at the points; width: of the picture in pixels, None where the points are not of one.

    glossy: whether `glossy_stage` follows, and its lobes may share the rays.  denoised: whether what is noisy may be told apart.
    """
    nothing = tables.emitters.no_light(len(points.pixel))
    if settings.bounces < 1 or settings.vpls < 1:
        run.skip("vpls", "no bounces or no VPLs asked for")
        return IndirectLight(nothing, None, Vpls.allocate(0))
    if not points.albedo.any():
        run.skip("vpls", "every visible albedo is black")
        return IndirectLight(nothing, None, Vpls.allocate(0))
    accurate = sampler if settings.method == "importance-sampling" else None
    with run.stage("vpls") as tick:
        if accurate:
            particles = run.sequence.particles if run.sequence else trace_by_power
            turn = run.turn if run.in_turn(settings) else None
            vpls, counts = sampler.prepare(tables, points, settings.vpls, tick, particles=particles, turn=turn)
        elif settings.method == "virtual-area-lights":
            vpls, counts = vpl_sequence(tables, points, settings.vpls, settings.bounces, settings.seed, threads)
        elif not settings.skipping:
            vpls, rays = trace_particles(tables, settings.vpls, settings.bounces, settings.seed, threads, tick)
            counts = {"light": rays, "shadow": 0, "traced": len(vpls.bounce), "useless": 0}
        else:
            batches = FEW_BATCHES if settings.smooth else MOST_BATCHES
            wanted = run.topology and partial(reachable_vpls, run.topology, rooms_seen(run.topology, points))
            aimed = tables._replace(emitters=sampler.emitters) if sampler else tables  # at what the cache says the view's light comes from
            particles = partial(trace_by_power, sharpest=0.0) if settings.smooth else trace_particles  # lights more alike cluster better
            vpls, counts = vpl_pool(
                aimed,
                points,
                settings.vpls,
                settings.bounces,
                clamp_of,
                settings.seed,
                threads,
                tick,
                share=wanted,
                batches=batches,
                particles=particles,
            )
        run.rays["light"] += counts["light"]
        run.rays["shadow"] += counts["shadow"]
        run.leave_out("vpls", counts["useless"], counts["traced"])
        if counts["useless"]:
            run.skip("vpls", f"{counts['useless']} of {counts['traced']} VPLs lie behind every visible point")
    if len(vpls.bounce) == 0 and not accurate:
        run.skip("vpls", "no lamp's light reaches a surface")
        return IndirectLight(nothing, None, Vpls.allocate(0))
    with run.stage("indirect") as tick:
        if accurate:
            irradiance = sampler.irradiance(
                points, tick, first=run.turn * max(settings.samples, settings.gather), by_share=width is not None and settings.skipping,
                reflections=settings.reflections if glossy else 0,
            )  # fmt: skip
            run.rays["shadow"] += sampler.rays
            run.pairs += sampler.pairs
            return IndirectLight(irradiance, None, vpls)
        own_gather = max(1, min(settings.gather, round(settings.gather * GATHER_POINTS / len(points.pixel)))) if denoised else 0
        solver = _solver(run, settings, width, threads, sampler, own_gather)
        solver.prepare(tables, vpls, points)
        irradiance = solver.irradiance(points, tick)
        run.rays["shadow"] += solver.rays
        run.pairs += solver.pairs
    return IndirectLight(irradiance, solver.noisy if settings.smooth else None, vpls)


def _solver(run: Run, settings: RenderSettings, width: int | None, threads: int, sampler: ImportanceSampling | None, own_gather: int):
    """What lights points by VPLs in every method but the accurate one; `run` keeps those whose clusters can be shown.

    own_gather: gather rays of each point, of methods that otherwise share them; 0 where they are to be shared.
    """
    common = {"bounces": settings.bounces, "seed": settings.seed, "threads": threads}
    compensation = settings.gather if settings.compensation else 0
    if settings.method == "fuzzy-clustering":
        run.clusters = FuzzyClustering(
            vpl_clusters=settings.vpl_clusters,
            point_clusters=settings.point_clusters,
            fuzziness=settings.fuzziness,
            weighting=settings.weighting,
            shade_with=settings.shade_with,
            compensation=CLUSTER_GATHER * compensation,
            own_compensation=own_gather if compensation else 0,
            sharers=SHARERS,
            cache=sampler.cache if sampler else None,
            **common,
        )
        return run.clusters
    if settings.method == "virtual-area-lights":
        run.clusters = VirtualAreaLights(
            vals=settings.vals, interleave=settings.interleave, width=width, compensation=settings.gather, **common
        )
        return run.clusters
    if run.topology is not None:
        gates = {"gates": settings.gates, "oversize": settings.gate_size, "blend": settings.gate_filter}
        run.clusters = VisibilityGates(run.topology, **gates, compensation=compensation, **common)
        return run.clusters
    if settings.visibility == "shadow-maps":
        return ShadowMappedRadiosity(seed=settings.seed, threads=threads)
    return InstantRadiosity(visibility=settings.visibility, compensation=compensation if settings.visibility == "rays" else 0, **common)


def single_lights(tables: Transport, vpls: Vpls, points: ShadingPoints, shape: tuple[int, int], threads: int) -> dict[str, np.ndarray]:
    """Debug layers: the light of the strongest VPLs, one by one."""
    found = {}
    for rank, j in enumerate(np.argsort(-vpls.flux.mean(axis=1), kind="stable")[:SINGLE_LIGHTS]):
        solver = InstantRadiosity(compensation=0, threads=threads)
        solver.prepare(tables, vpls.take([j]), points)
        found[f"VPL{rank}"] = splat(points, points.albedo * solver.irradiance(points) * np.float32(1 / np.pi), shape)
    return found
