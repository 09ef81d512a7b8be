"""Low-discrepancy sequences: Owen-scrambled Sobol and Halton points, and the R2 lattice.

Sobol' direction numbers: Joe & Kuo 2008, "Constructing Sobol sequences with better two-dimensional
projections" (new-joe-kuo-6).  Owen scrambling by hash: Burley 2020, "Practical Hash-based Owen Scrambling",
with Vegdahl's constants for the Laine-Karras permutation.  Scrambled Halton: Owen's scrambling of radical
inverses as in Pharr, Jakob & Humphreys, PBRT 4th ed., section 8.6.3.  R2: Roberts 2018.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from .hashing import hash_combine, hash_u32, to_unit

SOBOL_DIMENSIONS = 16
HALTON_DIMENSIONS = 16

# Degree, inner coefficients of the primitive polynomial, first direction numbers, of dimensions 1 to 15
# (dimension 0 is the van der Corput sequence).
_JOE_KUO = (
    (1, 0, (1,)),
    (2, 1, (1, 3)),
    (3, 1, (1, 3, 1)),
    (3, 2, (1, 1, 1)),
    (4, 1, (1, 1, 3, 3)),
    (4, 4, (1, 3, 5, 13)),
    (5, 2, (1, 1, 5, 5, 17)),
    (5, 4, (1, 1, 5, 5, 5)),
    (5, 7, (1, 1, 7, 11, 19)),
    (5, 11, (1, 1, 5, 1, 1)),
    (5, 13, (1, 1, 1, 3, 11)),
    (5, 14, (1, 3, 5, 5, 31)),
    (6, 1, (1, 3, 3, 9, 7, 49)),
    (6, 13, (1, 1, 1, 15, 21, 21)),
    (6, 16, (1, 3, 1, 13, 27, 49)),
)


def _reversed_bits(x: int) -> int:
    return int(f"{x:032b}"[::-1], 2)


def _sobol_matrices() -> np.ndarray:
    """(16, 32) uint32: the direction number of every index bit, bits reversed (see `sobol_u32`)."""
    v = np.zeros((SOBOL_DIMENSIONS, 32), np.uint32)
    v[0] = [1 << k for k in range(32)]
    for dimension, (degree, coefficients, first) in enumerate(_JOE_KUO, start=1):
        m = list(first)
        for k in range(degree, 32):
            value = m[k - degree] ^ (m[k - degree] << degree)
            for j in range(1, degree):
                if coefficients >> (degree - 1 - j) & 1:
                    value ^= m[k - j] << j
            m.append(value)
        v[dimension] = [_reversed_bits(m[k] << (31 - k)) for k in range(32)]
    return v


_SOBOL = _sobol_matrices()
_PRIMES = np.array((2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53), np.int64)


@inlined
def reverse_bits(x):
    """The 32 bits of x in reverse order."""
    x = np.uint32(x)
    x = np.uint32(((x & np.uint32(0x55555555)) << np.uint32(1)) | ((x >> np.uint32(1)) & np.uint32(0x55555555)))
    x = np.uint32(((x & np.uint32(0x33333333)) << np.uint32(2)) | ((x >> np.uint32(2)) & np.uint32(0x33333333)))
    x = np.uint32(((x & np.uint32(0x0F0F0F0F)) << np.uint32(4)) | ((x >> np.uint32(4)) & np.uint32(0x0F0F0F0F)))
    x = np.uint32(((x & np.uint32(0x00FF00FF)) << np.uint32(8)) | ((x >> np.uint32(8)) & np.uint32(0x00FF00FF)))
    return np.uint32((x << np.uint32(16)) | (x >> np.uint32(16)))


@inlined
def owen_reversed(x, seed):
    """Owen scrambling of a bit-reversed fraction: every bit is flipped by a hash of the bits below it."""
    x = np.uint32(x)
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x3D20ADEA)))
    x = np.uint32(x + np.uint32(seed))
    x = np.uint32(x * np.uint32((np.uint32(seed) >> np.uint32(16)) | np.uint32(1)))
    x = np.uint32(x ^ np.uint32(x * np.uint32(0x05526C56)))
    return np.uint32(x ^ np.uint32(x * np.uint32(0x53A22864)))


@inlined
def sobol_u32(index, dimension):
    """Point `index` of the Sobol sequence in one dimension (0..15): a 32-bit fraction, bits REVERSED."""
    x = np.uint32(0)
    i = np.uint32(index)
    k = 0
    while i != np.uint32(0):
        if i & np.uint32(1):
            x ^= _SOBOL[dimension, k]
        i >>= np.uint32(1)
        k += 1
    return x


@inlined
def sobol(index, dimension, seed):
    """Owen-scrambled Sobol point, one dimension (0..15), float32 in [0, 1).

    Points of one seed keep the sequence's stratification in all dimensions; different seeds are independent
    scrambles.  For more than 16 dimensions pad: another seed and a shuffled index (`shuffled_index`).
    """
    return to_unit(reverse_bits(owen_reversed(sobol_u32(index, dimension), hash_combine(seed, dimension))))


@inlined
def shuffled_index(index, seed):
    """Index of the sequence after Owen shuffling: keeps its blocks of powers of two, decorrelates padded sets."""
    return reverse_bits(owen_reversed(reverse_bits(np.uint32(index)), hash_u32(seed)))


@inlined
def _permuted_digit(digit, base, seed):
    """Element `digit` of a random permutation of 0..base-1, by cycle walking (Kensler 2013)."""
    mask = np.uint32(base - 1)
    mask |= mask >> np.uint32(1)
    mask |= mask >> np.uint32(2)
    mask |= mask >> np.uint32(4)
    i = np.uint32(digit)
    p = np.uint32(seed)
    while True:
        i ^= p
        i = np.uint32(i * np.uint32(0xE170893D))
        i ^= p >> np.uint32(16)
        i ^= (i & mask) >> np.uint32(4)
        i ^= p >> np.uint32(8)
        i = np.uint32(i * np.uint32(0x0929EB3F))
        i ^= p >> np.uint32(23)
        i ^= (i & mask) >> np.uint32(1)
        i = np.uint32(i * np.uint32(np.uint32(1) | (p >> np.uint32(27))))
        i = np.uint32(i * np.uint32(0x6935FA69))
        i ^= (i & mask) >> np.uint32(11)
        i = np.uint32(i * np.uint32(0x74DCB303))
        i ^= (i & mask) >> np.uint32(2)
        i = np.uint32(i * np.uint32(0x9E501CC3))
        i ^= (i & mask) >> np.uint32(2)
        i = np.uint32(i * np.uint32(0xC860A3DF))
        i &= mask
        i ^= i >> np.uint32(5)
        if i < np.uint32(base):
            break
    return np.int64((i + p) % np.uint32(base))


@inlined
def halton(index, dimension, seed):
    """Owen-scrambled radical inverse of `index` in the dimension's prime base (0..15), float32 in [0, 1)."""
    base = _PRIMES[dimension]
    scramble = hash_combine(seed, dimension)
    inverse = 1.0 / base
    scale = 1.0
    a = np.int64(index)
    digits = np.uint32(0)
    value = 0.0
    # Digits beyond the float's precision change nothing, and zeros ahead of the index are scrambled too.
    while scale > 1e-9:
        quotient = a // base
        key = hash_u32(scramble ^ digits)
        scale *= inverse
        value += _permuted_digit(a - quotient * base, base, key) * scale
        digits = np.uint32(np.uint32(digits * np.uint32(base)) + np.uint32(a - quotient * base) + np.uint32(0x9E3779B9))
        a = quotient
    return np.float32(min(value, 0.99999994))


