"""Emitters met by rays that were not aimed at them: their light along a ray, and how likely `sample_emitter` aims there.

Multiple importance sampling of glossy surfaces needs both (Veach 1997, chapter 9).
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf
from ..scene import AREA, DIFFUSE, SHADOW, SUN
from .links import is_hidden_alike
from .shapes import area_part, area_view, falloff, lamp_cone, spot_attenuation, spread_attenuation, triangle_view
from .solid_angle import rectangle_angle, triangle_angle
from .tables import (
    AREA_M2,
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    COS_OUTER,
    ELLIPTIC,
    FADING,
    NORMAL,
    ONE_MINUS_COS,
    POSITION,
    RADIUS,
    SIZE,
    SOFT,
    TRIANGLE,
    WORLD,
)  # fmt: skip
from .world import world_density, world_radiance

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)
_1_2PI = np.float32(0.5 / math.pi)
_1_PI = np.float32(1 / math.pi)
_INFINITY = np.float32(np.inf)
BOTH, EACH = 0, -1  # no kinds of rays
MEAN_COSINE = np.float32(2 / 3)  # of scattered light
_NEARLY_ALL = np.float32(0.99)  # of a part of the sky: the rest are Cycles' sparks


@inlined
def share_of(own, other):
    """Weight of a sample whose sampler has the density `own` where another has `other`: the power heuristic, exponent 2."""
    ratio = other / own
    return _1 / (_1 + ratio * ratio)


@inlined
def sought(world, dx, dy, dz, cosine):
    """The share of what shines along d that Cycles finds by shadow rays, where it meets a diffuse surface at `cosine`; the rest it finds by rays scattered there."""
    r, g, b = world_radiance(world, dx, dy, dz)
    aimed = world.sought * (r + g + b) / (np.float32(12) * world.estimate[0])
    return share_of(aimed, cosine * _1_PI) if aimed > _0 else _0


@inlined
def can_be_met(emitters, e):
    """Whether emitter e has a size, so that a ray can meet it; surfaces that others hide from shadow rays count as having none."""
    if emitters.kind[e] == TRIANGLE:
        return is_hidden_alike(emitters, e)
    if emitters.kind[e] >= WORLD or emitters.kind[e] == AREA:
        return True
    return emitters.lamps[e, ONE_MINUS_COS if emitters.kind[e] == SUN else RADIUS] > _0


@inlined
def ray_kind(emitters, e, dx, dy, dz):
    """What a ray of light from emitter e, which lies in the direction d, is to materials and objects that tell rays apart: SHADOW, DIFFUSE, BOTH in parts,
    or EACH whole.

    Cycles finds lamps and suns in the sky by shadow rays, an even sky by rays that diffuse surfaces scatter, and what lies between by both.  Beyond glass it
    takes whole what scattered rays find: there lamps of a size come twice, where the glass is none to shadow rays.  Suns do by rare sparks only.
    """
    if emitters.kind[e] != WORLD:
        twice = emitters.told and emitters.kind[e] != SUN and is_hidden_alike(emitters, e) and can_be_met(emitters, e)
        return EACH if twice else SHADOW
    if not (emitters.told and emitters.world.varies):
        return DIFFUSE
    return SHADOW if sought(emitters.world, dx, dy, dz, MEAN_COSINE) > _NEARLY_ALL else BOTH


@inlined
def _one_minus_cos_between(ax, ay, az, bx, by, bz):
    """1 - cos of two unit vectors, exact for small angles."""
    x, y, z = ax - bx, ay - by, az - bz
    return _HALF * (x * x + y * y + z * z)


@leaf
def _shape_along(emitters, e, px, py, pz, dx, dy, dz):
    """`lamp_along` for what shines at any distance alike."""
    lamps, flags = emitters.lamps, emitters.flags[e]
    if emitters.kind[e] == SUN:
        off = _one_minus_cos_between(dx, dy, dz, lamps[e, AXIS_Z], lamps[e, AXIS_Z + 1], lamps[e, AXIS_Z + 2])
        return _INFINITY, _1 if off < lamps[e, ONE_MINUS_COS] else _0
    if emitters.kind[e] == AREA:
        x, y, height = area_view(lamps, e, px, py, pz)
        along = dx * lamps[e, AXIS_Z] + dy * lamps[e, AXIS_Z + 1] + dz * lamps[e, AXIS_Z + 2]
        if not (height > _0 and along > _0):
            return _0, _0
        t = height / along
        sx = t * (dx * lamps[e, AXIS_X] + dy * lamps[e, AXIS_X + 1] + dz * lamps[e, AXIS_X + 2])
        sy = t * (dx * lamps[e, AXIS_Y] + dy * lamps[e, AXIS_Y + 1] + dz * lamps[e, AXIS_Y + 2])
        a, b = _2 * (x + sx) / lamps[e, SIZE], _2 * (y + sy) / lamps[e, SIZE + 1]
        outside = a * a + b * b > _1 if flags & ELLIPTIC else max(abs(a), abs(b)) > _1
        if outside:
            return _0, _0
        return t, spread_attenuation(lamps, e, np.float32(math.sqrt(sx * sx + sy * sy)) / height)
    radius = lamps[e, RADIUS]
    vx, vy, vz = lamps[e, POSITION] - px, lamps[e, POSITION + 1] - py, lamps[e, POSITION + 2] - pz
    d2 = vx * vx + vy * vy + vz * vz
    if not (radius > _0 and d2 > np.float32(1e-12)):
        return _0, _0
    d = np.float32(math.sqrt(d2))
    along = (vx * dx + vy * dy + vz * dz) / d
    cone = lamp_cone(radius, flags & SOFT, d2)
    if cone < _2 and _one_minus_cos_between(dx, dy, dz, vx / d, vy / d, vz / d) >= cone:
        return _0, _0
    if flags & SOFT:
        t = d / along
    else:
        half = np.float32(math.sqrt(max(_0, radius * radius - d2 * (_1 - along * along))))
        if cone == _2:
            return d * along + half, _0 if along <= _0 and lamps[e, COS_OUTER] > -_1 else _1
        t = d * along - half
    cosine = lamps[e, AXIS_Z] * dx + lamps[e, AXIS_Z + 1] * dy + lamps[e, AXIS_Z + 2] * dz
    return t, spot_attenuation(lamps, e, cosine)


@leaf
def lamp_along(emitters, e, px, py, pz, dx, dy, dz):
    """Lamp e along the unit direction d from p -> (distance, share of its radiance); the share is 0 where it is not met.

    e: a lamp (below `WORLD`).
    """
    t, share = _shape_along(emitters, e, px, py, pz, dx, dy, dz)
    if emitters.flags[e] & FADING and share > _0:
        share *= falloff(emitters.lamps, e, t)
    return t, share


@leaf
def emitter_of(emitters, triangle):
    """The emitter that a triangle is, -1 for none (their list is sorted)."""
    low, high = 0, len(emitters.triangle)
    while low < high:
        middle = (low + high) >> 1
        if emitters.triangle[middle] < triangle:
            low = middle + 1
        else:
            high = middle
    return emitters.first_triangle + low if low < len(emitters.triangle) and emitters.triangle[low] == triangle else -1


@leaf
def emitter_density(emitters, e, px, py, pz, nx, ny, nz, dx, dy, dz):
    """Density (per sr) of `sample_emitter` for the surface p with normal n in a direction d that meets emitter e."""
    lamps, kind, flags = emitters.lamps, emitters.kind[e], emitters.flags[e]
    if kind == TRIANGLE:
        i, shapes = e - emitters.first_triangle, emitters.shapes
        ax, ay, az, ex, ey, ez, fx, fy, fz, near, coplanar = triangle_view(shapes, i, px, py, pz)
        if coplanar:
            return _0
        if near:
            angle = triangle_angle(ax, ay, az, ax + ex, ay + ey, az + ez, ax + fx, ay + fy, az + fz)
            if angle > 1e-7:
                return np.float32(1.0 / angle)
        facing = dx * shapes[i, NORMAL] + dy * shapes[i, NORMAL + 1] + dz * shapes[i, NORMAL + 2]
        t = (ax * shapes[i, NORMAL] + ay * shapes[i, NORMAL + 1] + az * shapes[i, NORMAL + 2]) / facing
        return t * t / max(abs(facing) * shapes[i, AREA_M2], np.float32(1e-30))
    if kind == WORLD:
        return world_density(emitters.world, px, py, pz, nx, ny, nz, dx, dy, dz)
    if kind == SUN:
        return _1_2PI / lamps[e, ONE_MINUS_COS]
    if kind == AREA:
        x, y, height = area_view(lamps, e, px, py, pz)
        x0, x1, y0, y1, by_area = area_part(lamps, e, flags & ELLIPTIC, x, y, height)
        if not (height > _0 and x0 < x1 and y0 < y1):
            return _0
        if not by_area:
            ax, ay = np.float64(x), np.float64(y)
            angle = rectangle_angle(x0 - ax, x1 - ax, y0 - ay, y1 - ay, height)
            if angle > 1e-9:
                return np.float32(1.0 / angle)
        area = (x1 - x0) * (y1 - y0) * (np.float32(math.pi / 4) if by_area else _1)
        along = dx * lamps[e, AXIS_Z] + dy * lamps[e, AXIS_Z + 1] + dz * lamps[e, AXIS_Z + 2]
        return height * height / max(area * along * along * along, np.float32(1e-30))
    vx, vy, vz = lamps[e, POSITION] - px, lamps[e, POSITION + 1] - py, lamps[e, POSITION + 2] - pz
    cone = lamp_cone(lamps[e, RADIUS], flags & SOFT, vx * vx + vy * vy + vz * vz)
    if cone == _2:
        return max(dx * nx + dy * ny + dz * nz, np.float32(1e-6)) * _1_PI
    return _1_2PI / cone
