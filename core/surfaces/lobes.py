"""The glossy lobe of one surface seen from one direction, ready to be evaluated and sampled.

It follows Cycles' microfacet closures (kernel/closure/bsdf_microfacet.h): the GGX lobe times the Fresnel term at
the half vector, and the light that single scattering loses given back by a factor of the view alone (Kulla and
Conty 2017, "Revisiting physically based shading at Imageworks").  A lobe is a row of LOBE floats, so that kernels
keep the lobes of many points in one array.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, kernel, leaf
from ..sampling.maps import orthonormal_basis
from ..scene import ANGLED, PAST_NORMAL, REFRACTIVE
from . import ggx
from .microfacet import SMALLEST_ALPHA, reflect_by_facet, smith_lambda

# Columns: normal, direction to the viewer, its cosine, alpha (below 0: no lobe), reflectance at normal incidence, how
# much it rises to grazing, index of refraction of the rise (0: Schlick), albedo (mean of the channels), how much it dips before the rim (`ggx.edge`).
NORMAL, VIEWER, COSINE, ALPHA, F0, RISE, IOR, ALBEDO, DIP, LOBE = 0, 3, 6, 7, 8, 11, 14, 15, 16, 19

# Lobes with less albedo than this cost nothing.
NEGLIGIBLE = np.float32(1e-4)
WIDE_ALPHA = np.float32(0.1)  # of narrower lobes the rays of diffuse light, and photons, find next to nothing
# Density of a mirror's one direction: any other way of finding it counts for nothing.
MIRROR = np.float32(1e30)

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)
_QUARTER = np.float32(0.25)
_1_PI = np.float32(1 / math.pi)
_THIRD = np.float32(1 / 3)
# Reflectances up to here are dielectrics, which rise as the Fresnel term itself; above, metals, as Schlick's.
_DIELECTRIC = np.float32(0.1)
_SCHLICK_MEAN = np.float32(1 / 21)
_SCHLICK_Z = np.float32(0.2**0.5)  # Schlick's term is that of an index of refraction of 1.5, nearly
_BLUR = np.float32(math.pi / 4)
_LINE = np.float32(4 / math.pi - 1)
REACH = np.float32(3.0)  # widths of a lobe beyond a rectangle of slopes, within which it is the rectangle's
# A lobe gets all of its rays once this times its share of the reflected light is 1.
_FULL = np.float32(3.0)
_GRAZING = np.float32(0.01)
_TINY = np.float32(1e-12)
_WHOLE = np.float32(0.999)  # reflectances from here on are white, but for rounding
_DIP_MEAN = np.float32(1 / 126)  # cosine-weighted mean of c (1 - c)^6, twice its integral times c


@inlined
def specular_normal(nx, ny, nz, gx, gy, gz, ox, oy, oz):
    """The normal n, bent towards the geometric normal g as far as the mirror image of the view o would lie below g.

    Without it, lobes of interpolated and mapped normals lose their light below the surface; Cycles does the same
    (kernel/closure/bsdf_util.h, ensure_valid_specular_reflection).
    """
    on = ox * nx + oy * ny + oz * nz
    og = ox * gx + oy * gy + oz * gz
    ng = nx * gx + ny * gy + nz * gz
    lowest = min(np.float32(0.9) * og, _GRAZING)
    if _2 * on * ng - og >= lowest:
        return nx, ny, nz
    # In the plane of g and n, with c = cosine of the new normal and g: 2 (o.n') c - o.g = lowest, squared.
    tx, ty, tz = nx - ng * gx, ny - ng * gy, nz - ng * gz
    length = np.float32(math.sqrt(tx * tx + ty * ty + tz * tz))
    if length < np.float32(1e-6):
        return gx, gy, gz
    tx, ty, tz = tx / length, ty / length, tz / length
    ot = ox * tx + oy * ty + oz * tz
    a = max(ot * ot + og * og, np.float32(1e-12))
    b = _2 * (a + og * lowest)
    c = (lowest + og) * (lowest + og)
    root = np.float32(math.sqrt(max(_0, b * b - np.float32(4.0) * a * c)))
    c2 = min(max(_QUARTER * (b + root if ot < _0 else b - root) / a, _0), _1)
    along, aside = np.float32(math.sqrt(c2)), np.float32(math.sqrt(_1 - c2))
    return aside * tx + along * gx, aside * ty + along * gy, aside * tz + along * gz


@inlined
def lobe_cosine(nx, ny, nz, gx, gy, gz, ox, oy, oz):
    """Cosine (0..1) between the view o and the normal that lobes have, on one side of the surface: by it they take their share of what lies below."""
    nx, ny, nz = specular_normal(nx, ny, nz, gx, gy, gz, ox, oy, oz)
    return min(max(ox * nx + oy * ny + oz * nz, _0), _1)


@inlined
def seen_cosine(flags, nx, ny, nz, gx, gy, gz, dx, dy, dz):
    """Cosine (0..1) of a ray along the unit d by which a surface with the normals n and, geometric, g is evaluated: glass reflects and bends by the normal that lobes have.

    Walls of a tumbler that share their normals with its rim pass light by the interpolated ones where all of it is reflected.  Nodes that ask for the angle have the interpolated one.
    """
    if flags & (REFRACTIVE | ANGLED) == REFRACTIVE:
        side = -_1 if gx * dx + gy * dy + gz * dz > _0 else _1
        return lobe_cosine(side * nx, side * ny, side * nz, side * gx, side * gy, side * gz, -dx, -dy, -dz)
    return min(_1, abs(nx * dx + ny * dy + nz * dz))


@kernel
def set_lobe(row, nx, ny, nz, gx, gy, gz, ox, oy, oz, roughness, f0r, f0g, f0b, f90r, f90g, f90b, top=_0, er=_0, eg=_0, eb=_0):
    """Fill a row with the lobe of a surface: shading and geometric normal n and g and the view o on one side.

    f0, f90: as `layout.GLOSSY_F0` and `GLOSSY_F90`, which hold the mean share that multiple scattering leaves.  top, (er, eg, eb): as `layout.GLOSS`.
    """
    row[ALPHA] = -_1
    row[ALBEDO] = _0
    highest, grazing = max(f0r, f0g, f0b), max(f90r, f90g, f90b)
    if not max(highest, grazing) > NEGLIGIBLE:
        return
    nx, ny, nz = specular_normal(nx, ny, nz, gx, gy, gz, ox, oy, oz)
    cosine = min(max(ox * nx + oy * ny + oz * nz, np.float32(1e-4)), _1)
    ratio = min(max(highest / max(grazing, np.float32(1e-12)), np.float32(1e-4)), _1)
    if ratio < _DIELECTRIC:
        root = np.float32(math.sqrt(ratio))
        ior = (_1 + root) / (_1 - root)
        z = np.float32(math.sqrt(root))
        mean_rise = min(max((ggx.dielectric_mean_fresnel(ior) - ratio) / (_1 - ratio), _0), _1)
    else:
        ior, z, mean_rise = _0, _SCHLICK_Z, _SCHLICK_MEAN
    single, mean = ggx.single_scattering(cosine, roughness), ggx.single_scattering_mean(roughness)
    if top < _0:
        scale_r = scale_g = scale_b = _1 / mean
    else:
        if top == _0 or top > _WHOLE:
            mean_r, mean_g, mean_b = (
                _mean_fresnel(f0r, f90r, mean_rise),
                _mean_fresnel(f0g, f90g, mean_rise),
                _mean_fresnel(f0b, f90b, mean_rise),
            )
            if er + eg + eb > _0:
                mean_r = max(mean_r - er * _DIP_MEAN * ggx.edge(f0r, f90r - f0r) / max(f90r, _TINY), _0)
                mean_g = max(mean_g - eg * _DIP_MEAN * ggx.edge(f0g, f90g - f0g) / max(f90g, _TINY), _0)
                mean_b = max(mean_b - eb * _DIP_MEAN * ggx.edge(f0b, f90b - f0b) / max(f90b, _TINY), _0)
        else:  # what the albedos are of reflectances up to `top`: c -> w c mean / (1 - c (1 - mean)), inverted
            mean_r, mean_g, mean_b = f0r + mean_rise * (f90r - f0r), f0g + mean_rise * (f90g - f0g), f0b + mean_rise * (f90b - f0b)
            largest = max(highest, grazing)
            own = top * max(mean_r, mean_g, mean_b) / largest
            inverse = top * mean / (largest * (_1 - own * (_1 - mean)))
            mean_r, mean_g, mean_b = inverse * mean_r, inverse * mean_g, inverse * mean_b
            mean_r = mean_r / (mean + mean_r * (_1 - mean))
            mean_g = mean_g / (mean + mean_g * (_1 - mean))
            mean_b = mean_b / (mean + mean_b * (_1 - mean))
        scale_r = _view_scale(mean_r, single, mean)
        scale_g = _view_scale(mean_g, single, mean)
        scale_b = _view_scale(mean_b, single, mean)
    f0r, f0g, f0b = f0r * scale_r, f0g * scale_g, f0b * scale_b
    up_r, up_g, up_b = f90r * scale_r - f0r, f90g * scale_g - f0g, f90b * scale_b - f0b
    s = ggx.fresnel_rise(z, cosine, roughness)
    albedo = single * _THIRD * (f0r + f0g + f0b + s * (up_r + up_g + up_b))
    row[DIP] = row[DIP + 1] = row[DIP + 2] = _0
    if er + eg + eb > _0:
        row[DIP], row[DIP + 1], row[DIP + 2] = er * ggx.edge(f0r, up_r), eg * ggx.edge(f0g, up_g), eb * ggx.edge(f0b, up_b)
        albedo -= single * _THIRD * ggx.edge_dip(cosine, roughness) * (row[DIP] + row[DIP + 1] + row[DIP + 2])
    if not albedo > NEGLIGIBLE:
        return
    row[NORMAL], row[NORMAL + 1], row[NORMAL + 2] = nx, ny, nz
    row[VIEWER], row[VIEWER + 1], row[VIEWER + 2] = ox, oy, oz
    row[COSINE], row[ALPHA] = cosine, max(roughness * roughness, SMALLEST_ALPHA)
    row[F0], row[F0 + 1], row[F0 + 2] = f0r, f0g, f0b
    row[RISE], row[RISE + 1], row[RISE + 2] = up_r, up_g, up_b
    row[IOR], row[ALBEDO] = ior, albedo


@inlined
def _mean_fresnel(f0, f90, mean_rise):
    """Mean reflectance of a lobe that is white at the rim."""
    f = min(f0 / max(f90, _TINY), _1)
    f += mean_rise * (_1 - f)
    return f


@inlined
def _view_scale(f, single, mean):
    """Share of light scattered more than once at this view, of a lobe of the mean reflectance f, over the mean share that albedos hold already."""
    again = f * mean / (_1 - f * (_1 - mean))
    return (_1 + again * (_1 - single) / single) / (mean + again * (_1 - mean))


@inlined
def reflection_count(lobe, dr, dg, db, most):
    """How many of at most `most` rays are drawn from a lobe beside the diffuse albedo (dr, dg, db): by its share of the light."""
    if not lobe[ALPHA] > _0:
        return 0
    share = lobe[ALBEDO] / (lobe[ALBEDO] + _THIRD * (dr + dg + db))
    return max(np.int64(1), np.int64(np.float32(most) * min(_1, _FULL * share) + _HALF)) if most > 0 else np.int64(0)


@inlined
def _fresnel_rise(cosine, ior):
    """How far the Fresnel term has risen from normal to grazing incidence."""
    c = min(max(cosine, _0), _1)
    if ior == _0:
        x = _1 - c
        x2 = x * x
        return x2 * x2 * x
    g = np.float32(math.sqrt(ior * ior - _1 + c * c))
    a = (g - c) / (g + c)
    b = (c * (g + c) - _1) / (c * (g - c) + _1)
    f0 = (ior - _1) / (ior + _1)
    f0 *= f0
    return (_HALF * a * a * (_1 + b * b) - f0) / (_1 - f0)


@inlined
def _reflectance(row, cosine):
    """The Fresnel term (r, g, b) at the cosine with a microfacet."""
    rise = _fresnel_rise(cosine, row[IOR])
    r, g, b = row[F0] + rise * row[RISE], row[F0 + 1] + rise * row[RISE + 1], row[F0 + 2] + rise * row[RISE + 2]
    if row[DIP] + row[DIP + 1] + row[DIP + 2] > _0:
        c = min(max(cosine, _0), _1)
        x = _1 - c
        dip = c * x * x * x * x * x * x
        r, g, b = max(r - dip * row[DIP], _0), max(g - dip * row[DIP + 1], _0), max(b - dip * row[DIP + 2], _0)
    return r, g, b


@kernel
def lobe_value(row, dx, dy, dz):
    """The lobe towards the unit direction d, times the cosine there -> (r, g, b in 1/sr, density of `sample_lobe`).

    Zero for a mirror, which no direction but its own meets.
    """
    cos_d = row[NORMAL] * dx + row[NORMAL + 1] * dy + row[NORMAL + 2] * dz
    if cos_d <= _0 or row[ALPHA] <= SMALLEST_ALPHA:
        return _0, _0, _0, _0
    return _value(row, cos_d, dx, dy, dz)


@leaf
def _value(row, cos_d, dx, dy, dz):
    """`lobe_value` towards d, whose cosine with the lobe's normal may be below 0: the formula knows its square alone."""
    alpha = row[ALPHA]
    nx, ny, nz = row[NORMAL], row[NORMAL + 1], row[NORMAL + 2]
    hx, hy, hz = row[VIEWER] + dx, row[VIEWER + 1] + dy, row[VIEWER + 2] + dz
    length2 = max(hx * hx + hy * hy + hz * hz, np.float32(1e-12))
    cos_h = nx * hx + ny * hy + nz * hz
    # The sine from the cross product: exact for narrow lobes.
    sx, sy, sz = ny * hz - nz * hy, nz * hx - nx * hz, nx * hy - ny * hx
    a2 = alpha * alpha
    t = (cos_h * cos_h + (sx * sx + sy * sy + sz * sz) / a2) / length2
    d = _QUARTER * _1_PI / (a2 * t * t * row[COSINE])
    lambda_o, lambda_d = smith_lambda(row[COSINE], alpha), smith_lambda(cos_d, alpha)
    r, g, b = _reflectance(row, _HALF * np.float32(math.sqrt(length2)))
    w = d / (_1 + lambda_o + lambda_d)
    return w * r, w * g, w * b, d / (_1 + lambda_o)


