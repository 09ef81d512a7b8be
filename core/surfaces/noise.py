"""Perlin noise in one to four dimensions and its fractal sums (Cycles: kernel/svm/noise.h, fractal_noise.h)."""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
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
    v = y if h < 4 else x if h == 12 or h == 14 else z
    return _signed(u, h & 1) + _signed(v, h & 2)


@inlined
def _gradient4(h, x, y, z, w):
    h = h & 31
    u = x if h < 24 else y
    v = y if h < 16 else z
    s = z if h < 8 else w
    return _signed(u, h & 1) + _signed(v, h & 2) + _signed(s, h & 4)


@inlined
def _cell(x):
    """Cell and place in it; noise repeats every 100000 so that floats can tell places apart (Cycles: snoise)."""
    far = abs(x) >= F(1e6)
    x = np.fmod(x, F(100000))
    if far:
        x += F(0.5)
    f = np.floor(x)
    return np.int32(f), x - f


@inlined
def _mix(a, b, t):
    return a + t * (b - a)


@kernel
def perlin(dimensions, x, y, z, w):
    """Signed Perlin noise, about -1..1, of the first `dimensions` coordinates (one: w)."""
    if dimensions == 1:
        i, fx = _cell(w)
        return F(0.25) * _mix(_gradient1(hash1(i), fx), _gradient1(hash1(i + 1), fx - F(1)), _fade(fx))
    i, fx = _cell(x)
    j, fy = _cell(y)
    if dimensions == 2:
        low = _mix(_gradient2(hash2(i, j), fx, fy), _gradient2(hash2(i + 1, j), fx - F(1), fy), _fade(fx))
        high = _mix(_gradient2(hash2(i, j + 1), fx, fy - F(1)), _gradient2(hash2(i + 1, j + 1), fx - F(1), fy - F(1)), _fade(fx))
        return F(0.6616) * _mix(low, high, _fade(fy))
    k, fz = _cell(z)
    if dimensions == 3:
        return F(0.982) * _mix(_slice3(i, j, k, fx, fy, fz), _slice3(i, j, k + 1, fx, fy, fz - F(1)), _fade(fz))
    n, fw = _cell(w)
    low = _mix(_slice4(i, j, k, n, fx, fy, fz, fw), _slice4(i, j, k + 1, n, fx, fy, fz - F(1), fw), _fade(fz))
    fw1 = fw - F(1)
    high = _mix(_slice4(i, j, k, n + 1, fx, fy, fz, fw1), _slice4(i, j, k + 1, n + 1, fx, fy, fz - F(1), fw1), _fade(fz))
    return F(0.8344) * _mix(low, high, _fade(fw))


@inlined
def _slice3(i, j, k, fx, fy, fz):
    u = _fade(fx)
    low = _mix(_gradient3(hash3(i, j, k), fx, fy, fz), _gradient3(hash3(i + 1, j, k), fx - F(1), fy, fz), u)
    fy1 = fy - F(1)
    high = _mix(_gradient3(hash3(i, j + 1, k), fx, fy1, fz), _gradient3(hash3(i + 1, j + 1, k), fx - F(1), fy1, fz), u)
    return _mix(low, high, _fade(fy))


@kernel
def _slice4(i, j, k, n, fx, fy, fz, fw):
    u = _fade(fx)
    low = _mix(_gradient4(hash4(i, j, k, n), fx, fy, fz, fw), _gradient4(hash4(i + 1, j, k, n), fx - F(1), fy, fz, fw), u)
    fy1 = fy - F(1)
    high = _mix(_gradient4(hash4(i, j + 1, k, n), fx, fy1, fz, fw), _gradient4(hash4(i + 1, j + 1, k, n), fx - F(1), fy1, fz, fw), u)
    return _mix(low, high, _fade(fy))


