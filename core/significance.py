"""Whether one picture is nearer to a reference than another, beyond what the reference's own noise could feign."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from .errors import SceneError
from .metrics import FLOOR, valid_pixels

TILES = 12  # along the shorter side: errors of denoised pictures hang together over some pixels, hardly over a tile
LEAST_TILES = 8
LEVEL = 0.05


@dataclass(frozen=True)
class Significance:
    """relMSE(other) - relMSE(test), where the reference's noise cancels.

    difference: positive where the test is better.  low, high: its 95 % confidence interval.  p: chance of so large a difference, of either
    sign, between pictures that are equally good.  tiles: blocks of pixels that it was taken from.  reference_noise: standard deviation that the
    reference's noise alone gives the difference; None where there is no second half.
    """

    difference: float
    low: float
    high: float
    p: float
    tiles: int
    reference_noise: float | None

    @property
    def verdict(self) -> str:
        """'test', 'other', or 'neither' is better at the 5 % level."""
        return "neither" if self.p > LEVEL else "test" if self.difference > 0 else "other"


def compare_errors(test: np.ndarray, other: np.ndarray, reference: np.ndarray, half: np.ndarray | None = None) -> Significance:
    """Test the hypothesis that both pictures have the same relMSE.

    With x and y the pictures and r the reference, (y - r)^2 - (x - r)^2 = (y - x) (y + x - 2 r): the square of r's noise is gone, and
    what is left of it has no mean.  Means over tiles are taken as independent of each other (Student's t test of paired samples), so that
    errors that hang together, and the reference's noise, are in their spread.

    Args:
        test, other, reference: (H, W, C) linear values of one size.
        half: of a reference whose first half is `reference`, both independent.  Each half's denominators then go with the other's
            noise, so that the two do not correlate.

    Raises:
        SceneError: the sizes differ, the reference is black, or the pictures are too small to tell.
    """
    pictures = [np.atleast_3d(np.asarray(a, np.float64)) for a in (test, other, reference, *([] if half is None else [half]))]
    if len({picture.shape for picture in pictures}) > 1:
        raise SceneError("the pictures are of different size; render all of them at one size")
    valid = valid_pixels(*pictures)
    tiles = _tiles(valid)
    x, y, *halves = (np.where(valid[..., None], picture, 0.0) for picture in pictures)
    if not any(part.any() for part in halves):
        raise SceneError("the reference is black: errors relative to it are undefined")
    # Where there is one half only, its denominators are its own.
    parts = [_tile_means((y - x) * (y + x - 2 * r), scale, valid, tiles) for r, scale in zip(halves, halves[::-1])]
    means = np.mean(parts, axis=0)
    noise = None if half is None else float(np.std(parts[1] - parts[0], ddof=1) / 2 / len(means) ** 0.5)
    centre, error = means.mean(), means.std(ddof=1) / len(means) ** 0.5
    if error == 0:  # the same picture twice
        return Significance(float(centre), float(centre), float(centre), 1.0 if centre == 0 else 0.0, len(means), noise)
    students = stats.t(len(means) - 1)
    reach = students.ppf(1 - LEVEL / 2) * error
    return Significance(
        float(centre), float(centre - reach), float(centre + reach), float(2 * students.sf(abs(centre) / error)), len(means), noise
    )


def _tiles(valid: np.ndarray) -> np.ndarray:
    """(H, W) number of the tile that each pixel is in, -1 for pixels that are not valid."""
    height, width = valid.shape
    side = max(1, min(height, width) // TILES)
    rows, columns = (np.minimum(np.arange(n) // side, max(1, n // side) - 1) for n in (height, width))
    numbers = np.where(valid, rows[:, None] * (columns[-1] + 1) + columns[None], -1)
    if len(np.unique(numbers[valid])) < LEAST_TILES:
        raise SceneError(f"{int(valid.sum())} pixels are too few to tell two pictures apart; render larger ones")
    return numbers


def _tile_means(squares: np.ndarray, reference: np.ndarray, valid: np.ndarray, tiles: np.ndarray) -> np.ndarray:
    """Means of squares / (r^2 + e) over the tiles that hold valid pixels, weighted so that their mean is that of all pixels."""
    values = squares[valid] / (reference[valid] ** 2 + FLOOR * reference[valid].mean() ** 2)
    count = np.bincount(tiles[valid])
    total = np.bincount(tiles[valid], values.mean(axis=1))
    held = count > 0
    return total[held] * np.count_nonzero(held) / valid.sum()
