"""Where shadow rays leave smooth surfaces: above the facets, on the curved surface that their normals tell of.

A mesh of few facets that is shaded smoothly is lit as if it were round, but a facet that turns away from a lamp would shadow itself, along
its edges.  Cycles lets such rays leave from the surface that the corners' normals describe (kernel/light/sample.h,
`shadow_ray_smooth_surface_offset`; see Hanika 2021, "Hacking the Shadow Terminator", Ray Tracing Gems II), and so does this.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)
# Cosine below which a ray is lifted: an object's `shadow_terminator_geometry_offset` by default.
_CUTOFF = np.float32(0.1)
# A ray at this cosine to the facet is not lifted, whatever its cosine to the smooth surface.
LOW = _2 * _CUTOFF


@inlined
def _dot(x, y, z, normals, triangle, k):
    return x * normals[triangle, k, 0] + y * normals[triangle, k, 1] + z * normals[triangle, k, 2]


@inlined
def _from_first(vertices, triangles, triangle, k):
    """Corner k, relative to the first one, near which float32 has more room."""
    a, b = triangles[triangle, 0], triangles[triangle, k]
    return vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]


@leaf
def lift(vertices, triangles, corner_normals, triangle, px, py, pz, gx, gy, gz, dx, dy, dz):
    """Offset (x, y, z) in m from the point p of a triangle to where a shadow ray along the unit vector d leaves; 0 for flat shading.

    g: unit geometric normal on the lit side.  p may lie somewhat beside the triangle: it counts as on its edge.
    """
    n, t = corner_normals, triangle
    first = triangles[t, 0]
    px, py, pz = px - vertices[first, 0], py - vertices[first, 1], pz - vertices[first, 2]
    ex, ey, ez = _from_first(vertices, triangles, t, 1)
    fx, fy, fz = _from_first(vertices, triangles, t, 2)
    ee, ef, ff = ex * ex + ey * ey + ez * ez, ex * fx + ey * fy + ez * fz, fx * fx + fy * fy + fz * fz
    area2 = ee * ff - ef * ef
    if not area2 > np.float32(1e-12) * ee * ff:
        return _0, _0, _0
    ep, fp = ex * px + ey * py + ez * pz, fx * px + fy * py + fz * pz
    v, w = max((ff * ep - ef * fp) / area2, _0), max((ee * fp - ef * ep) / area2, _0)
    u = max(_1 - v - w, _0)
    s = _1 / (u + v + w)
    u, v, w = s * u, s * v, s * w

    nx = u * n[t, 0, 0] + v * n[t, 1, 0] + w * n[t, 2, 0]
    ny = u * n[t, 0, 1] + v * n[t, 1, 1] + w * n[t, 2, 1]
    nz = u * n[t, 0, 2] + v * n[t, 1, 2] + w * n[t, 2, 2]
    length = np.float32(math.sqrt(nx * nx + ny * ny + nz * nz))
    if not length > np.float32(1e-6):
        return _0, _0, _0
    side = _1 if nx * gx + ny * gy + nz * gz > _0 else -_1
    across, along = gx * dx + gy * dy + gz * dz, side * (nx * dx + ny * dy + nz * dz) / length
    amount = _2 - (across + along) / _CUTOFF if along < _CUTOFF else _1 - across / _CUTOFF
    if amount <= _0:
        return _0, _0, _0

    # Heights of the corners above each other's planes, from which p's follow, for it lies between them.
    e0, f0 = _dot(ex, ey, ez, n, t, 0), _dot(fx, fy, fz, n, t, 0)
    e1, f1 = _dot(ex, ey, ez, n, t, 1), _dot(fx, fy, fz, n, t, 1)
    e2, f2 = _dot(ex, ey, ez, n, t, 2), _dot(fx, fy, fz, n, t, 2)
    # A parabola through the corners, where it is at least half as high as the envelope of the corners' planes, each moved up to hold all corners.
    a, b, c = f0 - f2, (f1 - e1) - (f2 - e2), e1 - e0
    parabola = _HALF * (a * u * (u - _1) + (a + b + c) * u * v + b * v * (v - _1))
    h0 = max(side * e0, side * f0, _0) - side * (v * e0 + w * f0)
    h1 = max(-side * e1, side * (f1 - e1), _0) + side * (u * e1 - w * (f1 - e1))
    h2 = max(-side * f2, side * (e2 - f2), _0) + side * (u * f2 - v * (e2 - f2))
    height = min(max(h0, _0), max(h1, _0), max(h2, _0))
    height = max(height, parabola) if side > _0 else min(-height, parabola)
    height *= min(amount, _1)
    return height * nx, height * ny, height * nz
