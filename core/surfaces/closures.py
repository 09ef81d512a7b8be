"""Closures: each adds its share to a surface, or takes a layer's share from the weight of what lies below.

They follow Cycles' Principled BSDF (kernel/svm/closure.h, kernel/closure/bsdf_microfacet.h, Blender 4.5
and 5.2).  `weight` (wr, wg, wb) is what the layers above and the mix shaders leave for the closure.
Sums first, means last: while a program runs, the LAYER_* numbers and ROUGHNESS hold sums weighted by
what they describe; `finish` divides.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, leaf
from ..scene import CAMERA, GLOSSY, SHADOW, TRANSMISSION
from ..scene import DIFFUSE as DIFFUSE_RAY
from . import frosted, ggx
from . import sheen as sheens
from .layout import (
    BEND,
    COAT,
    COAT_F0,
    COAT_ROUGHNESS,
    DIFFUSE,
    DIFFUSE_ROUGHNESS,
    EMISSION,
    FROST,
    GLOSS,
    GLOSSY_F0,
    GLOSSY_F90,
    LAYER_F0,
    LAYER_MULTIPLE,
    LAYER_ROUGHNESS,
    LAYER_Z,
    LAYERED,
    LAYERED_TRANSLUCENCY,
    REFRACTION,
    ROUGHNESS,
    SHEEN,
    SHEEN_ROUGHNESS,
    STRAY,
    TRANSLUCENCY,
    TRANSPARENCY,
)
from .rough_glass import MULTIPLE, REFRACTING, more_by_pane, passed_from_within

F = np.float32

# Of the Glossy BSDF's distributions, beside 0 and 1.
BECKMANN = 2
# Times a Beckmann lobe's roughness: that of the GGX lobe whose normals have the same median slope, (ln 2)^(1/4).
_BECKMANN_ROUGHNESS = F(0.9124)

# Added to |cosine| where not the camera looks, but light that is reflected on (see `program.reflected_view`).
REFLECTED = F(4)
# Added instead for a lamp's shadow ray, and where the camera looks by way of a mirror or through glass (see `program.specular_view`).
SHADOWED, MIRRORED, TRANSMITTED = F(5.25), F(6.5), F(7.75)
# Added as well where the back of glass is seen by a view that began within it (see `program.from_within`).
WITHIN = F(9)


@inlined
def add(surface, at, wr, wg, wb, r, g, b):
    """Adds weight times colour to the three floats at `at`; colours are clamped below at 0."""
    surface[at] += wr * max(r, F(0))
    surface[at + 1] += wg * max(g, F(0))
    surface[at + 2] += wb * max(b, F(0))


@inlined
def diffuse(surface, r, g, b, roughness, wr, wg, wb):
    """Diffuse reflection with the colour (r, g, b)."""
    r, g, b = wr * max(r, F(0)), wg * max(g, F(0)), wb * max(b, F(0))
    surface[DIFFUSE] += r
    surface[DIFFUSE + 1] += g
    surface[DIFFUSE + 2] += b
    surface[DIFFUSE_ROUGHNESS] += min(max(roughness, F(0)), F(1)) * (r + g + b)
    return r, g, b


@inlined
def translucent(surface, r, g, b, layered, wr, wg, wb):
    """Diffuse transmission with the colour (r, g, b); layered: whether it lies under the dielectric lobe of the same surface."""
    add(surface, TRANSLUCENCY, wr, wg, wb, r, g, b)
    if layered:
        surface[LAYERED_TRANSLUCENCY] += wr * max(r, F(0)) + wg * max(g, F(0)) + wb * max(b, F(0))


@inlined
def _add_glossy(surface, wr, wg, wb, r0, g0, b0, r90, g90, b90, roughness, top, er, eg, eb):
    """Adds a glossy lobe by its albedos at normal and grazing incidence; top, (er, eg, eb): as `layout.GLOSS`."""
    surface[GLOSSY_F0] += wr * r0
    surface[GLOSSY_F0 + 1] += wg * g0
    surface[GLOSSY_F0 + 2] += wb * b0
    surface[GLOSSY_F90] += wr * r90
    surface[GLOSSY_F90 + 1] += wg * g90
    surface[GLOSSY_F90 + 2] += wb * b90
    weight = wr * (r0 + r90) + wg * (g0 + g90) + wb * (b0 + b90)
    surface[ROUGHNESS] += roughness * weight
    surface[GLOSS] += top * weight
    surface[GLOSS + 1] += er * weight
    surface[GLOSS + 2] += eg * weight
    surface[GLOSS + 3] += eb * weight


@inlined
def f0_of_ior(ior):
    """Reflectance at normal incidence."""
    x = (ior - F(1)) / (ior + F(1))
    return x * x


@inlined
def _darkening(mean_fresnel, roughness, multiple):
    """Mean factor by which scattering more than once darkens a lobe; where it is not modelled, that light is lost."""
    e = ggx.single_scattering_mean(roughness)
    if not multiple:
        return e
    return e + ggx.multiple_scattering(mean_fresnel, roughness) * (F(1) - e)


@inlined
def _top(reflectance, multiple):
    """The first number of `layout.GLOSS`."""
    return reflectance if multiple else -reflectance


@inlined
def dielectric_over_diffuse(surface, r, g, b, roughness, ior, level, rough, multiple, tr, tg, tb, wr, wg, wb):
    """Principled BSDF below coat, metal and transmission: a dielectric lobe over a diffuse base.

    level is Specular IOR Level, rough the roughness of the base, (tr, tg, tb) Specular Tint, multiple whether the lobe is Multiscatter GGX.
    """
    r, g, b = diffuse(surface, r, g, b, rough, wr, wg, wb)
    ior = max(ior, F(1e-5))
    roughness = min(max(roughness, F(0)), F(1))
    f0 = f0_of_ior(ior)
    level = max(level, F(0))
    eta = ior
    if level != F(0.5):
        f0 *= F(2) * level
        root = np.sqrt(min(f0, F(0.99)))
        eta = (F(1) + root) / (F(1) - root)
        if ior < F(1):
            eta = F(1) / eta
    if eta == F(1):
        return
    f0r = min(f0 * max(tr, F(0)), F(1))
    f0g = min(f0 * max(tg, F(0)), F(1))
    f0b = min(f0 * max(tb, F(0)), F(1))
    highest = max(f0r, max(f0g, f0b))
    real_f0 = f0_of_ior(eta)
    rise = min(max((ggx.dielectric_mean_fresnel(eta) - real_f0) / (F(1) - real_f0), F(0)), F(1))
    mean_fresnel = highest + rise * (F(1) - highest)
    z = np.sqrt(np.sqrt(real_f0))
    fms = ggx.multiple_scattering(mean_fresnel, roughness) if multiple else F(1)
    covered = r + g + b
    surface[LAYERED] += r
    surface[LAYERED + 1] += g
    surface[LAYERED + 2] += b
    surface[LAYER_F0] += covered * highest
    surface[LAYER_Z] += covered * z
    surface[LAYER_ROUGHNESS] += covered * roughness
    surface[LAYER_MULTIPLE] += covered * fms
    d = _darkening(mean_fresnel, roughness, multiple)
    _add_glossy(surface, wr * d, wg * d, wb * d, f0r, f0g, f0b, F(1), F(1), F(1), roughness, _top(F(1), multiple), F(0), F(0), F(0))


@inlined
def metal(surface, r, g, b, roughness, multiple, tr, tg, tb, wr, wg, wb):
    """Conductor with reflectance (r, g, b) at normal incidence and the tint (tr, tg, tb) at 82 degrees (F82)."""
    roughness = min(max(roughness, F(0)), F(1))
    r, g, b = min(max(r, F(0)), F(1)), min(max(g, F(0)), F(1)), min(max(b, F(0)), F(1))
    wr *= _darkening(_f82_mean(r, tr), roughness, multiple)
    wg *= _darkening(_f82_mean(g, tg), roughness, multiple)
    wb *= _darkening(_f82_mean(b, tb), roughness, multiple)
    er, eg, eb = F(1) - min(max(tr, F(0)), F(1)), F(1) - min(max(tg, F(0)), F(1)), F(1) - min(max(tb, F(0)), F(1))
    _add_glossy(surface, wr, wg, wb, r, g, b, F(1), F(1), F(1), roughness, _top(F(1), multiple), er, eg, eb)


@inlined
def _f82_mean(f0, tint):
    """Cosine-weighted mean of the F82 Fresnel term."""
    f6 = F((6 / 7) ** 6)
    schlick = f0 + (F(1) - f0) * F((6 / 7) ** 5)
    edge = schlick * F(7) / f6 * (F(1) - min(max(tint, F(0)), F(1)))
    return min(max(f0 + (F(1) - f0) * F(1 / 21) - edge * F(1 / 126), F(0)), F(1))


@inlined
def glossy(surface, r, g, b, roughness, kind, wr, wg, wb):
    """Glossy BSDF: the same reflectance at every angle.  kind: 1 for Multiscatter GGX, BECKMANN, else 0."""
    roughness = min(max(roughness, F(0)), F(1))
    multiple = kind == 1
    if kind == BECKMANN:  # without the long tails of GGX, whose middle is as bright where it is narrower, next to nothing is lost
        roughness *= _BECKMANN_ROUGHNESS
        r, g, b = max(r, F(0)), max(g, F(0)), max(b, F(0))
        _add_glossy(surface, wr, wg, wb, r, g, b, r, g, b, roughness, F(1), F(0), F(0), F(0))
        return
    r, g, b = max(r, F(0)), max(g, F(0)), max(b, F(0))
    top = _top(min(max(r, g, b), F(1)), multiple)
    r *= _darkening(min(r, F(1)), roughness, multiple)
    g *= _darkening(min(g, F(1)), roughness, multiple)
    b *= _darkening(min(b, F(1)), roughness, multiple)
    _add_glossy(surface, wr, wg, wb, r, g, b, r, g, b, roughness, top, F(0), F(0), F(0))


@inlined
def _through(surface, r, g, b, roughness, ior, thin, wr, wg, wb, cosine):
    """Lets (r, g, b) straight through, as glass does, or about the straight way where it is rough."""
    add(surface, TRANSPARENCY, wr, wg, wb, r, g, b)
    add(surface, REFRACTION, wr, wg, wb, r, g, b)
    passed = wr * max(r, F(0)) + wg * max(g, F(0)) + wb * max(b, F(0))
    surface[BEND] += passed * (F(1) if thin else ior)
    surface[STRAY] += passed * roughness * roughness
    if roughness > F(0):
        alpha = frosted.thin_alpha(roughness, ior) if thin else frosted.lobe_alpha(roughness, ior, view_cosine(cosine))
        surface[FROST] += passed * alpha


@inlined
def refraction(surface, r, g, b, roughness, ior, wr, wg, wb, cosine):
    """Refraction BSDF: lets (r, g, b) through, about the straight way, and keeps all where a view from within is reflected totally.

    cosine: see `program.evaluate`.
    """
    roughness = min(max(roughness, F(0)), F(1))
    through = F(1)
    if cosine < F(0) and ior > F(1):
        f0, c = f0_of_ior(ior), view_cosine(cosine)
        if cosine <= -WITHIN:
            through = passed_from_within(REFRACTING, ior, np.sqrt(np.sqrt(f0)), c, roughness)
        else:
            through = _passed_by_back(REFRACTING, f0, roughness, c, F(0), F(1))
    elif cosine <= -WITHIN and dielectric_fresnel(cosine, ior) >= F(1):
        return
    _through(surface, r, g, b, roughness, ior, False, wr * through, wg * through, wb * through, cosine)


@inlined
def _dielectric_albedo(f0, roughness, cosine):
    """What a dielectric lobe that loses no light reflects (0..1); cosine: see `program.evaluate`."""
    z = np.sqrt(np.sqrt(f0))
    if F(1) < abs(cosine) < REFLECTED:
        return ggx.layer_albedo_mean(f0, z, roughness, F(1))
    return ggx.layer_albedo(f0, z, roughness, F(1), view_cosine(cosine))


@leaf
def _passed_by_back(kind, f0, roughness, cosine, smooth, front):
    """What the back of a pane lets through (0..1) of light that goes straight on to `cosine` (0..1) outside, of which the front has let `front` in.

    smooth: what a smooth side reflects of it.  Of what one side of the pane reflects, both let as much through in the end: of smooth ones (1 - R) / (1 + R)
    comes through, or where they only refract all.
    """
    pane = F(1) if kind == REFRACTING else (F(1) - smooth) / (F(1) + smooth)
    if roughness > F(0):
        pane += more_by_pane(kind, np.sqrt(np.sqrt(f0)), cosine, roughness)
    return min(max(pane, F(0)) / max(front, F(1e-3)), F(1))


@leaf
def _through_wall(color, reflected, ior, cosine):
    """What both sides of a thin wall let through, of the colour that light has after going straight through it, by Cycles' sum over all its ways.

    reflected: what one side reflects.  cosine: of the view (0..1).
    """
    within = np.sqrt(max(F(1) - (F(1) - cosine * cosine) / (ior * ior), F(1e-4)))
    color = min(max(color, F(0)), F(1)) ** (F(1) / within)
    passed = F(1) - reflected
    again = reflected * color
    return passed * passed * color / max(F(1) - again * again, F(1e-6)), color


@inlined
def glass(surface, r, g, b, roughness, ior, thin, kind, tr, tg, tb, wr, wg, wb, cosine):
    """Glass: reflects its Fresnel term times (tr, tg, tb), lets the rest times (r, g, b) through, about the straight way.

    kind: of `rough_glass`.  cosine: see `program.evaluate`.  Its back reflects what its front does, for a view that entered by the front was not bent there; one
    that began within may be reflected totally, unless the glass is a thin wall.
    """
    roughness = min(max(roughness, F(0)), F(1))
    ior = max(ior, F(1e-5))
    f0, f90 = f0_of_ior(ior), F(1)
    through = F(1)
    if cosine <= -WITHIN and ior > F(1) and not thin:
        z, c = np.sqrt(np.sqrt(f0)), view_cosine(cosine)
        through = passed_from_within(kind, ior, z, c, roughness)
        # Light scattered once loses what the other kind lets out in place of it.
        f0 = f90 = F(1) - (through if kind == MULTIPLE else passed_from_within(MULTIPLE, ior, z, c, roughness))
    elif ior != F(1):
        kept = _dielectric_albedo(f0, roughness, cosine)
        through -= kept
        if cosine < F(0) and ior > F(1) and not thin:
            front, smooth = through, _dielectric_albedo(f0, F(0), cosine)
            through = _passed_by_back(kind, f0, roughness, view_cosine(cosine), smooth, front)
            reflected = F(1) - (
                through if kind == MULTIPLE else _passed_by_back(MULTIPLE, f0, roughness, view_cosine(cosine), smooth, front)
            )
            f0 = f90 = min(reflected / max(front, F(1e-3)), F(1))  # the front takes its part of that, once more
        if thin:
            c = view_cosine(cosine)
            r, cr = _through_wall(r, kept, ior, c)
            g, cg = _through_wall(g, kept, ior, c)
            b, cb = _through_wall(b, kept, ior, c)
            tr, tg, tb = max(tr, F(0)), max(tg, F(0)), max(tb, F(0))
            _through(surface, r, g, b, roughness, ior, True, wr, wg, wb, cosine)
            r, g, b = (
                kept * (F(1) + cr * r) * tr,
                kept * (F(1) + cg * g) * tg,
                kept * (F(1) + cb * b) * tb,
            )  # what the other side reflects, too
            _add_glossy(surface, wr, wg, wb, r, g, b, r, g, b, roughness, F(1), F(0), F(0), F(0))
            return
    _through(surface, r, g, b, roughness, ior, thin != 0, wr * through, wg * through, wb * through, cosine)
    tr, tg, tb = max(tr, F(0)), max(tg, F(0)), max(tb, F(0))
    if ior != F(1):
        _add_glossy(surface, wr, wg, wb, f0 * tr, f0 * tg, f0 * tb, f90 * tr, f90 * tg, f90 * tb, roughness, F(1), F(0), F(0), F(0))


@inlined
def sheen(surface, strength, roughness, velvet, tr, tg, tb, wr, wg, wb, cosine):
    """Principled BSDF's sheen: adds its lobe, which counts as diffuse, and returns the weight of what lies below; or an Ashikhmin velvet."""
    roughness = min(max(roughness, F(1e-3)), F(1))
    roughness = -roughness if velvet else roughness
    if F(1) < abs(cosine) < REFLECTED:
        albedo = strength * sheens.albedo_average(roughness)
    else:
        albedo = strength * sheens.albedo(view_cosine(cosine), roughness)
    albedo = max(albedo, F(0))
    tr, tg, tb = albedo * max(tr, F(0)), albedo * max(tg, F(0)), albedo * max(tb, F(0))
    add(surface, DIFFUSE, wr, wg, wb, tr, tg, tb)
    add(surface, SHEEN, wr, wg, wb, tr, tg, tb)
    surface[SHEEN_ROUGHNESS] = roughness
    below = max(F(1) - max(tr, max(tg, tb)), F(0))
    return wr * below, wg * below, wb * below


