"""Perlin noise: where it repeats, and that its loop over the corners of a cell is what it stands for."""

import numpy as np

from lumigate.core.jit import kernel
from lumigate.core.surfaces import noise

F = np.float32


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


@kernel
def _corner(h, x, y, z, values):
    values[0] = noise._gradient3(np.uint32(h), F(x), F(y), F(z))


def test_three_dimensions_mix_the_gradients_of_eight_corners():
    """Branches in `_gradient3` would keep the loop from being vectorized; its directions are the twelve edges' of a cube, four of them twice."""
    place, value = np.float32([0.25, -0.5, 0.75]), np.zeros(1, F)
    found = []
    for h in range(16):
        _corner(h, *place, value)
        found.append(float(value[0]))
    x, y, z = (float(c) for c in place)
    expected = [x + y, y - x, x - y, -x - y, x + z, z - x, x - z, -x - z, y + z, z - y, y - z, -y - z, y + x, z - y, y - x, -y - z]
    np.testing.assert_allclose(found, expected)
