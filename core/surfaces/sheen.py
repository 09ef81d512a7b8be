"""Sheen: lobes of cloth and dust, which shine towards the rims of things and back to where light comes from.

Two closures of Cycles.  The microfibre sheen of the Principled BSDF and the Sheen BSDF (kernel/closure/bsdf_sheen.h; Zeltner, Burley and Chiang 2022, "Practical
Multiple-Scattering Sheen Using Linearly Transformed Cosines") is E(v) times the density of a cosine lobe that a matrix of two numbers, a and b, by view
and roughness, transforms.  Cycles reads E, a and b from tables; here they are the fits of MaterialX, which differ from them by up to .02
in E.  The Ashikhmin velvet (kernel/closure/bsdf_ashikhmin_velvet.h; Ashikhmin, Premoze and Shirley 2000, "A microfacet-based BRDF generator") has
the distribution of normals exp(-cot^2 h / s^2) / (pi s^2 sin^4 h) and the V grooves' masking.

A roughness below 0 is a velvet's.  Both are diffuse closures to Cycles.  Here their albedo for a view is part of the diffuse one, and the lobe's
shape, relative to that of a Lambert lobe of as much albedo, weighs light by its direction.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf

F = np.float32
_SMALLEST = F(0.01)
_SIZE = 32  # nodes of the velvet's table along either axis
_0 = F(0)
_1 = F(1)


@inlined
def _fibre_albedo(cosine, roughness):
    """E of the microfibre lobe, by the fit of MaterialX."""
    x, y = cosine, max(roughness, _SMALLEST)
    s = y * (F(0.0206607) + F(1.58491) * y) / (F(0.0379424) + y * (F(1.32227) + y))
    m = y * (F(-0.193854) + y * (F(-1.14885) + y * (F(1.7932) - F(0.95943) * y * y))) / (F(0.046391) + y)
    o = y * (F(0.000654023) + (F(-0.0207818) + F(0.119681) * y) * y) / (F(1.26264) + y * (F(-1.92021) + y))
    t = (x - m) / s
    return min(max(np.exp(F(-0.5) * t * t) / (s * F(2.5066283)) + o, F(0)), F(1))


def _velvet_albedo(cosine: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Albedo (C, S) of the velvet for views at `cosine` (C,), of spreads (S,), by quadrature over its normals h.

    By t = cot h / s, whose density is nearly that of a Gaussian.  This is done on every start: over directions of light it takes over twenty times as long.
    """
    n, m = 32, 64
    t, turn = (np.arange(n)[:, None] + 0.5) * (4 / n), (np.arange(m) + 0.5) * np.pi / m
    c, s = cosine[:, None, None, None], spread[:, None, None]
    sine = 1 / np.sqrt(1 + (s * t) ** 2)
    h = s * t * sine
    between = np.sqrt(1 - c * c) * sine * np.cos(turn) + c * h
    light = 2 * between * h - c
    shown = np.minimum(np.minimum(between / c, 2 * h), 2 * h * light / c)  # the masking, times (h . view) / c
    return (8 * np.exp(-t * t) / (s * sine) * np.where((light > 0) & (between > 0), shown, 0)).mean((2, 3))


_NODES = np.maximum(np.arange(_SIZE) / (_SIZE - 1), 1e-2)
_VELVET = _velvet_albedo(_NODES, _NODES).astype(F)


def _mean(albedo: np.ndarray) -> np.ndarray:
    """(R,) cosine-weighted means of albedos (C, R) at the middles of even steps of the cosine."""
    weight = np.arange(len(albedo)) + 0.5
    return (weight @ albedo / weight.sum()).astype(F)


def _fibre_means() -> np.ndarray:
    """Means of E at the nodes of the roughness."""
    cosine = (np.arange(24) + 0.5) / 24
    return _mean(np.array([[_fibre_albedo.py_func(F(c), F(r)) for r in _NODES] for c in cosine]))


def _velvet_means() -> np.ndarray:
    """Means of the table at the nodes of the spread."""
    cosine = (np.arange(256) + 0.5) / 256
    return _mean(np.stack([np.interp(cosine * (_SIZE - 1), np.arange(_SIZE), column) for column in _VELVET.T], 1))