@inlined
def coat(surface, strength, roughness, ior, tr, tg, tb, wr, wg, wb, cosine):
    """Principled BSDF's coat: adds its lobe and returns the weight of what lies below.

    cosine: see `program.evaluate`.
    """
    strength = max(strength, F(0))
    roughness = min(max(roughness, F(0)), F(1))
    ior = max(ior, F(1))
    f0 = f0_of_ior(ior)
    albedo = F(0)
    if ior > F(1):
        albedo = _dielectric_albedo(f0, roughness, cosine)
        kept = strength * ggx.single_scattering_mean(roughness)  # what is scattered again is lost, if to no layer below
        kr, kg, kb = kept * wr, kept * wg, kept * wb
        _add_glossy(surface, kr, kg, kb, f0, f0, f0, F(1), F(1), F(1), roughness, F(1), F(0), F(0), F(0))
        add(surface, COAT, kr, kg, kb, F(1), F(1), F(1))
        surface[COAT_F0] += f0 * (kr + kg + kb)
        surface[COAT_ROUGHNESS] += roughness * (kr + kg + kb)
    c = view_cosine(cosine)
    cos2 = F(0.5) if F(1) < abs(cosine) < REFLECTED else c * c
    below = min(max(F(1) - strength * albedo, F(0)), F(1))
    depth = F(1) / np.sqrt(F(1) - (F(1) - cos2) / (ior * ior)) if ior > F(1) or cos2 > F(0) else F(1)
    wr *= below * (F(1) + strength * (max(tr, F(0)) ** depth - F(1)))
    wg *= below * (F(1) + strength * (max(tg, F(0)) ** depth - F(1)))
    wb *= below * (F(1) + strength * (max(tb, F(0)) ** depth - F(1)))
    return wr, wg, wb


