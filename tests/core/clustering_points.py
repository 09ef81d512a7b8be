"""Points for the clustering tests, and the slow search that the fast one must equal."""

from __future__ import annotations

import numpy as np

from lumigate.core.clustering.blocks import NO_NORMAL
from lumigate.core.clustering.grid import BY_POSITION, Metric


def room(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) points and unit normals on the walls of a 4 x 3 x 2.5 m room and on a sphere in it."""
    rng = np.random.default_rng(seed)
    size = np.array([4.0, 3.0, 2.5])
    points = rng.random((n, 3)) * size
    normals = np.zeros((n, 3))
    rows = np.arange(n)
    axis, side = rng.integers(0, 3, n), rng.integers(0, 2, n)
    points[rows, axis] = side * size[axis]
    normals[rows, axis] = 1 - 2 * side
    ball = rng.random(n) < 0.3
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points[ball] = size / 2 + 0.5 * direction[ball]
    normals[ball] = direction[ball]
    return points.astype(np.float32), normals.astype(np.float32)


def awkward(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points on a coarse lattice (many coincide, many distances are equal), far apart in places; some normals missing."""
    rng = np.random.default_rng(seed)
    points = rng.integers(0, rng.integers(1, 8), (n, 3)).astype(np.float32)
    points[rng.random(n) < 0.1] *= np.float32(100)
    points += (rng.random((n, 3)) < 0.2) * rng.random((n, 3)).astype(np.float32)
    normals = rng.normal(size=(n, 3))
    flat = rng.random(n) < 0.7
    normals[flat] = np.eye(3)[rng.integers(0, 3, n)][flat] * rng.choice([-1, 1], n)[flat, None]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    missing = rng.random(n) < 0.1
    normals[missing] = rng.choice([0.0, np.nan], missing.sum())[:, None]
    return points.astype(np.float32), normals.astype(np.float32)


def landscape(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rolling ground as a camera at eye height sees it: crowded near by, 2 km wide."""
    rng = np.random.default_rng(seed)
    distance = 1.7 / rng.uniform(1e-3, 0.8, n)
    x, y = rng.uniform(-0.7, 0.7, n) * distance, distance
    points = np.stack([x, y, 0.02 * distance * np.sin(np.log(distance) * 9)], axis=1)
    normals = np.stack([np.zeros(n), -0.4 * np.cos(np.log(distance) * 9), np.ones(n)], axis=1)
    return points.astype(np.float32), (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)


def distant_line(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A thin straight row of points, so far from the origin that float32 rounds to centimetres."""
    rng = np.random.default_rng(seed)
    points = np.array([1e5, -1e5, 3e5]) + rng.random((n, 1)) * [300, 0, 0] + rng.random((n, 3)) * 0.05
    return points.astype(np.float32), np.tile(np.float32([0, 0.6, 0.8]), (n, 1))


def _with_free(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    usable = np.isfinite(normals).all(axis=1) & (normals != 0).any(axis=1)
    return np.where(usable[:, None], normals, np.float32(0)), np.where(usable, np.float32(0), np.float32(NO_NORMAL))


def all_squared(points, normals, centres, centre_normals, metric: Metric = BY_POSITION) -> np.ndarray:
    """(N, K) float32 squared distances, term by term as the kernels add them up."""
    d = [points[:, None, axis] - centres[None, :, axis] for axis in range(3)]
    squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    if normals is None:
        normals, centre_normals = np.zeros_like(points), np.zeros_like(centres)
    (n, free), (m, centre_free) = _with_free(normals), _with_free(centre_normals)
    n, m = n[:, None], m[None]
    cos = n[..., 0] * m[..., 0] + n[..., 1] * m[..., 1] + n[..., 2] * m[..., 2] + free[:, None] + centre_free[None]
    squared = squared + np.float32(metric.turn) * np.maximum(np.float32(0), np.float32(1) - cos)
    if metric.plane:
        h = [np.abs(a[..., 0] * d[0] + a[..., 1] * d[1] + a[..., 2] * d[2]) for a in (n, m)]
        h = np.maximum(*h)
        squared = squared + np.float32(metric.plane) * (h * h)
    return np.where(cos > np.float32(metric.threshold), squared, np.float32(np.inf))


def brute_force(points, normals, centres, centre_normals, count=1, metric: Metric = BY_POSITION) -> tuple[np.ndarray, np.ndarray]:
    """(N, count) indices and squared distances: nearest first, equal ones by index, -1 and infinity for none."""
    squared = all_squared(points, normals, centres, centre_normals, metric)
    order = np.argsort(squared, axis=1, kind="stable")[:, :count]
    squared = np.take_along_axis(squared, order, axis=1)
    ids = np.where(np.isfinite(squared), order, -1).astype(np.int32)
    missing = ((0, 0), (0, count - ids.shape[1]))
    return np.pad(ids, missing, constant_values=-1), np.pad(squared, missing, constant_values=np.inf)
