"""Paths from the camera's side: what light leaves the surface that a gather ray meets.

VPLs cannot serve surfaces that are close to each other (their geometry term is clamped); there, and for
glossy reflections, a short path tracer continues from the hit: direct light at every surface, a cosine
ray to the next one.  Unbiased, and never blind to contact.
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel, leaf
from ..lamps.direct import direct_irradiance_at
from ..rays.offsets import hit_point, offset_origin
from ..rays.packet import new_packet
from ..rays.trace import ALL, intersect1
from ..sampling.hashing import uniform
from ..sampling.maps import cosine_hemisphere, to_world
from ..scene import DIFFUSE, TRANSPARENT
from ..surfaces.layout import SURFACE, TRANSPARENCY, total_albedo_average
from ..surfaces.normals import shading_normal
from ..surfaces.program import MEAN_VIEW, evaluate, new_registers
from ..threads import run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints

CHUNK = 1024  # points a chunk
MAX_PASSED = 64  # transparent surfaces that one ray passes at most
_0 = np.float32(0.0)
_1 = np.float32(1.0)

# Dimensions of the hash for one vertex of a path.
DIMENSIONS = 100


@leaf
def nearest_surface(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, reach, kinds, seed, path, dimension):
    """The nearest surface along a ray that does not let it through, its material evaluated into `surface`.

    Returns (triangle or -1, u, v, t, r, g, b): (r, g, b) weighs what is seen, or what lies beyond all surfaces, for
    what was passed.
    """
    r = g = b = _1
    start = _0
    for layer in range(MAX_PASSED):
        triangle, t, u, v = intersect1(scene.rays, ALL, packet, ox, oy, oz, dx, dy, dz, start, reach, kinds)
        if triangle < 0:
            return -1, _0, _0, reach, r, g, b
        evaluate(scene.materials, scene.material[triangle], scene.attributes, triangle, u, v, np.float32(MEAN_VIEW), rows, surface)
        if not scene.materials.flags[scene.material[triangle]] & TRANSPARENT:
            return triangle, u, v, t, r, g, b
        tr, tg, tb = surface[TRANSPARENCY], surface[TRANSPARENCY + 1], surface[TRANSPARENCY + 2]
        chance = min(_1, max(tr, tg, tb))
        if uniform(seed, path, dimension, layer) >= chance:
            rest = _1 / (_1 - chance)
            return triangle, u, v, t, r * rest, g * rest, b * rest
        r, g, b = r * tr / chance, g * tg / chance, b * tb / chance
        start = t + np.float32(1e-5) * abs(t)
    return -1, _0, _0, reach, _0, _0, _0


@leaf
def path_irradiance(scene, packet, rows, surface, x, y, z, error, gx, gy, gz, sx, sy, sz, bounces, seed, path):
    """One sample of the irradiance at a point: direct light, and light over up to `bounces` - 1 more surfaces.

    (x, y, z), error, g, s: the point, its rounding error, its normals on the side that is looked at.
    Returns (r, g, b) in W/m^2; its mean is exact.
    """
    er = eg = eb = _0
    wr = wg = wb = _1
    for vertex in range(bounces):
        r, g, b = direct_irradiance_at(
            scene, packet, rows, surface, x, y, z, error, gx, gy, gz, sx, sy, sz, seed, path, vertex * DIMENSIONS
        )
        er, eg, eb = er + wr * r, eg + wg * g, eb + wb * b
        if vertex + 1 == bounces:
            break
        if vertex >= 1:  # russian roulette by what the path still carries
            go_on = min(np.float32(0.95), max(wr, wg, wb))
            if uniform(seed, path, vertex * DIMENSIONS, 5) >= go_on:
                break
            wr, wg, wb = wr / go_on, wg / go_on, wb / go_on
        lx, ly, lz = cosine_hemisphere(uniform(seed, path, vertex * DIMENSIONS, 6), uniform(seed, path, vertex * DIMENSIONS, 7))
        dx, dy, dz = to_world(lx, ly, lz, sx, sy, sz)
        if gx * dx + gy * dy + gz * dz <= 0:
            break
        ox, oy, oz = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
        triangle, u, v, _, r, g, b = nearest_surface(
            scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, np.float32(np.inf), DIFFUSE, seed, path, vertex * DIMENSIONS + 8
        )
        if triangle < 0:
            break
        ar, ag, ab = total_albedo_average(surface)
        wr, wg, wb = wr * r * ar, wg * g * ag, wb * b * ab
        if not max(wr, wg, wb) > 0:
            break
        x, y, z, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
        sx, sy, sz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
        if gx * dx + gy * dy + gz * dz > 0:
            gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
    return er, eg, eb


@kernel
def _tail_chunk(scene, position, error, ng, ns, begin, end, bounces, seed, out):
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    for i in range(begin, end):
        out[i, 0], out[i, 1], out[i, 2] = path_irradiance(
            scene, packet, rows, surface, position[i, 0], position[i, 1], position[i, 2], error[i],
            ng[i, 0], ng[i, 1], ng[i, 2], ns[i, 0], ns[i, 1], ns[i, 2], bounces, seed, np.uint32(i),
        )  # fmt: skip


def tail_irradiance(scene: Transport, points: ShadingPoints, bounces: int, seed: int, threads: int = 0) -> np.ndarray:
    """One sample of `path_irradiance` at each of N points, (N, 3) float32 W/m^2."""
    out = np.zeros((len(points.pixel), 3), np.float32)

    def work(begin, end):
        _tail_chunk(scene, points.position, points.error, points.ng, points.ns, begin, end, bounces, np.uint32(seed), out)

    run_chunks(work, len(out), CHUNK, threads)
    return out
