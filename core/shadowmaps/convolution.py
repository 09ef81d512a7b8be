"""Convolution soft shadow maps: what part of a rectangular light a point sees, from one prefiltered depth map.

Annen et al. 2007, "Convolution Shadow Maps", and 2008, "Real-time, All-frequency Shadows in Dynamic Scenes"; on
paraboloids as in Dong et al. 2009, Section 4.  The depth test f(z - d), 1 where the map's depth z is not less than the
receiver's depth d, is a Fourier series whose terms in z are stored, so that its mean over any box of texels is one look-up
in summed-area tables.  The mean depth of what blocks comes from the same series weighted with z, and gives the box's size.

Depths are warped (by a square root, so that near ones are told apart better) and squeezed into a part of the series'
period, for the series rises again half a period behind the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..threads import run_chunks
from .paraboloid import direction_to_disk

TERMS = (4, 8, 16)
FOLD = 2  # texels of the depth map along the edge of one of the tables
SPAN = np.float32(0.85)  # of the half period that depths take
ATTENUATION = 0.5  # of the higher terms, exp(-a ((k - 1) / K)^2), against ringing
OFFSET = 0.25  # of a receiver towards the light, in half waves of the last term but one
REACH = np.float32(2.0)  # mean depths: what is beyond is all alike, so that a few far texels do not take the range of the others
LEAST_BLOCKED = np.float32(0.02)  # a search region that is less blocked is lit
NEAREST_BLOCKER = np.float32(0.05)  # of the receiver's distance: bounds the filter's size
OWN_BEGINS, OWN_ENDS = (
    np.float32(0.8),
    np.float32(0.95),
)  # of the receiver's distance: mean depths of blockers that are ever less taken for some
COVERED, BASIS = 0, 1  # channels: share of a texel in the disk; sine and cosine of each term; the same again, times the depth
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)
_PI = np.float32(np.pi)


class SoftShadowMaps(NamedTuple):
    """Shadow maps of S rectangular lights.

    origin: (S, 3) float32 (m).  frame: (S, 3, 3) float32, rows: the rectangle's axes and the map's.  half: (S, 2) float32, half
    sides of the rectangle (m).  far: (S,) float32, depth from which on all is alike (m).
    tables: (S, R + 1, R + 1, C) float32, summed-area tables.  scale: what makes an unblocked point's series 1.
    offset: of a receiver's warped depth.
    """

    origin: np.ndarray
    frame: np.ndarray
    half: np.ndarray
    far: np.ndarray
    tables: np.ndarray
    scale: np.float32
    offset: np.float32


def _amplitudes(terms: int) -> np.ndarray:
    """(K,) of the sines of the square wave with period 2, attenuated."""
    k = np.arange(terms)
    return (2 / (np.pi * (2 * k + 1)) * np.exp(-ATTENUATION * (k / terms) ** 2)).astype(np.float32)


@inlined
def _warped(depth, far):
    """Warped depth, 0 to SPAN; misses are at infinity."""
    return SPAN * np.sqrt(min(depth / far, _1))


@kernel
def _build(maps, begin, end, amplitudes, far, tables):
    """Summed-area tables of the maps begin..end-1; the depths from which on all is alike into far (S,)."""
    resolution = maps.shape[1] // FOLD
    channels = tables.shape[3]
    terms, half = len(amplitudes), channels // 2
    row_sum = np.empty(channels, np.float32)
    cell = np.empty(channels, np.float32)
    share = _1 / np.float32(FOLD * FOLD)
    for m in range(begin, end):
        farthest = total = _0
        hits = 0
        for row in range(maps.shape[1]):
            for column in range(maps.shape[1]):
                z = maps[m, row, column]
                if _0 <= z < np.float32(np.inf):
                    farthest = max(farthest, z)
                    total += z
                    hits += 1
        far[m] = min(farthest, REACH * total / np.float32(hits)) if farthest > _0 else _1
        tables[m, 0] = _0
        for row in range(resolution):
            row_sum[:] = _0
            tables[m, row + 1, 0] = _0
            for column in range(resolution):
                cell[:] = _0
                for a in range(FOLD):
                    for b in range(FOLD):
                        depth = maps[m, FOLD * row + a, FOLD * column + b]
                        if depth < _0:
                            continue
                        u = _warped(depth, far[m]) * _PI
                        z = min(depth / far[m], _1)
                        s, c = np.sin(u), np.cos(u)
                        # On to the next odd multiple by turning through twice the angle.
                        s2, c2 = _2 * s * c, c * c - s * s
                        cell[COVERED] += _1
                        cell[half + COVERED] += z
                        for k in range(terms):
                            at = BASIS + 2 * k
                            ws, wc = amplitudes[k] * s, amplitudes[k] * c
                            cell[at] += ws
                            cell[at + 1] += wc
                            cell[half + at] += z * ws
                            cell[half + at + 1] += z * wc
                            s, c = s * c2 + c * s2, c * c2 - s * s2
                for channel in range(channels):
                    row_sum[channel] += share * cell[channel]
                    tables[m, row + 1, column + 1, channel] = tables[m, row, column + 1, channel] + row_sum[channel]


def soft_shadow_maps(
    maps: np.ndarray, origin: np.ndarray, frame: np.ndarray, half: np.ndarray, terms: int = TERMS[0], threads: int = 0
) -> SoftShadowMaps:
    """Prefiltered shadow maps of S lights from their depth maps (S, 2 R, 2 R), as `paraboloid_maps` makes them.

    origin, frame, half: as in `SoftShadowMaps`.  terms: of the Fourier series.

    Raises:
        ValueError: `terms` is not one of TERMS.
    """
    if terms not in TERMS:
        raise ValueError(f"terms: expected one of {TERMS}, got {terms}")
    amplitudes = _amplitudes(terms)
    side = maps.shape[1] // FOLD + 1
    tables = np.empty((len(maps), side, side, 2 * (BASIS + 2 * terms)), np.float32)
    far = np.empty(len(maps), np.float32)
    run_chunks(lambda begin, end: _build(maps, begin, end, amplitudes, far, tables), len(maps), 1, threads)
    offset = OFFSET / (2 * terms)
    lit = 0.5 + (amplitudes * np.sin(np.pi * (2 * np.arange(terms) + 1) * offset)).sum()
    return SoftShadowMaps(origin, frame, half, far, tables, np.float32(1 / lit), np.float32(offset))


@inlined
def _table_edge(x, resolution):
    """(column, fraction) at which a table is read for the edge x of a box (texels)."""
    x = min(max(x, _0), np.float32(resolution))
    column = min(np.int64(x), resolution - 1)
    return column, x - np.float32(column)


@kernel
def _box_sums(tables, m, x0, x1, y0, y1, channels, sums):
    """Sums of the first `channels` over a box of texels into sums (C,); tables are linear between their entries."""
    resolution = tables.shape[1] - 1
    left, f0 = _table_edge(x0, resolution)
    right, f1 = _table_edge(x1, resolution)
    top, g0 = _table_edge(y0, resolution)
    bottom, g1 = _table_edge(y1, resolution)
    sums[:channels] = _0
    for a in range(4):
        row = (top if a < 2 else bottom) + (a & 1)
        g = g0 if a < 2 else g1
        wy = (g if a & 1 else _1 - g) * (-_1 if a < 2 else _1)
        for b in range(4):
            column = (left if b < 2 else right) + (b & 1)
            f = f0 if b < 2 else f1
            w = wy * (f if b & 1 else _1 - f) * (-_1 if b < 2 else _1)
            entry = tables[m, row, column]
            for c in range(channels):
                sums[c] += w * entry[c]


@inlined
def _filter_size(x, y, z, half_s, half_t, widening):
    """Half sides (in units of the disk) of the box with the second moments of the light's shape about a direction.

    x, y, z: the direction in the light's frame.  widening: 1/blocker - 1/receiver distance (1/m); times the light's side it is
    the angle of the penumbra as the light's centre sees it (Dong et al. 2009, Section 4.2).
    """
    scale = _1 / (_1 + z)
    # The sides across the direction, then by the derivative of (x, y) / (1 + z).
    s_x, s_y = (_1 - x * x + x * x * z * scale) * half_s, (-x * y + y * x * z * scale) * half_s
    t_x, t_y = (-x * y + x * y * z * scale) * half_t, (_1 - y * y + y * y * z * scale) * half_t
    widening *= scale
    return widening * np.sqrt(s_x * s_x + t_x * t_x), widening * np.sqrt(s_y * s_y + t_y * t_y)


@kernel
def soft_visibility(maps, m, px, py, pz, sums):
    """Part of light m (0 to 1) that the point p sees.  sums: scratch, (C,) float32.

    A point behind the light is seen along its horizon.
    """
    dx, dy, dz = px - maps.origin[m, 0], py - maps.origin[m, 1], pz - maps.origin[m, 2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    if not distance > _0:
        return _1
    inverse = _1 / distance
    frame = maps.frame[m]
    x = (dx * frame[0, 0] + dy * frame[0, 1] + dz * frame[0, 2]) * inverse
    y = (dx * frame[1, 0] + dy * frame[1, 1] + dz * frame[1, 2]) * inverse
    z = max((dx * frame[2, 0] + dy * frame[2, 1] + dz * frame[2, 2]) * inverse, _0)
    if z == _0:
        level = _1 / np.sqrt(max(x * x + y * y, np.float32(1e-12)))
        x, y = x * level, y * level
    s, t = direction_to_disk(x, y, z)
    resolution = maps.tables.shape[1] - 1
    texels = _HALF * np.float32(resolution)
    column, row = (s + _1) * texels, (t + _1) * texels
    far = maps.far[m]
    depth = max(_warped(distance, far) - maps.offset, _0) * _PI
    sin1, cos1 = np.sin(depth), np.cos(depth)
    sin2, cos2 = _2 * sin1 * cos1, cos1 * cos1 - sin1 * sin1
    # Of what would block half-way: the region in which blockers are looked for.
    widening, own = inverse, _0
    channels = len(sums) // 2
    terms = (channels - BASIS) // 2
    for search in (True, False):
        width, height = _filter_size(x, y, z, maps.half[m, 0], maps.half[m, 1], widening)
        width, height = max(width * texels, _HALF), max(height * texels, _HALF)
        _box_sums(maps.tables, m, column - width, column + width, row - height, row + height, 2 * channels if search else channels, sums)
        if sums[COVERED] < np.float32(1e-3):
            return _1
        share = _1 / sums[COVERED]
        lit = lit_depth = _0
        sine, cosine = sin1, cos1
        for k in range(terms):
            at = BASIS + 2 * k
            lit += cosine * sums[at] - sine * sums[at + 1]
            lit_depth += cosine * sums[channels + at] - sine * sums[channels + at + 1]  # of the search; read by nothing else
            sine, cosine = sine * cos2 + cosine * sin2, cosine * cos2 - sine * sin2
        lit = _HALF + lit * share
        if not search:
            lit = min(max(lit * maps.scale, _0), _1)
            return max(lit, own)
        blocked = _1 - lit
        if blocked < LEAST_BLOCKED:
            return _1
        mean_depth = sums[channels + COVERED] * share
        blocker = (_HALF * mean_depth - lit_depth * share) / blocked * far
        blocker = min(max(blocker, NEAREST_BLOCKER * distance), distance)
        widening = _1 / blocker - inverse
        # What lies no nearer than this is the receiver's own surface, at a slant.
        own = min(max((blocker * inverse - OWN_BEGINS) / (OWN_ENDS - OWN_BEGINS), _0), _1)
    return _1
