"""Uniform sampling of what a rectangle and a triangle subtend, in float64, whatever the arguments.

Near lights, those seen at a slant and small ones leave no room for less: what they subtend is the difference of angles that are nearly the same.  Take the
distances of a rectangle's edges from the point in float64, too.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import leaf

_F = np.float64


@leaf(fast=False)
def sample_rectangle(x0, x1, y0, y1, height, u1, u2):
    """Point of the rectangle [x0, x1] x [y0, y1] in the plane z = height, uniform in solid angle from the origin.

    Urena, Fajardo & King 2013, "An Area-Preserving Parametrization for Spherical Rectangles", with the arc sines
    that keep small angles exact, as in Cycles.  height > 0.

    Returns:
        (x, y, solid angle in sr); area sampling and weight where the angle is too small to be resolved.
    """
    x0, x1, y0, y1, height, u1, u2 = _F(x0), _F(x1), _F(y0), _F(y1), _F(height), _F(u1), _F(u2)
    n0 = -y0 / math.sqrt(y0 * y0 + height * height)
    n1 = x1 / math.sqrt(x1 * x1 + height * height)
    n2 = y1 / math.sqrt(y1 * y1 + height * height)
    n3 = -x0 / math.sqrt(x0 * x0 + height * height)
    g0 = math.asin(-n0 * n1)
    g1 = math.asin(-n1 * n2)
    g2 = math.asin(-n2 * n3)
    g3 = math.asin(-n3 * n0)
    angle = -(g0 + g1 + g2 + g3)
    if not angle > 1e-9:
        x, y = x0 + u1 * (x1 - x0), y0 + u2 * (y1 - y0)
        r2 = x * x + y * y + height * height
        return x, y, (x1 - x0) * (y1 - y0) * height / (r2 * math.sqrt(r2))
    au = u1 * angle + g2 + g3
    sine = math.sin(au)
    fu = (math.cos(au) * n0 + n2) / sine if sine != 0.0 else math.copysign(1e300, math.cos(au) * n0 + n2)
    cu = math.copysign(1.0 / math.sqrt(fu * fu + n0 * n0), fu)
    cu = min(max(cu, -1.0), 1.0)
    # The paper's plane lies at -height, hence the sign.
    x = cu * height / max(math.sqrt(1.0 - cu * cu), 1e-12)
    x = min(max(x, x0), x1)
    d2 = x * x + height * height
    h0 = y0 / math.sqrt(d2 + y0 * y0)
    h1 = y1 / math.sqrt(d2 + y1 * y1)
    h = h0 + u2 * (h1 - h0)
    y = h * math.sqrt(d2 / max(1.0 - h * h, 1e-15))
    return x, min(max(y, y0), y1), angle


@leaf(fast=False)
def rectangle_angle(x0, x1, y0, y1, height):
    """Solid angle (sr) of the rectangle [x0, x1] x [y0, y1] in the plane z = height from the origin; height > 0."""
    x0, x1, y0, y1, height = _F(x0), _F(x1), _F(y0), _F(y1), _F(height)
    return _corner(x1, y1, height) - _corner(x0, y1, height) - _corner(x1, y0, height) + _corner(x0, y0, height)


@leaf(fast=False)
def _corner(x, y, height):
    return math.atan(x * y / (height * math.sqrt(x * x + y * y + height * height)))


@leaf(fast=False)
def triangle_angle(ax, ay, az, bx, by, bz, cx, cy, cz):
    """Solid angle (sr) of the triangle abc from the origin (Van Oosterom & Strackee 1983)."""
    ax, ay, az = _F(ax), _F(ay), _F(az)
    bx, by, bz = _F(bx), _F(by), _F(bz)
    cx, cy, cz = _F(cx), _F(cy), _F(cz)
    la, lb, lc = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz), math.sqrt(cx * cx + cy * cy + cz * cz)
    volume = abs(ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx))
    ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
    return 2.0 * math.atan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)


@leaf(fast=False)
def _angle_between(ax, ay, az, bx, by, bz):
    """Angle of two unit vectors, exact for nearly parallel ones (Kahan)."""
    if ax * bx + ay * by + az * bz < 0.0:
        return math.pi - 2.0 * math.asin(min(1.0, 0.5 * math.sqrt((ax + bx) ** 2 + (ay + by) ** 2 + (az + bz) ** 2)))
    return 2.0 * math.asin(min(1.0, 0.5 * math.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2)))


@leaf(fast=False)
def sample_triangle(ax, ay, az, bx, by, bz, cx, cy, cz, u1, u2):
    """Direction uniform in the solid angle of the triangle abc seen from the origin.

    Arvo 1995, "Stratified Sampling of Spherical Triangles", in the form of PBRT 4th ed., section 6.5.4.

    Returns:
        (x, y, z unit, solid angle in sr); the angle is 0 where it is too small or degenerate.
    """
    ax, ay, az = _F(ax), _F(ay), _F(az)
    bx, by, bz = _F(bx), _F(by), _F(bz)
    cx, cy, cz = _F(cx), _F(cy), _F(cz)
    u1, u2 = _F(u1), _F(u2)
    la, lb, lc = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz), math.sqrt(cx * cx + cy * cy + cz * cz)
    if la == 0.0 or lb == 0.0 or lc == 0.0:
        return 0.0, 0.0, 1.0, 0.0
    ax, ay, az = ax / la, ay / la, az / la
    bx, by, bz = bx / lb, by / lb, bz / lb
    cx, cy, cz = cx / lc, cy / lc, cz / lc
    # Normals of the three great circles.
    px, py, pz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    qx, qy, qz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    rx, ry, rz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    lp, lq, lr = math.sqrt(px * px + py * py + pz * pz), math.sqrt(qx * qx + qy * qy + qz * qz), math.sqrt(rx * rx + ry * ry + rz * rz)
    if lp == 0.0 or lq == 0.0 or lr == 0.0:
        return 0.0, 0.0, 1.0, 0.0
    px, py, pz, qx, qy, qz, rx, ry, rz = px / lp, py / lp, pz / lp, qx / lq, qy / lq, qz / lq, rx / lr, ry / lr, rz / lr
    alpha = _angle_between(px, py, pz, -rx, -ry, -rz)
    excess = alpha + _angle_between(qx, qy, qz, -px, -py, -pz) + _angle_between(rx, ry, rz, -qx, -qy, -qz) - math.pi
    if not excess > 1e-7:
        return 0.0, 0.0, 1.0, 0.0
    area = math.pi + u1 * excess
    cos_alpha, sin_alpha = math.cos(alpha), math.sin(alpha)
    sin_phi = math.sin(area) * cos_alpha - math.cos(area) * sin_alpha
    cos_phi = math.cos(area) * cos_alpha + math.sin(area) * sin_alpha
    k1 = cos_phi + cos_alpha
    k2 = sin_phi - sin_alpha * (ax * bx + ay * by + az * bz)
    below = (k2 * sin_phi + k1 * cos_phi) * sin_alpha
    cos_b = (k2 + (k2 * cos_phi - k1 * sin_phi) * cos_alpha) / below if below != 0.0 else 1.0
    cos_b = min(max(cos_b, -1.0), 1.0)
    sin_b = math.sqrt(1.0 - cos_b * cos_b)
    # c' on the arc from a to c.
    k = cx * ax + cy * ay + cz * az
    gx, gy, gz = cx - k * ax, cy - k * ay, cz - k * az
    g = 1.0 / math.sqrt(max(gx * gx + gy * gy + gz * gz, 1e-300))
    cx, cy, cz = cos_b * ax + sin_b * g * gx, cos_b * ay + sin_b * g * gy, cos_b * az + sin_b * g * gz
    # The direction on the arc from b to c'.
    k = cx * bx + cy * by + cz * bz
    cosine = 1.0 - u2 * (1.0 - k)
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    gx, gy, gz = cx - k * bx, cy - k * by, cz - k * bz
    g = 1.0 / math.sqrt(max(gx * gx + gy * gy + gz * gz, 1e-300))
    return cosine * bx + sine * g * gx, cosine * by + sine * g * gy, cosine * bz + sine * g * gz, excess
