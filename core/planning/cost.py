"""Seconds of a pass, as they follow from what was seen of this scene and, before that, of this machine."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from .machine import Machine

# What a pass of quality 1 costs on scenes of middling difficulty, in rays of `Machine.ray`: the first of a process, which loads its
# kernels, the beginning of any, and each pixel.
LOADING_RAYS, BEGIN_RAYS, PIXEL_RAYS = 450_000.0, 1_500_000.0, 75.0
# More triangles make rays longer, and stand for richer materials and more edges: by how many times a pass takes as long for each time they double,
# and as long without (ten scenes of 32 to 560,000 triangles, smallest pass: within a fifth in nine of them).
A_DOUBLING, NO_TRIANGLES, LEAST_FACTOR = 0.09, -0.08, 0.25
# What each pixel costs however few its rays, as a quality: view, lobes, probes (480x270: .41 living room, .28 atrium, .56 Sponza).
BASE = 0.42
# How much the proportions of the first guesses count beside one pass that was seen, and how much the guesses themselves.
TRUST, FAITH = 0.002, 1e-6
# How much pilots alone count beside the guesses: in few pixels a pass takes longer than they foresee, in many it need not.
PILOT_FAITH = 3e-6
MIDDLING = 4096  # triangles, of a scene that takes as long as that
LEAST_PART = 0.02  # of a first guess: nothing is free


@dataclass
class PassCost:
    """seconds(pixels, quality) = begin + each * pixels * (BASE + quality), fitted to the passes seen so far.

    guess: (3,) seconds of loading the kernels (0 where they are loaded), of a pass's beginning, and of one pixel of quality 1.
    """

    guess: np.ndarray
    fitted: np.ndarray = field(init=False)
    seen: list[tuple[float, float]] = field(default_factory=list)  # (pixels * (BASE + quality), seconds)

    def __post_init__(self) -> None:
        self.fitted = self.guess.copy()

    @classmethod
    def of(cls, machine: Machine, cold: bool, triangles: int = MIDDLING) -> PassCost:
        """A first guess, from the machine and the scene's size alone; cold: whether this process has still to load the kernels."""
        factor = max(LEAST_FACTOR, NO_TRIANGLES + A_DOUBLING * math.log2(max(triangles, 1)))
        parts = cold * LOADING_RAYS, factor * BEGIN_RAYS / machine.threads, factor * PIXEL_RAYS / machine.threads
        return cls(np.array(parts) * machine.ray)

    def observe(self, pixels: int, quality: float, seconds: float, *, pilot: bool = False) -> None:
        """Note a pass, and fit again: least squares of relative errors, in units of the guesses."""
        self.seen.append((pixels * (BASE + quality), seconds))
        loading, begin, each = self.guess
        own = PILOT_FAITH**0.5 if pilot else 1.0
        rows = [own * np.array([loading if k == 0 else 0.0, begin, each * work]) / taken for k, (work, taken) in enumerate(self.seen)]
        # Loading is the machine's alone; a slow scene is slow in both of the others, whose proportion is held to.
        rows += [TRUST**0.5 * np.array(row) for row in ((1.0, 0.0, 0.0), (0.0, 1.0, -1.0))]
        rows += [FAITH**0.5 * row for row in np.eye(3)]
        wanted = [own] * len(self.seen) + [TRUST**0.5, 0.0] + [FAITH**0.5] * 3
        self.fitted = np.maximum(np.linalg.lstsq(np.array(rows), np.array(wanted), rcond=None)[0], LEAST_PART) * self.guess

    def seconds(self, pixels: int, quality: float) -> float:
        """Predicted seconds of the next pass."""
        return self._begin + self.each * pixels * (BASE + quality)

    def quality(self, pixels: int, seconds: float) -> float:
        """The quality whose pass takes so long; negative where not even the beginning fits."""
        return (seconds - self._begin) / (self.each * pixels) - BASE

    @property
    def each(self) -> float:
        """Predicted seconds of a pixel of quality 1, its base apart."""
        return self.fitted[2]

    @property
    def _begin(self) -> float:
        return self.fitted[1] + (0.0 if self.seen else self.fitted[0])