@inlined
def _long(half, a2, away2):
    """How much of a line an edge of half the length `half` is to a lobe of the squared width a2 at a squared distance from it: 0 to 1."""
    square = half * half
    return square / (square + _2 * a2 + away2)


@kernel
def flattened_lobe(row, along, across, dx, dy, dz):
    """As `lobe_value` (r, g, b in 1/sr), of normals that fill a rectangle of slopes about its own: along and across (3,) are its half axes.

    Of the distribution of normals, in slopes (x, y) a^2 / (pi (a^2 + x^2 + y^2)^2), the tails are kept, as if h^2 + k^2 were added to
    x^2 + y^2: the share a^2 / (a^2 + h^2 + k^2).  The rest is as bright as in its middle within the rectangle, and falls from its edges: as that of max(|x| - h, 0) and
    max(|y| - k, 0), but beside a long edge as the integral along a line does, with the power 3/2 in place of 2, as far as the edge is longer than the way from it.  Its
    integral is 1 + (h (1 + e p) + k (1 + e q)) / a + 4 h k / (pi a^2), p and q being how much of either edge is long, e = 4 / pi - 1; h and k are less than the half axes
    by up to pi a / 4, so that the middle of a large rectangle is as bright as the mean.  Mirrors have such a lobe, too.
    """
    alpha = max(row[ALPHA], SMALLEST_ALPHA)
    nx, ny, nz = row[NORMAL], row[NORMAL + 1], row[NORMAL + 2]
    cos_d = nx * dx + ny * dy + nz * dz
    if cos_d <= _0:
        return _0, _0, _0
    hx, hy, hz = row[VIEWER] + dx, row[VIEWER + 1] + dy, row[VIEWER + 2] + dz
    length2 = max(hx * hx + hy * hy + hz * hz, np.float32(1e-12))
    cos_h = max(nx * hx + ny * hy + nz * hz, np.float32(1e-6))
    sx, sy, sz = hx / cos_h - nx, hy / cos_h - ny, hz / cos_h - nz  # slopes
    off = sx * sx + sy * sy + sz * sz
    beyond = off
    wide = np.float32(math.sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]))
    thin = np.float32(math.sqrt(across[0] * across[0] + across[1] * across[1] + across[2] * across[2]))
    inner, narrow = wide * wide / (wide + _BLUR * alpha), thin * thin / (thin + _BLUR * alpha)
    past = _0  # the edge across `along`
    if wide > _0:
        x = abs(sx * along[0] + sy * along[1] + sz * along[2]) / wide
        past = max(x - inner, _0) ** 2
        beyond -= x * x - past
    if thin > _0:
        x = abs(sx * across[0] + sy * across[1] + sz * across[2]) / thin
        beyond -= x * x - max(x - narrow, _0) ** 2
    a2 = alpha * alpha
    beside = max(beyond - past, _0)
    edge = inner * (_1 + _LINE * _long(inner, a2, a2)) + narrow * (_1 + _LINE * _long(narrow, a2, a2))
    whole = _1 + edge / alpha + np.float32(4 / math.pi) * inner * narrow / a2
    size2 = wide * wide + thin * thin
    fall, tail = _1 + (past + beside) / a2, _1 + (off + size2) / a2
    fall *= fall
    if past + beside > _0:
        edge = beside * _long(inner, a2, beside) + past * _long(narrow, a2, past)
        fall = np.float32(fall ** (_1 - _QUARTER * edge / (past + beside)))
    cos2 = cos_h * cos_h / length2
    kept = a2 / (a2 + size2)
    far = (whole - _1) / max(whole - kept, np.float32(1e-6))  # of the tails: the rest has some, too
    d = (_1 - far * kept) / (whole * fall) + far / (tail * tail)
    d *= _QUARTER * _1_PI / (a2 * cos2 * cos2 * row[COSINE])
    r, g, b = _reflectance(row, _HALF * np.float32(math.sqrt(length2)))
    w = d / (_1 + smith_lambda(row[COSINE], alpha) + smith_lambda(cos_d, alpha))
    return w * r, w * g, w * b


