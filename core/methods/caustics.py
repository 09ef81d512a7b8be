"""Caustics: the lamps' light that glass bends, or that polished surfaces reflect, on its way to what is lit.

A shadow ray goes straight and cannot find what lenses throw (`surfaces.visibility` tells where one is in the way); virtual lights stand for what
glossy lobes throw, but of no lobe narrower than `particles.BLUR`, and close by they are clamped.  Photons find both (Jensen 1996,
"Global Illumination using Photon Maps"): they leave the lamps, are bent by clear glass and scattered by frosted glass, or reflected by the
lobes that they meet, and are told of where they land after that.  Each shines on what lies among its nearest neighbours.  Lamps of no size have
none by lenses and mirrors, as in Cycles, whose paths cannot meet them by chance.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..jit import inlined, kernel, leaf
from ..lamps.direct import set_point_lobe
from ..lamps.emission import FOR_EVER, emit, focused
from ..lamps.links import lights
from ..lamps.lookup import EACH, ray_kind
from ..lamps.shapes import AWAY_FROM_CENTRE
from ..lamps.tables import CASTS_SHADOW, FADING, ONE_MINUS_COS, RADIUS, SEEN_BY_GLOSSY, SEEN_THROUGH_GLASS, WORLD
from ..particles import BLUR, MAX_ADJOINT, NESTED, faded, reflected
from ..rays.offsets import hit_point, offset_origin, shadow_segment
from ..rays.packet import WIDTH, is_occluded, new_packet, set_ray
from ..rays.trace import ALL, OPAQUE, intersect1, occluded1, occluded_packet
from ..references import Reference
from ..sampling.hashing import hash_combine, uniform
from ..sampling.maps import orthonormal_basis
from ..sampling.sequences import sobol
from ..scene import ANGLED, DIFFUSE, FROSTED, METAL, POINT, REFRACTIVE, SHADOW, SPOT, SUN, TRANSPARENT, bounds
from ..surfaces.bending import GOES_STRAIGHT, TURNS, bent, scattered
from ..surfaces.brushed import ROUGHEST
from ..surfaces.frosted import joined_alpha, rest_alpha
from ..surfaces.layout import BEND, FROST, REFRACTION, ROUGHNESS, SURFACE, TRANSLUCENCY, TRANSPARENCY, passing_chance
from ..surfaces.layout import DIFFUSE as SURFACE_DIFFUSE
from ..surfaces.lobes import ALPHA, LOBE, WIDE_ALPHA, lobe_value
from ..surfaces.microfacet import SMALLEST_ALPHA
from ..surfaces.normals import mapped_normal, shading_normal
from ..surfaces.program import new_registers
from ..surfaces.visibility import OUTSIDE, SCATTERING, STRAIGHT_ON, bends_most, evaluate_along, is_lens, is_sheet, passed_glass, stray
from ..threads import Progress, run_chunks
from ..transport import Transport
from .wide_lobes import by_photons, is_wide

CHUNK = 4096  # particles a chunk
GLANCE, PILOT = 1 << 14, 1 << 16  # particles that tell whether any meet a lens or a lobe, and where
MARGIN = 0.01  # of the extent of the points, around them, in which photons count as useful
TELLING = 64  # photons that tell where
PHOTONS_A_POINT = 0.125  # wanted
FEWEST, MOST = 1 << 14, 1 << 15  # of them in any case
BY_LOBES = 1 << 17  # wanted of what lobes throw: they cost little, and the noise of what many points share is what a denoiser leaves
VPLS = 4096  # beside fewer, as in quick pictures, photons are fewer by the same share; by lobes, beside more, more
MOST_BESIDE = 16  # times as many, at most
# To fewer points than these, as small pictures have, photons by lobes are fewer, too, by the root of the share, and the least part of them: their noise is
# spread over fewer pixels, beside more of other kinds.
MANY_POINTS, FEWEST_BESIDE = 1 << 17, 0.25
MOST_FLOWN, MOST_BY_LOBES = 1 << 20, 1 << 20  # particles; virtual lights could stand for what lobes throw as well
NEAREST = 48  # photons among which the light of one is spread that lenses have bent
# Of how far frosted glass has spread light, by which a photon of it is spread itself, and how much wider than others that makes its disk at most.
PART_BLURRED, MOST_BLURRED = 0.5, 4.0
FEWEST_NEAREST, PART_NEAREST, MOST_NEAREST = 64, 1 / 256, 256  # the same of what lobes reflect, which is less sharp
WORTHWHILE = 0.02  # share of the view's light that lobes throw, weighed by how far virtual lights blur them
# Share of the view's light from which on all photons are traced, however wide the lobes (close by, the clamp leaves virtual lights' part to rays that know
# no direction), and the least part of them.
MUCH, LEAST_PART = 0.2, 0.125
MOST_WANTED = 4.0  # times as many, where they bring more than that
# Of the disks of photons by lobes as wide as virtual lights can tell, the least part that must meet something which they light, as so many of them tell: on leaves
# and other small things photons are noisier than virtual lights.
LEAST_MET, LOOKED_AT = 0.25, 1024
# Of those that several lobes have reflected: fewer neighbours tell nothing, and a smaller part of the light is left out.
FEWEST_AGAIN, LITTLE = 8, 0.005
MANY = 4  # times as many photons as neighbours, at least: fewer tell nothing
LOOKS = 32  # of the photons by lobes around it that each point looks at: its own noise is the denoiser's
FEW_LOOKS = 0.5  # root of the least part of these, where they bring little
ASKED = 16  # neighbours that tell how far more of them are
RAYS_A_DISK, EVERY_ONE = 8, 1 << 30  # rays that tell how much of it there is; count them all
SPARSE = 2.0  # times the median of the distances at which they lie: none is spread farther
MOST_LOBES = 16  # one after the other, as in a polished can; few go on so far
_SURFACES = 32  # that a photon meets at most
_ALIKE = np.float32(0.7)  # cosine of the normals of a point and of a photon that lights it, at least
_THICK = np.float32(0.1)  # of that distance: photons so far out of a point's plane are of another surface
_SMALLER = 4  # disks that are tried at most, each half as wide as the one before, of photons most of whose disk is lost
_LAYERS = 4  # that lie so near each other, at most
MOST_PASSING = np.float32(0.75)  # of the particles that meet the rim of a leaf's picture: the others have so much the more light
_MOST_KEPT = np.float32(8.0)  # times its flux: in foliage no more of it is kept
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_HALF = np.float32(0.5)
_INV_PI = np.float32(1 / math.pi)


class Photons(NamedTuple):
    """P photons: where lamps' light has landed that lenses bent or lobes reflected.

    position: (P, 3) float32 (m).  normal: (P, 3) float32, geometric, on the lit side.  direction: (P, 3) float32, unit, in which they flew.
    entry: (P, 3) float32, where they first met glass, or the lobe (m).  facing: (P, 3) float32, geometric normal of the lobe's surface, on the
    side to which it reflects; 0 without one.  flux: (P, 3) float32, W.  side: (P,) float32, 1 where the normal is their triangle's own, else -1.
    group: (P,) int32, their lamps' light groups.  metal: (P,) uint8, whether metal reflected them.  narrow: (P,) float32, by how much narrower it is
    than virtual lights can tell, by `particles.BLUR`: 0 to 1.  followed: (P,) uint8, whether rays that meet the lobe follow it.
    lobes: (P,) uint8, how many lobes have reflected it, one after the other; 1 where glass has bent or scattered a lamp's light, 0 for the world's.
    blur: (P,) float32, how far frosted glass has spread the light of which it is a part (m).
    """

    position: np.ndarray
    normal: np.ndarray
    direction: np.ndarray
    entry: np.ndarray
    facing: np.ndarray
    flux: np.ndarray
    side: np.ndarray
    group: np.ndarray
    metal: np.ndarray
    narrow: np.ndarray
    followed: np.ndarray
    lobes: np.ndarray
    blur: np.ndarray

    @staticmethod
    def allocate(n: int) -> Photons:
        """Room for n photons, not set."""
        return Photons(
            *(np.empty((n, 3), np.float32) for _ in range(6)),
            np.empty(n, np.float32),
            np.empty(n, np.int32),
            np.empty(n, np.uint8),
            np.empty(n, np.float32),
            *(np.empty(n, np.uint8) for _ in range(2)),
            np.empty(n, np.float32),
        )

    def take(self, index) -> Photons:
        """The photons at `index` (anything that indexes an array)."""
        return Photons(*(np.ascontiguousarray(a[index]) for a in self))


def bends_light(scene: Transport) -> bool:
    """Whether there is glass at all, and light to bend."""
    return bool((scene.materials.flags & REFRACTIVE).any()) and bool(scene.emitters.flux.any())


@inlined
def _shows(surface, lobes):
    """Whether a photon that so many lobes have reflected is of use where it lands: what nearly mirrors, as the inside of a can, shows no irradiance.

    There most photons may land, which told how wide the disks of all are: those of the few others would be sparks.
    """
    most = _0
    for c in range(3):
        most = max(most, surface[SURFACE_DIFFUSE + c], surface[TRANSLUCENCY + c])
    return most > _0 or (lobes == 1 and surface[ROUGHNESS] * surface[ROUGHNESS] > WIDE_ALPHA)


@kernel
def _fly(scene, begin, end, seed, lobes, bounces, photons):
    """Fly the particles begin..end-1 through lenses, or by way of `lobes` -> (how many photons they leave, rays traced).

    bounces: as of the picture; to have come through glass counts as one.
    """
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface, lens = np.zeros(SURFACE, np.float32), np.zeros(SURFACE, np.float32)
    lobe = np.zeros(LOBE, np.float32)
    owed, back = np.empty(NESTED, np.float32), np.empty(6, np.float32)
    emitters = scene.emitters
    any_frosted = False
    for material in range(len(scene.materials.flags)):
        any_frosted |= scene.materials.flags[material] & FROSTED != 0
    n = rays = 0
    for i in range(begin, end):
        e, ox, oy, oz, dx, dy, dz, r, g, b, near, far, before = emit(
            emitters, rows, surface, sobol(i, 0, seed), sobol(i, 1, seed), sobol(i, 2, seed), sobol(i, 3, seed), sobol(i, 4, seed)
        )
        if e < 0 or not max(r, g, b) > _0 or not emitters.flags[e] & (SEEN_BY_GLOSSY if lobes else CASTS_SHADOW):
            continue
        if not lobes and not emitters.flags[e] & SEEN_THROUGH_GLASS:
            continue
        kind = emitters.kind[e]
        sizeless = ((kind == POINT or kind == SPOT) and not emitters.lamps[e, RADIUS] > _0) or (
            kind == SUN and not emitters.lamps[e, ONE_MINUS_COS] > _0
        )
        if sizeless and not lobes and not any_frosted:
            continue
        hides = emitters.shadow_kinds[e]
        kinds = DIFFUSE | hides
        thrown = metal = followed = False
        narrow, met = _0, np.int64(0)
        ax, ay, az = dx, dy, dz  # the straight way
        square = near * before
        x = y = z = qx = qy = qz = fx = fy = fz = flown = _0
        glasses = sheets = fronts = 0  # sheets: of them, that bend it; fronts: whose backs it has not met
        entered = OUTSIDE
        frost = strayed = _0  # strayed: by frosted glass, of its distance from the lamp (m)
        for layer in range(_SURFACES):
            rays += 1
            triangle, t, u, v = intersect1(scene.rays, ALL, packet, ox, oy, oz, dx, dy, dz, _0, np.float32(np.inf), kinds)
            flown += t
            if triangle < 0 or (glasses == 0 and not thrown and flown > far):
                break
            px, py, pz, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
            behind = gx * dx + gy * dy + gz * dz > _0
            flags = scene.materials.flags[scene.material[triangle]]
            seen = scene.object_visibility[scene.object[triangle]]
            passes, reverse = flags & TRANSPARENT != 0, False
            receives = seen & DIFFUSE != 0 and (thrown or lights(emitters, e, scene.object, triangle))
            if flown < before and not thrown and not flags & REFRACTIVE:
                # On the disk of a soft lamp, of which it hides a part from what is near.
                if seen & hides and emitters.flags[e] & CASTS_SHADOW:
                    clear = _0
                    if passes:
                        evaluate_along(scene, triangle, u, v, -dx, -dy, -dz, SHADOW, OUTSIDE, rows, surface)
                        clear = (surface[TRANSPARENCY] + surface[TRANSPARENCY + 1] + surface[TRANSPARENCY + 2]) / np.float32(3.0)
                    if uniform(seed, i, layer, 20) >= clear:
                        near = max(near, square / (before - flown))
                ox, oy, oz = offset_origin(px, py, pz, gx, gy, gz, error, dx, dy, dz)
                continue
            if lobes and not thrown and not (seen & hides and emitters.flags[e] & CASTS_SHADOW):
                # It is lit, and so is what lies behind it: the particle does one or the other.
                passes = not receives or uniform(seed, i, layer, 19) < _HALF
                if receives:
                    r, g, b = _2 * r, _2 * g, _2 * b
                if passes:
                    ox, oy, oz = offset_origin(px, py, pz, gx, gy, gz, error, dx, dy, dz)
                    continue
            elif passes:
                seen_as = ray_kind(emitters, e, -dx, -dy, -dz)
                sent = lobes and not thrown and (seen_as == SHADOW or seen_as == EACH)
                first = SHADOW if sent else DIFFUSE
                # What comes through is seen from the other end; a view from within a solid may be reflected totally.  A lamp in glass sends its light out as it is bent.
                reverse = flags & (ANGLED | REFRACTIVE) == ANGLED or (
                    flags & REFRACTIVE != 0 and behind and fronts == 0 and (kind == WORLD or thrown)
                )
                if reverse:
                    evaluate_along(scene, triangle, u, v, -dx, -dy, -dz, first, OUTSIDE, rows, surface)
                    for c in range(3):
                        back[c], back[3 + c] = surface[TRANSPARENCY + c], surface[REFRACTION + c]
                evaluate_along(scene, triangle, u, v, dx, dy, dz, first if flags & REFRACTIVE else DIFFUSE, entered, rows, surface)
                if reverse:
                    for c in range(3):
                        surface[TRANSPARENCY + c], surface[REFRACTION + c] = back[c], back[3 + c]
                chance = passing_chance(surface, flags & ANGLED != 0)
                if chance < _1:  # what it leaves lights all that is around, however little of the surface there is just there
                    chance = min(chance, MOST_PASSING)
                passes = uniform(seed, i, layer, 16) < chance
                rest = _1 / chance if passes else _1 / (_1 - chance)
                if passes:
                    r, g, b = r * rest * surface[TRANSPARENCY], g * rest * surface[TRANSPARENCY + 1], b * rest * surface[TRANSPARENCY + 2]
                else:
                    r, g, b = r * rest, g * rest, b * rest
                if not chance > _0 and behind and flags & REFRACTIVE and glasses > 0:  # total reflection
                    nx, ny, nz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
                    twice = _2 * (nx * dx + ny * dy + nz * dz)
                    dx, dy, dz = dx - twice * nx, dy - twice * ny, dz - twice * nz
                    if gx * dx + gy * dy + gz * dz >= _0:
                        break
                    ox, oy, oz = offset_origin(px, py, pz, gx, gy, gz, error, dx, dy, dz)
                    continue
            if (
                not passes and strayed > _0 and not thrown and flags & REFRACTIVE and behind
            ):  # back into the frosted glass, which it leaves on its other side, or later
                nx, ny, nz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
                nx, ny, nz = mapped_normal(scene.materials, scene.material[triangle], surface, nx, ny, nz)
                dx, dy, dz, kr, kg, kb = reflected(
                    surface, lobe, -nx, -ny, -nz, -gx, -gy, -gz, dx, dy, dz, uniform(seed, i, layer, 21), uniform(seed, i, layer, 22)
                )
                r, g, b = kr * r, kg * g, kb * b
                if not max(r, g, b) > _0:
                    break
                ox, oy, oz = offset_origin(px, py, pz, gx, gy, gz, error, dx, dy, dz)
                continue
            if not passes:
                bends = glasses > 0 and (is_lens(glasses, x, y, z, ax, ay, az) or (kind != WORLD and not lobes and is_sheet(sheets)))
                if not lobes and kind != WORLD:
                    # As `surfaces.visibility.transmittance1` has it.
                    scattering = strayed > _0 and strayed >= SCATTERING * (_1 if kind == SUN else flown - before)
                    bends = scattering or (bends and not sizeless)
                    met = 1  # wide lobes' own rays go straight on, and would see the lamp where it is not
                # What is within a solid is lit by straight rays.
                if not receives or (flags & REFRACTIVE and (thrown or not lobes)) or (not thrown and flown < before + near):
                    break
                if not (flags & REFRACTIVE and behind):  # else it stays within the glass
                    for k in range(min(fronts, NESTED)):
                        r, g, b = owed[k] * r, owed[k] * g, owed[k] * b
                    fronts = 0
                if not (bends or lobes) or (lobes and not thrown and (bends or (glasses > 0 and bounces < 2))):
                    break
                if lobes and not flags & TRANSPARENT:
                    evaluate_along(scene, triangle, u, v, dx, dy, dz, DIFFUSE, OUTSIDE, rows, surface)
                if not lobes or (thrown and _shows(surface, met)):
                    side = -_1 if behind else _1
                    photons.position[n, 0], photons.position[n, 1], photons.position[n, 2] = px, py, pz
                    photons.normal[n, 0], photons.normal[n, 1], photons.normal[n, 2] = side * gx, side * gy, side * gz
                    photons.direction[n, 0], photons.direction[n, 1], photons.direction[n, 2] = dx, dy, dz
                    photons.entry[n, 0], photons.entry[n, 1], photons.entry[n, 2] = qx, qy, qz
                    photons.facing[n, 0], photons.facing[n, 1], photons.facing[n, 2] = fx, fy, fz
                    photons.flux[n, 0], photons.flux[n, 1], photons.flux[n, 2] = r, g, b
                    photons.side[n], photons.group[n] = side, emitters.light_group[e]
                    photons.metal[n], photons.narrow[n], photons.followed[n], photons.lobes[n] = metal, narrow, followed, met
                    away = np.float32(math.sqrt((px - qx) ** 2 + (py - qy) ** 2 + (pz - qz) ** 2))
                    photons.blur[n] = _0 if thrown else _2 * frost * away
                    n += 1
                if not lobes or met == MOST_LOBES:
                    break
                if not thrown and sizeless and not surface[ROUGHNESS] * surface[ROUGHNESS] > SMALLEST_ALPHA:
                    break
                nx, ny, nz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
                nx, ny, nz = mapped_normal(scene.materials, scene.material[triangle], surface, nx, ny, nz)
                if behind:
                    gx, gy, gz, nx, ny, nz = -gx, -gy, -gz, -nx, -ny, -nz
                cos_g, cos_s = gx * dx + gy * dy + gz * dz, nx * dx + ny * dy + nz * dz
                if not cos_g < _0:
                    break
                w = min(MAX_ADJOINT, max(_0, cos_s / cos_g))
                if not thrown and emitters.flags[e] & FADING:
                    w *= faded(emitters, e, near, flown - before)
                if not thrown and kind == SPOT and _2 * flown < far < FOR_EVER:
                    w *= AWAY_FROM_CENTRE
                u1, u2 = uniform(seed, i, layer, 21), uniform(seed, i, layer, 22)
                if not thrown:
                    u1, u2 = sobol(i, 5, seed), sobol(i, 6, seed)
                dx, dy, dz, kr, kg, kb = reflected(surface, lobe, nx, ny, nz, gx, gy, gz, dx, dy, dz, u1, u2)
                if thrown:  # some go on, and carry for all
                    kept = w * max(kr, kg, kb)
                    if uniform(seed, i, layer, 23) >= kept:
                        break
                    w /= min(_1, kept)
                r, g, b = w * kr * r, w * kg * g, w * kb * b
                if not max(r, g, b) > _0:
                    break
                ox, oy, oz = offset_origin(px, py, pz, gx, gy, gz, error, dx, dy, dz)
                qx, qy, qz, fx, fy, fz = ox, oy, oz, gx, gy, gz
                thrown, entered, kinds = True, OUTSIDE, DIFFUSE
                met += 1
                metal = flags & METAL > 0
                narrow = max(_0, _1 - (surface[ROUGHNESS] / BLUR) ** 2)
                followed = surface[ROUGHNESS] < ROUGHEST
                continue
            # What hides from diffuse rays sends none of them to the lamp.
            if seen & DIFFUSE and surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2] > _0:
                nx, ny, nz = shading_normal(scene.corner_normals, triangle, u, v, _0, _0, _0)
                x, y, z = x + nx, y + ny, z + nz
                if glasses == 0 and not lobes:
                    qx, qy, qz = px, py, pz
                glasses += 1
                material = scene.material[triangle]
                turn = GOES_STRAIGHT
                eta = surface[BEND]
                sheets += bends_most(surface)
                front = surface[TRANSPARENCY] + surface[TRANSPARENCY + 1] + surface[TRANSPARENCY + 2]
                ix, iy, iz = dx, dy, dz
                strayed = max(strayed, stray(surface) * (_1 if kind == SUN else flown - before))
                joined = joined_alpha(frost, surface[FROST])
                surface[FROST] = rest_alpha(frost, joined)
                frost = max(frost, joined)
                if abs(eta - _1) > STRAIGHT_ON and not reverse:  # what leaves such a solid goes straight on, as its reverse is seen
                    turn, ox, oy, oz, dx, dy, dz = bent(scene.materials, scene, material, triangle, u, v, dx, dy, dz, surface, False)
                turns = turn == TURNS
                if not turns:
                    entered = passed_glass(entered, behind)
                if behind:
                    if turns and fronts == 0 and bends_most(surface):  # as below
                        r, g, b = eta * eta * r, eta * eta * g, eta * eta * b
                    fronts = max(fronts - 1, 0)
                else:
                    # Seen from within, as where a pane is one sheet: bent light is denser there by the square of the index, but no brighter to Cycles.
                    owes = _1 / (eta * eta)
                    if not turns:
                        evaluate_along(scene, triangle, u, v, -ix, -iy, -iz, DIFFUSE, OUTSIDE, rows, lens)
                        owes = (lens[TRANSPARENCY] + lens[TRANSPARENCY + 1] + lens[TRANSPARENCY + 2]) / front
                    owed[min(fronts, NESTED - 1)] = owes
                    fronts += 1
                if turns and not behind:  # within, it is narrower
                    surface[FROST] /= eta
                if surface[FROST] > SMALLEST_ALPHA:  # about the way that clear glass would send it
                    ox, oy, oz, dx, dy, dz, w = scattered(
                        scene.materials, scene, material, triangle, u, v, dx, dy, dz,
                        uniform(seed, i, layer, 17), uniform(seed, i, layer, 18), surface, lobe,
                    )  # fmt: skip
                    r, g, b = w * r, w * g, w * b
                    if not max(r, g, b) > _0:
                        break
                    continue
                if turns:
                    continue
            ox, oy, oz = offset_origin(px, py, pz, gx, gy, gz, error, dx, dy, dz)
    return n, rays


def _traced(
    scene: Transport, particles: int, seed: int, threads: int, progress: Progress | None, lobes: bool, bounces: int
) -> tuple[Photons, int]:
    """Photons of so many particles, whose flux is still times the number of particles, and the rays traced."""

    def work(begin, end):
        room = Photons.allocate((end - begin) * (MOST_LOBES if lobes else 1))
        n, rays = _fly(scene, begin, end, np.uint32(seed), lobes, bounces, room)
        return Photons(*(column[:n].copy() for column in room)), rays  # of room for many few are used

    parts = run_chunks(work, particles, CHUNK, threads, progress)
    return Photons(*(np.concatenate(columns) for columns in zip(*(part for part, _ in parts)))), sum(rays for _, rays in parts)


def trace_photons(
    scene: Transport, position: np.ndarray, wanted: float, most: int, bounces: int, seed: int, threads: int = 0,
    progress: Progress | None = None, *, lobes: bool = False, worth: float = 0.0, wide: float = 0.0, nearest: int = 0,
) -> tuple[Photons, int]:  # fmt: skip
    """About so many photons `wanted` around points (N, 3), of `most` particles, none where nothing throws light on anything; and the rays traced.

    Their density, flux a unit of area, is the irradiance (W/m^2) that shadow rays miss; or, with `lobes`, what glossy surfaces reflect
    of the lamps' light, one or several in turn; those of one are counted and asked for.  bounces: as of the picture.  worth: what the mean
    `Photons.narrow` of those around the points, weighed by their light, must be at least; else there are none.  wide: part of the points that have wide lobes: to these what metal throws is worth as much as by narrow ones, for
    it is bright, and by rays from the lobes alone all noise.  nearest: above 0, there may be photons of wider lobes, too, where the disks of most, among so many
    neighbours, meet what they light.

    Raises:
        core.threads.Cancelled: `progress` returned False.
    """
    if not len(position):
        return Photons.allocate(0), 0
    low, high = bounds(position)
    margin = MARGIN * (high - low).max()
    how = threads, progress, lobes, bounces

    def useful(photons: Photons) -> np.ndarray:
        return ((photons.position >= low - margin) & (photons.position <= high + margin)).all(axis=1) & (photons.lobes <= 1)

    photons, rays = _traced(scene, GLANCE, seed, *how)
    if not useful(photons).any():
        return photons.take(slice(0, 0)), rays
    if np.count_nonzero(useful(photons)) < TELLING:
        photons, more = _traced(scene, PILOT, seed, *how)
        rays += more
    telling = useful(photons)
    light = photons.flux[telling].sum(axis=1, dtype=np.float64)
    blurred = light @ np.maximum(photons.narrow[telling], np.float32(wide) * photons.metal[telling]) < worth * light.sum()
    if blurred and not nearest:
        return photons.take(slice(0, 0)), rays
    if np.count_nonzero(telling) >= TELLING:
        scene = scene._replace(emitters=focused(scene.emitters, photons.entry[telling]))
        photons, more = _traced(scene, PILOT, seed + 1, *how)
        rays += more
        if blurred:
            around = photons.take(useful(photons))
            met, more = _part_met(scene, around, nearest * len(around.group) / wanted, seed, threads)
            rays += more
            if met < LEAST_MET:
                return photons.take(slice(0, 0)), rays
    flown = PILOT
    needed = min(int(flown * wanted / max(1, np.count_nonzero(useful(photons)))), most)
    if needed > flown:  # the first of them are the same
        photons, more = _traced(scene, needed, seed + 1, *how)
        rays += more
        flown = needed
    photons.flux[:] *= np.float32(1 / flown)
    return photons, rays


def by_lenses(
    scene: Transport, position: np.ndarray, vpls: int, bounces: int, seed: int, threads: int = 0, progress: Progress | None = None
) -> tuple[Caustics | None, int]:
    """What lenses throw on points (N, 3), None for nothing, beside so many VPLs; and the rays traced."""
    wanted = min(max(FEWEST, PHOTONS_A_POINT * len(position)), MOST) * min(1.0, vpls / VPLS)
    photons, rays = trace_photons(scene, position, wanted, MOST_FLOWN, bounces, seed, threads, progress)
    if len(photons.group) <= NEAREST:
        return None, rays
    caustics = arranged(photons, NEAREST, threads)
    return caustics, rays + keep_light(scene, caustics, seed, threads)


def by_lobes(
    scene: Transport, position: np.ndarray, share: float, wide: float, vpls: int, bounces: int, seed: int, threads: int = 0,
    progress: Progress | None = None,
) -> tuple[Caustics | None, Caustics | None, int]:  # fmt: skip
    """What glossy surfaces throw on points (N, 3) of the lamps' light, None where that is little, beside so many VPLs; and the rays traced.

    By one lobe, and by several, one after the other.

    share: of the points' light that it is, about.  wide: part of the points that have wide lobes.
    """
    if share < WORTHWHILE:
        return None, None, 0
    part = min(1.0, max(share / MUCH, LEAST_PART))  # of less light, more noise is as good
    # By powers of two, so that frames of a sequence agree.
    fewer = 2.0 ** round(0.5 * math.log2(max(len(position), 1) / MANY_POINTS))
    more = min(vpls / VPLS, MOST_BESIDE) * min(max(fewer, FEWEST_BESIDE), 1.0)
    most = min(max(share / MUCH, 1.0), MOST_WANTED)  # of the greater part of the light, less noise
    wanted = part * more * BY_LOBES
    nearest = int(most * np.clip(PART_NEAREST * wanted, FEWEST_NEAREST, MOST_NEAREST))
    wanted *= most
    photons, rays = trace_photons(
        scene, position, wanted, int(most * part * more * MOST_BY_LOBES), bounces, seed, threads, progress,
        lobes=True, worth=WORTHWHILE / share, wide=wide, nearest=nearest if share >= MUCH else 0,
    )  # fmt: skip
    first = photons.take(photons.lobes == 1)
    if len(first.group) < MANY * nearest:
        return None, None, rays
    every = max(1, int(nearest / (LOOKS * max(part, FEW_LOOKS) ** 2)))
    caustics, further = arranged(first, nearest, threads, tested=True, every=every), None
    rays += keep_light(scene, caustics, seed, threads)
    others = photons.take(photons.lobes > 1)
    # As wide disks: wider ones would lose more of their light at edges and in corners.
    nearest = min(max(FEWEST_AGAIN, nearest * len(others.group) // len(first.group)), len(others.group) // MANY)
    if nearest >= FEWEST_AGAIN and others.flux.sum() > LITTLE * first.flux.sum():
        further = arranged(others, nearest, threads, tested=True, every=min(every, max(1, nearest // LOOKS)))
        rays += keep_light(scene, further, seed, threads)
    return caustics, further, rays


class Caustics(NamedTuple):
    """P photons and the disks that they light, in cells at least as wide, one size of them for each power of two.

    radius: (P,) float32, of the disks (m).  cell: (P,) uint64, where they lie.  start: (H + 1,) int64, rows of the photons in each
    of H slots, a power of two.  origin: (3,) float32, of the cells.  edge: (L,) float32, their sides (m).  box: (L, 2, 3) float32, what each size lights.
    tested: whether what they light must see where they come from.  every: of the photons around a point it looks at so-manyth.
    """

    photons: Photons
    radius: np.ndarray
    cell: np.ndarray
    start: np.ndarray
    origin: np.ndarray
    edge: np.ndarray
    box: np.ndarray
    tested: bool
    every: int


@inlined
def _cell(level, ix, iy, iz):
    """Of a size, by its place: one integer."""
    mixed = (np.uint64(ix) * np.uint64(0x9E3779B97F4A7C15)) ^ (np.uint64(iy) * np.uint64(0xC2B2AE3D27D4EB4F))
    return (mixed ^ (np.uint64(iz) * np.uint64(0x165667B19E3779F9))) * np.uint64(0xD1B54A32D192ED03) + np.uint64(level)


@inlined
def _slot(cell, slots):
    return np.int64((cell >> np.uint64(24)) & np.uint64(slots - 1))


@kernel
def _cells(position, level, origin, edge, cell):
    for p in range(len(level)):
        inverse = _1 / edge[level[p]]
        cell[p] = _cell(
            level[p],
            np.int64(math.floor((position[p, 0] - origin[0]) * inverse)),
            np.int64(math.floor((position[p, 1] - origin[1]) * inverse)),
            np.int64(math.floor((position[p, 2] - origin[2]) * inverse)),
        )


def arranged(photons: Photons, nearest: int, threads: int = 0, *, tested: bool = False, every: int = 1) -> Caustics:
    """Photons, more than `nearest`, each of which lights a disk that reaches to so many neighbours, so that all of its light arrives.

    By the nearest photons of each point instead, dark surroundings would shine.
    """
    radius = _reach(photons.position, nearest, threads)
    radius = np.clip(radius, 1e-9, SPARSE * np.median(radius))
    radius = np.maximum(radius, np.minimum(PART_BLURRED * photons.blur, MOST_BLURRED * radius)).astype(np.float32)
    finest = radius.min()
    level = np.ceil(np.log2(radius / finest) - 1e-3).astype(np.int64)
    kinds, level = np.unique(level, return_inverse=True)
    edge = (2.02 * finest * 2.0**kinds).astype(np.float32)
    box = np.empty((len(kinds), 2, 3), np.float32)
    for k in range(len(kinds)):
        near = photons.position[level == k]
        box[k] = near.min(axis=0) - edge[k], near.max(axis=0) + edge[k]
    cell, origin = np.empty(len(level), np.uint64), photons.position.min(axis=0)
    _cells(photons.position, level, origin, edge, cell)
    slots = 1 << int(2 * len(level)).bit_length()
    slot = ((cell >> np.uint64(24)) & np.uint64(slots - 1)).astype(np.int64)
    order = np.argsort(slot, kind="stable")
    start = np.zeros(slots + 1, np.int64)
    np.cumsum(np.bincount(slot, minlength=slots), out=start[1:])
    return Caustics(photons.take(order), radius[order], cell[order], start, origin, edge, box, tested, every)


def _reach(position: np.ndarray, nearest: int, threads: int) -> np.ndarray:
    """How far about `nearest` others of the photons (P, 3) are around each, (P,) m, by the first so-manyth of them: as good, and cheaper."""
    part = max(1, nearest // ASKED)
    known, k = -(-len(position) // part), -(-nearest // part)
    query = partial(cKDTree(position[:known]).query, workers=threads or -1)
    own, others = query(position[:known], [k + 1])[0], query(position[known:], [k])[0]  # the first ones find themselves, too
    return np.concatenate([own[:, 0], others[:, 0]])


@inlined
def _is_ahead(photons, p, x, y, z):
    """Whether a point lies on the side of the surface to which the lobe reflects that has thrown photon p: glass hides nothing behind it."""
    dx, dy, dz = x - photons.entry[p, 0], y - photons.entry[p, 1], z - photons.entry[p, 2]
    return photons.facing[p, 0] * dx + photons.facing[p, 1] * dy + photons.facing[p, 2] * dz >= _0


@leaf
def _is_hole(scene, triangle, u, v, dx, dy, dz, rows, surface):
    """Whether a photon along d cannot stay at a place of a triangle: glass, or where a leaf's picture shows nothing."""
    flags = scene.materials.flags[scene.material[triangle]]
    if not flags & TRANSPARENT:
        return False
    evaluate_along(scene, triangle, u, v, dx, dy, dz, DIFFUSE, OUTSIDE, rows, surface)
    return flags & REFRACTIVE != 0 or not passing_chance(surface, flags & ANGLED != 0) < _1


