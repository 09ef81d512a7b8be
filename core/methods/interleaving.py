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
    """Batches of pairs (P,) of a point, at pixel (x, y), and a share: of points of one tile of the picture, for coherent rays."""
    tiles = int(x.max(initial=0)) // TILE + 1
    keys = ((y // TILE).astype(np.int64) * tiles + x // TILE) * LARGEST**2 + share
    order = radix_order(keys)
    keys = keys[order]
    # A new batch where the key changes, and after every TOGETHER pairs of one key.
    starts = np.flatnonzero(np.diff(keys, prepend=-1))
    sizes = np.diff(starts, append=len(keys))
    parts = -(-sizes // TOGETHER)
    within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    first = np.append(np.repeat(starts, parts) + TOGETHER * within, len(keys))
    return Batches(point[order], first, (keys[first[:-1]] % LARGEST**2).astype(np.int32))


@inlined
def _alike(points, i, k, reach2):
    """Whether the points i and k are taken for one smooth surface."""
    cosine = points.ns[i, 0] * points.ns[k, 0] + points.ns[i, 1] * points.ns[k, 1] + points.ns[i, 2] * points.ns[k, 2]
    dx = points.position[k, 0] - points.position[i, 0]
    dy = points.position[k, 1] - points.position[i, 1]
    dz = points.position[k, 2] - points.position[i, 2]
    r2 = dx * dx + dy * dy + dz * dz
    off = points.ng[i, 0] * dx + points.ng[i, 1] * dy + points.ng[i, 2] * dz
    return cosine >= np.float32(BETA) and r2 <= reach2 and off * off <= np.float32(PLANE * PLANE) * r2


@kernel
def _blur(points, pixels, light, begin, end, reach2, out, missing):
    """The mean of each share over the points like i in i's window, summed over the shares, for the points begin..end-1."""
    size, width = pixels.interleave, pixels.width
    height = (len(pixels.first) - 2) // width + 1
    channels = light.shape[1]
    total = np.empty(channels, np.float32)
    for i in range(begin, end):
        pixel = points.pixel[i]
        x, y = pixel % width, pixel // width
        for c in range(channels):
            out[i, c] = _0
        lacks = np.uint64(0)
        for dy in range(-(size // 2), size - size // 2):
            for dx in range(-(size // 2), size - size // 2):
                # Here, else a block further on, on the other side of the point, in one or both axes.
                found = 0
                for further in range(4):
                    u = x + dx + (0 if further & 1 == 0 else size if dx < 0 else -size)
                    v = y + dy + (0 if further & 2 == 0 else size if dy < 0 else -size)
                    if u < 0 or v < 0 or u >= width or v >= height:
                        continue
                    at = v * width + u
                    if at + 1 >= len(pixels.first):
                        continue
                    for place in range(pixels.first[at], pixels.first[at + 1]):
                        k = pixels.order[place]
                        if _alike(points, i, k, reach2):
                            if found == 0:
                                total[:] = _0
                            found += 1
                            for c in range(channels):
                                total[c] += light[k, c]
                    if found > 0:
                        break
                if found > 0:
                    scale = _1 / np.float32(found)
                    for c in range(channels):
                        out[i, c] += scale * total[c]
                else:
                    lacks |= np.uint64(1) << np.uint64(((y + dy) % size) * size + (x + dx) % size)
        missing[i] = lacks


def blur(points: ShadingPoints, pixels: Pixels, light: np.ndarray, extent: float, threads: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Light of all shares (N, C) from that of each point's own share (N, C), but for the shares `missing` (N,) uint64, bit by bit.

    extent: of the scene (m).
    """
    n = len(points.pixel)
    out, missing = np.empty_like(light), np.empty(n, np.uint64)
    reach2 = np.float32((ALPHA * extent) ** 2)
    run_chunks(lambda begin, end: _blur(points, pixels, light, begin, end, reach2, out, missing), n, CHUNK, threads)
    return out, missing
