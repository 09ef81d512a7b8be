"""The surface: the floats that describe what a material is at one point, and what is read from them.

One surface sums all closures of a node tree.  Reflectances are albedos (0..1), `EMISSION` is radiance in
W/m^2/sr, `TRANSPARENCY` the share of light that goes straight through, `TRANSLUCENCY` that which leaves the
other side spread as by a diffuse reflection.  The diffuse albedo depends on
the view where a dielectric lobe lies on top of it (see `ggx`): the part `LAYERED` of `DIFFUSE` is
covered by the lobe that the four `LAYER_*` numbers describe.  Where a mix holds several such lobes the
four are their means, weighted by what they cover.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, leaf
from . import ggx, rough_diffuse

F = np.float32

DIFFUSE = 0  # rgb: diffuse albedo of a smooth surface, before the dielectric lobe takes its share
LAYERED = 3  # rgb: the part of DIFFUSE under a dielectric lobe
LAYER_F0 = 6  # reflectance of that lobe at normal incidence
LAYER_Z = 7  # its index of refraction, as `ggx.ior_coordinate`
LAYER_ROUGHNESS = 8
LAYER_MULTIPLE = 9  # Fms of `ggx`
EMISSION = 10  # rgb
TRANSPARENCY = 13  # rgb
GLOSSY_F0 = 16  # rgb: glossy albedo at normal incidence
GLOSSY_F90 = 19  # rgb: at grazing incidence
ROUGHNESS = 22  # of the glossy lobes, weighted by their albedo
NORMAL = 23  # xyz: world-space shading normal of a NORMAL_MAPPED material, else zeros
REFRACTION = 26  # rgb: the part of TRANSPARENCY that passes glass, which is a bounce to Cycles
TILT = 29  # |cosine| of NORMAL and the surface's own, by which bumps shadow diffuse light (see `bumps`); 0 for no shadowing
TRANSLUCENCY = 30  # rgb: diffuse transmittance, the same from both sides, before the dielectric lobe takes its share
LAYERED_TRANSLUCENCY = 33  # the part (0..1) of TRANSLUCENCY under a dielectric lobe
DIFFUSE_ROUGHNESS = 34  # of the diffuse reflection (see `rough_diffuse`), weighted by its albedo
FROST = 35  # alpha of the lobe, about the straight way, by which REFRACTION leaves; 0 for clear glass (see `frosted`)
SHEEN = 36  # rgb: the part of DIFFUSE that is sheen (see `sheen`)
SHEEN_ROUGHNESS = 39  # of the last sheen, below 0 for a velvet; 0 for none
GLOSS = 40  # four numbers of the glossy lobes, weighted as ROUGHNESS, by which `lobes` knows what the albedos leave out: the largest reflectance
# of a lobe by itself, below 0 where light scattered more than once is lost (0: 1, and none is), and, rgb, how far its tint at 82 degrees is from white
COAT = 44  # rgb: the part of GLOSSY_F90 that is a coat's, whose lobe is apart from the others for those who look at it (see `bare`)
COAT_F0 = 47  # its reflectance at normal incidence, over that at grazing incidence
COAT_ROUGHNESS = 48
BEND = 49  # index of refraction by which REFRACTION leaves, weighted by it; 1 for thin walls, 0 where nothing does
STRAY = 50  # square of the roughness of the glass by which REFRACTION leaves, weighted by it: how far from straight, whatever the angle
SURFACE = 51  # length

COAT_TOP = F(-1)  # the first number of `GLOSS` of a coat's lobe by itself; among others it counts as 1
# z of an index of refraction of 1.5, whose Fresnel curve stands for all glossy lobes in means
_GLOSSY_Z = F(0.2**0.5)


@inlined
def diffuse_color(surface, cosine):
    """Diffuse albedo (r, g, b) of a smooth surface for a view at `cosine` (0..1): what Cycles' Diffuse Color pass holds."""
    share = ggx.layer_albedo(surface[LAYER_F0], surface[LAYER_Z], surface[LAYER_ROUGHNESS], surface[LAYER_MULTIPLE], cosine)
    share = min(max(share, F(0)), F(1))
    return (
        surface[DIFFUSE] - share * surface[LAYERED],
        surface[DIFFUSE + 1] - share * surface[LAYERED + 1],
        surface[DIFFUSE + 2] - share * surface[LAYERED + 2],
    )


