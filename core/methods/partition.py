"""Which part of the cached light virtual lights carry to a point, and what is left to gather rays."""

from __future__ import annotations

import numpy as np

from ..jit import kernel

# What half of the paths tells of a cell beyond so many times what the other half knows of it, and beyond the view's mean light, is
# a rare path: it is spread over the cells of the next coarser one.  In one cell it would be a spark.
RARE = np.float32(2.0)
_1 = np.float32(1.0)


def divided(
    halves: np.ndarray, shine: np.ndarray, first: np.ndarray, counts: np.ndarray, bright: np.ndarray, number: np.ndarray, tau: np.float32,
    parent: np.ndarray, later: np.float32,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """`sent` (C, 3 G), `lit` (C, 3 G) and `share` (C,) of a light cache.

    halves: (2, C, 3 G) W/m^2, the light that gather rays look up, as half of the paths tells it.  shine: (2, C, 3 G), the part of that
    which virtual lights carry in any case.  counts: (2, C), how much of each cell either half knows, 1 in all.  bright: (2, C), how
    bright each cell is as the *other* half tells it.  number: (C,), the weight of each cell's probes.  parent: (C,), the next coarser
    cell, -1 for none.
    """
    sent, lit, share = np.zeros_like(halves[0]), np.zeros_like(halves[0]), np.zeros(len(parent), np.float32)
    rare = np.zeros_like(halves)
    for h in range(2):
        part = bright[h] / (bright[h] + tau)
        own = _mean(halves[h])
        bound = RARE * bright[h] + tau
        beyond = np.where((own > bound) & (parent >= 0), _1 - bound / np.maximum(own, bound), np.float32(0))[:, None]
        light = counts[h][:, None] * halves[h]
        known = counts[h][:, None] * first[h]
        lights = part[:, None] * (known + later * (light - known)) + (counts[h] * (_1 - part))[:, None] * shine[h]
        share += counts[h] * part
        sent += (_1 - beyond) * light
        lit += (_1 - beyond) * lights
        rare[0] += beyond * light
        rare[1] += beyond * lights
    sent += _spread(rare[0], number, parent)
    lit += _spread(rare[1], number, parent)
    return sent, lit, share


def _mean(light: np.ndarray) -> np.ndarray:
    """Of the channels (C,), sum of all light groups (C, 3 G)."""
    return np.float32(1 / 3) * np.einsum("ck->c", light)


def _spread(light: np.ndarray, number: np.ndarray, parent: np.ndarray) -> np.ndarray:
    """The mean of the light (C, K), weighed by `number` (C,), over the cells that have the same parent."""
    if not light.any():
        return light
    sums, weights = np.zeros_like(light), np.zeros_like(number)
    _add_up(light, number, parent, sums, weights)
    means = sums / np.maximum(weights, np.float32(1e-20))[:, None]
    return np.where((parent >= 0)[:, None], means[parent], light)


@kernel
def _add_up(light, number, parent, sums, weights):
    for i in range(len(parent)):
        up = parent[i]
        if up >= 0:
            weights[up] += number[i]
            for k in range(light.shape[1]):
                sums[up, k] += number[i] * light[i, k]