@leaf
def in_flattened(row, along, across, dx, dy, dz):
    """Whether a facet that reflects d to the viewer lies in, or within `REACH` widths of the lobe from, the rectangle of slopes of `flattened_lobe`, and d before it."""
    nx, ny, nz = row[NORMAL], row[NORMAL + 1], row[NORMAL + 2]
    hx, hy, hz = row[VIEWER] + dx, row[VIEWER + 1] + dy, row[VIEWER + 2] + dz
    cos_h = nx * hx + ny * hy + nz * hz
    if nx * dx + ny * dy + nz * dz <= _0 or cos_h <= _0:
        return False
    sx, sy, sz = hx / cos_h - nx, hy / cos_h - ny, hz / cos_h - nz
    beyond = sx * sx + sy * sy + sz * sz
    for axis in (along, across):
        length = np.float32(math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]))
        if length > _0:
            x = abs(sx * axis[0] + sy * axis[1] + sz * axis[2]) / length
            beyond -= x * x - max(x - length, _0) ** 2
    reach = REACH * max(row[ALPHA], SMALLEST_ALPHA)
    return beyond <= reach * reach


@leaf
def _draw(row, u1, u2):
    """A direction d drawn from the lobe, and its cosine with the lobe's normal: (d, cosine)."""
    nx, ny, nz = row[NORMAL], row[NORMAL + 1], row[NORMAL + 2]
    tx, ty, tz, bx, by, bz = orthonormal_basis(nx, ny, nz)
    ox, oy, oz = row[VIEWER], row[VIEWER + 1], row[VIEWER + 2]
    lx, ly, lz = reflect_by_facet(
        ox * tx + oy * ty + oz * tz, ox * bx + oy * by + oz * bz, row[COSINE], max(row[ALPHA], SMALLEST_ALPHA), u1, u2
    )
    return lx * tx + ly * bx + lz * nx, lx * ty + ly * by + lz * ny, lx * tz + ly * bz + lz * nz, lz


