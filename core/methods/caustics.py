"""Caustics: the lamps' light that glass bends on its way to what is lit.

A shadow ray goes straight and cannot find it (`surfaces.visibility` tells where a lens is in the way).  Photons do (Jensen 1996,
"Global Illumination using Photon Maps"): they leave the lamps, are bent by clear glass and scattered by frosted glass, and stay where they
leave the last lens and land.  Each shines on what lies among its nearest neighbours.  Lamps of no size have none, as in
Cycles, whose paths cannot meet them by chance.
"""

from __future__ import annotations

import math
from itertools import chain
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..jit import kernel
from ..lamps.emission import emit, focused
from ..lamps.links import lights
from ..lamps.tables import CASTS_SHADOW, ONE_MINUS_COS, RADIUS
from ..rays.offsets import hit_point, offset_origin
from ..rays.packet import new_packet
from ..rays.trace import ALL, intersect1
from ..references import Reference
from ..sampling.hashing import uniform
from ..sampling.sequences import sobol
from ..scene import ANGLED, DIFFUSE, POINT, REFRACTIVE, SPOT, SUN, TRANSPARENT
from ..surfaces.bending import STRAIGHT_ON, bent, scattered
from ..surfaces.layout import BEND, FROST, REFRACTION, SURFACE, TRANSPARENCY, passing_chance
from ..surfaces.lobes import LOBE
from ..surfaces.microfacet import SMALLEST_ALPHA
from ..surfaces.normals import shading_normal
from ..surfaces.program import new_registers
from ..surfaces.visibility import OUTSIDE, evaluate_along, is_lens, passed_glass
from ..threads import run_chunks
from ..transport import Transport

CHUNK = 4096  # particles a chunk
GLANCE, PILOT = 1 << 14, 1 << 16  # particles that tell whether any meet a lens, and where
TELLING = 64  # photons that tell where
PHOTONS_A_POINT = 0.125  # wanted
FEWEST, MOST = 1 << 14, 1 << 15  # of them in any case
VPLS = 4096  # of fewer, as in quick pictures, photons are fewer by the same share
MOST_FLOWN = 1 << 20
NEAREST = 48  # photons among which the light of one is spread
SPARSE = 4.0  # times the median of the distances at which they lie: none is spread farther
_SURFACES = 32  # that a photon meets at most
_ALIKE = np.float32(0.7)  # cosine of the normals of a point and of a photon that lights it, at least
_THICK = np.float32(0.25)  # of that distance: photons so far out of a point's plane are of another surface
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)
_INV_PI = np.float32(1 / math.pi)


class Photons(NamedTuple):
    """P photons: where lamps' light has landed that lenses bent.

    position: (P, 3) float32 (m).  normal: (P, 3) float32, geometric, on the lit side.  direction: (P, 3) float32, unit, in which they flew.
    entry: (P, 3) float32, where they first met glass (m).  flux: (P, 3) float32, W.  group: (P,) int32, their lamps' light groups.
    """

    position: np.ndarray
    normal: np.ndarray
    direction: np.ndarray
    entry: np.ndarray
    flux: np.ndarray
    group: np.ndarray

    @staticmethod
    def allocate(n: int) -> Photons:
        """Room for n photons, not set."""
        return Photons(*(np.empty((n, 3), np.float32) for _ in range(5)), np.empty(n, np.int32))


def bends_light(scene: Transport) -> bool:
    """Whether there is glass at all, and light to bend."""
    return bool((scene.materials.flags & REFRACTIVE).any()) and bool(scene.emitters.flux.any())


