"""Albedo tables of the GGX microfacet lobe, as Cycles' Principled BSDF layers with them.

A dielectric lobe of roughness r and index of refraction n over a diffuse base takes the share

    L(mu) = (f0 + (1 - f0) s(r, mu, n)) (E(r, mu) + Fms (1 - E(r, mu)))

of the light that arrives at cosine mu: s is how far the Fresnel term, seen through the lobe's visible
normals, has risen from f0 to 1; E is the albedo of the single-scattering lobe without Fresnel; Fms is
the Fresnel term of the light scattered more than once (Kulla and Conty 2017, "Revisiting physically
based shading at Imageworks", appendix).  The base keeps 1 - L.

The tables have the sizes, axes and linear interpolation of Cycles' own (16^3 for s, 32^2 for E), so
that L follows Cycles between their nodes too; here they come from quadrature over the visible normals
(Heitz 2018, "Sampling the GGX distribution of visible normals").
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined

_S = 16  # nodes per axis of s: z (index of refraction), cosine, roughness
_E = 32  # nodes per axis of E: cosine, roughness
_RADII, _ANGLES = 32, 20  # quadrature over half of the disk of visible normals
F = np.float32
# Schlick's rise at 82 degrees, whose cosine is 1 / 7, and the inverse of c (1 - c)^6 there.
SCHLICK_82 = F((6 / 7) ** 5)
EDGE = F(7 / (6 / 7) ** 6)


def ior_coordinate(ior: float) -> float:
    """Coordinate z of an index of refraction in the table of s: f0^(1/4)."""
    return float(np.sqrt(abs((ior - 1.0) / (ior + 1.0))))


def visible_normals(
    roughness: np.ndarray, mu: np.ndarray, radii: int = _RADII, angles: int = _ANGLES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Quadrature over the visible normals h of views with cosine `mu`: (h . view, the cosine of h, weight).

    The arguments broadcast together, the `radii` x `angles` quadrature points are the last axis, along which the weights add up to 1.  Radii crowd at
    the disk's rim, which holds the long tails of narrow lobes.
    """
    alpha = np.square(roughness)[..., None]
    mu = mu[..., None]
    sine = np.sqrt(1 - mu * mu)
    inner = 1 - (np.arange(radii) + 0.5) / radii  # sqrt(1 - radius^2)
    weight = np.repeat(inner, angles)
    radius = np.sqrt(1 - np.square(inner))[:, None]
    angle = (np.arange(angles) + 0.5) * (np.pi / angles)
    x, y = (radius * np.sin(angle)).ravel(), (radius * np.cos(angle)).ravel()
    # Heitz 2018, listing 1, with the view in the plane x = 0 so that the disk's x is the symmetric axis.
    stretched = np.sqrt(np.square(alpha * sine) + mu * mu)
    vy, vz = alpha * sine / stretched, mu / stretched
    s = 0.5 * (1 + vz)
    y = (1 - s) * np.sqrt(1 - x * x) + s * y
    z = np.sqrt(np.maximum(0, 1 - x * x - y * y))
    hx, hy, hz = alpha * x, alpha * (z * vy - y * vz), np.maximum(0, y * vy + z * vz)
    norm = 1 / np.sqrt(hx * hx + hy * hy + hz * hz)
    hy, hz = hy * norm, hz * norm
    return hy * sine + hz * mu, hz, weight / weight.sum()


