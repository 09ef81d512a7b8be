"""Lamps of every shape as Cycles has them: how they fade with direction, and aiming at each from a point.

Every sampler returns the unit direction to the light, its distance, and radiance / density per solid angle
(zero where there is no light that way).
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf
from ..sampling.maps import concentric_disk, cosine_hemisphere, to_world, uniform_cone, uniform_triangle
from .solid_angle import sample_rectangle, sample_triangle
from .tables import (
    AREA_M2,
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    CORNERS,
    COS_INNER,
    COS_OUTER,
    EXPONENT,
    NORMAL,
    ONE_MINUS_COS,
    POSITION,
    RADIUS,
    SIZE,
    SMOOTHING,
    TAN_HALF_SPREAD,
)  # fmt: skip

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)
_PI = np.float32(math.pi)
_2PI = np.float32(2 * math.pi)
_TINY = np.float32(1e-12)
_INFINITY = np.float32(np.inf)

# What a spot's inside counts to a point within, in directions that lead away from its centre: Cycles lets no ray meet it so
# (kernel/light/spot.h), and its shadow rays leave half of a diffuse surface's light to such rays.
AWAY_FROM_CENTRE = np.float32(0.5)

_COPLANAR = np.float32(5e-7)  # a few roundings of a point's coordinates


@inlined
def one_minus_cos(sin2):
    """1 - cos of an angle from its squared sine, without cancellation."""
    return sin2 / (_1 + np.float32(math.sqrt(max(_0, _1 - sin2))))


@inlined
def smoothstep(x):
    """3x^2 - 2x^3, clamped to 0..1."""
    x = min(max(x, _0), _1)
    return x * x * (np.float32(3.0) - _2 * x)


@inlined
def spot_attenuation(lamps, i, cosine):
    """Share of a spot's axial intensity at an angle off its axis (1 for a point lamp)."""
    outer, inner = lamps[i, COS_OUTER], lamps[i, COS_INNER]
    if cosine >= inner:
        return _1
    if cosine <= outer:
        return _0
    return smoothstep((cosine - outer) / (inner - outer))


@inlined
def spread_attenuation(lamps, i, tangent):
    """Share of an area lamp's axial radiance at an angle off its axis, given as the tangent."""
    limit = lamps[i, TAN_HALF_SPREAD]
    if limit == _INFINITY:
        return _1
    return max(_0, _1 - tangent / limit)


@inlined
def falloff(lamps, i, t):
    """By how much a lamp of a falloff of its own shines more at the distance t (m) than one without (Cycles: Light Falloff node)."""
    factor = _1
    if lamps[i, EXPONENT] > _HALF:
        factor = t * t if lamps[i, EXPONENT] > np.float32(1.5) else t
    smoothing = lamps[i, SMOOTHING]
    return factor * (t * t / (smoothing + t * t)) if smoothing > _0 else factor


@inlined
def lamp_cone(radius, soft, d2):
    """1 - cos of the half angle that a sphere, or a disk that faces the point, fills at the squared distance d2; 2 within it."""
    r2 = radius * radius
    if soft:
        return one_minus_cos(r2 / (d2 + r2))
    return one_minus_cos(r2 / d2) if d2 > r2 else _2


@inlined
def area_view(lamps, i, px, py, pz):
    """The point p in an area lamp's own axes -> (x, y, height before it; light leaves to positive heights)."""
    vx, vy, vz = px - lamps[i, POSITION], py - lamps[i, POSITION + 1], pz - lamps[i, POSITION + 2]
    x = vx * lamps[i, AXIS_X] + vy * lamps[i, AXIS_X + 1] + vz * lamps[i, AXIS_X + 2]
    y = vx * lamps[i, AXIS_Y] + vy * lamps[i, AXIS_Y + 1] + vz * lamps[i, AXIS_Y + 2]
    return x, y, -(vx * lamps[i, AXIS_Z] + vy * lamps[i, AXIS_Z + 1] + vz * lamps[i, AXIS_Z + 2])


@inlined
def area_part(lamps, i, ellipse, x, y, height):
    """The part of an area lamp that `sample_area` samples -> (x0, x1, y0, y1, whether by area on the whole ellipse)."""
    half_x, half_y = _HALF * lamps[i, SIZE], _HALF * lamps[i, SIZE + 1]
    reach = height * lamps[i, TAN_HALF_SPREAD]
    # Below this distance the density of area samples varies more than rejection costs.
    longer = max(half_x, half_y)
    beside = max(_0, np.float32(math.sqrt(x * x + y * y)) - longer)
    far = beside * beside + height * height > _HALF * longer * longer
    by_area = ellipse and far and reach > _2 * (half_x + half_y + abs(x) + abs(y))
    return max(-half_x, x - reach), min(half_x, x + reach), max(-half_y, y - reach), min(half_y, y + reach), by_area


