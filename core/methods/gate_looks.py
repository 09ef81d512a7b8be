"""What points see of VPLs, told by neighbours: every few pairs have a shadow ray, and what those around a pair found stands for it.

Where the probes of a block of VPLs disagree (`gate_guided`), every STRIDE-th point of a geometry cluster looks at each of its VPLs, another set of
points at the next one.  The nearest of those that looked at the same VPL, and what they see of the block's others, tell what another point
sees, and how sure that is: both are learned from the rays themselves, each told by its neighbours as if it had not been traced.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..rays.offsets import shadow_segment
from ..rays.packet import WIDTH, Packet, set_ray
from ..scene import DIFFUSE
from ..surfaces.visibility import shadow_packet
from ..transport import Transport
from .gate_lists import LANES

STRIDE, NEAREST = 8, 3
LEVELS, AROUND = 8, 4  # steps of what they see of the VPL, and of the others of its block
TELLING = (LEVELS + 1) * (AROUND + 1)
WHOLE, KNOWN = TELLING, TELLING + 1  # pairs of which the block's probes tell all there is; that were traced
CODES = TELLING + 2
PRIOR, PRIOR_VARIANCE = np.float32(1.0), np.float32(0.25)  # rays that every code starts with, and how unlike they are
_STEEP = np.float32(4.0)  # times the distance to the other's plane, as `nearest_plane_aware` has it
_NEAR = np.float32(1e-15)  # m^2, as in `light_block`; m
_0 = np.float32(0.0)
_1 = np.float32(1.0)


class Tracer(NamedTuple):
    """What shadow rays of a chunk need.

    scene: `Transport`.  packet: `Packet` of rays.  rows, surface: registers of the materials' programs.  cutouts: whether any light passes surfaces.
    through: (WIDTH, 3) float32, what the last rays let through.
    """

    scene: Transport
    packet: Packet
    rows: np.ndarray
    surface: np.ndarray
    cutouts: bool
    through: np.ndarray


@inlined
def set_shadow_ray(packet, lane, points, p, vpls, m):
    """The shadow ray from point p to VPL m into a lane."""
    ox, oy, oz, dx, dy, dz = shadow_segment(
        points.position[p, 0], points.position[p, 1], points.position[p, 2],
        points.ng[p, 0], points.ng[p, 1], points.ng[p, 2], points.error[p],
        vpls.position[m, 0], vpls.position[m, 1], vpls.position[m, 2],
        vpls.normal[m, 0], vpls.normal[m, 1], vpls.normal[m, 2], vpls.error[m],
    )  # fmt: skip
    set_ray(packet, lane, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE)


@kernel
def trace(tracer, count):
    """Trace the shadow rays in lanes 0..count-1; the light that they let through into `tracer.through`."""
    shadow_packet(tracer.scene, tracer.packet, tracer.rows, tracer.surface, count, DIFFUSE, tracer.cutouts, tracer.through)


@kernel
def weigh(table, j, local, n, g_max, weight):
    """Irradiance by flux / pi (m^-2) of VPL j at n points without shadows, into `weight` (POINTS,)."""
    lx, ly, lz, mx, my, mz = table[0, j], table[1, j], table[2, j], table[3, j], table[4, j], table[5, j]
    x, y, z, nx, ny, nz, gx, gy, gz = local[0], local[1], local[2], local[3], local[4], local[5], local[6], local[7], local[8]
    for k in range(n):
        dx, dy, dz = lx - x[k], ly - y[k], lz - z[k]
        r2 = dx * dx + dy * dy + dz * dz + _NEAR
        facing = max(nx[k] * dx + ny[k] * dy + nz[k] * dz, _0) * max(-(mx * dx + my * dy + mz * dz), _0)
        weight[k] = min(facing / (r2 * r2), g_max) if gx[k] * dx + gy[k] * dy + gz[k] * dz > _0 else _0


@kernel
def neighbours(local, n, near, share):
    """Of n points and each of STRIDE sets of every STRIDE-th one, the nearest others in that set and their shares, by inverse distance.

    near: (STRIDE, POINTS, NEAREST) int32, -1 where there are no more.  share: the same shape, float32.
    """
    x, y, z, gx, gy, gz = local[0], local[1], local[2], local[6], local[7], local[8]
    away = np.empty(NEAREST, np.float32)
    for s in range(STRIDE):
        for k in range(n):
            of = near[s, k]
            of[:] = -1
            away[:] = np.inf
            for i in range(s, n, STRIDE):
                if i == k:
                    continue
                dx, dy, dz = x[i] - x[k], y[i] - y[k], z[i] - z[k]
                above = _STEEP * (dx * gx[k] + dy * gy[k] + dz * gz[k])
                d = dx * dx + dy * dy + dz * dz + above * above
                if not d < away[NEAREST - 1]:
                    continue
                at = NEAREST - 1
                while at > 0 and d < away[at - 1]:
                    away[at], of[at] = away[at - 1], of[at - 1]
                    at -= 1
                away[at], of[at] = d, i
            for at in range(NEAREST):
                share[s, k, at] = _1 / (np.sqrt(away[at]) + _NEAR) if of[at] >= 0 else _0


@inlined
def _nearby(value, near, share):
    """What the nearest others see of a VPL, 0 to 1; -1 if none of them looked."""
    total = seen = _0
    for at in range(NEAREST):
        if near[at] >= 0 and value[near[at]] >= _0:
            total += share[at]
            seen += share[at] * value[near[at]]
    return min(seen / total, _1) if total > _0 else -_1


@inlined
def _code(nearby, others):
    """The number of what is seen of a VPL and of the others of its block, both 0 to 1."""
    around = np.int64(np.float32(AROUND - 1) * others + _1) if others < _1 else AROUND
    if others <= _0:
        around = 0
    return np.int64(np.float32(LEVELS) * nearby + np.float32(0.5)) * (AROUND + 1) + around


@kernel
def _found(tracer, count, lights, drawn, value, light):
    """Trace `count` rays of a block, what they let through into `value` (LANES, POINTS), and the light that they bring to `light` (3, POINTS).

    drawn: (WIDTH, 5) float64: the point's place, the VPL's column, its weight, its lane.
    """
    through = tracer.through
    trace(tracer, count)
    for i in range(count):
        k, j, lane = np.int64(drawn[i, 0]), np.int64(drawn[i, 1]), np.int64(drawn[i, 3])
        value[lane, k] = (through[i, 0] + through[i, 1] + through[i, 2]) / np.float32(3)
        for c in range(3):
            light[c, k] += np.float32(drawn[i, 2]) * lights.table[6 + c, j] * through[i, c]


@kernel
def look(tracer, points, runs, r, n, vpls, lights, block, local, near, share, g_max, drawn, weight, value, nearby, code, learned, light):
    """Trace every STRIDE-th pair of a block; the codes of all its pairs into `code` (columns, POINTS), the light of those traced to `light`.

    near, share: of `neighbours`.  learned: (3, TELLING) float32, how many rays had a code, the sum of what they found and of its square; this
    block's are added.  drawn, weight, value, nearby: scratch.  Returns the number of rays.
    """
    blocks = lights.blocks
    first, light_first = runs.first[r], blocks.first[block]
    lanes = blocks.first[block + 1] - light_first
    count = rays = 0
    for lane in range(lanes):
        j = block * LANES + lane
        value[lane] = -_1
        weigh(lights.table, j, local, n, g_max, weight)
        for k in range((light_first + lane) % STRIDE, n, STRIDE):
            if not weight[k] > _0:
                continue
            set_shadow_ray(tracer.packet, count, points, runs.order[first + k], vpls, blocks.order[light_first + lane])
            drawn[count, 0], drawn[count, 1], drawn[count, 2], drawn[count, 3] = k, j, weight[k], lane
            count += 1
            if count == WIDTH:
                _found(tracer, count, lights, drawn, value, light)
                rays += count
                count = 0
    if count:
        _found(tracer, count, lights, drawn, value, light)
        rays += count
    for lane in range(lanes):
        s = (light_first + lane) % STRIDE
        for k in range(n):
            nearby[lane, k] = _nearby(value[lane], near[s, k], share[s, k])
    for k in range(n):
        total, seen = _0, _0
        for lane in range(lanes):
            if nearby[lane, k] >= _0:
                total += _1
                seen += nearby[lane, k]
        for lane in range(lanes):
            told = np.int64(WHOLE)
            if nearby[lane, k] >= _0:
                others = nearby[lane, k]
                if total > _1:
                    others = (seen - others) / (total - _1)
                told = _code(nearby[lane, k], others)
            one = value[lane, k]
            if one >= _0:
                if told != WHOLE:
                    learned[0, told] += _1
                    learned[1, told] += one
                    learned[2, told] += one * one
                told = np.int64(KNOWN)
            code[block * LANES + lane, k] = told
    return rays


@kernel
def learn(learned, mean, doubt):
    """Mean and standard deviation of what pairs of each code let through, by the rays that had it, into (CODES,) each."""
    for q in range(TELLING):
        first = np.float32(q // (AROUND + 1)) / np.float32(LEVELS)
        count = learned[0, q] + PRIOR
        mean[q] = (learned[1, q] + PRIOR * first) / count
        doubt[q] = np.sqrt(max((learned[2, q] + PRIOR * (first * first + PRIOR_VARIANCE)) / count - mean[q] * mean[q], _0))
