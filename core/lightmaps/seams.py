"""Seams: edges of a smooth surface whose two sides lie apart in the UV map, and must show the same light all the same.

What a viewer sees beside an edge is the image, bilinearly interpolated, along two lines in it.  Texels near them are moved as
little as makes the lines agree, by least squares (Iwanicki 2013, "Lighting Technology of The Last of Us", SIGGRAPH Talks).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

from ..scene import Geometry
from ..view.texels import Charts

SMOOTH = 0.98  # cosine between the shading normals of both sides: a sharper edge may well show two kinds of light
APART = 0.05  # texels
STEP = 0.5  # texels between the places where both sides are compared
AGREEMENT = 30.0  # weight of a difference at one place, against
KEPT = 1.0  # that of changing a texel that shows,
FREE = 0.1  # and of one in the margin
_TOLERANCE = 1e-4
_ITERATIONS = 200


class Seams(NamedTuple):
    """E edges, each twice in the image: ends (E, 2, 2) float64 in texels (x, y), in the same order in space on both sides."""

    a: np.ndarray
    b: np.ndarray


class Pairs(NamedTuple):
    """P places on seams: the four texels (P, 4) int64 around each on either side, and their bilinear weights (P, 4)."""

    texels_a: np.ndarray
    weights_a: np.ndarray
    texels_b: np.ndarray
    weights_b: np.ndarray

    def difference(self, image: np.ndarray) -> np.ndarray:
        """What side a shows more than side b, (P, C)."""
        flat = image.reshape(-1, image.shape[-1]).astype(np.float64)
        sides = (self.texels_a, self.weights_a), (self.texels_b, self.weights_b)
        a, b = (np.einsum("pk,pkc->pc", weights, flat[texels]) for texels, weights in sides)
        return a - b


def find_seams(geometry: Geometry, charts: Charts) -> Seams:
    """Edges of exactly two triangles, smooth across, whose sides lie apart in the image."""
    corners = _welded(geometry, charts.triangle)
    normals = geometry.corner_normals[charts.triangle]
    # Edge k of a triangle goes from corner k to the next; row e of the list is edge e % 3 of triangle e // 3.
    first, second = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    swapped = first > second
    low, high = np.minimum(first, second), np.maximum(first, second)
    key = low.astype(np.int64) * (corners.max(initial=0) + 1) + high
    order = np.argsort(key, kind="stable")
    ends = np.flatnonzero(np.diff(key[order], append=-1))
    count = np.diff(ends, prepend=-1)
    last = ends[(count == 2) & (low[order[ends]] != high[order[ends]])]
    a, b = order[last - 1], order[last]

    def of_edges(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
        """(E, 2, ...) of values (T, 3, ...) at the ends of edges, the lower vertex first."""
        pair = np.stack([values[edges // 3, edges % 3], values[edges // 3, (edges + 1) % 3]], axis=1)
        return np.where(swapped[edges].reshape(-1, *[1] * (pair.ndim - 1)), pair[:, ::-1], pair)

    uv_a, uv_b = of_edges(charts.uv, a).astype(np.float64), of_edges(charts.uv, b).astype(np.float64)
    smooth = (np.einsum("eic,eic->ei", of_edges(normals, a), of_edges(normals, b)) > SMOOTH).all(axis=1)
    chosen = smooth & (np.abs(uv_a - uv_b).max(axis=(1, 2), initial=0) > APART)
    return Seams(uv_a[chosen], uv_b[chosen])


def _welded(geometry: Geometry, triangles: np.ndarray) -> np.ndarray:
    """(T, 3) numbers of corners, the same for the same place on the same object, however often the file lists it."""
    places = geometry.vertices[geometry.triangles[triangles]] + np.float32(0)  # -0 becomes 0
    bits = np.ascontiguousarray(places).view(np.uint32).astype(np.uint64)
    with np.errstate(over="ignore"):
        mixed = geometry.object[triangles].astype(np.uint64)[:, None] * np.uint64(0xD6E8FEB86659FD93)
        for c in range(3):
            mixed = (mixed ^ bits[..., c]) * np.uint64(0x9E3779B97F4A7C15)
            mixed ^= mixed >> np.uint64(29)
    return np.unique(mixed, return_inverse=True)[1].reshape(-1, 3)


def compared_places(seams: Seams, filled: np.ndarray) -> Pairs:
    """Places along all seams in an image whose texels `filled` (H, W) bool hold light; places beside others are left out."""
    length = np.maximum(*(np.linalg.norm(side[:, 1] - side[:, 0], axis=1) for side in seams))
    counts = np.maximum(1, np.ceil(length / STEP)).astype(np.int64)
    edge = np.repeat(np.arange(len(counts)), counts)
    along = (np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[edge]
    sides = [_bilinear(side[edge, 0] + along[:, None] * (side[edge, 1] - side[edge, 0]), filled.shape) for side in seams]
    known = np.ones(len(edge), bool)
    for texels, weights in sides:
        known &= (filled.ravel()[texels] | (weights < 1e-6)).all(axis=1)
    return Pairs(*(array[known] for side in sides for array in side))


def _bilinear(places: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The texels (P, 4) around places (P, 2) and their weights (P, 4), as a renderer interpolates and extends at the border."""
    corner = np.floor(places - 0.5)
    fx, fy = (places - 0.5 - corner).T
    x, y = (np.clip(corner[:, c, None].astype(np.int64) + np.arange(2), 0, shape[1 - c] - 1) for c in (0, 1))
    texels = np.stack(
        [y[:, 0] * shape[1] + x[:, 0], y[:, 0] * shape[1] + x[:, 1], y[:, 1] * shape[1] + x[:, 0], y[:, 1] * shape[1] + x[:, 1]], 1
    )
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], 1)
    return texels, weights


def stitched(image: np.ndarray, lit: np.ndarray, filled: np.ndarray, seams: Seams) -> np.ndarray:
    """`image` (H, W, C) float32 whose seams agree as far as its resolution allows; not negative.

    lit: (H, W) bool, texels that show a surface, which are changed as little as possible; filled: those and the margins.
    """
    if len(seams.a) == 0:
        return image
    pairs = compared_places(seams, filled)
    if len(pairs.texels_a) == 0:
        return image
    texels, column = np.unique(np.concatenate([pairs.texels_a, pairs.texels_b], axis=1), return_inverse=True)
    rows = np.repeat(np.arange(len(pairs.texels_a)), 8)
    weights = np.concatenate([pairs.weights_a, -pairs.weights_b], axis=1).ravel()
    differences = sparse.csr_matrix((weights, (rows, column.ravel())), shape=(len(pairs.texels_a), len(texels)))
    keep = np.where(lit.ravel()[texels], KEPT, FREE)
    normal = AGREEMENT * differences.T @ differences + sparse.diags(keep)
    out = image.reshape(-1, image.shape[-1]).copy()
    precondition = sparse.diags(1 / normal.diagonal())
    for c in range(out.shape[1]):
        before = out[texels, c].astype(np.float64)
        change, _ = cg(normal, -AGREEMENT * (differences.T @ (differences @ before)), rtol=_TOLERANCE, maxiter=_ITERATIONS, M=precondition)
        out[texels, c] = np.maximum(before + change, 0)
    return out.reshape(image.shape)


def seam_error(image: np.ndarray, filled: np.ndarray, seams: Seams) -> float:
    """Mean difference across the seams, of the mean of the texels that hold light; NaN where there are no seams."""
    pairs = compared_places(seams, filled)
    if len(pairs.texels_a) == 0:
        return float("nan")
    return float(np.abs(pairs.difference(image)).mean() / max(float(image[filled].mean()), 1e-30))
