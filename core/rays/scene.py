"""RayScene: triangles ready for tracing, from NumPy (batches) or from inside kernels (`RayScene.tables`)."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..scene import ALL_RAYS
from ..threads import run_chunks
from . import packet as pk
from .bvh import BvhBackend
from .embree import EmbreeBackend, EmbreeError
from .partition import partition, valid_triangles
from .trace import ALL, intersect_packet, occluded_packet

CHUNK = 16384  # rays a chunk of the batch functions; a multiple of the packet width


class RayScene:
    """Triangles in two traversable sets: OPAQUE, and CUTOUT (the transparent ones); ALL is both.

    A ray of kinds `mask` meets the triangles whose visibility shares a bit with it.  Triangles with a
    corner that is not finite, or of no area, are never met.  Hits report indices into `triangles`.

    vertices: (V, 3) float32.  triangles: (T, 3) int32.  visibility: (T,) uint32, bits of ray kinds
        (default: all).  transparent: (T,) bool (default: none).
    moving: (T,) int32, 0 for what keeps its place; triangles of every other number can be moved together (see `move`).
    backend: 'embree', 'bvh', or 'auto': Embree where its wheel is installed.
    Attributes: `tables` for kernels, valid until `close()` and no longer than this object;  `backend`, the name of the one chosen.
    """

    def __init__(self, vertices, triangles, visibility=None, transparent=None, backend: str = "auto", embree_config: str = "", moving=None):
        vertices = np.ascontiguousarray(vertices, np.float32).reshape(-1, 3)
        triangles = np.ascontiguousarray(triangles, np.int32).reshape(-1, 3)
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(vertices):
            raise ValueError("triangles index vertices that do not exist")
        visibility = np.full(len(triangles), ALL_RAYS, np.uint32) if visibility is None else np.asarray(visibility, np.uint32)
        transparent = np.zeros(len(triangles), bool) if transparent is None else np.asarray(transparent, bool)
        parts = partition(vertices, triangles, visibility, transparent, moving)
        self._moving, self._triangles = moving, triangles
        self._visible, self._listed = visibility != 0, np.zeros(len(triangles), bool)
        self._listed[parts.triangle] = True
        self.backend = backend
        if backend == "auto":
            try:
                self._impl = EmbreeBackend(vertices, triangles, parts, embree_config)
                self.backend = "embree"
            except EmbreeError:
                self._impl = BvhBackend(vertices, triangles, parts)
                self.backend = "bvh"
        elif backend == "embree":
            self._impl = EmbreeBackend(vertices, triangles, parts, embree_config)
        elif backend == "bvh":
            self._impl = BvhBackend(vertices, triangles, parts)
        else:
            raise ValueError(f"backend {backend!r} is not one of 'auto', 'embree', 'bvh'")
        self.tables = self._impl.tables

    def move(self, vertices: np.ndarray, moved: Collection[int]) -> bool:
        """Take other places (V, 3) of the vertices, as many as before, which differ for triangles of the numbers `moved` only.

        False, and nothing done, where all must be built anew: without Embree, where one of the numbers is 0 (or all are), and
        where a triangle has become invalid or valid.
        """
        vertices = np.ascontiguousarray(vertices, np.float32).reshape(-1, 3)
        if self._moving is None or 0 in moved or self.backend != "embree":
            return False
        mine = np.isin(self._moving, list(moved))
        if not np.array_equal(valid_triangles(vertices, self._triangles[mine]) & self._visible[mine], self._listed[mine]):
            return False
        self._impl.move(vertices, moved)
        return True

    def close(self) -> None:
        """Release memory at once. `tables` must not be used any more."""
        self.tables = None
        self._impl.close()

    def __enter__(self) -> RayScene:
        return self

    def __exit__(self, *_) -> None:
        self.close()


class Hits(NamedTuple):
    """Nearest hits of N rays.

    triangle: (N,) int32, -1 for none.  t: (N,) float32 in units of the direction's length.
    u, v: (N,) float32, weights of corners 1 and 2; 0 where there is none.
    """

    triangle: np.ndarray
    t: np.ndarray
    u: np.ndarray
    v: np.ndarray


@kernel
def _intersect_chunk(tables, which, origins, directions, t_max, mask, triangle, t, u, v):
    packet = pk.new_packet()
    n = len(origins)
    for begin in range(0, n, pk.WIDTH):
        count = min(pk.WIDTH, n - begin)
        for lane in range(count):
            o, d = origins[begin + lane], directions[begin + lane]
            pk.set_ray(packet, lane, o[0], o[1], o[2], d[0], d[1], d[2], np.float32(0.0), t_max[begin + lane], mask)
        intersect_packet(tables, which, packet, count)
        for lane in range(count):
            triangle[begin + lane] = pk.hit_triangle(packet, lane)
            t[begin + lane] = pk.hit_t(packet, lane)
            found = pk.hit_triangle(packet, lane) >= 0
            u[begin + lane] = pk.hit_u(packet, lane) if found else np.float32(0.0)
            v[begin + lane] = pk.hit_v(packet, lane) if found else np.float32(0.0)


@kernel
def _occluded_chunk(tables, which, origins, directions, t_max, mask, occluded):
    packet = pk.new_packet()
    n = len(origins)
    for begin in range(0, n, pk.WIDTH):
        count = min(pk.WIDTH, n - begin)
        for lane in range(count):
            o, d = origins[begin + lane], directions[begin + lane]
            pk.set_ray(packet, lane, o[0], o[1], o[2], d[0], d[1], d[2], np.float32(0.0), t_max[begin + lane], mask)
        occluded_packet(tables, which, packet, count)
        for lane in range(count):
            occluded[begin + lane] = pk.is_occluded(packet, lane)


def _rays(origins, directions, t_max):
    origins = np.ascontiguousarray(origins, np.float32)
    directions = np.ascontiguousarray(directions, np.float32)
    t_max = np.ascontiguousarray(np.broadcast_to(np.asarray(t_max, np.float32), len(origins)))
    return origins, directions, t_max


def intersect(ray_scene: RayScene, origins, directions, t_max=np.inf, mask: int = ALL_RAYS, which: int = ALL, threads: int = 0) -> Hits:
    """Nearest hits of N rays.

    origins, directions: (N, 3) float32; t is in units of each direction's length.
    t_max: (N,) or one number.  mask: bits of ray kinds.  which: OPAQUE, CUTOUT or ALL.
    """
    origins, directions, t_max = _rays(origins, directions, t_max)
    n = len(origins)
    hits = Hits(np.empty(n, np.int32), np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32))

    def work(b, e):
        _intersect_chunk(ray_scene.tables, which, origins[b:e], directions[b:e], t_max[b:e], mask, *(a[b:e] for a in hits))

    run_chunks(work, n, CHUNK, threads)
    return hits


def occluded(ray_scene: RayScene, origins, directions, t_max=1.0, mask: int = ALL_RAYS, which: int = ALL, threads: int = 0) -> np.ndarray:
    """(N,) uint8: 1 where anything lies in 0..t_max along the ray; arguments as `intersect`."""
    origins, directions, t_max = _rays(origins, directions, t_max)
    n = len(origins)
    result = np.empty(n, np.uint8)

    def work(b, e):
        _occluded_chunk(ray_scene.tables, which, origins[b:e], directions[b:e], t_max[b:e], mask, result[b:e])

    run_chunks(work, n, CHUNK, threads)
    return result
