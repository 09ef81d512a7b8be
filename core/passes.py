"""How many passes a picture takes: until a time is used up, or until its own error estimate is small enough.

The error is estimated from pictures that are independent of each other.  With A denoised and B and C as they are,

    relMSE(A) = mean over pixels of (A - B) (A - C) / (reference^2 + 0.01 mean(reference)^2),

in expectation, whatever the denoiser blurs away: the noise of B and C cancels, what is wrong with A stays.  The
mean of all passes is better than A, which has a third of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .denoise import Denoiser
from .metrics import FLOOR
from .picture import Picture

GROUPS = 3
# Quality of a pass: 1 is that of a picture without budget; its samples and its time go with it.
LEAST, MOST = 0.25, 8.0
LARGE_PICTURE = 500_000  # pixels above which passes are not made larger than 1, for their memory
MOST_PASSES = 256
PASS, DENOISING = 4e-5, 4e-6  # seconds a pixel (and a thread) of a pass of quality 1 and of denoising, as a first guess
BEGIN = 0.35  # of a time budget, for the pass that tells how long others take
# A pass of twice the quality is worth more than two: its cache of light and its pool of VPLs are larger.
WORTH = 1.5
# Error of a picture by its worth: a denoised one's falls more slowly than noise does.
SLOPE = 0.25


@dataclass
class Passes:
    """The passes of one picture, dealt to three groups.

    time_budget: seconds, target_error: relMSE; without either there is one pass of quality 1.  pixels: of the picture.
    """

    time_budget: float | None
    target_error: float | None
    pixels: int
    threads: int
    groups: list[Picture | None] = field(default_factory=lambda: [None] * GROUPS)
    count: int = 0
    estimate: float | None = None

    def first(self) -> float:
        """Quality of the first pass."""
        if self.time_budget is not None:
            return min(1.0, max(LEAST, BEGIN * self.time_budget * self.threads / (PASS * self.pixels)))
        return 1.0 if self.target_error is None else 0.5

    def add(self, picture: Picture) -> None:
        """Deal one more pass to the next group."""
        k = self.count % GROUPS
        self.groups[k] = picture if self.groups[k] is None else self.groups[k].blend(picture)
        self.count += 1

    @property
    def picture(self) -> Picture:
        """The mean of all passes."""
        parts = [group for group in self.groups if group is not None]
        whole = parts[0]
        for part in parts[1:]:
            whole = whole.blend(part)
        return whole

    def next(self, elapsed: float, last: float, quality: float, denoiser: Denoiser | None) -> float | None:
        """Quality of the next pass, None where no more is wanted.

        elapsed: seconds since the render began; last: of the last pass, which had `quality`.
        """
        most = MOST if self.pixels < LARGE_PICTURE else 1.0
        if self.count >= MOST_PASSES:
            return None
        if self.time_budget is not None:
            left = self.time_budget - elapsed - (DENOISING * self.pixels if denoiser else 0.0)
            fits = left / max(last / quality, 1e-9)
            # Equal parts, rather than a last one that is too small to be worth its fixed costs.
            return fits / np.ceil(fits / most) if fits >= LEAST else None
        if self.target_error is None:
            return None
        if self.count % GROUPS:
            return quality
        return None if self.error(denoiser) <= self.target_error else min(most, 2 * quality)

    def error(self, denoiser: Denoiser | None) -> float:
        """Estimated relMSE of the indirect light of `picture`, denoised if there is a denoiser; NaN with less than three passes."""
        if any(group is None for group in self.groups):
            return float("nan")
        clean = [group.denoised(denoiser, self.threads, direct=False) if denoiser else group for group in self.groups]
        reference = sum(picture.indirect.astype(np.float64) for picture in clean) / GROUPS
        scale = reference**2 + FLOOR * reference.mean() ** 2
        errors = []
        for k in range(GROUPS):
            a, b, c = (part.indirect.astype(np.float64) for part in (clean[k], self.groups[k - 1], self.groups[k - 2]))
            share = self.groups[k].weight / self.picture.weight
            errors.append(((a - b) * (a - c) / scale).mean() * share ** (SLOPE if denoiser else 1.0))
        self.estimate = max(0.0, float(np.mean(errors)))
        return self.estimate
