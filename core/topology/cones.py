"""Cones of light between balls, and what they meet."""

from __future__ import annotations

import numpy as np

from ..jit import inlined

_0 = np.float32(0.0)
_1 = np.float32(1.0)


@inlined
def cone_through(x, y, z, rho, cx, cy, cz, r):
    """Apex, axis, cosine and sine of half the angle of the cone that holds all lines from the ball (x, rho) through the ball (c, r), beyond it.

    The inner tangents of two balls meet between them, nearer to the smaller one.  A sine of 2 stands for the whole space.
    """
    dx, dy, dz = cx - x, cy - y, cz - z
    d = np.sqrt(dx * dx + dy * dy + dz * dz)
    if d <= rho + r:
        return x, y, z, _1, _0, _0, _0, np.float32(2.0)
    t = rho / (rho + r)
    sine = (rho + r) / d
    inverse = _1 / d
    return x + t * dx, y + t * dy, z + t * dz, dx * inverse, dy * inverse, dz * inverse, np.sqrt(_1 - sine * sine), sine


@inlined
def ball_meets(ax, ay, az, ux, uy, uz, cosine, sine, sx, sy, sz, radius):
    """Whether a ball meets a cone (Eberly, "Intersection of a Sphere and a Cone", without the cap at the apex)."""
    if sine >= _1:
        return True
    dx, dy, dz = sx - ax, sy - ay, sz - az
    along = dx * ux + dy * uy + dz * uz
    across = np.sqrt(max(_0, dx * dx + dy * dy + dz * dz - along * along))
    return across * cosine - along * sine <= radius and along > -radius
