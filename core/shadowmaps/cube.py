"""Cube shadow maps: the distance from a light to what is nearest, in the directions of a cube's texels.

As in Franchi & Ferrante's report on instant radiosity, "Rendering the Point Light with Shadows": world distances,
a static bias plus one that grows with 1 - n.l, and percentage-closer filtering over offset look-ups.  Both biases
are in units of a texel's width at the light's distance, so that they hold at any scale and resolution.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..rays.packet import WIDTH, hit_t, hit_triangle, new_packet, set_ray
from ..rays.trace import COHERENT, OPAQUE, intersect_packet
from ..sampling.hashing import uniform
from ..threads import run_chunks

STATIC_BIAS = np.float32(0.6)  # texels
SLOPE_BIAS = np.float32(3.0)  # texels, at grazing light
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)


@inlined
def face_direction(face, a, b):
    """Direction (not unit) through the point (a, b), both -1..1, of a cube's face: +x -x +y -y +z -z."""
    if face == 0:
        return _1, a, b
    if face == 1:
        return -_1, a, b
    if face == 2:
        return a, _1, b
    if face == 3:
        return a, -_1, b
    if face == 4:
        return a, b, _1
    return a, b, -_1


@inlined
def face_texel(dx, dy, dz, resolution):
    """(face, row, column) of the texel that a direction passes."""
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        face, a, b, m = (0 if dx > 0 else 1), dy, dz, ax
    elif ay >= az:
        face, a, b, m = (2 if dy > 0 else 3), dx, dz, ay
    else:
        face, a, b, m = (4 if dz > 0 else 5), dx, dy, az
    m = max(m, np.float32(1e-30))
    column = np.int64((a / m * _HALF + _HALF) * np.float32(resolution))
    row = np.int64((b / m * _HALF + _HALF) * np.float32(resolution))
    return face, min(max(row, 0), resolution - 1), min(max(column, 0), resolution - 1)


@kernel
def _fill(rays, position, error, normal, begin, end, kinds, maps):
    """Distances of the lights begin..end-1 into maps (M, 6, R, R). A light without a surface has the normal 0."""
    resolution = maps.shape[2]
    packet = new_packet()
    step = np.float32(2.0) / np.float32(resolution)
    count = 0
    for i in range(begin, end):
        x = position[i, 0] + error[i] * normal[i, 0]
        y = position[i, 1] + error[i] * normal[i, 1]
        z = position[i, 2] + error[i] * normal[i, 2]
        for face in range(6):
            for texel in range(0, resolution * resolution, WIDTH):
                lanes = min(WIDTH, resolution * resolution - texel)
                for lane in range(lanes):
                    row, column = (texel + lane) // resolution, (texel + lane) % resolution
                    a, b = (np.float32(column) + _HALF) * step - _1, (np.float32(row) + _HALF) * step - _1
                    dx, dy, dz = face_direction(face, a, b)
                    scale = _1 / np.sqrt(dx * dx + dy * dy + dz * dz)
                    # What lies behind the light's own surface is never asked for.
                    behind = (dx * normal[i, 0] + dy * normal[i, 1] + dz * normal[i, 2]) < 0
                    far = -_1 if behind else np.float32(np.inf)
                    set_ray(packet, lane, x, y, z, dx * scale, dy * scale, dz * scale, _0, far, kinds)
                    count += not behind
                intersect_packet(rays, OPAQUE | COHERENT, packet, lanes)
                for lane in range(lanes):
                    row, column = (texel + lane) // resolution, (texel + lane) % resolution
                    t = hit_t(packet, lane)
                    maps[i, face, row, column] = np.float32(np.inf) if hit_triangle(packet, lane) < 0 or t < 0 else t
    return count


def cube_maps(rays, position, error, normal, resolution: int, kinds: int, threads: int = 0) -> tuple[np.ndarray, int]:
    """Shadow maps of M lights.

    Args:
        rays: `RayScene.tables`.  position, normal: (M, 3) float32, error: (M,) float32 (zeros for a free point).
        resolution: texels along a face's edge.  kinds: bits of ray kinds that the occluders must be visible to.

    Returns:
        (M, 6, R, R) float32 distances (m), inf where nothing is hit; and the rays traced.  Cut-outs cast no shadow.
    """
    maps = np.full((len(position), 6, resolution, resolution), np.inf, np.float32)
    rays_traced = sum(run_chunks(lambda b, e: _fill(rays, position, error, normal, b, e, kinds, maps), len(position), 1, threads))
    return maps, rays_traced


@kernel
def lit_share(maps, light, dx, dy, dz, cosine, samples, seed, point):
    """Share of the light that arrives at a point, by percentage-closer filtering over `samples` look-ups.

    d: from the light to the point (not unit).  cosine: of the light with the point's normal.
    """
    resolution = maps.shape[2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    if not distance > 0:
        return _1
    texel = np.float32(2.0) / np.float32(resolution)
    bias = distance * texel * (STATIC_BIAS + SLOPE_BIAS * (_1 - min(_1, abs(cosine))))
    lit = 0
    for s in range(samples):
        ox = oy = oz = _0
        if samples > 1:
            spread = texel * distance
            ox = spread * (uniform(seed, point, s, 0) - _HALF)
            oy = spread * (uniform(seed, point, s, 1) - _HALF)
            oz = spread * (uniform(seed, point, s, 2) - _HALF)
        face, row, column = face_texel(dx + ox, dy + oy, dz + oz, resolution)
        if distance - bias <= maps[light, face, row, column]:
            lit += 1
    return np.float32(lit) / np.float32(samples)
