"""Perlin noise: what it costs, and where it repeats."""

import time

import numpy as np

from lumigate.core.jit import kernel
from lumigate.core.surfaces import noise

F = np.float32


@kernel
def _sum(dimensions, count, values):
    """Noise at `count` places, whose sum goes to values[0]."""
    total = F(0)
    for i in range(count):
        x = F(i) * F(0.137)
        total += noise.perlin(dimensions, x, F(i) * F(0.071), x * F(0.31), F(0.5))
    values[0] = total


def _seconds(dimensions, count=100_000):
    """CPU time of the quickest of several runs."""
    values = np.zeros(1, F)
    _sum(dimensions, 10, values)
    runs = []
    for _ in range(7):
        begin = time.process_time()
        _sum(dimensions, count, values)
        runs.append(time.process_time() - begin)
    return min(runs)


def test_three_dimensions_cost_less_than_four():
    """They have half of the corners.  Most materials of stone, plaster or wood are made of them; by branches and calls they took a third longer."""
    assert _seconds(3) < 0.9 * _seconds(4)


@kernel
def _at(dimensions, places, values):
    for i in range(len(places)):
        values[i] = noise.perlin(dimensions, places[i, 0], places[i, 1], places[i, 2], places[i, 3])


def test_noise_repeats_far_away():
    """Every 100,000, as Cycles has it, beyond a million half a cell aside."""
    rng = np.random.default_rng(1)
    near = (rng.integers(0, 64, (500, 4)) / 4).astype(F)  # exact in float32 far away
    for dimensions in (1, 2, 3, 4):
        values = np.zeros((3, len(near)), F)
        _at(dimensions, near, values[0])
        _at(dimensions, near + F(100_000), values[1])
        np.testing.assert_allclose(values[1], values[0], atol=1e-5)
        _at(dimensions, near + F(0.5), values[1])
        _at(dimensions, near + F(1_000_000), values[2])
        np.testing.assert_allclose(values[2], values[1], atol=1e-5)
