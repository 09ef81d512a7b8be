"""Light of the listed VPLs on the points of geometry clusters (visibility gates paper, Section V.D).

A block of VPLs and a geometry cluster are worked on together, one VPL at a time over all points: the inner loops are plain vector code.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..topology.gates import CELLS, SIDES
from ..topology.lines import free_line
from .gate_lists import ENTERING, LANES, LEAVING, LINES, NO_GATE, NUMBER, PLACES, POINTS, place_of

# How far it is believed, beside lines of voxels, that a visibility cluster sees itself, and that a line through polygons is free.
OWN, THROUGH = np.float32(0.4), np.float32(0.6)
_place_of = inlined(place_of)
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
def _shares_of_places(local, n, share):
    """By how much each place of a geometry cluster speaks for each of its n points, into `share` (PLACES, POINTS): inverse squared distances."""
    for k in range(n):
        total = _0
        for q in range(PLACES):
            i = _place_of(q, n)
            d2 = _TINY
            for a in range(3):
                d2 += (local[a, k] - local[a, i]) ** 2
            share[q, k] = _1 / d2
            total += _1 / d2
        for q in range(PLACES):
            share[q, k] /= total


@kernel
def _faces_places(table, j, local, n):
    """Whether VPL j and any place of n points face each other."""
    for q in range(PLACES):
        k = _place_of(q, n)
        dx, dy, dz = table[0, j] - local[0, k], table[1, j] - local[1, k], table[2, j] - local[2, k]
        at_point = local[3, k] * dx + local[4, k] * dy + local[5, k] * dz
        if at_point > _0 and table[3, j] * dx + table[4, j] * dy + table[5, j] * dz < _0:
            return True
    return False


@inlined
def _free(lines, light, r, q):
    """Whether the line from a VPL's voxel to a place of geometry cluster r is free; it counts as free where either has no voxel."""
    place = lines.places[r, q]
    if light[0] < 0 or place[0] < 0:
        return True
    return free_line(lines.empty, light[0], light[1], light[2], place[0], place[1], place[2])


@kernel
def _see_lines(lines, table, r, at, lanes, share, local, n, seen):
    """What n points see of the VPLs from column `at`, by lines of voxels to their places, into `seen` (LANES, POINTS); whether anything."""
    some = False
    for lane in range(lanes):
        of, light = seen[lane], lines.lights[at + lane]
        of[:n] = _0
        if not _faces_places(table, at + lane, local, n):
            continue
        first, last = _free(lines, light, r, 0), _free(lines, light, r, PLACES - 1)
        some |= first or last
        for q in range(PLACES):
            # Where the outermost two agree, those between are not asked.
            free = first if q == 0 or first == last else last if q == PLACES - 1 else _free(lines, light, r, q)
            if free:
                some = True
                for k in range(n):
                    of[k] += share[q, k]
    return some


@kernel
def see(lights, lists, begin, end, gate_table, lines, r, share, local, n, seen, passed, scratch):
    """What n points of geometry cluster r see of the VPLs of a block, listed in begin..end-1, into `seen` (LANES, POINTS); whether anything.

    By its gates all or nothing; by them and by lines, where these are asked, a part: what gates let through is believed to THROUGH, that a
    cluster sees itself to OWN, and lines for the rest.  share: of the places, for lines.  passed: (2, LANES, POINTS), scratch: (3, POINTS)
    float32, scratch.
    """
    block, first = lists.block[begin], lists.gate[begin]
    at, lanes = block * LANES, lights.blocks.first[block + 1] - lights.blocks.first[block]
    asked = lines.empty.size > 0
    if first == LINES:
        return asked and _see_lines(lines, lights.table, r, at, lanes, share, local, n, seen)
    if first == NO_GATE:
        if not asked:
            seen[:, :n] = _1
            return True
        _see_lines(lines, lights.table, r, at, lanes, share, local, n, seen)
        for lane in range(lanes):
            for k in range(n):
                seen[lane, k] = OWN + (_1 - OWN) * seen[lane, k]
        return True
    some = _see_through(lights, lists, begin, end, gate_table, local, n, seen, passed, scratch)
    if not asked:
        return some
    some |= _see_lines(lines, lights.table, r, at, lanes, share, local, n, passed[0])
    for lane in range(lanes):
        by_gates, by_lines = seen[lane], passed[0, lane]
        for k in range(n):
            believed = THROUGH * by_gates[k]
            by_gates[k] = believed + (_1 - believed) * by_lines[k]
    return some


@kernel
def _see_through(lights, lists, begin, end, gate_table, local, n, seen, passed, scratch):
    """Set `seen` (LANES, POINTS) to 1 where n points see the VPLs of a block, listed in begin..end-1, through gates; whether any does.

    passed: (2, LANES, POINTS), scratch: (3, POINTS) float32, scratch.
    """
    at = lists.block[begin] * LANES
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
def shade(points, runs, begin, end, lights, lists, gate_table, lines, g_max, out):
    """The listed light of the points of the geometry clusters begin..end-1 into their places in `out`; the pairs shaded.

    A VPL lights a point once, through however many gates their line passes.
    """
    seen, passed = np.empty((LANES, POINTS), np.float32), np.empty((2, LANES, POINTS), np.float32)
    scratch, local, light = np.empty((3, POINTS), np.float32), np.empty((9, POINTS), np.float32), np.empty((3, POINTS), np.float32)
    share = np.empty((PLACES, POINTS), np.float32)
    pairs = 0
    for r in range(begin, end):
        n = gathered(points, runs, r, local)
        if lines.empty.size:
            _shares_of_places(local, n, share)
        light[:] = _0
        i = lists.first[r]
        while i < lists.first[r + 1]:
            block, last = lists.block[i], i + 1
            while last < lists.first[r + 1] and lists.block[last] == block:
                last += 1
            if see(lights, lists, i, last, gate_table, lines, r, share, local, n, seen, passed, scratch):
                lanes = lights.blocks.first[block + 1] - lights.blocks.first[block]
                light_block(lights.table, block * LANES, lanes, local, n, seen, seen, seen, g_max, light)
                pairs += n * lanes
            i = last
        scatter(light, runs, r, out)
    return pairs
