"""Maps from the unit square to disks, cones, spheres and hemispheres, and frames around a direction."""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined

_PI = np.float32(math.pi)
_PI_4 = np.float32(math.pi / 4)
_PI_2 = np.float32(math.pi / 2)
_2PI = np.float32(2 * math.pi)
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)


@inlined
def orthonormal_basis(nx, ny, nz):
    """Two unit vectors that complete the unit vector n to a right-handed frame (t, b, n): six float32.

    Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
    """
    sign = np.float32(math.copysign(_1, nz))
    a = -_1 / (sign + nz)
    b = nx * ny * a
    return _1 + sign * nx * nx * a, sign * b, -sign * nx, b, sign + ny * ny * a, -ny


@inlined
def to_world(x, y, z, nx, ny, nz):
    """A vector given in the frame of `orthonormal_basis(n)`, in world axes: x t + y b + z n."""
    tx, ty, tz, bx, by, bz = orthonormal_basis(nx, ny, nz)
    return x * tx + y * bx + z * nx, x * ty + y * by + z * ny, x * tz + y * bz + z * nz


@inlined
def concentric_disk(u1, u2):
    """Uniform point of the unit disk, density 1/pi (Shirley & Chiu 1997)."""
    a = _2 * u1 - _1
    b = _2 * u2 - _1
    if a == _0 and b == _0:
        return _0, _0
    if abs(a) > abs(b):
        r = a
        phi = _PI_4 * (b / a)
    else:
        r = b
        phi = _PI_2 - _PI_4 * (a / b)
    return r * np.float32(math.cos(phi)), r * np.float32(math.sin(phi))


@inlined
def cosine_hemisphere(u1, u2):
    """Direction (x, y, z) about +z with density z/pi: the disk lifted onto the hemisphere (Malley)."""
    x, y = concentric_disk(u1, u2)
    return x, y, np.float32(math.sqrt(max(_0, _1 - x * x - y * y)))


@inlined
def uniform_sphere(u1, u2):
    """Uniform direction, density 1/(4 pi)."""
    z = _1 - _2 * u1
    r = np.float32(math.sqrt(max(_0, _1 - z * z)))
    phi = _2PI * u2
    return r * np.float32(math.cos(phi)), r * np.float32(math.sin(phi)), z


@inlined
def uniform_cone(u1, u2, one_minus_cos):
    """Uniform direction about +z within a cone, density 1/(2 pi one_minus_cos).

    The cone is given as 1 - cos(half angle), which stays exact for narrow cones.
    """
    h = u1 * one_minus_cos
    r = np.float32(math.sqrt(max(_0, h * (_2 - h))))
    phi = _2PI * u2
    return r * np.float32(math.cos(phi)), r * np.float32(math.sin(phi)), _1 - h


@inlined
def uniform_triangle(u1, u2):
    """Barycentric weights (of corners 1 and 2) uniform in area, low distortion (Heitz 2019)."""
    half = np.float32(0.5)
    if u2 > u1:
        u = half * u1
        return u, u2 - u
    v = half * u2
    return u1 - v, v