@inlined
def diffuse_albedo(surface, cosine):
    """Diffuse albedo (r, g, b) for a view at `cosine` (0..1)."""
    r, g, b = diffuse_color(surface, cosine)
    if surface[DIFFUSE_ROUGHNESS] > F(0):
        kr, kg, kb = rough_diffuse.kept(surface[DIFFUSE_ROUGHNESS], cosine, surface[DIFFUSE], surface[DIFFUSE + 1], surface[DIFFUSE + 2])
        r, g, b = kr * r, kg * g, kb * b
    return r, g, b


@inlined
def diffuse_albedo_average(surface):
    """Diffuse albedo (r, g, b), the mean of `diffuse_albedo` over the cosine-weighted hemisphere."""
    share = ggx.layer_albedo_mean(surface[LAYER_F0], surface[LAYER_Z], surface[LAYER_ROUGHNESS], surface[LAYER_MULTIPLE])
    share = min(max(share, F(0)), F(1))
    r = surface[DIFFUSE] - share * surface[LAYERED]
    g = surface[DIFFUSE + 1] - share * surface[LAYERED + 1]
    b = surface[DIFFUSE + 2] - share * surface[LAYERED + 2]
    if surface[DIFFUSE_ROUGHNESS] > F(0):
        kr, kg, kb = rough_diffuse.kept_average(surface[DIFFUSE_ROUGHNESS], surface[DIFFUSE], surface[DIFFUSE + 1], surface[DIFFUSE + 2])
        r, g, b = kr * r, kg * g, kb * b
    return r, g, b


@leaf
def translucency(surface, cosine):
    """Diffuse transmittance (r, g, b) of light from behind for a view at `cosine` (0..1): to Cycles a part of its Diffuse Color pass."""
    kept = F(1)
    if surface[LAYERED_TRANSLUCENCY] > F(0):
        share = ggx.layer_albedo(surface[LAYER_F0], surface[LAYER_Z], surface[LAYER_ROUGHNESS], surface[LAYER_MULTIPLE], cosine)
        kept -= min(max(share, F(0)), F(1)) * surface[LAYERED_TRANSLUCENCY]
    return kept * surface[TRANSLUCENCY], kept * surface[TRANSLUCENCY + 1], kept * surface[TRANSLUCENCY + 2]


@leaf
def translucency_average(surface):
    """Diffuse transmittance (r, g, b), the mean of `translucency` over the cosine-weighted hemisphere."""
    kept = F(1)
    if surface[LAYERED_TRANSLUCENCY] > F(0):
        share = ggx.layer_albedo_mean(surface[LAYER_F0], surface[LAYER_Z], surface[LAYER_ROUGHNESS], surface[LAYER_MULTIPLE])
        kept -= min(max(share, F(0)), F(1)) * surface[LAYERED_TRANSLUCENCY]
    return kept * surface[TRANSLUCENCY], kept * surface[TRANSLUCENCY + 1], kept * surface[TRANSLUCENCY + 2]


@inlined
def glossy_rise(cosine, roughness):
    """How far a glossy albedo at `cosine` has risen from `GLOSSY_F0` to `GLOSSY_F90`."""
    return ggx.fresnel_rise(_GLOSSY_Z, cosine, roughness)


@inlined
def glossy_albedo(surface, cosine):
    """Glossy albedo (r, g, b) for a view at `cosine`."""
    s = glossy_rise(cosine, surface[ROUGHNESS])
    f0r, f0g, f0b = surface[GLOSSY_F0], surface[GLOSSY_F0 + 1], surface[GLOSSY_F0 + 2]
    upr, upg, upb = surface[GLOSSY_F90] - f0r, surface[GLOSSY_F90 + 1] - f0g, surface[GLOSSY_F90 + 2] - f0b
    r, g, b = f0r + s * upr, f0g + s * upg, f0b + s * upb
    er, eg, eb = surface[GLOSS + 1], surface[GLOSS + 2], surface[GLOSS + 3]
    if er + eg + eb > F(0):
        dip = ggx.edge_dip(cosine, surface[ROUGHNESS])
        r = max(r - er * dip * ggx.edge(f0r, upr), F(0))
        g = max(g - eg * dip * ggx.edge(f0g, upg), F(0))
        b = max(b - eb * dip * ggx.edge(f0b, upb), F(0))
    return r, g, b