@kernel
def _fly(scene, begin, end, seed, photons):
    """Fly the particles begin..end-1 through glass -> (how many photons they leave, rays traced)."""
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    lobe = np.zeros(LOBE, np.float32)
    emitters = scene.emitters
    n = rays = 0
    for i in range(begin, end):
        e, ox, oy, oz, dx, dy, dz, r, g, b, near, far, before = emit(
            emitters, rows, surface, sobol(i, 0, seed), sobol(i, 1, seed), sobol(i, 2, seed), sobol(i, 3, seed), sobol(i, 4, seed)
        )
        if e < 0 or not max(r, g, b) > _0 or not emitters.flags[e] & CASTS_SHADOW:
            continue
        kind = emitters.kind[e]
        if ((kind == POINT or kind == SPOT) and not emitters.lamps[e, RADIUS] > _0) or (
            kind == SUN and not emitters.lamps[e, ONE_MINUS_COS] > _0
        ):
            continue
        kinds = DIFFUSE | emitters.shadow_kinds[e]
        ax, ay, az = dx, dy, dz  # the straight way
        x = y = z = qx = qy = qz = flown = _0
        glasses = 0
        entered = OUTSIDE
        for layer in range(_SURFACES):
            rays += 1
            triangle, t, u, v = intersect1(scene.rays, ALL, packet, ox, oy, oz, dx, dy, dz, _0, np.float32(np.inf), kinds)
            flown += t
            if triangle < 0 or (glasses == 0 and flown > far):
                break
            px, py, pz, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
            behind = gx * dx + gy * dy + gz * dz > _0
            flags = scene.materials.flags[scene.material[triangle]]
            seen = scene.object_visibility[scene.object[triangle]]
            passes = flags & TRANSPARENT != 0
            if passes:
                evaluate_along(scene, triangle, u, v, dx, dy, dz, entered, rows, surface)
                chance = passing_chance(surface, flags & ANGLED != 0)
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
            if not passes:
                if glasses == 0 or not is_lens(glasses, x, y, z, ax, ay, az) or flown < before + near:
                    break
                # What glass keeps it mirrors, and what is within a solid is lit by straight rays.
                if not seen & DIFFUSE or flags & REFRACTIVE or not lights(emitters, e, scene.object, triangle):
                    break
                side = -_1 if behind else _1
                photons.position[n, 0], photons.position[n, 1], photons.position[n, 2] = px, py, pz
                photons.normal[n, 0], photons.normal[n, 1], photons.normal[n, 2] = side * gx, side * gy, side * gz
                photons.direction[n, 0], photons.direction[n, 1], photons.direction[n, 2] = dx, dy, dz
                photons.entry[n, 0], photons.entry[n, 1], photons.entry[n, 2] = qx, qy, qz
                photons.flux[n, 0], photons.flux[n, 1], photons.flux[n, 2] = r, g, b
                photons.group[n] = emitters.light_group[e]
                n += 1
                break
            # What hides from diffuse rays sends none of them to the lamp.
            if seen & DIFFUSE and surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2] > _0:
                nx, ny, nz = shading_normal(scene.corner_normals, triangle, u, v, _0, _0, _0)
                x, y, z = x + nx, y + ny, z + nz
                if glasses == 0:
                    qx, qy, qz = px, py, pz
                glasses += 1
                material = scene.material[triangle]
                turns = False
                if abs(surface[BEND] - _1) > STRAIGHT_ON:
                    turns, ox, oy, oz, dx, dy, dz = bent(scene.materials, scene, material, triangle, u, v, dx, dy, dz, surface)
                if not turns:
                    entered = passed_glass(entered, behind)
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


def _traced(scene: Transport, particles: int, seed: int, threads: int) -> tuple[Photons, int]:
    """Photons of so many particles, whose flux is still times the number of particles, and the rays traced."""

    def work(begin, end):
        room = Photons.allocate(end - begin)
        n, rays = _fly(scene, begin, end, np.uint32(seed), room)
        return Photons(*(column[:n] for column in room)), rays

    parts = run_chunks(work, particles, CHUNK, threads)
    return Photons(*(np.concatenate(columns) for columns in zip(*(part for part, _ in parts)))), sum(rays for _, rays in parts)


