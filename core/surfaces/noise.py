"""Perlin noise in one to four dimensions and its fractal sums (Cycles: kernel/svm/noise.h, fractal_noise.h)."""

from __future__ import annotations

import numpy as np

from ..jit import inlined, leaf
from .hashing import float1, float2, hash1, hash2, hash3, hash4

F = np.float32

# Kinds of fractal sums, named as the Noise Texture's types.
FRACTAL_KINDS = ("MULTIFRACTAL", "FBM", "HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL", "HETERO_TERRAIN")
MULTIFRACTAL, FBM, HYBRID, RIDGED, HETERO = range(5)


@inlined
def _fade(t):
    return t * t * t * (t * (t * F(6) - F(15)) + F(10))


@inlined
def _signed(x, bit):
    return -x if bit else x


@inlined
def _sign(bit):
    """-1 where a bit is set, else 1, without a branch, for loops that are to be vectorized."""
    return F(1) - F(2) * F(bit != 0)


@inlined
def _gradient1(h, x):
    g = F(1) + F(h & 7)
    return _signed(g, h & 8) * x


@inlined
def _gradient2(h, x, y):
    h = h & 7
    u, v = (x, F(2) * y) if h < 4 else (y, F(2) * x)
    return _signed(u, h & 1) + _signed(v, h & 2)


@inlined
def _gradient3(h, x, y, z):
    h = h & 15
    u = x if h < 8 else y
    far = x if (h == 12) | (h == 14) else z
    v = y if h < 4 else far
    return _sign(h & 1) * u + _sign(h & 2) * v


@inlined
def _gradient4(h, x, y, z, w):
    h = h & 31
    u = x if h < 24 else y
    v = y if h < 16 else z
    s = z if h < 8 else w
    return _sign(h & 1) * u + _sign(h & 2) * v + _sign(h & 4) * s


@inlined
def _cell(x):
    """Cell and place in it; noise repeats every 100000 so that floats can tell places apart (Cycles: snoise)."""
    if abs(x) >= F(100000):  # a call, and dear
        far = abs(x) >= F(1e6)
        x = np.fmod(x, F(100000))
        if far:
            x += F(0.5)
    f = np.floor(x)
    return np.int32(f), x - f


@inlined
def _mix(a, b, t):
    return a + t * (b - a)


@leaf
def perlin(dimensions, x, y, z, w):
    """Signed Perlin noise, about -1..1, of the first `dimensions` coordinates (one: w)."""
    if dimensions == 1:
        i, fx = _cell(w)
        return F(0.25) * _mix(_gradient1(hash1(i), fx), _gradient1(hash1(i + 1), fx - F(1)), _fade(fx))
    i, fx = _cell(x)
    j, fy = _cell(y)
    u, v = _fade(fx), _fade(fy)
    if dimensions == 2:
        low = high = F(0)
        for b in range(2):
            gy = fy - F(b)
            row = _mix(_gradient2(hash2(i, j + b), fx, gy), _gradient2(hash2(i + 1, j + b), fx - F(1), gy), u)
            low, high = high, row
        return F(0.6616) * _mix(low, high, v)
    k, fz = _cell(z)
    t = _fade(fz)
    total = F(0)
    if dimensions == 3:
        for corner in range(1 << dimensions):  # a number that the compiler does not know: it would unroll the loop, not vectorize it
            a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
            weight = (u if a else F(1) - u) * (v if b else F(1) - v) * (t if c else F(1) - t)
            total += weight * _gradient3(hash3(i + a, j + b, k + c), fx - F(a), fy - F(b), fz - F(c))
        return F(0.982) * total
    n, fw = _cell(w)
    s = _fade(fw)
    for corner in range(16):
        a, b, c, d = corner & 1, (corner >> 1) & 1, (corner >> 2) & 1, corner >> 3
        weight = (u if a else F(1) - u) * (v if b else F(1) - v) * (t if c else F(1) - t) * (s if d else F(1) - s)
        total += weight * _gradient4(hash4(i + a, j + b, k + c, n + d), fx - F(a), fy - F(b), fz - F(c), fw - F(d))
    return F(0.8344) * total