_FIBRE_MEAN = _fibre_means()
_VELVET_MEAN = _velvet_means()


@inlined
def _at(x):
    """Index and fraction of a table coordinate in 0..1."""
    x = min(max(x, _0), _1) * F(_SIZE - 1)
    i = min(np.int32(x), np.int32(_SIZE - 2))
    return i, x - F(i)


@leaf
def albedo(cosine, roughness):
    """Albedo of the lobe for a view at `cosine` (0..1)."""
    if roughness >= _0:
        return _fibre_albedo(cosine, roughness)
    i, t = _at(cosine)
    j, s = _at(-roughness)
    a = _VELVET[i, j] + s * (_VELVET[i, j + 1] - _VELVET[i, j])
    b = _VELVET[i + 1, j] + s * (_VELVET[i + 1, j + 1] - _VELVET[i + 1, j])
    return a + t * (b - a)


@leaf
def albedo_average(roughness):
    """Mean of `albedo` over the cosine-weighted hemisphere."""
    j, s = _at(abs(roughness))
    if roughness >= _0:
        return _FIBRE_MEAN[j] + s * (_FIBRE_MEAN[j + 1] - _FIBRE_MEAN[j])
    return _VELVET_MEAN[j] + s * (_VELVET_MEAN[j + 1] - _VELVET_MEAN[j])


@leaf
def lit_from(roughness, light):
    """How much light from a direction at the cosine `light` a surface scatters by the lobe, to all sides together, over what its mean albedo says.

    The lobes look alike from both ends, nearly: this is the albedo for a view from there.
    """
    return albedo(min(max(light, _0), _1), roughness) / max(albedo_average(roughness), F(1e-6))


@leaf
def shape(roughness, light, view, between):
    """How bright light from one direction makes the lobe, over even light of the same irradiance: its mean over the hemisphere, by cosine, is 1.

    light, view: cosines of the directions to light and view with the normal, below 0 from behind;  between: with each other.
    """
    if light <= _0:
        return _1
    if roughness >= _0:
        # A bump that faces away is seen along its pile, from its own side, as by Cycles: not at all evenly.
        y, x = max(roughness, _SMALLEST), min(max(view, _0), _1)
        a = (F(2.58126) * x + F(0.813703) * y) * y / (_1 + F(0.310327) * x * x + F(2.60994) * x * y)
        b = F(math.sqrt(_1 - x)) * (y - _1) * y * y * y / (F(0.0000254053) + F(1.71228) * x - F(1.71506) * x * y + F(1.34174) * y * y)
        # The part of the light's direction along the surface, towards the viewer and across.
        sine = F(math.sqrt(max(_1 - view * view, F(1e-12))))
        along = (between - light * view) / sine
        across2 = max(_1 - light * light - along * along, _0)
        length2 = (a * along + b * light) ** 2 + a * a * across2 + light * light
        a /= length2
        return a * a
    if view <= _0:
        return _0
    s = max(-roughness, _SMALLEST)
    half2 = max(F(0.5) * (_1 + between), F(1e-9))  # squared cosine of the view with the half vector
    cos_h2 = (light + view) * (light + view) / (F(4) * half2)
    ratio = (light + view) / (F(2) * half2)
    masked = min(_1, F(2) * ratio * min(light, view))
    sine2 = max(_1 - cos_h2, F(1e-7))
    normals = F(math.exp(-cos_h2 / (sine2 * s * s))) / (s * s * sine2 * sine2)
    return F(0.25) * normals * masked / (view * light * max(albedo(view, roughness), F(1e-6)))


@leaf
def factors(sheen, sx, sy, sz, vx, vy, vz, dx, dy, dz):
    """What a surface reflects diffusely of light from d, seen from v, over what its albedo says, by channel.

    sheen: (4,) float32, the lobe's share of the albedo (rgb), and its roughness.  s: shading normal; all vectors unit.
    """
    more = shape(sheen[3], sx * dx + sy * dy + sz * dz, sx * vx + sy * vy + sz * vz, dx * vx + dy * vy + dz * vz) - _1
    return _1 + sheen[0] * more, _1 + sheen[1] * more, _1 + sheen[2] * more
