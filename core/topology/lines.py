"""Lines between the surfaces of parts of the empty space, and whether they are free: what parts see of each other.

A part stands here for a few of its voxels that touch something solid; only those that face each other are joined by lines, as light would be.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..sampling.hashing import uniform
from .bits import pack

SAMPLES = 512  # surface voxels that stand for a part
LINES = 256  # between two parts
_SEED = np.uint32(20)


class Samples(NamedTuple):
    """Surface voxels that stand for each of K parts.

    voxels: (K, SAMPLES, 6) int32: x, y, z, and as x, y, z where solid voxels are not.  sizes: (K,) int64, surface voxels of each part.
    """

    voxels: np.ndarray
    sizes: np.ndarray


@kernel
def _facing(label, z, y, x):
    """(x, y, z) away from the solid neighbours by faces of a voxel, or what lies outside; 0 where it has none."""
    nz, ny, nx = label.shape
    return (
        np.int32(x == 0 or label[z, y, x - 1] < 0) - np.int32(x == nx - 1 or label[z, y, x + 1] < 0),
        np.int32(y == 0 or label[z, y - 1, x] < 0) - np.int32(y == ny - 1 or label[z, y + 1, x] < 0),
        np.int32(z == 0 or label[z - 1, y, x] < 0) - np.int32(z == nz - 1 or label[z + 1, y, x] < 0),
    )


@kernel
def _draw(label, seed, samples, sizes):
    """Draw surface voxels of each label (Z, Y, X) by reservoirs (Vitter 1985); any voxels of one that has no surface.

    samples: (labels, K, 6) int32, takes x, y, z and the facing of each; sizes: (labels,) int64, surface voxels.
    """
    nz, ny, nx = label.shape
    count = samples.shape[1]
    inner = np.zeros(len(sizes), np.int64)
    sizes[:] = 0
    for z in range(nz):
        for y in range(ny):
            for x in range(nx):
                c = label[z, y, x]
                if c < 0:
                    continue
                fx, fy, fz = _facing(label, z, y, x)
                at_surface = fx != 0 or fy != 0 or fz != 0
                if not at_surface and sizes[c] > 0:
                    continue
                seen = sizes[c] if at_surface else inner[c]
                place = seen
                if seen >= count:
                    place = np.int64(uniform(seed, np.uint32(c), np.uint32(seen), np.uint32(0)) * np.float32(seen + 1))
                if place < count:
                    samples[c, place, 0], samples[c, place, 1], samples[c, place, 2] = x, y, z
                    samples[c, place, 3], samples[c, place, 4], samples[c, place, 5] = fx, fy, fz
                if at_surface:
                    sizes[c] += 1
                else:
                    inner[c] += 1
    for c in range(len(sizes)):
        if sizes[c] == 0:
            sizes[c] = min(count, inner[c])


@kernel
def free_line(empty, x, y, z, u, v, w):
    """Whether the line between the middles of two voxels meets empty voxels only (Amanatides & Woo 1987).

    empty: (Z, Y, W) uint64, the empty voxels in bits (`bits.pack`): little memory to walk through.
    """
    ax, ay, az = abs(u - x), abs(v - y), abs(w - z)
    sx, sy, sz = (1 if u > x else -1), (1 if v > y else -1), (1 if w > z else -1)
    step_x, step_y, step_z = 1.0 / max(ax, 1e-9), 1.0 / max(ay, 1e-9), 1.0 / max(az, 1e-9)
    tx, ty, tz = 0.5 * step_x, 0.5 * step_y, 0.5 * step_z
    for _ in range(ax + ay + az):
        if tx <= ty and tx <= tz:
            x += sx
            tx += step_x
        elif ty <= tz:
            y += sy
            ty += step_y
        else:
            z += sz
            tz += step_z
        if not (empty[z, y, x >> 6] >> np.uint64(x & 63)) & np.uint64(1):
            return False
    return True


@kernel
def _free(empty, samples, sizes, pairs, seed, out):
    """The share of free lines between samples of each pair of clusters (P, 2) that face each other, into `out` (P,); 1 where none do."""
    for p in range(len(pairs)):
        a, b = pairs[p, 0], pairs[p, 1]
        na, nb = min(sizes[a], samples.shape[1]), min(sizes[b], samples.shape[1])
        tried = free = 0
        for k in range(4 * LINES):
            i = min(na - 1, np.int64(uniform(seed, np.uint32(a), np.uint32(b), np.uint32(2 * k)) * np.float32(na)))
            j = min(nb - 1, np.int64(uniform(seed, np.uint32(a), np.uint32(b), np.uint32(2 * k + 1)) * np.float32(nb)))
            s, t = samples[a, i], samples[b, j]
            dx, dy, dz = t[0] - s[0], t[1] - s[1], t[2] - s[2]
            if (s[3] or s[4] or s[5]) and dx * s[3] + dy * s[4] + dz * s[5] <= 0:
                continue
            if (t[3] or t[4] or t[5]) and dx * t[3] + dy * t[4] + dz * t[5] >= 0:
                continue
            tried += 1
            free += free_line(empty, s[0], s[1], s[2], t[0], t[1], t[2])
            if tried == LINES:
                break
        out[p] = free / tried if tried else 1.0


def samples_of(label: np.ndarray, count: int) -> Samples:
    """Voxels that stand for each of `count` parts; label: (Z, Y, X) int32, negative in solid voxels."""
    samples = Samples(np.zeros((count, SAMPLES, 6), np.int32), np.empty(count, np.int64))
    _draw(label, _SEED, *samples)
    return samples


def free_shares(label: np.ndarray, samples: Samples, pairs: np.ndarray) -> np.ndarray:
    """(P,) float64: which share of LINES lines between the parts of each pair (P, 2) is free; 1 where no samples face each other."""
    out = np.empty(len(pairs))
    _free(pack(label >= 0), *samples, np.ascontiguousarray(pairs, np.int64), _SEED, out)
    return out
