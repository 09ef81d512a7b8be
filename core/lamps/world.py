"""The world: lookup, densities over its pixels, and directions drawn from them.

Each pixel of the equirectangular image is a patch of constant radiance, for lookups, direct light and particles
alike, so that they agree exactly.  Direct light mixes a cosine density with one of max(L - mean, 0), which leaves
the even part of a sky to the cosine (MIS compensation: Karlik et al. 2019).  Where portals face a surface, most of its
rays go through them, evenly by solid angle.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf
from ..sampling.discrete import cumulative, sample_cdf
from ..sampling.maps import cosine_hemisphere, to_world
from ..scene import World
from .shapes import area_view
from .solid_angle import rectangle_angle, sample_rectangle
from .tables import AXIS_X, AXIS_Y, AXIS_Z, LAMP, POSITION, SIZE, WorldTable

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)
_PI = np.float32(math.pi)
_1_PI = np.float32(1 / math.pi)
_2PI = np.float32(2 * math.pi)
_1_2PI = np.float32(0.5 / math.pi)
# Of the rays of what portals face so many go through them, by so much less as the light comes from parts of the sky that are so many times as bright as the mean, such as suns; of the
# others, which find those and what shines past the portals, so many are even.  Without portals it is half of all.
BY_PORTALS, PEAKED, PEAK, _BESIDE = 0.75, 0.35, 10.0, np.float32(0.25)


def pixel_direction(row: np.ndarray, column: np.ndarray, height: int, width: int) -> np.ndarray:
    """Unit directions (..., 3), float64, of the centres of pixels in a panorama; row and column are broadcast."""
    theta, phi = np.pi * (np.asarray(row) + 0.5) / height, np.pi - 2 * np.pi * (np.asarray(column) + 0.5) / width
    z = np.broadcast_to(np.cos(theta), np.broadcast_shapes(theta.shape, phi.shape))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), z], -1)


def row_angles(height: int, width: int) -> np.ndarray:
    """(H,) float64 solid angles of each row's pixels (sr)."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return (2 * np.pi / width) * (edges[:-1] - edges[1:])


