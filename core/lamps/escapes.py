"""Gather rays that meet the world or shining surfaces: they find direct light as shadow rays do, and cost nothing more (`lamps.direct`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined
from ..sampling.hashing import hash_combine
from ..sampling.maps import cosine_hemisphere, to_world
from ..sampling.sequences import r2
from ..scene import DIFFUSE, EMISSIVE, SHADOW, Geometry, MaterialTables

# Bits of what a ray has met: nothing at all; first something that may let light through; in the end a surface that shines.
ESCAPED, VEILED, SHINING = 1, 2, 4
VEIL = 60  # dimension of the random numbers by which a ray passes what is partly transparent


class GatherRays(NamedTuple):
    """Cosine-distributed rays that N points have traced.

    count: (N,) int32, rays of each.  met: (N, R) uint8, bits of each.  number: (N,) int32, seed, first: of their random numbers (`gather_ray`).
    """

    count: np.ndarray
    met: np.ndarray
    number: np.ndarray
    seed: int
    first: int

    def spread(self, index: np.ndarray, n: int) -> GatherRays:
        """Those of n points, of which the ones at `index` (N,) have traced these."""
        count, met, number = np.zeros(n, np.int32), np.zeros((n, self.met.shape[1]), np.uint8), np.zeros(n, np.int32)
        count[index], met[index], number[index] = self.count, self.met, self.number
        return GatherRays(count, met, number, self.seed, self.first)


def no_gather_rays(n: int) -> GatherRays:
    """Of n points that have traced none."""
    return GatherRays(np.zeros(n, np.int32), np.zeros((n, 0), np.uint8), np.zeros(n, np.int32), 0, 0)


def shadows_alike(geometry: Geometry, materials: MaterialTables) -> bool:
    """Whether gather rays may stand for shadow rays: both meet the same objects, and the former all that shine."""
    diffuse = (geometry.object_visibility & DIFFUSE) > 0
    shining = np.unique(geometry.object[(materials.flags[geometry.material] & EMISSIVE) > 0])
    return bool((diffuse == ((geometry.object_visibility & SHADOW) > 0)).all() and diffuse[shining].all())


@inlined
def gather_path(k, turn):
    """Number of the path that the ray `turn` of point k begins, for random numbers."""
    return np.uint32(k * np.int64(977) + turn)


@inlined
def gather_ray(seed, k, turn, nx, ny, nz):
    """Direction (x, y, z) of the ray number `turn` of point k, cosine-distributed about its normal n, and its cosine."""
    u1, u2 = r2(turn, hash_combine(seed, k))
    lx, ly, lz = cosine_hemisphere(u1, u2)
    dx, dy, dz = to_world(lx, ly, lz, nx, ny, nz)
    return dx, dy, dz, lz
