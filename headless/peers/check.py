"""Whether a peer shows the same scene: its direct light beside ours."""

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
    """mean: of the peer's direct light, over ours.  worst: largest relative difference of a block.  allowed: what noise and tolerance allow."""

    mean: float
    worst: float
    allowed: float

    @property
    def holds(self) -> bool:
        """Whether both show the same light."""
        return abs(self.mean - 1) <= TOLERANCE and self.worst <= self.allowed


def same_light(ours: np.ndarray, peer: tuple[np.ndarray, np.ndarray], shown: np.ndarray) -> Check:
    """Compare direct light, ours (H, W, 3) and two independent pictures of the peer, in the pixels `shown` (H, W) bool."""
    mean = 0.5 * (peer[0] + peer[1])
    light, theirs, noise = (_blocks(picture, shown) for picture in (ours, mean, 0.5 * (peer[0] - peer[1])))
    scale = light + _FLOOR * light.mean()
    allowed = BLOCK_TOLERANCE + _NOISE * float(np.sqrt(np.mean((noise / scale) ** 2)))
    return Check(float(mean[shown].mean() / ours[shown].mean()), float(np.abs((theirs - light) / scale).max()), allowed)


def _blocks(picture: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """(rows, columns) means of square blocks, over their shown pixels; what remains at the right and the bottom belongs to the last."""
    height, width = shown.shape
    side = max(1, width // BLOCKS)
    rows, columns = (np.minimum(np.arange(n) // side, max(0, n // side - 1)) for n in (height, width))
    block = rows[:, None] * (columns[-1] + 1) + columns
    count = np.bincount(block[shown], minlength=block.max() + 1)
    total = np.bincount(block[shown], picture.mean(2)[shown], minlength=block.max() + 1)
    return total[count > 0] / count[count > 0]
