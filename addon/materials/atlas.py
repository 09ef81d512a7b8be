"""A fresh UV layout for baking: every polygon has a cell of its own, sized by its area."""

from __future__ import annotations

import math

import numpy as np

_SMALLEST, _LARGEST = 8, 512  # texels along the side of a cell; powers of two
_GAP = 1.5  # texels between a polygon and the border of its cell


def cell_sizes(areas: np.ndarray, side: int) -> np.ndarray:
    """(P,) int64 sides of the cells, powers of two in proportion to the root of the areas, that fill a square of `side` texels.

    Raises:
        ValueError: so many polygons do not fit.
    """
    length = np.sqrt(np.maximum(areas, 0))
    if len(areas) * _SMALLEST**2 > side * side:
        raise ValueError("too many polygons")
    density = 2 * side / max(math.sqrt(float((length**2).sum())), 1e-30)
    while True:
        wanted = np.clip(length * density, _SMALLEST, min(_LARGEST, side))
        sizes = 2 ** np.floor(np.log2(wanted)).astype(np.int64)
        if (sizes**2).sum() <= side * side:
            return sizes
        density /= math.sqrt(2)


def pack(sizes: np.ndarray, side: int) -> np.ndarray:
    """(P, 2) int64 lower left corners of cells in a square.

    Cells in descending order follow each other along the Morton curve, where squares whose sides are powers
    of two leave no holes.
    """
    order = np.argsort(-sizes, kind="stable")
    units = (sizes[order] // _SMALLEST) ** 2
    start = np.cumsum(units) - units
    corners = np.empty((len(sizes), 2), np.int64)
    x, y = np.zeros_like(start), np.zeros_like(start)
    for bit in range(int(math.log2(side)) + 1):
        x |= ((start >> (2 * bit)) & 1) << bit
        y |= ((start >> (2 * bit + 1)) & 1) << bit
    corners[order] = np.stack([x, y], 1) * _SMALLEST
    return corners


def polygon_shape(corners: int) -> np.ndarray:
    """(corners, 2) convex polygon in the unit square; any triangulation of it is free of overlaps."""
    if corners == 3:
        return np.array([(0, 0), (1, 0), (0, 1)], float)
    if corners == 4:
        return np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    angle = np.arange(corners) * (2 * np.pi / corners)
    return 0.5 + 0.5 * np.stack([np.cos(angle), np.sin(angle)], 1)


def layout(corner_counts: np.ndarray, areas: np.ndarray, side: int) -> np.ndarray:
    """(sum of corner_counts, 2) float32 UVs of the polygons' corners, one polygon after the other."""
    sizes = cell_sizes(areas, side)
    origins = pack(sizes, side)
    first = np.cumsum(corner_counts) - corner_counts
    uv = np.empty((int(corner_counts.sum()), 2), np.float32)
    for count in np.unique(corner_counts):
        which = np.flatnonzero(corner_counts == count)
        inner = (sizes[which] - 2 * _GAP)[:, None, None]
        at = origins[which][:, None, :] + _GAP + polygon_shape(int(count)) * inner
        uv[first[which][:, None] + np.arange(count)] = at / side
    return uv
