"""Traversal of the fallback's BVH: packets of 16 while most lanes agree, single rays below that.

Wald et al. 2001, "Interactive rendering with coherent ray tracing" (packets);
Benthin et al. 2012, "Combining single and packet ray tracing" (the switch to single rays);
Ize 2013, "Robust BVH ray traversal" (the widened slab test);
Davidovic et al. 2012, "3D rasterization: a unifying approach" (signed edge volumes, as Embree's robust mode).
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from . import bvh_build as bb
from . import packet as pk
from .trace import CUTOUT, OPAQUE

W = pk.WIDTH
# Words of the packet's scratch: rows of 16 lanes, then the two stacks.
INVERSE_X, INVERSE_Y, INVERSE_Z, T_END, PLACE, NEAR_LEFT, NEAR_RIGHT, TEST_T, TEST_U, TEST_V, TEST_W, TEST_HIT = range(
    pk.SCRATCH, pk.SCRATCH + 12 * W, W
)
STACK_NODE = pk.SCRATCH + 12 * W
STACK_LANES = STACK_NODE + bb.MAX_DEPTH
SINGLE_NODE = STACK_LANES + bb.MAX_DEPTH
SINGLE_NEAR = SINGLE_NODE + bb.MAX_DEPTH
# With this many lanes or fewer, single rays are faster than a packet (measured).
FEW_LANES = 3

_ULP = np.float32(2.0**-23)
# Twice gamma(3): the relative error of both distances to a slab [Ize 2013].
_WIDEN = np.float32(1.0 + 6.0 * 2.0**-23)
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@inlined(fastmath=False)
def _inverse(d):
    """1/d, finite where d is almost zero (as Embree's rcp_safe)."""
    small = np.float32(1e-18)
    return _ONE / (d if abs(d) > small else (small if d >= _ZERO else -small))


@inlined(fastmath=False)
def _corners(c, p):
    return c[p, 0], c[p, 1], c[p, 2], c[p, 3], c[p, 4], c[p, 5], c[p, 6], c[p, 7], c[p, 8]


@inlined(fastmath=False)
def _edge_volumes(px, py, pz, qx, qy, qz, rx, ry, rz, ox, oy, oz, dx, dy, dz):
    """(u, v, w): volumes that the ray spans with the edges opposite corners 1, 2 and 0."""
    ax, ay, az = px - ox, py - oy, pz - oz
    bx, by, bz = qx - ox, qy - oy, qz - oz
    cx, cy, cz = rx - ox, ry - oy, rz - oz
    ex, ey, ez, sx, sy, sz = cx - ax, cy - ay, cz - az, cx + ax, cy + ay, cz + az
    u = (ey * sz - ez * sy) * dx + (ez * sx - ex * sz) * dy + (ex * sy - ey * sx) * dz
    ex, ey, ez, sx, sy, sz = ax - bx, ay - by, az - bz, ax + bx, ay + by, az + bz
    v = (ey * sz - ez * sy) * dx + (ez * sx - ex * sz) * dy + (ex * sy - ey * sx) * dz
    ex, ey, ez, sx, sy, sz = bx - cx, by - cy, bz - cz, bx + cx, by + cy, bz + cz
    w = (ey * sz - ez * sy) * dx + (ez * sx - ex * sz) * dy + (ex * sy - ey * sx) * dz
    return u, v, w


@inlined(fastmath=False)
def _inside(u, v, w):
    """All volumes of one sign, either one; an ulp of tolerance closes shared edges, as in Embree."""
    tolerance = _ULP * abs(u + v + w)
    return (min(u, min(v, w)) >= -tolerance) | (max(u, max(v, w)) <= tolerance)


@inlined(fastmath=False)
def _stable(a1, b2, a2, b1, c2, c1):
    """A component of the normal from whichever pair of edges has the smaller product to cancel."""
    ab, bc = a2 * b1, b2 * c1
    return a1 * b2 - ab if abs(ab) < abs(bc) else b1 * c2 - bc


@inlined(fastmath=False)
def _distance(px, py, pz, qx, qy, qz, rx, ry, rz, ox, oy, oz, dx, dy, dz):
    """(t, denominator) of the triangle's plane."""
    ax, ay, az = px - ox, py - oy, pz - oz
    bx, by, bz = qx - ox, qy - oy, qz - oz
    cx, cy, cz = rx - ox, ry - oy, rz - oz
    ex, ey, ez, fx, fy, fz, gx, gy, gz = cx - ax, cy - ay, cz - az, ax - bx, ay - by, az - bz, bx - cx, by - cy, bz - cz
    nx = _stable(ey, fz, ez, fy, gz, gy)
    ny = _stable(ez, fx, ex, fz, gx, gz)
    nz = _stable(ex, fy, ey, fx, gy, gx)
    denominator = nx * dx + ny * dy + nz * dz
    return (ax * nx + ay * ny + az * nz) / denominator, denominator


@inlined(fastmath=False)
def _slab(lx, ly, lz, hx, hy, hz, ox, oy, oz, ix, iy, iz, tnear, tfar):
    """(near, far) of a ray in a box, widened by the rounding error."""
    x0, x1 = (lx - ox) * ix, (hx - ox) * ix
    y0, y1 = (ly - oy) * iy, (hy - oy) * iy
    z0, z1 = (lz - oz) * iz, (hz - oz) * iz
    near = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), tnear))
    far = min(min(max(x0, x1), max(y0, y1)), min(max(z0, z1), tfar))
    return near, far * _WIDEN


