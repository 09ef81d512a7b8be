"""Light particles and the virtual point lights that they leave behind.

Keller 1997, "Instant Radiosity": N particles leave the lamps, and the first floor(rho^j N) of them go on to
bounce j, rho being the scene's mean reflectivity; the weight N / floor(rho^j N) makes up for the others.  The
points are scrambled Sobol, whose beginnings are well distributed themselves, so that the ones which go on are a
fair sample.

Shading normals: light that arrives is weighed with |ns.w| / |ng.w| (Veach 1997, section 5.3), and light that
leaves is cosine-distributed about the geometric normal, which together is the exact adjoint of what a path
tracer computes with shading normals.

Glossy surfaces: at each hit a particle is reflected by the diffuse or by the glossy lobe, drawn by their albedos for the
light's own direction, and flies on as that lobe sends it.  A glossy reflection leaves a VPL that shines about the
direction drawn from the lobe: all of them together shine as the lobe does, blurred by a cosine, with its energy.  Those by
`trace_by_power` stand for the lobe itself (`Vpls.lobe`), which `by_lobe` evaluates.  What they could give is told by a cosine about the lobe's
middle, stretched along it (Heitz, Dupuy, Hill & Neubelt 2016, Real-Time Polygonal-Light Shading with Linearly Transformed Cosines):
1 / sqrt(1 + b) times as wide, b their sharpness.
Only diffuse reflections count as bounces, as in Cycles; the first surface that a lamp lights is free in any case.

Glass: a particle flies against the path that finds it, from behind; what a surface lets through is what it does for that path.  Whether that
path begins within the glass is known where the particle lands: until then it owes the difference for each front that it has passed.

Translucent surfaces: a particle that is drawn to go through leaves its VPL on the other side, and flies on from there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .jit import inlined, kernel, leaf
from .lamps.emission import FOR_EVER, emit
from .lamps.links import lights, parts_rays
from .lamps.lookup import BOTH, EACH, ray_kind, sought
from .lamps.shapes import AWAY_FROM_CENTRE, falloff
from .lamps.tables import CASTS_SHADOW, FADING, GLOSSY_ONLY, NOMINAL, RADIUS, SEEN_BY_GLOSSY, SOFT, WORLD
from .rays.offsets import hit_point, offset_origin
from .rays.packet import T_FAR, WIDTH, disable_ray, hit_t, hit_triangle, hit_u, hit_v, new_packet, set_ray
from .rays.trace import ALL, intersect_packet
from .sampling.hashing import uniform
from .sampling.maps import cosine_hemisphere, to_world
from .sampling.sequences import sobol
from .scene import ANGLED, DIFFUSE, GLOSSY_LOBE, REFRACTIVE, SHADOW, SPOT, TELLING, TRANSLUCENT, TRANSPARENT
from .surfaces.bending import scattered as scattered_by_glass
from .surfaces.bumps import shadowing
from .surfaces.frosted import joined_alpha, rest_alpha
from .surfaces.layout import (
    BEND,
    FROST,
    GLOSS,
    GLOSSY_F0,
    GLOSSY_F90,
    REFRACTION,
    ROUGHNESS,
    SHEEN,
    SHEEN_ROUGHNESS,
    SURFACE,
    TILT,
    TRANSPARENCY,
    diffuse_albedo_average,
    glossy_albedo,
    largest_kept,
    translucency_average,
)
from .surfaces.lobes import ALBEDO, ALPHA, LOBE, NORMAL, VIEWER, lobe_value, sample_lobe, set_lobe
from .surfaces.normals import mapped_normal, shading_normal, surface_side
from .surfaces.program import new_registers
from .surfaces.sheen import lit_from
from .surfaces.visibility import OUTSIDE, SCATTERING, bends_most, evaluate_along, evaluate_from, passed_glass, stray
from .threads import Progress, run_chunks
from .transport import Transport

_EMISSION_DIMENSIONS = 5  # Sobol dimensions that a particle's birth takes
_MAX_PASSED = 64  # transparent surfaces that one flight passes at most
# Bound of |ns.w| / |ng.w|: beyond it, on a facet that is met edge on, particles are few and strong.  What they leave is the gather rays' (`methods.tails`).
MAX_ADJOINT = np.float32(8.0)
_MORE_SURFACES = 4  # that a path may meet beyond its diffuse bounces, by glossy reflections and through translucent surfaces
LEAST_POWER = 1.0  # of the mean share of its light that a particle keeps at a first surface: what surely flies on by `trace_by_power`
# Most `sharpness` of lights by `trace_by_power`, and least roughness of the lobes that they stand for: narrower ones are seen as spots, for there are only
# so many of them.
SHARPEST = np.float32(64.0)
BLUR = np.float32(0.2)
ROUND = np.float32(0.2)  # share of them that shine all around
# Times what the clamp leaves of a light that is not sharp: no more of a sharp one, which the clamp alone would let be 1 + sharpness times as bright.
BRIGHTEST = np.float32(8.0)
# Times 1 / roughness^4: the sharpness of a light that shines about as widely as the lobe that its direction was drawn from.
_AS_WIDE = np.float32(0.25)
_MORE = 16  # times as many particles are tried where none has landed
SHINE, THROUGH = 1, 2  # kinds of lights, `Vpls.shine`
NESTED = 4  # fronts of glass, each within the last, that a particle owes for
_ALIKE, _APART, _BY_GLASS = 0, 1, 2  # what shadow rays and diffuse ones make of what a particle has passed
_MET = 0.2  # of what passes an angled surface, at least, tries what that keeps
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_PI = np.float32(math.pi)
_THIRD = np.float32(1 / 3)


class Vpls(NamedTuple):
    """M virtual point lights: small patches that shine with a cosine about their normal, or more narrowly.

    position: (M, 3) float32.  error: (M,) float32, rounding error of the position (m).  normal: (M, 3) float32,
    unit geometric normal on the lit side, or the direction of a glossy reflection.  surface_normal: (M, 3) float32, the
    geometric normal in any case.  flux: (M, 3) float32, W leaving (what
    the surface itself hides of a glossy reflection included); the irradiance at a point x is flux / pi * cos cos' / r^2.
    emitter: (M,) int32, where the light came from.  bounce: (M,) int32, 1 for light that left one surface.
    side: (M,) int32, of the surface, as `surface_side` has it.  shine: (M,) uint8, `SHINE` where a lamp's light was reflected by a glossy lobe,
    `THROUGH` where other light was reflected by a glossy lobe, else 0.
    sharpness: (M,) float32, b of a light that shines with (1 + b) c / (1 + b (1 - c^2))^2 instead of the cosine c.
    lobe: (M, LOBE) float32, row of `surfaces.lobes` of what such a light stands for, whose `ALPHA` is below 0 where it is none (`by_lobe`).
    seen: (M,) float32, the visible share of what it sends to the view, 1 where that is not known.
    """

    position: np.ndarray
    error: np.ndarray
    normal: np.ndarray
    surface_normal: np.ndarray
    flux: np.ndarray
    emitter: np.ndarray
    bounce: np.ndarray
    side: np.ndarray
    shine: np.ndarray
    sharpness: np.ndarray
    lobe: np.ndarray
    seen: np.ndarray

    @staticmethod
    def allocate(n: int) -> Vpls:
        """Room for n lights, not set, of which nothing is known to be hidden."""
        f, e = np.float32, np.empty
        return Vpls(
            e((n, 3), f),
            e(n, f),
            e((n, 3), f),
            e((n, 3), f),
            e((n, 3), f),
            *(e(n, np.int32) for _ in range(3)),
            e(n, np.uint8),
            e(n, f),
            e((n, LOBE), f),
            np.ones(n, f),
        )

    def take(self, index) -> Vpls:
        """The lights at `index` (anything that indexes an array)."""
        return Vpls(*(np.ascontiguousarray(a[index]) for a in self))

    @staticmethod
    def concatenate(parts: list[Vpls]) -> Vpls:
        """All lights of `parts`, in order."""
        return Vpls(*(np.concatenate(arrays) for arrays in zip(*parts))) if parts else Vpls.allocate(0)


@inlined
def is_ahead(vpls, j, x, y, z):
    """Whether a point lies on the side of its surface that light j shines on: glass does not hide a light from what is behind it."""
    dx, dy, dz = x - vpls.position[j, 0], y - vpls.position[j, 1], z - vpls.position[j, 2]
    return vpls.surface_normal[j, 0] * dx + vpls.surface_normal[j, 1] * dy + vpls.surface_normal[j, 2] * dz > _0


@inlined
def _flattened(c, sharpness):
    """c, between a light's direction and the normal of the surface that cuts it off, after what stretches the light to a cosine."""
    return c / math.sqrt(c * c + (_1 - c * c) / (_1 + sharpness))


