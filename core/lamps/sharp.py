"""Lamps whose shadows are sharp: their direct light has next to no noise, but edges that a denoiser takes away with the noise of others'."""

from __future__ import annotations

import numpy as np

from ..scene import POINT, SPOT, SUN
from .tables import ONE_MINUS_COS, RADIUS, Emitters

WIDEST_SUN = np.radians(2.0)  # angular diameter
LARGEST = 0.01  # radius of a point or spot lamp, as a part of the diagonal of the scene


def small_lamps(kind: np.ndarray, lamps: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(A,) bool: which analytic lamps are small; kind (A,), lamps (A, LAMP) and box as in `Emitters`."""
    size = float(np.linalg.norm(box[1] - box[0]))
    return ((kind == SUN) & (lamps[:, ONE_MINUS_COS] <= 1 - np.cos(WIDEST_SUN / 2))) | (
        np.isin(kind, (POINT, SPOT)) & (lamps[:, RADIUS] <= LARGEST * size)
    )


def sharp_emitters(emitters: Emitters, samples: int) -> np.ndarray | None:
    """Which emitters (E,) have sharp shadows, and a ray from every point of `samples`; None for none of them."""
    small = np.zeros(len(emitters.kind), bool)
    small[: len(emitters.lamps)] = small_lamps(emitters.kind[: len(emitters.lamps)], emitters.lamps, emitters.box)
    alone = np.zeros(len(emitters.kind), bool)
    alone[emitters.groups[emitters.groups >= 0]] = len(emitters.groups) <= samples
    sharp = small & alone
    return sharp if sharp.any() else None
