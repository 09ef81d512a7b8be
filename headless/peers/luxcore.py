"""The neutral scene in LuxCore, and a render of it by the path tracer, with or without its cache of indirect light (PhotonGI)."""

from __future__ import annotations

import importlib.util
from functools import cache
from time import perf_counter, sleep
from types import ModuleType

import numpy as np

from ...core.errors import SceneError
from ...core.layers import Layers
from ...core.scene import ELLIPSE, POINT, SPOT, SUN, Lamps
from ...core.threads import thread_count
from .neutral import Neutral, Sheet, back_of

NAME = "luxcore"
HINT = ""
# Kept for each sample a pixel: LuxCore's own way traces 2 million at once, 20 s before the first sample of a picture.
PHOTONS = 20_000
_OUTPUTS = {
    "Combined": "RGB",
    "Albedo": "ALBEDO",
    "Normal": "AVG_SHADING_NORMAL",
    "Position": "POSITION",
}
_ELLIPSE_CORNERS = 64
_POLL = 0.005  # s


@cache
def start() -> ModuleType:
    """The module `pyluxcore`.

    Raises:
        SceneError: it is not installed, or cannot be loaded here.
    """
    if importlib.util.find_spec("pyluxcore") is None:
        raise SceneError("LuxCore is not installed; pip install pyluxcore")
    try:
        import pyluxcore

        pyluxcore.Init()
    except (ImportError, OSError, RuntimeError) as error:
        raise SceneError(f"LuxCore cannot run: {str(error).strip().splitlines()[0]}") from error
    return pyluxcore


def version(neutral: Neutral | None = None) -> str:
    """Of LuxCore; it takes a scene as all that a `Worker` calls."""
    return start().Version()


def render(neutral: Neutral, cached: bool, spp: int, bounces: int, seed: int) -> tuple[Layers, float, float]:
    """Layers of the neutral scene, all light in `Direct`; the seconds from the arrays to the film; and those of the guides, which cost nothing.

    LuxCore's own layers are no help: to them light that a path meets by chance is indirect, and emission is no mean over a pixel.

    cached: with PhotonGI's indirect cache, at LuxCore's own settings but for the photons' bounces and their number (see `PHOTONS`).
    """
    lux = start()
    begin = perf_counter()
    session = lux.RenderSession(lux.RenderConfig(_properties(lux, _settings(neutral, cached, spp, bounces, seed)), load(lux, neutral)))
    session.Start()
    while not session.HasDone():  # `WaitForDone` would keep the lock that LuxCore's own messages wait for
        sleep(_POLL)
        session.UpdateStats()
    session.Stop()
    film = session.GetFilm()
    arrays = {name: _output(lux, film, output) for name, output in _OUTPUTS.items()}
    seconds = perf_counter() - begin
    nothing = np.zeros_like(arrays["Combined"])
    nowhere = dict.fromkeys(("DiffuseIndirect", "GlossyIndirect", "Indirect", "Emission"), nothing)
    return Layers({**arrays, "Direct": arrays["Combined"], **nowhere}), seconds, 0.0


def direct(neutral: Neutral, spp: int, seed: int) -> np.ndarray:
    """(H, W, 3) direct light, and emission where it is seen."""
    return render(neutral, False, spp, 0, seed)[0]["Combined"]


def _properties(lux: ModuleType, values: dict):
    properties = lux.Properties()
    for name, value in values.items():
        properties.Set(lux.Property(name, value))
    return properties


