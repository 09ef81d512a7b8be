"""The world: lookup, densities over its pixels, and directions drawn from them.

Each pixel of the equirectangular image is a patch of constant radiance, for lookups, direct light and particles
alike, so that they agree exactly.  Direct light mixes a cosine density with one of max(L - mean, 0), which leaves
the even part of a sky to the cosine (MIS compensation: Karlik et al. 2019).
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf
from ..sampling.discrete import cumulative, sample_cdf
from ..sampling.maps import cosine_hemisphere, to_world
from ..scene import World
from .tables import WorldTable

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)
_PI = np.float32(math.pi)
_1_PI = np.float32(1 / math.pi)
_2PI = np.float32(2 * math.pi)
_1_2PI = np.float32(0.5 / math.pi)


def pixel_directions(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (H, W, 3) of the pixels' centres, and solid angles (H, 1) of each row's pixels (sr), float64."""
    theta = np.pi * (np.arange(height) + 0.5)[:, None] / height
    phi = np.pi - 2 * np.pi * (np.arange(width) + 0.5)[None] / width
    z = np.broadcast_to(np.cos(theta), (height, width))
    direction = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), z], -1)
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return direction, (2 * np.pi / width) * (edges[:-1] - edges[1:])[:, None]


def projected_box_area(box: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Area (...) of the shadow that the box (2, 3) casts along directions (..., 3), m^2."""
    x, y, z = np.asarray(box[1], np.float64) - box[0]
    return np.abs(direction) @ np.array([y * z, z * x, x * y])


def _entering(box: np.ndarray, height: int, width: int) -> np.ndarray:
    """(H, W): what a unit radiance in each pixel sends into the box, m^2 sr; coarse pixels in finer parts."""
    parts = max(1, -(-64 // height))
    direction, solid_angle = pixel_directions(height * parts, width * parts)
    fine = projected_box_area(box, direction) * solid_angle
    return fine.reshape(height, parts, width, parts).sum((1, 3))


def world_table(radiance: np.ndarray, box: np.ndarray, sought: float = 1.0) -> tuple[WorldTable, np.ndarray, np.ndarray]:
    """Table of a world (H, W, 3), its mean radiance (3,) and the flux (3,) that it sends into the box (W).

    sought: as of `World`.
    """
    radiance = np.ascontiguousarray(radiance, np.float32)
    height, width = radiance.shape[:2]
    constant = bool((radiance == radiance[0, 0]).all())
    if constant:
        radiance = radiance[:1, :1]
        # A constant world needs no fine image, but its particles follow the projected area of the box.
        height, width = 32, 64
    radiance_for_density = np.broadcast_to(radiance, (height, width, 3)).astype(np.float64)
    direction, solid_angle = pixel_directions(height, width)
    mean = (radiance_for_density * solid_angle[..., None]).sum((0, 1)) / (4 * np.pi)
    value = radiance_for_density.mean(-1)
    above = np.maximum(value - mean.mean(), 0) * solid_angle
    entering = _entering(box, height, width)
    emitted = value * entering
    harmonics = (value[..., None] * solid_angle[..., None] * direction).sum((0, 1)) / 2
    table = WorldTable(
        radiance=radiance,
        rows=cumulative(above.sum(1)),
        columns=cumulative(above),
        emission_rows=cumulative(emitted.sum(1)),
        emission_columns=cumulative(emitted),
        varies=not constant,
        estimate=np.array([np.pi * mean.mean(), *harmonics], np.float32),
        sought=np.float32(sought),
    )
    flux = (radiance_for_density * entering[..., None]).sum((0, 1))
    return table, mean, flux


def no_world() -> WorldTable:
    """The table of a world without light."""
    return world_table(np.zeros((1, 1, 3), np.float32), np.zeros((2, 3)))[0]


def world_tables(world: World) -> WorldTable:
    """The world, whatever rays may see it, for `world_radiance`."""
    return world_table(world.radiance, np.zeros((2, 3)))[0]


@inlined
def _pixel(world, dx, dy, dz, height, width):
    y = np.int64(np.float32(math.acos(min(max(dz, -_1), _1))) * _1_PI * np.float32(height))
    x = np.int64((_HALF - np.float32(math.atan2(dy, dx)) * _1_2PI) * np.float32(width))
    return min(y, height - 1), min(max(x, 0), width - 1)


@inlined
def world_radiance(world, dx, dy, dz):
    """Radiance (r, g, b) that comes from the unit direction d."""
    height, width = world.radiance.shape[0], world.radiance.shape[1]
    y, x = _pixel(world, dx, dy, dz, height, width)
    return world.radiance[y, x, 0], world.radiance[y, x, 1], world.radiance[y, x, 2]


@inlined
def _row_edge(y, height):
    return np.float32(math.cos(math.pi * y / height))


@inlined
def _sample_pixel(rows, columns, u1, u2):
    """Direction, uniform within a pixel drawn from the CDFs -> (d, row, column, density per sr)."""
    height, width = columns.shape[0], columns.shape[1] - 1
    y, v, p_row = sample_cdf(rows, u1)
    x, u, p_column = sample_cdf(columns[y], u2)
    top, bottom = _row_edge(y, height), _row_edge(y + 1, height)
    z = top + v * (bottom - top)
    phi = _PI - _2PI * (np.float32(x) + u) / np.float32(width)
    r = np.float32(math.sqrt(max(_0, _1 - z * z)))
    density = p_row * p_column * np.float32(width) / (_2PI * (top - bottom))
    return r * np.float32(math.cos(phi)), r * np.float32(math.sin(phi)), z, y, x, density


@inlined
def _pixel_density(world, y, x, height, width):
    """Density (per sr) of drawing a direction in pixel (y, x) from the CDFs for direct light."""
    p = (world.rows[y + 1] - world.rows[y]) * (world.columns[y, x + 1] - world.columns[y, x])
    return p * np.float32(width) / (_2PI * (_row_edge(y, height) - _row_edge(y + 1, height)))


@leaf
def world_density(world, nx, ny, nz, dx, dy, dz):
    """Density (per sr) with which `sample_world` gives the direction d on a surface with normal n."""
    cosine = max(_0, dx * nx + dy * ny + dz * nz)
    if not world.varies:
        return cosine * _1_PI
    height, width = world.radiance.shape[0], world.radiance.shape[1]
    y, x = _pixel(world, dx, dy, dz, height, width)
    return _HALF * (cosine * _1_PI + _pixel_density(world, y, x, height, width))


@leaf
def sample_world(world, nx, ny, nz, u1, u2):
    """Direction for direct light on a surface with normal n -> (d, radiance / density): six float32."""
    if not world.varies:
        lx, ly, lz = cosine_hemisphere(u1, u2)
        dx, dy, dz = to_world(lx, ly, lz, nx, ny, nz)
        w = _PI / max(lz, np.float32(1e-6))
        return dx, dy, dz, world.radiance[0, 0, 0] * w, world.radiance[0, 0, 1] * w, world.radiance[0, 0, 2] * w
    height, width = world.radiance.shape[0], world.radiance.shape[1]
    if u1 < _HALF:
        lx, ly, lz = cosine_hemisphere(u1 * _2, u2)
        dx, dy, dz = to_world(lx, ly, lz, nx, ny, nz)
        cosine = lz
        y, x = _pixel(world, dx, dy, dz, height, width)
        density = _pixel_density(world, y, x, height, width)
    else:
        dx, dy, dz, y, x, density = _sample_pixel(world.rows, world.columns, u1 * _2 - _1, u2)
        cosine = max(_0, dx * nx + dy * ny + dz * nz)
    both = _HALF * (cosine * _1_PI + density)
    w = _1 / max(both, np.float32(1e-12))
    return dx, dy, dz, world.radiance[y, x, 0] * w, world.radiance[y, x, 1] * w, world.radiance[y, x, 2] * w


@leaf
def emit_world(world, u1, u2):
    """Direction towards the world for a particle -> (d, radiance / density): six float32."""
    dx, dy, dz, y, x, density = _sample_pixel(world.emission_rows, world.emission_columns, u1, u2)
    w = _1 / density
    y, x = y * world.varies, x * world.varies
    return dx, dy, dz, world.radiance[y, x, 0] * w, world.radiance[y, x, 1] * w, world.radiance[y, x, 2] * w
