"""Gate-guided visibility: what the topology and a few rays say, and shadow rays drawn by how much it matters where that may be wrong.

Beyond the visibility gates paper.  A few rays, well spread, probe every block of VPLs from every geometry cluster.  What they find, with what the
topology says (one quasi-convex cluster; two that do not see each other) as a prior, is what all pairs of the two are taken to let through: a control
variate.  Pairs are then drawn for a shadow ray by their light times the doubt about them, so that each point's noise has a given variance for the
fewest rays, and what a ray finds beside what was expected counts by the inverse of the probability (Horvitz & Thompson 1952).  So the mean is
that of all shadow rays, whatever the topology says.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..rays.offsets import shadow_segment
from ..rays.packet import WIDTH, new_packet, set_ray
from ..sampling.hashing import rotate_unit, uniform
from ..scene import DIFFUSE
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..surfaces.visibility import shadow_packet
from ..topology import SOLID
from .gate_lists import LANES, POINTS
from .gate_shading import gathered, light_block, scatter

OPEN, DARK, MIXED = 0, 1, 2
PROBES = WIDTH  # rays between a geometry cluster and a block, one packet
FIRST, PAIRS = 4, 32
# As how many probes before the first one the topology's word counts, and as how many that say the contrary.
BELIEF, DISBELIEF = np.float32(1.0), np.float32(0.25)
UNTOLD = np.float32(0.5)  # the same for either answer where it says nothing (Jeffreys' prior)
VARIANCE = np.float32(0.0042)  # of a point's light by its square, for which rays are drawn: that of well-spread ones is less
DARKER = np.float32(0.5)  # times what is expected: a point with less is lit again by more rays
LEAST = np.float32(0.2)  # of what is expected, that a point is taken to get: keeps shares finite in the dark
_GOLDEN = np.float32(0.618034)
_NEAR = np.float32(1e-15)  # m^2, as in `light_block`
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@inlined
def _facing(points, p, table, j):
    """Whether a point and a VPL face each other."""
    dx, dy, dz = table[0, j] - points.position[p, 0], table[1, j] - points.position[p, 1], table[2, j] - points.position[p, 2]
    at_point = dx * points.ns[p, 0] + dy * points.ns[p, 1] + dz * points.ns[p, 2]
    above = dx * points.ng[p, 0] + dy * points.ng[p, 1] + dz * points.ng[p, 2]
    at_light = dx * table[3, j] + dy * table[4, j] + dz * table[5, j]
    return at_point > _0 and above > _0 and at_light < _0


@inlined
def _set_shadow_ray(packet, lane, points, p, vpls, m):
    """The shadow ray from point p to VPL m into a lane."""
    ox, oy, oz, dx, dy, dz = shadow_segment(
        points.position[p, 0], points.position[p, 1], points.position[p, 2],
        points.ng[p, 0], points.ng[p, 1], points.ng[p, 2], points.error[p],
        vpls.position[m, 0], vpls.position[m, 1], vpls.position[m, 2],
        vpls.normal[m, 0], vpls.normal[m, 1], vpls.normal[m, 2], vpls.error[m],
    )  # fmt: skip
    set_ray(packet, lane, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE)


@kernel
def _trace(scene, packet, rows, surface, count, cutouts, through):
    """Trace the shadow rays in lanes 0..count-1; the light that they let through into `through` (WIDTH, 3)."""
    shadow_packet(scene, packet, rows, surface, count, DIFFUSE, cutouts, through)


@kernel
def _probe(points, runs, r, n, lights, block, vpls, packet, seed):
    """Set shadow rays between random pairs of a geometry cluster of n points and a block that face each other; their number."""
    first, light_first = runs.first[r], lights.blocks.first[block]
    lanes = lights.blocks.first[block + 1] - light_first
    wanted = min(PROBES, max(FIRST, n * lanes // PAIRS))
    rays = 0
    for k in range(wanted):
        # Points in order, lights in any: each probe stands for other pairs than the rest.
        i = min(n - 1, np.int64((np.float32(k) + uniform(seed, r, block, 2 * k)) / np.float32(wanted) * np.float32(n)))
        lane = min(lanes - 1, np.int64(uniform(seed, r, block, 2 * k + 1) * np.float32(lanes)))
        p = runs.order[first + i]
        if _facing(points, p, lights.table, block * LANES + lane):
            _set_shadow_ray(packet, rays, points, p, vpls, lights.blocks.order[light_first + lane])
            rays += 1
    return rays


@kernel
def _told(sight, own, other):
    """What the topology says of two visibility clusters: OPEN within one, DARK where they do not see each other, MIXED where it cannot tell."""
    if own == SOLID or other == SOLID:
        return MIXED
    if own == other:
        return OPEN
    return MIXED if sight[own, other] else DARK


@kernel
def _expected(told, passed, rays):
    """What pairs let through, where `passed` of so many rays did, and the standard deviation of one pair: the mean of a beta distribution."""
    yes = no = UNTOLD
    if told != MIXED:
        yes, no = BELIEF, DISBELIEF
        if told == DARK:
            yes, no = DISBELIEF, BELIEF
    mean = (passed + yes) / (np.float32(rays) + yes + no)
    return mean, np.sqrt(mean * (_1 - mean))


@kernel
def _pairs(points, runs, r, lights, block):
    """Pairs that face each other: the shadow rays of a geometry cluster and a block."""
    count = 0
    for k in range(runs.first[r], runs.first[r + 1]):
        for lane in range(lights.blocks.first[block + 1] - lights.blocks.first[block]):
            count += _facing(points, runs.order[k], lights.table, block * LANES + lane)
    return count


@kernel
def _weigh(table, j, local, n, g_max, weight):
    """Irradiance by flux / pi (m^-2) of VPL j at n points without shadows, into `weight` (POINTS,)."""
    lx, ly, lz, mx, my, mz = table[0, j], table[1, j], table[2, j], table[3, j], table[4, j], table[5, j]
    x, y, z, nx, ny, nz, gx, gy, gz = local[0], local[1], local[2], local[3], local[4], local[5], local[6], local[7], local[8]
    for k in range(n):
        dx, dy, dz = lx - x[k], ly - y[k], lz - z[k]
        r2 = dx * dx + dy * dy + dz * dz + _NEAR
        facing = max(nx[k] * dx + ny[k] * dy + nz[k] * dz, _0) * max(-(mx * dx + my * dy + mz * dz), _0)
        weight[k] = min(facing / (r2 * r2), g_max) if gx[k] * dx + gy[k] * dy + gz[k] * dz > _0 else _0


@kernel
def _correct(scene, packet, rows, surface, count, cutouts, through, lights, drawn, light):
    """Trace `count` drawn shadow rays, and add what they find beside what was expected to `light` (3, POINTS).

    drawn: (WIDTH, 4) float64: the point's place, the VPL's column, its weight by the ray's probability, what was expected.
    """
    _trace(scene, packet, rows, surface, count, cutouts, through)
    for lane in range(count):
        k, j = np.int64(drawn[lane, 0]), np.int64(drawn[lane, 1])
        for c in range(3):
            light[c, k] += np.float32(drawn[lane, 2]) * lights.table[6 + c, j] * (through[lane, c] - np.float32(drawn[lane, 3]))


@kernel
def _draw(
    scene, points, runs, r, low, high, vpls, lights, local, shines, mean, doubt, scale, phase, g_max, packet, rows, surface, cutouts, through,
    drawn, weight, light,
):  # fmt: skip
    """Shadow rays for pairs of the points low..high-1 of a geometry cluster, and what they find beside what was expected to `light` (3, POINTS).

    mean, doubt: (B,) of each block.  scale: (POINTS,), probability of a ray by the pair's light and doubt, m^2/W.  phase: (POINTS,) of the
    systematic samples of each point, whose pairs are taken in the order of VPLs in space.  Returns the number of rays.
    """
    table, blocks = lights.table, lights.blocks
    first = runs.first[r]
    n = high - low
    part = local[:, low:high]
    count = rays = 0
    for block in range(len(blocks.cluster)):
        if not shines[block]:
            continue
        for lane in range(blocks.first[block + 1] - blocks.first[block]):
            j = block * LANES + lane
            power = (table[6, j] + table[7, j] + table[8, j]) * doubt[block]
            if not power > _0:
                continue
            _weigh(table, j, part, n, g_max, weight)
            for k in range(n):
                chance = min(_1, weight[k] * power * scale[low + k])
                phase[low + k] += chance
                if phase[low + k] < _1:
                    continue
                phase[low + k] -= _1
                _set_shadow_ray(packet, count, points, runs.order[first + low + k], vpls, blocks.order[blocks.first[block] + lane])
                drawn[count, 0], drawn[count, 1], drawn[count, 2], drawn[count, 3] = low + k, j, weight[k] / chance, mean[block]
                count += 1
                if count == WIDTH:
                    _correct(scene, packet, rows, surface, count, cutouts, through, lights, drawn, light)
                    rays += count
                    count = 0
    if count:
        _correct(scene, packet, rows, surface, count, cutouts, through, lights, drawn, light)
        rays += count
    return rays


@kernel
def shade_guided(scene, vpls, points, runs, begin, end, lights, sight, cutouts, g_max, seed, out):
    """The light of all VPLs at the points of the geometry clusters begin..end-1 into their places in `out`.

    sight: (clusters, clusters) bool, as of `Topology`.  Returns (rays traced, pairs that face each other, pairs shaded).
    """
    packet, surface = new_packet(), np.zeros(SURFACE, np.float32)
    rows = new_registers(scene.materials)
    through = np.ones((WIDTH, 3), np.float32)
    full = np.ones((LANES, POINTS), np.float32)
    local, light, smooth = np.empty((9, POINTS), np.float32), np.empty((3, POINTS), np.float32), np.empty((3, POINTS), np.float32)
    one = np.empty((3, POINTS), np.float32)
    blocks = lights.blocks
    count = len(blocks.cluster)
    carried = np.empty((count, POINTS), np.float32)
    shines, mean, doubt = np.empty(count, np.bool_), np.empty(count, np.float32), np.empty(count, np.float32)
    scale, phase, weight = np.empty(POINTS, np.float32), np.empty(POINTS, np.float32), np.empty(POINTS, np.float32)
    drawn = np.empty((WIDTH, 4))
    traced = facing = pairs = 0
    for r in range(begin, end):
        n = gathered(points, runs, r, local)
        smooth[:] = _0
        for block in range(count):
            lanes = blocks.first[block + 1] - blocks.first[block]
            one[:] = _0
            light_block(lights.table, block * LANES, lanes, local, n, full, full, full, g_max, one)
            shines[block] = one[:, :n].max() > _0
            if not shines[block]:
                continue
            rays = _probe(points, runs, r, n, lights, block, vpls, packet, seed)
            passed = _0
            if rays:
                _trace(scene, packet, rows, surface, rays, cutouts, through)
                passed = through[:rays].sum() / np.float32(3)
            mean[block], doubt[block] = _expected(_told(sight, runs.cluster[r], blocks.cluster[block]), passed, rays)
            for k in range(n):
                carried[block, k] = one[0, k] + one[1, k] + one[2, k]
                for c in range(3):
                    smooth[c, k] += mean[block] * one[c, k]
            traced += rays
            facing += _pairs(points, runs, r, lights, block)
            pairs += n * lanes
        start = uniform(seed, r, 0, 2 * PROBES)
        for k in range(n):
            arriving = smooth[0, k] + smooth[1, k] + smooth[2, k]
            uncertain = _0
            for block in range(count):
                if shines[block]:
                    uncertain += doubt[block] * carried[block, k]
            # One after the other: the square of dim light is no number of float32.
            scale[k] = uncertain / arriving / arriving / VARIANCE if arriving > _0 else _0
            phase[k] = rotate_unit(start, np.float32(k) * _GOLDEN % _1)
        light[:] = smooth
        traced += _draw(
            scene, points, runs, r, 0, n, vpls, lights, local, shines, mean, doubt, scale, phase, g_max, packet, rows, surface, cutouts,
            through, drawn, weight, light,
        )  # fmt: skip
        for k in range(n):
            found = light[0, k] + light[1, k] + light[2, k]
            arriving = smooth[0, k] + smooth[1, k] + smooth[2, k]
            if found < DARKER * arriving:
                part = max(found / arriving, LEAST)
                scale[k] /= part * part
                light[:, k] = smooth[:, k]
                traced += _draw(
                    scene, points, runs, r, k, k + 1, vpls, lights, local, shines, mean, doubt, scale, phase, g_max, packet, rows, surface,
                    cutouts, through, drawn, weight, light,
                )  # fmt: skip
            for c in range(3):
                light[c, k] = max(light[c, k], _0)
        scatter(light, runs, r, out)
    return traced, facing, pairs