@leaf
def _met(scene, packet, rows, surface, photons, p, r, tested, seed, enough):
    """How many of `RAYS_A_DISK` rays through the disk of photon p, of radius r, meet what it lights there, counted up to `enough`; and the rays traced."""
    mx, my, mz = photons.normal[p, 0], photons.normal[p, 1], photons.normal[p, 2]
    tx, ty, tz, bx, by, bz = orthonormal_basis(mx, my, mz)
    thick = _THICK * r
    met = rays = 0
    for k in range(RAYS_A_DISK):
        if met >= enough:
            break
        # Spread as Epanechnikov's kernel is, each by chance: `_keep` takes their number for a binomial's.  Down through all that the light reaches.
        away = r * np.float32(math.sqrt(_1 - math.sqrt(_1 - uniform(seed, p, k, 1))))
        angle = np.float32(2 * math.pi) * uniform(seed, p, k, 0)
        a, b = away * np.float32(math.cos(angle)), away * np.float32(math.sin(angle))
        high = min(thick, np.float32(math.sqrt(r * r - away * away)))
        ox, oy, oz = (
            photons.position[p, 0] + a * tx + b * bx + high * mx,
            photons.position[p, 1] + a * ty + b * by + high * my,
            photons.position[p, 2] + a * tz + b * bz + high * mz,
        )
        far = _2 * high
        for layer in range(_LAYERS):
            triangle, t, u, v = intersect1(scene.rays, ALL, packet, ox, oy, oz, -mx, -my, -mz, _0, far, DIFFUSE)
            rays += 1
            if triangle < 0:
                break
            x, y, z, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
            along = gx * mx + gy * my + gz * mz
            # Triangles beside the photon's may turn the other way.  What lies below the first of them is a back, or seen from where the light comes.
            alike = abs(along) >= _ALIKE and (tested or layer == 0 or photons.side[p] * along > _0)
            if alike and not _is_hole(
                scene, triangle, u, v, photons.direction[p, 0], photons.direction[p, 1], photons.direction[p, 2], rows, surface
            ):
                if tested:
                    if along < _0:
                        gx, gy, gz = -gx, -gy, -gz
                    sx, sy, sz, dx, dy, dz = shadow_segment(
                        x, y, z, gx, gy, gz, error, photons.entry[p, 0], photons.entry[p, 1], photons.entry[p, 2], _0, _0, _0, _0
                    )  # fmt: skip
                    rays += 1
                    met += _is_ahead(photons, p, x, y, z) and not occluded1(
                        scene.rays, OPAQUE, packet, sx, sy, sz, dx, dy, dz, _0, _1, DIFFUSE
                    )
                else:
                    met += 1
            ox, oy, oz = offset_origin(x, y, z, gx, gy, gz, error, -mx, -my, -mz)
            far -= t
            if not far > _0:
                break
    return met, rays


