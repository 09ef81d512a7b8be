"""IES photometric files (IESNA LM-63) as images of what a lamp sends into each direction, read as Cycles reads them (util/ies.cpp, kernel/svm/ies.h)."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

# Watt of a lamp that sends one candela everywhere: 4 pi over the luminous efficacy of D65, 177.83 lm/W.
WATT_OF_CANDELA = 0.0706650768394
UNREADABLE = 100.0  # what Cycles shows for a file that it cannot read
WIDTH, HEIGHT = 720, 720  # of the image: half and quarter degrees
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)")


class BadIes(Exception):
    """The text is no IES file that Cycles understands."""


@dataclass
class Photometry:
    """Intensities (H, V), in the watts that make a lamp of even light as bright, at H angles about the vertical and V from straight down (rad)."""

    h_angles: np.ndarray
    v_angles: np.ndarray
    intensity: np.ndarray


def parse(text: str) -> Photometry:
    """The numbers of a file, mirrored to the whole sphere.

    Raises:
        BadIes: Cycles would not read it either.
    """
    text = text.replace(",", " ").replace("\r\n", "\n").replace("\r", "\n")
    at = text.find("\nTILT=")
    if at < 0:
        raise BadIes("it has no line that begins with TILT=")
    included = text.startswith("\nTILT=INCLUDE", at)
    at = text.find("\n", at + 1) if not included else at + len("\nTILT=INCLUDE")
    if at < 0:
        raise BadIes("it ends too early")
    numbers = _Numbers(text, at)
    if included:
        numbers.take(1)
        numbers.take(2 * int(numbers.take(1)[0]))
    _, _, factor, n_v, n_h, kind, _, _, _, _, ballast, photometric, _ = numbers.take(13)
    if int(kind) not in _TYPES:
        raise BadIes(f"its photometric type is {int(kind)}, none of C (1), B (2) and A (3)")
    v, h = numbers.take(int(n_v)), numbers.take(int(n_h))
    if len(v) < 2 or not len(h):
        raise BadIes("it has no angles")
    intensity = numbers.take(len(v) * len(h)).reshape(len(h), len(v)) * (factor * ballast * photometric * WATT_OF_CANDELA)
    v, h, intensity = v.astype(np.float32), h.astype(np.float32), intensity.astype(np.float32)
    h, v, intensity = _TYPES[int(kind)](h, v, intensity)
    if len(h) < 2:
        raise BadIes("it has a single angle")
    return Photometry(np.radians(h.astype(np.float64)), np.radians(v.astype(np.float64)), intensity.astype(np.float64))


class _Numbers:
    """The numbers of a text, one after the other."""

    def __init__(self, text: str, at: int):
        self.text, self.at = text, at

    def take(self, count: int) -> np.ndarray:
        """(count,) float64, the next ones."""
        found = np.empty(max(count, 0))
        for k in range(len(found)):
            match = _NUMBER.match(self.text, self.at)
            if match is None:
                raise BadIes("it holds too few numbers")
            found[k], self.at = float(match[1]), match.end()
        return found


def _is(a: np.floating, b: float) -> bool:
    return abs(a - b) < 1e-4


def _type_a(h: np.ndarray, v: np.ndarray, intensity: np.ndarray):
    """Angles from straight ahead, which is level: 90 to the left and right, or one of the two."""
    left, rest = (180 - h[::-1], intensity[::-1]), h[:0]
    if _is(h[0], 0):
        rest = 180 + h[1:]
    return np.concatenate([left[0], rest]), v + 90, np.concatenate([left[1], intensity[len(h) - len(rest) :]])


def _type_b(h: np.ndarray, v: np.ndarray, intensity: np.ndarray):
    """Angles about a level axis, from -90 or mirrored at 0; as in Cycles the axis stands upright."""
    h, v, intensity = v, h, intensity.T
    if _is(h[0], 0):
        h, intensity = np.concatenate([90 - h[:0:-1], 90 + h]), np.concatenate([intensity[:0:-1], intensity])
    else:
        h = h + 90
    if _is(v[0], 0):
        v, intensity = np.concatenate([90 - v[:0:-1], 90 + v]), np.concatenate([intensity[:, :0:-1], intensity], 1)
    else:
        v = v + 90
    return h, v, intensity


def _type_c(h: np.ndarray, v: np.ndarray, intensity: np.ndarray):
    """Angles about the upright axis, and from straight down; quadrants and halves are mirrored."""
    if _is(h[0], 90):
        h = h - 90
    if len(h) == 1:
        h, intensity = np.array([0, 360], h.dtype), np.concatenate([intensity, intensity])
    for part in (90, 180):
        if _is(h[-1], part):
            h, intensity = np.concatenate([h, 2 * part - h[-2::-1]]), np.concatenate([intensity, intensity[-2::-1]])
    gap = 360 - h[-1]
    if (
        _is(h[0], 0) and not _is(gap, 0) and (_is(gap, h[-1] - h[-2]) or _is(gap, h[1] - h[0]))
    ):  # files that leave out the last as it is the first
        h, intensity = np.append(h, np.float32(360)), np.concatenate([intensity, intensity[:1]])
    return h, v, intensity


_TYPES = {1: _type_c, 2: _type_b, 3: _type_a}


def _cubic(a, b, c, d, x):
    """Catmull-Rom spline through b (x = 0) and c (x = 1), as Cycles' cubic_interp."""
    return 0.5 * (((d + 3 * (b - c) - a) * x + (2 * a - 5 * b + 4 * c - d)) * x + (c - a)) * x + b


