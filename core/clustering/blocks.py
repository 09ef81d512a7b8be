"""Points in space-filling order, sixteen to a block: the form in which they are searched for their clusters.

Neighbours in this order are neighbours in space with similar normals, so that one short list of
candidates serves all lanes of a block and the inner loops are plain vector code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..jit import inlined, kernel

LANES = 16  # points a block: one AVX-512 register, two of AVX2

NO_NORMAL = 4.0  # stands for the cosine between a normal and a missing one

_AXIS_BITS = 15
_FACE_BITS = 3
_DIGIT_BITS = 12  # of the radix sort: 4 passes, 4096 counters (32 KiB)
_FARTHEST = 1e18  # coordinates beyond it overflow a float32 squared distance
_POINT = 1e-30  # m: points within it are one place


@dataclass(frozen=True)
class PointBlocks:
    """N of the M given points (those with finite coordinates), sorted and padded to P, a multiple of LANES.

    order: (N,) int32, sorted place -> given index.
    positions: (3, P) float32.
    normals: (4, P) float32: x, y, z and 0. A normal that is zero, not finite or not given becomes
        (0, 0, 0, NO_NORMAL), which lies above every threshold on the cosine: it goes with any other.
    given: M.
    """

    order: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    given: int

    def __len__(self) -> int:
        return len(self.order)

    def every(self, step: int) -> PointBlocks:
        """Every `step`-th point of the order: a sample stratified over space and normals."""
        return self.take(np.arange(step // 2, len(self), step))

    def take(self, places: np.ndarray) -> PointBlocks:
        """The points at these sorted places."""
        padded = _padded(places)
        return PointBlocks(
            self.order[places],
            np.ascontiguousarray(self.positions[:, padded]),
            np.ascontiguousarray(self.normals[:, padded]),
            self.given,
        )


def as_blocks(positions: np.ndarray | PointBlocks, normals: np.ndarray | None) -> PointBlocks:
    """`positions` if they are blocks already, else `point_blocks` of both."""
    return positions if isinstance(positions, PointBlocks) else point_blocks(positions, normals)


def point_blocks(positions: np.ndarray, normals: np.ndarray | None = None) -> PointBlocks:
    """Sort points along a Morton curve whose cells are split by the normal's dominant axis.

    positions: (M, 3), any finite unit; normals: (M, 3) unit vectors or None.
    Points with a coordinate that is not finite (or beyond 1e18) are left out.

    Raises:
        ValueError: the shapes are not (M, 3).
    """
    positions = as_vectors(positions, "positions")
    normals = as_vectors(normals, "normals") if normals is not None else np.zeros_like(positions)
    if len(normals) != len(positions):
        raise ValueError(f"normals: {len(normals)} rows for {len(positions)} positions")
    indices = np.empty(len(positions), np.int32)
    bounds = np.zeros((2, 3), np.float32)
    indices = indices[: _finite_points(positions, indices, bounds)]
    extent = float((bounds[1] - bounds[0]).max())
    scale = np.float32((2**_AXIS_BITS - 1) / extent if extent > _POINT else 0.0)
    # The normal splits cells that hold some 512 points where the points lie on surfaces.
    face_level = round(math.log2(max(1.0, math.sqrt(len(indices) / 512))))
    keys = np.empty(len(indices), np.int64)
    _sort_keys(positions, normals, indices, bounds[0], scale, 3 * (_AXIS_BITS - min(face_level, _AXIS_BITS)), keys)
    order = indices[radix_order(keys)]
    places = _padded(order)
    return PointBlocks(order, gather(positions, places), gather_normals(normals, places), len(positions))


def as_vectors(array: np.ndarray, name: str) -> np.ndarray:
    """(M, 3) contiguous float32, or ValueError naming the argument."""
    array = np.ascontiguousarray(array, np.float32)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: expected an array of shape (N, 3), got {array.shape}")
    return array


def radix_order(keys: np.ndarray) -> np.ndarray:
    """The stable order of (N,) int64 keys in [0, 2^48), as (N,) int32."""
    order = np.arange(len(keys), dtype=np.int32)
    return _radix_order(keys, order, np.empty_like(order), np.empty(2**_DIGIT_BITS, np.int64))


def _padded(places: np.ndarray) -> np.ndarray:
    missing = -len(places) % LANES
    return np.concatenate([places, np.repeat(places[-1:], missing)]) if missing else places


@kernel(fast=False)
def _finite_points(positions, indices, bounds):
    n = 0
    for i in range(len(positions)):
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        if abs(x) < _FARTHEST and abs(y) < _FARTHEST and abs(z) < _FARTHEST:  # False for NaN
            for axis in range(3):
                bounds[0, axis] = min(bounds[0, axis], positions[i, axis]) if n else positions[i, axis]
                bounds[1, axis] = max(bounds[1, axis], positions[i, axis]) if n else positions[i, axis]
            indices[n] = i
            n += 1
    return n


@kernel(fast=False)
def gather(vectors, places):
    """(N, 3) vectors at (P,) places -> (3, P)."""
    out = np.empty((3, len(places)), np.float32)
    for i in range(len(places)):
        for axis in range(3):
            out[axis, i] = vectors[places[i], axis]
    return out


@kernel(fast=False)
def gather_normals(normals, places):
    """(N, 3) normals at (P,) places -> (4, P), the form of `PointBlocks.normals`."""
    out = np.zeros((4, len(places)), np.float32)
    for i in range(len(places)):
        x, y, z = normals[places[i], 0], normals[places[i], 1], normals[places[i], 2]
        if np.isfinite(x + y + z) and (x != 0 or y != 0 or z != 0):
            out[0, i], out[1, i], out[2, i] = x, y, z
        else:
            out[3, i] = NO_NORMAL
    return out


@inlined(fastmath=False)
def _spread(v):
    """15 bits, two zeros after each."""
    v = (v | (v << 16)) & 0x0000FF0000FF
    v = (v | (v << 8)) & 0x00F00F00F00F
    v = (v | (v << 4)) & 0x0C30C30C30C3
    return (v | (v << 2)) & 0x249249249249


@kernel(fast=False)
def _sort_keys(positions, normals, indices, low, scale, face_shift, keys):
    lower_bits = (np.int64(1) << face_shift) - 1
    for i in range(len(indices)):
        p = indices[i]
        code = np.int64(0)
        for axis in range(3):
            code |= _spread(np.int64((positions[p, axis] - low[axis]) * scale)) << axis
        x, y, z = normals[p, 0], normals[p, 1], normals[p, 2]
        largest = max(abs(x), abs(y), abs(z))
        face = np.int64(0) if abs(x) == largest else (np.int64(1) if abs(y) == largest else np.int64(2))
        face += 3 * np.int64(x + y + z < 0)
        keys[i] = ((code & ~lower_bits) << _FACE_BITS) | (face << face_shift) | (code & lower_bits)


@kernel(fast=False)
def _radix_order(keys, order, other, count):
    for shift in range(0, 3 * _AXIS_BITS + _FACE_BITS, _DIGIT_BITS):
        count[:] = 0
        for i in range(len(keys)):
            count[(keys[i] >> shift) & (len(count) - 1)] += 1
        total = 0
        for digit in range(len(count)):
            total, count[digit] = total + count[digit], total
        for i in range(len(order)):
            digit = (keys[order[i]] >> shift) & (len(count) - 1)
            other[count[digit]] = order[i]
            count[digit] += 1
        order, other = other, order
    return order
