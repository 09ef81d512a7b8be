"""Sparks: points to which one path of rare light gives many times what anything around them has.

A gather ray that ends where a lobe shows it the sun finds thousands of times the light of its neighbours, once in a million rays.  No denoiser takes that
for noise.  What is too much is taken from the point and given to all around it, and to the whole picture where there it would be much, too: the mean
of each channel stays what it is (after DeCoro, Weyrich & Rusinkiewicz 2010, Density-based Outlier Rejection in Monte Carlo Rendering, who drop it).
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter

from ..view.points import ShadingPoints

# Times what is foreseen of a point and what its neighbours have.  A denoiser knows what to do with less, and where it belongs: at 8, cathedral and
# gallery had 1 to 3 % more error.  A spark keeps so many times that.
BRIGHT, KEPT = np.float32(24.0), np.float32(4.0)
# The same of light by photons, whose disks are wide: a point that alone has so much of it is a crumb, a leaf's or a rim's, on which all of a photon's light falls.
BRIGHT_BY_PHOTONS = np.float32(8.0)
MOST_RAISED = np.float32(2.0)  # times what lobes reflect of it may become elsewhere
TOGETHER = 3  # pixels of a neighbourhood, at most, that are sparks
AROUND = 5  # pixels along a side of a neighbourhood
AREA = 64  # pixels along a side of what takes the excess
MUCH = 0.05  # of an area's light, that it takes at most


def spread_sparks(
    points: ShadingPoints,
    light: np.ndarray,
    foreseen: np.ndarray,
    shape: tuple[int, int],
    bright: np.float32 = BRIGHT,
    together: int = TOGETHER,
) -> np.ndarray:
    """The irradiance `light` (N, 3 G) W/m^2 of a picture's points without sparks: itself where there are none.

    foreseen: (N,) W/m^2, as `methods.foreseen` has it.  shape: height and width of the picture.  bright: what is a spark, see `BRIGHT`.  together: see `TOGETHER`.
    """
    whole = light.sum(axis=1) / np.float32(3)  # of all light groups, as what is foreseen
    suspects = np.flatnonzero((whole > bright * foreseen) & np.isfinite(whole))
    if not len(suspects):
        return light
    height, width = shape
    pixels, own, quiet = height * width, points.pixel[suspects], np.ones(len(whole), np.bool_)
    quiet[suspects] = False

    def within_reach(image: np.ndarray) -> np.ndarray:
        """Sums of the pixels around each suspect, its own included."""
        return AROUND**2 * uniform_filter(image.reshape(shape).astype(np.float64), AROUND, mode="constant").ravel()[own]

    def around(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The light of points around each suspect, each pixel as one, and the number of these; and of points (P,) in each pixel."""
        number = np.bincount(points.pixel[rows], minlength=pixels)
        mean = np.bincount(points.pixel[rows], whole[rows], pixels) / np.maximum(number, 1)
        return within_reach(mean), within_reach(number > 0), number

    light_around, known, number = around(slice(None))
    others = (light_around - whole[suspects] / number[own]) / np.maximum(known - 1 / number[own], 1)
    # A few sparks side by side, as one light throws them, do not vouch for each other; many are a bright thing.
    shows = np.zeros(pixels)
    shows[own] = 1
    light_around, known, _ = around(np.flatnonzero(quiet))
    few = (within_reach(shows) < together + 0.5) & (known > 0.5)
    others[few] = light_around[few] / known[few]
    usual = np.maximum(foreseen[suspects], others)
    far_above = whole[suspects] > bright * usual
    if not far_above.any():
        return light
    sparks = suspects[far_above]
    kept = (KEPT * usual[far_above] / whole[sparks])[:, None]
    area = points.pixel // width // AREA * -(-width // AREA) + points.pixel % width // AREA
    spread = light.copy()
    spread[sparks] *= kept
    # Channel by channel, in proportion to what is foreseen of each point.
    for c in range(light.shape[1]):
        albedo = points.albedo[:, c % 3]
        sums = np.bincount(area, albedo * foreseen)
        total = sums.sum()
        if not total > 0:  # nobody can take it
            spread[:, c] = light[:, c]
            continue
        excess = np.bincount(area[sparks], albedo[sparks] * (light[sparks, c] - spread[sparks, c]), len(sums))
        nearby = np.minimum(excess, MUCH * np.bincount(area, albedo * spread[:, c], len(sums)))
        rest = (excess - nearby).sum() / total
        raised = np.divide(nearby, sums, out=np.zeros_like(sums), where=sums > 0) + rest
        spread[:, c] += raised.astype(np.float32)[area] * foreseen
    return spread


def spread_thrown(
    points: ShadingPoints, thrown: np.ndarray, shown: np.ndarray, foreseen: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """The same for the irradiance `thrown` (N, 3 G) W/m^2 by photons, and what lobes reflect of that, `shown` (N, 3 G) W/m^2/sr, or no rows.

    Lobes reflect the less of the photons that a point keeps less of, and elsewhere so much the more.
    """
    spread = spread_sparks(points, thrown, foreseen, shape, BRIGHT_BY_PHOTONS, 0)
    if spread is thrown or not len(shown):
        return spread, shown
    before = thrown.sum(axis=1)
    part = np.divide(spread.sum(axis=1), before, out=np.ones_like(before), where=before > 0)
    kept = np.minimum(part, np.float32(1))[:, None] * shown
    sums = [light.sum(axis=0, dtype=np.float64) for light in (shown, kept)]
    raised = np.divide(*sums, out=np.ones_like(sums[0]), where=sums[1] > 0)
    return spread, kept * np.minimum(raised, MOST_RAISED).astype(np.float32)
