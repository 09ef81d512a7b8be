"""Texels that got no light of their own: what they take from their neighbours, so that no edge is black."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import convolve, distance_transform_edt

from ..denoise import Denoiser, mean_factor
from ..view.texels import HIDDEN, LIT, Texels


STRAY = 6  # hidden neighbours, of 8, of a texel that is hidden itself, whatever its own few rays found


def without_strays(state: np.ndarray) -> np.ndarray:
    """`state` (H, W) uint8 of texels without single lit ones amid hidden ones."""
    around = convolve((state == HIDDEN).astype(np.int32), np.ones((3, 3), np.int32), mode="constant")
    return np.where((state == LIT) & (around >= STRAY), np.uint8(HIDDEN), state)


def nearest_known(known: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Distance (H, W) of each texel to the nearest one that is `known` (H, W) bool, in texels, and that one's row and column."""
    distance, (row, column) = distance_transform_edt(~known, return_indices=True)
    return distance, (row, column)


def extended(image: np.ndarray, state: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """`image` (H, W, C) with all hidden texels and those within `margin` texels of a lit one filled, the rest zero.

    Returns the image and where it holds light, (H, W) bool.
    """
    lit = state == LIT
    if not lit.any():
        return np.zeros_like(image), lit
    distance, nearest = nearest_known(lit)
    filled = (distance <= margin) | (state == HIDDEN)
    return np.where(filled[..., None], image[nearest], np.float32(0)), filled


def denoised(irradiance: np.ndarray, texels: Texels, denoiser: Denoiser, threads: int) -> np.ndarray:
    """`irradiance` (H, W, 3) without noise where texels are lit, its mean kept.

    Charts are grown until they meet before the denoiser sees them: a black gutter would darken their edges.  Normals tell it
    where one chart ends and another begins.
    """
    lit = texels.state == LIT
    if not lit.any() or not irradiance[lit].any():
        return irradiance
    _, nearest = nearest_known(lit)
    grey = np.full_like(irradiance, 0.5)
    clean = denoiser.denoise(irradiance[nearest], grey, texels.normal[nearest], position=texels.position[nearest], threads=threads)
    return np.where(lit[..., None], clean * mean_factor(irradiance[lit][None], clean[lit][None]), np.float32(0))
