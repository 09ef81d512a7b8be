"""Corners of triangles as shading points, for light that is kept in a mesh's colour attribute."""

from __future__ import annotations

import numpy as np

from ..threads import Progress, run_chunks
from ..transport import Transport, is_translucent
from .points import ShadingPoints
from .texels import ALBEDO, EMITTED, LAYERS, NORMALS, POSITION, Texels, shade_rows

CHUNK = 4096  # corners a chunk


def view_corners(
    scene: Transport,
    triangles: np.ndarray,
    samples: int,
    seed: int,
    threads: int = 0,
    progress: Progress | None = None,
    *,
    materials: bool = False,
) -> Texels:
    """The corners of T triangles as "texels" (T, 3): `samples` samples (1 to 16) of the third of the triangle next to each.

    materials: whether albedo and emission are wanted.
    """
    corners = 3 * len(triangles)
    triangles = np.ascontiguousarray(triangles, np.int32)
    found = np.repeat(np.arange(len(triangles), dtype=np.int32), 3)
    weights = corner_weights(corners, samples, seed)
    a, b, c = (scene.vertices[scene.triangles[triangles, k]].astype(np.float64) for k in range(3))
    footprint = np.sqrt(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6).astype(np.float32)
    state, layers = np.zeros(corners, np.uint8), np.zeros((corners, LAYERS), np.float32)

    def work(begin, end):
        room = ShadingPoints.allocate((end - begin) * samples * (1 + is_translucent(scene)))
        inside = np.repeat(found[begin:end, None], samples, axis=1)
        n, rays = shade_rows(
            scene, triangles, footprint, inside, weights[begin:end], begin, 1, np.uint32(seed), materials, True, room, state, layers
        )
        return room.first(n), rays

    parts = run_chunks(work, corners, CHUNK, threads, progress)
    shaped = layers.reshape(-1, 3, LAYERS)
    return Texels(
        ShadingPoints.concatenate([part for part, _ in parts]),
        state.reshape(-1, 3),
        *(np.ascontiguousarray(shaped[..., start : start + 3]) for start in (ALBEDO, EMITTED, NORMALS, POSITION)),
        sum(rays for _, rays in parts),
    )


def corner_weights(corners: int, samples: int, seed: int) -> np.ndarray:
    """(corners, samples, 2) float32, weights of corners 1 and 2 of points spread over the part where the own corner's is the largest."""
    rng = np.random.default_rng(seed)
    uv = rng.random((corners, samples, 2))
    uv = np.where(uv.sum(axis=2, keepdims=True) > 1, 1 - uv, uv)
    weights = np.concatenate([1 - uv.sum(axis=2, keepdims=True), uv], axis=2)
    own, largest = np.arange(corners)[:, None] % 3, weights.argmax(axis=2)
    shift = (np.arange(3) + (largest - own)[..., None]) % 3
    return np.take_along_axis(weights, shift, axis=2)[..., 1:].astype(np.float32)