def pixel_directions(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (H, W, 3) of the pixels' centres, and solid angles (H, 1) of each row's pixels (sr), float64."""
    return pixel_direction(np.arange(height)[:, None], np.arange(width), height, width), row_angles(height, width)[:, None]


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


def portal_table(portals: np.ndarray) -> np.ndarray:
    """(P, LAMP) float32 of portals (P, 3, 3), as `World` has them."""
    table = np.zeros((len(portals), LAMP), np.float32)
    halves = np.linalg.norm(portals[:, 1:], axis=2)
    x, y = (portals[:, k] / halves[:, k - 1, None] for k in (1, 2))
    table[:, POSITION : POSITION + 3] = portals[:, 0]
    for at, axis in ((AXIS_X, x), (AXIS_Y, y), (AXIS_Z, np.cross(x, y))):
        table[:, at : at + 3] = axis
    table[:, SIZE : SIZE + 2] = 2 * halves
    return table


def world_table(
    radiance: np.ndarray, box: np.ndarray, sought: float = 1.0, portals: np.ndarray | None = None
) -> tuple[WorldTable, np.ndarray, np.ndarray]:
    """Table of a world (H, W, 3), its mean radiance (3,) and the flux (3,) that it sends into the box (W).

    sought, portals: as of `World`, None for none.
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
    peaks = np.maximum(value - PEAK * mean.mean(), 0) * solid_angle
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
        aimed=np.float32(BY_PORTALS - PEAKED * peaks.sum() / max((value * solid_angle).sum(), 1e-300)),
        portals=portal_table(np.zeros((0, 3, 3)) if portals is None else portals),
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
def _portal_angle(portals, i, px, py, pz, nx, ny, nz):
    """Solid angle (sr) of portal i from p, 0 where it faces away or lies below the horizon of the normal n."""
    x, y, height = area_view(portals, i, px, py, pz)
    half_x, half_y = _HALF * portals[i, SIZE], _HALF * portals[i, SIZE + 1]
    if not height > np.float32(1e-5) * (half_x + half_y):
        return _0
    cx, cy, cz = portals[i, POSITION] - px, portals[i, POSITION + 1] - py, portals[i, POSITION + 2] - pz
    across_x = abs(nx * portals[i, AXIS_X] + ny * portals[i, AXIS_X + 1] + nz * portals[i, AXIS_X + 2])
    across_y = abs(nx * portals[i, AXIS_Y] + ny * portals[i, AXIS_Y + 1] + nz * portals[i, AXIS_Y + 2])
    if not nx * cx + ny * cy + nz * cz + half_x * across_x + half_y * across_y > _0:
        return _0
    ax, ay = np.float64(x), np.float64(y)
    return max(_0, np.float32(rectangle_angle(-half_x - ax, half_x - ax, -half_y - ay, half_y - ay, height)))


@inlined
def _faces(portals, i, px, py, pz, dx, dy, dz):
    """Whether a ray from p along d goes through portal i."""
    x, y, height = area_view(portals, i, px, py, pz)
    along = dx * portals[i, AXIS_Z] + dy * portals[i, AXIS_Z + 1] + dz * portals[i, AXIS_Z + 2]
    if not (height > _0 and along > _0):
        return False
    t = height / along
    x += t * (dx * portals[i, AXIS_X] + dy * portals[i, AXIS_X + 1] + dz * portals[i, AXIS_X + 2])
    y += t * (dx * portals[i, AXIS_Y] + dy * portals[i, AXIS_Y + 1] + dz * portals[i, AXIS_Y + 2])
    return abs(x) <= _HALF * portals[i, SIZE] and abs(y) <= _HALF * portals[i, SIZE + 1]


@leaf
def _portals_density(portals, px, py, pz, nx, ny, nz, dx, dy, dz):
    """Density (per sr) of the rays through portals along d from p, with the normal n, and whether any portal faces that; the rays are even by solid angle."""
    whole, through = _0, 0
    for i in range(len(portals)):
        angle = _portal_angle(portals, i, px, py, pz, nx, ny, nz)
        whole += angle
        through += angle > _0 and _faces(portals, i, px, py, pz, dx, dy, dz)
    return (np.float32(through) / whole, True) if whole > _0 else (_0, False)


@leaf
def _through_portal(portals, px, py, pz, nx, ny, nz, u1, u2):
    """A direction from p through one of the portals, some of which face it."""
    whole, chosen, u = _0, 0, u1
    for i in range(len(portals)):  # reservoir sampling with one recycled random number
        angle = _portal_angle(portals, i, px, py, pz, nx, ny, nz)
        if angle > _0:
            whole += angle
            p = angle / whole
            if u < p:
                chosen, u = i, u / p
            else:
                u = (u - p) / (_1 - p)
            u = min(u, np.float32(0.99999994))
    x, y, height = area_view(portals, chosen, px, py, pz)
    half_x, half_y = _HALF * portals[chosen, SIZE], _HALF * portals[chosen, SIZE + 1]
    ax, ay = np.float64(x), np.float64(y)
    qx, qy, _ = sample_rectangle(-half_x - ax, half_x - ax, -half_y - ay, half_y - ay, height, u, u2)
    sx, sy = np.float32(qx), np.float32(qy)
    short = _1 / np.float32(math.sqrt(sx * sx + sy * sy + height * height))
    sx, sy, sz = short * sx, short * sy, short * height
    dx = sx * portals[chosen, AXIS_X] + sy * portals[chosen, AXIS_Y] + sz * portals[chosen, AXIS_Z]
    dy = sx * portals[chosen, AXIS_X + 1] + sy * portals[chosen, AXIS_Y + 1] + sz * portals[chosen, AXIS_Z + 1]
    dz = sx * portals[chosen, AXIS_X + 2] + sy * portals[chosen, AXIS_Y + 2] + sz * portals[chosen, AXIS_Z + 2]
    return dx, dy, dz


@leaf
def world_density(world, px, py, pz, nx, ny, nz, dx, dy, dz):
    """Density (per sr) with which `sample_world` gives the direction d at p on a surface with normal n."""
    through, faced = _0, False
    if len(world.portals) > 0:
        through, faced = _portals_density(world.portals, px, py, pz, nx, ny, nz, dx, dy, dz)
    density = max(_0, dx * nx + dy * ny + dz * nz) * _1_PI
    if world.varies:
        height, width = world.radiance.shape[0], world.radiance.shape[1]
        y, x = _pixel(world, dx, dy, dz, height, width)
        even = _BESIDE if faced else _HALF
        density = even * density + (_1 - even) * _pixel_density(world, y, x, height, width)
    return world.aimed * through + (_1 - world.aimed) * density if faced else density


@inlined
def faces_portals(world, px, py, pz, nx, ny, nz):
    """Whether the world shines on p, of the normal n, through portals."""
    for i in range(len(world.portals)):
        if _portal_angle(world.portals, i, px, py, pz, nx, ny, nz) > _0:
            return True
    return False


@leaf
def sample_world(world, px, py, pz, nx, ny, nz, u1, u2):
    """Direction for direct light at p on a surface with normal n -> (d, radiance / density): six float32."""
    if faces_portals(world, px, py, pz, nx, ny, nz):
        if u1 < world.aimed:
            dx, dy, dz = _through_portal(world.portals, px, py, pz, nx, ny, nz, u1 / world.aimed, u2)
        else:
            dx, dy, dz, _, _, _ = _sample_sky(world, _BESIDE, nx, ny, nz, (u1 - world.aimed) / (_1 - world.aimed), u2)
        w = _1 / max(world_density(world, px, py, pz, nx, ny, nz, dx, dy, dz), np.float32(1e-12))
        r, g, b = world_radiance(world, dx, dy, dz)
        return dx, dy, dz, w * r, w * g, w * b
    return _sample_sky(world, _HALF, nx, ny, nz, u1, u2)


@leaf
def _sample_sky(world, even, nx, ny, nz, u1, u2):
    """`sample_world` without portals; even: share of the directions that follow the cosine."""
    if not world.varies:
        lx, ly, lz = cosine_hemisphere(u1, u2)
        dx, dy, dz = to_world(lx, ly, lz, nx, ny, nz)
        w = _PI / max(lz, np.float32(1e-6))
        return dx, dy, dz, world.radiance[0, 0, 0] * w, world.radiance[0, 0, 1] * w, world.radiance[0, 0, 2] * w
    height, width = world.radiance.shape[0], world.radiance.shape[1]
    if u1 < even:
        lx, ly, lz = cosine_hemisphere(u1 / even, u2)
        dx, dy, dz = to_world(lx, ly, lz, nx, ny, nz)
        cosine = lz
        y, x = _pixel(world, dx, dy, dz, height, width)
        density = _pixel_density(world, y, x, height, width)
    else:
        dx, dy, dz, y, x, density = _sample_pixel(world.rows, world.columns, (u1 - even) / (_1 - even), u2)
        cosine = max(_0, dx * nx + dy * ny + dz * nz)
    both = even * cosine * _1_PI + (_1 - even) * density
    w = _1 / max(both, np.float32(1e-12))
    return dx, dy, dz, world.radiance[y, x, 0] * w, world.radiance[y, x, 1] * w, world.radiance[y, x, 2] * w


@leaf
def emit_world(world, u1, u2):
    """Direction towards the world for a particle -> (d, radiance / density): six float32."""
    dx, dy, dz, y, x, density = _sample_pixel(world.emission_rows, world.emission_columns, u1, u2)
    w = _1 / density
    y, x = y * world.varies, x * world.varies
    return dx, dy, dz, world.radiance[y, x, 0] * w, world.radiance[y, x, 1] * w, world.radiance[y, x, 2] * w
