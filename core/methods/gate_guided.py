"""Gate-guided visibility: what the topology and a few rays say, and shadow rays drawn by how much it matters where that may be wrong.

Beyond the visibility gates paper.  A few rays, well spread, probe every block of VPLs from every geometry cluster.  What they find, with what the
topology says (one quasi-convex cluster; two that do not see each other) as a prior, is what all pairs of the two are taken to let through; where that
leaves much in doubt, every few pairs are traced, and tell the others (`gate_looks`).  This is a control variate: pairs are then drawn for a
shadow ray by their light times the doubt about them, so that each point's noise has a given variance for the fewest rays, and what a ray finds
beside what was expected counts by the inverse of the probability (Horvitz & Thompson 1952).  So the mean is that of all shadow rays, whatever the
topology says.  Last, the corrections of a geometry cluster are drawn towards their mean as far as they are noise (James & Stein 1961).
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..rays.packet import WIDTH, new_packet
from ..sampling.hashing import rotate_unit, uniform
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..topology import SOLID
from .gate_lists import LANES, POINTS
from .gate_looks import CODES, NEAREST, STRIDE, TELLING, WHOLE, Tracer, learn, look, neighbours, set_shadow_ray, trace, weigh
from .gate_shading import gathered, light_block, scatter

OPEN, DARK, MIXED = 0, 1, 2
PROBES = WIDTH  # rays between a geometry cluster and a block, one packet
FIRST, PAIRS = 4, 32
# As how many probes before the first one the topology's word counts, and as how many that say the contrary.
BELIEF, DISBELIEF = np.float32(1.0), np.float32(0.25)
UNTOLD = np.float32(0.5)  # the same for either answer where it says nothing (Jeffreys' prior)
VARIANCE = np.float32(0.0050)  # of a point's light by its square, for which rays are drawn: that of well-spread ones is less
STEP = np.float32(2.0)  # at most, in standard deviations of the noise, that a correction is drawn towards the mean
FEWEST = 8  # corrections whose mean says something of each
DARKER = np.float32(0.5)  # times what is expected: a point with less is lit again by more rays
LEAST = np.float32(0.2)  # of what is expected, that a point is taken to get: keeps shares finite in the dark
_GOLDEN = np.float32(0.618034)
_TINY = np.float32(1e-20)
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@inlined
def _sum(light, k):
    """Of the three colours of a point's light."""
    return light[0, k] + light[1, k] + light[2, k]


@inlined
def _facing(points, p, table, j):
    """Whether a point and a VPL face each other."""
    dx, dy, dz = table[0, j] - points.position[p, 0], table[1, j] - points.position[p, 1], table[2, j] - points.position[p, 2]
    at_point = dx * points.ns[p, 0] + dy * points.ns[p, 1] + dz * points.ns[p, 2]
    above = dx * points.ng[p, 0] + dy * points.ng[p, 1] + dz * points.ng[p, 2]
    at_light = dx * table[3, j] + dy * table[4, j] + dz * table[5, j]
    return at_point > _0 and above > _0 and at_light < _0


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
            set_shadow_ray(packet, rays, points, p, vpls, lights.blocks.order[light_first + lane])
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
def _correct(tracer, count, lights, drawn, light, last, noise):
    """Trace `count` drawn shadow rays, and add what they find beside what was expected to `light` (3, POINTS).

    drawn: (WIDTH, 5) float64: the point's place, the VPL's column, its weight by the ray's probability, what was expected, the probability.
    noise: (POINTS,) variance of each point's sum, by successive differences of its systematic samples; last: (POINTS,) the sample before.
    """
    through = tracer.through
    trace(tracer, count)
    for lane in range(count):
        k, j = np.int64(drawn[lane, 0]), np.int64(drawn[lane, 1])
        found = _0
        for c in range(3):
            more = np.float32(drawn[lane, 2]) * lights.table[6 + c, j] * (through[lane, c] - np.float32(drawn[lane, 3]))
            light[c, k] += more
            found += more
        step = found - last[k]
        noise[k] += np.float32(0.5) * step * step * (_1 - np.float32(drawn[lane, 4]))
        last[k] = found