@inlined
def view_cosine(cosine):
    """|cosine| of the view, of `program.evaluate`'s argument; the cosine-weighted mean 2/3 for the mean over the views."""
    c = abs(cosine)
    c = c - WITHIN if c >= WITHIN else c
    if c <= F(1):
        return c
    if c < REFLECTED:
        return F(2 / 3)
    return min(c - (TRANSMITTED if c >= TRANSMITTED else MIRRORED if c >= MIRRORED else SHADOWED if c >= SHADOWED else REFLECTED), F(1))


@inlined
def view_rays(cosine):
    """The kind of rays, as a bit, whose view `program.evaluate`'s argument is."""
    c = abs(cosine)
    c = c - WITHIN if c >= WITHIN else c
    if c <= F(1):
        return CAMERA
    return TRANSMISSION if c >= TRANSMITTED else GLOSSY if c >= MIRRORED else SHADOW if c >= SHADOWED else DIFFUSE_RAY


@inlined
def dielectric_fresnel(cosine, ior):
    """Dielectric Fresnel term at the view, from inside (1 / ior) where the back is seen."""
    ior = max(ior, F(1e-5))
    if cosine < F(0):
        ior = F(1) / ior
    c = view_cosine(cosine)
    g = ior * ior - F(1) + c * c
    if g <= F(0):
        return F(1)
    g = np.sqrt(g)
    a = (g - c) / (g + c)
    b = (c * (g + c) - F(1)) / (c * (g - c) + F(1))
    return F(0.5) * a * a * (F(1) + b * b)


