"""Particles that leave the emitters: the same light as `sample`, followed the other way.

The flux that the particles carry through any surface element is, on average, the irradiance that direct light
finds there, for every kind of lamp.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf
from ..rays.offsets import hit_point, offset_origin
from ..sampling.discrete import cumulative, sample_cdf
from ..sampling.maps import concentric_disk, cosine_hemisphere, to_world, uniform_cone, uniform_sphere, uniform_triangle
from ..scene import AREA, POINT, SPOT, SUN
from ..surfaces.layout import EMISSION
from ..surfaces.program import evaluate, reflected_view
from .openings import Openings
from .shapes import one_minus_cos, spot_attenuation, spread_attenuation
from .tables import (
    AREA_M2,
    AXIS_X,
    AXIS_Y,
    AXIS_Z,
    BACK_OUT,
    COS_INNER,
    COS_OUTER,
    ELLIPTIC,
    FRONT_OUT,
    GLOSSY_ONLY,
    HALF_SPREAD,
    INWARDS,
    NORMAL,
    ONE_MINUS_COS,
    POSITION,
    RADIUS,
    SIZE,
    SOFT,
    TAN_HALF_SPREAD,
    TEXTURED,
    TRIANGLE,
    WITHIN,
    WORLD,
    Emitters,
)  # fmt: skip
from .textured import direction_density, draw_direction, draw_place, place_density, shown
from .world import emit_world

OUTLIERS = 0.02, 0.1, 0.0  # shares of the places beyond either end of a focus along each axis
# In size, from one focus around all places to a wider one, as many as fit into the whole: what just misses one weighs the square of it more.
GROWTH, MOST_WIDER = 4.0, 4
MARGIN = 0.05  # of a focus's size, on all sides
# Of half the surface of the box that particles enter: by larger openings enough of them come in as it is (living room .25, Sponza .06: a few percent more
# error with openings, which take particles from what lies beside).
SMALL = 0.03
# Of the particles of sun and world where openings have all lines: for what comes in by others, or after a bounce outside.
BESIDE_OPENINGS = 0.35
# Of an opening's size, on all sides of a box that gets as many particles as it: a window that stands askew leaves some of its light to what lies beside.
AROUND_OPENINGS = 0.25
FAR = 0.05  # of its flux, at least, counts what an emitter sends elsewhere
WORTHWHILE = 0.5  # of the whole box's surface: larger focuses gain nothing
GLOSSY_SHARE = 0.25  # by which the flux of what shines on glossy surfaces alone counts where particles are dealt
APART = 2.0  # radii of an aim from its centre, at least, of an emitter whose particles are drawn to it
WIDER = 2.0  # times the radius of an aim, at least, for the next one
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)
_PI = np.float32(math.pi)
FOR_EVER = np.float32(3e38)  # m, before any particle that has no end
_2PI = np.float32(2 * math.pi)


@leaf(fast=False)
def _spot_one_minus_cos(outer, inner, u):
    """1 - cosine off the axis with density ~ a spot's attenuation: 1 above `inner`, smoothstep down to `outer`."""
    full, edge = 1.0 - inner, 0.5 * (inner - outer)
    target = u * (full + edge)
    if target < full or edge <= 0.0:
        return target
    # The integral of smoothstep, normalised, is x^3 (2 - x) = s: safeguarded Newton.
    s = 1.0 - (target - full) / edge
    low, high, x = 0.0, 1.0, 0.5
    for _ in range(40):
        f = x * x * x * (2.0 - x) - s
        if f > 0.0:
            high = x
        else:
            low = x
        slope = x * x * (6.0 - 4.0 * x)
        step = x - f / slope if slope > 1e-12 else low
        step = step if low < step < high else 0.5 * (low + high)
        if abs(step - x) < 1e-9:
            break
        x = step
    return full + (1.0 - x) * (inner - outer)


@leaf(fast=False)
def _spread_angle(half, u):
    """Angle off the axis with density ~ cos (1 - tan / tan(half)) sin, the light of an area lamp with spread."""
    cotangent = math.cos(half) / math.sin(half)
    total = 1.0 - half * cotangent
    low, high = 0.0, half
    x = half * 0.5
    for _ in range(60):
        s, c = math.sin(x), math.cos(x)
        f = s * s - (x - s * c) * cotangent - u * total
        if f > 0.0:
            high = x
        else:
            low = x
        slope = 2.0 * s * (c - s * cotangent)
        step = x - f / slope if slope > 1e-12 else low
        step = step if low < step < high else 0.5 * (low + high)
        if abs(step - x) < 1e-9:
            break
        x = step
    return x


