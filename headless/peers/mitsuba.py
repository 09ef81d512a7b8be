"""The neutral scene in Mitsuba 3, and a render of it by the path tracer.

Direct and indirect light are told apart by the difference of renders of one seed that end paths sooner: each sample takes the same way as far
as both go, so that the difference is exactly the light of the longer paths.  Only the longest render counts as time.  This needs a variant that
traces all samples of a picture at once, each with random numbers of its own (`llvm_ad_rgb`).

To the shadow rays of the integrator `path` a cut-out is opaque; `volpath`, which lets them through, takes twice the time.
"""

from __future__ import annotations

import importlib.util
from functools import cache
from time import perf_counter
from types import ModuleType

import numpy as np

from ...core.errors import SceneError
from ...core.layers import Layers
from ...core.scene import ELLIPSE, POINT, SPOT, SUN, Lamps
from ...core.threads import thread_count
from .neutral import Neutral, Sheet, Surface, back_of

NAME = "mitsuba"
VARIANT = "llvm_ad_rgb"
HINT = "; Mitsuba needs an LLVM library of version 19, which DRJIT_LIBLLVM_PATH may name"
# From Mitsuba's environment (y up; the middle of the map along +z) to Blender's (z up; the middle along +x).
_WORLD = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@cache
def start() -> ModuleType:
    """The module `mitsuba`, set to the variant, with as many threads as everyone has.

    Raises:
        SceneError: it is not installed, or its variant cannot run here.
    """
    if importlib.util.find_spec("mitsuba") is None:
        raise SceneError("Mitsuba is not installed; pip install mitsuba")
    try:
        import drjit
        import mitsuba

        mitsuba.set_variant(VARIANT)
    except (ImportError, RuntimeError) as error:
        raise SceneError(f"Mitsuba cannot run: {str(error).strip().splitlines()[0]}{HINT}") from error
    drjit.set_thread_count(thread_count())
    return mitsuba


def version(neutral: Neutral | None = None) -> str:
    """Of Mitsuba, with its variant; it takes a scene as all that a `Worker` calls."""
    return f"{start().__version__} {VARIANT}"


def load(mi: ModuleType, neutral: Neutral):
    """Mitsuba's scene."""
    parts: dict = {"type": "scene", "sensor": _sensor(mi, neutral)}
    for number, sheet in enumerate(neutral.sheets):
        surface = _surface(mi, sheet.surface)
        shapes = [sheet, back_of(sheet, neutral.extent)] if sheet.surface.shines else [sheet]
        parts |= {f"sheet{number}_{side}": _shape(mi, shape, surface) for side, shape in enumerate(shapes)}
    parts |= {f"lamp{number}": _lamp(mi, neutral.lamps, number) for number in range(len(neutral.lamps))}
    if neutral.world.any():
        parts["world"] = _world(mi, neutral.world)
    return mi.load_dict(parts)


def render(neutral: Neutral, kind: str, spp: int, bounces: int, seed: int) -> tuple[Layers, float, float]:
    """Layers of the neutral scene by the integrator `kind`, with guides for a denoiser.

    Also the seconds of loading the scene and of the render with all bounces, and those of the guides: in one render with them the path tracer
    takes twice the time.
    """
    mi = start()
    begin = perf_counter()
    scene = load(mi, neutral)
    light = _render(mi, scene, {"type": kind, "max_depth": bounces + 2}, spp, seed)
    rendered = perf_counter()
    guides = _render(mi, scene, {"type": "aov", "aovs": "Albedo:albedo,Normal:sh_normal,Position:position"}, spp, seed)
    guided = perf_counter()
    direct, emission = (_render(mi, scene, {"type": kind, "max_depth": depth}, spp, seed) for depth in (2, 1))
    layers = Layers({"Combined": light, "Direct": direct - emission, "DiffuseIndirect": light - direct, "Emission": emission})
    layers["Indirect"], layers["GlossyIndirect"] = layers["DiffuseIndirect"], np.zeros_like(light)
    for number, name in enumerate(("Albedo", "Normal", "Position")):
        layers[name] = guides[..., 3 * number : 3 * number + 3]
    return layers, rendered - begin, guided - rendered


