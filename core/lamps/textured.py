"""Lamps whose nodes make them shine unevenly: what they show a ray, and where their light leaves.

Cycles runs a lamp's nodes for each ray that leaves it.  So does this: they are compiled as a material's are, and read where and how the ray
leaves in rows of their own (`program.LAMP_NORMAL` and those after it).  A lamp's light is its mean, of which the tables
of emitters know, times what the nodes make of a ray over their mean.  By maps of that, particles are drawn; rays that are
aimed at a lamp need none.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, kernel, leaf
from ..sampling.discrete import cumulative, sample_cdf
from ..sampling.sequences import r2_points
from ..scene import AREA, SUN, MaterialTables
from ..surfaces.layout import EMISSION, SURFACE
from ..surfaces.program import LAMP_INCOMING, LAMP_NORMAL, LAMP_PLACE, REGISTERS, evaluate, new_registers
from ..threads import run_chunks
from .tables import (
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    COS_INNER,
    COS_OUTER,
    ELLIPTIC,
    MAP,
    ONE_MINUS_COS,
    PER_MEAN,
    POSITION,
    PROGRAM,
    RADIUS,
    SIZE,
    SOFT,
    TAN_HALF_SPREAD,
    TEXTURED,
    EmissionMaps,
)  # fmt: skip

HEIGHT, WIDTH = 32, 64  # cells of a map
_RAYS = 9  # of a cell, to know its mean
_CHUNK = 4096
_LOWEST = 0.02  # of the mean of a map: what its darkest cells count, whose few rays may have missed a spark
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)
_PI = np.float32(math.pi)
_2PI = np.float32(2 * math.pi)
_BELOW_ONE = np.float32(0.99999994)


@inlined
def _given(rows, row, x, y, z):
    rows[REGISTERS + row, 0], rows[REGISTERS + row, 1], rows[REGISTERS + row, 2], rows[REGISTERS + row, 3] = x, y, z, _1


@leaf
def shown(materials, attributes, kind, flags, lamps, i, x, y, z, dx, dy, dz, rows, surface):
    """What lamp i shows a ray that meets it, over the mean of all that it sends -> (r, g, b).

    kind, flags: its own.  lamps: as in `Emitters`.  (x, y, z): where the ray leaves it, relative to its position; anything for a sun.
    d: unit direction of the ray towards the lamp, against its light.  rows, surface: scratch.
    """
    nx, ny, nz = -dx, -dy, -dz
    if kind == AREA:
        nx, ny, nz = -lamps[i, AXIS_Z], -lamps[i, AXIS_Z + 1], -lamps[i, AXIS_Z + 2]
    elif kind == SUN:
        x, y, z = nx, ny, nz
    elif lamps[i, RADIUS] > _0 and not flags & SOFT:
        length = np.float32(math.sqrt(x * x + y * y + z * z))
        if length > _0:
            nx, ny, nz = x / length, y / length, z / length
    cosine = -(nx * dx + ny * dy + nz * dz)
    ax, ay, az = lamps[i, AXIS_X], lamps[i, AXIS_X + 1], lamps[i, AXIS_X + 2]
    bx, by, bz = lamps[i, AXIS_Y], lamps[i, AXIS_Y + 1], lamps[i, AXIS_Y + 2]
    cx, cy, cz = lamps[i, AXIS_Z], lamps[i, AXIS_Z + 1], lamps[i, AXIS_Z + 2]
    _given(rows, LAMP_NORMAL, ax * nx + ay * ny + az * nz, bx * nx + by * ny + bz * nz, cx * nx + cy * ny + cz * nz)
    _given(rows, LAMP_INCOMING, -(ax * dx + ay * dy + az * dz), -(bx * dx + by * dy + bz * dz), -(cx * dx + cy * dy + cz * dz))
    _given(rows, LAMP_PLACE, ax * x + ay * y + az * z, bx * x + by * y + bz * z, cx * x + cy * y + cz * z)
    k = lamps[i, PER_MEAN]
    evaluate(materials, np.int64(lamps[i, PROGRAM]), attributes, 0, _0, _0, cosine, rows, surface)
    return k * surface[EMISSION], k * surface[EMISSION + 1], k * surface[EMISSION + 2]


@inlined
def shown_from(materials, attributes, kind, flags, lamps, i, px, py, pz, dx, dy, dz, t, rows, surface):
    """`shown` for the ray from p that meets lamp i at the distance t along d."""
    if kind == SUN:
        t = _0
    x, y, z = px + t * dx - lamps[i, POSITION], py + t * dy - lamps[i, POSITION + 1], pz + t * dz - lamps[i, POSITION + 2]
    return shown(materials, attributes, kind, flags, lamps, i, x, y, z, dx, dy, dz, rows, surface)


@leaf
def draw_direction(maps, lamps, i, u1, u2):
    """Direction of a particle of point or spot lamp i, by its map -> (x, y, z)."""
    k = np.int64(lamps[i, MAP])
    row, v, _ = sample_cdf(maps.rows[k], u1)
    column, u, _ = sample_cdf(maps.columns[k, row], u2)
    z = _1 - np.float32(2.0 / HEIGHT) * (np.float32(row) + v)
    phi = np.float32(2 * math.pi / WIDTH) * (np.float32(column) + u)
    r = np.float32(math.sqrt(max(_0, _1 - z * z)))
    x, y = r * np.float32(math.cos(phi)), r * np.float32(math.sin(phi))
    return (
        x * lamps[i, AXIS_X] + y * lamps[i, AXIS_Y] + z * lamps[i, AXIS_Z],
        x * lamps[i, AXIS_X + 1] + y * lamps[i, AXIS_Y + 1] + z * lamps[i, AXIS_Z + 1],
        x * lamps[i, AXIS_X + 2] + y * lamps[i, AXIS_Y + 2] + z * lamps[i, AXIS_Z + 2],
    )


@inlined
def _cell_chance(maps, k, row, column):
    return (maps.rows[k, row + 1] - maps.rows[k, row]) * (maps.columns[k, row, column + 1] - maps.columns[k, row, column])


@leaf
def direction_density(maps, lamps, i, dx, dy, dz):
    """Density (per sr) of `draw_direction`."""
    x = dx * lamps[i, AXIS_X] + dy * lamps[i, AXIS_X + 1] + dz * lamps[i, AXIS_X + 2]
    y = dx * lamps[i, AXIS_Y] + dy * lamps[i, AXIS_Y + 1] + dz * lamps[i, AXIS_Y + 2]
    z = dx * lamps[i, AXIS_Z] + dy * lamps[i, AXIS_Z + 1] + dz * lamps[i, AXIS_Z + 2]
    row = np.int64(max(_0, (_1 - z) * np.float32(HEIGHT / 2)))
    phi = np.float32(math.atan2(y, x))
    column = np.int64((phi + _2PI if phi < _0 else phi) * np.float32(WIDTH / (2 * math.pi)))
    chance = _cell_chance(maps, np.int64(lamps[i, MAP]), min(row, HEIGHT - 1), min(column, WIDTH - 1))
    return chance * np.float32(HEIGHT * WIDTH / (4 * math.pi))


@leaf
def draw_place(maps, lamps, i, u1, u2):
    """Place of a particle on area lamp i, by its map -> (x, y) in -1/2..1/2, of its widths."""
    k = np.int64(lamps[i, MAP])
    row, v, _ = sample_cdf(maps.rows[k], u2)
    column, u, _ = sample_cdf(maps.columns[k, row], u1)
    return (np.float32(column) + u) * np.float32(1 / WIDTH) - _HALF, (np.float32(row) + v) * np.float32(1 / HEIGHT) - _HALF


@leaf
def place_density(maps, lamps, i, a, b):
    """Density of `draw_place`, of which the whole rectangle has the area 1."""
    column, row = np.int64((a + _HALF) * np.float32(WIDTH)), np.int64((b + _HALF) * np.float32(HEIGHT))
    chance = _cell_chance(maps, np.int64(lamps[i, MAP]), min(max(row, 0), HEIGHT - 1), min(max(column, 0), WIDTH - 1))
    return chance * np.float32(HEIGHT * WIDTH)


@kernel
def _rays_shown(materials, kind, flags, lamps, i, place, direction, begin, end, out):
    """`shown` for the rays begin..end-1 of one lamp; place, direction, out: (N, 3)."""
    rows = new_registers(materials)
    surface = np.zeros(SURFACE, np.float32)
    attributes = np.zeros((0, 0, 3, 4), np.float32)
    for n in range(begin, end):
        out[n, 0], out[n, 1], out[n, 2] = shown(
            materials, attributes, kind, flags, lamps, i, place[n, 0], place[n, 1], place[n, 2],
            direction[n, 0], direction[n, 1], direction[n, 2], rows, surface,
        )  # fmt: skip


def rays_shown(
    materials: MaterialTables, kind: int, flags: int, lamps: np.ndarray, i: int, place: np.ndarray, direction: np.ndarray, threads: int = 0
) -> np.ndarray:
    """(N, 3) float32 of `shown` for N rays towards lamp i.

    lamps: (A, LAMP) float32.  place, direction: (N, 3), as there.
    """
    place, direction = np.ascontiguousarray(place, np.float32), np.ascontiguousarray(direction, np.float32)
    out = np.empty((len(place), 3), np.float32)

    def work(begin, end):
        _rays_shown(materials, np.int32(kind), np.int32(flags), lamps, i, place, direction, begin, end, out)

    run_chunks(work, len(place), _CHUNK, threads)
    return out


def _disk(u: np.ndarray) -> np.ndarray:
    """(..., 2) points of the unit disk, evenly for even u (..., 2)."""
    r, phi = np.sqrt(u[..., 0]), 2 * np.pi * u[..., 1]
    return np.stack([r * np.cos(phi), r * np.sin(phi)], -1)


def _leaving(kind: int, flags: int, row: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays that leave a lamp, some from each cell of its map: where relative to its position, the way of its light (HEIGHT, WIDTH, R, 3), what each counts (HEIGHT, WIDTH, R).

    row: (LAMP,), the lamp's own row of the table.  The weights are in proportion to what an even lamp sends so.
    """
    cells = HEIGHT, WIDTH, _RAYS, 2
    u, v = (r2_points(0, HEIGHT * WIDTH * _RAYS, np.uint32(seed)).reshape(cells).astype(np.float64) for seed in (0, 7))
    y = (np.arange(HEIGHT)[:, None, None] + u[..., 0]) / HEIGHT
    x = (np.arange(WIDTH)[None, :, None] + u[..., 1]) / WIDTH
    axes = row[AXIS_X : AXIS_X + 9].reshape(3, 3).astype(np.float64)
    disk = _disk(v)
    rise = np.sqrt(np.maximum(1 - (disk**2).sum(-1), 0))
    if kind == AREA:
        place = np.stack([(x - 0.5) * row[SIZE], (y - 0.5) * row[SIZE + 1], np.zeros_like(x)], -1)
        way = np.stack([disk[..., 0], disk[..., 1], -rise], -1)
        tangent = np.sqrt(1 - rise**2) / np.maximum(rise, 1e-6)
        weight = np.maximum(0, 1 - tangent / float(row[TAN_HALF_SPREAD]))
        if flags & ELLIPTIC:
            weight = weight * ((x - 0.5) ** 2 + (y - 0.5) ** 2 <= 0.25)
        return place @ axes, way @ axes, weight
    if kind == SUN:
        turned, phi = row[ONE_MINUS_COS] * y, 2 * np.pi * x
        sine = np.sqrt(turned * (2 - turned))
        way = -np.stack([sine * np.cos(phi), sine * np.sin(phi), 1 - turned], -1) @ axes
        return np.zeros_like(way), way, np.ones_like(x)
    z, phi = 1 - 2 * y, 2 * np.pi * x
    sine = np.sqrt(np.maximum(1 - z * z, 0))
    way = np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), z), -1) @ axes
    # A line of this direction leaves the sphere where it passes the disk across it, or, of a soft lamp, on that disk.
    side = np.cross(way, np.where(np.abs(way[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    place = disk[..., :1] * side + disk[..., 1:] * np.cross(way, side)
    if not flags & SOFT:
        place = place + rise[..., None] * way
    outer, inner = float(row[COS_OUTER]), float(row[COS_INNER])
    edge = np.clip((-z - outer) / max(inner - outer, 1e-12), 0, 1)
    weight = np.where(-z >= inner, 1.0, edge * edge * (3 - 2 * edge)) * np.ones_like(x)
    return float(row[RADIUS]) * place, way, weight


def measured(
    materials: MaterialTables, kind: np.ndarray, flags: np.ndarray, lamps: np.ndarray, threads: int = 0
) -> tuple[np.ndarray, EmissionMaps]:
    """Mean (A,) over channels and rays of what programs make of the light of each lamp, 1 for even ones, and the maps of those that have one.

    kind, flags: (A,).  lamps: (A, LAMP), in which PER_MEAN and MAP are set.
    """
    mean = np.ones(len(kind))
    rows, columns = [np.zeros((0, HEIGHT))], [np.zeros((0, HEIGHT, WIDTH))]
    lamps[:, PER_MEAN] = 1
    for i in np.flatnonzero(flags & TEXTURED):
        place, way, weight = _leaving(kind[i], flags[i], lamps[i])
        value = rays_shown(materials, kind[i], flags[i], lamps, i, place.reshape(-1, 3), -way.reshape(-1, 3), threads)
        cells = (value.astype(np.float64).mean(1).reshape(weight.shape) * weight).sum(-1)
        mean[i] = cells.sum() / max(weight.sum(), 1e-30)
        if not mean[i] > 0:
            mean[i] = 0
            continue
        lamps[i, PER_MEAN] = 1 / mean[i]
        if kind[i] != SUN:
            lamps[i, MAP] = len(rows) - 1
            cells = np.where(weight.sum(-1) > 0, np.maximum(cells, _LOWEST * cells.mean()), 0)
            rows.append(cells.sum(1)[None])
            columns.append(cells[None])
    return mean, EmissionMaps(cumulative(np.concatenate(rows)), cumulative(np.concatenate(columns)))
