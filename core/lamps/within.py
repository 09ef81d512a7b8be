"""What surfaces lie within the spheres of point and spot lamps: bulbs, shades, and walls that large lamps reach through."""

from __future__ import annotations

import math

import numpy as np

from ..jit import kernel
from ..scene import DIFFUSE, Geometry
from ..threads import run_chunks

CHUNK = 64  # lamps


@kernel
def _distance2(px, py, pz, a, b, c):
    """Squared distance of p to the triangle a, b, c (Ericson 2005, Real-Time Collision Detection, section 5.1.5)."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    apx, apy, apz = px - a[0], py - a[1], pz - a[2]
    d1, d2 = abx * apx + aby * apy + abz * apz, acx * apx + acy * apy + acz * apz
    ab2, ac2, abac = abx * abx + aby * aby + abz * abz, acx * acx + acy * acy + acz * acz, abx * acx + aby * acy + abz * acz
    d3, d4, d5, d6 = d1 - ab2, d2 - abac, d1 - abac, d2 - ac2
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        v, w = 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v, w = d1 / (d1 - d3), 0.0
    elif d6 >= 0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) / (d4 - d3 + d5 - d6)
        v = 1.0 - w
    else:
        total = max(va + vb + vc, 1e-300)
        v, w = vb / total, vc / total
    x, y, z = apx - v * abx - w * acx, apy - v * aby - w * acy, apz - v * abz - w * acz
    return x * x + y * y + z * z


@kernel
def _areas(vertices, triangles, taken, position, radius, out):
    """Adds to out (L,) bounds of the area (m^2) of the `taken` triangles within each sphere."""
    for t in range(len(triangles)):
        if not taken[t]:
            continue
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        area = -1.0
        for i in range(len(radius)):
            r = radius[i]
            apart = False
            for k in range(3):
                apart = apart or min(a[k], b[k], c[k]) > position[i, k] + r or max(a[k], b[k], c[k]) < position[i, k] - r
            if apart:
                continue
            rest = r * r - _distance2(position[i, 0], position[i, 1], position[i, 2], a, b, c)
            if rest > 0:
                if area < 0:
                    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
                    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
                    area = 0.5 * math.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2)
                out[i] += min(area, math.pi * rest)


def share_within(geometry: Geometry, position: np.ndarray, radius: np.ndarray, threads: int = 0) -> np.ndarray:
    """About which share (0..1) of the chords of each sphere meets a surface; 0 only where none lies within.

    position: (L, 3) m.  radius: (L,) m.  A surface of area A cuts 2 A / S of the chords of a sphere of surface S, on average.
    """
    area = np.zeros(len(radius))
    taken = (geometry.object_visibility[geometry.object] & DIFFUSE) > 0
    position, radius = position.astype(np.float64), radius.astype(np.float64)
    if (radius > 0).any():
        vertices = geometry.vertices.astype(np.float64)

        def work(begin, end):
            _areas(vertices, geometry.triangles, taken, position[begin:end], radius[begin:end], area[begin:end])

        run_chunks(work, len(radius), CHUNK, threads)
    return np.minimum(1.0, area / np.maximum(2 * np.pi * radius**2, 1e-30))