@kernel
def _blend(lights, block, local, n, code, mean, doubt, g_max, weight, smooth, uncertain):
    """Add what a block is expected to send to n points to `smooth` (3, POINTS), and the light times the doubt about it to `uncertain` (POINTS,)."""
    table = lights.table
    red, green, blue = smooth[0], smooth[1], smooth[2]
    for lane in range(lights.blocks.first[block + 1] - lights.blocks.first[block]):
        j = block * LANES + lane
        fr, fg, fb = table[6, j], table[7, j], table[8, j]
        weigh(table, j, local, n, g_max, weight)
        told = code[j]
        for k in range(n):
            w = weight[k] * mean[told[k]]
            red[k] += w * fr
            green[k] += w * fg
            blue[k] += w * fb
            uncertain[k] += weight[k] * (fr + fg + fb) * doubt[told[k]]


@kernel
def _draw(
    tracer, points, runs, r, low, high, vpls, lights, local, shines, code, mean, doubt, scale, phase, g_max, drawn, weight, light, last, noise,
):  # fmt: skip
    """Shadow rays for pairs of the points low..high-1 of a geometry cluster, and what they find beside what was expected to `light` (3, POINTS).

    code: (columns, POINTS) of each pair; mean, doubt: (B, CODES) of each block.  scale: (POINTS,), probability of a ray by the pair's light and
    doubt, m^2/W.  phase: (POINTS,) of the systematic samples of each point, whose pairs are taken in the order of VPLs in space.  noise: as in
    `_correct`.  Returns the number of rays.
    """
    table, blocks = lights.table, lights.blocks
    first = runs.first[r]
    n = high - low
    part = local[:, low:high]
    count = rays = 0
    for block in range(len(blocks.cluster)):
        if not shines[block]:
            continue
        expected, doubtful = mean[block], doubt[block]
        for lane in range(blocks.first[block + 1] - blocks.first[block]):
            j = block * LANES + lane
            power = table[6, j] + table[7, j] + table[8, j]
            if not power > _0:
                continue
            told = code[j]
            weigh(table, j, part, n, g_max, weight)
            for k in range(n):
                chance = min(_1, weight[k] * power * doubtful[told[low + k]] * scale[low + k])
                phase[low + k] += chance
                if phase[low + k] < _1:
                    continue
                phase[low + k] -= _1
                set_shadow_ray(tracer.packet, count, points, runs.order[first + low + k], vpls, blocks.order[blocks.first[block] + lane])
                drawn[count, 0], drawn[count, 1], drawn[count, 2] = low + k, j, weight[k] / chance
                drawn[count, 3], drawn[count, 4] = expected[told[low + k]], chance
                count += 1
                if count == WIDTH:
                    _correct(tracer, count, lights, drawn, light, last, noise)
                    rays += count
                    count = 0
    if count:
        _correct(tracer, count, lights, drawn, light, last, noise)
        rays += count
    return rays


@kernel
def _scales(expected, uncertain, n, scale):
    """Probability of a ray by a pair's light and doubt (m^2/W) at n points, so that each point's variance is as wanted, into `scale` (POINTS,)."""
    for k in range(n):
        total = _sum(expected, k)
        # One after the other: the square of dim light is no number of float32.
        scale[k] = uncertain[k] / total / total / VARIANCE if total > _0 else _0


