"""Gate-guided visibility: the topology answers where it is certain, shadow rays decide the rest, and only where it matters.

Beyond the visibility gates paper.  A few rays, well spread, probe every block of VPLs from every geometry cluster.  Where they all agree, and
the more of them the more light is at stake, their answer stands for all pairs; half as many do where the topology says the same: one
quasi-convex cluster, or two that do not see each other.  Where they disagree, lanes that carry little light get the mean of a few rays for every
few neighbouring points, and all others a shadow ray for each pair.
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
from ..topology import SOLID
from .gate_lists import LANES, POINTS
from .gate_shading import gathered, light_block, scatter

OPEN, DARK, MIXED, NOTHING = 0, 1, 2, 3
PROBES = WIDTH  # rays of a round, one packet
FIRST, PAIRS = 4, 32  # of the first round: so many at least, and one for so many pairs
ROUNDS = 8  # at most; where more would be needed, all pairs are traced
LANES_TOGETHER, POINTS_TOGETHER = 4, 16  # of what is estimated by one mean
FEW, PART = 2, 8  # rays for such a mean at least, and one of so many pairs
ENOUGH = 400.0  # rays that must agree, times the share of the light that a block carries
LITTLE = 0.006  # share of the light that lanes may carry whose visibility is a mean
_LEAST = np.float32(0.02)  # of the light without shadows, that is taken to arrive: keeps shares finite in the dark
ODD = 0.25  # share of its light by which a point differs from the rest of its geometry cluster
_TINY = np.float32(1e-20)  # W/m^2
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
def _probe(points, runs, r, low, high, lights, block, left, right, vpls, packet, seed, serial, wanted, odd, place):
    """Set shadow rays between random pairs that face each other, of points low..high-1 of a geometry cluster and VPLs left..right-1 of a block.

    serial: a number for each call with the same r and block.  odd: (POINTS,) bool, points that are left out.  place: (PROBES,) int64, takes the
    point of each ray.  Returns the number of rays, at most `wanted`.
    """
    first, light_first = runs.first[r] + low, lights.blocks.first[block] + left
    size, lanes = high - low, right - left
    rays = 0
    for k in range(wanted):
        # Points in order, lights in any: each probe stands for other pairs than the rest.
        dimension = 2 * (serial * PROBES + k)
        i = min(size - 1, np.int64((np.float32(k) + uniform(seed, r, block, dimension)) / np.float32(wanted) * np.float32(size)))
        lane = min(lanes - 1, np.int64(uniform(seed, r, block, dimension + 1) * np.float32(lanes)))
        p = runs.order[first + i]
        if not odd[low + i] and _facing(points, p, lights.table, block * LANES + left + lane):
            _set_shadow_ray(packet, rays, points, p, vpls, lights.blocks.order[light_first + lane])
            place[rays] = low + i
            rays += 1
    return rays


@kernel
def _united(through, count, answer):
    """What `count` traced rays say, if all of them say one thing, and that what `answer` was; MIXED otherwise."""
    for lane in range(count):
        least, most = min(through[lane, 0], through[lane, 1], through[lane, 2]), max(through[lane, 0], through[lane, 1], through[lane, 2])
        said = OPEN if least == _1 else (DARK if most == _0 else MIXED)
        if said == MIXED or (answer != NOTHING and said != answer):
            return MIXED
        answer = said
    return answer


@kernel
def _see_all(scene, points, runs, r, low, high, lights, block, left, right, vpls, packet, rows, surface, cutouts, through, odd, visible):
    """Shadow rays of all pairs that face each other, as of `_probe`; what they let through into `visible` (3, LANES, POINTS); their number."""
    table, blocks, first = lights.table, lights.blocks, runs.first[r]
    place = np.empty(WIDTH, np.int64)
    rays = 0
    for light in range(left, right):
        m = blocks.order[blocks.first[block] + light]
        i = low
        while i < high:
            lanes = 0
            while i < high and lanes < WIDTH:
                p = runs.order[first + i]
                if not odd[i] and _facing(points, p, table, block * LANES + light):
                    _set_shadow_ray(packet, lanes, points, p, vpls, m)
                    place[lanes] = i
                    lanes += 1
                i += 1
            if lanes == 0:
                break
            _trace(scene, packet, rows, surface, lanes, cutouts, through)
            rays += lanes
            for lane in range(lanes):
                for c in range(3):
                    visible[c, light, place[lane]] = through[lane, c]
    return rays


@kernel
def _expected(sight, own, other):
    """What the topology says of two visibility clusters: OPEN within one, DARK where they do not see each other, MIXED where it cannot tell."""
    if own == SOLID or other == SOLID:
        return MIXED
    if own == other:
        return OPEN
    return MIXED if sight[own, other] else DARK


@kernel
def _pairs(points, runs, r, lights, block):
    """Pairs that face each other: the shadow rays of a geometry cluster and a block."""
    count = 0
    for k in range(runs.first[r], runs.first[r + 1]):
        for lane in range(lights.blocks.first[block + 1] - lights.blocks.first[block]):
            count += _facing(points, runs.order[k], lights.table, block * LANES + lane)
    return count


@kernel
def _carried(lights, block, local, n, g_max, full, light, carried):
    """The light without shadows of a block at each of n points, by LANES_TOGETHER lanes, into `carried` (LANES / LANES_TOGETHER, POINTS).

    full: (LANES, POINTS) of ones.  light: (3, POINTS), scratch.  Returns whether there is any.
    """
    lanes = lights.blocks.first[block + 1] - lights.blocks.first[block]
    carried[:] = _0
    most = _0
    for part in range(-(-lanes // LANES_TOGETHER)):
        left = part * LANES_TOGETHER
        light[:] = _0
        right = min(lanes, left + LANES_TOGETHER)
        light_block(lights.table, block * LANES + left, right - left, local, n, full, full, full, g_max, light)
        for k in range(n):
            carried[part, k] = light[0, k] + light[1, k] + light[2, k]
            most = max(most, carried[part, k])
    return most > _0


@kernel
def _share(carried, arriving, n):
    """The share of the light `arriving` at n points that lanes carry, as a root of the mean square; carried: (P, POINTS)."""
    total = _0
    for k in range(n):
        at = _0
        for part in range(len(carried)):
            at += carried[part, k]
        at /= arriving[k]
        total += at * at
    return np.sqrt(total / np.float32(n))


@kernel
def _is_odd(scene, points, p, k, vpls, lights, carried, means, count, packet, rows, surface, cutouts, through, seed):
    """Whether point p, the k-th of its geometry cluster, sees much more or less of the light than the rest; and the rays that tell so.

    A point in a crack sees nothing of what all others do.  carried: (B, parts, POINTS); means: (B,) what the blocks' probes let through.
    """
    blocks = lights.blocks
    total = expected = _0
    for block in range(count):
        for part in range(carried.shape[1]):
            total += carried[block, part, k]
            expected += means[block] * carried[block, part, k]
    if not total > _0:
        return False, 0
    sum_ = _0
    rays = 0
    block = part = 0
    reached = carried[0, 0, k]
    for s in range(WIDTH):
        target = (np.float32(s) + uniform(seed, p, 0, 2 * s)) / np.float32(WIDTH) * total
        while reached <= target:
            if part + 1 < carried.shape[1]:
                part += 1
            elif block + 1 < count:
                block, part = block + 1, 0
            else:
                break
            reached += carried[block, part, k]
        left = part * LANES_TOGETHER
        lanes = min(LANES_TOGETHER, blocks.first[block + 1] - blocks.first[block] - left)
        begin = np.int64(uniform(seed, p, 0, 2 * s + 1) * np.float32(lanes))
        for step in range(lanes):
            lane = left + (begin + step) % lanes
            if _facing(points, p, lights.table, block * LANES + lane):
                _set_shadow_ray(packet, rays, points, p, vpls, blocks.order[blocks.first[block] + lane])
                rays += 1
                break
    if rays == 0:
        return False, 0
    _trace(scene, packet, rows, surface, rays, cutouts, through)
    for lane in range(rays):
        sum_ += through[lane, 0] + through[lane, 1] + through[lane, 2]
    return abs(sum_ / np.float32(3 * rays) - expected / total) > np.float32(ODD), rays


@kernel
def _light_odd(scene, points, p, vpls, lights, packet, rows, surface, cutouts, through, g_max, of):
    """The light of all VPLs at point p, by a shadow ray each, into `of` (3,); their number."""
    table, blocks = lights.table, lights.blocks
    weight, column = np.empty(WIDTH, np.float32), np.empty(WIDTH, np.int64)
    of[:] = _0
    rays = lanes = 0
    for block in range(len(blocks.cluster)):
        last = block + 1 == len(blocks.cluster)
        for lane in range(blocks.first[block + 1] - blocks.first[block]):
            j = block * LANES + lane
            if _facing(points, p, table, j):
                dx, dy, dz = table[0, j] - points.position[p, 0], table[1, j] - points.position[p, 1], table[2, j] - points.position[p, 2]
                r2 = dx * dx + dy * dy + dz * dz
                at_point = dx * points.ns[p, 0] + dy * points.ns[p, 1] + dz * points.ns[p, 2]
                at_light = -(dx * table[3, j] + dy * table[4, j] + dz * table[5, j])
                weight[lanes], column[lanes] = min(at_point * at_light / (r2 * r2), g_max), j
                _set_shadow_ray(packet, lanes, points, p, vpls, blocks.order[blocks.first[block] + lane])
                lanes += 1
            if lanes == WIDTH or (lanes > 0 and last and lane + 1 == blocks.first[block + 1] - blocks.first[block]):
                _trace(scene, packet, rows, surface, lanes, cutouts, through)
                for k in range(lanes):
                    for c in range(3):
                        of[c] += weight[k] * table[6 + c, column[k]] * through[k, c]
                rays += lanes
                lanes = 0
    return rays


@kernel
def shade_guided(scene, vpls, points, runs, begin, end, lights, sight, cutouts, g_max, seed, out):
    """The light of all VPLs at the points of the geometry clusters begin..end-1 into their places in `out`.

    sight: (clusters, clusters) bool, as of `Topology`.  Returns (rays traced, pairs that face each other, pairs shaded).
    """
    packet, surface = new_packet(), np.zeros(SURFACE, np.float32)
    rows = new_registers(scene.materials)
    through = np.ones((WIDTH, 3), np.float32)
    full, visible = np.ones((LANES, POINTS), np.float32), np.empty((3, LANES, POINTS), np.float32)
    local, light, scratch = np.empty((9, POINTS), np.float32), np.empty((3, POINTS), np.float32), np.empty((3, POINTS), np.float32)
    blocks = lights.blocks
    count = len(blocks.cluster)
    carried = np.zeros((count, LANES // LANES_TOGETHER, POINTS), np.float32)
    arriving, shines = np.empty(POINTS, np.float32), np.empty(count, np.bool_)
    said, at, means = np.empty((count, PROBES), np.float32), np.empty((count, PROBES), np.int64), np.empty(count, np.float32)
    odd, place, exact = np.empty(POINTS, np.bool_), np.empty(PROBES, np.int64), np.empty(3, np.float32)
    answer, agreed = np.empty(count, np.int64), np.empty(count, np.int64)
    traced = facing = pairs = 0
    for r in range(begin, end):
        n = gathered(points, runs, r, local)
        light[:] = _0
        arriving[:] = _TINY
        odd[:] = False
        at[:] = -1
        for block in range(count):
            shines[block] = _carried(lights, block, local, n, g_max, full, scratch, carried[block])
            answer[block], agreed[block], means[block] = NOTHING, 0, _0
            if not shines[block]:
                continue
            lanes = blocks.first[block + 1] - blocks.first[block]
            wanted = min(PROBES, max(FIRST, n * lanes // PAIRS))
            rays = _probe(points, runs, r, 0, n, lights, block, 0, lanes, vpls, packet, seed, 0, wanted, odd, place)
            means[block] = _LEAST
            if rays == 0:
                continue
            _trace(scene, packet, rows, surface, rays, cutouts, through)
            traced += rays
            means[block] = through[:rays].sum() / np.float32(3 * rays)
            for k in range(rays):
                said[block, k], at[block, k] = (through[k, 0] + through[k, 1] + through[k, 2]) / np.float32(3), place[k]
        for k in range(n):
            p = runs.order[runs.first[r] + k]
            odd[k], rays = _is_odd(scene, points, p, k, vpls, lights, carried, means, count, packet, rows, surface, cutouts, through, seed)
            traced += rays
        for block in range(count):
            if not shines[block]:
                continue
            for k in range(PROBES):
                if at[block, k] >= 0 and not odd[at[block, k]]:
                    told = OPEN if said[block, k] == _1 else (DARK if said[block, k] == _0 else MIXED)
                    answer[block] = told if answer[block] in (NOTHING, told) else MIXED
                    agreed[block] += 1
            for part in range(carried.shape[1]):
                for k in range(n):
                    arriving[k] += max(_LEAST, means[block]) * carried[block, part, k]
        for block in range(count):
            if not shines[block]:
                continue
            lanes = blocks.first[block + 1] - blocks.first[block]
            facing += _pairs(points, runs, r, lights, block)
            needed = ENOUGH * _share(carried[block], arriving, n)
            if answer[block] == _expected(sight, runs.cluster[r], blocks.cluster[block]):
                needed *= 0.5
            if needed > ROUNDS * PROBES:
                answer[block] = MIXED
            for round_ in range(1, ROUNDS):
                if answer[block] == MIXED or answer[block] == NOTHING or agreed[block] >= needed:
                    break
                rays = _probe(points, runs, r, 0, n, lights, block, 0, lanes, vpls, packet, seed, round_, PROBES, odd, place)
                if rays:
                    _trace(scene, packet, rows, surface, rays, cutouts, through)
                    traced += rays
                    answer[block] = _united(through, rays, answer[block])
                agreed[block] += PROBES
            if answer[block] == DARK:
                continue
            if answer[block] == OPEN:
                light_block(lights.table, block * LANES, lanes, local, n, full, full, full, g_max, light)
                pairs += n * lanes
                continue
            for left in range(0, lanes, LANES_TOGETHER):
                right, part = min(lanes, left + LANES_TOGETHER), left // LANES_TOGETHER
                little = _share(carried[block, part : part + 1], arriving, n) <= LITTLE
                for low in range(0, n, POINTS_TOGETHER):
                    high = min(n, low + POINTS_TOGETHER)
                    rays = 0
                    if little:
                        serial = ROUNDS + part * (POINTS // POINTS_TOGETHER) + low // POINTS_TOGETHER
                        few = max(FEW, (high - low) * (right - left) // PART)
                        rays = _probe(points, runs, r, low, high, lights, block, left, right, vpls, packet, seed, serial, few, odd, place)
                    if rays:
                        _trace(scene, packet, rows, surface, rays, cutouts, through)
                        for c in range(3):
                            visible[c, left:right, low:high] = through[:rays, c].sum() / np.float32(rays)
                    else:
                        visible[:, left:right, low:high] = _0
                        rays = _see_all(
                            scene,
                            points,
                            runs,
                            r,
                            low,
                            high,
                            lights,
                            block,
                            left,
                            right,
                            vpls,
                            packet,
                            rows,
                            surface,
                            cutouts,
                            through,
                            odd,
                            visible,
                        )
                    traced += rays
            light_block(lights.table, block * LANES, lanes, local, n, visible[0], visible[1], visible[2], g_max, light)
            pairs += n * lanes
        for i in range(n):
            if odd[i]:
                traced += _light_odd(
                    scene, points, runs.order[runs.first[r] + i], vpls, lights, packet, rows, surface, cutouts, through, g_max, exact
                )
                light[:, i] = exact
        scatter(light, runs, r, out)
    return traced, facing, pairs