def look_up(lamp: Photometry, h_angle: np.ndarray, v_angle: np.ndarray, *, continued: bool) -> np.ndarray:
    """Intensities in directions, arrays of any shape: angle about the vertical (0..2 pi) and from straight down (0..pi).

    continued: whether what lies beyond the first and the last angles is taken to be as they are (Cycles 5), and not dark, by the spline.
    """
    h, v, table = lamp.h_angles, lamp.v_angles, lamp.intensity
    i = np.clip(np.searchsorted(h, h_angle, "left") - 1, 0, len(h) - 2)
    j = np.clip(np.searchsorted(v, v_angle, "left") - 1, 0, len(v) - 2)
    x = (h_angle - h[i]) / (h[i + 1] - h[i])
    y = (v_angle - v[j]) / (v[j + 1] - v[j])

    def along(k):
        here, next_ = table[k, j], table[k, j + 1]
        # Before straight down lies, as if the lamp were symmetrical, what lies after it.  Cycles goes around nowhere else: it compares the
        # last angles with pi and 2 pi less a part of their rounding.
        first = table[k, 1] if v[0] < 1e-7 else here if continued else 0.0
        last = np.where(j + 2 < len(v), table[k, np.minimum(j + 2, len(v) - 1)], next_ if continued else 0.0)
        return _cubic(np.where(j > 0, table[k, j - 1], first), here, next_, last, y)

    here = along(i)
    beyond = here if continued else 0.0
    before = np.where(i > 0, along(np.maximum(i - 1, 0)), beyond)
    after = np.where(i + 2 < len(h), along(np.minimum(i + 2, len(h) - 1)), beyond)
    value = _cubic(before, here, along(i + 1), after, x)
    outside = (v_angle >= v[-1]) | (v_angle < v[0]) | (h_angle >= h[-1]) | (h_angle < h[0])
    return np.where(outside, 0.0, np.maximum(value, 0.0))


def image(lamp: Photometry, *, continued: bool) -> np.ndarray:
    """(HEIGHT, WIDTH, 1) float32 image of what `look_up` finds: columns by the angle about the vertical, from 0, rows by that from straight down."""
    h_angle, v_angle = (np.arange(WIDTH) + 0.5) * (2 * np.pi / WIDTH), (np.arange(HEIGHT) + 0.5) * (np.pi / HEIGHT)
    h_angle, v_angle = np.broadcast_arrays(h_angle[None], v_angle[:, None])
    value = look_up(lamp, h_angle, v_angle, continued=continued)
    if np.allclose(value, value[:, :1], rtol=1e-6, atol=0):
        value = value[:, :1]
    return np.ascontiguousarray(value[..., None], np.float32)