@leaf
def _box_entry(box, dx, dy, dz, u1, u2):
    """Where a ray of direction d enters the box, uniform over the box's shadow -> (x, y, z, shadow's area)."""
    sx, sy, sz = box[1, 0] - box[0, 0], box[1, 1] - box[0, 1], box[1, 2] - box[0, 2]
    ax, ay, az = abs(dx) * sy * sz, abs(dy) * sz * sx, abs(dz) * sx * sy
    area = ax + ay + az
    u = u1 * area
    if u < ax:
        x = box[0, 0] if dx > _0 else box[1, 0]
        return x, box[0, 1] + sy * min(u / ax, _1), box[0, 2] + sz * u2, area
    u -= ax
    if u < ay:
        y = box[0, 1] if dy > _0 else box[1, 1]
        return box[0, 0] + sx * min(u / ay, _1), y, box[0, 2] + sz * u2, area
    u -= ay
    z = box[0, 2] if dz > _0 else box[1, 2]
    return box[0, 0] + sx * min(u / max(az, np.float32(1e-30)), _1), box[0, 1] + sy * u2, z, area


@leaf
def _shadow(box, dx, dy, dz):
    """Area of a box's shadow along d."""
    sx, sy, sz = box[1, 0] - box[0, 0], box[1, 1] - box[0, 1], box[1, 2] - box[0, 2]
    return max(abs(dx) * sy * sz + abs(dy) * sz * sx + abs(dz) * sx * sy, np.float32(1e-30))


@leaf
def _slabs(box, x, y, z, dx, dy, dz):
    """Distances from a place, along d, at which its line enters and leaves a box: the first is the larger where it misses."""
    enter, leave = -FOR_EVER, FOR_EVER
    for low, high, at, d in ((box[0, 0], box[1, 0], x, dx), (box[0, 1], box[1, 1], y, dy), (box[0, 2], box[1, 2], z, dz)):
        if d == _0:
            if at < low or at > high:
                enter = FOR_EVER
            continue
        near, far = (low - at) / d, (high - at) / d
        enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
    return enter, leave


@leaf
def _focused_entry(box, focus, drawn, dx, dy, dz, u1, u2):
    """Where a ray of direction d enters the box -> (x, y, z, inverse of the density of such rays per area across d).

    The box itself and each focus get their shares of the rays, `drawn`; the density is that of them all (balance heuristic, Veach and Guibas 1995).
    """
    picked, u = -1, u1
    while picked < len(focus) - 1 and u >= drawn[picked + 1]:
        u -= drawn[picked + 1]
        picked += 1
    u = min(u / max(drawn[picked + 1], np.float32(1e-30)), np.float32(0.99999994))
    if picked < 0:
        x, y, z, area = _box_entry(box, dx, dy, dz, u, u2)
        density = drawn[0] / max(area, np.float32(1e-30))
    else:
        x, y, z, area = _box_entry(focus[picked], dx, dy, dz, u, u2)
        density = drawn[picked + 1] / max(area, np.float32(1e-30)) + drawn[0] / _shadow(box, dx, dy, dz)
    for k in range(len(focus)):
        if k != picked:
            enter, leave = _slabs(focus[k], x, y, z, dx, dy, dz)
            if enter <= leave:
                density += drawn[k + 1] / _shadow(focus[k], dx, dy, dz)
    if picked >= 0:
        back, _ = _slabs(box, x, y, z, dx, dy, dz)
        x, y, z = x + back * dx, y + back * dy, z + back * dz
    return x, y, z, _1 / density


@inlined
def _aim_from(aims, k, x, y, z, radius):
    """Where an aim lies from a sphere around (x, y, z) -> (vector to its centre, square of its distance, of both radii); the last is 0 where it is no aim, for it lies near."""
    vx, vy, vz = aims[k, 0] - x, aims[k, 1] - y, aims[k, 2] - z
    wide, d2 = aims[k, 3] + radius, vx * vx + vy * vy + vz * vz
    return vx, vy, vz, d2, wide * wide if d2 > np.float32(APART * APART) * wide * wide else _0


