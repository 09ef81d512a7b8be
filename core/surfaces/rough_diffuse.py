"""Rough diffuse surfaces, as Cycles' Oren-Nayar closure has them (kernel/closure/bsdf_oren_nayar.h).

The model of Oren and Nayar (1994) in the form of Fujii ("A tiny improvement of Oren-Nayar reflectance model"), and light that is scattered more
than once (OpenPBR specification).  With a = 1 / (pi + s (pi / 2 - 2 / 3)), b = s a for a roughness s, the colour rho, the cosines nl and nv of light and
view and t = l.v - nl nv, over max(nl, nv) where it is positive,

    f = rho (a + b t + M (1 - E(nl)) (1 - E(nv))),   E(c) = pi a + b G(c),   M = rho^2 / pi Em / (1 - Em) / (1 - rho (1 - Em)),

where Em is the cosine-weighted mean of E.  So the albedo towards v is rho (E(nv) + (1 - E(nv)) K), with K = rho^2 Em / (1 - rho (1 - Em)).
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf

F = np.float32
_PI = F(math.pi)
_SINGLE = F(math.pi / 2 - 2 / 3)
_MEAN = F((2 * math.pi - 5.6) / 3)
_TWO_THIRDS = F(2 / 3)
_MIDDLE = F(0.5)  # colour by which light scattered more than once, which is little, is shared out over directions


@inlined
def _a(roughness):
    return F(1) / (_PI + min(roughness, F(1)) * _SINGLE)


@leaf
def _directional(roughness, cosine):
    """E: albedo towards a cosine by light that is scattered once, of a white surface."""
    c = min(max(cosine, F(0)), F(1))
    sine = F(math.sqrt(F(1) - c * c))
    if c < F(1e-6):
        g = _SINGLE - c
    else:
        g = sine * (F(math.acos(c)) - _TWO_THIRDS - sine * c) + _TWO_THIRDS * (sine / c) * (F(1) - sine * sine * sine)
    a = _a(roughness)
    return a * (_PI + min(roughness, F(1)) * g)


@inlined
def _mean(roughness):
    """Em: the cosine-weighted mean of E."""
    return _a(roughness) * (_PI + min(roughness, F(1)) * _MEAN)


@inlined
def _again(color, mean):
    """K: what is left, of light that is not scattered once only."""
    rho = min(max(color, F(0)), F(1))
    return rho * rho * mean / (F(1) - rho * (F(1) - mean))


@leaf
def kept(roughness, cosine, r, g, b):
    """Albedo (r, g, b) towards a view at `cosine` (0..1) over that of a smooth surface, for the colour (r, g, b)."""
    mean, e = _mean(roughness), _directional(roughness, cosine)
    rest = F(1) - e
    return e + rest * _again(r, mean), e + rest * _again(g, mean), e + rest * _again(b, mean)


@leaf
def kept_average(roughness, r, g, b):
    """The mean of `kept` over the cosine-weighted hemisphere."""
    mean = _mean(roughness)
    rest = F(1) - mean
    return mean + rest * _again(r, mean), mean + rest * _again(g, mean), mean + rest * _again(b, mean)


@leaf
def shape(roughness, light, view, between):
    """How bright light from one direction makes a surface, over even light of the same irradiance: its mean over the hemisphere, by cosine, is 1.

    light, view: cosines of the directions to light and view with the normal;  between: with each other.
    """
    if light <= F(0) or view <= F(0):
        return F(1)
    a, mean, e = _a(roughness), _mean(roughness), _directional(roughness, view)
    t = between - light * view
    if t > F(0):
        t /= max(light, view)
    more = _again(_MIDDLE, mean) * (F(1) - e)
    return (_PI * a * (F(1) + min(roughness, F(1)) * t) + more * (F(1) - _directional(roughness, light)) / (F(1) - mean)) / (e + more)