@kernel
def _count_met(scene, photons, radius, begin, end, seed, met):
    """How many of `RAYS_A_DISK` rays through the disks of the photons begin..end-1 meet what they light, into `met` (P,); the rays traced."""
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    rays = 0
    for p in range(begin, end):
        met[p], traced = _met(scene, packet, rows, surface, photons, p, radius[p], True, seed, EVERY_ONE)
        rays += traced
    return rays


def _part_met(scene: Transport, photons: Photons, nearest: float, seed: int, threads: int) -> tuple[float, int]:
    """The part of what photons by lobes light among so many neighbours that is there and sees where they come from; the rays traced."""
    k = min(max(1, round(nearest)), len(photons.group) - 1)
    if k < 1:
        return 0.0, 0
    some = photons.take(slice(None, None, -(-len(photons.group) // LOOKED_AT)))
    radius = cKDTree(photons.position).query(some.position, [k + 1], workers=threads or -1)[0][:, 0]
    radius, met = np.maximum(radius, 1e-9).astype(np.float32), np.empty(len(radius), np.int64)
    rays = sum(
        run_chunks(lambda begin, end: _count_met(scene, some, radius, begin, end, np.uint32(seed), met), len(met), CHUNK // 16, threads)
    )
    return float(met.mean()) / RAYS_A_DISK, rays


@kernel
def _keep(scene, photons, radius, tested, begin, end, seed):
    """Makes up for what of the disks of the photons begin..end-1 lies beyond edges and in corners, by a few rays through each; the rays traced."""
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    rays = 0
    for p in range(begin, end):
        r = radius[p]
        met = 0
        for attempt in range(_SMALLER):
            met, traced = _met(scene, packet, rows, surface, photons, p, r, tested, seed, RAYS_A_DISK // 2)
            rays += traced
            if met >= RAYS_A_DISK // 2 or attempt + 1 == _SMALLER:
                break
            r *= _HALF  # most of it would be lost: on something small, or beside an edge
        radius[p] = r
        # By rays of their own: a disk that was kept because many rays met it by chance has less of it met than these rays tell.
        met, traced = _met(scene, packet, rows, surface, photons, p, r, tested, hash_combine(seed, np.uint32(1)), EVERY_ONE)
        rays += traced
        # The mean of this is about one over the part that is met (a binomial's).
        more = min(_MOST_KEPT, np.float32(RAYS_A_DISK + 1) / np.float32(met + 1))
        for c in range(3):
            photons.flux[p, c] *= more
    return rays


def keep_light(scene: Transport, caustics: Caustics, seed: int, threads: int = 0) -> int:
    """Give what is left of each disk at edges and in corners all of its photon's light; the rays traced."""
    n = len(caustics.radius)
    return sum(
        run_chunks(
            lambda begin, end: _keep(scene, caustics.photons, caustics.radius, caustics.tested, begin, end, np.uint32(seed)),
            n,
            CHUNK,
            threads,
        )
    )


@kernel
def _light(scene, caustics, points, lit, begin, end, seed, tested, every, near, size, out, shown):
    """Adds the irradiance by photons, each evenly bright but for Epanechnikov's kernel of its radius, to the rows lit[begin..end-1] of `out`.

    tested: whether it is seen from there where they come from, as one of them by chance tells.  every: by so-manyth of those around alone.
    shown: (N, 3 G) W/m^2/sr, what wide lobes reflect of it is added there (of the world's light nothing), but for what lobes throw from nearer than `near` (m)
    or than their blur of a cell of the cache, of a `size` (m): their own rays find that.  No rows for none.
    """
    slots = len(caustics.start) - 1
    photons = caustics.photons
    packet = new_packet()
    found, seen = np.zeros((WIDTH, out.shape[1]), np.float32), np.zeros((WIDTH, out.shape[1]), np.float32)
    lobe = np.zeros(LOBE, np.float32)
    wide, least = False, _0
    owner = np.empty(WIDTH, np.int64)
    n = np.int64(0)
    rays = 0
    for row in range(begin, end):
        i = lit[row]
        x, y, z = points.position[i, 0], points.position[i, 1], points.position[i, 2]
        nx, ny, nz = points.ng[i, 0], points.ng[i, 1], points.ng[i, 2]
        total, left, picked = 0.0, np.float64(uniform(seed, i, 0, 0)), -1
        if len(shown) > 0:
            set_point_lobe(points, i, lobe)
            wide = is_wide(lobe)
            least = max(near, size / lobe[ALPHA]) if wide else _0
        for level in range(len(caustics.edge)):
            box = caustics.box[level]
            if x < box[0, 0] or y < box[0, 1] or z < box[0, 2] or x > box[1, 0] or y > box[1, 1] or z > box[1, 2]:
                continue
            inverse = _1 / caustics.edge[level]
            bx, by, bz = (
                np.int64(math.floor((x - caustics.origin[0]) * inverse - _HALF)),
                np.int64(math.floor((y - caustics.origin[1]) * inverse - _HALF)),
                np.int64(math.floor((z - caustics.origin[2]) * inverse - _HALF)),
            )
            for corner in range(8):
                cell = _cell(level, bx + (corner & 1), by + (corner >> 1 & 1), bz + (corner >> 2))
                slot = _slot(cell, slots)
                begin_at = caustics.start[slot]
                if every > 1 and caustics.start[slot + 1] > begin_at:
                    begin_at += hash_combine(hash_combine(seed, i), np.uint32(cell)) % every
                for p in range(begin_at, caustics.start[slot + 1], every):
                    if caustics.cell[p] != cell:
                        continue
                    ax, ay, az = photons.position[p, 0] - x, photons.position[p, 1] - y, photons.position[p, 2] - z
                    inverse2 = _1 / (caustics.radius[p] * caustics.radius[p])
                    falls = _1 - (ax * ax + ay * ay + az * az) * inverse2
                    if not falls > _0:
                        continue
                    mx, my, mz = photons.normal[p, 0], photons.normal[p, 1], photons.normal[p, 2]
                    if nx * mx + ny * my + nz * mz < _ALIKE or abs(nx * ax + ny * ay + nz * az) > _THICK * caustics.radius[p]:
                        continue
                    dx, dy, dz = photons.direction[p, 0], photons.direction[p, 1], photons.direction[p, 2]
                    cos_g = -(mx * dx + my * dy + mz * dz)
                    cos_s = -(points.ns[i, 0] * dx + points.ns[i, 1] * dy + points.ns[i, 2] * dz)
                    if not (cos_g > _0 and cos_s > _0):
                        continue
                    w = np.float32(every) * _2 * _INV_PI * inverse2 * falls * min(_2, cos_s / cos_g)
                    r, g, b = w * photons.flux[p, 0], w * photons.flux[p, 1], w * photons.flux[p, 2]
                    c = 3 * photons.group[p]
                    found[n, c] += r
                    found[n, c + 1] += g
                    found[n, c + 2] += b
                    if wide and photons.lobes[p] > 0:
                        ex, ey, ez = photons.entry[p, 0] - x, photons.entry[p, 1] - y, photons.entry[p, 2] - z
                        if not tested or ex * ex + ey * ey + ez * ez > least * least:
                            lr, lg, lb, _ = lobe_value(lobe, -dx, -dy, -dz)
                            part = by_photons(lobe, cos_s, lr, lg, lb) / cos_s if photons.followed[p] else _1 / cos_s
                            seen[n, c] += part * lr * r
                            seen[n, c + 1] += part * lg * g
                            seen[n, c + 2] += part * lb * b
                    # One of them by its light, with one random number for all.
                    light = np.float64(r + g + b)
                    total += light
                    if left * total < light:
                        left *= total / light
                        picked = p
                    else:
                        left = (left * total - light) / (total - light)
        if picked < 0:
            continue
        if tested and not _is_ahead(photons, picked, x, y, z):
            for c in range(out.shape[1]):
                found[n, c] = seen[n, c] = _0
            continue
        owner[n] = i
        if tested:
            ox, oy, oz, dx, dy, dz = shadow_segment(
                x, y, z, nx, ny, nz, points.error[i], photons.entry[picked, 0], photons.entry[picked, 1], photons.entry[picked, 2], _0, _0, _0, _0
            )  # fmt: skip
            set_ray(packet, n, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE)
            rays += 1
        n += 1
        if n == WIDTH:
            _arrive(scene, packet, owner, n, tested, found, seen, out, shown)
            n = np.int64(0)
    if n > 0:
        _arrive(scene, packet, owner, n, tested, found, seen, out, shown)
    return rays


@leaf
def _arrive(scene, packet, owner, lanes, tested, found, seen, out, shown):
    """Adds what the `lanes` points of a packet have found, and their lobes reflect (16, 3 G), to their rows of `out` and `shown`, where their rays
    arrive; forgets it."""
    if tested:
        occluded_packet(scene.rays, OPAQUE, packet, lanes)
    for lane in range(lanes):
        arrives = not (tested and is_occluded(packet, lane))
        for c in range(out.shape[1]):
            if arrives:
                out[owner[lane], c] += found[lane, c]
                if len(shown) > 0:
                    shown[owner[lane], c] += seen[lane, c]
            found[lane, c] = seen[lane, c] = _0


def add_caustics(
    scene: Transport, caustics: Caustics, points, seed: int, threads: int, out: np.ndarray, shown: np.ndarray | None = None,
    near: float = 0.0, size: float = 0.0,
) -> int:  # fmt: skip
    """Add the irradiance by photons to `out`, (N, 3 G) W/m^2, at N points (with the arrays position, error, ns and ng); the rays traced.

    shown: (N, 3 G) W/m^2/sr, what wide lobes reflect of it is added, None where that is not wanted.  near, size: as of `_light`.
    """
    shown = out[:0] if shown is None else shown
    low, high = caustics.box[:, 0].min(axis=0), caustics.box[:, 1].max(axis=0)
    lit = np.flatnonzero(((points.position >= low) & (points.position <= high)).all(axis=1))
    disks, receivers = Reference(caustics), Reference(points)

    def work(begin, end):
        return _light(
            scene, disks, receivers, lit, begin, end, np.uint32(seed), caustics.tested, caustics.every, np.float32(near), np.float32(size),
            out, shown,
        )  # fmt: skip

    return sum(run_chunks(work, len(lit), CHUNK, threads))
