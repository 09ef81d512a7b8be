"""Gather rays that meet the world: they find direct light as shadow rays do, and cost nothing more (`lamps.direct`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined
from ..sampling.hashing import hash_combine
from ..sampling.maps import cosine_hemisphere, to_world
from ..sampling.sequences import r2
from ..scene import DIFFUSE, SHADOW

STOPPED, ESCAPED, VEILED = 0, 1, 2  # met an opaque surface first, nothing at all, something that may let light through


class GatherRays(NamedTuple):
    """Cosine-distributed rays that N points have traced.

    count: (N,) int32, rays of each.  met: (N, R) uint8, of those above for each.  seed, first: of their random numbers (`gather_ray`).
    """

    count: np.ndarray
    met: np.ndarray
    seed: int
    first: int


def no_gather_rays(n: int) -> GatherRays:
    """Of n points that have traced none."""
    return GatherRays(np.zeros(n, np.int32), np.zeros((n, 0), np.uint8), 0, 0)


def shadows_alike(visibility: np.ndarray) -> bool:
    """Whether rays of diffuse light and shadow rays may meet the same objects, of a `visibility` (O,) each: else they cannot stand for each other."""
    return bool((((visibility & DIFFUSE) > 0) == ((visibility & SHADOW) > 0)).all())


@inlined
def gather_ray(seed, k, turn, nx, ny, nz):
    """Direction (x, y, z) of the ray number `turn` of point k, cosine-distributed about its normal n, and its cosine."""
    u1, u2 = r2(turn, hash_combine(seed, k))
    lx, ly, lz = cosine_hemisphere(u1, u2)
    dx, dy, dz = to_world(lx, ly, lz, nx, ny, nz)
    return dx, dy, dz, lz
