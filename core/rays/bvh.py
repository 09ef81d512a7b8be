"""The fallback where there is no Embree: a binary BVH in Numba, with Embree's robust triangle test.

Woop et al. 2013, "Watertight ray/triangle intersection" (the idea of signed edge functions);
Davidovic et al. 2012, "3D rasterization: a unifying approach" (in Pluecker coordinates);
Ize 2013, "Robust BVH ray traversal" (the widened slab test).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from . import bvh_build as bb
from . import packet as pk
from .partition import Partition
from .trace import CUTOUT, OPAQUE, register_backend

CORNER_WORDS = 9


class BvhTables(NamedTuple):
    """What kernels need to trace.

    roots: (2,) int32, root node of the opaque and the cutout set (-1: empty).
    nodes: (N, 16) float32;  words: the same as int32 (see bvh_build).
    corners: (P, 9) float32, corners 0, 1, 2 of the triangles in the order of the leaves.
    visibility: (P,) int32.  triangle: (P,) int32, the caller's indices.
    """

    roots: np.ndarray
    nodes: np.ndarray
    words: np.ndarray
    corners: np.ndarray
    visibility: np.ndarray
    triangle: np.ndarray


class BvhBackend:
    """Two trees (opaque, cutout) over the valid triangles of a partition."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, partition: Partition):
        n = len(partition.triangle)
        corners = vertices[triangles[partition.triangle]]
        low, high = corners.min(axis=1), corners.max(axis=1)
        visibility = np.zeros(n, np.int32)
        order = np.arange(n, dtype=np.int32)
        nodes = np.zeros((max(2, n), bb.NODE_WORDS), np.float32)
        words = nodes.view(np.int32)
        roots = np.full(2, -1, np.int32)
        used = 0
        for s, groups in enumerate((partition.opaque, partition.cutout)):
            for group in groups:
                visibility[group.begin : group.end] = group.visibility
            if groups:
                begin, end = groups[0].begin, groups[-1].end
                roots[s] = used
                used += bb.build(low, high, order[begin:end], begin, used, nodes[used:], words[used:])
        nodes = nodes[:used].copy()
        self.tables = BvhTables(
            roots,
            nodes,
            nodes.view(np.int32),
            corners[order].reshape(n, CORNER_WORDS),
            visibility[order],
            partition.triangle[order],
        )

    def close(self) -> None:
        """Drop the arrays."""
        self.tables = None


_ULP = np.float32(2.0**-23)
# Twice gamma(3), relative error of a slab distance on either side [Ize 2013].
_WIDEN = np.float32(1.0 + 6.0 * 2.0**-23)


@inlined(fastmath=False)
def _inverse(d):
    """1/d, finite where d is almost zero (as Embree's rcp_safe)."""
    if abs(d) < np.float32(1e-18):
        return np.float32(1e18) if d >= 0 else np.float32(-1e18)
    return np.float32(1.0) / d


@inlined(fastmath=False)
def _triangle(corners, p, ox, oy, oz, dx, dy, dz, tnear, tfar):
    """(hit, t, u, v) by signed edge volumes, both sides; a tolerance of an ulp closes shared edges, as in Embree."""
    ax, ay, az = corners[p, 0] - ox, corners[p, 1] - oy, corners[p, 2] - oz
    bx, by, bz = corners[p, 3] - ox, corners[p, 4] - oy, corners[p, 5] - oz
    cx, cy, cz = corners[p, 6] - ox, corners[p, 7] - oy, corners[p, 8] - oz
    # Edges as Embree orders them: ca, ab, bc; U belongs to corner 1, V to corner 2, W to corner 0.
    ex, ey, ez = cx - ax, cy - ay, cz - az
    fx, fy, fz = ax - bx, ay - by, az - bz
    gx, gy, gz = bx - cx, by - cy, bz - cz
    sx, sy, sz = cx + ax, cy + ay, cz + az
    u = (ey * sz - ez * sy) * dx + (ez * sx - ex * sz) * dy + (ex * sy - ey * sx) * dz
    sx, sy, sz = ax + bx, ay + by, az + bz
    v = (fy * sz - fz * sy) * dx + (fz * sx - fx * sz) * dy + (fx * sy - fy * sx) * dz
    sx, sy, sz = bx + cx, by + cy, bz + cz
    w = (gy * sz - gz * sy) * dx + (gz * sx - gx * sz) * dy + (gx * sy - gy * sx) * dz
    total = u + v + w
    tolerance = _ULP * abs(total)
    zero = np.float32(0.0)
    if not (min(u, v, w) >= -tolerance or max(u, v, w) <= tolerance):
        return False, zero, zero, zero
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    denominator = nx * dx + ny * dy + nz * dz
    t = (ax * nx + ay * ny + az * nz) / denominator
    if denominator == zero or not (tnear <= t <= tfar):
        return False, zero, zero, zero
    scale = np.float32(1.0) / total if total != zero else zero
    return True, t, min(u * scale, np.float32(1.0)), min(v * scale, np.float32(1.0))