@leaf
def sample_point(lamps, i, soft, px, py, pz, nx, ny, nz, u1, u2):
    """Point and spot lamps -> (d, distance, radiance factor / density).

    A sphere is sampled uniformly in the cone that it fills (Shirley et al. 1996).  A soft lamp is a disk that faces
    the shading point: it fills a cone as well, which needs no area density as in Cycles.
    """
    vx, vy, vz = lamps[i, POSITION] - px, lamps[i, POSITION + 1] - py, lamps[i, POSITION + 2] - pz
    d2 = vx * vx + vy * vy + vz * vz
    r = lamps[i, RADIUS]
    if d2 < _TINY:
        return _0, _0, _1, _0, _0
    d = np.float32(math.sqrt(d2))
    vx, vy, vz = vx / d, vy / d, vz / d
    if r == _0:
        dx, dy, dz, t = vx, vy, vz, d
        weight = _1 / d2
    elif soft:
        cone = lamp_cone(r, True, d2)
        lx, ly, lz = uniform_cone(u1, u2, cone)
        dx, dy, dz = to_world(lx, ly, lz, vx, vy, vz)
        t = d / lz
        weight = _2PI * cone
    elif d2 > r * r:
        cone = lamp_cone(r, False, d2)
        lx, ly, lz = uniform_cone(u1, u2, cone)
        dx, dy, dz = to_world(lx, ly, lz, vx, vy, vz)
        t = d * lz - np.float32(math.sqrt(max(_0, r * r - d2 * (_1 - lz * lz))))
        weight = _2PI * cone
    else:  # within the sphere, light comes from everywhere, whatever the spot's cone
        lx, ly, lz = cosine_hemisphere(u1, u2)
        dx, dy, dz = to_world(lx, ly, lz, nx, ny, nz)
        along = dx * vx + dy * vy + dz * vz
        t = d * along + np.float32(math.sqrt(max(_0, r * r - d2 * (_1 - along * along))))
        weight = _PI / max(lz, np.float32(1e-6))
        return dx, dy, dz, t, weight * AWAY_FROM_CENTRE if along <= _0 and lamps[i, COS_OUTER] > -_1 else weight
    cosine = lamps[i, AXIS_Z] * dx + lamps[i, AXIS_Z + 1] * dy + lamps[i, AXIS_Z + 2] * dz
    return dx, dy, dz, t, weight * spot_attenuation(lamps, i, cosine)


@leaf
def sample_sun(lamps, i, u1, u2):
    """Sun -> (d, radiance factor / density); of a sun without size the factor is that of its irradiance."""
    lx, ly, lz = uniform_cone(u1, u2, lamps[i, ONE_MINUS_COS])
    ax, ay, az = lamps[i, AXIS_Z], lamps[i, AXIS_Z + 1], lamps[i, AXIS_Z + 2]
    dx, dy, dz = to_world(lx, ly, lz, ax, ay, az)
    return dx, dy, dz, _2PI * lamps[i, ONE_MINUS_COS] if lamps[i, ONE_MINUS_COS] > _0 else _1


@leaf
def sample_area(lamps, i, ellipse, px, py, pz, u1, u2):
    """Area lamps -> (d, distance, radiance factor / density).

    Only the part of the lamp whose spread reaches the point is sampled.  Rectangles: uniform in solid angle.
    Ellipses: uniform in area where the lamp is far, else the rectangle around them with rejected corners.
    """
    x, y, height = area_view(lamps, i, px, py, pz)
    if not height > _0:
        return _0, _0, _1, _0, _0
    half_x, half_y = _HALF * lamps[i, SIZE], _HALF * lamps[i, SIZE + 1]
    x0, x1, y0, y1, by_area = area_part(lamps, i, ellipse, x, y, height)
    if not (x0 < x1 and y0 < y1):
        return _0, _0, _1, _0, _0
    if by_area:
        a, b = concentric_disk(u1, u2)
        sx, sy = a * half_x - x, b * half_y - y
        r2 = sx * sx + sy * sy + height * height
        weight = _PI * half_x * half_y * height / (r2 * np.float32(math.sqrt(r2)))
    else:
        ax, ay = np.float64(x), np.float64(y)
        qx, qy, angle = sample_rectangle(x0 - ax, x1 - ax, y0 - ay, y1 - ay, height, u1, u2)
        sx, sy, weight = np.float32(qx), np.float32(qy), np.float32(angle)
        if ellipse and ((sx + x) / half_x) ** 2 + ((sy + y) / half_y) ** 2 > _1:
            weight = _0
        r2 = sx * sx + sy * sy + height * height
    t = np.float32(math.sqrt(r2))
    weight *= spread_attenuation(lamps, i, np.float32(math.sqrt(sx * sx + sy * sy)) / height)
    sx, sy, sz = sx / t, sy / t, height / t
    dx = sx * lamps[i, AXIS_X] + sy * lamps[i, AXIS_Y] + sz * lamps[i, AXIS_Z]
    dy = sx * lamps[i, AXIS_X + 1] + sy * lamps[i, AXIS_Y + 1] + sz * lamps[i, AXIS_Z + 1]
    dz = sx * lamps[i, AXIS_X + 2] + sy * lamps[i, AXIS_Y + 2] + sz * lamps[i, AXIS_Z + 2]
    return dx, dy, dz, t, weight


