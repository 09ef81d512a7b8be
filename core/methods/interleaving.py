"""Interleaved sampling: pixels of a picture that share what they find, where they show one surface.

Keller & Heidrich 2001; Segovia et al. 2006; as in Dong et al. 2009, Section 6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..clustering.blocks import radix_order
from ..jit import inlined, kernel
from ..threads import run_chunks
from ..view.points import ShadingPoints

LARGEST = 8  # I at most
ALPHA = 0.1  # of the scene's extent: points farther apart have nothing to do with each other (Laine et al. 2007)
BETA = 0.8  # least cosine of their normals
PLANE = 0.1  # sine of the angle by which a chord may lie off the tangent of a round surface
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


def pixels_of(points: ShadingPoints, width: int, interleave: int) -> Pixels:
    """The points of each pixel of a picture that is `width` pixels wide."""
    counts = np.bincount(points.pixel)
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    return Pixels(interleave, width, radix_order(points.pixel.astype(np.int64)), first)


@inlined
def alike(table, i, k, reach2):
    """Whether the points at places i and k of a table (N, 6) of positions and normals are taken for one smooth surface.

    Chords of a sphere are normal to the mean of the normals at their ends: so a surface may turn, but not step.
    """
    dx, dy, dz = table[k, 0] - table[i, 0], table[k, 1] - table[i, 1], table[k, 2] - table[i, 2]
    cosine = table[i, 3] * table[k, 3] + table[i, 4] * table[k, 4] + table[i, 5] * table[k, 5]
    r2 = dx * dx + dy * dy + dz * dz
    off = (table[i, 3] + table[k, 3]) * dx + (table[i, 4] + table[k, 4]) * dy + (table[i, 5] + table[k, 5]) * dz
    return cosine >= np.float32(BETA) and r2 <= reach2 and off * off <= np.float32(4 * PLANE * PLANE) * r2


def by_place(points: ShadingPoints, pixels: Pixels) -> np.ndarray:
    """Position and geometric normal (N, 6) float32 of the points by pixel, as `alike` reads them."""
    return np.concatenate([points.position, points.ng], axis=1)[pixels.order]


@kernel
def _blur(points, pixels, table, values, begin, end, reach2, out):
    """Means over the points alike in their windows, for those at places begin..end-1, into out (N, 3)."""
    size, width, first = pixels.interleave, pixels.width, pixels.first
    last = len(first) - 1
    for place in range(begin, end):
        i = pixels.order[place]
        x, y = points.pixel[i] % width, points.pixel[i] // width
        red = green = blue = count = _0
        for v in range(max(y - size // 2, 0), y + size - size // 2):
            for u in range(max(x - size // 2, 0), min(x + size - size // 2, width)):
                if v * width + u >= last:
                    break
                for k in range(first[v * width + u], first[v * width + u + 1]):
                    if k == place or alike(table, place, k, reach2):
                        j = pixels.order[k]
                        red, green, blue, count = red + values[j, 0], green + values[j, 1], blue + values[j, 2], count + _1
        out[i, 0], out[i, 1], out[i, 2] = red / count, green / count, blue / count


def blur(points: ShadingPoints, pixels: Pixels, values: np.ndarray, extent: float, threads: int = 0) -> np.ndarray:
    """Geometry-aware blur of values (N, 3): means over windows of I x I pixels, of points of one surface.

    extent: of the scene (m).
    """
    out = np.empty_like(values)
    table, reach2 = by_place(points, pixels), np.float32((ALPHA * extent) ** 2)
    run_chunks(lambda begin, end: _blur(points, pixels, table, values, begin, end, reach2, out), len(values), CHUNK, threads)
    return out