@leaf
def faded(emitters, e, near, t):
    """How much more a lamp of a falloff of its own shines at a distance t than where its particles are born; near: as of `emit`."""
    lamps = emitters.lamps
    if emitters.flags[e] & SOFT:
        # The line passes the centre at h, with near = h^2 / sqrt(r^2 - h^2), and meets the disk that faces this point beyond it.
        radius = lamps[e, RADIUS]
        h2 = np.float32(0.5) * near * (np.float32(math.sqrt(near * near + np.float32(4.0) * radius * radius)) - near)
        t += h2 / max(t, np.float32(1e-6))
    return falloff(lamps, e, t) / lamps[e, NOMINAL]


@leaf
def _set_reflection(row, surface, roughness, sx, sy, sz, gx, gy, gz, dx, dy, dz):
    """Fills a row of `surfaces.lobes` with the glossy lobe of a surface, as rough as `roughness`, for light along d; s, g as of `reflected`."""
    set_lobe(
        row, sx, sy, sz, gx, gy, gz, -dx, -dy, -dz, roughness,
        surface[GLOSSY_F0], surface[GLOSSY_F0 + 1], surface[GLOSSY_F0 + 2],
        surface[GLOSSY_F90], surface[GLOSSY_F90 + 1], surface[GLOSSY_F90 + 2], surface[GLOSS], surface[GLOSS + 1], surface[GLOSS + 2], surface[GLOSS + 3],
    )  # fmt: skip