@leaf
def _aim_at(aims, x, y, z, radius, u1, u2):
    """Of the particles that leave a sphere around (x, y, z), as many as it draws by itself are drawn to the cone in which it sees each aim that lies far off.

    Returns:
        (direction, or zeros where the emitter is to draw it, number of aims that lie far off, and u1, stretched).
    """
    count = 0
    for k in range(len(aims)):
        _, _, _, _, wide2 = _aim_from(aims, k, x, y, z, radius)
        count += wide2 > _0
    u = u1 * np.float32(count + 1)
    picked = min(np.int64(u), count)
    u = min(u - np.float32(picked), np.float32(0.99999994))
    if picked == 0:
        return _0, _0, _0, count, u if count > 0 else u1
    for k in range(len(aims)):
        vx, vy, vz, d2, wide2 = _aim_from(aims, k, x, y, z, radius)
        picked -= wide2 > _0
        if picked == 0:
            lx, ly, lz = uniform_cone(u, u2, one_minus_cos(wide2 / d2))
            length = np.float32(math.sqrt(d2))
            dx, dy, dz = to_world(lx, ly, lz, vx / length, vy / length, vz / length)
            return dx, dy, dz, count, u
    return _0, _0, _0, count, u


@leaf
def _aimed_weight(aims, x, y, z, radius, count, own, dx, dy, dz):
    """Density per solid angle `own` of an emitter's directions over that of `_aim_at` and itself, as many of each (balance heuristic)."""
    if count == 0:
        return _1
    density = own
    for k in range(len(aims)):
        vx, vy, vz, d2, wide2 = _aim_from(aims, k, x, y, z, radius)
        # By the sine, which a cosine of narrow cones does not tell.
        cx, cy, cz = dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx
        if wide2 > _0 and dx * vx + dy * vy + dz * vz > _0 and cx * cx + cy * cy + cz * cz <= np.float32(1.0001) * wide2:
            density += _1 / (_2PI * one_minus_cos(wide2 / d2))
    return own * np.float32(count + 1) / density if own > _0 else _0


@leaf
def _emit_point(lamps, i, spot, soft, textured, maps, aims, u1, u2, u3, u4):
    """Point and spot lamps -> (origin, direction, weight, and `near`, `far`, `before` of `emit`).

    All lines of one direction pass a disk of the lamp's radius.  Of a sphere they start on its surface, outwards where they
    leave it, or inwards where they enter: its inside shines as the outside does, a spot's in all directions.  A soft
    lamp is a disk that faces the point it lights: a point at distance d from the lamp sees a line that passes the
    centre at distance h only if 1/h^2 > 1/r^2 + 1/d^2, so the line carries light from h^2 / sqrt(r^2 - h^2) on.  Where it meets the
    disk that faces a point so far on is as far behind the centre as h^2 over that distance.
    """
    ax, ay, az = -lamps[i, AXIS_Z], -lamps[i, AXIS_Z + 1], -lamps[i, AXIS_Z + 2]
    weight = _1
    inwards = False
    crossed = lamps[i, WITHIN]
    full = (_1 - lamps[i, COS_INNER]) + _HALF * (lamps[i, COS_INNER] - lamps[i, COS_OUTER]) if spot else _2
    if crossed > _0 and not soft:  # as many as there may be surfaces to meet
        chance = crossed / (_1 + crossed)
        inwards = u1 < chance
        if inwards:
            u1 = min(u1 / chance, np.float32(0.99999994))
            weight = _2 / (full * chance)
        else:
            u1 = min((u1 - chance) / (_1 - chance), np.float32(0.99999994))
            weight = _1 / (_1 - chance)
    x, y, z = lamps[i, POSITION], lamps[i, POSITION + 1], lamps[i, POSITION + 2]
    radius = lamps[i, RADIUS]
    dx = dy = dz = _0
    aimed = 0
    if not crossed > _0:
        dx, dy, dz, aimed, u1 = _aim_at(aims, x, y, z, radius, u1, u2)
    mapped = textured and not crossed > _0
    if mapped and dx == _0 and dy == _0 and dz == _0:  # half of them by the map
        if u1 < _HALF:
            u1 = u1 * _2
        else:
            dx, dy, dz = draw_direction(maps, lamps, i, u1 * _2 - _1, u2)
    if dx == _0 and dy == _0 and dz == _0:
        if spot and not inwards:
            h = _spot_one_minus_cos(np.float64(lamps[i, COS_OUTER]), np.float64(lamps[i, COS_INNER]), np.float64(u1))
            sine, phi = np.float32(math.sqrt(h * (2.0 - h))), _2PI * u2
            dx, dy, dz = to_world(sine * np.float32(math.cos(phi)), sine * np.float32(math.sin(phi)), np.float32(1.0 - h), ax, ay, az)
        else:
            dx, dy, dz = uniform_sphere(u1, u2)
    if aimed > 0 or mapped:
        own = spot_attenuation(lamps, i, ax * dx + ay * dy + az * dz) if spot else _1
        own = drawn = own / (_2PI * full)
        if mapped:
            drawn = _HALF * (own + direction_density(maps, lamps, i, dx, dy, dz))
            weight = own / drawn if own > _0 else _0
        if aimed > 0 and own > _0:
            weight *= _aimed_weight(aims, x, y, z, radius, aimed, drawn, dx, dy, dz)
        elif aimed > 0:
            weight = _0
    near, far, before = _0, FOR_EVER, _0
    if radius > _0:
        a, b = concentric_disk(u3, u4)
        rest = radius * np.float32(math.sqrt(max(np.float32(1e-12), _1 - a * a - b * b)))
        h2 = radius * radius * (a * a + b * b)
        forward = _0
        if soft:
            near = h2 / rest
            if crossed > _0:
                forward, before = -rest, rest
        elif inwards:
            forward, far = -rest, _2 * rest
        else:
            forward = rest
        hx, hy, hz = to_world(a * radius, b * radius, forward, dx, dy, dz)
        x, y, z = x + hx, y + hy, z + hz
    return x, y, z, dx, dy, dz, weight, near, far, before


