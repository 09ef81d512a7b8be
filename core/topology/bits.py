"""Volumes of bits: 64 neighbours along x in a word of uint64, rows along y, slices along z."""

from __future__ import annotations

import numpy as np

WORD = 64


def pack(volume: np.ndarray, words: int | None = None) -> np.ndarray:
    """(Z, Y, W) uint64 of a volume (Z, Y, X) of bool; bit x % 64 of word x // 64, the rest 0.

    words: W, where more are wanted than X needs.
    """
    nz, ny, nx = volume.shape
    words = -(-nx // WORD) if words is None else words
    packed = np.zeros((nz, ny, words * 8), np.uint8)
    packed[:, :, : -(-nx // 8)] = np.packbits(volume, axis=2, bitorder="little")
    return packed.view(np.uint64)


def unpack(words: np.ndarray, width: int) -> np.ndarray:
    """(Z, Y, width) bool of packed words (Z, Y, W)."""
    return np.unpackbits(words.view(np.uint8), axis=2, count=width, bitorder="little").view(bool)


def popcount(words: np.ndarray) -> int:
    """Bits that are set in an array of uint64 (bytes in a table: NumPy 1 counts no bits)."""
    return int(np.bincount(words.view(np.uint8).ravel(), minlength=256) @ _BITS)


_BITS = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1).sum(axis=1).astype(np.int64)
