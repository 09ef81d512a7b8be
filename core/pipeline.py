"""One render, from the scene's arrays to its layers: the stages in the order in which light passes them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace

import numpy as np

from .coincident import covered_places, warning_line
from .denoise import Denoiser
from .enlarged import Whole, enlarged
from .lamps import DirectLight, LightGroups, sharp_emitters, world_tables
from .layers import Layers
from .memory import check_memory
from .methods.caustics import bends_light
from .methods.glossy import Reflections, has_lobes
from .methods.importance_sampling import ImportanceSampling
from .methods.wide_lobes import sees_alike
from .passes import Passes, has_few_rays
from .picture import Picture, nearest_triangles, splat
from .planning.machine import cached_machine, look_again
from .planning.planner import ENLARGED_SAMPLES, Planner, reduced, sides
from .reuse import Sequence
from .scene import Camera, Scene
from .settings import RenderSettings
from .soundness import sound
from .stages import (
    TURN,
    Run,
    StageProgress,
    cache_stage,
    direct_stage,
    glossy_stage,
    indirect_stage,
    method_of,
    prepared,
    refractive,
    sharp_light,
    side_by_side,
    single_lights,
    with_openings,
    within_reach,
)
from .subpixel import PointLight
from .threads import thread_count
from .topology import IN_MEMORY, Topologies, Topology
from .transport import Transport
from .view.picked import MOST_POINTS, picked
from .view.primary import View, view

GLANCE = 64  # pixels along the longer side of a picture that tells what the whole one will show
TOO_SLOW = 2 / 3  # of the denoiser's time that the machine's file foresees: less shows that other work ran when it was made
LOADED: set[str] = set()  # methods whose kernels this process has in memory, which the first pass of one pays for


@dataclass
class RenderResult:
    """Layers of one picture and the statistics of `--stats` (design.md, section 3)."""

    layers: Layers
    stats: dict


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
    passes, _, _ = _passes(run, scene, settings, threads, None, topologies, lambda: time.perf_counter() - begin)
    picture = passes.picture
    if exposed:
        sequence.expose(picture, threads)
    else:
        sequence.add(picture)


def scout(
    scene: Scene,
    settings: RenderSettings,
    sequence: Sequence,
    progress: StageProgress | None = None,
    *,
    topologies: Topologies = IN_MEMORY,
) -> None:
    """Compute of a frame only what the cache of light of later ones takes from it; arguments and errors as `render`."""
    settings = settings.with_defaults()
    run = Run(progress, sequence=sequence, turn=sequence.turn)
    threads = thread_count(settings.threads)
    run.groups = _light_groups(run, scene, settings)
    with prepared(run, scene, settings, threads, topologies) as tables:
        seen = _look(run, scene, tables, settings, threads)
        cache_stage(run, tables, seen.points, settings, threads)


def glance(scene: Scene, settings: RenderSettings, topology: Topology | None = None) -> list[dict]:
    """`savings` of a render of `scene`, whose numbers are sound, as far as a look of few pixels tells: `stage`, `what` and `share` each.

    topology: of the scene, where it is known: it tells which lamps are out of reach.
    """
    settings = replace(settings.with_defaults(), method="instant-radiosity")
    longest = max(scene.camera.width, scene.camera.height)
    small = replace(scene, camera=reduced(scene.camera, max(1.0, longest / GLANCE)))
    run, threads = Run(None, topology=topology), thread_count(settings.threads)
    with prepared(run, small, settings, threads) as tables:
        points = _look(run, small, tables, settings, threads).points
        if topology is not None:
            within_reach(run, tables, points)
    return [{key: line[key] for key in ("stage", "what", "share")} for line in run.savings()]


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
    passes, lit, whole = _passes(run, scene, settings, threads, denoiser, topologies, elapsed)
    picture = passes.picture
    if sequence:
        with run.stage("history"):
            picture = sequence.developed(picture, threads)
    if denoiser:
        with run.stage("denoise") as denoiser.progress:
            in_turn = run.in_turn(settings)
            share = sequence.settings.frame_share if in_turn else 1.0  # history stands for the other rays
            # A kept view saves more time than the better network takes, and its sharper light flickers less where lamps move.
            least = "high" if in_turn and sequence.resting else "fast"
            weight = passes.weight / share
            quality, few = run.planner.denoising_quality(weight, elapsed(), least), has_few_rays(settings, weight)
            direct = settings.wants("Direct", "Combined")
            clean = passes.clean if quality == "fast" and not sequence else None
            picture = picture.denoised(
                denoiser, threads, direct=direct, indirect=not passes.as_it_is, quality=quality, few=few, clean=clean
            )
            foreseen = run.planner.denoising_seconds(quality) if run.planner.machine else 0.0
        if run.planner.machine and run.seconds["denoise"] < TOO_SLOW * foreseen:
            with _calibration(run):  # for the budgets to come
                look_again(run.planner.machine)
        if passes.as_it_is:
            run.skip("denoise", f"the indirect light's relMSE is {passes.estimate:.2g} as it is")
    if picture.groups and (denoiser or sequence):  # either has changed the whole
        with closing(Denoiser(quality="fast")) as quick, run.stage("groups") as quick.progress:
            picture = picture.shared_out(quick, threads)
    if whole:
        with run.stage("enlarging"):
            picture = enlarged(picture, whole, lit, scene.camera, threads)
    layers = picture.layers(scene)
    layers.update(run.debug)
    if settings.layers is not None:
        for name in [name for name in layers if name.partition("_")[0] not in settings.layers and name not in run.debug]:
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
        "savings": run.savings(),
        "warnings": run.warnings,
    }
    return RenderResult(layers, stats)


@contextmanager
def _calibration(run: Run) -> Iterator[None]:
    """Seconds that are spent once a machine: apart from the render, as compilation is."""
    begin = time.perf_counter()
    yield
    run.seconds["calibration"] = run.seconds.get("calibration", 0.0) + time.perf_counter() - begin


def _planner(run: Run, scene: Scene, tables: Transport, settings: RenderSettings, threads: int) -> Planner:
    """Who decides the passes; what this machine can do is only asked where there is something to be reached."""
    machine = None
    if settings.time_budget is not None:
        with _calibration(run):
            machine = cached_machine(threads)
    images = 4 if settings.wants("Direct", "Combined") else 3  # diffuse indirect light is denoised twice
    if images == 4 and sharp_emitters(tables.emitters, settings.direct_samples) is not None:
        images += 1
    if run.groups:  # direct and indirect light of three groups are two images, denoised in half the time
        images += -(-len(run.groups.names) // 3)
    triangles = len(scene.geometry.triangles)
    return Planner(
        settings, math.prod(sides(scene.camera)), machine, images=images, cold=settings.method not in LOADED, triangles=triangles
    )


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
) -> tuple[Passes, Camera, Whole | None]:
    """All passes of a picture, and those that stand for the frames before the first one of a sequence.

    Also the camera of the passes, and, where it is a smaller one, what the scene's own sees.
    """

    def look(run: Run) -> Whole:
        fewer = replace(settings, pixel_samples=min(settings.pixel_samples, ENLARGED_SAMPLES))
        seen = _look(run, full, tables, fewer, threads)
        return Whole.of(seen, sharp_light(run, tables, seen, settings, threads))

    run.groups = _light_groups(run, scene, settings)
    with prepared(run, scene, settings, threads, topologies) as tables:
        planner = run.planner = _planner(run, scene, tables, settings, threads)
        _fly(run, planner, scene, tables, denoiser, threads, elapsed)
        full, whole = scene, None
        if run.sequence or settings.debug_layers:
            if settings.downsampling > 1:
                run.warn("every pixel is lit: sequences and debug layers know no downsampling")
        else:
            scene = replace(scene, camera=planner.lit_camera(scene.camera, elapsed()))
        if planner.lit and settings.time_budget is not None:  # what that costs tells how large a picture can be lit
            whole = look(run)
        passes = Passes(threads)
        quality = planner.first(elapsed())
        while quality is not None:
            start = elapsed()
            asked = settings.scaled(quality, passes.count)

            def light(run: Run, scene=scene, asked=asked, quality=quality) -> Picture:
                return _pass(run, scene, tables, asked, threads, quality, shining=planner.lit is None)

            if planner.lit and whole is None:
                picture, whole = side_by_side(run, threads, light, look)
                passes.add(picture)
            else:
                passes.add(light(run))
            planner.observe(quality, elapsed() - start)
            larger = planner.larger_camera(full.camera, elapsed()) if whole else None
            if larger:
                passes, scene = Passes(threads), replace(scene, camera=larger)
                whole = whole if planner.lit else None
                quality = planner.first(elapsed())
                continue
            with run.stage("plan"):
                quality = planner.next(elapsed(), passes, denoiser)
        if run.sequence:
            for turn in run.sequence.first_turns:
                run.turn = turn
                run.sequence.add(_pass(run, scene, tables, settings, threads, 1.0))
    return passes, scene.camera, whole


def _light_groups(run: Run, scene: Scene, settings: RenderSettings) -> LightGroups | None:
    """The light groups whose light gets layers of its own."""
    if scene.light_groups and settings.light_groups:
        if settings.method == "importance-sampling":
            return LightGroups.of(scene)
        run.warnings.append(f"light groups get no layers of their own from {settings.method}: use the automatic method for them")
    return None


def _look(run: Run, scene: Scene, tables: Transport, settings: RenderSettings, threads: int) -> View:
    """What the camera sees."""
    with run.stage("view") as tick:

        def look() -> View:
            return view(
                scene,
                tables.rays,
                world_tables(scene.world),
                settings.pixel_samples,
                settings.seed,
                threads,
                tick,
                run.groups,
                settings.film,
                covered_places(run.black, len(scene.geometry.triangles)),
            )

        seen = run.sequence.view(scene, settings, look) if run.sequence else look()
        if len(seen.covered):
            run.warn(warning_line(scene.geometry, seen.covered))
        run.rays["primary"] += seen.rays
        run.leave_out("pixels", seen.depth.size - len(np.unique(seen.points.pixel)), seen.depth.size)
    return seen


def _pass(
    run: Run, scene: Scene, tables: Transport, settings: RenderSettings, threads: int, weight: float, *, shining: bool = True
) -> Picture:
    """One picture of the view, its samples, VPLs and caches independent of those of other seeds.

    shining: whether what shines behind glass is in it.
    """
    seen = _look(run, scene, tables, settings, threads)
    if not shining:
        seen.emitted[:, 1:] = 0
    points = seen.points
    if run.topology is not None:
        tables = within_reach(run, tables, points)
    nothing = tables.emitters.no_light(len(points.pixel))
    few = None
    if settings.method == "importance-sampling" and settings.skipping:
        few = picked(points, MOST_POINTS, settings.seed + TURN * run.turn)
    lit = few.points if few else points  # whose indirect light is computed
    behind_glass = bool(points.behind_glass.any())
    wants = settings.wants
    wants_glossy = wants("Direct", "Combined", "GlossyIndirect", "Indirect")
    wants_indirect = wants("DiffuseIndirect", "Indirect", "Irradiance", "Combined") or (behind_glass and wants("GlossyIndirect"))
    lobes = wants_glossy and has_lobes(lit) and sees_alike(scene.geometry.object_visibility)
    openings = None
    if wants_glossy or wants_indirect:
        tables, openings = with_openings(run, tables, points, settings, threads)

    def cache(run: Run) -> ImportanceSampling | None:
        return cache_stage(run, tables, lit, settings, threads, openings=openings) if wants_glossy or wants_indirect else None

    def direct(run: Run, sampler: ImportanceSampling | None = None) -> DirectLight:
        if not (wants("Direct", "Combined") or behind_glass or ((wants_indirect or wants_glossy) and refractive(tables))):
            return DirectLight(nothing, nothing, nothing, nothing)
        with run.stage("direct") as tick:
            return direct_stage(run, scene, tables, points, settings, threads, tick, sampler, few.index if few else None)

    def indirect_of(run: Run, sampler: ImportanceSampling | None) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        if not wants_indirect:
            return tables.emitters.no_light(len(lit.pixel)), None, None
        found = indirect_stage(
            run, tables, lit, seen.shape[1], settings, threads, sampler, glossy=lobes, denoised=settings.denoise and run.sequence is None
        )
        indirect, vpls = found.irradiance, found.vpls
        run.vpls += len(vpls.bounce)
        foreseen = None
        if sampler and sampler.lights is not None and settings.denoise:
            with run.stage("indirect"):
                foreseen = sampler.foreseen(lit, seen.shape, points)
                indirect = sampler.without_sparks(lit, indirect, foreseen[few.index] if few else foreseen, seen.shape)
        if settings.debug_layers and not run.debug:
            run.debug = single_lights(tables, vpls, lit, seen.shape, threads)
            if run.clusters is not None:
                run.debug |= run.clusters.debug_layers(lit, seen.shape)
        return indirect, foreseen, found.noisy

    def glossy(run: Run, sampler: ImportanceSampling | None) -> Reflections:
        if not wants_glossy:
            return Reflections(nothing, nothing, 0, nothing[:, :3])
        found = glossy_stage(run, tables, lit, settings, threads, sampler)
        if few:
            spread = {name: few.spread(getattr(found, name), len(points.pixel)) for name in ("direct", "indirect", "albedo")}
            found = found._replace(**spread)
        return found

    if not settings.smooth:  # direct light and reflections are told what the gather rays before them have found
        sampler = cache(run)
        indirect, foreseen, noisy = indirect_of(run, sampler)
        light, mirrored = direct(run, sampler), glossy(run, sampler)
    elif bends_light(tables):  # the cache tells direct light where to look for what lenses throw
        sampler = cache(run)
        (indirect, foreseen, noisy), (light, mirrored) = side_by_side(
            run, threads, lambda run: indirect_of(run, sampler), lambda run: (direct(run, sampler), glossy(run, sampler))
        )
    else:
        sampler, light = side_by_side(run, threads, cache, direct)
        (indirect, foreseen, noisy), mirrored = side_by_side(
            run, threads, lambda run: indirect_of(run, sampler), lambda run: glossy(run, sampler)
        )
    LOADED.add(settings.method)
    own = indirect
    if few:
        indirect = few.spread(few.factor[:, None] * indirect, len(points.pixel))
    picture = Picture.compose(
        seen, light.irradiance, indirect + light.irradiance_by_glass, light.glossy + mirrored.direct,
        light.glossy_by_glass + mirrored.indirect, mirrored.albedo, weight, run.groups, foreseen,
        light.sharp, light.unshadowed, light.sharp_rays, light.shine,
    )  # fmt: skip
    smooth = None
    if settings.smooth:
        even = indirect if noisy is None else indirect - noisy
        smooth = splat(points, points.albedo * np.float32(1 / np.pi) * even * (points.behind_glass == 0)[:, None], seen.shape)
    if foreseen is not None and run.sequence is None:
        by_glass = light.irradiance_by_glass
        if few:
            by_glass, foreseen = by_glass[few.index], foreseen[few.index]
        picture = replace(picture, points=(PointLight.of(lit, own + by_glass, foreseen, scene.camera, weight),))
    alpha = np.float32(1) - seen.clear if settings.film.transparent else None
    return replace(picture, smooth=smooth, alpha=alpha, triangle=nearest_triangles(seen) if run.sequence else None)
