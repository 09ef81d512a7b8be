"""What rough glass lets through: one surface from within, and both sides of a pane with all ways between them.

Each side is a GGX surface of microfacets that reflect and refract by Fresnel's equations (Walter et al. 2007, "Microfacet Models for Refraction through
Rough Surfaces"), as Cycles has it (kernel/closure/bsdf_microfacet.h).  What one reflects towards the surface, or refracts away from it, is lost, and
what neighbours mask; `MULTIPLE` gives both lobes so much more that nothing is lost, as Cycles' Multiscatter GGX does.  Within a pane light goes to and fro, by
directions of all angles: the geometric series of what a side reflects, over cosines.  Most of what is reflected totally at one facet is lost or comes
back to the same side: a pane of a roughness of .8 lets as much through as a smooth one.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf
from .ggx import cell, lerp2, visible_normals

F = np.float32
MULTIPLE, SINGLE, REFRACTING = 0, 1, 2  # kinds of glass; the last reflects nothing and loses what it does not refract
_Z, _ROUGHNESS, _COSINES = 10, 11, 14  # nodes per axis
_RADII, _ANGLES = 16, 10  # of the quadrature over visible normals
# Roughness up to which what a surface reflects from within has the edge of the critical angle, which no table holds, and from which on it is the table's.
_SHARP, _SOFT = F(0.2), F(0.4)


def _shadowing(cosine: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Smith's Lambda of GGX."""
    return 0.5 * (np.sqrt(1 + alpha * alpha * np.maximum(1 / np.square(np.maximum(cosine, 1e-6)) - 1, 0)) - 1)