@leaf
def reflected(surface, lobe, sx, sy, sz, gx, gy, gz, dx, dy, dz, u1, u2):
    """A direction drawn from the glossy lobe for light along d -> (direction, weights whose mean is the albedo).

    s, g: shading and geometric normal on the lit side.  lobe: (LOBE,) float32, is set to it.
    """
    _set_reflection(lobe, surface, surface[ROUGHNESS], sx, sy, sz, gx, gy, gz, dx, dy, dz)
    if not lobe[ALPHA] > _0:
        return gx, gy, gz, _0, _0, _0
    wx, wy, wz, r, g, b, _ = sample_lobe(lobe, u1, u2)
    cos_g, cos_s = gx * wx + gy * wy + gz * wz, sx * wx + sy * wy + sz * wz
    if not (cos_g > _0 and cos_s > _0):
        return gx, gy, gz, _0, _0, _0
    adjoint = min(MAX_ADJOINT, cos_g / cos_s)
    return wx, wy, wz, adjoint * r, adjoint * g, adjoint * b


@leaf
def _axis(lobe, sharpest, gx, gy, gz):
    """`_axis_of` a row of `surfaces.lobes`."""
    return _axis_of(
        lobe[ALPHA], lobe[NORMAL], lobe[NORMAL + 1], lobe[NORMAL + 2], lobe[VIEWER], lobe[VIEWER + 1], lobe[VIEWER + 2], sharpest, gx, gy, gz
    )  # fmt: skip


@leaf
def _axis_of(alpha, nx, ny, nz, vx, vy, vz, sharpest, gx, gy, gz):
    """Axis and sharpness, `sharpest` at most, of a light about as wide as a lobe about the normal n for light from v, on the side g of its surface."""
    cosine = nx * vx + ny * vy + nz * vz
    # Low light is reflected as widely as other light up and down, but less to the sides, by its cosine; this is as wide in the mean.
    sharp = min(sharpest, np.float32(2.0) * _AS_WIDE / max(alpha * alpha * (_1 + cosine * cosine), np.float32(1e-12)))
    c = np.float32(2.0) * cosine
    # Wide lobes lean towards the normal (Lagarde & de Rousiers 2014, Moving Frostbite to PBR, section 4.9.3).
    lean = _1 - alpha * alpha
    ax, ay, az = nx + lean * (c * nx - vx - nx), ny + lean * (c * ny - vy - ny), nz + lean * (c * nz - vz - nz)
    length = np.float32(math.sqrt(ax * ax + ay * ay + az * az))
    ax, ay, az = ax / length, ay / length, az / length
    if not ax * gx + ay * gy + az * gz > _0:
        return gx, gy, gz, _0
    return ax, ay, az, sharp


@leaf
def _uncut(gx, gy, gz, ax, ay, az, sharp):
    """How much brighter a light about the axis a is for the surface, of the normal g, that cuts it off: what is left has the light of all of it."""
    return np.float32(2.0) / (_1 + _flattened(gx * ax + gy * ay + gz * az, sharp))


@leaf
def by_lobe(vpls, j, x, y, z):
    """How much more the lobe that light j stands for sends towards a point than the light does; 1 for a light that is no lobe's.

    Than such lights do in the mean, of which `ROUND` shine with a cosine about their surface's normal: by the balance heuristic (Veach & Guibas 1995)
    each of them sends as much as the lobe, and none has to make up for directions in which lights about the lobe's middle send next to nothing.
    """
    if not vpls.lobe[j, ALPHA] > _0:
        return _1
    dx, dy, dz = x - vpls.position[j, 0], y - vpls.position[j, 1], z - vpls.position[j, 2]
    inverse = _1 / max(np.float32(math.sqrt(dx * dx + dy * dy + dz * dz)), np.float32(1e-20))
    dx, dy, dz = inverse * dx, inverse * dy, inverse * dz
    gx, gy, gz = vpls.surface_normal[j, 0], vpls.surface_normal[j, 1], vpls.surface_normal[j, 2]
    cos_g = gx * dx + gy * dy + gz * dz
    cos_s = vpls.lobe[j, NORMAL] * dx + vpls.lobe[j, NORMAL + 1] * dy + vpls.lobe[j, NORMAL + 2] * dz
    if not (cos_g > _0 and cos_s > _0):
        return _0
    ax, ay, az, sharp = _axis(vpls.lobe[j], SHARPEST, gx, gy, gz)
    cosine = max(_0, ax * dx + ay * dy + az * dz)
    spread = _1 + sharp * (_1 - cosine * cosine)
    light = (_1 - ROUND) * _uncut(gx, gy, gz, ax, ay, az, sharp) * (_1 + sharp) * cosine / (spread * spread) + ROUND * cos_g
    r, g, b, _ = lobe_value(vpls.lobe[j], dx, dy, dz)
    return _PI * _THIRD * (r + g + b) * min(MAX_ADJOINT, cos_g / cos_s) / (vpls.lobe[j, ALBEDO] * light)