@inlined(fastmath=False)
def _box(nodes, node, at):
    return nodes[node, at], nodes[node, at + 1], nodes[node, at + 2], nodes[node, at + 3], nodes[node, at + 4], nodes[node, at + 5]


@kernel(fast=False)
def _traverse1(nodes, words, corners, visibility, f, i, root, any_hit, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """(place in the leaves or -1, t, u, v) of the nearest hit below node `root`, or of any."""
    ix, iy, iz = _inverse(dx), _inverse(dy), _inverse(dz)
    best, best_u, best_v = np.int64(-1), _ZERO, _ZERO
    depth, node = 0, np.int64(root)
    while True:
        near_l, far_l = _slab(*_box(nodes, node, bb.LEFT_LOW), ox, oy, oz, ix, iy, iz, tnear, tfar)
        near_r, far_r = _slab(*_box(nodes, node, bb.RIGHT_LOW), ox, oy, oz, ix, iy, iz, tnear, tfar)
        left, right = near_l <= far_l, near_r <= far_r
        count_l, count_r = words[node, bb.COUNT], words[node, bb.COUNT + 1]
        for side in range(2):
            count = (count_r if right else 0) if side else (count_l if left else 0)
            begin = words[node, bb.CHILD + side]
            for p in range(begin, begin + count):
                u, v, w = _edge_volumes(*_corners(corners, p), ox, oy, oz, dx, dy, dz)
                if not (_inside(u, v, w) and visibility[p] & mask):
                    continue
                t, denominator = _distance(*_corners(corners, p), ox, oy, oz, dx, dy, dz)
                if denominator != _ZERO and tnear <= t and t <= tfar:
                    total = u + v + w
                    scale = _ONE / total if total != _ZERO else _ZERO
                    best, tfar, best_u, best_v = np.int64(p), t, min(u * scale, _ONE), min(v * scale, _ONE)
                    if any_hit:
                        return best, tfar, best_u, best_v
        left &= count_l == 0
        right &= count_r == 0
        if left and right:
            nearer = 0 if near_l <= near_r else 1
            i[SINGLE_NODE + depth] = words[node, bb.CHILD + 1 - nearer]
            f[SINGLE_NEAR + depth] = near_l if nearer else near_r
            depth += 1
            node = np.int64(words[node, bb.CHILD + nearer])
        elif left or right:
            node = np.int64(words[node, bb.CHILD + (0 if left else 1)])
        else:
            while depth > 0 and f[SINGLE_NEAR + depth - 1] > tfar:
                depth -= 1
            if depth == 0:
                return best, tfar, best_u, best_v
            depth -= 1
            node = np.int64(i[SINGLE_NODE + depth])


@inlined(fastmath=False)
def _slab16(nodes, node, at, f, near_row):
    """Lanes, as bits, whose rays meet the box; where they enter goes to `near_row`."""
    # Read before the loop: the compiler cannot know that the loop's writes leave the node alone.
    lx, ly, lz, hx, hy, hz = _box(nodes, node, at)
    bits = np.int32(0)
    for k in range(W):
        near, far = _slab(
            lx, ly, lz, hx, hy, hz, f[pk.ORG_X * W + k], f[pk.ORG_Y * W + k], f[pk.ORG_Z * W + k],
            f[INVERSE_X + k], f[INVERSE_Y + k], f[INVERSE_Z + k], f[pk.T_NEAR * W + k], f[T_END + k],
        )  # fmt: skip
        f[near_row + k] = near
        bits |= np.int32(near <= far) << np.int32(k)
    return bits


@kernel(fast=False)
def _leaf16(corners, visibility, f, i, begin, end, any_hit):
    """Test 16 lanes against triangles begin..end-1 of the leaves."""
    for p in range(begin, end):
        px, py, pz, qx, qy, qz, rx, ry, rz = _corners(corners, p)
        some = np.int32(0)
        for k in range(W):
            u, v, w = _edge_volumes(
                px, py, pz, qx, qy, qz, rx, ry, rz, f[pk.ORG_X * W + k], f[pk.ORG_Y * W + k], f[pk.ORG_Z * W + k],
                f[pk.DIR_X * W + k], f[pk.DIR_Y * W + k], f[pk.DIR_Z * W + k],
            )  # fmt: skip
            f[TEST_U + k], f[TEST_V + k], f[TEST_W + k] = u, v, w
            hit = np.int32(_inside(u, v, w))
            i[TEST_HIT + k] = hit
            some += hit
        if some == 0:
            continue
        for k in range(W):
            if i[TEST_HIT + k] == 0 or not (visibility[p] & i[pk.MASK * W + k]):
                continue
            t, denominator = _distance(
                px, py, pz, qx, qy, qz, rx, ry, rz, f[pk.ORG_X * W + k], f[pk.ORG_Y * W + k], f[pk.ORG_Z * W + k],
                f[pk.DIR_X * W + k], f[pk.DIR_Y * W + k], f[pk.DIR_Z * W + k],
            )  # fmt: skip
            if denominator != _ZERO and f[pk.T_NEAR * W + k] <= t and t <= f[T_END + k]:
                u, v, total = f[TEST_U + k], f[TEST_V + k], f[TEST_U + k] + f[TEST_V + k] + f[TEST_W + k]
                scale = _ONE / total if total != _ZERO else _ZERO
                _record(f, i, k, p, t, min(u * scale, _ONE), min(v * scale, _ONE), any_hit)


@inlined
def _record(f, i, k, p, t, u, v, any_hit):
    i[PLACE + k] = p
    f[T_END + k] = pk.OCCLUDED if any_hit else t
    f[pk.HIT_U * W + k], f[pk.HIT_V * W + k] = u, v


@kernel(fast=False)
def _traverse16(nodes, words, corners, visibility, f, i, root, any_hit):
    """Nearest hits below `root`, or any, of the lanes whose T_END is not below T_NEAR: to PLACE, T_END, HIT_U, HIT_V."""
    depth, node = 0, np.int64(root)
    while True:
        lanes_l = _slab16(nodes, node, bb.LEFT_LOW, f, NEAR_LEFT)
        lanes_r = _slab16(nodes, node, bb.RIGHT_LOW, f, NEAR_RIGHT)
        for side in range(2):
            lanes = lanes_r if side else lanes_l
            begin, size = words[node, bb.CHILD + side], words[node, bb.COUNT + side]
            if lanes != 0 and size > 0:
                _leaf16(corners, visibility, f, i, begin, begin + size, any_hit)
        if words[node, bb.COUNT] > 0:
            lanes_l = np.int32(0)
        if words[node, bb.COUNT + 1] > 0:
            lanes_r = np.int32(0)
        # Nearer child first, as one lane that meets both sees it; the other one waits with its lanes.
        both = lanes_l & lanes_r
        nearer = 0 if lanes_l != 0 else 1
        if both != 0:
            k = 0
            while not both >> k & 1:
                k += 1
            nearer = 0 if f[NEAR_LEFT + k] <= f[NEAR_RIGHT + k] else 1
        for step in range(2):
            side = 1 - nearer if step == 0 else nearer
            lanes = lanes_r if side else lanes_l
            if lanes != 0:
                i[STACK_NODE + depth] = words[node, bb.CHILD + side]
                i[STACK_LANES + depth] = lanes
                depth += 1
        while True:
            if depth == 0:
                return
            depth -= 1
            node, lanes = np.int64(i[STACK_NODE + depth]), i[STACK_LANES + depth]
            alive = 0
            for k in range(W):
                alive += (lanes >> k) & np.int32(f[T_END + k] >= f[pk.T_NEAR * W + k])
            if alive > FEW_LANES:
                break
            if alive == 0:
                continue
            for k in range(W):
                if lanes >> k & 1 and f[T_END + k] >= f[pk.T_NEAR * W + k]:
                    p, t, u, v = _traverse1(
                        nodes, words, corners, visibility, f, i, node, any_hit,
                        f[pk.ORG_X * W + k], f[pk.ORG_Y * W + k], f[pk.ORG_Z * W + k],
                        f[pk.DIR_X * W + k], f[pk.DIR_Y * W + k], f[pk.DIR_Z * W + k],
                        f[pk.T_NEAR * W + k], f[T_END + k], i[pk.MASK * W + k],
                    )  # fmt: skip
                    if p >= 0:
                        _record(f, i, k, p, t, u, v, any_hit)


@kernel(fast=False)
def _trace16(tables, which, packet, count, any_hit):
    f, i = packet.f, packet.i
    for k in range(W):
        f[INVERSE_X + k] = _inverse(f[pk.DIR_X * W + k])
        f[INVERSE_Y + k] = _inverse(f[pk.DIR_Y * W + k])
        f[INVERSE_Z + k] = _inverse(f[pk.DIR_Z * W + k])
        f[T_END + k] = f[pk.T_FAR * W + k] if k < count else pk.OCCLUDED
        i[PLACE + k] = -1
    for s in range(2):
        if which & (OPAQUE, CUTOUT)[s] and tables.roots[s] >= 0:
            _traverse16(tables.nodes, tables.words, tables.corners, tables.visibility, f, i, tables.roots[s], any_hit)
    for k in range(count):
        place = i[PLACE + k]
        i[pk.PRIMITIVE * W + k] = tables.triangle[place] if place >= 0 else -1
        if place >= 0:
            f[pk.T_FAR * W + k] = f[T_END + k]


@inlined
def occluded_packet(tables, which, packet, count):
    """See `trace.occluded_packet`."""
    _trace16(tables, which, packet, count, True)


@inlined
def intersect_packet(tables, which, packet, count):
    """See `trace.intersect_packet`."""
    _trace16(tables, which, packet, count, False)


@kernel(fast=False)
def _trace1(tables, which, packet, any_hit, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    place, best_u, best_v = np.int64(-1), _ZERO, _ZERO
    for s in range(2):
        if which & (OPAQUE, CUTOUT)[s] and tables.roots[s] >= 0 and tnear <= tfar and not (any_hit and place >= 0):
            p, t, u, v = _traverse1(
                tables.nodes, tables.words, tables.corners, tables.visibility, packet.f, packet.i, tables.roots[s], any_hit,
                ox, oy, oz, dx, dy, dz, tnear, tfar, mask,
            )  # fmt: skip
            if p >= 0:
                place, tfar, best_u, best_v = p, t, u, v
    return place, tfar, best_u, best_v


@kernel(fast=False)
def occluded1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """See `trace.occluded1`."""
    return _trace1(tables, which, packet, True, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)[0] >= 0


@kernel(fast=False)
def intersect1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """See `trace.intersect1`."""
    place, t, u, v = _trace1(tables, which, packet, False, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)
    return (tables.triangle[place] if place >= 0 else np.int32(-1)), t, u, v
