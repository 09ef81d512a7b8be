"""Frosted glass: what a rough surface of glass lets through, as a lobe about the straight way.

Views and light go straight through glass here.  Cycles refracts them at a GGX microfacet (kernel/closure/bsdf_microfacet.h; Walter et al. 2007,
"Microfacet Models for Refraction through Rough Surfaces").  A microfacet whose slope is s moves the refracted direction, measured outside and
along the surface, by (n cos t - cos i) s from where a smooth surface sends it; a mirror moves the reflected one by 2 cos i s.  So
glass of the width alpha blurs as the GGX lobe of a mirror does whose image is what lies behind it, and whose width is
alpha (n cos t - cos i) / (2 cos i).  The two sides of a pane blur one after the other.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined

F = np.float32
# Widths of GGX lobes that follow each other add up by their powers of so much: two alike are 1.67 times as wide, by the median of the angle.
_POWER = F(1.35)
_LEAST_COSINE = F(0.05)
# What rough panes reflect totally within are the wide directions: lobes of theirs are narrower, to half at this width.
_HALVED = F(0.37)


@inlined
def lobe_alpha(roughness, ior, cosine):
    """Width (GGX alpha, 0..1) of the mirror's lobe that blurs as one surface of glass does, seen from outside at `cosine` (0..1)."""
    c = max(cosine, _LEAST_COSINE)
    within = F(math.sqrt(max(ior * ior - F(1) + c * c, F(0))))  # n cos t
    return min(roughness * roughness * abs(within - c) / (F(2) * c), F(1))


@inlined
def thin_alpha(roughness, ior):
    """The same of a thin wall, both of whose sides Cycles (Blender 5.2) has as one such lobe, by a fit of its own."""
    squared = F(3.4) * (ior - F(1)) * (ior - F(0.5)) * (ior - F(0.5)) / (ior * ior * ior)
    return min(roughness * roughness * F(math.sqrt(max(squared, F(0)))), F(1))


@inlined
def joined_alpha(first, second):
    """Width (0..1) of what two surfaces in a row blur, by their widths."""
    joined = (first**_POWER + second**_POWER) ** (F(1) / _POWER)
    x = joined / _HALVED
    return min(joined / (F(1) + x * x), F(1))


@inlined
def rest_alpha(first, joined):
    """Width (0..1) of what is left to blur where so much of what surfaces in a row do, `joined`, the first ones have done."""
    return max(joined**_POWER - first**_POWER, F(0)) ** (F(1) / _POWER)


@inlined
def seen_through(nx, ny, nz, ox, oy, oz):
    """The direction, on the other side, of a viewer to whom a mirror shows what the viewer at o sees straight through a surface of normal n."""
    twice = F(2) * (nx * ox + ny * oy + nz * oz)
    return ox - twice * nx, oy - twice * ny, oz - twice * nz