@kernel
def _shrink(light, expected, noise, n):
    """Draw the corrections of n points towards their mean as far as their variance is noise; the sum of their light stays but for STEP.

    The positive-part estimator of James and Stein (1961), its steps limited (Efron & Morris 1972), so that the few that differ stay so.
    light: (3, POINTS), with corrections; expected: the same without; noise: (POINTS,) variance of the corrections, below 0 for points left out.
    """
    more, sent = np.zeros(3, np.float32), np.zeros(3, np.float32)
    count = 0
    for k in range(n):
        if noise[k] < _0:
            continue
        count += 1
        for c in range(3):
            more[c] += light[c, k] - expected[c, k]
            sent[c] += expected[c, k]
    if count < FEWEST:
        return
    for c in range(3):
        more[c] = more[c] / sent[c] if sent[c] > _0 else _0
    away = np.zeros(POINTS, np.float32)
    unlike = random = _0
    for k in range(n):
        if noise[k] < _0:
            continue
        total = _sum(expected, k)
        for c in range(3):
            away[k] += (light[c, k] - expected[c, k] * (_1 + more[c])) / total
        unlike += away[k] * away[k]
        random += noise[k] / total / total
    share = min(random / max(unlike, _TINY), _1)
    step = STEP * np.sqrt(random / np.float32(count))
    for k in range(n):
        if noise[k] < _0:
            continue
        part = min(share, step / max(abs(away[k]), _TINY))
        for c in range(3):
            light[c, k] -= part * (light[c, k] - expected[c, k] * (_1 + more[c]))


@kernel
def _probe_all(tracer, points, runs, r, n, vpls, lights, sight, local, full, g_max, seed, carried, shines, facing, mean, doubt):
    """What each block may send to n points without shadows into `carried` (B, 3, POINTS), and what its probes tell into `mean` and `doubt`.

    shines: (B,) bool, whether any light may come; facing: (B,) pairs that face each other.  Returns (rays, pairs shaded).
    """
    blocks = lights.blocks
    traced = pairs = 0
    for block in range(len(blocks.cluster)):
        lanes = blocks.first[block + 1] - blocks.first[block]
        one = carried[block]
        one[:] = _0
        light_block(lights.table, block * LANES, lanes, local, n, full, full, full, g_max, one)
        shines[block] = one[:, :n].max() > _0
        if not shines[block]:
            continue
        rays = _probe(points, runs, r, n, lights, block, vpls, tracer.packet, seed)
        passed = _0
        if rays:
            trace(tracer, rays)
            passed = tracer.through[:rays].sum() / np.float32(3)
        told = _told(sight, runs.cluster[r], blocks.cluster[block])
        mean[block, WHOLE], doubt[block, WHOLE] = _expected(told, passed, rays)
        facing[block] = _pairs(points, runs, r, lights, block)
        traced += rays
        pairs += n * lanes
    return traced, pairs


@kernel
def _expect(lights, local, n, shines, looked, carried, code, mean, doubt, g_max, weight, expected, uncertain):
    """Add what all blocks are expected to send to n points to `expected` (3, POINTS); light times the doubt about it into `uncertain` (POINTS,)."""
    uncertain[:] = _0
    for block in range(len(shines)):
        if looked[block]:
            _blend(lights, block, local, n, code, mean[block], doubt[block], g_max, weight, expected, uncertain)
        elif shines[block]:
            one = carried[block]
            for k in range(n):
                for c in range(3):
                    expected[c, k] += mean[block, WHOLE] * one[c, k]
                uncertain[k] += doubt[block, WHOLE] * _sum(one, k)


@kernel
def _would_draw(carried, doubt, scale, n):
    """How many rays would be drawn for a block, by what its probes tell."""
    rays = _0
    for k in range(n):
        rays += _sum(carried, k) * doubt * scale[k]
    return rays


