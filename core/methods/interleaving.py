"""Interleaved sampling and the geometry-aware blur that removes its pattern.

Keller & Heidrich 2001; Segovia et al. 2006; as in Dong et al. 2009, Section 6.  The pixels of a block of I x I each light by their own
share of the VPLs (the pixel's residue).  Every window of I x I pixels holds each share once, so that the sum over a window of one
surface has no pattern at all, however unlike the shares are.  Where the window leaves the surface, a missing share is
taken from the pixels a block further on; what is missing there, too, is left to the caller, who computes it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..clustering.blocks import radix_order
from ..jit import inlined, kernel
from ..threads import run_chunks
from ..view.points import ShadingPoints

LARGEST = 8  # I at most: the shares of a block are the bits of a 64-bit number
ALPHA = 0.1  # of the scene's extent: farther points are not blurred over (Laine et al. 2007)
BETA = 0.8  # least cosine of the normals
PLANE = 0.35  # sine of the angle by which a neighbour may lie off the point's plane
TILE = 64  # pixels along the edge of the area from which points with one residue are lit together
TOGETHER = 128  # such points at most
CHUNK = 4096  # points blurred in one piece of work
_0 = np.float32(0.0)
_1 = np.float32(1.0)


class Pixels(NamedTuple):
    """Which of N points a picture's pixels show.

    interleave: I.  width: pixels of a row.  order: (N,) int32, points by pixel.  first: (P + 1,) int32: the points
    order[first[p]..first[p + 1] - 1] are in pixel p.
    """

    interleave: int
    width: int
    order: np.ndarray
    first: np.ndarray


class Batches(NamedTuple):
    """Pairs of a point and a share of the VPLs, in batches of one share.

    point: (P,) int32.  first: (B + 1,) int64, borders of the batches.  share: (B,) int32.
    """

    point: np.ndarray
    first: np.ndarray
    share: np.ndarray


def pixels_of(points: ShadingPoints, width: int, interleave: int) -> Pixels:
    """The points of each pixel of a picture that is `width` pixels wide."""
    counts = np.bincount(points.pixel)
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    return Pixels(interleave, width, radix_order(points.pixel.astype(np.int64)), first)


def own_shares(points: ShadingPoints, pixels: Pixels) -> Batches:
    """Every point with the share of its pixel."""
    x, y = points.pixel % pixels.width, points.pixel // pixels.width
    return batches(np.arange(len(points.pixel), dtype=np.int32), (y % pixels.interleave) * pixels.interleave + x % pixels.interleave, x, y)


def missing_shares(points: ShadingPoints, pixels: Pixels, missing: np.ndarray) -> Batches:
    """Every point with the shares that it misses; missing: (N,) uint64, of `blur`."""
    at = np.flatnonzero(missing)
    row, share = np.nonzero((missing[at, None] >> np.arange(pixels.interleave**2, dtype=np.uint64)) & np.uint64(1))
    point = at[row].astype(np.int32)
    pixel = points.pixel[point]
    return batches(point, share, pixel % pixels.width, pixel // pixels.width)


def all_shares(points: ShadingPoints) -> Batches:
    """Every point with all VPLs, which are one share; neighbours in memory are batched."""
    n = len(points.pixel)
    borders = np.append(np.arange(0, n, TOGETHER), n)
    return Batches(np.arange(n, dtype=np.int32), borders, np.zeros(len(borders) - 1, np.int32))


def batches(point: np.ndarray, share: np.ndarray, x: np.ndarray, y: np.ndarray) -> Batches:
    """Batches of pairs (P,) of a point, at pixel (x, y), and a share: of points of one tile of the picture, for coherent rays.

    Share by share, so that the shadow maps of its few area lights stay in the processor's cache.
    """
    columns = int(x.max(initial=0)) // TILE + 1
    tiles = (int(y.max(initial=0)) // TILE + 1) * columns
    keys = share.astype(np.int64) * tiles + (y // TILE) * columns + x // TILE
    order = radix_order(keys)
    keys = keys[order]
    # A new batch where the key changes, and after every TOGETHER pairs of one key.
    starts = np.flatnonzero(np.diff(keys, prepend=-1))
    sizes = np.diff(starts, append=len(keys))
    parts = -(-sizes // TOGETHER)
    within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    first = np.append(np.repeat(starts, parts) + TOGETHER * within, len(keys))
    return Batches(point[order], first, (keys[first[:-1]] // tiles).astype(np.int32))


@inlined
def _alike(table, i, k, gx, gy, gz, reach2):
    """Whether the points at places i and k are taken for one smooth surface; g: the geometric normal at i."""
    dx, dy, dz = table[k, 0] - table[i, 0], table[k, 1] - table[i, 1], table[k, 2] - table[i, 2]
    cosine = table[i, 3] * table[k, 3] + table[i, 4] * table[k, 4] + table[i, 5] * table[k, 5]
    r2 = dx * dx + dy * dy + dz * dz
    off = gx * dx + gy * dy + gz * dz
    return cosine >= np.float32(BETA) and r2 <= reach2 and off * off <= np.float32(PLANE * PLANE) * r2


@kernel
def _blur(points, pixels, table, begin, end, reach2, out, missing):
    """The mean of each share over the points like i in i's window, summed over the shares, for the points at places begin..end-1.

    table: (N, 9) float32 position, shading normal and light of the points by pixel.
    """
    size, width, first = pixels.interleave, pixels.width, pixels.first
    last = len(first) - 1
    height = (last - 1) // width + 1
    for place in range(begin, end):
        i = pixels.order[place]
        gx, gy, gz = points.ng[i, 0], points.ng[i, 1], points.ng[i, 2]
        x, y = points.pixel[i] % width, points.pixel[i] // width
        red = green = blue = _0
        lacks = np.uint64(0)
        for dy in range(-(size // 2), size - size // 2):
            for dx in range(-(size // 2), size - size // 2):
                # Here, else a block further on, on the other side of the point, in one or both axes.
                found = 0
                r = g = b = _0
                for further in range(4):
                    u = x + dx + (0 if further & 1 == 0 else size if dx < 0 else -size)
                    v = y + dy + (0 if further & 2 == 0 else size if dy < 0 else -size)
                    at = v * width + u
                    if u < 0 or v < 0 or u >= width or v >= height or at >= last:
                        continue
                    for k in range(first[at], first[at + 1]):
                        if _alike(table, place, k, gx, gy, gz, reach2):
                            found += 1
                            r, g, b = r + table[k, 6], g + table[k, 7], b + table[k, 8]
                    if found > 0:
                        break
                if found > 0:
                    scale = _1 / np.float32(found)
                    red, green, blue = red + scale * r, green + scale * g, blue + scale * b
                else:
                    lacks |= np.uint64(1) << np.uint64(((y + dy) % size) * size + (x + dx) % size)
        out[i, 0], out[i, 1], out[i, 2] = red, green, blue
        missing[i] = lacks


def blur(points: ShadingPoints, pixels: Pixels, light: np.ndarray, extent: float, threads: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Light of all shares (N, 3) from that of each point's own share (N, 3), but for the shares `missing` (N,) uint64, bit by bit.

    extent: of the scene (m).
    """
    n = len(points.pixel)
    out, missing = np.empty_like(light), np.empty(n, np.uint64)
    reach2 = np.float32((ALPHA * extent) ** 2)
    table = np.concatenate([points.position, points.ns, light], axis=1)[pixels.order]
    run_chunks(lambda begin, end: _blur(points, pixels, table, begin, end, reach2, out, missing), n, CHUNK, threads)
    return out, missing
