"""Hashes of integers and floats: Bob Jenkins' lookup3, on which Cycles' procedural textures rest (util/hash.h)."""

from __future__ import annotations

import numpy as np

from ..jit import inlined

F = np.float32
U = np.uint32


@inlined
def _rotated(x, k):
    return U(U(x << U(k)) | U(x >> U(32 - k)))


@inlined
def _final(a, b, c):
    c = U(U(c ^ b) - _rotated(b, 14))
    a = U(U(a ^ c) - _rotated(c, 11))
    b = U(U(b ^ a) - _rotated(a, 25))
    c = U(U(c ^ b) - _rotated(b, 16))
    a = U(U(a ^ c) - _rotated(c, 4))
    b = U(U(b ^ a) - _rotated(a, 14))
    return U(U(c ^ b) - _rotated(b, 24))


@inlined
def hash1(x):
    """Hash of one uint32."""
    start = U(0xDEADBEEF + 4 + 13)
    return _final(U(start + U(x)), start, start)


@inlined
def hash2(x, y):
    """Hash of two uint32."""
    start = U(0xDEADBEEF + 8 + 13)
    return _final(U(start + U(x)), U(start + U(y)), start)


@inlined
def hash3(x, y, z):
    """Hash of three uint32."""
    start = U(0xDEADBEEF + 12 + 13)
    return _final(U(start + U(x)), U(start + U(y)), U(start + U(z)))


@inlined
def hash4(x, y, z, w):
    """Hash of four uint32."""
    start = U(0xDEADBEEF + 16 + 13)
    a, b, c = U(start + U(x)), U(start + U(y)), U(start + U(z))
    a = U(U(a - c) ^ _rotated(c, 4))
    c = U(c + b)
    b = U(U(b - a) ^ _rotated(a, 6))
    a = U(a + c)
    c = U(U(c - b) ^ _rotated(b, 8))
    b = U(b + a)
    a = U(U(a - c) ^ _rotated(c, 16))
    c = U(c + b)
    b = U(U(b - a) ^ _rotated(a, 19))
    a = U(a + c)
    c = U(U(c - b) ^ _rotated(b, 4))
    b = U(b + a)
    return _final(U(a + U(w)), b, c)


@inlined
def _unit(h):
    return F(h) * F(1 / 0xFFFFFFFF)


@inlined
def _bits(x):
    return F(x).view(np.uint32)


@inlined
def float1(x):
    """Hash of one float, in 0..1."""
    return _unit(hash1(_bits(x)))


@inlined
def float2(x, y):
    """Hash of two floats, in 0..1."""
    return _unit(hash2(_bits(x), _bits(y)))


@inlined
def float3(x, y, z):
    """Hash of three floats, in 0..1."""
    return _unit(hash3(_bits(x), _bits(y), _bits(z)))


@inlined
def float4(x, y, z, w):
    """Hash of four floats, in 0..1."""
    return _unit(hash4(_bits(x), _bits(y), _bits(z), _bits(w)))