@leaf
def _area_density(lamps, i, even, cosine):
    """Density per solid angle of the directions of an area lamp, at a cosine off its axis.  even: whether it has no spread."""
    if not cosine > _0:
        return _0
    if even:
        return cosine / _PI
    half = lamps[i, HALF_SPREAD]
    tangent = np.float32(math.sqrt(max(_0, _1 - cosine * cosine))) / cosine
    total = 1.0 - np.float64(half) * math.cos(np.float64(half)) / math.sin(np.float64(half))
    return cosine * spread_attenuation(lamps, i, tangent) / (_PI * np.float32(total))


@leaf
def _emit_area(lamps, i, ellipse, textured, maps, aims, u1, u2, u3, u4):
    """Area lamps -> (origin, direction, weight): uniform on the shape, cosine with the spread around the axis."""
    weight = _1
    if textured and u1 >= _HALF:  # half of them by the map
        a, b = draw_place(maps, lamps, i, u1 * _2 - _1, u2)
    else:
        u1 = u1 * _2 if textured else u1
        if ellipse:
            a, b = concentric_disk(u1, u2)
            a, b = _HALF * a, _HALF * b
        else:
            a, b = u1 - _HALF, u2 - _HALF
    if textured:
        own = _1
        if ellipse:
            own = np.float32(4 / math.pi) if a * a + b * b <= np.float32(0.25) else _0
        weight = own / (_HALF * (own + place_density(maps, lamps, i, a, b))) if own > _0 else _0
    a, b = a * lamps[i, SIZE], b * lamps[i, SIZE + 1]
    x = lamps[i, POSITION] + a * lamps[i, AXIS_X] + b * lamps[i, AXIS_Y]
    y = lamps[i, POSITION + 1] + a * lamps[i, AXIS_X + 1] + b * lamps[i, AXIS_Y + 1]
    z = lamps[i, POSITION + 2] + a * lamps[i, AXIS_X + 2] + b * lamps[i, AXIS_Y + 2]
    even = lamps[i, TAN_HALF_SPREAD] == np.float32(np.inf)
    dx, dy, dz, aimed, u3 = _aim_at(aims, x, y, z, _0, u3, u4)
    if dx != _0 or dy != _0 or dz != _0:
        lz = -(dx * lamps[i, AXIS_Z] + dy * lamps[i, AXIS_Z + 1] + dz * lamps[i, AXIS_Z + 2])
        return x, y, z, dx, dy, dz, weight * _aimed_weight(aims, x, y, z, _0, aimed, _area_density(lamps, i, even, lz), dx, dy, dz)
    if even:
        lx, ly, lz = cosine_hemisphere(u3, u4)
    else:
        theta = _spread_angle(np.float64(lamps[i, HALF_SPREAD]), np.float64(u3))
        s, lz, phi = np.float32(math.sin(theta)), np.float32(math.cos(theta)), _2PI * u4
        lx, ly = s * np.float32(math.cos(phi)), s * np.float32(math.sin(phi))
    dx = lx * lamps[i, AXIS_X] + ly * lamps[i, AXIS_Y] - lz * lamps[i, AXIS_Z]
    dy = lx * lamps[i, AXIS_X + 1] + ly * lamps[i, AXIS_Y + 1] - lz * lamps[i, AXIS_Z + 1]
    dz = lx * lamps[i, AXIS_X + 2] + ly * lamps[i, AXIS_Y + 2] - lz * lamps[i, AXIS_Z + 2]
    return x, y, z, dx, dy, dz, weight * _aimed_weight(aims, x, y, z, _0, aimed, _area_density(lamps, i, even, lz), dx, dy, dz)