@inlined(fastmath=False)
def _slab(nodes, node, side, ox, oy, oz, ix, iy, iz, tnear, tfar):
    """(near, far) of the ray in a child's box, widened by the rounding error."""
    at = bb.LEFT_LOW if side == 0 else bb.RIGHT_LOW
    x0, x1 = (nodes[node, at] - ox) * ix, (nodes[node, at + 3] - ox) * ix
    y0, y1 = (nodes[node, at + 1] - oy) * iy, (nodes[node, at + 4] - oy) * iy
    z0, z1 = (nodes[node, at + 2] - oz) * iz, (nodes[node, at + 5] - oz) * iz
    near = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), tnear))
    far = min(min(max(x0, x1), max(y0, y1)), min(max(z0, z1), tfar))
    return near, far * _WIDEN


@kernel(fast=False)
def _traverse1(tables, root, any_hit, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """(place in the leaves or -1, t, u, v) of the nearest hit, or of any."""
    nodes, words = tables.nodes, tables.words
    # The stack: nodes and where the ray enters them.
    f, i, at, at_t = packet.f, packet.i, pk.SCRATCH, pk.SCRATCH + bb.MAX_DEPTH
    ix, iy, iz = _inverse(dx), _inverse(dy), _inverse(dz)
    best, best_u, best_v = -1, np.float32(0.0), np.float32(0.0)
    depth, node = 0, np.int64(root)
    while True:
        near_l, far_l = _slab(nodes, node, 0, ox, oy, oz, ix, iy, iz, tnear, tfar)
        near_r, far_r = _slab(nodes, node, 1, ox, oy, oz, ix, iy, iz, tnear, tfar)
        left, right = near_l <= far_l, near_r <= far_r
        for side in range(2):
            count = words[node, bb.COUNT + side]
            if count > 0 and (right if side else left):
                begin = words[node, bb.CHILD + side]
                for p in range(begin, begin + count):
                    hit, t, u, v = _triangle(tables.corners, p, ox, oy, oz, dx, dy, dz, tnear, tfar)
                    if hit and tables.visibility[p] & mask:
                        best, tfar, best_u, best_v = p, t, u, v
                        if any_hit:
                            return best, tfar, best_u, best_v
        left &= words[node, bb.COUNT] == 0
        right &= words[node, bb.COUNT + 1] == 0
        if left and right:
            nearer = 0 if near_l <= near_r else 1
            i[at + depth] = words[node, bb.CHILD + 1 - nearer]
            f[at_t + depth] = near_l if nearer else near_r
            depth += 1
            node = np.int64(words[node, bb.CHILD + nearer])
        elif left or right:
            node = np.int64(words[node, bb.CHILD + (0 if left else 1)])
        else:
            while depth > 0 and f[at_t + depth - 1] > tfar:
                depth -= 1
            if depth == 0:
                return best, tfar, best_u, best_v
            depth -= 1
            node = np.int64(i[at + depth])


@kernel(fast=False)
def _occluded1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    for s in range(2):
        if which & (OPAQUE, CUTOUT)[s] and tables.roots[s] >= 0 and tnear <= tfar:
            if _traverse1(tables, tables.roots[s], True, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)[0] >= 0:
                return True
    return False


@kernel(fast=False)
def _intersect1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    triangle, best_u, best_v = np.int32(-1), np.float32(0.0), np.float32(0.0)
    for s in range(2):
        if which & (OPAQUE, CUTOUT)[s] and tables.roots[s] >= 0 and tnear <= tfar:
            p, t, u, v = _traverse1(tables, tables.roots[s], False, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)
            if p >= 0:
                triangle, tfar, best_u, best_v = tables.triangle[p], t, u, v
    return triangle, tfar, best_u, best_v


@kernel(fast=False)
def _occluded_packet(tables, which, packet, count):
    f, i, w = packet.f, packet.i, pk.WIDTH
    for k in range(count):
        if _occluded1(
            tables, which, packet, f[pk.ORG_X * w + k], f[pk.ORG_Y * w + k], f[pk.ORG_Z * w + k], f[pk.DIR_X * w + k],
            f[pk.DIR_Y * w + k], f[pk.DIR_Z * w + k], f[pk.T_NEAR * w + k], f[pk.T_FAR * w + k], i[pk.MASK * w + k],
        ):  # fmt: skip
            f[pk.T_FAR * w + k] = pk.OCCLUDED


@kernel(fast=False)
def _intersect_packet(tables, which, packet, count):
    f, i, w = packet.f, packet.i, pk.WIDTH
    for k in range(count):
        i[pk.PRIMITIVE * w + k], f[pk.T_FAR * w + k], f[pk.HIT_U * w + k], f[pk.HIT_V * w + k] = _intersect1(
            tables, which, packet, f[pk.ORG_X * w + k], f[pk.ORG_Y * w + k], f[pk.ORG_Z * w + k], f[pk.DIR_X * w + k],
            f[pk.DIR_Y * w + k], f[pk.DIR_Z * w + k], f[pk.T_NEAR * w + k], f[pk.T_FAR * w + k], i[pk.MASK * w + k],
        )  # fmt: skip


register_backend(BvhTables, _occluded_packet, _intersect_packet, _occluded1, _intersect1)