@leaf
def carried_by_lights(alpha, nx, ny, nz, vx, vy, vz, gx, gy, gz, dx, dy, dz, reach):
    """The part that lights, as `by_lobe` has them, carry of what a lobe about the normal n, on the side g of its surface, reflects from v towards d.

    reach: cosine at the light at which one that is not sharp comes to the clamp of the geometry term.
    """
    ax, ay, az, sharp = _axis_of(max(alpha, BLUR * BLUR), nx, ny, nz, vx, vy, vz, SHARPEST, gx, gy, gz)
    scale = (_1 - ROUND) * _uncut(gx, gy, gz, ax, ay, az, sharp)
    cosine, cos_g = max(_0, ax * dx + ay * dy + az * dz), max(_0, gx * dx + gy * dy + gz * dz)
    spread = _1 + sharp * (_1 - cosine * cosine)
    along = (_1 + sharp) * cosine / (spread * spread)
    whole = scale * along + ROUND * cos_g
    if not whole > _0:
        return _0
    return (scale * min(along, min(_1 + sharp, BRIGHTEST) * reach) + ROUND * min(cos_g, reach)) / whole


@inlined
def surely_carried(alpha):
    """The `reach` from which on `carried_by_lights` is 1."""
    alpha = max(alpha, BLUR * BLUR)
    return max(_1, (_1 + min(SHARPEST, np.float32(2.0) * _AS_WIDE / (alpha * alpha))) / BRIGHTEST)


