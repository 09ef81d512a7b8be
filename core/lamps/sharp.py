"""Lamps whose shadows are sharp: their direct light has next to no noise, but edges that a denoiser takes away with the noise of others'."""

from __future__ import annotations

import numpy as np

from ..scene import POINT, SPOT, SUN
from .tables import ONE_MINUS_COS, RADIUS, Emitters

WIDEST_SUN = np.radians(2.0)  # angular diameter
LARGEST = 0.01  # radius of a point or spot lamp, as a part of the diagonal of the scene


def sharp_emitters(emitters: Emitters, samples: int) -> np.ndarray | None:
    """Which emitters (E,) have sharp shadows, and a ray from every point of `samples`; None for none of them."""
    kind, lamps = emitters.kind, emitters.lamps
    size = float(np.linalg.norm(emitters.box[1] - emitters.box[0]))
    small = np.zeros(len(kind), bool)
    analytic = kind[: len(lamps)]
    small[: len(lamps)] = ((analytic == SUN) & (lamps[:, ONE_MINUS_COS] <= 1 - np.cos(WIDEST_SUN / 2))) | (
        np.isin(analytic, (POINT, SPOT)) & (lamps[:, RADIUS] <= LARGEST * size)
    )
    alone = np.zeros(len(kind), bool)
    alone[emitters.groups[emitters.groups >= 0]] = len(emitters.groups) <= samples
    sharp = small & alone
    return sharp if sharp.any() else None