@leaf
def fractal(kind, normalize, dimensions, x, y, z, w, detail, roughness, lacunarity, offset, gain):
    """A sum of octaves of `perlin`; `kind` indexes FRACTAL_KINDS, `detail` is octaves less one (may be fractional)."""
    whole = np.int32(detail)
    rest = detail - np.floor(detail)
    scale, power, weight, signal, most = F(1), F(1), F(1), F(0), F(0)
    value = F(1) if kind == MULTIFRACTAL else F(0)
    for i in range(whole + (2 if rest != F(0) and kind != RIDGED else 1)):
        # `share` of this octave: the last one may count in part.
        share = rest if i > whole else F(1)
        n = perlin(dimensions, scale * x, scale * y, scale * z, scale * w)
        scale *= lacunarity
        if kind == FBM:
            finer = value + power * n
            if share == F(1):
                value = finer
                most += power
            elif normalize:
                return _mix(F(0.5) * value / most + F(0.5), F(0.5) * finer / (most + power) + F(0.5), share)
            else:
                return _mix(value, finer, share)
        elif kind == MULTIFRACTAL:
            value *= share * power * n + F(1)
        elif kind == HETERO:
            value += offset + n if i == 0 else share * (n + offset) * power * value
        elif kind == HYBRID:
            if not weight > F(0.001):
                break
            signal = (n + offset) * power
            value += share * min(weight, F(1)) * signal
            weight = min(weight, F(1)) * gain * signal
        else:
            weight = min(max(signal * gain, F(0)), F(1)) if i > 0 else F(1)
            signal = (offset - abs(n)) ** 2 * weight
            value += signal * power
        power *= roughness
    return F(0.5) * value / most + F(0.5) if kind == FBM and normalize else value


@inlined
def _shift(dimensions, seed, axis):
    """Offset of one axis that makes a channel's noise its own."""
    if dimensions == 1:
        return F(100) + F(100) * float1(seed)
    return F(100) + F(100) * float2(seed, F(axis))


@leaf
def _shifted(dimensions, seed, x, y, z, w):
    """The point moved to where the noise of channel `seed` is taken."""
    last = _shift(dimensions, seed, 3)
    return x + _shift(dimensions, seed, 0), y + _shift(dimensions, seed, 1), z + _shift(dimensions, seed, 2), w + last


@leaf
def noise_texture(kind, normalize, dimensions, x, y, z, w, detail, roughness, lacunarity, offset, gain, distortion, colored):
    """The Noise Texture: (r, g, b), of which r is the value; g and b only where `colored`."""
    detail = min(max(detail, F(0)), F(15))
    roughness = max(roughness, F(0))
    if distortion != F(0):
        d0 = d1 = d2 = d3 = F(0)
        for axis in range(dimensions):
            px, py, pz, pw = _shifted(dimensions, F(axis), x, y, z, w)
            d0, d1, d2, d3 = d1, d2, d3, perlin(dimensions, px, py, pz, pw)
        # The last one computed is d3: with n dimensions the first axis is in d(4 - n).
        if dimensions == 1:
            w += distortion * d3
        elif dimensions == 2:
            x, y = x + distortion * d2, y + distortion * d3
        elif dimensions == 3:
            x, y, z = x + distortion * d1, y + distortion * d2, z + distortion * d3
        else:
            x, y, z, w = x + distortion * d0, y + distortion * d1, z + distortion * d2, w + distortion * d3
    r = g = b = F(0)
    for channel in range(3 if colored else 1):
        px, py, pz, pw = x, y, z, w
        if channel > 0:
            # The seeds after those of the distortion.
            px, py, pz, pw = _shifted(dimensions, F(dimensions + channel - 1), x, y, z, w)
        value = fractal(kind, normalize, dimensions, px, py, pz, pw, detail, roughness, lacunarity, offset, gain)
        if channel == 0:
            r = value
        elif channel == 1:
            g = value
        else:
            b = value
    return r, g, b