def trace_photons(scene: Transport, points: int, vpls: int, seed: int, threads: int = 0) -> tuple[Photons, int]:
    """Photons for the light at so many points and so many VPLs, none where no lens throws light on anything; and the rays traced.

    Their density, flux a unit of area, is the irradiance (W/m^2) that shadow rays miss.
    """
    photons, rays = _traced(scene, GLANCE, seed, threads)
    if not len(photons.group):
        return photons, rays
    photons, more = _traced(scene, PILOT, seed, threads)
    rays += more
    if len(photons.group) >= TELLING:
        scene = scene._replace(emitters=focused(scene.emitters, photons.entry))
        photons, more = _traced(scene, PILOT, seed + 1, threads)
        rays += more
    wanted = min(max(FEWEST, PHOTONS_A_POINT * points), MOST) * min(1.0, vpls / VPLS)
    flown = min(int(PILOT * wanted / max(1, len(photons.group))), MOST_FLOWN)
    if flown > PILOT:  # the first of them are the same
        photons, more = _traced(scene, flown, seed + 1, threads)
        rays += more
    photons.flux[:] *= np.float32(1 / max(flown, PILOT))
    return photons, rays


@kernel
def _spread(photons, radius, first, points, lit, out):
    """Adds the irradiance by each photon p, evenly bright but for Epanechnikov's kernel of its `radius` (P,), to the rows lit[first[p]:first[p + 1]] of `out`."""
    for p in range(len(radius)):
        inverse = _1 / (radius[p] * radius[p])
        dx, dy, dz = photons.direction[p, 0], photons.direction[p, 1], photons.direction[p, 2]
        cos_g = -(photons.normal[p, 0] * dx + photons.normal[p, 1] * dy + photons.normal[p, 2] * dz)
        if not cos_g > _0:
            continue
        c = 3 * photons.group[p]
        for k in range(first[p], first[p + 1]):
            i = lit[k]
            nx, ny, nz = points.ng[i, 0], points.ng[i, 1], points.ng[i, 2]
            if nx * photons.normal[p, 0] + ny * photons.normal[p, 1] + nz * photons.normal[p, 2] < _ALIKE:
                continue
            x, y, z = (
                photons.position[p, 0] - points.position[i, 0],
                photons.position[p, 1] - points.position[i, 1],
                photons.position[p, 2] - points.position[i, 2],
            )
            if abs(nx * x + ny * y + nz * z) > _THICK * radius[p]:
                continue
            cos_s = -(points.ns[i, 0] * dx + points.ns[i, 1] * dy + points.ns[i, 2] * dz)
            w = _2 * _INV_PI * inverse * max(_0, _1 - (x * x + y * y + z * z) * inverse) * min(_2, max(_0, cos_s / cos_g))
            out[i, c] += w * photons.flux[p, 0]
            out[i, c + 1] += w * photons.flux[p, 1]
            out[i, c + 2] += w * photons.flux[p, 2]


def add_caustics(photons: Photons, points, threads: int, out: np.ndarray) -> None:
    """Add the irradiance by photons to `out`, (N, 3 G) W/m^2, at N points (with the arrays position, ns and ng).

    Each photon lights a disk that reaches to its `NEAREST` neighbours, so that all of its light arrives; by the nearest photons of each
    point instead, dark surroundings would shine.
    """
    if len(photons.group) <= NEAREST or not len(points.position):
        return
    radius = cKDTree(photons.position).query(photons.position, [NEAREST + 1], workers=threads)[0][:, 0]
    radius = np.clip(radius, 1e-9, SPARSE * np.median(radius)).astype(np.float32)
    low, high = (photons.position - radius[:, None]).min(axis=0), (photons.position + radius[:, None]).max(axis=0)
    near = np.flatnonzero(((points.position >= low) & (points.position <= high)).all(axis=1))
    if not len(near):
        return
    tree = cKDTree(points.position[near])
    for begin in range(0, len(radius), CHUNK):  # what each batch finds is in memory at once
        part = slice(begin, begin + CHUNK)
        found = tree.query_ball_point(photons.position[part], radius[part], workers=threads)
        first = np.cumsum([0, *map(len, found)])
        lit = near[np.fromiter(chain.from_iterable(found), np.int64, first[-1])]
        _spread(Reference(Photons(*(column[part] for column in photons))), radius[part], first, Reference(points), lit, out)
