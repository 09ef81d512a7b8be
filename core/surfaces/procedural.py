"""Procedural patterns: checker, gradient, wave, magic, brick, white noise (Cycles: kernel/svm/*.h)."""

from __future__ import annotations

import numpy as np

from ..jit import inlined, leaf
from .hashing import float1, float2, float3, float4
from .noise import FBM, fractal

F = np.float32
_TURN = F(2 * np.pi)

GRADIENT_KINDS = ("LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "RADIAL", "QUADRATIC_SPHERE", "SPHERICAL")
_LINEAR, _QUADRATIC, _EASING, _DIAGONAL, _RADIAL, _QUADRATIC_SPHERE, _SPHERICAL = range(7)


@inlined
def _unit(x):
    return min(max(x, F(0)), F(1))


@inlined
def _nudged(x):
    """Off the integers, where rounding would decide between neighbours."""
    return (x + F(0.000001)) * F(0.999999)


@inlined
def checker(x, y, z):
    """1 in the odd cells, 0 in the even ones."""
    i, j, k = np.int32(np.floor(_nudged(x))), np.int32(np.floor(_nudged(y))), np.int32(np.floor(_nudged(z)))
    return F((i + j + k) & 1)


@leaf
def gradient(kind, x, y, z):
    """The Gradient Texture, 0..1; `kind` indexes GRADIENT_KINDS."""
    if kind == _LINEAR:
        value = x
    elif kind == _QUADRATIC:
        value = max(x, F(0)) ** 2
    elif kind == _EASING:
        r = _unit(x)
        value = r * r * (F(3) - F(2) * r)
    elif kind == _DIAGONAL:
        value = (x + y) * F(0.5)
    elif kind == _RADIAL:
        value = np.arctan2(y, x) / _TURN + F(0.5)
    else:
        value = max(F(0.999999) - np.sqrt(x * x + y * y + z * z), F(0))
        if kind == _QUADRATIC_SPHERE:
            value *= value
    return _unit(value)


@leaf
def white_noise(dimensions, x, y, z, w):
    """The White Noise Texture: (r, g, b, value)."""
    if dimensions == 1:
        value = float1(w)
        return value, float2(w, F(1)), float2(w, F(2)), value
    if dimensions == 2:
        value = float2(x, y)
        return value, float3(x, y, F(1)), float3(x, y, F(2)), value
    if dimensions == 3:
        value = float3(x, y, z)
        return value, float4(x, y, z, F(1)), float4(x, y, z, F(2)), value
    value = float4(x, y, z, w)
    return value, float4(z, x, w, y), float4(w, z, y, x), value


@leaf
def wave(rings, direction, profile, x, y, z, distortion, detail, detail_scale, detail_roughness, phase):
    """The Wave Texture: bands (direction x, y, z, diagonal) or rings (about x, y, z, spherical); profile sine, saw, triangle."""
    x, y, z = _nudged(x), _nudged(y), _nudged(z)
    if rings:
        rx, ry, rz = x, y, z
        if direction == 0:
            rx = F(0)
        elif direction == 1:
            ry = F(0)
        elif direction == 2:
            rz = F(0)
        n = np.sqrt(rx * rx + ry * ry + rz * rz) * F(20)
    elif direction == 0:
        n = x * F(20)
    elif direction == 1:
        n = y * F(20)
    elif direction == 2:
        n = z * F(20)
    else:
        n = (x + y + z) * F(10)
    n += phase
    if distortion != F(0):
        s = detail_scale
        detail = min(max(detail, F(0)), F(15))
        n += distortion * (fractal(FBM, True, 3, x * s, y * s, z * s, F(0), detail, detail_roughness, F(2), F(0), F(0)) * F(2) - F(1))
    if profile == 0:
        return F(0.5) + F(0.5) * np.sin(n - F(np.pi / 2))
    n /= _TURN
    if profile == 1:
        return n - np.floor(n)
    return abs(n - np.floor(n + F(0.5))) * F(2)


@leaf(fast=False)
def magic(depth, x, y, z, scale, distortion):
    """The Magic Texture: (r, g, b)."""
    px, py, pz = np.fmod(x, _TURN), np.fmod(y, _TURN), np.fmod(z, _TURN)
    k = F(5) * scale
    x = np.sin((px + py + pz) * k)
    y = np.cos((-px + py - pz) * k)
    z = -np.cos((-px - py + pz) * k)
    if depth > 0:
        x *= distortion
        y *= distortion
        z *= distortion
        y = -np.cos(x - y + z) * distortion
    if depth > 1:
        x = np.cos(x - y - z) * distortion
    if depth > 2:
        z = np.sin(-x - y - z) * distortion
    if depth > 3:
        x = -np.cos(-x + y - z) * distortion
    if depth > 4:
        y = -np.sin(-x + y + z) * distortion
    if depth > 5:
        y = -np.cos(-x + y + z) * distortion
    if depth > 6:
        x = np.cos(x + y + z) * distortion
    if depth > 7:
        z = np.sin(x + y - z) * distortion
    if depth > 8:
        x = -np.cos(-x - y + z) * distortion
    if depth > 9:
        y = -np.sin(x - y + z) * distortion
    if distortion != F(0):
        twice = F(2) * distortion
        x, y, z = x / twice, y / twice, z / twice
    return F(0.5) - x, F(0.5) - y, F(0.5) - z


@inlined
def _brick_tint(n):
    n = (n + np.int64(1013)) & np.int64(0x7FFFFFFF)
    n = (n >> 13) ^ n
    # The products wrap at 32 bits.
    square = (n * n) & np.int64(0xFFFFFFFF)
    polynomial = (square * np.int64(60493) + np.int64(19990303)) & np.int64(0xFFFFFFFF)
    product = np.uint64(n) * np.uint64(polynomial)
    bits = (np.int64(product & np.uint64(0xFFFFFFFF)) + np.int64(1376312589)) & np.int64(0x7FFFFFFF)
    return F(0.5) * (F(bits) / F(1073741824.0))


@leaf
def brick(x, y, mortar_size, mortar_smooth, bias, width, height, offset, offset_every, squash, squash_every):
    """The Brick Texture: (tint between the brick colours, share of mortar)."""
    row = np.int32(np.floor(y / height))
    shift = F(0)
    if offset_every > 0 and squash_every > 0:
        if row % squash_every == 0:
            width *= squash
        if row % offset_every == 0:
            shift = width * offset
    column = np.int32(np.floor((x + shift) / width))
    left, low = x + shift - width * F(column), y - height * F(row)
    number = (np.int64(row) << 16) + (np.int64(column) & 0xFFFF)
    tint = _unit(_brick_tint(number & np.int64(0xFFFFFFFF)) + bias)
    nearest = min(min(left, low), min(width - left, height - low))
    if nearest >= mortar_size:
        return tint, F(0)
    if mortar_smooth == F(0):
        return tint, F(1)
    t = _unit((F(1) - nearest / mortar_size) / mortar_smooth)
    return tint, t * t * (F(3) - F(2) * t)
