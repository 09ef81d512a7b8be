"""Suns in a panorama: small spots that give much of its light, taken out as lamps.

A photographed sky has its sun in a few pixels.  As a part of the sky it is found by those rays to the world that happen to go there, its shadows are
smoothed with the noise of the rest, and its patches behind windows are told by few particles.  As a lamp it gets rays, particles and sharp shadows of its own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .sharp import WIDEST_SUN
from .world import pixel_direction, row_angles

BRIGHT = 100.0  # times the mean radiance of the panorama, at least, of every pixel of a spot
SHARE = 0.01  # of the panorama's light, at least, that is worth a lamp
MOST = 4  # suns
_REACH, _AROUND = math.radians(2.5), math.radians(4.0)  # a spot lies within the one, about its centre, and nothing as bright between both
_STRAY = 0.02  # of a spot's light, at most, that is as bright between both
_LOOKED_AT = 64  # of the brightest places


class Sun(NamedTuple):
    """A sun disc taken out of a sky.

    direction: (3,) towards it.  irradiance: (3,) W/m^2 on a plane that faces it.  angle: diameter (rad).
    """

    direction: np.ndarray
    irradiance: np.ndarray
    angle: float


def take_out_suns(radiance: np.ndarray) -> tuple[np.ndarray, list[Sun]]:
    """The panorama (H, W, 3) float32, as of `World`, without its suns, and these, the strongest first; the same array where there are none.

    Irradiance and centre of a sun are those of its pixels, and so is its mean square width, whatever their shape.
    """
    height, width = radiance.shape[:2]
    if math.pi / height > WIDEST_SUN:  # a pixel is as wide
        return radiance, []
    value, angles = radiance.mean(axis=2), row_angles(height, width)
    total = float(value.sum(axis=1, dtype=np.float64) @ angles)
    bright = value > BRIGHT * total / (4 * np.pi)
    y, x = np.nonzero(bright)
    towards, light = pixel_direction(y, x, height, width), value[y, x] * angles[y]
    rest, suns, left = radiance, [], np.ones(len(y), bool)
    for _ in range(_LOOKED_AT):
        if len(suns) == MOST or not left.any():
            break
        first = np.argmax(np.where(left, value[y, x], -1))
        centre = _mean_direction(towards, light * (left & _within(towards, towards[first], _REACH)))
        spot = left & _within(towards, centre, _REACH)
        spot[first] = True
        beside = _within(towards, centre, _AROUND) & ~spot
        left &= ~spot
        if light[beside].sum() > _STRAY * light[spot].sum():  # a part of something larger
            continue
        sky = _sky_around(radiance, bright, centre, angles)
        above = np.maximum(radiance[y[spot], x[spot]] - sky, 0) * angles[y[spot], None]
        weight = above.mean(axis=1)
        if weight.sum() <= SHARE * total:
            continue
        centre = _mean_direction(towards[spot], weight)
        # Cycles draws straight lines from pixel to pixel: one alone is a tent, of the variance 1/6 both ways.
        own = (np.pi / height) ** 2 + (2 * np.pi / width) ** 2 * (1 - towards[spot, 2] ** 2)
        off = 2 * (1 - np.minimum(towards[spot] @ centre, 1)) + own / 6
        angle = 2 * math.sqrt(2 * float(weight @ off / weight.sum()))  # of an even disc half its squared radius
        if angle > WIDEST_SUN:
            continue
        rest = radiance.copy() if rest is radiance else rest
        rest[y[spot], x[spot]] = np.minimum(rest[y[spot], x[spot]], sky)
        suns.append(Sun(centre, above.sum(axis=0), angle))
    return rest, sorted(suns, key=lambda sun: -sun.irradiance.mean())


def _within(towards: np.ndarray, centre: np.ndarray, angle: float) -> np.ndarray:
    """Which directions (..., 3) lie within an angle (rad) of the centre (3,)."""
    return towards @ centre >= math.cos(angle)


def _mean_direction(towards: np.ndarray, weight: np.ndarray) -> np.ndarray:
    mean = weight @ towards
    return mean / np.linalg.norm(mean)


def _sky_around(radiance: np.ndarray, bright: np.ndarray, centre: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Mean radiance (3,) of what is not bright around a spot, float32."""
    height, width = bright.shape
    theta = math.acos(min(max(centre[2], -1), 1))
    top, bottom = (min(max(int(edge * height / np.pi), 0), height - 1) for edge in (theta - _AROUND, theta + _AROUND))
    rows = np.arange(top, bottom + 1)
    near = _within(pixel_direction(rows[:, None], np.arange(width), height, width), centre, _AROUND) & ~bright[rows]
    weight = near * angles[rows, None]
    return np.float32(np.einsum("hw,hwc->c", weight, radiance[rows]) / max(weight.sum(), 1e-30))