@inlined
def emit(emitters, rows, surface, u0, u1, u2, u3, u4):
    """A particle from the emitters.

    u0: chooses the emitter by flux, in order, so that stratified u0 give each emitter its share; u1..u4: position
    and direction; all float32 or float64 in [0, 1).  rows, surface: scratch as for `sample_emitter`.

    Returns:
        (emitter or -1 if nothing shines, origin x, y, z, direction x, y, z, flux r, g, b in W, near, far, before).  The mean
        flux of many particles is the power of all emitters, and of the insides of spheres where surfaces lie within.  What the particle
        meets more than `before` and closer than before + near stops it but is not lit (0 but for lamps with soft falloff).  What it meets closer than
        `before`, at a distance b before that, only hides from it what is closer than before + near before / b.  It ends at `far`.
    """
    if not emitters.emission_cdf[-1] > 0.0 or emitters.kind.shape[0] == 0:
        return -1, _0, _0, _0, _0, _0, _1, _0, _0, _0, _0, FOR_EVER, _0
    e, _, probability = sample_cdf(emitters.emission_cdf, np.float64(u0))
    w = _1 / np.float32(probability)
    kind = emitters.kind[e]
    r, g, b = np.float32(emitters.flux[e, 0]), np.float32(emitters.flux[e, 1]), np.float32(emitters.flux[e, 2])
    near, far, before = _0, FOR_EVER, _0
    if kind == TRIANGLE:
        i = e - emitters.first_triangle
        shapes = emitters.shapes
        u, v = uniform_triangle(u1, u2)
        x, y, z, nx, ny, nz, error = hit_point(emitters.vertices, emitters.triangles, emitters.triangle[i], u, v)
        dx, dy, dz, aimed, u3 = _aim_at(emitters.aims, x, y, z, _0, u3, u4)
        forwards = _HALF
        if emitters.flags[e] & (FRONT_OUT | BACK_OUT):
            forwards = (_1 if emitters.flags[e] & FRONT_OUT else INWARDS) / (_1 + INWARDS)
        if dx != _0 or dy != _0 or dz != _0:
            lz = shapes[i, NORMAL] * dx + shapes[i, NORMAL + 1] * dy + shapes[i, NORMAL + 2] * dz
            side, lz = _1 if lz >= _0 else -_1, abs(lz)
        else:
            front = u3 < forwards
            lx, ly, lz = cosine_hemisphere(u3 / forwards if front else (u3 - forwards) / (_1 - forwards), u4)
            side = _1 if front else -_1
            dx, dy, dz = to_world(lx, ly, lz, side * shapes[i, NORMAL], side * shapes[i, NORMAL + 1], side * shapes[i, NORMAL + 2])
        chance = forwards if side > _0 else _1 - forwards
        w *= _HALF / chance * _aimed_weight(emitters.aims, x, y, z, _0, aimed, chance * lz / _PI, dx, dy, dz)
        x, y, z = offset_origin(x, y, z, nx, ny, nz, error, dx, dy, dz)
        if emitters.flags[e] & TEXTURED:
            triangle, material = emitters.triangle[i], emitters.material[i]
            evaluate(emitters.materials, material, emitters.attributes, triangle, u, v, reflected_view(side * lz), rows, surface)
            k = _2PI * shapes[i, AREA_M2]
            r, g, b = k * surface[EMISSION], k * surface[EMISSION + 1], k * surface[EMISSION + 2]
    elif kind == WORLD or kind == SUN:
        if kind == WORLD:
            dx, dy, dz, r, g, b = emit_world(emitters.world, u1, u2)
        else:
            lamps = emitters.lamps
            narrow = lamps[e, ONE_MINUS_COS]
            lx, ly, lz = uniform_cone(u1, u2, narrow)
            dx, dy, dz = to_world(lx, ly, lz, lamps[e, AXIS_Z], lamps[e, AXIS_Z + 1], lamps[e, AXIS_Z + 2])
            k = _2PI * narrow if narrow > _0 else _1
            r, g, b = k * emitters.radiance[e, 0], k * emitters.radiance[e, 1], k * emitters.radiance[e, 2]
        dx, dy, dz = -dx, -dy, -dz
        if len(emitters.focus) > 0:
            x, y, z, area = _focused_entry(emitters.box, emitters.focus, emitters.drawn, dx, dy, dz, u3, u4)
        else:
            x, y, z, area = _box_entry(emitters.box, dx, dy, dz, u3, u4)
        w *= area
    elif kind == AREA:
        x, y, z, dx, dy, dz, k = _emit_area(
            emitters.lamps, e, emitters.flags[e] & ELLIPTIC, emitters.flags[e] & TEXTURED, emitters.maps, emitters.aims, u1, u2, u3, u4
        )
        w *= k
    else:
        soft = emitters.flags[e] & SOFT
        x, y, z, dx, dy, dz, k, near, far, before = _emit_point(
            emitters.lamps, e, kind == SPOT, soft, emitters.flags[e] & TEXTURED, emitters.maps, emitters.aims, u1, u2, u3, u4
        )
        w *= k
    if emitters.flags[e] & TEXTURED and kind != TRIANGLE:
        lamps = emitters.lamps
        sr, sg, sb = shown(
            emitters.materials, emitters.attributes, kind, emitters.flags[e], lamps, e,
            x - lamps[e, POSITION], y - lamps[e, POSITION + 1], z - lamps[e, POSITION + 2], -dx, -dy, -dz, rows, surface,
        )  # fmt: skip
        r, g, b = r * sr, g * sg, b * sb
    return e, x, y, z, dx, dy, dz, r * w, g * w, b * w, near, far, before


