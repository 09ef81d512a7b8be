"""Shading normals at a hit."""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined
from ..scene import COVERED, NORMAL_MAPPED
from .arithmetic import normalized
from .layout import NORMAL


@inlined
def shading_normal(corner_normals, triangle, u, v, gx, gy, gz):
    """Unit interpolated normal; the geometric one (g, unit) where the corners' normals cancel or are not finite."""
    w = np.float32(1.0) - u - v
    x = w * corner_normals[triangle, 0, 0] + u * corner_normals[triangle, 1, 0] + v * corner_normals[triangle, 2, 0]
    y = w * corner_normals[triangle, 0, 1] + u * corner_normals[triangle, 1, 1] + v * corner_normals[triangle, 2, 1]
    z = w * corner_normals[triangle, 0, 2] + u * corner_normals[triangle, 1, 2] + v * corner_normals[triangle, 2, 2]
    length2 = x * x + y * y + z * z
    if not (length2 > np.float32(1e-12)) or not (length2 < np.float32(1e12)):
        return gx, gy, gz
    s = np.float32(1.0) / np.float32(math.sqrt(length2))
    return x * s, y * s, z * s


@inlined
def geometric_normal(vertices, triangles, triangle):
    """Unit normal of a triangle."""
    a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
    ex, ey, ez = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    fx, fy, fz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    return normalized(ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx)


@inlined
def sees_back(vertices, triangles, triangle, dx, dy, dz):
    """Whether a ray along d meets the back of a triangle."""
    a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
    ex, ey, ez = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    fx, fy, fz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    return (ey * fz - ez * fy) * dx + (ez * fx - ex * fz) * dy + (ex * fy - ey * fx) * dz > np.float32(0.0)


@inlined
def mapped_normal(materials, material, surface, sx, sy, sz):
    """The normal that the evaluated material gives the surface, on the front of the triangle; s where it gives none."""
    if materials.flags[material] & NORMAL_MAPPED:
        return surface[NORMAL], surface[NORMAL + 1], surface[NORMAL + 2]
    return sx, sy, sz


@inlined
def surface_side(materials, material, behind):
    """Tells surfaces apart that share a place and a normal: twice the material's number, one more on the back of a triangle.

    A triangle that others cover in part is not apart from the surface to which it belongs.
    """
    if materials.flags[material] & COVERED:
        material = materials.code[materials.start[material], 7]
    return np.int32(2) * np.int32(material) + np.int32(behind)