def direct(neutral: Neutral, kind: str, spp: int, seed: int) -> np.ndarray:
    """(H, W, 3) direct light."""
    mi = start()
    scene = load(mi, neutral)
    light, emission = (_render(mi, scene, {"type": kind, "max_depth": depth}, spp, seed) for depth in (2, 1))
    return light - emission


def _render(mi: ModuleType, scene, integrator: dict, spp: int, seed: int) -> np.ndarray:
    """(H, W, C) of an integrator."""
    return np.array(mi.render(scene, integrator=mi.load_dict(integrator), spp=spp, seed=seed), np.float32)


def _sensor(mi: ModuleType, neutral: Neutral) -> dict:
    camera = neutral.camera
    left, right, bottom, top = camera.window
    turned = camera.matrix @ np.diag([-1.0, 1, -1, 1])  # Mitsuba looks along +z, x to the left
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f(turned.tolist()),
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(0.5 * (right - left)))),
        "principal_point_offset_x": 0.5 * (left + right) / (right - left),
        "principal_point_offset_y": -0.5 * (bottom + top) / (top - bottom),
        "near_clip": float(camera.near),
        "far_clip": float(camera.far),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }


def _texture(mi: ModuleType, values: np.ndarray) -> dict:
    """Of values in 0..1, one (3,) or (), or an image with row 0 at the bottom, where Mitsuba has v = 0 as well."""
    if values.ndim < 2:
        return {"type": "rgb", "value": values.tolist()} if values.ndim else {"type": "uniform", "value": float(values)}
    pixels = np.ascontiguousarray(np.round(values * 255).astype(np.uint8))
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels if pixels.ndim == 3 else pixels[..., None]), "raw": True}


def _surface(mi: ModuleType, surface: Surface):
    bsdf = {"type": "twosided", "sides": {"type": "diffuse", "reflectance": _texture(mi, surface.albedo)}}
    if not surface.is_opaque:
        opacity = _texture(mi, surface.opacity) if surface.opacity.ndim else float(surface.opacity)
        bsdf = {"type": "mask", "opacity": opacity, "solid": bsdf}
    return mi.load_dict(bsdf)


def _shape(mi: ModuleType, sheet: Sheet, bsdf):
    count = 3 * len(sheet.positions)
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    if sheet.surface.shines:
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": sheet.surface.emission.tolist()}})
    mesh = mi.Mesh(sheet.surface.name, count, len(sheet.positions), has_vertex_normals=True, has_vertex_texcoords=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["faces"] = np.arange(count, dtype=np.uint32)
    parameters["vertex_positions"] = sheet.positions.ravel()
    parameters["vertex_normals"] = sheet.normals.ravel()
    parameters["vertex_texcoords"] = sheet.uv.ravel()
    parameters.update()
    return mesh


def _lamp(mi: ModuleType, lamps: Lamps, number: int) -> dict:
    kind, position, axes = int(lamps.kind[number]), lamps.position[number].astype(float), lamps.axes[number].astype(float)
    emission = {"type": "rgb", "value": lamps.emission[number].tolist()}
    if kind == POINT:
        return {"type": "point", "position": position.tolist(), "intensity": emission}
    if kind == SUN:
        return {"type": "directional", "direction": (-axes[2]).tolist(), "irradiance": emission}
    placed = np.eye(4)
    placed[:3, :3], placed[:3, 3] = axes.T @ np.diag([-1.0, 1, -1]), position  # emitters of Mitsuba shine along +z
    if kind == SPOT:
        half = float(np.degrees(0.5 * lamps.angle[number]))
        return {
            "type": "spot",
            "to_world": mi.ScalarTransform4f(placed.tolist()),
            "intensity": emission,
            "cutoff_angle": half,
            "beam_width": half,
        }
    placed[:3, :3] = placed[:3, :3] @ np.diag([*(0.5 * lamps.size[number].astype(float)), 1])
    return {
        "type": "disk" if lamps.shape[number] == ELLIPSE else "rectangle",
        "to_world": mi.ScalarTransform4f(placed.tolist()),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
        "emitter": {"type": "area", "radiance": emission},
    }


def _world(mi: ModuleType, radiance: np.ndarray) -> dict:
    if radiance.ndim == 1:
        return {"type": "constant", "radiance": {"type": "rgb", "value": radiance.tolist()}}
    return {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(radiance)), "to_world": mi.ScalarTransform4f(_WORLD.tolist())}