@kernel
def _trace_particles(scene, begin, end, survivors, least, sharpest, bounces, seed, vpls):
    """Fly the particles begin..end-1. survivors: (L,) int64, how many of all fly to surface 0..L-1.

    least: of those, what has kept a smaller share of the light that it was born with goes on by chance, with so much.
    sharpest: the most `sharpness` of a light.

    bounces: diffuse reflections of a path at most, that of its first surface counted even if it is glossy, and one for glass before it.

    Writes VPLs (their flux still times the number of particles); returns their number, the rays traced, the sum and count of the
    albedos met (for rho), and the sum of the shares of their light that VPLs have kept.
    """
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    rows = new_registers(scene.materials)
    origin = np.empty((WIDTH, 3), np.float32)
    direction = np.empty((WIDTH, 3), np.float32)
    flux = np.empty((WIDTH, 3), np.float32)
    born = np.empty(WIDTH, np.float32)
    emitter = np.empty(WIDTH, np.int32)
    near = np.empty(WIDTH, np.float32)
    far = np.empty(WIDTH, np.float32)
    before = np.empty(WIDTH, np.float32)
    square = np.empty(WIDTH, np.float32)
    flown = np.empty(WIDTH, np.float32)
    flying = np.empty(WIDTH, np.bool_)
    scattered = np.empty(WIDTH, np.int32)  # diffuse reflections so far, and one for the first surface in any case, and for glass before it
    lobe = np.zeros(LOBE, np.float32)
    entered = np.empty(WIDTH, np.int64)
    kind = np.empty(WIDTH, np.int64)  # of the first flight
    both = np.empty(WIDTH, np.bool_)  # whether half of the particles fly as each kind
    told = np.empty(WIDTH, np.int64)  # whether what a particle has passed then tells these kinds apart
    hiding = np.empty(WIDTH, np.int64)  # kinds of rays that meet what hides its lamp
    owed = np.empty((WIDTH, NESTED), np.float32)
    frost = np.empty(WIDTH, np.float32)  # width of the lobe in which frosted glass has scattered a particle so far
    n = 0
    n_rays = 0
    albedo_sum = 0.0
    albedo_count = 0
    kept_sum = 0.0
    for base in range(begin, end, WIDTH):
        lanes = min(WIDTH, end - base)
        for lane in range(lanes):
            i = base + lane
            emitter[lane], ox, oy, oz, dx, dy, dz, r, g, b, near[lane], far[lane], before[lane] = emit(
                scene.emitters, rows, surface, sobol(i, 0, seed), sobol(i, 1, seed), sobol(i, 2, seed), sobol(i, 3, seed), sobol(i, 4, seed)
            )
            origin[lane, 0], origin[lane, 1], origin[lane, 2] = ox, oy, oz
            direction[lane, 0], direction[lane, 1], direction[lane, 2] = dx, dy, dz
            flux[lane, 0], flux[lane, 1], flux[lane, 2] = r, g, b
            born[lane] = r + g + b
            flying[lane] = emitter[lane] >= 0 and max(r, g, b) > 0
            scattered[lane] = 0
            entered[lane] = OUTSIDE
            kind[lane], both[lane], told[lane] = DIFFUSE, False, _ALIKE
            if flying[lane]:
                hiding[lane] = scene.emitters.shadow_kinds[emitter[lane]]
                kind[lane] = ray_kind(scene.emitters, emitter[lane], -dx, -dy, -dz)
                if kind[lane] == BOTH or kind[lane] == EACH:
                    both[lane] = True
                    kind[lane] = SHADOW if uniform(seed, i, 0, 8) < np.float32(0.5) else DIFFUSE
                    if scene.emitters.parted:
                        hiding[lane] = kind[lane]
            square[lane] = near[lane] * before[lane]
            flown[lane] = frost[lane] = _0
        for bounce in range(len(survivors)):
            landed_any = False
            for lane in range(WIDTH):
                if lane < lanes and flying[lane] and base + lane < survivors[bounce]:
                    # The first flight is a shadow ray of the lamp, seen from its other end.
                    kinds = DIFFUSE | scene.emitters.shadow_kinds[emitter[lane]] if bounce == 0 else DIFFUSE
                    set_ray(
                        packet, lane, origin[lane, 0], origin[lane, 1], origin[lane, 2],
                        direction[lane, 0], direction[lane, 1], direction[lane, 2], np.float32(0.0), np.float32(np.inf), kinds,
                    )  # fmt: skip
                    landed_any = True
                    n_rays += 1
                else:
                    if lane < lanes:
                        flying[lane] = False
                    disable_ray(packet, lane)
            passed = 0
            while landed_any and passed < _MAX_PASSED:
                intersect_packet(scene.rays, ALL, packet, WIDTH)
                landed_any = False
                for lane in range(lanes):
                    triangle = hit_triangle(packet, lane)
                    if not flying[lane] or packet.f[T_FAR * WIDTH + lane] < 0:
                        continue
                    if triangle < 0:
                        flying[lane] = False
                        disable_ray(packet, lane)
                        continue
                    u, v, t = hit_u(packet, lane), hit_v(packet, lane), hit_t(packet, lane)
                    dx, dy, dz = direction[lane, 0], direction[lane, 1], direction[lane, 2]
                    x, y, z, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
                    if bounce == 0 and flown[lane] + t > far[lane]:  # where a sphere's inside ends
                        flying[lane] = False
                        disable_ray(packet, lane)
                        continue
                    behind = gx * dx + gy * dy + gz * dz > 0
                    flags = scene.materials.flags[scene.material[triangle]]
                    angled = flags & (ANGLED | REFRACTIVE) == ANGLED
                    # What comes through is seen from the other end.
                    # But lamps send to the other side of a sheet what the square of the index says (see `visibility.is_sheet`).
                    by_lamp = bounce == 0 and scene.emitters.kind[emitter[lane]] != WORLD
                    reverse = angled or (flags & REFRACTIVE and behind and entered[lane] == OUTSIDE and not by_lamp)
                    as_kind = kind[lane] if bounce == 0 else DIFFUSE
                    if reverse:
                        evaluate_along(scene, triangle, u, v, -dx, -dy, -dz, as_kind, OUTSIDE, rows, surface)
                        tr, tg, tb = surface[TRANSPARENCY], surface[TRANSPARENCY + 1], surface[TRANSPARENCY + 2]
                    evaluate_along(
                        scene, triangle, u, v, dx, dy, dz, as_kind if flags & REFRACTIVE else DIFFUSE, entered[lane], rows, surface
                    )
                    seen = scene.object_visibility[scene.object[triangle]]
                    through = spread = False
                    ahead = bounce > 0 or flown[lane] + t >= before[lane]
                    receives = seen & DIFFUSE and (bounce > 0 or lights(scene.emitters, emitter[lane], scene.object, triangle))
                    unshadowed = bounce == 0 and not (seen & hiding[lane] and scene.emitters.flags[emitter[lane]] & CASTS_SHADOW)
                    if not ahead:  # on the disk of a soft lamp, of which it hides a part from what is near
                        through = True
                        clear = (tr + tg + tb) / np.float32(3.0) if reverse else _0
                        if flags & TRANSPARENT and not reverse:
                            clear = (surface[TRANSPARENCY] + surface[TRANSPARENCY + 1] + surface[TRANSPARENCY + 2]) / np.float32(3.0)
                        if not unshadowed and uniform(seed, base + lane, 1, 16 + passed) >= clear:
                            near[lane] = max(near[lane], square[lane] / (before[lane] - flown[lane] - t))
                    elif unshadowed:  # it is lit, and so is what lies behind it: the particle does one or the other
                        through = True
                        if receives and not (both[lane] and flags & REFRACTIVE):  # what glass shows of the sky, scattered rays have found
                            through = uniform(seed, base + lane, bounce, 16 + _MAX_PASSED + passed) < np.float32(0.5)
                            for c in range(3):
                                flux[lane, c] *= np.float32(2.0)
                        if through and parts_rays(seen):
                            told[lane] = max(told[lane], _APART)
                    elif flags & TRANSPARENT:
                        if bounce == 0 and flags & REFRACTIVE and parts_rays(seen):
                            told[lane] = _BY_GLASS
                        if not reverse:
                            tr, tg, tb = surface[TRANSPARENCY], surface[TRANSPARENCY + 1], surface[TRANSPARENCY + 2]
                        chance = max(tr, tg, tb)
                        ends = largest_kept(surface)
                        if angled:  # other views may see more kept
                            ends = max(ends, np.float32(_MET) * chance)
                        chance = chance / (chance + ends) if chance > _0 else _0
                        i = base + lane
                        if uniform(seed, i, bounce, 16 + passed) < chance:
                            flux[lane, 0] *= tr / chance
                            flux[lane, 1] *= tg / chance
                            flux[lane, 2] *= tb / chance
                            through = True
                            if bounce == 0 and told[lane] != _BY_GLASS and (flags & TELLING or parts_rays(seen)):
                                bent = surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2] > _0
                                told[lane] = _BY_GLASS if bent else _APART
                            if flags & REFRACTIVE:
                                if bounce == 0 and scattered[lane] == 0:
                                    bent = surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2]
                                    whole = surface[TRANSPARENCY] + surface[TRANSPARENCY + 1] + surface[TRANSPARENCY + 2]
                                    scattered[lane] = uniform(seed, i, bounce, 16 + 2 * _MAX_PASSED + passed) * whole < bent
                                squared = surface[BEND] * surface[BEND]
                                bending = bends_most(surface)
                                if bounce == 0 and by_lamp and stray(surface) >= SCATTERING:
                                    spread = True
                                    joined = joined_alpha(frost[lane], surface[FROST])
                                    surface[FROST] = rest_alpha(frost[lane], joined)
                                    frost[lane] = max(frost[lane], joined)
                                    sx, sy, sz, dx, dy, dz, w = scattered_by_glass(
                                        scene.materials, scene, scene.material[triangle], triangle, u, v, dx, dy, dz,
                                        uniform(seed, i, 17, 16 + passed), uniform(seed, i, 18, 16 + passed), surface, lobe,
                                    )  # fmt: skip
                                    for c in range(3):
                                        flux[lane, c] *= w
                                if behind and by_lamp and bending and entered[lane] == OUTSIDE:
                                    for c in range(3):
                                        flux[lane, c] *= squared
                                if not behind and by_lamp and bending:
                                    owed[lane, min(entered[lane], NESTED - 1)] = _1 / squared
                                elif not behind:
                                    ix, iy, iz = direction[lane, 0], direction[lane, 1], direction[lane, 2]
                                    evaluate_along(scene, triangle, u, v, -ix, -iy, -iz, as_kind, OUTSIDE, rows, surface)
                                    within = surface[TRANSPARENCY] + surface[TRANSPARENCY + 1] + surface[TRANSPARENCY + 2]
                                    owed[lane, min(entered[lane], NESTED - 1)] = within / (tr + tg + tb)
                                entered[lane] = passed_glass(entered[lane], behind)
                        else:  # the albedo at a hit is that of what does not let light through
                            flux[lane, 0] /= _1 - chance
                            flux[lane, 1] /= _1 - chance
                            flux[lane, 2] /= _1 - chance
                    if bounce == 0:
                        flown[lane] += t
                    if through:
                        ox, oy, oz = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
                        if spread:
                            direction[lane, 0], direction[lane, 1], direction[lane, 2] = dx, dy, dz
                        kinds = DIFFUSE | scene.emitters.shadow_kinds[emitter[lane]] if bounce == 0 else DIFFUSE
                        set_ray(packet, lane, ox, oy, oz, dx, dy, dz, np.float32(0.0), np.float32(np.inf), kinds)
                        n_rays += 1
                        landed_any = True
                        continue
                    disable_ray(packet, lane)
                    if not receives or (bounce == 0 and flown[lane] < before[lane] + near[lane]):
                        flying[lane] = False
                        continue
                    if bounce == 0 and scene.emitters.flags[emitter[lane]] & FADING:
                        fades = faded(scene.emitters, emitter[lane], near[lane], flown[lane] - before[lane])
                        for c in range(3):
                            flux[lane, c] *= fades
                    if bounce == 0 and np.float32(2.0) * flown[lane] < far[lane] < FOR_EVER and scene.emitters.kind[emitter[lane]] == SPOT:
                        for c in range(3):
                            flux[lane, c] *= AWAY_FROM_CENTRE
                    sx, sy, sz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
                    sx, sy, sz = mapped_normal(scene.materials, scene.material[triangle], surface, sx, sy, sz)
                    if not (flags & REFRACTIVE and behind):  # else it stays within the glass
                        for k in range(min(entered[lane], NESTED)):
                            for c in range(3):
                                flux[lane, c] *= owed[lane, k]
                        entered[lane] = OUTSIDE
                    cos_g = gx * dx + gy * dy + gz * dz
                    if behind:
                        gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
                        cos_g = -cos_g
                    cos_s = sx * dx + sy * dy + sz * dz
                    if bounce == 0 and both[lane] and told[lane] != _ALIKE:
                        # Cycles gives each of both kinds its share, but takes the light beyond glass whole.
                        share = _1
                        if (kind[lane] == SHADOW or told[lane] == _APART) and scene.emitters.kind[emitter[lane]] == WORLD:
                            share = sought(scene.emitters.world, -dx, -dy, -dz, max(_0, -cos_s))
                        if kind[lane] != SHADOW:
                            share = _1 if told[lane] == _BY_GLASS else _1 - share
                        for c in range(3):
                            flux[lane, c] *= np.float32(2.0) * share
                    adjoint = min(MAX_ADJOINT, max(np.float32(0.0), cos_s / cos_g)) if cos_g < 0 else np.float32(0.0)
                    i = base + lane
                    d = _EMISSION_DIMENSIONS + 2 * bounce
                    if d + 1 < 16:
                        u1, u2 = sobol(i, d, seed), sobol(i, d + 1, seed)
                    else:
                        u1, u2 = uniform(seed, i, bounce, 0), uniform(seed, i, bounce, 1)
                    fr, fg, fb = glossy_albedo(surface, min(_1, abs(cos_s)))
                    if bounce == 0 and not scene.emitters.flags[emitter[lane]] & SEEN_BY_GLOSSY:
                        fr = fg = fb = _0
                    if angled:
                        evaluate_from(scene, triangle, u, v, behind, uniform(seed, i, bounce, 4), rows, surface)
                    dr, dg, db = diffuse_albedo_average(surface)
                    if surface[SHEEN_ROUGHNESS] != _0:
                        more = lit_from(surface[SHEEN_ROUGHNESS], abs(cos_s)) - _1
                        dr, dg, db = dr + more * surface[SHEEN], dg + more * surface[SHEEN + 1], db + more * surface[SHEEN + 2]
                    if angled and flags & TRANSLUCENT:
                        evaluate_from(scene, triangle, u, v, not behind, uniform(seed, i, bounce, 5), rows, surface)
                    tr, tg, tb = translucency_average(surface)
                    if angled:  # glossy light leaves at the angle at which it came
                        evaluate_along(scene, triangle, u, v, dx, dy, dz, DIFFUSE, OUTSIDE, rows, surface)
                    if bounce == 0 and scene.emitters.flags[emitter[lane]] & GLOSSY_ONLY:
                        dr = dg = db = tr = tg = tb = _0
                        if not fr + fg + fb > _0:
                            flying[lane] = False
                            continue
                    through_sum = tr + tg + tb
                    total = dr + dg + db + fr + fg + fb + through_sum
                    albedo_sum += total / 3.0
                    albedo_count += 1
                    chance = (fr + fg + fb) / max(total, np.float32(1e-12))
                    pick = uniform(seed, i, bounce, 2)
                    glossy = pick < chance
                    transmitted = through_sum > _0 and not glossy and pick * total < fr + fg + fb + through_sum
                    if not (glossy or transmitted) or bounce == 0:
                        scattered[lane] += 1
                    if scattered[lane] > bounces:
                        flying[lane] = False
                        continue
                    lit, sharp = _1, _0
                    vpls.lobe[n, ALPHA] = -_1
                    shine = np.uint8(0)
                    if bounce > 0:
                        shine = np.uint8(THROUGH if glossy else 0)
                    elif glossy:
                        shine = np.uint8(SHINE)
                    if glossy:
                        wx, wy, wz, r, g, b = reflected(surface, lobe, sx, sy, sz, gx, gy, gz, dx, dy, dz, u1, u2)
                        r, g, b = r / chance, g / chance, b / chance
                        axis_x, axis_y, axis_z = wx, wy, wz
                        # Light that has left a surface before comes from all around: a narrow light for it would be one bright spot for many dim ones.
                        if sharpest > _0 and bounce == 0 and lobe[ALPHA] > _0:
                            _set_reflection(vpls.lobe[n], surface, max(surface[ROUGHNESS], BLUR), sx, sy, sz, gx, gy, gz, dx, dy, dz)
                        if vpls.lobe[n, ALPHA] > _0:
                            whole = lobe[ALBEDO] / (_THIRD * (fr + fg + fb) * chance)
                            all_r, all_g, all_b = whole * fr, whole * fg, whole * fb
                            axis_x, axis_y, axis_z = gx, gy, gz
                            if pick >= ROUND * chance:
                                axis_x, axis_y, axis_z, sharp = _axis(vpls.lobe[n], sharpest, gx, gy, gz)
                        lit = _uncut(gx, gy, gz, axis_x, axis_y, axis_z, sharp)
                    else:
                        rest = _1 - chance
                        if transmitted:
                            gx, gy, gz, behind = -gx, -gy, -gz, not behind
                            dr, dg, db, rest = tr, tg, tb, through_sum / total
                        elif through_sum > _0:
                            rest = (dr + dg + db) / total
                        lx, ly, lz = cosine_hemisphere(u1, u2)
                        wx, wy, wz = to_world(lx, ly, lz, gx, gy, gz)
                        left = shadowing(surface[TILT], -cos_g) / rest
                        r, g, b = left * dr, left * dg, left * db
                    if not vpls.lobe[n, ALPHA] > _0:
                        all_r, all_g, all_b = r, g, b
                    here_r, here_g, here_b = flux[lane, 0] * adjoint, flux[lane, 1] * adjoint, flux[lane, 2] * adjoint
                    r, g, b, all_r, all_g, all_b = here_r * r, here_g * g, here_b * b, here_r * all_r, here_g * all_g, here_b * all_b
                    if not max(all_r, all_g, all_b) > 0:
                        flying[lane] = False
                        continue
                    ox, oy, oz = offset_origin(x, y, z, gx, gy, gz, error, wx, wy, wz)
                    vpls.surface_normal[n, 0], vpls.surface_normal[n, 1], vpls.surface_normal[n, 2] = gx, gy, gz
                    if glossy:
                        # Shadow rays move it along its axis alone, which may graze the surface.
                        x, y, z, gx, gy, gz = ox, oy, oz, axis_x, axis_y, axis_z
                    vpls.position[n, 0], vpls.position[n, 1], vpls.position[n, 2] = x, y, z
                    vpls.normal[n, 0], vpls.normal[n, 1], vpls.normal[n, 2] = gx, gy, gz
                    vpls.flux[n, 0], vpls.flux[n, 1], vpls.flux[n, 2] = all_r * lit, all_g * lit, all_b * lit
                    vpls.error[n] = error
                    vpls.emitter[n] = emitter[lane]
                    vpls.bounce[n] = bounce + 1
                    vpls.side[n] = surface_side(scene.materials, scene.material[triangle], behind)
                    vpls.shine[n], vpls.sharpness[n] = shine, sharp
                    n += 1
                    kept_sum += (all_r + all_g + all_b) / born[lane]
                    if max(r, g, b) > 0 and bounce + 1 < len(survivors) and i < survivors[bounce + 1]:
                        more = np.float32(survivors[bounce] / survivors[bounce + 1])
                        kept = more * (r + g + b) / born[lane]
                        if kept < least:
                            if uniform(seed, i, bounce, 3) * least >= kept:
                                flying[lane] = False
                                continue
                            more *= least / kept
                        flux[lane, 0], flux[lane, 1], flux[lane, 2] = r * more, g * more, b * more
                        direction[lane, 0], direction[lane, 1], direction[lane, 2] = wx, wy, wz
                        origin[lane, 0], origin[lane, 1], origin[lane, 2] = ox, oy, oz
                    else:
                        flying[lane] = False
                passed += 1
            # A lane that still waits has passed too many surfaces: its light is lost, as in any renderer's limit.
    return n, n_rays, albedo_sum, albedo_count, kept_sum


