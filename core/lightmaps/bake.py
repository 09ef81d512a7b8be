"""A bake, from the scene's arrays and its UV maps to finished lightmaps."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from ..denoise import Denoiser
from ..errors import SceneError
from ..rays.order import morton_order
from ..scene import Scene
from ..settings import CONTENTS, BakeSettings, RenderSettings
from ..sharp_shadows import SharpLight, doubt_of
from ..soundness import sound
from ..stages import Run, StageProgress, light_points, method_of, prepared
from ..threads import thread_count
from ..transport import Transport
from ..view.corners import view_corners
from ..view.points import ShadingPoints
from ..view.texels import HIDDEN, LIT, Charts, Texels, view_texels
from .filling import denoised, extended, surroundings, without_strays
from .seams import find_seams, stitched

TEXEL_RAYS = 3  # of each shading point of a texel, for each of a pixel's: texels are looked at from near by
CORNER_RAYS = 2  # of each of a corner's shading points, likewise: they are few, and no denoiser sees them
DENOISING = "fast"  # half the time of "high" at the same error (docs/lightmaps.md)


INSIDE_OUT = (
    "no light reaches '{}': its lightmap is black; if its faces are turned inside out, Mesh > Normals > Recalculate Outside turns them"
)


@dataclass(frozen=True)
class Target:
    """One image: the triangles (T,) int32 that it shows, their UV coordinates (T, 3, 2) in 0..1, v up, and its (width, height)."""

    name: str
    triangles: np.ndarray
    uv: np.ndarray
    size: tuple[int, int]


@dataclass(frozen=True)
class Lightmap:
    """A finished image (H, W, 3) float32, first row at the top (v = 1), and the state (H, W) uint8 of its texels before margins."""

    name: str
    image: np.ndarray
    state: np.ndarray


@dataclass(frozen=True)
class BakeResult:
    """Lightmaps in the order of their targets, and statistics as of a render."""

    lightmaps: list[Lightmap]
    stats: dict


def bake(
    scene: Scene, targets: list[Target], settings: BakeSettings, progress: StageProgress | None = None, *, extraction_seconds: float = 0.0
) -> BakeResult:
    """Compute lightmaps; the scene needs no camera.

    Raises:
        SceneError: the scene cannot be baked with these settings.
        core.threads.Cancelled: `progress` returned False.
    """
    if settings.content not in CONTENTS:
        raise SceneError(f"a lightmap cannot hold {settings.content!r}; choose {', '.join(CONTENTS)}")
    request = settings.render.with_defaults()
    method = method_of(request)
    run = Run(progress)
    run.seconds["extraction"] = extraction_seconds
    begin = time.perf_counter()
    scene = sound(scene)
    threads = thread_count(request.threads)
    settings = replace(settings, render=_with_rays(request, TEXEL_RAYS))
    with prepared(run, scene, request, threads) as tables:
        seen = [_view(run, tables, target, settings, threads) for target in targets]
        irradiance = _light(run, scene, tables, [texels for texels, _ in seen], settings, threads)
    denoiser = Denoiser(quality=DENOISING) if request.denoise else None
    if denoiser and denoiser.warning:
        run.warnings.append(denoiser.warning)
    lightmaps = [
        _finished(run, scene, target, *view, light, settings, denoiser, threads) for target, view, light in zip(targets, seen, irradiance)
    ]
    if denoiser:
        denoiser.close()
    run.warnings += [INSIDE_OUT.format(found.name) for found in lightmaps if (found.state == LIT).any() and not found.image.any()]
    stats = {
        "method": method,
        "content": settings.content,
        "images": {target.name: list(target.size) for target in targets},
        "texels": {
            name: int(sum((texels.state == state).sum() for texels, _ in seen)) for name, state in (("lit", LIT), ("hidden", HIDDEN))
        },
        "vpls": run.vpls,
        "bounces": request.bounces,
        "threads": threads,
        "seconds": {"jit": 0.0} | run.seconds,
        "seconds_total": extraction_seconds + time.perf_counter() - begin - run.seconds.get("jit", 0.0),
        "rays": run.rays,
        "pairs_shaded": run.pairs,
        "skipped": [vars(s) for s in run.skipped],
        "warnings": run.warnings,
    }
    return BakeResult(lightmaps, stats)


def bake_corners(
    scene: Scene, triangles: np.ndarray, settings: BakeSettings, progress: StageProgress | None = None
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Light at the corners of T triangles, for a colour attribute: values (T, 3, 3), which of them hold light (T, 3) bool, and warnings.

    Raises as `bake`.
    """
    request = settings.render.with_defaults()
    settings = replace(settings, render=_with_rays(request, CORNER_RAYS))
    run = Run(progress)
    scene = sound(scene)
    threads = thread_count(request.threads)
    full = settings.content == "full"
    with prepared(run, scene, request, threads) as tables:
        with run.stage("texels") as tick:
            corners = view_corners(tables, triangles, settings.texel_samples, request.seed, threads, tick, materials=full)
        ((light, _),) = _light(run, scene, tables, [corners], settings, threads)
    if full:
        light = corners.albedo * light * np.float32(1 / np.pi) + corners.emission
    return light, corners.state == LIT, run.warnings


