"""Points on triangles and rays that leave them: how far float32 lets a point stray from its surface.

A point that a ray hit is found again from its barycentric weights (never origin + t direction), in float64,
and rounded once.  The error radius bounds, along the normal, the rounding of the point and of the origin
moved off it [Pharr, Jakob, Humphreys 2023, Physically Based Rendering, 4th ed., 6.8 "Managing rounding
error"], plus the error of the intersector: it subtracts the ray's origin from the corners first, so its
error grows with the triangle (and with how slender it is), not with the distance to the world's origin.
Moving the origin by this radius to the side that the ray leaves on keeps it from hitting the triangle
again; what lies further from the triangle than a few radii is not jumped over.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, leaf

UNIT_ROUNDOFF = 2.0**-24
# Distance from the plane at which Embree and the BVH were seen to hit a triangle from its own surface: up to
# 1.5 L + .1 L^3 / (2 A) in units of the roundoff, L the longest edge, A the area (tests/core/test_rays_offsets.py).
_EDGE = 3.0
_SLENDER = 0.5
# Rounding of the point and of the offset origin, half an ulp each, and a half more for the addition.
_POSITION = 3.0
# A ray that arrives from distance D misjudges its target's plane by up to 3 D roundoffs.
_DISTANCE = np.float32(4.0 * UNIT_ROUNDOFF)
# Distance from the triangle's edges, in error radii, and what it may cost in barycentric weight.
_EDGE_MARGIN = 2.0
_LARGEST_MARGIN = 0.02


@leaf
def hit_point(vertices, triangles, triangle, u, v):
    """The point of weights u, v (corners 1, 2) -> (x, y, z, nx, ny, nz, error).

    n is the unit geometric normal (v1 - v0) x (v2 - v0), zero where the area is; error is the radius (m) for
    `offset_origin` and `shadow_segment`.  Points closer to an edge than two radii are pulled inside, so that
    the offset origin does not leave a closed corner.
    """
    a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
    ax, ay, az = np.float64(vertices[a, 0]), np.float64(vertices[a, 1]), np.float64(vertices[a, 2])
    ex, ey, ez = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    fx, fy, fz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    area2 = np.sqrt(nx * nx + ny * ny + nz * nz)
    inverse = 1.0 / area2 if area2 > 0.0 else 0.0
    nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
    gx, gy, gz = fx - ex, fy - ey, fz - ez
    edge2 = max(ex * ex + ey * ey + ez * ez, fx * fx + fy * fy + fz * fz, gx * gx + gy * gy + gz * gz)
    edge = np.sqrt(edge2)
    # The plane's distance from zero is what all of its points round with, up to the triangle's own size.
    away = abs(nx) * (abs(ax) + edge) + abs(ny) * (abs(ay) + edge) + abs(nz) * (abs(az) + edge)
    error = UNIT_ROUNDOFF * (_POSITION * away + edge * (_EDGE + _SLENDER * edge2 * inverse))

    margin = min(_EDGE_MARGIN * error * edge * inverse, _LARGEST_MARGIN)
    w1, w2 = np.float64(u), np.float64(v)
    w0 = max(1.0 - w1 - w2, margin)
    w1, w2 = max(w1, margin), max(w2, margin)
    scale = 1.0 / (w0 + w1 + w2)
    w1, w2 = w1 * scale, w2 * scale
    return (
        np.float32(ax + w1 * ex + w2 * fx),
        np.float32(ay + w1 * ey + w2 * fy),
        np.float32(az + w1 * ez + w2 * fz),
        np.float32(nx),
        np.float32(ny),
        np.float32(nz),
        np.float32(error),
    )


@inlined
def offset_origin(px, py, pz, nx, ny, nz, error, dx, dy, dz):
    """(x, y, z): the point moved off its surface by `error`, to the side that direction d points to."""
    step = error if nx * dx + ny * dy + nz * dz >= np.float32(0.0) else -error
    return px + step * nx, py + step * ny, pz + step * nz


@inlined
def shadow_segment(px, py, pz, pnx, pny, pnz, perror, qx, qy, qz, qnx, qny, qnz, qerror):
    """(ox, oy, oz, dx, dy, dz) of the ray from p to q, both moved off their surfaces: trace t in 0..1.

    A point without a surface (a lamp) has error 0 and a zero normal.
    """
    dx, dy, dz = qx - px, qy - py, qz - pz
    far = _DISTANCE * (abs(dx) + abs(dy) + abs(dz))
    ox, oy, oz = offset_origin(px, py, pz, pnx, pny, pnz, perror, dx, dy, dz)
    tx, ty, tz = offset_origin(qx, qy, qz, qnx, qny, qnz, qerror + far, -dx, -dy, -dz)
    return ox, oy, oz, tx - ox, ty - oy, tz - oz
