"""Pictures of what a method found, point by point."""

from __future__ import annotations

import numpy as np


def largest_of_pixels(values: np.ndarray, pixel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(H, W, C) of values (N, C): of a pixel's points the largest counts, so that single marked points are not lost."""
    out = np.zeros((shape[0] * shape[1], values.shape[1]), np.float32)
    np.maximum.at(out, pixel, values)
    return out.reshape(*shape, -1)
