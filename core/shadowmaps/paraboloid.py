"""Paraboloid shadow maps: the distances from a light to what is nearest in the half-space before it.

Dong et al. 2009, Section 4.2 (after Brabec, Annen & Seidel 2002).  The map is the stereographic projection: a unit direction
(x, y, z) of the light's frame is the point (x, y) / (1 + z) of the unit disk, small circles stay circles, and a
small angle is 1 / (1 + z) of it in the map.  Texels outside of the disk lie behind the light and stay empty.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..rays.packet import OCCLUDED, T_FAR, WIDTH, hit_t, new_packet, set_ray
from ..rays.trace import COHERENT, CUTOUT, OPAQUE, intersect_packet, occluded_packet
from ..scene import DIFFUSE
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..surfaces.visibility import OUTSIDE, nearest_surface
from ..threads import run_chunks
from ..transport import Transport

EMPTY = np.float32(-1.0)  # depth of texels outside of the disk
TILE = 4  # texels along the edge of a packet
ROWS = 32  # of a map, in one piece of work
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)


@inlined
def disk_to_direction(s, t):
    """Unit direction (x, y, z), z >= 0, of the point (s, t) of the unit disk."""
    r2 = s * s + t * t
    scale = _1 / (_1 + r2)
    return _2 * s * scale, _2 * t * scale, (_1 - r2) * scale


@inlined
def direction_to_disk(x, y, z):
    """The point of the unit disk of a unit direction with z >= 0."""
    scale = _1 / (_1 + z)
    return x * scale, y * scale


@kernel
def _fill(scene, origin, frame, begin, end, kinds, cutouts, seed, maps):
    """Depths of the rows begin..end-1, counted over all maps, into maps (M, R, R); returns the rays traced."""
    resolution = maps.shape[1]
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    rows = new_registers(scene.materials)
    direction = np.empty((WIDTH, 3), np.float32)
    inside = np.empty(WIDTH, np.bool_)
    step = _2 / np.float32(resolution)
    count = 0
    for top in range(begin, end, TILE):
        m, row0 = top // resolution, top % resolution
        x, y, z = origin[m, 0], origin[m, 1], origin[m, 2]
        for column0 in range(0, resolution, TILE):
            any_inside = False
            for lane in range(WIDTH):
                s = (np.float32(column0 + lane % TILE) + _HALF) * step - _1
                t = (np.float32(row0 + lane // TILE) + _HALF) * step - _1
                inside[lane] = s * s + t * t < _1
                a, b, c = disk_to_direction(s, t)
                for axis in range(3):
                    direction[lane, axis] = a * frame[m, 0, axis] + b * frame[m, 1, axis] + c * frame[m, 2, axis]
                far = np.float32(np.inf) if inside[lane] else -_1
                set_ray(packet, lane, x, y, z, direction[lane, 0], direction[lane, 1], direction[lane, 2], _0, far, kinds)
                any_inside |= inside[lane]
                count += inside[lane]
            if any_inside:
                intersect_packet(scene.rays, OPAQUE | COHERENT, packet, WIDTH)
            for lane in range(WIDTH):
                depth = hit_t(packet, lane) if inside[lane] else EMPTY
                maps[m, row0 + lane // TILE, column0 + lane % TILE] = depth
            if cutouts and any_inside:
                count += _cut_out(scene, packet, rows, surface, x, y, z, direction, inside, m, row0, column0, kinds, seed, maps)
    return count


@kernel
def _cut_out(scene, packet, rows, surface, x, y, z, direction, inside, m, row0, column0, kinds, seed, maps):
    """Depths of one tile anew where a transparent surface is nearer: it counts as there or not at random; returns the rays traced."""
    resolution = maps.shape[1]
    for lane in range(WIDTH):
        far = maps[m, row0 + lane // TILE, column0 + lane % TILE] if inside[lane] else -_1
        set_ray(packet, lane, x, y, z, direction[lane, 0], direction[lane, 1], direction[lane, 2], _0, far, kinds)
    occluded_packet(scene.rays, CUTOUT | COHERENT, packet, WIDTH)
    found = np.empty(WIDTH, np.bool_)
    count = 0
    for lane in range(WIDTH):
        found[lane] = packet.f[T_FAR * WIDTH + lane] == OCCLUDED and inside[lane]
    for lane in range(WIDTH):
        if found[lane]:
            row, column = row0 + lane // TILE, column0 + lane % TILE
            path = np.uint32((m * resolution + row) * resolution + column)
            _, _, _, depth, _, _, _, _, _ = nearest_surface(
                scene, packet, rows, surface, x, y, z, direction[lane, 0], direction[lane, 1], direction[lane, 2],
                maps[m, row, column], kinds, seed, path, 61, OUTSIDE,
            )  # fmt: skip
            maps[m, row, column] = depth
            count += 1
    return count


def paraboloid_maps(
    scene: Transport,
    origin: np.ndarray,
    frame: np.ndarray,
    resolution: int,
    cutouts: bool,
    *,
    kinds: int = DIFFUSE,
    seed: int = 0,
    threads: int = 0,
) -> tuple[np.ndarray, int]:
    """Depth maps (M, R, R) float32 (m; infinite where nothing is, EMPTY outside of the disk), and the rays that filled them.

    origin: (M, 3) float32.  frame: (M, 3, 3) float32, rows tangent, bitangent and axis of each map.
    resolution: R, a multiple of 32.  cutouts: whether transparent surfaces count, open or closed at random.
    kinds: of rays.
    """
    maps = np.empty((len(origin), resolution, resolution), np.float32)

    def work(begin, end):
        return _fill(scene, origin, frame, begin, end, kinds, cutouts, np.uint32(seed), maps)

    return maps, sum(run_chunks(work, len(origin) * resolution, ROWS, threads))
