"""Whether a renderer shows the same scene: its direct light beside that of the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TOLERANCE = 0.01  # of the mean
BLOCKS = 12  # across the picture
BLOCK_TOLERANCE = 0.05
_NOISE = 4.0  # times the noise of a block, which must not be taken for a difference
_FLOOR = 0.1  # of the mean, added where a block is dark


@dataclass(frozen=True)
class Check:
    """mean: of a renderer's direct light, over the reference's.  worst: largest relative difference of a block.  allowed: what noise and tolerance allow."""

    mean: float
    worst: float
    allowed: float

    @property
    def holds(self) -> bool:
        """Whether both show the same light."""
        return abs(self.mean - 1) <= TOLERANCE and self.worst <= self.allowed


def same_light(reference: tuple[np.ndarray, np.ndarray], peer: tuple[np.ndarray, np.ndarray], shown: np.ndarray) -> Check:
    """Compare direct light, two independent pictures (H, W, 3) of the reference and of a renderer, in the pixels `shown` (H, W) bool."""
    light, theirs = (_blocks(0.5 * (pair[0] + pair[1]), shown) for pair in (reference, peer))
    scale = light + _FLOOR * light.mean()
    noise = [_blocks(0.5 * (pair[0] - pair[1]), shown) / scale for pair in (reference, peer)]
    allowed = BLOCK_TOLERANCE + _NOISE * float(np.sqrt(np.mean(np.square(noise).sum(0))))
    mean = sum(picture[shown].mean() for picture in peer) / sum(picture[shown].mean() for picture in reference)
    return Check(float(mean), float(np.abs((theirs - light) / scale).max()), allowed)


def _blocks(picture: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """(rows, columns) means of square blocks, over their shown pixels; what remains at the right and the bottom belongs to the last."""
    height, width = shown.shape
    side = max(1, width // BLOCKS)
    rows, columns = (np.minimum(np.arange(n) // side, max(0, n // side - 1)) for n in (height, width))
    block = rows[:, None] * (columns[-1] + 1) + columns
    count = np.bincount(block[shown], minlength=block.max() + 1)
    total = np.bincount(block[shown], picture.mean(2)[shown], minlength=block.max() + 1)
    return total[count > 0] / count[count > 0]
