"""Sharp shadows that a denoiser takes for noise, and gets back: leaves, blinds, railings in the light of suns and small lamps."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from .denoise import ROWS
from .jit import kernel
from .threads import run_chunks

# Of rays to a small lamp, lit or not by chance, the fewest whose own difference tells their variance; that of fewer, by Jeffreys' prior; the pixels along a side in which
# it is compared, or in which some must be lit where none are; and what number of rays is as good as any.
TELLING, FEW_RAYS, COMPARED, FARTHER, MOST_RAYS = np.float32(2.0), np.float32(3 / 16), 5, 9, np.float32(4096.0)
PENUMBRA = 0.05  # least difference between the lit parts of neighbouring pixels that makes a penumbra
LEAST_LIT = np.float32(1e-5)  # of the rays there: less is what sums along rows leave


class SharpLight(NamedTuple):
    """Light of lamps with sharp shadows in an image, (H, W, 3) float32 each.

    lit: with its noise.  unshadowed: what it would be with nothing in its way.  doubt: that by the number of rays that have told, of several points each by its share.
    """

    lit: np.ndarray
    unshadowed: np.ndarray
    doubt: np.ndarray


def doubt_of(unshadowed: np.ndarray, whole: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """What N points add to `SharpLight.doubt` of their pixels, (N, 3): unshadowed light of theirs, that of the whole pixel, (N, 3) each, and their rays (N,)."""
    return unshadowed * np.divide(unshadowed, whole, out=np.zeros_like(unshadowed), where=whole > 0) / np.maximum(rays, 1)[:, None]


def in_penumbras(lit: np.ndarray, clear: np.ndarray, pixel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Which pixels (H * W,) lie where the lit part of the light changes; lit, clear: light with and without shadows, of points (N,) in those pixels."""
    count = math.prod(shape)
    whole = np.bincount(pixel, clear, count)
    part = np.divide(np.bincount(pixel, lit, count), whole, out=np.full(count, np.nan), where=whole > 0).reshape(shape)
    dark = np.isnan(part)
    most = maximum_filter(np.where(dark, -np.inf, part), 3, mode="nearest")
    least = minimum_filter(np.where(dark, np.inf, part), 3, mode="nearest")
    return (most - least > PENUMBRA).ravel()


def give_shadows_back(clean: np.ndarray, light: SharpLight, threads: int) -> None:
    """Add to `clean` (H, W, 3), the denoised `light`, what it lacks of that, as far as it is more than the noise of the pixels around.

    Shadows of leaves, which a denoiser takes for noise, differ from what it makes of them by more than their rays' noise, wide penumbras by less.
    """
    planes = np.empty((5, *clean.shape[:2]), np.float32)
    run_chunks(
        lambda begin, end: _tell_noise(light.lit, clean, light.unshadowed, light.doubt, begin, end, *planes), len(clean), ROWS, threads
    )
    noise, supposed, lacking, lit, rays = (uniform_filter(plane, COMPARED, mode="nearest") for plane in planes)
    # Where few rays in a hundred find light, as through blinds, none of those around may have found any, which tell of no noise then; but some do farther off.
    np.maximum(noise, supposed, out=noise, where=uniform_filter(planes[3], FARTHER, mode="nearest") > LEAST_LIT)
    # Rays are in strata, few of which the bounds of shadows cross: noise falls with the root of their number as well, of those that tell what few do.
    noise /= np.sqrt(np.maximum(rays * np.minimum(lit, 1 - lit), 1))
    kept = np.zeros_like(noise)
    np.divide(lacking - noise, lacking, out=kept, where=lacking > noise)
    dots = np.zeros((len(clean), 3))
    run_chunks(lambda begin, end: _add_lacking(light.lit, light.unshadowed, kept, begin, end, clean, dots), len(clean), ROWS, threads)
    sums = clean.sum(axis=(0, 1), dtype=np.float64)
    clean *= 1 + np.divide(dots.sum(axis=0), sums, out=np.zeros(3), where=sums > 0).astype(np.float32)


@kernel
def _tell_noise(sharp, clean, unshadowed, doubt, begin, end, noise, supposed, lacking, lit, rays):
    """Rows of (H, W): the variance of `sharp` as a part of `unshadowed`, that if `clean` is right, and the square of what `clean` lacks of it, each of all channels together; the lit part of
    the rays, and their number.

    Lit or not is all that rays to a small lamp tell, so that the variance is that of a binomial distribution, told without bias by the rays themselves.
    """
    for y in range(begin, end):
        for x in range(sharp.shape[1]):
            noise[y, x] = supposed[y, x] = lacking[y, x] = lit[y, x] = rays[y, x] = np.float32(0.0)
            for c in range(3):
                whole = unshadowed[y, x, c]
                part = sharp[y, x, c] / whole
                if not (whole > 0 and part >= 0):  # nor where that is no number, which would be all around it
                    continue
                part, n = min(part, np.float32(1.0)), min(whole / doubt[y, x, c], MOST_RAYS)
                noise[y, x] += part * (np.float32(1.0) - part) / (n - np.float32(1.0)) if n >= TELLING else FEW_RAYS
                told = clean[y, x, c] / whole
                if told >= 0:
                    told = min(told, np.float32(1.0))
                    supposed[y, x] += told * (np.float32(1.0) - told) / n
                lack = abs(sharp[y, x, c] - clean[y, x, c]) / whole
                if lack > 0:  # beside light that the denoiser has smeared, no more than all
                    lacking[y, x] += min(lack, np.float32(1.0)) ** 2
                lit[y, x], rays[y, x] = part, n


@kernel
def _add_lacking(sharp, unshadowed, kept, begin, end, clean, dots):
    """Adds to rows of `clean` the part `kept` (H, W) of what they lack of `sharp`, but makes no pixel more lit than the most lit of those beside it: few rays find the sun
    through blinds, and where two of a pixel's do by chance there would be a dot.  What those would have is added to rows of `dots` (H, 3), for all."""
    height, width = kept.shape
    for y in range(begin, end):
        for x in range(width):
            if not kept[y, x] > 0:
                continue
            for c in range(3):
                most, alone = np.float32(0.0), True
                for v in range(max(y - 1, 0), min(y + 2, height)):
                    for u in range(max(x - 1, 0), min(x + 2, width)):
                        if (v != y or u != x) and unshadowed[v, u, c] > 0:
                            alone = False
                            if sharp[v, u, c] > most * unshadowed[v, u, c]:
                                most = sharp[v, u, c] / unshadowed[v, u, c]
                lack = sharp[y, x, c] - clean[y, x, c]
                if not abs(lack) < np.inf:  # nor where that is no number
                    continue
                if not alone:
                    bounded = min(lack, max(most * unshadowed[y, x, c] - clean[y, x, c], np.float32(0.0)))
                    dots[y, c] += kept[y, x] * (lack - bounded)
                    lack = bounded
                clean[y, x, c] += kept[y, x] * lack