@inlined
def finish(surface):
    """Turns the weighted sums into means."""
    whole = surface[DIFFUSE] + surface[DIFFUSE + 1] + surface[DIFFUSE + 2]
    surface[DIFFUSE_ROUGHNESS] = surface[DIFFUSE_ROUGHNESS] / whole if whole > F(0) else F(0)
    covered = surface[LAYERED] + surface[LAYERED + 1] + surface[LAYERED + 2]
    if covered > F(0):
        surface[LAYER_F0] /= covered
        surface[LAYER_Z] /= covered
        surface[LAYER_ROUGHNESS] /= covered
        surface[LAYER_MULTIPLE] /= covered
    else:
        surface[LAYER_F0] = surface[LAYER_Z] = surface[LAYER_ROUGHNESS] = surface[LAYER_MULTIPLE] = F(0)
    if surface[LAYERED_TRANSLUCENCY] > F(0):
        surface[LAYERED_TRANSLUCENCY] /= surface[TRANSLUCENCY] + surface[TRANSLUCENCY + 1] + surface[TRANSLUCENCY + 2]
    coat_weight = surface[COAT] + surface[COAT + 1] + surface[COAT + 2]
    if coat_weight > F(0):
        surface[COAT_F0] /= coat_weight
        surface[COAT_ROUGHNESS] /= coat_weight
    refracted = surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2]
    if refracted > F(0):
        surface[FROST] /= refracted
        surface[BEND] /= refracted
        surface[STRAY] /= refracted
    glossy_weight = F(0)
    for k in range(6):
        glossy_weight += surface[GLOSSY_F0 + k]
    surface[ROUGHNESS] = surface[ROUGHNESS] / glossy_weight if glossy_weight > F(0) else F(0)
    for k in range(4):
        surface[GLOSS + k] = surface[GLOSS + k] / glossy_weight if glossy_weight > F(0) else F(0)


__all__ = [
    "DIFFUSE",
    "EMISSION",
    "TRANSPARENCY",
    "add",
    "coat",
    "dielectric_over_diffuse",
    "diffuse",
    "finish",
    "glass",
    "glossy",
    "metal",
    "translucent",
]
