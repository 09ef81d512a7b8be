"""Tiles of a picture: how it is cut, and how what they show becomes one picture again.

Each tile is lit by VPLs and a cache of light of its own, so that its light differs from its neighbours' by the noise of a render,
evenly over the whole tile: at a sharp border a thousandth of it is seen.  Tiles therefore overlap, and fade into one another.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from .layers import CONTRACT, VECTORS, Layers

HALO = 32  # pixels around a tile: the denoiser sees beyond its border, and two tiles fade over twice as many

Tile = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels of the full frame, y down; x1 and y1 are the first ones outside

_MIXED = set(CONTRACT) - VECTORS - {"Depth"}  # colours and light, with those of light groups; other layers are cut at the border


def tiles(border: Tile, side: int) -> Iterator[Tile]:
    """Tiles `side` wide of the part of a picture inside `border`, row by row."""
    left, top, right, bottom = border
    for y in range(top, bottom, side):
        for x in range(left, right, side):
            yield x, y, min(x + side, right), min(y + side, bottom)


def with_halo(tile: Tile, border: Tile) -> Tile:
    """The tile and the pixels around it, as far as `border` goes."""
    x0, y0, x1, y1 = tile
    return max(border[0], x0 - HALO), max(border[1], y0 - HALO), min(border[2], x1 + HALO), min(border[3], y1 + HALO)


class Mosaic:
    """The part of a picture inside `border`, of tiles that come one by one, in any order, each once and with its halo.

    cut: all of `tiles(border, side)`.
    """

    def __init__(self, cut: Iterable[Tile], border: Tile):
        cut = list(cut)
        self._border = border
        self._columns = _shares({(tile[0], tile[2]) for tile in cut}, border[0], border[2])
        self._rows = _shares({(tile[1], tile[3]) for tile in cut}, border[1], border[3])
        self._arrays: dict[str, np.ndarray] = {}
        self._first: Layers | None = None

    def add(self, tile: Tile, layers: Layers) -> None:
        """What `tile` shows: `layers` of its `with_halo`, with their offset in the full frame."""
        self._first = self._first or replace(layers, arrays={})
        x, y = layers.offset[0] - self._border[0], layers.offset[1] - self._border[1]
        (x0, y0, x1, y1), (left, top) = tile, layers.offset
        for name, array in layers.items():
            height, width, channels = array.shape
            if name not in self._arrays:
                shape = (self._border[3] - self._border[1], self._border[2] - self._border[0], channels)
                self._arrays[name] = np.zeros(shape, np.float32)
            whole = self._arrays[name][y : y + height, x : x + width]
            if name.partition("_")[0] in _MIXED:
                share = np.outer(self._rows[y0, y1][y : y + height], self._columns[x0, x1][x : x + width])
                whole += array * share[..., None]
            else:
                inner = slice(y0 - top, y1 - top), slice(x0 - left, x1 - left)
                whole[inner] = array[inner]

    def picture(self) -> Layers:
        """All layers, when all tiles are there."""
        return replace(self._first, arrays=self._arrays, offset=self._border[:2])


def _shares(spans: set[tuple[int, int]], begin: int, end: int) -> dict[tuple[int, int], np.ndarray]:
    """Along one axis, (end - begin,) float32 for each span of a tile: how much of each pixel is its own; those of all add up to 1."""
    middle = np.arange(begin, end) + 0.5
    shares = {}
    for low, high in spans:
        rise = np.clip((middle - low) / (2 * HALO) + 0.5, 0, 1) if low > begin else np.ones(end - begin)
        fall = np.clip((high - middle) / (2 * HALO) + 0.5, 0, 1) if high < end else np.ones(end - begin)
        shares[low, high] = np.minimum(rise, fall)
    total = np.sum(list(shares.values()), axis=0)
    return {span: (share / total).astype(np.float32) for span, share in shares.items()}
