"""References by Cycles on the CPU, as the layers of the contract, and the peer 'Cycles + OIDN'.

What of Cycles' light goes into which layer (design.md, section 3):

- `DiffuseIndirect`: the Diffuse Indirect pass times the Diffuse Color pass, which is outgoing radiance, for Cycles
  divides the means of the pixel by each other when it hands a pass over.  Subsurface and translucent light are diffuse.
- `GlossyIndirect`: glossy, transmitted and volume-scattered indirect light.  What is seen through glass is the specular
  part of a picture: Cycles cannot tell which light of it was diffuse further on, so `DiffuseIndirect` stays clean of it.
- `Direct`: the direct light of the same four kinds.  `Emission`: emission that the camera sees, and the world.
- `Irradiance`: pi x the Diffuse Indirect pass as Cycles gives it, zero where the albedo is.

The number of diffuse bounces is the only one that cuts.  Cycles ends a path at the first limit it meets, so every other
limit is far above what carries light: glossy, transmission and volume bounces, and the total, which bounds them all.
A path then holds at most B diffuse reflections after the first, whatever mirrors and glass lie between.  (Transmission
through a translucent surface counts as transmission in Cycles, not as a diffuse bounce.)
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..core.denoise import Denoiser
from ..core.errors import SceneError
from ..core.layers import Layers, read_exr, write_exr
from ..core.scene import REMAINDER
from ..core.threads import Cancelled
from .interrupts import ending_amid

# Raise it when a change here changes pixels: cached references of older versions are then rendered anew.
REFERENCE_VERSION = 1

# Far above what carries light, and bounded all the same, for a closed room of mirrors.
_MANY_BOUNCES = 256
_MOST_BOUNCES = 1024  # Blender's own limit
_SMALLEST_SIDE = 4  # pixels; Blender raises smaller ones in silence
# Blender 4.5's names of passes in a file, and those of 5.x.
_LONG_NAMES = {
    "DiffDir": "Diffuse Direct",
    "DiffInd": "Diffuse Indirect",
    "DiffCol": "Diffuse Color",
    "GlossDir": "Glossy Direct",
    "GlossInd": "Glossy Indirect",
    "GlossCol": "Glossy Color",
    "TransDir": "Transmission Direct",
    "TransInd": "Transmission Indirect",
    "TransCol": "Transmission Color",
    "VolumeDir": "Volume Direct",
    "VolumeInd": "Volume Indirect",
    "Emit": "Emission",
    "Env": "Environment",
}
_PASSES = (
    "combined", "z", "normal", "position", "emit", "environment",
    "diffuse_direct", "diffuse_indirect", "diffuse_color",
    "glossy_direct", "glossy_indirect", "glossy_color",
    "transmission_direct", "transmission_indirect", "transmission_color",
)  # fmt: skip
_GROUP = "Combined_"  # of Cycles' passes of light groups
_VOLUME_PASSES = ("volume_direct", "volume_indirect")
DENOISED = ("Direct", "DiffuseIndirect", "GlossyIndirect")


@dataclass(frozen=True)
class ReferenceSettings:
    """What decides the pixels of a reference.

    spp: samples a pixel.  size: (width, height) in pixels, None for the scene's own.  bounces: diffuse bounces
    of the indirect light.  camera: name, None for the scene's own.  frame: None for the current one.
    border: (x0, y0, x1, y1) pixels, x to the right, y down: the part to be rendered, None for the scene's own.
    view_layer: name, None for the first.  guiding: Cycles' path guiding.
    denoise: OIDN with albedo and normal guides on `denoised`;  prefilter: on guides denoised first.
    """

    spp: int = 1024
    size: tuple[int, int] | None = None
    bounces: int = 4
    seed: int = 0
    camera: str | None = None
    frame: int | None = None
    border: tuple[int, int, int, int] | None = None
    view_layer: str | None = None
    guiding: bool = False
    denoise: bool = False
    prefilter: bool = False
    denoised: tuple[str, ...] = DENOISED


def render_reference(scene: bpy.types.Scene, path: str | os.PathLike, *, threads: int = 0, **settings) -> dict:
    """Render `scene` with Cycles and write its layers to `path`, whole or not at all.

    settings: fields of `ReferenceSettings`.  threads: 0 is all cores.

    Returns:
        The statistics of `render_layers`, with `seconds.write` added.

    Raises:
        SceneError: the scene cannot be rendered, or the file not be written.
        Cancelled: the user stopped the render.
    """
    layers, stats = render_layers(scene, ReferenceSettings(**settings), threads=threads)
    start = time.perf_counter()
    write_exr(path, layers)
    stats["seconds"]["write"] = time.perf_counter() - start
    return stats


def render_layers(
    scene: bpy.types.Scene, settings: ReferenceSettings, *, threads: int = 0, denoiser: Denoiser | None = None
) -> tuple[Layers, dict]:
    """Render `scene` with Cycles: its layers in memory, and what it cost.  The scene's settings are as before afterwards.

    denoiser: one to be used again; a benchmark of many renders saves loading the network each time.

    Returns:
        layers, stats.  stats: method, size, bounces, spp, seed, threads, version (of Blender), warnings, and
        seconds: render (wall clock of Blender's operator: scene sync, BVH and light), read (passes to arrays),
        denoise.<layer>, denoise (all of them, guides included);  seconds_total: render + denoise, what the peer costs.

    Raises:
        SceneError: the scene cannot be rendered.
        Cancelled: the user stopped the render.
    """
    if not hasattr(scene, "cycles"):
        raise SceneError("Cycles is not enabled in this Blender; enable the add-on 'Cycles Render Engine'")
    camera = _camera(scene, settings.camera)
    view_layer = _view_layer(scene, settings.view_layer)
    frame = scene.frame_current, scene.frame_subframe
    width, height = settings.size or _size(scene)
    border = settings.border or _scene_border(scene, width, height)
    warnings = _differences(scene, camera)
    with _changed(_changes(scene, view_layer, camera, (width, height), border, settings, threads)):
        try:
            if settings.frame is not None:
                scene.frame_set(settings.frame)
            passes, seconds = _render(scene, view_layer)
        finally:
            if settings.frame is not None:
                scene.frame_set(frame[0], subframe=frame[1])
    layers = _layers(passes)
    if border is not None:
        layers.offset, layers.full_size = border[:2], (width, height)
    if settings.denoise:
        denoiser = denoiser or Denoiser()
        seconds |= denoise_layers(layers, settings, denoiser, threads=threads)
        warnings += [denoiser.warning] if denoiser.warning else []
    layers.metadata = {
        "method": "cycles",
        "settings": " ".join(f"{name}={value}" for name, value in dataclasses.asdict(settings).items() if value is not None),
        "blender": bpy.app.version_string,
    }
    return layers, {
        "method": "cycles+oidn" if settings.denoise else "cycles",
        "size": list(layers.size),
        "spp": settings.spp,
        "bounces": settings.bounces,
        "seed": settings.seed,
        "threads": threads,
        "version": bpy.app.version_string,
        "seconds": seconds,
        "seconds_total": seconds["render"] + seconds.get("denoise", 0.0),
        "warnings": warnings,
    }


def _camera(scene: bpy.types.Scene, name: str | None) -> bpy.types.Object:
    camera = scene.camera if name is None else scene.objects.get(name)
    if camera is None or camera.type != "CAMERA":
        there = ", ".join(repr(o.name) for o in scene.objects if o.type == "CAMERA") or "none"
        wanted = f"scene {scene.name!r} has no active camera" if name is None else f"scene {scene.name!r} has no camera called {name!r}"
        raise SceneError(f"{wanted}; cameras there: {there}; add one, or name one of these")
    return camera


def _view_layer(scene: bpy.types.Scene, name: str | None) -> bpy.types.ViewLayer:
    if name is None:
        return next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])
    if name not in scene.view_layers:
        there = ", ".join(repr(layer.name) for layer in scene.view_layers)
        raise SceneError(f"scene {scene.name!r} has no view layer called {name!r}; name one of {there}")
    return scene.view_layers[name]


def _size(scene: bpy.types.Scene) -> tuple[int, int]:
    render = scene.render
    return tuple(side * render.resolution_percentage // 100 for side in (render.resolution_x, render.resolution_y))


def _scene_border(scene: bpy.types.Scene, width: int, height: int) -> tuple[int, int, int, int] | None:
    """The scene's own render region in pixels, y down, cut off to whole pixels as Blender does."""
    render = scene.render
    if not render.use_border:
        return None
    x0, x1 = int(render.border_min_x * width), int(render.border_max_x * width)
    y0, y1 = int(render.border_min_y * height), int(render.border_max_y * height)
    return x0, height - y1, x1, height - y0


def _differences(scene: bpy.types.Scene, camera: bpy.types.Object) -> list[str]:
    """What of the scene's look is left out, because the contract's camera is a pinhole with an instant shutter."""
    warnings = []
    if scene.render.use_motion_blur:
        warnings.append(f"scene {scene.name!r}: motion blur is off in the reference")
    if camera.data.dof.use_dof:
        warnings.append(f"camera {camera.name!r}: depth of field is off in the reference")
    return warnings


def _border(border: tuple[int, int, int, int], width: int, height: int) -> dict[str, float]:
    """Blender's border (shares, y up) of a rectangle in pixels; the half pixel survives Blender's truncation."""
    x0, y0, x1, y1 = border
    if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
        raise SceneError(f"the border {border} does not lie in the picture of {width}x{height} pixels; give x0 y0 x1 y1 inside it")
    return {
        "border_min_x": (x0 + 0.5) / width,
        "border_max_x": min(1.0, (x1 + 0.5) / width),
        "border_min_y": (height - y1 + 0.5) / height,
        "border_max_y": min(1.0, (height - y0 + 0.5) / height),
    }


def _changes(scene, view_layer, camera, size: tuple[int, int], border, settings: ReferenceSettings, threads: int) -> list[tuple]:
    """(owner, values) of everything that a reference sets; what a version of Blender does not know is passed over."""
    width, height = size
    if min(size) < _SMALLEST_SIDE:
        raise SceneError(f"Cycles renders no picture of {width}x{height} pixels; both sides must be {_SMALLEST_SIDE} or more")
    return [
        # The engine first: its settings exist only once it is known.
        (
            scene.render,
            {
                "engine": "CYCLES",
                "resolution_x": width,
                "resolution_y": height,
                "resolution_percentage": 100,
                "use_border": border is not None,
                "use_crop_to_border": True,
                **(_border(border, width, height) if border else {}),
                "threads_mode": "FIXED" if threads else "AUTO",
                **({"threads": threads} if threads else {}),
                "use_motion_blur": False,
                "film_transparent": False,
                "use_compositing": False,
                "use_sequencer": False,
                "use_freestyle": False,
                "use_multiview": False,
                "use_stamp": False,
            },
        ),
        (scene, {"camera": camera}),
        (camera.data.dof, {"use_dof": False}),
        (
            scene.cycles,
            {
                "device": "CPU",
                "samples": settings.spp,
                "use_sample_subset": False,
                "sample_offset": 0,
                "time_limit": 0.0,
                "seed": settings.seed,
                "use_animated_seed": False,
                "use_adaptive_sampling": False,
                "use_denoising": False,
                "use_guiding": settings.guiding,
                "light_sampling_threshold": 0.0,
                "sample_clamp_direct": 0.0,
                "sample_clamp_indirect": 0.0,
                "blur_glossy": 0.0,
                "caustics_reflective": True,
                "caustics_refractive": True,
                "use_fast_gi": False,
                "min_light_bounces": 0,
                "min_transparent_bounces": 0,
                "diffuse_bounces": settings.bounces,
                "glossy_bounces": _MANY_BOUNCES,
                "transmission_bounces": _MANY_BOUNCES,
                "volume_bounces": _MANY_BOUNCES,
                "max_bounces": _MOST_BOUNCES,
                "transparent_max_bounces": _MOST_BOUNCES,
                "pixel_filter_type": "BOX",
                "filter_width": 1.0,
                "use_pixel_jitter": False,
                "film_exposure": 1.0,
                "film_transparent_glass": False,
            },
        ),
        *((layer, {"use": layer == view_layer}) for layer in scene.view_layers),
        (view_layer, {"samples": 0, **{f"use_pass_{name}": True for name in _PASSES}}),
        (view_layer.cycles, {f"use_pass_{name}": True for name in _VOLUME_PASSES}),
        # Kind before format before depth: each decides what the next may be, on the way back too.
        (
            scene.render.image_settings,
            {
                "media_type": "MULTI_LAYER_IMAGE",
                "file_format": "OPEN_EXR_MULTILAYER",
                "color_mode": "RGBA",
                "color_depth": "32",
                "exr_codec": "NONE",
            },
        ),
    ]


@contextmanager
def _changed(changes: list[tuple]) -> Iterator[None]:
    """RNA properties set inside the block, and as before after it."""
    before = []
    try:
        for owner, values in changes:
            values = {name: value for name, value in values.items() if hasattr(owner, name)}
            before += [(owner, name, getattr(owner, name)) for name in values]
            for name, value in values.items():
                setattr(owner, name, value)
        yield
    finally:
        for owner, name, value in before:
            setattr(owner, name, value)


def _render(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> tuple[Layers, dict]:
    """Cycles' passes by their long names, and the seconds of rendering and of reading them back."""
    start = time.perf_counter()
    try:
        with ending_amid():
            outcome = bpy.ops.render.render(scene=scene.name)
    except RuntimeError as error:
        raise SceneError(f"Cycles cannot render scene {scene.name!r}: {' '.join(str(error).split())}") from error
    if "FINISHED" not in outcome:
        raise Cancelled
    rendered = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "passes.exr"
        bpy.data.images["Render Result"].save_render(str(file), scene=scene)
        passes = read_exr(file, view_layer.name)
    passes.arrays = {_LONG_NAMES.get(name, name): array for name, array in passes.items()}
    return passes, {"render": rendered - start, "read": time.perf_counter() - rendered}


def _light(passes: Layers, kind: str, suffix: str) -> np.ndarray:
    """Outgoing radiance of one kind of scattering, (H, W, 3)."""
    return passes[f"{kind} {suffix}"] * passes[f"{kind} Color"]


def _layers(passes: Layers) -> Layers:
    """The layers of the contract from Cycles' passes."""
    albedo = passes["Diffuse Color"]
    rest = {
        suffix: _light(passes, "Glossy", suffix) + _light(passes, "Transmission", suffix) + passes[f"Volume {suffix}"]
        for suffix in ("Direct", "Indirect")
    }
    layers = Layers(view_layer=passes.view_layer)
    layers["Combined"] = passes["Combined"][..., :3]
    layers["Direct"] = _light(passes, "Diffuse", "Direct") + rest["Direct"]
    diffuse = _light(passes, "Diffuse", "Indirect")
    layers["Indirect"] = diffuse + rest["Indirect"]
    layers["DiffuseIndirect"] = diffuse
    layers["GlossyIndirect"] = rest["Indirect"]
    layers["Irradiance"] = np.where(albedo > 0, np.float32(np.pi) * passes["Diffuse Indirect"], 0)
    layers["Albedo"] = albedo
    layers["Emission"] = passes["Emission"] + passes["Environment"]
    layers["Normal"] = passes["Normal"]
    layers["Position"] = passes["Position"]
    layers["Depth"] = passes["Depth"]
    groups = {name: passes[name][..., :3] for name in passes if name.startswith(_GROUP)}
    if groups:
        layers.update(groups)
        layers[_GROUP + REMAINDER] = layers["Combined"] - sum(groups.values())
    return layers


def denoise_layers(layers: Layers, settings: ReferenceSettings, denoiser: Denoiser, *, threads: int = 0) -> dict:
    """Denoise the light layers of `settings` in place, rebuild those that depend on them, and return the seconds."""
    start, seconds = time.perf_counter(), {}
    albedo, normal = layers["Albedo"], layers["Normal"]
    if settings.prefilter:
        albedo, normal = (denoiser.prefilter(kind, guide, threads=threads) for kind, guide in (("albedo", albedo), ("normal", normal)))
    groups = [name for name in layers if name.startswith(_GROUP)]
    for name in (*settings.denoised, *groups):
        began = time.perf_counter()
        layers[name] = denoiser.denoise(
            layers[name], albedo, normal, position=layers["Position"], clean_aux=settings.prefilter, threads=threads
        )
        seconds[f"denoise.{name}"] = time.perf_counter() - began
    diffuse, color = layers["DiffuseIndirect"], layers["Albedo"]
    layers["Indirect"] = diffuse + layers["GlossyIndirect"]
    layers["Combined"] = layers["Direct"] + layers["Indirect"] + layers["Emission"]
    layers["Irradiance"] = np.float32(np.pi) * np.divide(diffuse, color, out=np.zeros_like(diffuse), where=color > 0)
    return seconds | {"denoise": time.perf_counter() - start}