@kernel
def shade_guided(scene, vpls, points, runs, begin, end, lights, sight, cutouts, g_max, seed, out):
    """The light of all VPLs at the points of the geometry clusters begin..end-1 into their places in `out`.

    sight: (clusters, clusters) bool, as of `Topology`.  Returns (rays traced, pairs that face each other, pairs shaded).
    """
    through = np.ones((WIDTH, 3), np.float32)
    tracer = Tracer(scene, new_packet(), new_registers(scene.materials), np.zeros(SURFACE, np.float32), cutouts, through)
    full = np.ones((LANES, POINTS), np.float32)
    local, light, expected = np.empty((9, POINTS), np.float32), np.empty((3, POINTS), np.float32), np.empty((3, POINTS), np.float32)
    count = len(lights.blocks.cluster)
    carried = np.empty((count, 3, POINTS), np.float32)
    shines, looked, facing = np.zeros(count, np.bool_), np.zeros(count, np.bool_), np.zeros(count, np.int64)
    mean, doubt = np.zeros((count, CODES), np.float32), np.zeros((count, CODES), np.float32)
    code = np.empty((count * LANES, POINTS), np.uint8)
    value, nearby, learned = (
        np.empty((LANES, POINTS), np.float32),
        np.empty((LANES, POINTS), np.float32),
        np.empty((3, TELLING), np.float32),
    )
    near, share = np.empty((STRIDE, POINTS, NEAREST), np.int32), np.empty((STRIDE, POINTS, NEAREST), np.float32)
    uncertain, scale, phase, weight = (
        np.empty(POINTS, np.float32), np.empty(POINTS, np.float32), np.empty(POINTS, np.float32), np.empty(POINTS, np.float32)
    )  # fmt: skip
    last, noise, got = np.empty(POINTS, np.float32), np.empty(POINTS, np.float32), np.empty(POINTS, np.float32)
    drawn = np.empty((WIDTH, 5))
    rays = faced = pairs = 0
    for r in range(begin, end):
        n = gathered(points, runs, r, local)
        facing[:], looked[:] = 0, False
        traced, shaded = _probe_all(
            tracer, points, runs, r, n, vpls, lights, sight, local, full, g_max, seed, carried, shines, facing, mean, doubt
        )
        rays, faced, pairs = rays + traced, faced + facing.sum(), pairs + shaded
        code[:] = WHOLE
        expected[:] = _0
        _expect(lights, local, n, shines, looked, carried, code, mean, doubt, g_max, weight, expected, uncertain)
        _scales(expected, uncertain, n, scale)
        if n >= 2 * STRIDE:
            learned[:], light[:] = _0, _0
            some = False
            for block in range(count):
                if not shines[block] or np.float32(STRIDE) * _would_draw(carried[block], doubt[block, WHOLE], scale, n) < np.float32(
                    facing[block]
                ):
                    continue
                if not some:
                    neighbours(local, n, near, share)
                some = looked[block] = True
                rays += look(
                    tracer, points, runs, r, n, vpls, lights, block, local, near, share, g_max, drawn, weight, value, nearby, code, learned, light,
                )  # fmt: skip
            if some:
                for block in range(count):
                    if looked[block]:
                        learn(learned, mean[block], doubt[block])
                expected[:] = light
                _expect(lights, local, n, shines, looked, carried, code, mean, doubt, g_max, weight, expected, uncertain)
                _scales(expected, uncertain, n, scale)
        start = uniform(seed, r, 0, 2 * PROBES)
        for k in range(n):
            phase[k] = rotate_unit(start, np.float32(k) * _GOLDEN % _1)
        light[:] = expected
        last[:], noise[:] = _0, _0
        rays += _draw(
            tracer, points, runs, r, 0, n, vpls, lights, local, shines, code, mean, doubt, scale, phase, g_max, drawn, weight, light, last, noise,
        )  # fmt: skip
        for k in range(n):
            got[k] = _sum(light, k)
            if got[k] < DARKER * _sum(expected, k) or not _sum(expected, k) > _0:
                noise[k] = -_1
        _shrink(light, expected, noise, n)
        for k in range(n):
            if got[k] < DARKER * _sum(expected, k):
                part = max(got[k] / _sum(expected, k), LEAST)
                scale[k] /= part * part
                light[:, k] = expected[:, k]
                rays += _draw(
                    tracer, points, runs, r, k, k + 1, vpls, lights, local, shines, code, mean, doubt, scale, phase, g_max, drawn, weight, light,
                    last, noise,
                )  # fmt: skip
            for c in range(3):
                light[c, k] = max(light[c, k], _0)
        scatter(light, runs, r, out)
    return rays, faced, pairs