def _settings(neutral: Neutral, cached: bool, spp: int, bounces: int, seed: int) -> dict:
    outputs = {f"film.outputs.{k}.type": output for k, output in enumerate(_OUTPUTS.values())}
    outputs |= {f"film.outputs.{k}.filename": f"{output}.exr" for k, output in enumerate(_OUTPUTS.values())}
    depth = bounces + 2
    return {
        "renderengine.type": "PATHCPU",
        "renderengine.seed": seed + 1,
        "sampler.type": "SOBOL",
        "native.threads.count": thread_count(),
        "film.opencl.enable": False,
        "film.width": neutral.camera.width,
        "film.height": neutral.camera.height,
        "film.filter.type": "BOX",
        "film.filter.width": 0.5,
        "batch.haltspp": [spp, 0],
        "path.pathdepth.total": depth,
        "path.pathdepth.diffuse": depth,
        "path.pathdepth.glossy": depth,
        "path.pathdepth.specular": depth,
        "path.photongi.indirect.enabled": cached,
        "path.photongi.photon.maxdepth": bounces,
        "path.photongi.indirect.maxsize": PHOTONS * spp,
        **outputs,
    }


def _output(lux: ModuleType, film, output: str) -> np.ndarray:
    """(H, W, 3) of the film, first row at the top; what no sample has seen is 0."""
    pixels = np.zeros(film.GetWidth() * film.GetHeight() * 3, np.float32)
    film.GetOutputFloat(getattr(lux.FilmOutputType, output), pixels)
    return np.nan_to_num(pixels.reshape(film.GetHeight(), film.GetWidth(), 3)[::-1], posinf=0, neginf=0)


def load(lux: ModuleType, neutral: Neutral):
    """LuxCore's scene."""
    scene, values = lux.Scene(), _camera(neutral)
    for number, sheet in enumerate(neutral.sheets):
        material = f"surface{number}"
        values |= _surface(scene, material, sheet)
        for side, shape in enumerate([sheet, back_of(sheet, neutral.extent)] if sheet.surface.shines else [sheet]):
            values |= _object(scene, f"sheet{number}-{side}", shape, material)
    for number in range(len(neutral.lamps)):
        values |= _lamp(scene, neutral.lamps, number)
    if neutral.world.any():
        values |= _world(scene, neutral.world)
    scene.Parse(_properties(lux, values))
    return scene


def _camera(neutral: Neutral) -> dict:
    camera = neutral.camera
    left, right, bottom, top = camera.window
    row = (top - bottom) / camera.height  # LuxCore's rows lie one higher than those of the window
    position, ahead, up = camera.matrix[:3, 3], -camera.matrix[:3, 2], camera.matrix[:3, 1]
    return {
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": position.tolist(),
        "scene.camera.lookat.target": (position + ahead).tolist(),
        "scene.camera.up": up.tolist(),
        "scene.camera.fieldofview": 90.0,  # at which the window counts in units of the distance
        "scene.camera.screenwindow": [left, right, bottom - row, top - row],
        "scene.camera.autofocus.enable": False,
        "scene.camera.lensradius": 0.0,
        "scene.camera.cliphither": float(camera.near),
        "scene.camera.clipyon": float(camera.far),
    }


def _texture(scene, name: str, values: np.ndarray) -> tuple[dict, object]:
    """Properties of an image of values in 0..1 with row 0 at the bottom, and its name; of a constant none, and the value."""
    if values.ndim < 2:
        return {}, values.tolist() if values.ndim else [float(values)] * 3
    height, width = values.shape[:2]
    pixels = np.ascontiguousarray(values[::-1], np.float32)
    scene.DefineImageMap(name, pixels, 1.0, 3 if values.ndim == 3 else 1, width, height)
    start = f"scene.textures.{name}"
    return {f"{start}.type": "imagemap", f"{start}.file": name, f"{start}.gamma": 1.0, f"{start}.mapping.uvscale": [1.0, -1.0]}, name


def _surface(scene, material: str, sheet: Sheet) -> dict:
    surface, start = sheet.surface, f"scene.materials.{material}"
    values, albedo = _texture(scene, f"{material}-albedo", surface.albedo)
    values |= {f"{start}.type": "matte", f"{start}.kd": albedo}
    if not surface.is_opaque:
        image, opacity = _texture(scene, f"{material}-opacity", surface.opacity)
        values |= image | {f"{start}.transparency": opacity}
    if surface.shines:
        values |= {f"{start}.emission": surface.emission.tolist()}
    return values


