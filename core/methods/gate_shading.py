"""Light of the listed VPLs on the points of geometry clusters (visibility gates paper, Section V.D).

A block of VPLs and a geometry cluster are worked on together, one VPL at a time over all points: the inner loops are plain vector code.
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..topology.gates import CELLS, SIDES
from .gate_lists import ENTERING, LANES, LEAVING, NO_GATE, NUMBER, POINTS

_TINY = np.float32(1e-15)  # m^2: keeps r^4 above zero
_ALL = np.uint32((1 << LANES) - 1)
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@kernel
def gathered(points, runs, r, local):
    """The points of a geometry cluster into `local` (9, POINTS): position (m), shading normal, geometric normal; their number."""
    first, n = runs.first[r], runs.first[r + 1] - runs.first[r]
    for k in range(n):
        p = runs.order[first + k]
        for a in range(3):
            local[a, k], local[3 + a, k], local[6 + a, k] = points.position[p, a], points.ns[p, a], points.ng[p, a]
    return n


@kernel
def scatter(light, runs, r, out):
    """Write the light (3, POINTS) of a geometry cluster to its places in out (N, 3)."""
    first = runs.first[r]
    for k in range(runs.first[r + 1] - first):
        for c in range(3):
            out[first + k, c] = light[c, k]


@kernel
def light_block(table, at, lanes, local, n, red_seen, green_seen, blue_seen, g_max, light):
    """Add the irradiance of `lanes` VPLs, from column `at`, at n points to `light` (3, POINTS).

    red_seen, green_seen, blue_seen: (LANES, POINTS) float32, what the points see of each VPL.
    """
    x, y, z, nx, ny, nz, gx, gy, gz = local[0], local[1], local[2], local[3], local[4], local[5], local[6], local[7], local[8]
    red, green, blue = light[0], light[1], light[2]
    for j in range(lanes):
        lx, ly, lz = table[0, at + j], table[1, at + j], table[2, at + j]
        mx, my, mz = table[3, at + j], table[4, at + j], table[5, at + j]
        fr, fg, fb = table[6, at + j], table[7, at + j], table[8, at + j]
        rs, gs, bs = red_seen[j], green_seen[j], blue_seen[j]
        for k in range(n):
            dx, dy, dz = lx - x[k], ly - y[k], lz - z[k]
            r2 = dx * dx + dy * dy + dz * dz + _TINY
            facing = max(nx[k] * dx + ny[k] * dy + nz[k] * dz, _0) * max(-(mx * dx + my * dy + mz * dz), _0)
            w = min(facing / (r2 * r2), g_max) if gx[k] * dx + gy[k] * dy + gz[k] * dz > _0 else _0
            red[k] += w * fr * rs[k]
            green[k] += w * fg * gs[k]
            blue[k] += w * fb * bs[k]


@kernel
def _pass_gate(table, at, gates, g, polygons, mask, local, n, passed, scratch):
    """Set `passed` (LANES, POINTS) to 1 where the line from one of n points to a VPL in `mask`, from column `at`, passes gate g; whether any does.

    scratch: (3, POINTS) float32.
    """
    c, f = gates.centre[g], gates.frame[g]
    cx, cy, cz = c[0], c[1], c[2]
    ux, uy, uz, vx, vy, vz, nx, ny, nz = f[0, 0], f[0, 1], f[0, 2], f[1, 0], f[1, 1], f[1, 2], f[2, 0], f[2, 1], f[2, 2]
    x, y, z = local[0], local[1], local[2]
    u, v, inside = scratch[0], scratch[1], scratch[2]
    radius2 = gates.radius[g] * gates.radius[g]
    low_u, low_v = -gates.extent[g, SIDES // 2], -gates.extent[g, 3 * SIDES // 4]
    to_u = np.float32(CELLS) / (gates.extent[g, 0] - low_u)
    to_v = np.float32(CELLS) / (gates.extent[g, SIDES // 4] - low_v)
    some = False
    for j in range(LANES):
        if not (mask >> np.uint32(j)) & np.uint32(1):
            continue
        ax, ay, az = table[0, at + j] - cx, table[1, at + j] - cy, table[2, at + j] - cz
        before = ax * nx + ay * ny + az * nz
        au, av, a2 = ax * ux + ay * uy + az * uz, ax * vx + ay * vy + az * vz, _0
        for k in range(n):
            dx, dy, dz = x[k] - cx, y[k] - cy, z[k] - cz
            toward = dx * nx + dy * ny + dz * nz
            # Where the line meets the gate's plane, from its centre.
            t = before / (before - toward)
            u[k] = au + t * (dx * ux + dy * uy + dz * uz - au)
            v[k] = av + t * (dx * vx + dy * vy + dz * vz - av)
            inside[k] = _1 if before * toward < _0 and u[k] * u[k] + v[k] * v[k] <= radius2 else _0
            a2 += inside[k]
        if not a2 > _0:
            continue
        of = passed[j]
        if not polygons:
            some = True
            for k in range(n):
                of[k] = max(of[k], inside[k])
            continue
        for k in range(n):
            if inside[k] > of[k]:
                i, row = np.int64(np.floor((u[k] - low_u) * to_u)), np.int64(np.floor((v[k] - low_v) * to_v))
                if 0 <= i < CELLS and 0 <= row < CELLS and (gates.raster[g, row] >> i) & 1:
                    of[k] = _1
                    some = True
    return some


@kernel
def see(lights, lists, begin, end, gate_table, local, n, seen, passed, scratch):
    """Set `seen` (LANES, POINTS) to 1 where n points see the VPLs of a block, listed in begin..end-1, through gates; whether any does.

    passed: (2, LANES, POINTS), scratch: (3, POINTS) float32, scratch.
    """
    at = lists.block[begin] * LANES
    if lists.gate[begin] == NO_GATE:
        seen[:, :n] = _1
        return True
    seen[:, :n] = _0
    gates, polygons = gate_table.gates, gate_table.polygons
    some = False
    item = begin
    while item < end:
        g, mask = lists.gate[item], lists.mask[item]
        if g < LEAVING:
            some |= _pass_gate(lights.table, at, gates, g, polygons, mask, local, n, seen, scratch)
            item += 1
            continue
        # One set: all its gates that lead out, then all that lead in.
        passed[:, :, :n] = _0
        left = entered = False
        while item < end and lists.gate[item] < ENTERING:
            g, mask = lists.gate[item] & NUMBER, lists.mask[item]
            left |= _pass_gate(lights.table, at, gates, g, polygons, mask, local, n, passed[0], scratch)
            item += 1
        while item < end and lists.gate[item] >= ENTERING:
            if left:
                entered |= _pass_gate(lights.table, at, gates, lists.gate[item] & NUMBER, polygons, _ALL, local, n, passed[1], scratch)
            item += 1
        if entered:
            for lane in range(LANES):
                one, other, of = passed[0, lane], passed[1, lane], seen[lane]
                for k in range(n):
                    of[k] = max(of[k], one[k] * other[k])
            some = True
    return some


@kernel
def shade(points, runs, begin, end, lights, lists, gate_table, g_max, out):
    """The listed light of the points of the geometry clusters begin..end-1 into their places in `out`; the pairs shaded.

    A VPL lights a point once, through however many gates their line passes.
    """
    seen, passed = np.empty((LANES, POINTS), np.float32), np.empty((2, LANES, POINTS), np.float32)
    scratch, local, light = np.empty((3, POINTS), np.float32), np.empty((9, POINTS), np.float32), np.empty((3, POINTS), np.float32)
    pairs = 0
    for r in range(begin, end):
        n = gathered(points, runs, r, local)
        light[:] = _0
        i = lists.first[r]
        while i < lists.first[r + 1]:
            block, last = lists.block[i], i + 1
            while last < lists.first[r + 1] and lists.block[last] == block:
                last += 1
            if see(lights, lists, i, last, gate_table, local, n, seen, passed, scratch):
                lanes = lights.blocks.first[block + 1] - lights.blocks.first[block]
                light_block(lights.table, block * LANES, lanes, local, n, seen, seen, seen, g_max, light)
                pairs += n * lanes
            i = last
        scatter(light, runs, r, out)
    return pairs