def _with_rays(request: RenderSettings, factor: int) -> RenderSettings:
    """So many times the rays of every shading point."""
    return replace(request, **{name: factor * getattr(request, name) for name in ("samples", "gather", "direct_samples")})


def _view(run: Run, tables: Transport, target: Target, settings: BakeSettings, threads: int) -> tuple[Texels, Charts]:
    """The texels of one image."""
    charts = Charts.of(target.triangles, target.uv, target.size)
    with run.stage("texels") as tick:
        texels = view_texels(
            tables, charts, target.size, settings.texel_samples, settings.render.seed, threads, tick, materials=settings.content == "full"
        )
    texels.state = without_strays(texels.state)
    run.rays["primary"] += texels.rays
    if not (texels.state == LIT).any():
        run.warnings.append(f"'{target.name}' is hidden inside other objects: its lightmap is black")
    return texels, charts


def _light(
    run: Run, scene: Scene, tables: Transport, seen: list[Texels], settings: BakeSettings, threads: int
) -> list[tuple[np.ndarray, SharpLight | None]]:
    """Irradiance (H, W, 3) of each image, and what of it has sharp shadows; all images are lit together."""
    sizes = [texels.state.size for texels in seen]
    first = np.concatenate([[0], np.cumsum(sizes)])
    points = ShadingPoints.concatenate(
        [texels.points._replace(pixel=texels.points.pixel + np.int32(start)) for texels, start in zip(seen, first)]
    )
    points = points.take(morton_order(points.position, points.ns))
    request = settings.render.with_defaults()
    light = light_points(run, scene, tables, points, request, threads, direct=settings.content != "indirect")
    layers = [_image(points, light.irradiance + light.irradiance_by_glass, first[-1])]
    if light.sharp is not None:
        lit, unshadowed = (_image(points, part, first[-1]) for part in (light.sharp, light.unshadowed))
        doubt = doubt_of(points.albedo * light.unshadowed, unshadowed[points.pixel], light.sharp_rays)
        layers += [lit, unshadowed, _sums(points, doubt, first[-1])]
    images = [
        [flat[start : start + size].reshape(*texels.state.shape, 3) for flat in layers] for texels, start, size in zip(seen, first, sizes)
    ]
    return [(whole, SharpLight(*sharp) if sharp else None) for whole, *sharp in images]


def _image(points: ShadingPoints, irradiance: np.ndarray, n: int) -> np.ndarray:
    """Sum (n, 3) of the irradiance (N, 3) of each texel's points by their shares of it."""
    return _sums(points, points.albedo * irradiance, n)


def _sums(points: ShadingPoints, values: np.ndarray, n: int) -> np.ndarray:
    """Sum (n, 3) of the values (N, 3) of each texel's points."""
    return np.stack([np.bincount(points.pixel, values[:, c], n) for c in range(3)], axis=1).astype(np.float32)


def _finished(
    run: Run, scene: Scene, target: Target, texels: Texels, charts: Charts, light: tuple[np.ndarray, SharpLight | None], settings: BakeSettings,
    denoiser: Denoiser | None, threads: int,
) -> Lightmap:  # fmt: skip
    """The image that is kept, of the `_light` of its texels: without noise, with margins, without seams."""
    lit, (irradiance, sharp) = texels.state == LIT, light
    if not lit.any():
        return Lightmap(target.name, np.zeros_like(texels.normal), texels.state)
    with run.stage("margin"):
        around = surroundings(texels.state)
    if denoiser is not None:
        with run.stage("denoise") as denoiser.progress:
            irradiance = denoised(irradiance, texels.normal, texels.position, around, denoiser, threads, sharp)
    with run.stage("margin"):
        image, filled = extended(irradiance, texels.state, around, settings.margin)
    if settings.stitch:
        with run.stage("seams"):
            image = stitched(image, lit, filled, find_seams(scene.geometry, charts))
    if settings.content == "full":
        albedo, emission = (extended(layer, texels.state, around, settings.margin)[0] for layer in (texels.albedo, texels.emission))
        image = albedo * image * np.float32(1 / np.pi) + emission
    return Lightmap(target.name, image, texels.state)