@kernel
def fractal(kind, normalize, dimensions, x, y, z, w, detail, roughness, lacunarity, offset, gain):
    """A sum of octaves of `perlin`; `kind` indexes FRACTAL_KINDS, `detail` is octaves less one (may be fractional)."""
    octaves = np.int32(detail)
    rest = detail - np.floor(detail)
    scale = F(1)
    if kind == FBM:
        amplitude, most, total = F(1), F(0), F(0)
        for _ in range(octaves + 1):
            total += amplitude * perlin(dimensions, scale * x, scale * y, scale * z, scale * w)
            most += amplitude
            amplitude *= roughness
            scale *= lacunarity
        finer = total
        if rest != F(0):
            finer += amplitude * perlin(dimensions, scale * x, scale * y, scale * z, scale * w)
        if not normalize:
            return _mix(total, finer, rest)
        total = F(0.5) * total / most + F(0.5)
        return _mix(total, F(0.5) * finer / (most + amplitude) + F(0.5), rest) if rest != F(0) else total
    if kind == MULTIFRACTAL:
        value, power = F(1), F(1)
        for _ in range(octaves + 1):
            value *= power * perlin(dimensions, scale * x, scale * y, scale * z, scale * w) + F(1)
            power *= roughness
            scale *= lacunarity
        if rest != F(0):
            value *= rest * power * perlin(dimensions, scale * x, scale * y, scale * z, scale * w) + F(1)
        return value
    if kind == HETERO:
        power = roughness
        value = offset + perlin(dimensions, x, y, z, w)
        for _ in range(octaves):
            scale *= lacunarity
            value += (perlin(dimensions, scale * x, scale * y, scale * z, scale * w) + offset) * power * value
            power *= roughness
        if rest != F(0):
            scale *= lacunarity
            value += rest * (perlin(dimensions, scale * x, scale * y, scale * z, scale * w) + offset) * power * value
        return value
    if kind == HYBRID:
        power, value, weight = F(1), F(0), F(1)
        for _ in range(octaves + 1):
            if not weight > F(0.001):
                break
            weight = min(weight, F(1))
            signal = (perlin(dimensions, scale * x, scale * y, scale * z, scale * w) + offset) * power
            power *= roughness
            value += weight * signal
            weight *= gain * signal
            scale *= lacunarity
        if rest != F(0) and weight > F(0.001):
            signal = (perlin(dimensions, scale * x, scale * y, scale * z, scale * w) + offset) * power
            value += rest * min(weight, F(1)) * signal
        return value
    power = roughness
    signal = offset - abs(perlin(dimensions, x, y, z, w))
    signal *= signal
    value = signal
    for _ in range(octaves):
        scale *= lacunarity
        weight = min(max(signal * gain, F(0)), F(1))
        signal = offset - abs(perlin(dimensions, scale * x, scale * y, scale * z, scale * w))
        signal *= signal * weight
        value += signal * power
        power *= roughness
    return value


@inlined
def _shift(dimensions, seed, axis):
    """Offset of one axis that makes a channel's noise its own."""
    if dimensions == 1:
        return F(100) + F(100) * float1(seed)
    return F(100) + F(100) * float2(seed, F(axis))


@inlined
def _shifted_perlin(dimensions, x, y, z, w, seed):
    last = _shift(dimensions, seed, 3)
    return perlin(dimensions, x + _shift(dimensions, seed, 0), y + _shift(dimensions, seed, 1), z + _shift(dimensions, seed, 2), w + last)


@kernel
def noise_texture(kind, normalize, dimensions, x, y, z, w, detail, roughness, lacunarity, offset, gain, distortion, colored):
    """The Noise Texture: (r, g, b), of which r is the value; g and b only where `colored`."""
    detail = min(max(detail, F(0)), F(15))
    roughness = max(roughness, F(0))
    if distortion != F(0):
        dx = _shifted_perlin(dimensions, x, y, z, w, F(0))
        dy = dz = dw = F(0)
        if dimensions == 1:
            dw = dx
        else:
            dy = _shifted_perlin(dimensions, x, y, z, w, F(1))
        if dimensions > 2:
            dz = _shifted_perlin(dimensions, x, y, z, w, F(2))
        if dimensions > 3:
            dw = _shifted_perlin(dimensions, x, y, z, w, F(3))
        x, y, z, w = x + distortion * dx, y + distortion * dy, z + distortion * dz, w + distortion * dw
    r = fractal(kind, normalize, dimensions, x, y, z, w, detail, roughness, lacunarity, offset, gain)
    g = b = r
    if colored:
        # The seeds after those of the distortion.
        first = F(max(dimensions, 1))
        for channel in range(2):
            seed = first + F(channel)
            px, py = x + _shift(dimensions, seed, 0), y + _shift(dimensions, seed, 1)
            pz, pw = z + _shift(dimensions, seed, 2), w + _shift(dimensions, seed, 3)
            value = fractal(kind, normalize, dimensions, px, py, pz, pw, detail, roughness, lacunarity, offset, gain)
            if channel == 0:
                g = value
            else:
                b = value
    return r, g, b