def _object(scene, name: str, sheet: Sheet, material: str) -> dict:
    count = 3 * len(sheet.positions)
    corners = np.arange(count, dtype=np.uint32).reshape(-1, 3)
    positions, normals, uv = sheet.positions.reshape(-1, 3), sheet.normals.reshape(-1, 3), sheet.uv.reshape(-1, 2)
    scene.DefineMeshExt(name, positions, corners, normals=normals, uvs=[uv])
    return {f"scene.objects.{name}.shape": name, f"scene.objects.{name}.material": material}


def _lamp(scene, lamps: Lamps, number: int) -> dict:
    kind, position, axes = int(lamps.kind[number]), lamps.position[number].astype(float), lamps.axes[number].astype(float)
    gain = lamps.emission[number].astype(float)
    if kind not in (POINT, SPOT, SUN):
        return _area(scene, lamps, number)
    start = f"scene.lights.lamp{number}"
    values = {f"{start}.gain": gain.tolist(), f"{start}.color": [1.0, 1.0, 1.0], f"{start}.power": 0.0, f"{start}.efficency": 0.0}
    if kind == SUN:
        return values | {f"{start}.type": "sharpdistant", f"{start}.direction": (-axes[2]).tolist()}
    if kind == POINT:
        power = 4 * np.pi * gain  # of a point, LuxCore asks for all of it
        return values | {f"{start}.type": "point", f"{start}.position": position.tolist(), f"{start}.gain": power.tolist()}
    half = float(np.degrees(0.5 * lamps.angle[number]))
    return values | {
        f"{start}.type": "spot",
        f"{start}.position": position.tolist(),
        f"{start}.target": (position - axes[2]).tolist(),
        f"{start}.coneangle": half,
        f"{start}.conedeltaangle": 0.0,
    }


def _area(scene, lamps: Lamps, number: int) -> dict:
    """An area lamp is a black sheet that shines on its front."""
    x, y = lamps.axes[number, :2]
    if lamps.shape[number] == ELLIPSE:
        angle = np.arange(_ELLIPSE_CORNERS) * (2 * np.pi / _ELLIPSE_CORNERS)
        # Of the ellipse's own area.
        rim = np.stack([np.cos(angle), np.sin(angle)], 1) / np.sqrt(np.sinc(2 / _ELLIPSE_CORNERS))
    else:
        rim = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    around = 0.5 * rim * lamps.size[number]
    places = (lamps.position[number] + around[:, :1] * x - around[:, 1:] * y).astype(np.float32)
    corners = np.array([(0, k, k + 1) for k in range(1, len(places) - 1)], np.uint32)
    name = f"lamp{number}"
    scene.DefineMeshExt(name, places, corners)
    start = f"scene.materials.{name}"
    return {
        f"{start}.type": "matte",
        f"{start}.kd": [0.0, 0.0, 0.0],
        f"{start}.emission": lamps.emission[number].tolist(),
        f"scene.objects.{name}.shape": name,
        f"scene.objects.{name}.material": name,
    }


def _world(scene, radiance: np.ndarray) -> dict:
    start = "scene.lights.world"
    if radiance.ndim == 1:
        return {f"{start}.type": "constantinfinite", f"{start}.color": [1.0, 1.0, 1.0], f"{start}.gain": radiance.tolist()}
    height, width = radiance.shape[:2]
    mirrored = np.roll(radiance[:, ::-1], width // 2, axis=1)  # LuxCore's azimuth runs the other way, from -x
    scene.DefineImageMap("world", np.ascontiguousarray(mirrored), 1.0, 3, width, height)
    return {f"{start}.type": "infinite", f"{start}.file": "world", f"{start}.gamma": 1.0}