def shares(flux: np.ndarray, flags: np.ndarray) -> np.ndarray:
    """(E,) shares of the particles of emitters with the flux (E, 3) W, up to a factor."""
    outwards = np.where(flags & (FRONT_OUT | BACK_OUT), 0.5 * (1 + INWARDS), 1)  # of the flux of both sides
    return flux.mean(axis=1) * outwards * np.where(flags & GLOSSY_ONLY, GLOSSY_SHARE, 1)


def focused(emitters: Emitters, places: np.ndarray, openings: Openings | None = None) -> Emitters:
    """The same emitters, which send most of their particles where the places (N, 3) are, with exact weights: sun and world, and all that are far off.

    A room with a window in a wide land, or before a lamp across the street, would else wait long for one that comes in.
    openings: by which sun and world shine on the places, None for none that are known.
    """
    if not len(places):
        return emitters
    extent = (emitters.box[1] - emitters.box[0]).max()
    boxes = []
    for part in OUTLIERS:
        box = np.quantile(places, (part, 1 - part), axis=0)
        boxes.append(_widened(box, np.maximum(MARGIN * (box[1] - box[0]).max(), 1e-6 * extent)))
    # In a wide land what comes from just beside the known places would else be told by a few particles of thousands of times the light.
    wider = math.sqrt(_surface(emitters.box) / max(_surface(boxes[-1]), 1e-30))
    count = min(int(math.log(max(wider, 1)) / math.log(GROWTH)), MOST_WIDER)
    for _ in range(count):
        boxes.append(_widened(boxes[-1], 0.5 * (wider ** (1 / (count + 1)) - 1) * (boxes[-1][1] - boxes[-1][0]).max()))
    boxes = [np.clip(box, *emitters.box) for box in boxes]
    kept = [box for box in boxes if _surface(box) < WORTHWHILE * _surface(emitters.box)]
    aims = _balls([*boxes, emitters.box])
    seen = _seen_cones(emitters, *aims[0])
    around, gaps = len(kept), [] if openings is None else openings.boxes
    if not is_small(gaps, boxes[0] if around else emitters.box):
        gaps = []
    if not around + len(gaps) and (seen == 1).all():
        return emitters
    # Of what such an emitter sends, about this share comes near the places.
    comes = _surface(boxes[0]) / _surface(emitters.box) if around else 1.0
    drawn = np.full(1 + around, 1 / (1 + around))
    if len(gaps):
        through = openings.share.sum()
        comes = (1 - through) * comes + through * min(comes, sum(map(_surface, gaps)) / _surface(emitters.box))
        wider = [np.clip(_widened(gap, AROUND_OPENINGS * (gap[1] - gap[0]).max()), *emitters.box) for gap in gaps]
        kept = [*kept, *gaps, *wider]
        shared = 0.5 * (1 - BESIDE_OPENINGS) * openings.share
        drawn = np.concatenate([(1 - (1 - BESIDE_OPENINGS) * through) * drawn, shared, shared])
    near = np.where(np.isin(emitters.kind, (SUN, WORLD)) & bool(kept), max(comes, FAR), seen)
    sent = shares(emitters.flux, emitters.flags) * near
    if (seen < 1).any() and sent.sum() > 0:
        flux = shares(emitters.flux, emitters.flags)
        sent = (1 - FAR) * sent / sent.sum() + FAR * flux / flux.sum()
    return emitters._replace(
        focus=np.array(kept, np.float32).reshape(-1, 2, 3),
        drawn=drawn.astype(np.float32),
        around=around,
        aims=np.array([[*centre, radius] for centre, radius in aims], np.float32),
        emission_cdf=cumulative(sent, np.float64),
    )


