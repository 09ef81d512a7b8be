"""Light of the listed VPLs on the points of geometry clusters (visibility gates paper, Section V.D)."""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..topology.gates import DIRECTIONS, SIDES
from .gate_lists import LANES, NO_GATE

_TINY = np.float32(1e-15)  # m^2: keeps r^4 above zero
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@kernel
def _open_gate(table, at, gates, g, polygons, px, py, pz, inside):
    """Set `inside` (LANES,) to 1 for the VPLs of a block, from column `at`, whose line to p passes gate g, and to 0 for the others."""
    cx, cy, cz = gates.centre[g, 0], gates.centre[g, 1], gates.centre[g, 2]
    f = gates.frame[g]
    x, y, z = table[0, at : at + LANES], table[1, at : at + LANES], table[2, at : at + LANES]
    radius2 = gates.radius[g] * gates.radius[g]
    toward = (px - cx) * f[2, 0] + (py - cy) * f[2, 1] + (pz - cz) * f[2, 2]
    if not polygons:
        for k in range(LANES):
            ax, ay, az = x[k] - cx, y[k] - cy, z[k] - cz
            before = ax * f[2, 0] + ay * f[2, 1] + az * f[2, 2]
            t = before / (before - toward)
            qx, qy, qz = ax + t * (px - x[k]), ay + t * (py - y[k]), az + t * (pz - z[k])
            inside[k] = _1 if before * toward < _0 and qx * qx + qy * qy + qz * qz <= radius2 else _0
        return
    for k in range(LANES):
        ax, ay, az = x[k] - cx, y[k] - cy, z[k] - cz
        before = ax * f[2, 0] + ay * f[2, 1] + az * f[2, 2]
        t = before / (before - toward)
        qx, qy, qz = ax + t * (px - x[k]), ay + t * (py - y[k]), az + t * (pz - z[k])
        u = qx * f[0, 0] + qy * f[0, 1] + qz * f[0, 2]
        v = qx * f[1, 0] + qy * f[1, 1] + qz * f[1, 2]
        beyond = _0 if before * toward < _0 else _1
        for s in range(SIDES):
            beyond += _1 if u * DIRECTIONS[s, 0] + v * DIRECTIONS[s, 1] > gates.extent[g, s] else _0
        inside[k] = _0 if beyond > _0 else _1


@kernel
def _light_of(table, at, seen, px, py, pz, nx, ny, nz, g_max):
    """Irradiance (r, g, b) at a point by the VPLs of a block, from column `at`, weighed with `seen` (LANES,)."""
    x, y, z = table[0, at : at + LANES], table[1, at : at + LANES], table[2, at : at + LANES]
    mx, my, mz = table[3, at : at + LANES], table[4, at : at + LANES], table[5, at : at + LANES]
    red, green, blue = table[6, at : at + LANES], table[7, at : at + LANES], table[8, at : at + LANES]
    r = g = b = _0
    for j in range(LANES):
        dx, dy, dz = x[j] - px, y[j] - py, z[j] - pz
        r2 = dx * dx + dy * dy + dz * dz + _TINY
        facing = max(nx * dx + ny * dy + nz * dz, _0) * max(-(mx[j] * dx + my[j] * dy + mz[j] * dz), _0)
        w = min(facing / (r2 * r2), g_max) * seen[j]
        r += w * red[j]
        g += w * green[j]
        b += w * blue[j]
    return r, g, b


@kernel
def shade(points, runs, begin, end, lights, lists, gate_table, g_max, out):
    """Adds the listed light to the points of the geometry clusters begin..end-1; the pairs shaded.

    A VPL lights a point once, through however many gates their line passes.
    """
    seen, inside = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    pairs = 0
    for r in range(begin, end):
        i = lists.first[r]
        while i < lists.first[r + 1]:
            block = lists.block[i]
            last = i + 1
            while last < lists.first[r + 1] and lists.block[last] == block:
                last += 1
            at = block * LANES
            for k in range(runs.first[r], runs.first[r + 1]):
                p = runs.order[k]
                px, py, pz = points.position[p, 0], points.position[p, 1], points.position[p, 2]
                if lists.gate[i] == NO_GATE:
                    seen[:] = _1
                else:
                    seen[:] = _0
                    for item in range(i, last):
                        _open_gate(lights.table, at, gate_table.gates, lists.gate[item], gate_table.polygons, px, py, pz, inside)
                        for lane in range(LANES):
                            bit = (lists.mask[item] >> np.uint32(lane)) & np.uint32(1)
                            seen[lane] = max(seen[lane], inside[lane] * np.float32(bit))
                red, green, blue = _light_of(lights.table, at, seen, px, py, pz, points.ns[p, 0], points.ns[p, 1], points.ns[p, 2], g_max)
                out[p, 0] += red
                out[p, 1] += green
                out[p, 2] += blue
                pairs += LANES
            i = last
    return pairs
