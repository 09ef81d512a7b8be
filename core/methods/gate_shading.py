"""Light of the listed VPLs on the points of geometry clusters (visibility gates paper, Section V.D)."""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..topology.gates import CELLS, SIDES
from .gate_lists import ENTRANCE, LANES, NO_GATE

_TINY = np.float32(1e-15)  # m^2: keeps r^4 above zero
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@kernel
def _pass_gate(table, at, gates, g, polygons, px, py, pz, mask, passed, scratch):
    """Set `passed` (LANES,) to 1 for those VPLs of a block, from column `at`, in `mask` whose line to p passes gate g; whether any does.

    scratch: (3 or more, LANES) float32.
    """
    cx, cy, cz = gates.centre[g, 0], gates.centre[g, 1], gates.centre[g, 2]
    ux, uy, uz = gates.frame[g, 0, 0], gates.frame[g, 0, 1], gates.frame[g, 0, 2]
    vx, vy, vz = gates.frame[g, 1, 0], gates.frame[g, 1, 1], gates.frame[g, 1, 2]
    nx, ny, nz = gates.frame[g, 2, 0], gates.frame[g, 2, 1], gates.frame[g, 2, 2]
    x, y, z = table[0, at : at + LANES], table[1, at : at + LANES], table[2, at : at + LANES]
    radius2 = gates.radius[g] * gates.radius[g]
    dx, dy, dz = px - cx, py - cy, pz - cz
    toward = dx * nx + dy * ny + dz * nz
    u, v, inside = scratch[0], scratch[1], scratch[2]
    total = _0
    for k in range(LANES):
        ax, ay, az = x[k] - cx, y[k] - cy, z[k] - cz
        before = ax * nx + ay * ny + az * nz
        # Where the line meets the gate's plane, from its centre.
        t = before / (before - toward)
        qx, qy, qz = ax + t * (dx - ax), ay + t * (dy - ay), az + t * (dz - az)
        u[k], v[k] = qx * ux + qy * uy + qz * uz, qx * vx + qy * vy + qz * vz
        among = np.float32((mask >> np.uint32(k)) & np.uint32(1))
        inside[k] = among if before * toward < _0 and u[k] * u[k] + v[k] * v[k] <= radius2 else _0
        total += inside[k]
    if total > _0 and polygons:
        total = _0
        low_u, low_v = -gates.extent[g, SIDES // 2], -gates.extent[g, 3 * SIDES // 4]
        to_u = np.float32(CELLS) / (gates.extent[g, 0] - low_u)
        to_v = np.float32(CELLS) / (gates.extent[g, SIDES // 4] - low_v)
        for k in range(LANES):
            if inside[k] > _0:
                i, j = np.int64(np.floor((u[k] - low_u) * to_u)), np.int64(np.floor((v[k] - low_v) * to_v))
                covered = 0 <= i < CELLS and 0 <= j < CELLS and (gates.raster[g, j] >> i) & 1
                inside[k] = _1 if covered else _0
                total += inside[k]
    if total > _0:
        for k in range(LANES):
            passed[k] = max(passed[k], inside[k])
    return total > _0


@kernel
def see(lights, lists, begin, end, gate_table, px, py, pz, seen, scratch):
    """Set `seen` (LANES,) to 1 for the VPLs of a block, listed in begin..end-1, whose line to p passes the gates; whether any does.

    scratch: (4, LANES) float32.
    """
    at = lists.block[begin] * LANES
    if lists.gate[begin] == NO_GATE:
        seen[:] = _1
        return True
    entered = scratch[3]
    seen[:] = _0
    entered[:] = _0
    leaves = enters = False
    for item in range(begin, end):
        g, mask = lists.gate[item], lists.mask[item]
        if g < ENTRANCE:
            leaves |= _pass_gate(lights.table, at, gate_table.gates, g, gate_table.polygons, px, py, pz, mask, seen, scratch)
        elif leaves:
            enters |= _pass_gate(lights.table, at, gate_table.gates, g - ENTRANCE, gate_table.polygons, px, py, pz, mask, entered, scratch)
        else:
            return False
    if gate_table.polygons:
        for k in range(LANES):
            seen[k] *= entered[k]
        return enters
    return leaves


@kernel
def light_of(table, at, red_seen, green_seen, blue_seen, points, p, g_max):
    """Irradiance (r, g, b) at point p by the VPLs of a block, from column `at`, each channel weighed with what is seen of it (LANES,)."""
    px, py, pz = points.position[p, 0], points.position[p, 1], points.position[p, 2]
    nx, ny, nz = points.ns[p, 0], points.ns[p, 1], points.ns[p, 2]
    gx, gy, gz = points.ng[p, 0], points.ng[p, 1], points.ng[p, 2]
    x, y, z = table[0, at : at + LANES], table[1, at : at + LANES], table[2, at : at + LANES]
    mx, my, mz = table[3, at : at + LANES], table[4, at : at + LANES], table[5, at : at + LANES]
    red, green, blue = table[6, at : at + LANES], table[7, at : at + LANES], table[8, at : at + LANES]
    r = g = b = _0
    for j in range(LANES):
        dx, dy, dz = x[j] - px, y[j] - py, z[j] - pz
        r2 = dx * dx + dy * dy + dz * dz + _TINY
        facing = max(nx * dx + ny * dy + nz * dz, _0) * max(-(mx[j] * dx + my[j] * dy + mz[j] * dz), _0)
        w = min(facing / (r2 * r2), g_max) if gx * dx + gy * dy + gz * dz > _0 else _0
        r += w * red[j] * red_seen[j]
        g += w * green[j] * green_seen[j]
        b += w * blue[j] * blue_seen[j]
    return r, g, b


@kernel
def shade(points, runs, begin, end, lights, lists, gate_table, g_max, out):
    """Adds the listed light to the points of the geometry clusters begin..end-1; the pairs shaded.

    A VPL lights a point once, through however many gates their line passes.
    """
    seen, scratch = np.empty(LANES, np.float32), np.empty((4, LANES), np.float32)
    pairs = 0
    for r in range(begin, end):
        i = lists.first[r]
        while i < lists.first[r + 1]:
            last = i + 1
            while last < lists.first[r + 1] and lists.block[last] == lists.block[i]:
                last += 1
            at = lists.block[i] * LANES
            for k in range(runs.first[r], runs.first[r + 1]):
                p = runs.order[k]
                px, py, pz = points.position[p, 0], points.position[p, 1], points.position[p, 2]
                if not see(lights, lists, i, last, gate_table, px, py, pz, seen, scratch):
                    continue
                red, green, blue = light_of(lights.table, at, seen, seen, seen, points, p, g_max)
                out[p, 0] += red
                out[p, 1] += green
                out[p, 2] += blue
                pairs += LANES
            i = last
    return pairs