def _reflected(cos_h: np.ndarray, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The dielectric Fresnel term, 1 where all is reflected, and the cosine beyond; ratio: the index there over that here."""
    root = 1 - (1 - cos_h * cos_h) / (ratio * ratio)
    beyond = np.sqrt(np.maximum(root, 0))
    across, along = (cos_h - ratio * beyond) / (cos_h + ratio * beyond), (ratio * cos_h - beyond) / (ratio * cos_h + beyond)
    return np.where(root > 0, 0.5 * (across * across + along * along), 1), beyond


def _sides(ratio: np.ndarray, roughness: np.ndarray, cosine: np.ndarray):
    """Of surfaces of each kind, what goes on by each visible normal of views of these cosines: cosine and weight (3 kinds, ..., Q) by refraction, and by reflection.

    The arguments broadcast together.
    """
    alpha, mu = np.square(roughness)[..., None], cosine[..., None]
    cos_h, h_z, weight = visible_normals(roughness, cosine, _RADII, _ANGLES)
    reflected, beyond = _reflected(cos_h, ratio[..., None])
    there, back = mu / ratio[..., None] - (cos_h / ratio[..., None] - beyond) * h_z, 2 * cos_h * h_z - mu
    here = 1 + _shadowing(mu, alpha)
    passed = weight * np.where((there > 0) & (reflected < 1), here / (here + _shadowing(there, alpha)), 0)
    kept = weight * np.where(back > 0, here / (here + _shadowing(back, alpha)) * reflected, 0)
    single = passed * (1 - reflected)
    whole = (single + kept).sum(-1, keepdims=True)
    return there, np.stack([single / whole, single, passed]), back, np.stack([kept / whole, kept, np.zeros_like(kept)])


def _over_cosines(cosine: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weights (..., Q) as a histogram (..., _COSINES) over the middles of as many parts of [0, 1], linearly between two of them."""
    x = np.clip(cosine, 0, 1) * _COSINES - 0.5
    i = np.clip(np.floor(x).astype(int), 0, _COSINES - 2)
    t = np.clip(x - i, 0, 1)
    rows = np.arange(weight[..., 0].size).reshape(weight.shape[:-1])[..., None] * _COSINES + i
    size = weight[..., 0].size * _COSINES
    found = np.bincount(rows.ravel(), (weight * (1 - t)).ravel(), size) + np.bincount(rows.ravel() + 1, (weight * t).ravel(), size)
    return found.reshape(*weight.shape[:-1], _COSINES)


def _tables() -> tuple[np.ndarray, np.ndarray]:
    """(3 kinds, z, cosine, roughness) what both sides of a pane let through more than smooth ones do, and what one surface lets out from within."""
    z = np.clip(np.linspace(0, 1, _Z), 0.03, 0.95)
    ior = ((1 + z * z) / (1 - z * z))[:, None, None]
    roughness = np.clip(np.linspace(0, 1, _ROUGHNESS), 0.03, 1)[:, None]
    node = np.clip(np.linspace(0, 1, _COSINES), 1e-2, 1)
    middle = (np.arange(_COSINES) + 0.5) / _COSINES
    _, passed, back, kept = _sides(1 / ior, roughness, middle)
    lost = np.eye(_COSINES) - np.linalg.matrix_power(_over_cosines(np.broadcast_to(back, kept.shape), kept), 2)
    out = np.linalg.solve(lost, passed.sum(-1)[..., None])  # (3, z, roughness, cosine, 1)
    there, passed, _, _ = _sides(ior, roughness, node)
    pane = (_over_cosines(np.broadcast_to(there, passed.shape), passed) @ out)[..., 0]
    smooth = (1 - (r := _reflected(node, ior)[0])) / (1 + r)
    pane -= np.stack([smooth, smooth, np.ones_like(smooth)])
    pane[:, :, 0] = 0
    within = _sides(1 / ior, roughness, node)[1].sum(-1)
    return tuple(np.ascontiguousarray(table.swapaxes(2, 3), F) for table in (pane, within))


PANE_TABLE, WITHIN_TABLE = _tables()


@inlined
def _looked_up(table, kind, z, cosine, roughness):
    k, c = cell(z, _Z)
    i, t = cell(cosine, _COSINES)
    j, r = cell(roughness, _ROUGHNESS)
    a = lerp2(table[kind, k], i, t, j, r)
    b = lerp2(table[kind, k + 1], i, t, j, r)
    return a + c * (b - a)


@leaf
def more_by_pane(kind, z, cosine, roughness):
    """What both sides of a pane let through more than smooth ones do, at `cosine` (0..1) outside; z: `ggx.ior_coordinate`."""
    return _looked_up(PANE_TABLE, kind, z, cosine, roughness)


@inlined
def _fresnel_within(cosine, ior):
    root = F(1) - ior * ior * (F(1) - cosine * cosine)
    if not root > F(0):
        return F(1)
    beyond = F(math.sqrt(root))
    across, along = (ior * cosine - beyond) / (ior * cosine + beyond), (cosine - ior * beyond) / (cosine + ior * beyond)
    return F(0.5) * (across * across + along * along)


@leaf
def passed_from_within(kind, ior, z, cosine, roughness):
    """What one surface lets out (0..1) of light that comes from within it at `cosine` (0..1): of smooth ones nothing beyond the critical angle.

    Of surfaces that are hardly rough the mean over visible normals of which those that lean across the plane of incidence count as if they did not.
    """
    rough = _looked_up(WITHIN_TABLE, kind, z, cosine, roughness)
    if roughness >= _SOFT:
        return rough
    alpha = roughness * roughness
    if alpha < F(1e-3):
        reflected = _fresnel_within(cosine, ior)
        passed = F(1) - reflected if kind != REFRACTING or not reflected < F(1) else F(1)
    else:
        sine = F(math.sqrt(max(F(1) - cosine * cosine, F(0))))
        passed = seen = F(0)
        for k in range(8):
            x = F(0.25) * (F(k) + F(0.5)) - F(1)
            slope = alpha * x / F(math.sqrt(F(1) - x * x))
            weight = max(cosine + slope * sine, F(0))
            reflected = _fresnel_within(min(weight / F(math.sqrt(F(1) + slope * slope)), F(1)), ior)
            passed += weight * (F(1) - reflected if kind != REFRACTING or not reflected < F(1) else F(1))
            seen += weight
        passed /= seen
    t = min(max((roughness - _SHARP) / (_SOFT - _SHARP), F(0)), F(1))
    return passed + t * (rough - passed)