@inlined
def triangle_view(shapes, i, px, py, pz):
    """A triangle from p -> (a, e, f, near, coplanar): first corner relative to p, edges, how `sample_mesh_triangle` sees it.

    A point in the triangle's plane, to rounding, is not lit by it: seen from its own surface it would fill half of
    all directions.
    """
    c = CORNERS
    ax, ay, az = shapes[i, c] - px, shapes[i, c + 1] - py, shapes[i, c + 2] - pz
    ex, ey, ez = shapes[i, c + 3] - shapes[i, c], shapes[i, c + 4] - shapes[i, c + 1], shapes[i, c + 5] - shapes[i, c + 2]
    fx, fy, fz = shapes[i, c + 6] - shapes[i, c], shapes[i, c + 7] - shapes[i, c + 1], shapes[i, c + 8] - shapes[i, c + 2]
    third = np.float32(1 / 3)
    mx, my, mz = ax + third * (ex + fx), ay + third * (ey + fy), az + third * (ez + fz)
    longest = max(ex * ex + ey * ey + ez * ez, fx * fx + fy * fy + fz * fz, (fx - ex) ** 2 + (fy - ey) ** 2 + (fz - ez) ** 2)
    rounding = _COPLANAR * (abs(px) + abs(py) + abs(pz) + np.float32(math.sqrt(longest)))
    coplanar = abs(ax * shapes[i, NORMAL] + ay * shapes[i, NORMAL + 1] + az * shapes[i, NORMAL + 2]) <= rounding
    return ax, ay, az, ex, ey, ez, fx, fy, fz, longest > np.float32(0.1) * (mx * mx + my * my + mz * mz), coplanar


@leaf
def sample_mesh_triangle(shapes, i, px, py, pz, u1, u2):
    """Emissive triangles -> (d, distance, 1 / density, u, v): uniform in solid angle near by, in area far away."""
    ax, ay, az, ex, ey, ez, fx, fy, fz, near, coplanar = triangle_view(shapes, i, px, py, pz)
    nx, ny, nz = shapes[i, NORMAL], shapes[i, NORMAL + 1], shapes[i, NORMAL + 2]
    third = np.float32(1 / 3)
    if coplanar:
        return nx, ny, nz, _1, _0, third, third
    if near:
        dx, dy, dz, angle = sample_triangle(ax, ay, az, ax + ex, ay + ey, az + ez, ax + fx, ay + fy, az + fz, u1, u2)
        if angle > 0.0:
            # Where the direction meets the plane: distance and barycentric coordinates (Cramer's rule).
            d_n = dx * nx + dy * ny + dz * nz
            t = (ax * nx + ay * ny + az * nz) / d_n if d_n != 0.0 else 0.0
            hx, hy, hz = t * dx - ax, t * dy - ay, t * dz - az
            ee, ef, ff = ex * ex + ey * ey + ez * ez, ex * fx + ey * fy + ez * fz, fx * fx + fy * fy + fz * fz
            he, hf = hx * ex + hy * ey + hz * ez, hx * fx + hy * fy + hz * fz
            below = ee * ff - ef * ef
            u = min(max((ff * he - ef * hf) / below, 0.0), 1.0)
            v = min(max((ee * hf - ef * he) / below, 0.0), 1.0 - u)
            if t > 0.0:
                return np.float32(dx), np.float32(dy), np.float32(dz), np.float32(t), np.float32(angle), np.float32(u), np.float32(v)
    u, v = uniform_triangle(u1, u2)
    dx, dy, dz = ax + u * ex + v * fx, ay + u * ey + v * fy, az + u * ez + v * fz
    r2 = dx * dx + dy * dy + dz * dz
    if r2 < _TINY:
        return _0, _0, _1, _0, _0, u, v
    t = np.float32(math.sqrt(r2))
    dx, dy, dz = dx / t, dy / t, dz / t
    return dx, dy, dz, t, shapes[i, AREA_M2] * abs(dx * nx + dy * ny + dz * nz) / r2, u, v
