"""The room that stress cases break in one way at a time, and its light by each method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core import scene as sc
from ...core.layers import Layers
from ...core.pipeline import render
from ...core.settings import RenderSettings
from . import arrays

SETTINGS = RenderSettings(
    vpls=128, bounces=3, pixel_samples=2, direct_samples=4, samples=8, gather=8, vals=16, voxels=32, vpl_clusters=32, point_clusters=64,
    denoise=False, threads=1, seed=5,
)  # fmt: skip
WALLS = ((0.7, 0.2, 0.1), (0.1, 0.6, 0.2), (0.6, 0.6, 0.6), (0.4, 0.4, 0.5))  # albedos: -x, +x, the other sides, the block
BLOCK = ((-0.5, -0.4, -1), (0.1, 0.3, -0.3))


def room_mesh() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and materials (of `WALLS`) of a closed room of 2 m with a block in it."""
    walls = (*arrays.box((-1, -1, -1), (1, 1, 1)), np.repeat([0, 1, 2, 2, 2, 2], 2))
    return arrays.join(walls, (*arrays.box(*BLOCK, inward=False), 3))


def bulb(scale: float = 1.0, power: float = 1.0, position=(0.4, 0.2, 0.6)) -> sc.Lamps:
    """A point lamp that gives the same irradiance in a room of any scale."""
    return arrays.lamp(sc.POINT, power * scale**2, scale * np.asarray(position, float))


def view(scale: float = 1.0, size: tuple[int, int] = (24, 16)) -> sc.Camera:
    """From under the ceiling down into the room."""
    return arrays.camera((0, 0, 0.95 * scale), *size, near=1e-3 * scale, far=1e3 * scale)


def room(scale: float = 1.0, power: float = 1.0, albedos=WALLS, size=(24, 16), lamps: sc.Lamps | None = None, extra=(), **more) -> sc.Scene:
    """The room at `scale`, lit by `lamps` (the bulb); extra: further (vertices, triangles, material) parts; more: of `arrays.geometry`."""
    vertices, triangles, material = arrays.join(room_mesh(), *extra)
    return arrays.scene(
        arrays.geometry(scale * np.asarray(vertices), triangles, material, **more),
        arrays.materials(*((albedo, 0.0) for albedo in albedos)),
        lamps=bulb(scale, power) if lamps is None else lamps,
        camera=view(scale, size),
    )


def light(scene: sc.Scene, method: str, **changes) -> Layers:
    """All layers of `scene` by `method`."""
    return render(scene, replace(SETTINGS, method=method, **changes)).layers


def irradiance(layers: Layers) -> float:
    """Mean indirect irradiance of a picture, W/m^2; NaN where any layer holds a value that is no number."""
    if not all(np.isfinite(layer).all() for layer in layers.values()):
        return float("nan")
    return float(layers["Irradiance"].mean(dtype=np.float64))
