"""Light groups of a denoised picture: each gets its share of the light, so that they add up to the picture.

A denoiser run on every group would cost more than the light does.  Here it sees the brightness of three groups at once, as the
channels of one picture, without their colours, which vary little from pixel to pixel: a group's colour is the mean of a window.
What a group has of the sum of all groups is its share of the denoised whole, but for a factor a channel that keeps its energy: a faint
group beside a bright one would gain some per cent otherwise.
"""

from __future__ import annotations

import numpy as np
import scipy

from .denoise import Denoiser

WINDOW = 15  # pixels along the square whose mean is a group's colour
DARKEST = np.float32(0.02)  # albedo that light is divided by, at least
ROUNDS = 2  # of proportional fitting to the groups' energy
FAINT = 1e-3  # of a group's mean light: what is darker has the colour of the whole group
_TINY = np.float32(1e-30)


def shares_of(
    parts: np.ndarray,
    clean: np.ndarray,
    albedo: np.ndarray,
    normal: np.ndarray,
    position: np.ndarray,
    denoiser: Denoiser,
    threads: int = 0,
) -> np.ndarray:
    """What each part has of clean light: (G, H, W, 3) float32 that add up to it.

    parts: (G, H, W, 3) noisy radiance that adds up to what `clean` (H, W, 3) was before it was denoised.
    albedo, normal, position: (H, W, 3), for the denoiser, as in `Denoiser.denoise`.
    """
    share = np.zeros_like(parts)
    lit = [k for k, part in enumerate(parts) if part.any()]
    if not lit or not clean.any():
        share[-1] = clean
        return share
    light = parts[lit] / np.maximum(albedo, DARKEST)
    bright = light.mean(axis=3)
    size = bright.mean(axis=(1, 2))[:, None, None]
    bright = bright / size  # alike in size, as the channels of a picture are
    for first in range(0, len(lit), 3):
        bright[first : first + 3] = _three_denoised(bright[first : first + 3], albedo, normal, position, denoiser, threads)
    share[lit] = (size * bright)[..., None] * _colors(light)
    energy = parts.mean(axis=(1, 2), dtype=np.float64)
    energy *= clean.mean(axis=(0, 1)) / np.maximum(energy.sum(axis=0), _TINY)
    for _ in range(ROUNDS):
        share = _adding_up(share, lit[0]) * clean
        found = share.mean(axis=(1, 2), dtype=np.float64)
        factor = np.divide(energy, found, out=np.ones_like(energy), where=found > 0)
        share *= factor[:, None, None].astype(np.float32)
    return _adding_up(share, lit[0]) * clean


def _adding_up(share: np.ndarray, rest: int) -> np.ndarray:
    """Shares (G, H, W, 3) that add up to 1; rest: who has all where nobody has any, for the denoiser of the whole may put light there."""
    total = share.sum(axis=0)
    share = np.divide(share, total, out=np.zeros_like(share), where=total > 0)
    share[rest] += total <= 0
    return share


def _three_denoised(bright: np.ndarray, albedo, normal, position, denoiser: Denoiser, threads: int) -> np.ndarray:
    """Up to three brightnesses (K, H, W) without noise."""
    image = np.zeros((*bright.shape[1:], 3), np.float32)
    image[..., : len(bright)] = np.moveaxis(bright, 0, 2)
    image = denoiser.denoise(image, albedo, normal, position=position, preserve_mean=True, threads=threads)
    return np.moveaxis(image, 2, 0)[: len(bright)]


def _colors(light: np.ndarray) -> np.ndarray:
    """Colours (G, H, W, 3) of light, their channels' mean 1."""
    mean = light.mean(axis=(1, 2), keepdims=True)
    near = scipy.ndimage.uniform_filter(light, (0, WINDOW, WINDOW, 0), mode="nearest") + np.float32(FAINT) * mean
    return near / np.maximum(near.mean(axis=3, keepdims=True), _TINY)
