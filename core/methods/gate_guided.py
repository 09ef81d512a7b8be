"""Gate-guided visibility: the topology answers where it is certain, shadow rays decide the rest.

Beyond the visibility gates paper.  A block of VPLs and a geometry cluster are certain where the topology has a clear answer, one quasi-convex
cluster, or no line that passes the gates, and a few rays between them, well spread, all agree with it.  Where it has none, twice as many
rays that agree with each other are as good.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..rays.offsets import shadow_segment
from ..rays.packet import WIDTH, new_packet, set_ray
from ..sampling.hashing import uniform
from ..scene import DIFFUSE
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..surfaces.visibility import shadow_packet
from .gate_lists import LANES, NO_GATE, POINTS
from .gate_shading import gathered, light_block, scatter, see

OPEN, DARK, UNCERTAIN, NOTHING = 0, 1, 2, 3
PROBES = WIDTH  # rays of a round, one packet
AGREEING, ALONE = 2, 4  # rounds that must agree where the topology says the same, and where it does not
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
def _probe(points, runs, r, lights, block, vpls, packet, seed, round_, pairs):
    """Set shadow rays between random pairs of a geometry cluster and a block that face each other; their number, at most PROBES.

    pairs: (PROBES, 2) int64, takes the places of the point in its cluster and of the VPL in its block.
    """
    table, blocks = lights.table, lights.blocks
    first, size = runs.first[r], runs.first[r + 1] - runs.first[r]
    light_first, light_size = blocks.first[block], blocks.first[block + 1] - blocks.first[block]
    rays = 0
    for k in range(PROBES):
        # Points in order, lights in any: each probe stands for other pairs than the rest.
        i = min(
            size - 1, np.int64((np.float32(k) + uniform(seed, r, block, 2 * (round_ * PROBES + k))) / np.float32(PROBES) * np.float32(size))
        )
        lane = min(light_size - 1, np.int64(uniform(seed, r, block, 2 * (round_ * PROBES + k) + 1) * np.float32(light_size)))
        p = runs.order[first + i]
        if _facing(points, p, table, block * LANES + lane):
            _set_shadow_ray(packet, rays, points, p, vpls, blocks.order[light_first + lane])
            pairs[rays, 0], pairs[rays, 1] = i, lane
            rays += 1
    return rays


@kernel
def _united(through, count, answer):
    """What `count` traced rays say, if all of them say one thing, and that what `answer` was."""
    for lane in range(count):
        least, most = min(through[lane, 0], through[lane, 1], through[lane, 2]), max(through[lane, 0], through[lane, 1], through[lane, 2])
        said = OPEN if least == _1 else (DARK if most == _0 else UNCERTAIN)
        if said == UNCERTAIN or (answer != NOTHING and said != answer):
            return UNCERTAIN
        answer = said
    return answer


@kernel
def _answer(lights, lists, begin, end, gate_table, local, n, pairs, count, seen, entered, scratch):
    """What the topology says of `count` pairs of a block that is listed in begin..end-1, or not at all, if it says one thing of all."""
    if begin == end:
        return DARK
    if lists.gate[begin] == NO_GATE:
        return OPEN
    if not see(lights, lists, begin, end, gate_table, local, n, seen, entered, scratch):
        return DARK
    open_ = 0
    for k in range(count):
        open_ += seen[pairs[k, 1], pairs[k, 0]] > _0
    return OPEN if open_ == count else (UNCERTAIN if open_ else DARK)


@kernel
def _see_all(scene, points, runs, r, lights, block, vpls, packet, rows, surface, cutouts, through, visible):
    """Shadow rays of all pairs that face each other; what they let through into `visible` (3, LANES, POINTS); their number."""
    table, blocks = lights.table, lights.blocks
    first, size = runs.first[r], runs.first[r + 1] - runs.first[r]
    lane_of = np.empty(WIDTH, np.int64)
    rays = 0
    for light in range(blocks.first[block + 1] - blocks.first[block]):
        m = blocks.order[blocks.first[block] + light]
        i = 0
        while i < size:
            lanes = 0
            while i < size and lanes < WIDTH:
                p = runs.order[first + i]
                if _facing(points, p, table, block * LANES + light):
                    _set_shadow_ray(packet, lanes, points, p, vpls, m)
                    lane_of[lanes] = i
                    lanes += 1
                i += 1
            if lanes == 0:
                break
            _trace(scene, packet, rows, surface, lanes, cutouts, through)
            rays += lanes
            for lane in range(lanes):
                for c in range(3):
                    visible[c, light, lane_of[lane]] = through[lane, c]
    return rays


@kernel
def shade_guided(scene, vpls, points, runs, begin, end, lights, lists, gate_table, cutouts, g_max, seed, out):
    """Adds the light of all VPLs to the points of the geometry clusters begin..end-1.

    Returns (probes, rays, rays that the topology saved, pairs shaded).
    """
    packet, surface = new_packet(), np.zeros(SURFACE, np.float32)
    rows = new_registers(scene.materials)
    through = np.ones((WIDTH, 3), np.float32)
    visible, entered = np.empty((3, LANES, POINTS), np.float32), np.empty((LANES, POINTS), np.float32)
    scratch, local, light = np.empty((3, POINTS), np.float32), np.empty((9, POINTS), np.float32), np.empty((3, POINTS), np.float32)
    probed = np.empty((PROBES, 2), np.int64)
    probes = traced = saved = pairs = 0
    for r in range(begin, end):
        n = gathered(points, runs, r, local)
        light[:] = _0
        at = lists.first[r]
        for block in range(len(lights.blocks.cluster)):
            upto = at
            while upto < lists.first[r + 1] and lists.block[upto] == block:
                upto += 1
            topology, answer = UNCERTAIN, NOTHING
            for round_ in range(ALONE):
                rays = _probe(points, runs, r, lights, block, vpls, packet, seed, round_, probed)
                if rays:
                    _trace(scene, packet, rows, surface, rays, cutouts, through)
                    probes += rays
                    answer = _united(through, rays, answer)
                if round_ == 0 and answer != UNCERTAIN:
                    topology = _answer(lights, lists, at, upto, gate_table, local, n, probed, rays, visible[0], entered, scratch)
                if answer == UNCERTAIN or (answer == topology and round_ + 1 == AGREEING):
                    break
            at = upto
            if answer == UNCERTAIN or answer == NOTHING:
                # Where no pair tried faces each other, there are few to trace.
                visible[:] = _0
                traced += _see_all(scene, points, runs, r, lights, block, vpls, packet, rows, surface, cutouts, through, visible)
            else:
                saved += _pairs(points, runs, r, lights, block)
                if answer == DARK:
                    continue
                visible[:] = _1
            lanes = lights.blocks.first[block + 1] - lights.blocks.first[block]
            light_block(lights.table, block * LANES, lanes, local, n, visible[0], visible[1], visible[2], g_max, light)
            pairs += n * lanes
        scatter(light, runs, r, out)
    return probes, traced, saved, pairs


@kernel
def _pairs(points, runs, r, lights, block):
    """Pairs that face each other: the shadow rays of a geometry cluster and a block."""
    count = 0
    for k in range(runs.first[r], runs.first[r + 1]):
        for lane in range(lights.blocks.first[block + 1] - lights.blocks.first[block]):
            count += _facing(points, runs.order[k], lights.table, block * LANES + lane)
    return count
