"""Tangents of a UV map in the MikkTSpace convention, on which normal maps are built.

M. Mikkelsen, Simulation of wrinkled surfaces revisited, 2008; here without its splitting of fans that
meet in a vertex but share no edge.
"""

from __future__ import annotations

import numpy as np


def tangents(positions: np.ndarray, normals: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(T, 3, 4) float32: unit tangent and sign of the bitangent at the corners of T triangles.

    positions, normals: (T, 3, 3).  uv: (T, 3, 2).  Where the UV map has no area the tangent is
    (1, 0, 0), as in the reference implementation.
    """
    edge1, edge2 = positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]
    st1, st2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    sign = np.where(st1[:, 0] * st2[:, 1] - st1[:, 1] * st2[:, 0] > 0, np.float32(1), np.float32(-1))
    direction = _unit(sign[:, None] * (edge1 * st2[:, 1:] - edge2 * st1[:, 1:]))
    projected = _unit(_reject(direction[:, None], normals))

    before = _unit(_reject(np.roll(positions, 1, axis=1) - positions, normals))
    after = _unit(_reject(np.roll(positions, -1, axis=1) - positions, normals))
    angle = np.arccos(np.clip(np.einsum("tkc,tkc->tk", before, after), -1, 1))

    corner_sign = np.broadcast_to(sign[:, None, None], (*uv.shape[:2], 1))
    group = _groups(np.concatenate([positions, normals, uv, corner_sign], axis=2, dtype=np.float32).reshape(-1, 9))
    weighted = (projected * angle[..., None]).reshape(-1, 3)
    total = np.stack([np.bincount(group, weighted[:, c]) for c in range(3)], axis=1)
    result = np.empty((*uv.shape[:2], 4), np.float32)
    total[~total.any(1)] = (1, 0, 0)
    result[..., :3] = _unit(total)[group].reshape(positions.shape)
    result[..., 3] = sign[:, None]
    return result


def _groups(rows: np.ndarray) -> np.ndarray:
    """A number for every row, the same for rows that are equal bit by bit (64-bit hashes are compared)."""
    bits = (rows + np.float32(0)).view(np.uint32).astype(np.uint64)  # + 0 makes -0 and 0 one
    factors = np.random.default_rng(1).integers(1, 2**63, rows.shape[1], np.uint64) | np.uint64(1)
    mixed = (bits * factors).sum(1, dtype=np.uint64)
    return np.unique(mixed, return_inverse=True)[1].ravel()


def _reject(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return vectors - normals * np.einsum("...c,...c->...", np.broadcast_to(vectors, normals.shape), normals)[..., None]


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)