def trace_particles(
    scene: Transport, particles: int, bounces: int, seed: int, threads: int = 0, progress: Progress | None = None
) -> tuple[Vpls, int]:
    """Fly `particles` from the lamps over at most `bounces` diffuse surfaces; VPLs and rays traced.

    The expected irradiance of the VPLs is exactly that of light which left 1 to `bounces` surfaces.
    """
    return _fly(scene, particles, bounces, seed, threads, progress, by_power=False, sharpest=0.0)


def trace_by_power(
    scene: Transport,
    particles: int,
    bounces: int,
    seed: int,
    threads: int = 0,
    progress: Progress | None = None,
    *,
    sharpest: float = SHARPEST,
) -> tuple[Vpls, int]:
    """The same light by VPLs that are more alike: which particles go on is told by what each has kept, not by its number.

    Where most particles land on something dark, as from a sun on the ground around a house, few go on by number, and the
    later bounces are a few lights of 10 to 100 times the power of the others.  What a particle has kept of its birth's light
    counts, not what it carries: where lamps are `focused`, those that are wanted are born with the least.  Glossy reflections have a
    `sharpness`, `sharpest` at most: 0 for methods that do not shade by it.
    Other arguments, and values, as `trace_particles`.
    """
    return _fly(scene, particles, bounces, seed, threads, progress, by_power=True, sharpest=sharpest)