@inlined
def r2(index, seed):
    """Point of the R2 lattice (plastic number) under a random shift by `seed`: two float32 in [0, 1)."""
    i = np.uint32(index)
    a = np.uint32(np.uint32(i * np.uint32(3242174889)) + hash_combine(seed, 0))
    b = np.uint32(np.uint32(i * np.uint32(2447445414)) + hash_combine(seed, 1))
    return to_unit(a), to_unit(b)


@kernel
def sobol_points(start, count, dimensions, seed):
    """(count, dimensions) float32: Owen-scrambled Sobol points start..start+count-1 (dimensions <= 16)."""
    out = np.empty((count, dimensions), np.float32)
    for i in range(count):
        for d in range(dimensions):
            out[i, d] = sobol(start + i, d, seed)
    return out


@kernel
def halton_points(start, count, dimensions, seed):
    """(count, dimensions) float32: Owen-scrambled Halton points start..start+count-1 (dimensions <= 16)."""
    out = np.empty((count, dimensions), np.float32)
    for i in range(count):
        for d in range(dimensions):
            out[i, d] = halton(start + i, d, seed)
    return out


@kernel
def r2_points(start, count, seed):
    """(count, 2) float32: shifted R2 points start..start+count-1."""
    out = np.empty((count, 2), np.float32)
    for i in range(count):
        out[i, 0], out[i, 1] = r2(start + i, seed)
    return out