@leaf
def _weighed(row, dx, dy, dz, cos_d):
    """What `sample_lobe` returns of a direction that counts."""
    if row[ALPHA] <= SMALLEST_ALPHA:
        r, g, b = _reflectance(row, row[COSINE])
        return dx, dy, dz, r, g, b, MIRROR
    r, g, b, density = _value(row, cos_d, dx, dy, dz)
    inverse = _1 / max(density, np.float32(1e-20))
    return dx, dy, dz, r * inverse, g * inverse, b * inverse, density


@kernel
def sample_lobe(row, u1, u2):
    """A direction drawn from the lobe -> (d, r, g, b, density): (r, g, b) = lobe * cosine / density, 0 below the surface."""
    dx, dy, dz, cos_d = _draw(row, u1, u2)
    if not cos_d > _0:
        return dx, dy, dz, _0, _0, _0, _0
    return _weighed(row, dx, dy, dz, cos_d)


@kernel
def sample_above(row, gx, gy, gz, past, u1, u2):
    """As `sample_lobe`, but where it goes `past` the normal, 0 below the surface of geometric normal g alone.

    Bumps mirror what they turn their backs on, too, as far as it lies above the surface: so it is in Cycles before Blender 5, whose lobes are 0 there to shadow
    rays, not to the rays that it draws from them (kernel/closure/bsdf_microfacet.h).  Normals that are smoothed over facets alone Cycles does not bend as
    lobes here are, and with what lies behind these a room of gilt frames had 12 % more `GlossyIndirect`.
    """
    dx, dy, dz, cos_d = _draw(row, u1, u2)
    if not (gx * dx + gy * dy + gz * dz > _0 and (cos_d > _0 or past)):
        return dx, dy, dz, _0, _0, _0, _0
    return _weighed(row, dx, dy, dz, cos_d)


@inlined
def goes_past(scene, triangle, tilt):
    """Whether a surface of that triangle and `layout.TILT` mirrors what its bumps turn their backs on."""
    return tilt > _0 and triangle >= 0 and scene.materials.flags[scene.material[triangle]] & PAST_NORMAL != 0


@inlined
def is_behind(row, dx, dy, dz):
    """Whether a direction lies behind the lobe's normal, where `lobe_value` is 0."""
    return not row[NORMAL] * dx + row[NORMAL + 1] * dy + row[NORMAL + 2] * dz > _0
