"""Texels that got no light of their own: what they take from their neighbours, so that no edge is black."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import convolve, distance_transform_edt, find_objects, label

from ..denoise import Denoiser, mean_factor
from ..sharp_shadows import SharpLight, give_shadows_back
from ..view.texels import EMPTY, HIDDEN, LIT

# Hidden neighbours, of those that show a surface, of a texel that is hidden itself, whatever its own few rays found; and so many at least.
STRAY, LEAST = 0.75, 3
# Texels around a chart that a denoiser sees with it, where charts are laid closer together than in the image.  From 4 to 12 errors are alike.
_SEEN_AROUND = 6
_WORTH = 0.9  # of the image's area: a denser one that is no smaller than this is not made
_DEPTHS = (1.0, 0.5, 0.25)  # how far inside its chart a texel's mirror image lies, of its distance outside


class Surroundings(NamedTuple):
    """Where each texel of an image looks for light; arrays (H, W).

    lit: bool, it has light of its own.  distance: to the nearest one that has, in texels.
    nearest: int64, that one, row-major.  mirrored: int64, the texel as far inside the chart as this one is outside, where there is one.
    """

    lit: np.ndarray
    distance: np.ndarray
    nearest: np.ndarray
    mirrored: np.ndarray


class Packing(NamedTuple):
    """A smaller image of what is lit in a larger one, and of what is around that.

    source: (h, w) int64, the texel of the large image that each texel shows, row-major.  place: (H, W) int64, where a lit texel is in the small one.
    """

    source: np.ndarray
    place: np.ndarray


def without_strays(state: np.ndarray) -> np.ndarray:
    """`state` (H, W) uint8 of texels without single lit ones amid hidden ones."""
    hidden = state == HIDDEN
    if not hidden.any():
        return state
    around, shown = (convolve(which.astype(np.uint8), np.ones((3, 3), np.uint8), mode="constant") for which in (hidden, state != EMPTY))
    alone = (around >= LEAST) & (around >= STRAY * (shown - 1))
    return np.where((state == LIT) & alone, np.uint8(HIDDEN), state)


def surroundings(state: np.ndarray) -> Surroundings:
    """What `state` (H, W) uint8 of texels, at least one of them lit, says of their neighbours."""
    height, width = state.shape
    lit = state == LIT
    distance, (row, column) = distance_transform_edt(~lit, return_indices=True)
    nearest = row.astype(np.int64) * width + column
    mirrored, flat = nearest.copy(), lit.ravel()
    left = np.flatnonzero(~flat)
    for depth in _DEPTHS:
        y, x = left // width, left % width
        ny, nx = nearest.flat[left] // width, nearest.flat[left] % width
        my = np.clip(np.rint(ny + depth * (ny - y)).astype(np.int64), 0, height - 1)
        mx = np.clip(np.rint(nx + depth * (nx - x)).astype(np.int64), 0, width - 1)
        image = my * width + mx
        inside = flat[image]
        mirrored.flat[left[inside]] = image[inside]
        left = left[~inside]
    return Surroundings(lit, distance, nearest, mirrored)


def extended(image: np.ndarray, state: np.ndarray, around: Surroundings, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """`image` (H, W, C) with all hidden texels and those within `margin` texels of a lit one filled, the rest zero.

    Returns the image and where it holds light, (H, W) bool.
    """
    filled = (around.distance <= margin) | (state == HIDDEN)
    return np.where(filled[..., None], _taken(image, around.nearest), np.float32(0)), filled


def packing(lit: np.ndarray) -> Packing | None:
    """How charts, of which `lit` (H, W) bool tells, lie closer together, on shelves; None where they hardly could.

    An atlas is empty for a half to three quarters, on which a denoiser spends as much time as on the rest.
    """
    height, width = lit.shape
    chart, count = label(lit, np.ones((3, 3)))
    bounds = np.array([[(along.start, along.stop) for along in box] for box in find_objects(chart)])
    low = np.maximum(bounds[..., 0] - _SEEN_AROUND, 0)
    size = np.minimum(bounds[..., 1] + _SEEN_AROUND, (height, width)) - low
    side = max(int(size[:, 1].max()), int(np.ceil(1.05 * np.sqrt(size.prod(axis=1).sum()))))
    corner = np.empty((count, 2), np.int64)
    x = y = shelf = 0
    for k in np.argsort(-size[:, 0], kind="stable"):
        if x + size[k, 1] > side:
            x, y, shelf = 0, y + shelf, 0
        corner[k] = y, x
        x, shelf = x + size[k, 1], max(shelf, size[k, 0])
    if (y + shelf) * side > _WORTH * lit.size:
        return None
    source, place = np.full((y + shelf, side), -1, np.int64), np.zeros(lit.shape, np.int64)
    for k in range(count):
        (top, left), (rows, columns), (y, x) = low[k], size[k], corner[k]
        there, here = np.s_[top : top + rows, left : left + columns], np.s_[y : y + rows, x : x + columns]
        row, column = np.arange(rows)[:, None], np.arange(columns)
        source[here] = (top + row) * width + left + column
        place[there] = np.where(chart[there] == k + 1, (y + row) * side + x + column, place[there])
    row, column = distance_transform_edt(source < 0, return_distances=False, return_indices=True)
    return Packing(source[row, column], place)


def denoised(
    irradiance: np.ndarray, normal: np.ndarray, position: np.ndarray, around: Surroundings, denoiser: Denoiser, threads: int,
    sharp: SharpLight | None = None,
) -> np.ndarray:  # fmt: skip
    """`irradiance` (H, W, 3) without noise where texels are lit, its mean kept.

    Charts are mirrored about their edges first: a black gutter would darken them, and one filled with streaks of a colour would
    look like a pattern to be kept; and laid closer together, to save time.  Normals (H, W, 3) tell the denoiser where one chart ends and another begins; positions (m) are
    for the blur that stands in for it.  sharp: what of the irradiance has sharp shadows, which is denoised apart and gets them back.
    """
    if not irradiance[around.lit].any():
        return irradiance
    packed = packing(around.lit)
    source = around.mirrored if packed is None else around.mirrored.ravel()[packed.source]
    color, normal, position = (_taken(image, source) for image in (irradiance, normal, position))
    guides = np.full_like(color, 0.5), normal
    clean = np.zeros_like(color)
    if sharp is not None:
        sharp = SharpLight(*(_taken(image, source) for image in sharp))
        clean += denoiser.denoise(sharp.lit, *guides, position=position, threads=threads)
        give_shadows_back(clean, sharp, threads)
        color = color - sharp.lit
    if color.any():
        clean += denoiser.denoise(color, *guides, position=position, threads=threads)
    if packed is not None:
        clean = _taken(clean, packed.place)
    factor = mean_factor(irradiance[around.lit][None], clean[around.lit][None])
    return np.where(around.lit[..., None], clean * factor, np.float32(0))


def _taken(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    """`image` (H, W, C) with each texel replaced by the one `at` (H, W)."""
    return image.reshape(-1, image.shape[-1])[at]
