"""Surfaces at some places of each material: what textured ones are in the mean, or mostly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..jit import kernel
from ..sampling.hashing import uniform
from ..scene import MaterialTables
from .batch import evaluate_batch
from .layout import SURFACE
from .program import MEAN_VIEW

PLACES = 16  # of a material


@kernel
def _some_triangles(material, found, number):
    """Fills each row of `found` (M, PLACES) with triangles of that material, drawn evenly; number: (M,) int64 zeros, how many it is on."""
    most = found.shape[1]
    for t in range(len(material)):
        m = material[t]
        n = number[m]
        at = n if n < most else np.int64(uniform(np.uint32(t), 0, 0, 0) * np.float32(n + 1))
        if at < most:
            found[m, at] = t
        number[m] += 1


def some_surfaces(
    tables: MaterialTables, material: np.ndarray, attributes: np.ndarray, wanted: np.ndarray, threads: int = 0,
    cosines: Sequence[float] = (MEAN_VIEW,),
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Surfaces (K N, SURFACE) float32 at up to `PLACES` triangles of each of the `wanted` (M,) bool materials, view by view, and the material of each, (K N,).

    material: (T,) int32, of the triangles.  attributes: (K, T, 3, 4) float32.  cosines: (K,) of the views, as for `program.evaluate`.
    """
    found = np.full((len(wanted), PLACES), -1, np.int32)
    _some_triangles(material, found, np.zeros(len(wanted), np.int64))
    found[~wanted] = -1
    owner, _ = np.nonzero(found >= 0)
    triangle = found[found >= 0]
    u, v = np.random.default_rng(0).random((2, len(triangle)))
    u, v = 1 - np.sqrt(u), v * np.sqrt(u)
    places = [np.tile(column, len(cosines)) for column in (triangle, u.astype(np.float32), v.astype(np.float32))]
    surfaces = evaluate_batch(tables, material, attributes, *places, np.repeat(np.asarray(cosines, np.float32), len(triangle)), threads)
    return surfaces.reshape(-1, SURFACE), np.tile(owner, len(cosines))