def _mirrored(roughness: np.ndarray, mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(h . view, outgoing cosine) at the visible normals, for `_mean`."""
    cos_h, h_z, _ = visible_normals(roughness, mu)
    return cos_h, 2 * cos_h * h_z - mu[..., None]


def _mean(values: np.ndarray) -> np.ndarray:
    """Mean over the quadrature points of `_mirrored`, the last axis."""
    weight = np.repeat(1 - (np.arange(_RADII) + 0.5) / _RADII, _ANGLES)
    return values @ (weight / weight.sum())


def _fresnel_rise(cos_h: np.ndarray, ior: float) -> np.ndarray:
    """(F - f0) / (1 - f0) of the dielectric Fresnel term."""
    g = np.sqrt(ior * ior - 1 + cos_h * cos_h)
    a = (g - cos_h) / (g + cos_h)
    b = (cos_h * (g + cos_h) - 1) / (cos_h * (g - cos_h) + 1)
    f0 = ((ior - 1) / (ior + 1)) ** 2
    return np.clip((0.5 * a * a * (1 + b * b) - f0) / (1 - f0), 0, 1)


def _table_s() -> np.ndarray:
    """(16, 16, 16) s over (z, cosine, roughness)."""
    node = np.clip(np.arange(_S, dtype=F) / F(_S - 1), F(1e-4), F(1))
    cos_h, cos_out = _mirrored(node[None, :], node[:, None])
    f0_quarter = np.clip(node, 1e-4, 0.99)
    iors = (1 + f0_quarter**2) / (1 - f0_quarter**2)
    above = cos_out > 0
    return np.stack([_mean(np.where(above, _fresnel_rise(cos_h, n), 0)) for n in iors]).astype(F)


def _table_dip() -> np.ndarray:
    """(16, 16) over (cosine, roughness): mean of c (1 - c)^6 over the cosines c of the visible normals with the view."""
    node = np.clip(np.arange(_S, dtype=F) / F(_S - 1), F(1e-4), F(1))
    cos_h, cos_out = _mirrored(node[None, :], node[:, None])
    return _mean(np.where(cos_out > 0, cos_h * (1 - cos_h) ** 6, 0)).astype(F)


def _table_e() -> np.ndarray:
    """(32, 32) E over (cosine, roughness): mean of G2 / G1 over the visible normals."""
    node = np.clip(np.arange(_E, dtype=F) / F(_E - 1), F(1e-4), F(1))
    mu = node[:, None]
    _, cos_out = _mirrored(node[None, :], mu)
    alpha2 = (node**4)[None, :]

    def smith_lambda(cosine, alpha2):
        return 0.5 * (np.sqrt(1 + alpha2 * np.maximum(1 / np.square(cosine) - 1, 0)) - 1)

    lambda_in = smith_lambda(mu, alpha2)[..., None]
    lambda_out = smith_lambda(np.maximum(cos_out, F(1e-6)), alpha2[..., None])
    return _mean(np.where(cos_out > 0, (1 + lambda_in) / (1 + lambda_in + lambda_out), 0)).astype(F)


def _resample(table: np.ndarray, axis: int, size: int) -> np.ndarray:
    """The piecewise linear function along `axis`, at `size` equidistant midpoints."""
    x = (np.arange(size) + 0.5) / size * (table.shape[axis] - 1)
    i = x.astype(int)
    t = (x - i).reshape([-1 if a == axis else 1 for a in range(table.ndim)])
    return np.take(table, i, axis) * (1 - t) + np.take(table, i + 1, axis) * t


def _means(s: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cosine-weighted means over the hemisphere: of E (32,), of s and of s E (16, 16) over (z, roughness)."""
    n = 120
    weight = 2 * ((np.arange(n) + 0.5) / n) / n
    e_fine = _resample(e, 0, n)
    s_fine = _resample(s, 1, n)
    # E at the nodes of the roughness axis of s
    x = np.linspace(0, _E - 1, _S)
    i = np.minimum(x.astype(int), _E - 2)
    e_at = e_fine[:, i] * (1 - (x - i)) + e_fine[:, i + 1] * (x - i)
    return (
        np.einsum("m,mr->r", weight, e_fine).astype(F),
        np.einsum("m,zmr->zr", weight, s_fine).astype(F),
        np.einsum("m,zmr,mr->zr", weight, s_fine, e_at).astype(F),
    )


S_TABLE = _table_s()
E_TABLE = _table_e()
DIP_TABLE = _table_dip()
E_MEAN, S_MEAN, SE_MEAN = _means(S_TABLE, E_TABLE)


@inlined
def cell(x, size):
    """Index and fraction of a table coordinate in 0..1."""
    x = min(max(x, F(0)), F(1)) * F(size - 1)
    i = min(np.int32(x), np.int32(size - 2))
    return i, x - F(i)


@inlined
def lerp2(table, i, t, j, r):
    a = table[i, j] + r * (table[i, j + 1] - table[i, j])
    b = table[i + 1, j] + r * (table[i + 1, j + 1] - table[i + 1, j])
    return a + t * (b - a)


@inlined
def fresnel_rise(z, cosine, roughness):
    """s: how far from f0 to 1 the lobe's Fresnel term is at `cosine`; z as in `ior_coordinate`."""
    k, c = cell(z, _S)
    i, t = cell(cosine, _S)
    j, r = cell(roughness, _S)
    a = lerp2(S_TABLE[k], i, t, j, r)
    b = lerp2(S_TABLE[k + 1], i, t, j, r)
    return a + c * (b - a)


@inlined
def edge(f0, rise):
    """By how much, times c (1 - c)^6, a black tint at 82 degrees (c = 1/7) lowers Schlick's term f0 + rise (1 - c)^5: there to 0 (Kutz et al. 2021)."""
    return EDGE * (f0 + SCHLICK_82 * rise)


@inlined
def edge_dip(cosine, roughness):
    """c (1 - c)^6 as a lobe sees it at `cosine`, c that of its visible normals with the view."""
    i, t = cell(cosine, _S)
    j, r = cell(roughness, _S)
    return lerp2(DIP_TABLE, i, t, j, r)


@inlined
def single_scattering(cosine, roughness):
    """E: albedo of the lobe without Fresnel term at `cosine`."""
    i, t = cell(cosine, _E)
    j, r = cell(roughness, _E)
    return lerp2(E_TABLE, i, t, j, r)


@inlined
def single_scattering_mean(roughness):
    """Mean of E over the cosine-weighted hemisphere."""
    j, r = cell(roughness, _E)
    return E_MEAN[j] + r * (E_MEAN[j + 1] - E_MEAN[j])


@inlined
def layer_albedo(f0, z, roughness, multiple, cosine):
    """L(mu) of the module's head; `multiple` is Fms (1 where the lobe keeps no multiple scattering)."""
    s = fresnel_rise(z, cosine, roughness)
    e = single_scattering(cosine, roughness)
    return (f0 + (F(1) - f0) * s) * (e + multiple * (F(1) - e))


@inlined
def layer_albedo_mean(f0, z, roughness, multiple):
    """Mean of `layer_albedo` over the cosine-weighted hemisphere."""
    k, c = cell(z, _S)
    j, r = cell(roughness, _S)
    s = lerp2(S_MEAN, k, c, j, r)
    se = lerp2(SE_MEAN, k, c, j, r)
    e = single_scattering_mean(roughness)
    return f0 * (e + multiple * (F(1) - e)) + (F(1) - f0) * (multiple * s + (F(1) - multiple) * se)


@inlined
def multiple_scattering(mean_fresnel, roughness):
    """Fms of a lobe whose Fresnel term has the mean `mean_fresnel` over the hemisphere."""
    e = single_scattering_mean(roughness)
    return mean_fresnel * e / (F(1) - mean_fresnel * (F(1) - e))


@inlined
def dielectric_mean_fresnel(ior):
    """Cosine-weighted mean of the dielectric Fresnel term (fit by Kulla and Conty 2017)."""
    if ior < F(1):
        return F(0.997118) + ior * (F(0.1014) - ior * (F(0.965241) + ior * F(0.130607)))
    return (ior - F(1)) / (F(4.08567) + F(1.00071) * ior)
