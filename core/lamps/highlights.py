"""Highlights of small lamps on things whose normals turn far within a pixel: handles, cutlery, balls.

One normal a pixel would meet such a highlight by chance, many times too bright.  A pixel's normals are taken to
fill a rectangle of slopes with the same mean and covariance (`ShadingPoints.turned`), over which the lobe is averaged (after Kaplanyan, Hill, Patney & Lefohn 2016, Filtering Distributions of Normals for Shading Antialiasing).  That is the lobe stretched
by the rectangle: its long tails stay as they are, which a rougher GGX lobe (Tokuyoshi & Kaplanyan 2019) would lift on all sides.
Lamps that no facet within the rectangle shows are those tails alone, or lie behind the mean normal: they are found from the normals of a few places, which vary little there.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import kernel, leaf
from ..rays.packet import new_packet
from ..references import Reference
from ..sampling.hashing import hash_combine
from ..sampling.sequences import sobol
from ..surfaces.layout import SURFACE
from ..surfaces.lobes import ALPHA, LOBE, flattened_lobe, in_flattened, set_lobe
from ..surfaces.program import new_registers
from ..threads import run_chunks
from .departures import on_one_facet, position_at, surface_at
from .direct import passed, shadow_ray
from .links import lights
from .sample import sample_emitter
from .tables import CASTS_SHADOW, SEEN_BY_GLOSSY, SHARP

_CHUNK = 2048  # points
_SEED = np.uint32(0x51A9)
# Lobes so many times as wide as the pixel's normals are found from the normals of a few places: stretched, they would lose what
# normals have in common with a low lamp.
WIDE = np.float32(1.0)
# Half width of the slopes from which on a pixel shows most of a thing, and they are no rectangle about a mean: there so wide a lobe is enough.
LARGE, WIDE_ENOUGH = np.float32(0.45), np.float32(0.5)
_0 = np.float32(0.0)


@leaf
def _set_lobe(points, i, nx, ny, nz, gx, gy, gz, lobe):
    """The lobe of point i about the shading normal n on a facet with the normal g."""
    set_lobe(
        lobe, nx, ny, nz, gx, gy, gz, points.wo[i, 0], points.wo[i, 1], points.wo[i, 2], points.roughness[i],
        points.f0[i, 0], points.f0[i, 1], points.f0[i, 2], points.f90[i, 0], points.f90[i, 1], points.f90[i, 2],
        points.gloss[i, 0], points.gloss[i, 1], points.gloss[i, 2], points.gloss[i, 3],
    )  # fmt: skip


@kernel
def _highlights_chunk(scene, points, which, lamps, begin, end, seed, out):
    """Adds what the points which[begin:end] reflect of the `lamps` to their rows of `out` (N, 6 G), the later half by way of glass -> rays."""
    emitters = scene.emitters
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    lobe, own, still = np.zeros(LOBE, np.float32), np.zeros(LOBE, np.float32), np.zeros(3, np.float32)
    glass = out.shape[1] // 2
    places = points.spread.shape[1] + 1
    part = np.float32(1.0 / places)
    cast = 0
    for number in range(begin, end):
        i = which[number]
        entered = np.int64(points.entered[i])
        key = hash_combine(hash_combine(seed, _SEED), i)
        turned = points.turned[i]
        mx, my, mz = points.ns[i, 0] + turned[0, 0], points.ns[i, 1] + turned[0, 1], points.ns[i, 2] + turned[0, 2]
        _set_lobe(points, i, mx, my, mz, points.ng[i, 0], points.ng[i, 1], points.ng[i, 2], lobe)
        if not lobe[ALPHA] > _0:
            continue
        half = np.float32(math.sqrt(turned[1, 0] * turned[1, 0] + turned[1, 1] * turned[1, 1] + turned[1, 2] * turned[1, 2]))
        wide = lobe[ALPHA] >= (WIDE_ENOUGH if half > LARGE else WIDE) * half
        for place in range(places):
            ox, oy, oz, fx, fy, fz, _ = surface_at(points, i, place)
            _set_lobe(points, i, ox, oy, oz, fx, fy, fz, own)
            at = place if on_one_facet(points, i, place) else np.int64(0)
            for lamp in range(len(lamps)):
                e = lamps[lamp]
                if not lights(emitters, e, scene.object, points.triangle[i]):
                    continue
                u1, u2 = sobol(place, 0, hash_combine(key, lamp)), sobol(place, 1, hash_combine(key, lamp))
                stretched = False
                if not wide:
                    px, py, pz = position_at(points, i, at)
                    dx, dy, dz, t, r, g, b, u, v = sample_emitter(emitters, e, px, py, pz, mx, my, mz, u1, u2, rows, surface)
                    stretched = in_flattened(lobe, turned[1], turned[2], dx, dy, dz)
                    nx, ny, nz, gx, gy, gz = mx, my, mz, points.ng[i, 0], points.ng[i, 1], points.ng[i, 2]
                if not stretched:
                    if not own[ALPHA] > _0:
                        continue
                    px, py, pz = position_at(points, i, place)
                    nx, ny, nz, gx, gy, gz = ox, oy, oz, fx, fy, fz
                    dx, dy, dz, t, r, g, b, u, v = sample_emitter(emitters, e, px, py, pz, nx, ny, nz, u1, u2, rows, surface)
                if nx * dx + ny * dy + nz * dz <= _0 or gx * dx + gy * dy + gz * dz <= _0 or not max(r, g, b) > _0:
                    continue
                if stretched:
                    fr, fg, fb = flattened_lobe(lobe, turned[1], turned[2], dx, dy, dz)
                else:
                    fr, fg, fb = flattened_lobe(own, still, still, dx, dy, dz)
                if not max(fr * r, fg * g, fb * b) > _0:
                    continue
                tr = tg = tb = clear = np.float32(1.0)
                if emitters.flags[e] & CASTS_SHADOW:
                    sx, sy, sz, dx, dy, dz, end_t = shadow_ray(scene, e, u, v, px, py, pz, gx, gy, gz, points.error[i], dx, dy, dz, t)
                    tr, tg, tb, clear = passed(
                        scene, packet, rows, surface, e, sx, sy, sz, dx, dy, dz, end_t, entered, max(_0, nx * dx + ny * dy + nz * dz)
                    )
                    cast += 1
                r, g, b = part * fr * r * tr, part * fg * g * tg, part * fb * b * tb
                c = 3 * emitters.light_group[e]
                out[i, c] += clear * r
                out[i, c + 1] += clear * g
                out[i, c + 2] += clear * b
                out[i, c + glass] += (np.float32(1.0) - clear) * r
                out[i, c + glass + 1] += (np.float32(1.0) - clear) * g
                out[i, c + glass + 2] += (np.float32(1.0) - clear) * b
    return cast


def highlights(scene, points, seed: int, threads: int = 0):
    """What lobes of points with `turned` normals reflect of `SHARP` lamps, which no other stage finds there.

    scene: Transport.  points: `view.points.ShadingPoints`.

    Returns:
        (radiance (N, 3 G) float32 W/m^2/sr, the same of light that passed glass, number of rays), None where there is none.
    """
    emitters = scene.emitters
    lamps = np.flatnonzero((emitters.flags & (SHARP | SEEN_BY_GLOSSY)) == (SHARP | SEEN_BY_GLOSSY))
    which = np.flatnonzero(points.turned.any(axis=(1, 2))) if len(lamps) else lamps
    if not len(which):
        return None
    out = np.zeros((len(points.position), 6 * emitters.light_groups), np.float32)
    receivers = Reference(points)

    def work(begin, end):
        return _highlights_chunk(scene, receivers, which, lamps, begin, end, np.uint32(seed), out)

    rays = sum(run_chunks(work, len(which), _CHUNK, threads))
    columns = out.shape[1] // 2
    return np.ascontiguousarray(out[:, :columns]), np.ascontiguousarray(out[:, columns:]), rays
