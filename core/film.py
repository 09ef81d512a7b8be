"""What a pixel takes in: how its samples lie around its middle, and whether the world behind everything is left out.

The filters are those of Cycles (`scene/film.cpp`), and as there samples are drawn by them instead of weighed: each has the same
weight, and the light of a picture is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FILTERS = ("BOX", "GAUSSIAN", "BLACKMAN_HARRIS")
_TABLE = 1025  # values of the inverse distribution, an odd number: the middle is exact
_FINE = 16 * _TABLE


@dataclass(frozen=True)
class Film:
    """A pixel filter, one of `FILTERS`, of `width` pixels as Blender counts them; transparent: the camera sees no world, but an alpha."""

    filter: str = "BOX"
    width: float = 1.0
    transparent: bool = False

    def offsets(self) -> np.ndarray:
        """Where samples lie off the pixel's middle along an axis (K,) float32, at equal steps of probability.

        Empty for the pixel's square, which needs no table.

        Raises:
            ValueError: an unknown filter.
        """
        if self.filter not in FILTERS:
            raise ValueError(f"unknown pixel filter {self.filter!r}; known: {', '.join(FILTERS)}")
        if self == Film(transparent=self.transparent):
            return np.zeros(0, np.float32)
        reach = self.width * {"BOX": 0.5, "GAUSSIAN": 1.5, "BLACKMAN_HARRIS": 1.0}[self.filter]
        v = np.linspace(-1.0, 1.0, _FINE)
        if self.filter == "BOX":
            density = np.ones(_FINE)
        elif self.filter == "GAUSSIAN":
            density = np.exp(-18.0 * v * v)
        else:
            phase = np.pi * (v + 1.0)
            density = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2 * phase) - 0.01168 * np.cos(3 * phase)
        below = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
        return (reach * np.interp(np.linspace(0.0, 1.0, _TABLE), below / below[-1], v)).astype(np.float32)


SQUARE = Film()  # the pixel's own
