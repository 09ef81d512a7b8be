"""Chessboard distance to the surfaces, and the opening map: how large a ball every voxel lies in."""

from __future__ import annotations

import numpy as np
import scipy

from ..jit import kernel
from ..threads import run_chunks

_LARGEST = 255  # voxels, of a distance in a byte; half of 512 is 256
_LINES = 512  # of one chunk


def distance_map(empty: np.ndarray, *, closed: bool = True) -> np.ndarray:
    """(Z, Y, X) uint8: chessboard distance (voxels) of the empty voxels to the nearest other one, at most 255; 0 in those.

    empty: (Z, Y, X) bool.  closed: what lies outside the volume counts as solid.
    """
    if closed:
        empty = np.pad(empty, 1)
    elif empty.all():
        return np.full(empty.shape, _LARGEST, np.uint8)
    distance = np.minimum(scipy.ndimage.distance_transform_cdt(empty, "chessboard"), _LARGEST).astype(np.uint8)
    return np.ascontiguousarray(distance[1:-1, 1:-1, 1:-1]) if closed else distance


def opening_map(distance: np.ndarray, threads: int = 0) -> np.ndarray:
    """(Z, Y, X) uint8: the largest distance D(c) over the chessboard balls |v - c| < D(c) that hold voxel v.

    distance: (Z, Y, X) uint8, of `distance_map`.  Of two balls that reach a line through v, the larger one reaches further and
    counts for more: a running maximum along each axis in turn is exact.
    """
    values = distance.copy()
    nz, ny, nx = values.shape
    for n, stride in ((nx, 1), (ny, nx), (nz, ny * nx)):
        run_chunks(
            lambda begin, end, n=n, stride=stride: _spread_lines(values.ravel(), n, stride, begin, end), values.size // n, _LINES, threads
        )
    return values


@kernel
def _spread(line, n, value, end, out):
    """Running maximum along a line: out[i] = max of line[j] over the j <= i with i - j < line[j].

    value, end: (n,) scratch: a queue of falling values, each with the last voxel that it reaches.
    """
    head = tail = 0
    for i in range(n):
        d = line[i]
        while tail > head and value[tail - 1] <= d:
            tail -= 1
        if d > 0:
            value[tail], end[tail] = d, i + d - 1
            tail += 1
        while head < tail and end[head] < i:
            head += 1
        out[i] = value[head] if head < tail else 0


@kernel
def _spread_lines(values, n, stride, begin, end):
    """Replace the lines begin..end-1 of n voxels each, `stride` apart in the flat volume, by their running maximum from both sides."""
    forth, back = np.empty(n, np.int64), np.empty(n, np.int64)
    value, reach = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    for k in range(begin, end):
        start = k // stride * (stride * n) + k % stride
        line = values[start : start + stride * n : stride]
        _spread(line, n, value, reach, forth)
        _spread(line[::-1], n, value, reach, back)
        for i in range(n):
            line[i] = max(forth[i], back[n - 1 - i])