@leaf
def as_if_whole(surface, rest):
    """Makes up on a surface itself, not by the weight of a path that ends there, for the paths that have passed it: all that it sends is `rest` times as much.

    The rim of a leaf's picture keeps next to nothing, and the few paths that end there weighed thousands of times as much: fair to the rim, but the cache of light
    multiplies that weight by what a whole cell sends, leaf and rim.  Of a surface so brightened, by the `passing_chance`, none sends more than it gets.
    """
    for c in range(3):
        surface[DIFFUSE + c] *= rest
        surface[LAYERED + c] *= rest
        surface[TRANSLUCENCY + c] *= rest
        surface[SHEEN + c] *= rest
        surface[EMISSION + c] *= rest
        surface[GLOSSY_F0 + c] *= rest
        surface[GLOSSY_F90 + c] *= rest
        surface[COAT + c] *= rest


@leaf
def take_lobe(surface):
    """Leaves of a surface what its glossy lobes reflect."""
    for c in range(3):
        surface[DIFFUSE + c] = surface[LAYERED + c] = surface[TRANSLUCENCY + c] = surface[SHEEN + c] = F(0)
    surface[SHEEN_ROUGHNESS] = F(0)


@leaf
def bare(surface):
    """Takes the coat's lobe away from the glossy lobes of a surface, whose roughness and `GLOSS` are then those of the others."""
    coat = surface[COAT] + surface[COAT + 1] + surface[COAT + 2]
    if not coat > F(0):
        return
    whole = F(0)
    for k in range(6):
        whole += surface[GLOSSY_F0 + k]
    coat *= F(1) + surface[COAT_F0]
    rest = whole - coat
    if rest > F(1e-4) * whole:
        surface[ROUGHNESS] = min(max((whole * surface[ROUGHNESS] - coat * surface[COAT_ROUGHNESS]) / rest, F(0)), F(1))
        surface[GLOSS] = (whole * surface[GLOSS] - coat) / rest
        for k in range(1, 4):
            surface[GLOSS + k] *= whole / rest
    for c in range(3):
        surface[GLOSSY_F0 + c] = max(surface[GLOSSY_F0 + c] - surface[COAT_F0] * surface[COAT + c], F(0))
        surface[GLOSSY_F90 + c] = max(surface[GLOSSY_F90 + c] - surface[COAT + c], F(0))


@inlined
def passing_chance(surface, angled):
    """With what probability a path that samples one of both had better go straight through a surface than end there.

    Any other than 0 is right with the weights transparency / chance and 1 / (1 - chance) (but see `as_if_whole`); this one lets tinted glass,
    which keeps nothing that could be seen, pass always.  Other glass is met as often as passed: were the few paths that it keeps given
    large weights, the cache, which knows means alone, would carry too much.  So are `angled` surfaces, of which it would else know those
    views alone that see much kept.
    """
    through = max(surface[TRANSPARENCY], surface[TRANSPARENCY + 1], surface[TRANSPARENCY + 2])
    kept = largest_kept(surface)
    if kept > F(0):
        kept = max(kept, surface[REFRACTION], surface[REFRACTION + 1], surface[REFRACTION + 2])
        kept = max(kept, through) if angled else kept
    return through / (through + kept) if through > F(0) else F(0)


@inlined
def largest_kept(surface):
    """Bound on the largest channel of what is scattered, diffuse and glossy together; at least 1 for a surface that shines."""
    kept = F(0)
    for c in range(3):
        kept = max(kept, surface[DIFFUSE + c] + surface[TRANSLUCENCY + c] + max(surface[GLOSSY_F0 + c], surface[GLOSSY_F90 + c]))
        if surface[EMISSION + c] > F(0):
            kept = max(kept, F(1))
    return kept
