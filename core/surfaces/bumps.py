"""Bump mapping: a normal turned by the slope of a height over the surface (Mikkelsen 2010, "Bump Mapping Unparametrized
Surfaces on the GPU"), as Cycles' Bump node does (kernel/svm/displace.h, svm_node_set_bump).

The slope is measured over two steps at right angles in the plane of the triangle.  They are Cycles' in direction and length, so
that what a step is too long for looks the same.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined

F = np.float32
_SMALLEST = F(1e-20)
_CELLS = 16


def _mean(cosine: float) -> float:
    """What `shadowing` leaves of even light from above the surface, where the normal makes an angle of `cosine` with the surface's own."""
    sine, tangent2 = math.sqrt(1 - cosine * cosine), (1 - cosine * cosine) / max(cosine * cosine, 1e-12)
    z, turn = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(128) + 0.5) * (math.pi / 128))
    lit = np.maximum(sine * np.sqrt(1 - z * z) * np.cos(turn) + cosine * z, 0)
    passed = 2 / (1 + np.sqrt(1 + min(0.125 * tangent2, 1.0) * (1 / (z * z) - 1)))
    return float((lit * passed).sum() / lit.sum())


_MEAN = np.array([_mean(k / _CELLS) for k in range(_CELLS + 1)], F)


@inlined
def _tangents(mx, my, mz):
    """Two unit vectors at right angles to the unit vector m: those of Cycles (make_orthonormals)."""
    if mx != my or mx != mz:
        tx, ty, tz = mz - my, mx - mz, my - mx
    else:
        tx, ty, tz = mz - my, mx + mz, -my - mx
    s = F(1) / F(math.sqrt(tx * tx + ty * ty + tz * tz))
    tx, ty, tz = s * tx, s * ty, s * tz
    return tx, ty, tz, my * tz - mz * ty, mz * tx - mx * tz, mx * ty - my * tx


@inlined
def _face(ex, ey, ez, fx, fy, fz):
    """Unit normal of a triangle with the edges e and f from its first corner, and twice its area (0: no normal)."""
    mx, my, mz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    area = F(math.sqrt(mx * mx + my * my + mz * mz))
    s = F(1) / area if area > _SMALLEST else F(0)
    return s * mx, s * my, s * mz, area


@inlined
def steps(ex, ey, ez, fx, fy, fz, step, facing):
    """Steps (u, v), (u, v) in barycentric coordinates that go `step` (m) along the tangents; none on a triangle without area.

    facing: 1 for the front of the triangle; -1 for its back, whose first tangent is the opposite one.
    """
    mx, my, mz, area = _face(ex, ey, ez, fx, fy, fz)
    if not area > _SMALLEST:
        return F(0), F(0), F(0), F(0)
    tx, ty, tz, bx, by, bz = _tangents(mx, my, mz)
    s = step / area
    ux, uy, uz = s * (fy * mz - fz * my), s * (fz * mx - fx * mz), s * (fx * my - fy * mx)
    vx, vy, vz = s * (my * ez - mz * ey), s * (mz * ex - mx * ez), s * (mx * ey - my * ex)
    return (
        facing * (tx * ux + ty * uy + tz * uz),
        facing * (tx * vx + ty * vy + tz * vz),
        bx * ux + by * uy + bz * uz,
        bx * vx + by * vy + bz * vz,
    )


@inlined
def gradient(ex, ey, ez, fx, fy, fz, rise_x, rise_y, step, facing):
    """The gradient, in the triangle's plane, of what rises so much over `step` (m) along the tangents."""
    mx, my, mz, area = _face(ex, ey, ez, fx, fy, fz)
    if not area > _SMALLEST or not step > _SMALLEST:
        return F(0), F(0), F(0)
    tx, ty, tz, bx, by, bz = _tangents(mx, my, mz)
    dx, dy = facing * rise_x / step, rise_y / step
    return dx * tx + dy * bx, dx * ty + dy * by, dx * tz + dy * bz


@inlined
def bumped_normal(nx, ny, nz, dx, dy, dz, strength, mx, my, mz):
    """Unit normal: n turned against the gradient d of a height over a face of normal m (of any length and sign).

    strength: the share of the bump, more than 1 exaggerates it.

    Cycles sums up tangents times rises, (m x d) x n = d (m . n) - m (n . d), and divides by the determinant m . n.
    """
    s = F(1) / max(F(math.sqrt(nx * nx + ny * ny + nz * nz)), _SMALLEST)
    nx, ny, nz = s * nx, s * ny, s * nz
    s = F(1) / max(F(math.sqrt(mx * mx + my * my + mz * mz)), _SMALLEST)
    det = s * (mx * nx + my * ny + mz * nz)
    if not abs(det) > F(1e-6):
        return nx, ny, nz
    s *= (nx * dx + ny * dy + nz * dz) / det
    x, y, z = nx - dx + s * mx, ny - dy + s * my, nz - dz + s * mz
    s = strength / max(F(math.sqrt(x * x + y * y + z * z)), _SMALLEST)
    rest = F(1) - strength
    x, y, z = s * x + rest * nx, s * y + rest * ny, s * z + rest * nz
    s = F(1) / max(F(math.sqrt(x * x + y * y + z * z)), _SMALLEST)
    return s * x, s * y, s * z


@inlined
def tilt_of(nx, ny, nz, sx, sy, sz):
    """|cosine| between a unit normal n and the surface's own s, not 0."""
    s = F(1) / max(F(math.sqrt(sx * sx + sy * sy + sz * sz)), _SMALLEST)
    return min(max(abs(s * (nx * sx + ny * sy + nz * sz)), F(1e-3)), F(1))


@inlined
def shadowing(tilt, cosine):
    """What bumps leave of the light that a diffuse surface gets from a direction at `cosine` to its own normal (0..1).

    Cycles' bump_shadowing_term: the GGX shadowing of bumps so steep as `tilt` is (Conty Estevez, Lecocq and Stein 2019, "A
    Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem").  tilt: of `tilt_of`, 0 for no bumps.
    """
    if tilt <= F(0) or tilt >= F(1):
        return F(1)
    alpha2 = min(F(0.125) * (F(1) / (tilt * tilt) - F(1)), F(1))
    c2 = max(cosine * cosine, F(1e-8))
    return F(2) / (F(1) + F(math.sqrt(F(1) + alpha2 * max(F(1) / c2 - F(1), F(0)))))


@inlined
def mean_shadowing(tilt):
    """The mean of `shadowing` for even light."""
    if tilt <= F(0):
        return F(1)
    at = F(_CELLS) * tilt
    k = min(int(at), _CELLS - 1)
    return _MEAN[k] + (at - F(k)) * (_MEAN[k + 1] - _MEAN[k])
