"""The GGX lobe: sampling and evaluation of reflection, without Fresnel term.

Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces"; height-correlated Smith masking;
visible normals sampled by spherical caps (Dupuy & Benyoub 2023).  alpha = roughness^2, as Blender has it.
Vectors are local: z is the shading normal.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined

SMALLEST_ALPHA = np.float32(1e-4)
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_PI = np.float32(math.pi)
_2PI = np.float32(2 * math.pi)


@inlined
def smith_lambda(z, alpha):
    """Lambda of a direction with the cosine z."""
    z2 = max(z * z, np.float32(1e-12))
    return np.float32(0.5) * (np.float32(math.sqrt(_1 + alpha * alpha * max(_0, _1 - z2) / z2)) - _1)


@inlined
def reflect_by_facet(ox, oy, oz, alpha, u1, u2):
    """The direction i in which a visible microfacet, drawn at random, reflects; it may point below."""
    # Stretch, sample the cap of the sphere that is seen, unstretch.
    sx, sy, sz = alpha * ox, alpha * oy, oz
    inverse = _1 / np.float32(math.sqrt(sx * sx + sy * sy + sz * sz))
    sx, sy, sz = sx * inverse, sy * inverse, sz * inverse
    phi = _2PI * u1
    cz = (_1 - u2) * (_1 + sz) - sz
    sine = np.float32(math.sqrt(max(_0, _1 - cz * cz)))
    hx, hy, hz = sine * np.float32(math.cos(phi)) + sx, sine * np.float32(math.sin(phi)) + sy, cz + sz
    hx, hy, hz = alpha * hx, alpha * hy, max(hz, np.float32(1e-9))
    inverse = _1 / np.float32(math.sqrt(hx * hx + hy * hy + hz * hz))
    hx, hy, hz = hx * inverse, hy * inverse, hz * inverse
    twice = np.float32(2.0) * (ox * hx + oy * hy + oz * hz)
    return twice * hx - ox, twice * hy - oy, twice * hz - oz


@inlined
def sample_reflection(ox, oy, oz, alpha, u1, u2):
    """A direction i reflected by a visible microfacet -> (ix, iy, iz, weight).

    weight = (lobe * cosine / density) of the lobe without Fresnel term: G2 / G1; 0 where i points below.
    """
    ix, iy, iz = reflect_by_facet(ox, oy, oz, alpha, u1, u2)
    if iz <= _0:
        return ix, iy, iz, _0
    lo, li = smith_lambda(oz, alpha), smith_lambda(iz, alpha)
    return ix, iy, iz, (_1 + lo) / (_1 + lo + li)


@inlined
def reflection(ox, oy, oz, ix, iy, iz, alpha):
    """The lobe without Fresnel term times the cosine at i, for unit directions o, i above the surface (1/sr)."""
    hx, hy, hz = ox + ix, oy + iy, oz + iz
    inverse = _1 / max(np.float32(math.sqrt(hx * hx + hy * hy + hz * hz)), np.float32(1e-12))
    hx, hy, hz = hx * inverse, hy * inverse, hz * inverse
    a2 = alpha * alpha
    # (1 - z^2) from x and y: exact for narrow lobes.
    t = hz * hz + (hx * hx + hy * hy) / a2
    d = _1 / (_PI * a2 * t * t)
    return d / (np.float32(4.0) * max(oz, np.float32(1e-6)) * (_1 + smith_lambda(oz, alpha) + smith_lambda(iz, alpha)))