def is_small(boxes: np.ndarray, around: np.ndarray) -> bool:
    """Whether particles that are sent evenly into a box (2, 3) seldom come through openings (K, 2, 3), of which there are some."""
    return len(boxes) > 0 and sum(map(_surface, boxes)) <= SMALL * _surface(around)


def _balls(boxes: list[np.ndarray]) -> list[tuple[np.ndarray, float]]:
    """Centre (3,) and radius of the spheres around the first of the boxes (2, 3), and around others of which each is much larger than those before."""
    balls = []
    for box in boxes:
        radius = 0.5 * float(np.linalg.norm(box[1] - box[0]))
        if not balls or radius > WIDER * balls[-1][1]:
            balls.append((box.mean(axis=0), radius))
    return balls


def _seen_cones(emitters: Emitters, centre: np.ndarray, radius: float) -> np.ndarray:
    """Share (E,) of all directions in which emitters that are far off see a sphere; 1 for those that are near, sun and world."""
    position = np.tile(centre, (len(emitters.kind), 1)).astype(np.float64)
    size = np.zeros(len(position))
    lamps = len(emitters.source)
    finite = ~np.isin(emitters.kind[:lamps], (SUN, WORLD))
    position[:lamps][finite] = emitters.lamps[finite, POSITION : POSITION + 3]
    round_ = np.isin(emitters.kind[:lamps], (POINT, SPOT))
    size[:lamps][round_] = emitters.lamps[round_, RADIUS]
    if emitters.first_triangle < len(position):
        corners = emitters.vertices[emitters.triangles[emitters.triangle]]
        position[emitters.first_triangle :] = corners.mean(axis=1)
    wide2, d2 = (radius + size) ** 2, ((position - centre) ** 2).sum(axis=1)
    far = (d2 > APART**2 * wide2) & (wide2 > 0)
    share = 0.5 * (1 - np.sqrt(1 - np.minimum(wide2 / np.maximum(d2, 1e-30), 1)))
    spots = emitters.kind[:lamps] == SPOT
    cones = 1 - 0.5 * emitters.lamps[spots][:, [COS_INNER, COS_OUTER]].sum(axis=1)
    share[:lamps][spots] = np.minimum(1, 2 * share[:lamps][spots] / np.maximum(cones, 1e-12))
    return np.where(far, share, 1.0)


def focus_share(emitters: Emitters) -> float:
    """How much smaller than the whole box the focus of sun and world is, 1 without one: their light from elsewhere is told by so much fewer particles."""
    if emitters.around == 0 or not emitters.flux[np.isin(emitters.kind, (SUN, WORLD))].any():
        return 1.0
    return _surface(emitters.focus[0]) / _surface(emitters.box)


def _widened(box: np.ndarray, margin: float) -> np.ndarray:
    """A box (2, 3) with a margin on all sides."""
    return box + margin * np.array([[-1.0], [1.0]])


def _surface(box: np.ndarray) -> float:
    """Half the surface of a box (2, 3)."""
    x, y, z = (box[1] - box[0]).astype(np.float64)
    return x * y + y * z + z * x
