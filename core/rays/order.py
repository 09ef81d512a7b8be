"""Orders in which neighbouring points follow each other, so that their rays stay together.

Morton 1966, "A computer oriented geodetic data base and a new technique in file sequencing".
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel

BITS = 16  # of each axis
_DIGIT = 11
_BUCKETS = 1 << _DIGIT


@inlined
def _spread(x):
    """Move bit k of a 16-bit number to bit 3 k."""
    x = (x | x << np.uint64(32)) & np.uint64(0x001F00000000FFFF)
    x = (x | x << np.uint64(16)) & np.uint64(0x001F0000FF0000FF)
    x = (x | x << np.uint64(8)) & np.uint64(0x100F00F00F00F00F)
    x = (x | x << np.uint64(4)) & np.uint64(0x10C30C30C30C30C3)
    return (x | x << np.uint64(2)) & np.uint64(0x1249249249249249)


@kernel
def morton_codes(points):
    """(N,) uint64 Morton codes of (N, 3) points in the cube around them; points that are not finite get 0."""
    n = len(points)
    low = np.full(3, np.inf)
    high = np.full(3, -np.inf)
    for p in range(n):
        for a in range(3):
            x = points[p, a]
            if np.isfinite(x):
                low[a], high[a] = min(low[a], x), max(high[a], x)
    extent = max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    scale = (2.0**BITS - 1.0) / extent if extent > 0.0 and np.isfinite(extent) else 0.0
    codes = np.zeros(n, np.uint64)
    for p in range(n):
        if np.isfinite(points[p, 0]) and np.isfinite(points[p, 1]) and np.isfinite(points[p, 2]):
            x = np.uint64((points[p, 0] - low[0]) * scale)
            y = np.uint64((points[p, 1] - low[1]) * scale)
            z = np.uint64((points[p, 2] - low[2]) * scale)
            codes[p] = _spread(x) | _spread(y) << np.uint64(1) | _spread(z) << np.uint64(2)
    return codes


@kernel
def _add_octant(codes, normals):
    for p in range(len(codes)):
        octant = (normals[p, 0] < 0) * 1 + (normals[p, 1] < 0) * 2 + (normals[p, 2] < 0) * 4
        codes[p] |= np.uint64(octant) << np.uint64(3 * BITS)


@kernel
def radix_argsort(keys, bits):
    """(N,) int64 stable order of uint64 keys whose lowest `bits` count."""
    n = len(keys)
    order, other = np.arange(n), np.empty(n, np.int64)
    key, other_key = keys.copy(), np.empty(n, np.uint64)
    start = np.empty(_BUCKETS, np.int64)
    for shift in range(0, bits, _DIGIT):
        start[:] = 0
        for k in range(n):
            start[np.int64(key[k] >> np.uint64(shift)) & (_BUCKETS - 1)] += 1
        total = 0
        for b in range(_BUCKETS):
            total, start[b] = total + start[b], total
        for k in range(n):
            b = np.int64(key[k] >> np.uint64(shift)) & (_BUCKETS - 1)
            other[start[b]], other_key[start[b]] = order[k], key[k]
            start[b] += 1
        order, other, key, other_key = other, order, other_key, key
    return order


def morton_order(points: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
    """(N,) int64 permutation that sorts (N, 3) points along a Morton curve, stably.

    With normals (N, 3), points of one octant of normals come together, each octant along the curve.
    """
    codes = morton_codes(np.asarray(points))
    if normals is None:
        return radix_argsort(codes, 3 * BITS)
    _add_octant(codes, np.asarray(normals))
    return radix_argsort(codes, 3 * BITS + 3)
