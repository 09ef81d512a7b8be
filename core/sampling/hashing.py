"""Random numbers without state: a hash of (seed, pixel, sample, dimension).

The same arguments give the same number on every thread and in every order, which is what keeps renders
reproducible for any number of threads.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel

_TO_UNIT = np.float32(2.0**-24)


@inlined
def hash_u32(x):
    """A well-mixed permutation of the 32-bit integers (Jarzynski & Olano 2020, `pcg`)."""
    state = np.uint32(np.uint32(x) * np.uint32(747796405) + np.uint32(2891336453))
    word = np.uint32(((state >> np.uint32((state >> np.uint32(28)) + np.uint32(4))) ^ state) * np.uint32(277803737))
    return np.uint32((word >> np.uint32(22)) ^ word)


@inlined
def hash_combine(seed, value):
    """Hash of a seed and one more integer; chain it for more of them."""
    return hash_u32(np.uint32(hash_u32(seed) + np.uint32(value)))


@inlined
def hash_key(seed, pixel, sample, dimension):
    """Hash of four counters, 32 bits."""
    return hash_combine(hash_combine(hash_combine(seed, pixel), sample), dimension)


@inlined
def to_unit(bits):
    """The upper 24 of 32 random bits as float32 in [0, 1): 1 is never reached."""
    return np.float32(np.uint32(bits) >> np.uint32(8)) * _TO_UNIT


@inlined
def uniform(seed, pixel, sample, dimension):
    """A uniform float32 in [0, 1) for four counters."""
    return to_unit(hash_key(seed, pixel, sample, dimension))


@inlined
def rotate_unit(u, shift):
    """Cranley-Patterson rotation: (u + shift) mod 1, for both in [0, 1)."""
    s = np.float32(u + shift)
    s = s - np.float32(1.0) if s >= np.float32(1.0) else s
    return s


@kernel
def uniform_points(seed, pixels, sample, dimensions):
    """Uniform numbers for many pixels.

    Args:
        seed, sample: integers.  pixels: (N,) integers.  dimensions: how many numbers a pixel.

    Returns:
        (N, dimensions) float32 in [0, 1).
    """
    out = np.empty((pixels.shape[0], dimensions), np.float32)
    for i in range(pixels.shape[0]):
        for d in range(dimensions):
            out[i, d] = uniform(seed, pixels[i], sample, d)
    return out