def _fly(
    scene: Transport, particles: int, bounces: int, seed: int, threads: int, progress: Progress | None, *, by_power: bool, sharpest: float
) -> tuple[Vpls, int]:
    chunk = 1024
    seed, none = np.uint32(seed), np.float32(0)
    probe = n_rays = albedo_count = 0
    while albedo_count == 0 and probe < particles:  # the first that land: of lamps far off few do
        probe = min(particles, _MORE * probe or chunk)
        room = Vpls.allocate(probe)
        n, rays, albedo_sum, albedo_count, kept_sum = _trace_particles(
            scene, 0, probe, np.array([probe], np.int64), none, none, 1, seed, room
        )
        n_rays += rays
    if albedo_count == 0 or bounces < 1:
        return Vpls.allocate(0), n_rays
    surfaces = bounces + (_MORE_SURFACES if (scene.materials.flags & (GLOSSY_LOBE | TRANSLUCENT)).any() else 0)
    if by_power:
        least = np.float32(LEAST_POWER * kept_sum / n) if n else none
        survivors = np.full(surfaces, particles, np.int64)
    else:
        least, rho = none, min(max(albedo_sum / albedo_count, 0.05), 1.0)
        survivors = np.array([max(math.floor(rho**j * particles), min(particles, 16)) for j in range(surfaces)], np.int64)

    def work(begin, end):
        room = Vpls.allocate((end - begin) * surfaces)
        n, rays, *_ = _trace_particles(scene, begin, end, survivors, least, np.float32(sharpest), bounces, seed, room)
        return room.take(slice(0, n)), rays

    parts = run_chunks(work, particles, chunk, threads, progress)
    vpls = Vpls.concatenate([part for part, _ in parts])
    vpls.flux[:] *= np.float32(1.0 / particles)
    return vpls, n_rays + sum(rays for _, rays in parts)
