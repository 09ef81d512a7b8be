"""Aiming from a shading point at one emitter."""

from __future__ import annotations

import numpy as np

from ..jit import inlined
from ..scene import AREA, SUN
from ..surfaces.layout import EMISSION
from ..surfaces.program import evaluate, reflected_view
from .shapes import falloff, sample_area, sample_mesh_triangle, sample_point, sample_sun
from .tables import ELLIPTIC, FADING, NORMAL, SOFT, TEXTURED, TRIANGLE, WORLD
from .textured import shown_from
from .world import sample_world

_INFINITY = np.float32(np.inf)


@inlined
def sample_emitter(emitters, e, px, py, pz, nx, ny, nz, u1, u2, rows, surface):
    """One sample of emitter e for a surface at p with shading normal n.

    u1, u2: float32 in [0, 1).  rows, surface: scratch for textured emitters (`new_registers`, (SURFACE,) float32).

    Returns:
        Nine float32: unit direction to the light, distance (inf for sun and world), radiance / density per solid
        angle as r, g, b, and barycentric u, v on a triangle.  The mean over u1, u2 of radiance / density times the
        cosine with n is the unshadowed irradiance (W/m^2).
    """
    kind = emitters.kind[e]
    r, g, b = emitters.radiance[e, 0], emitters.radiance[e, 1], emitters.radiance[e, 2]
    t = _INFINITY
    u = v = np.float32(0.0)
    if kind == TRIANGLE:
        i = e - emitters.first_triangle
        shapes = emitters.shapes
        dx, dy, dz, t, w, u, v = sample_mesh_triangle(shapes, i, px, py, pz, u1, u2)
        if emitters.flags[e] & TEXTURED and w > 0:
            side = -(dx * shapes[i, NORMAL] + dy * shapes[i, NORMAL + 1] + dz * shapes[i, NORMAL + 2])
            triangle, material = emitters.triangle[i], emitters.material[i]
            evaluate(emitters.materials, material, emitters.attributes, triangle, u, v, reflected_view(side), rows, surface)
            r, g, b = surface[EMISSION], surface[EMISSION + 1], surface[EMISSION + 2]
    elif kind == WORLD:
        dx, dy, dz, r, g, b = sample_world(emitters.world, px, py, pz, nx, ny, nz, u1, u2)
        w = np.float32(1.0)
    elif kind == SUN:
        dx, dy, dz, w = sample_sun(emitters.lamps, e, u1, u2)
    elif kind == AREA:
        dx, dy, dz, t, w = sample_area(emitters.lamps, e, emitters.flags[e] & ELLIPTIC, px, py, pz, u1, u2)
    else:
        dx, dy, dz, t, w = sample_point(emitters.lamps, e, emitters.flags[e] & SOFT, px, py, pz, nx, ny, nz, u1, u2)
    if emitters.flags[e] & FADING:
        w *= falloff(emitters.lamps, e, t)
    if emitters.flags[e] & TEXTURED and kind != TRIANGLE and w > 0:
        sr, sg, sb = shown_from(
            emitters.materials, emitters.attributes, kind, emitters.flags[e], emitters.lamps, e, px, py, pz, dx, dy, dz, t, rows, surface
        )
        r, g, b = r * sr, g * sg, b * sb
    return dx, dy, dz, t, r * w, g * w, b * w, u, v
