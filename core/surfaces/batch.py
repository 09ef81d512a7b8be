"""Surfaces of many hits at once, over threads."""

from __future__ import annotations

import numpy as np

from ..scene import MaterialTables
from ..threads import Progress, run_chunks
from .layout import SURFACE
from .program import MEAN_VIEW, evaluate_range

_CHUNK = 4096


def evaluate_batch(
    tables: MaterialTables,
    materials: np.ndarray,
    attributes: np.ndarray,
    triangle: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    cosine: np.ndarray | float = MEAN_VIEW,
    threads: int = 0,
    progress: Progress | None = None,
) -> np.ndarray:
    """(N, SURFACE) float32 surfaces of N hits.

    materials: (T,) int32, material of each triangle.  attributes: (K, T, 3, 4) float32.
    triangle: (N,) int32, below 0 for no hit (zeros).  u, v: (N,) float32 barycentric.
    cosine: (N,) or one number, see `program.evaluate`.
    """
    n = len(triangle)
    surfaces = np.empty((n, SURFACE), np.float32)
    # Of one type, whatever is handed over, and writable, so that the kernel is compiled once.
    materials, triangle = np.ascontiguousarray(materials, np.int32), np.ascontiguousarray(triangle, np.int32)
    u, v, cosine = (np.array(np.broadcast_to(part, n), np.float32, order="C") for part in (u, v, cosine))

    def work(begin: int, end: int) -> None:
        evaluate_range(tables, materials, attributes, triangle, u, v, cosine, begin, end, surfaces)

    run_chunks(work, n, _CHUNK, threads, progress)
    return surfaces
