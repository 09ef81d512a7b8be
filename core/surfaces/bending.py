"""How a ray goes on through glass: bent by Snell's law where it is clear, scattered where it is frosted."""

from __future__ import annotations

import math

import numpy as np

from ..jit import leaf
from ..rays.offsets import hit_point, offset_origin
from .arithmetic import normalized
from .frosted import seen_through
from .layout import BEND, FROST
from .lobes import sample_lobe, set_lobe
from .normals import mapped_normal, shading_normal

STRAIGHT_ON = np.float32(1e-3)  # distance of an index of refraction from 1 up to which glass bends nothing
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@leaf
def scattered(materials, geometry, material, triangle, u, v, dx, dy, dz, u1, u2, surface, lobe):
    """How a sample along d goes on through frosted glass, whose `surface` is evaluated: (origin, direction, weight), with weight 0 for nowhere."""
    x, y, z, gx, gy, gz, error = hit_point(geometry.vertices, geometry.triangles, triangle, u, v)
    sx, sy, sz = shading_normal(geometry.corner_normals, triangle, u, v, gx, gy, gz)
    sx, sy, sz = mapped_normal(materials, material, surface, sx, sy, sz)
    if gx * dx + gy * dy + gz * dz < _0:
        gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
    wx, wy, wz = seen_through(sx, sy, sz, -dx, -dy, -dz)
    set_lobe(lobe, sx, sy, sz, gx, gy, gz, wx, wy, wz, np.float32(math.sqrt(surface[FROST])), _1, _1, _1, _1, _1, _1)
    dx, dy, dz, w, _, _, _ = sample_lobe(lobe, u1, u2)
    if gx * dx + gy * dy + gz * dz <= _0:
        return x, y, z, dx, dy, dz, _0
    x, y, z = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
    return x, y, z, dx, dy, dz, w


@leaf
def bent(materials, geometry, material, triangle, u, v, dx, dy, dz, surface):
    """How a sample along d goes on through clear glass, whose `surface` is evaluated, by Snell's law: (whether it turns, origin, direction).

    Only what has a thickness bends it for good; a solid's back bends it the other way.
    """
    x, y, z, gx, gy, gz, error = hit_point(geometry.vertices, geometry.triangles, triangle, u, v)
    sx, sy, sz = shading_normal(geometry.corner_normals, triangle, u, v, gx, gy, gz)
    sx, sy, sz = mapped_normal(materials, material, surface, sx, sy, sz)
    eta = _1 / surface[BEND]
    if gx * dx + gy * dy + gz * dz < _0:
        gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
    else:
        eta = surface[BEND]
    cosine = sx * dx + sy * dy + sz * dz
    within = _1 - eta * eta * (_1 - cosine * cosine)
    if not (within > _0 and cosine > _0):
        return False, x, y, z, dx, dy, dz
    along = np.float32(math.sqrt(within)) - eta * cosine
    tx, ty, tz = normalized(eta * dx + along * sx, eta * dy + along * sy, eta * dz + along * sz)
    if gx * tx + gy * ty + gz * tz <= _0:
        return False, x, y, z, dx, dy, dz
    x, y, z = offset_origin(x, y, z, gx, gy, gz, error, tx, ty, tz)
    return True, x, y, z, tx, ty, tz
