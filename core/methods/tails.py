"""Paths from the camera's side: what light leaves the surface that a gather ray meets.

VPLs cannot serve surfaces that are close to each other (their geometry term is clamped); there, and for
glossy reflections, a short path tracer continues from the hit: direct light at every surface, a ray drawn from its
diffuse or its glossy lobe to the next one, or through it where it is translucent.  Never blind to contact.

To Cycles diffuse transmission is no diffuse bounce, so that as many of those may follow as after a glossy reflection.

A lobe shows the lamps' light blurred where it is narrow, and bounded: a path that finds a small lamp in it by chance would be all noise.  Of an even sky,
that would be a half of what a polished wall throws on the floor at its foot: there the ray that is drawn from the lobe finds the world, the more the less it is
concentrated.  Spread over the hemisphere, as cells have it, it would be far too bright to what lies along the surface, as a polished box to its floor.  Where virtual
lights stand for that light, which know its direction, it is left to them.
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel, leaf
from ..lamps.direct import direct_sample_at
from ..lamps.lookup import share_of
from ..lamps.tables import GLOSSY_ONLY, SEEN_BY_GLOSSY, WORLD
from ..lamps.world import world_density, world_radiance
from ..particles import MAX_ADJOINT, carried_by_lights
from ..rays.offsets import hit_point, offset_origin
from ..rays.packet import new_packet
from ..references import Reference
from ..sampling.hashing import uniform
from ..sampling.maps import cosine_hemisphere, to_world
from ..scene import DIFFUSE, GLOSSY, METAL, TRANSMISSION
from ..surfaces import ggx, layout
from ..surfaces.bumps import shadowing
from ..surfaces.layout import (
    GLOSS,
    GLOSSY_F0,
    GLOSSY_F90,
    ROUGHNESS,
    SHEEN,
    SHEEN_ROUGHNESS,
    SURFACE,
    TILT,
    diffuse_albedo,
    glossy_rise,
    translucency,
)
from ..surfaces.lobes import ALBEDO, ALPHA, LOBE, goes_past, lobe_cosine, lobe_value, sample_above, set_lobe
from ..surfaces.normals import mapped_normal, shading_normal, surface_side
from ..surfaces.program import new_registers
from ..surfaces.sheen import lit_from, shape
from ..surfaces.visibility import OUTSIDE, encloses, nearest_surface
from ..threads import run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints, is_transmitting
from .light_cache import LightCache, add_known, find_cell, no_cache, take_known

CHUNK = 1024  # points a chunk
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_THIRD = np.float32(1 / 3)
_PI = np.float32(np.pi)
BLUR = np.float32(0.35)  # least roughness of a lobe that shows the lamps
# Times what a diffuse lobe of its albedo sends, at most: of a blurred lobe that is the peak when looked at straight.  Along the surface it goes to the
# hundreds, and one path in a million with it: 7 % of the light of a living room in one pixel.  Of a lamp low over a rough floor a quarter is lost.
PEAK = np.float32(16.0)
_LEAST = np.float32(1e-20)  # density
_MORE_SURFACES = 8  # that a path may meet beyond its diffuse bounces, by glossy reflections

# Dimensions of the hash for one vertex of a path.
DIMENSIONS = 100


@leaf
def scatter_light(
    scene, packet, rows, surface, lobe, on, x, y, z, error, gx, gy, gz, sx, sy, sz, wx, wy, wz, entered, lamp_rays, diffuse, towards, seed, path, at,
    out, shine, beneath, glass, apart, i, kr, kg, kb, sheen, aside, relied, reach,
):  # fmt: skip
    """What a surface sends towards w at first hand, and a ray that finds the rest.

    on: its triangle.  (x, y, z), error, g, s: the point, its rounding error, its normals on the side of w.  surface: its material, evaluated;
    overwritten.  lobe: (LOBE,) float32, scratch.  entered: solids of glass that the surface lies in, to its view.  lamp_rays: shadow rays for the direct light.  diffuse: whether the diffuse lobe may be drawn, and light by way of glass counts.
    towards: whether a glossy lobe sends the lamps' light where it does, not as a diffuse one, and, above 1, whether sheen does, of a surface evaluated for w.
    at: first dimension.
    out, shine, beneath: (N, 3 G) float32: pi times the radiance by direct light (W/m^2), weighed by k, is added to row i: of the diffuse lobe, and of what
    comes through, to that of `out`, of the glossy one, times `sheen`, to that of `shine`.
    What comes from below the facet, where no particle lands, or nearly along it, where their weight is bounded, goes to `beneath`, times `aside`.
    glass: (N, 3 G) float32, where `apart`: the part of all that which came by way of glass.
    relied: how far lights carry what the lobe reflects of the lamps, reach: as of `carried_by_lights`.

    Returns (dx, dy, dz, wr, wg, wb, kinds, beyond): the ray's direction, its weight and its kind, 0 where there is none, and the share of the world's
    light along it that is left to it (multiple importance sampling; the blurred lobe's density stands for that of the ray, which may be narrower).
    """
    emitters = scene.emitters
    shining = len(emitters.source)
    world = towards > 0 and shining < len(emitters.kind) and emitters.kind[shining] == WORLD and emitters.flags[shining] & SEEN_BY_GLOSSY
    cosine = lobe_cosine(sx, sy, sz, gx, gy, gz, wx, wy, wz)
    dr, dg, db = diffuse_albedo(surface, cosine)
    tr, tg, tb = translucency(surface, cosine)
    roughness, tilt = surface[ROUGHNESS], surface[TILT]
    sheened, top = surface[SHEEN_ROUGHNESS], surface[GLOSS]
    er, eg, eb = surface[GLOSS + 1], surface[GLOSS + 2], surface[GLOSS + 3]
    hr, hg, hb = surface[SHEEN], surface[SHEEN + 1], surface[SHEEN + 2]
    f0r, f0g, f0b = surface[GLOSSY_F0], surface[GLOSSY_F0 + 1], surface[GLOSSY_F0 + 2]
    f90r, f90g, f90b = surface[GLOSSY_F90], surface[GLOSSY_F90 + 1], surface[GLOSSY_F90 + 2]
    share = _1 / np.float32(max(1, lamp_rays))
    shiny = max(f0r, f0g, f0b, f90r, f90g, f90b) > _0
    # As many again on the other side, where light comes through; called in one place, which is as fast as without.
    side = _1
    set_lobe(lobe, sx, sy, sz, gx, gy, gz, wx, wy, wz, roughness, f0r, f0g, f0b, f90r, f90g, f90b, top, er, eg, eb)
    turned = towards > 0 and lobe[ALPHA] > _0
    kept = lobe[ALBEDO]
    if turned and roughness < BLUR:
        set_lobe(lobe, sx, sy, sz, gx, gy, gz, wx, wy, wz, BLUR, f0r, f0g, f0b, f90r, f90g, f90b, top, er, eg, eb)
    kept *= _PI / max(lobe[ALBEDO], np.float32(1e-6))  # a blurred lobe sends as much
    for k in range(2 * lamp_rays if tr + tg + tb > _0 else lamp_rays):
        if k == lamp_rays:
            side = -_1
        r, g, b, cosine, e, across, clear, dx, dy, dz = direct_sample_at(
            scene, packet, rows, surface, on, shiny, x, y, z, error, side * gx, side * gy, side * gz, side * sx, side * sy, side * sz, entered, seed, path, at + 20 + k
        )  # fmt: skip
        if e < 0:
            continue
        if across <= _0 and tilt > _0:
            continue
        c = 3 * scene.emitters.light_group[e]
        # Glass is a surface to Cycles, where the last bounce ends: what comes through it has one less.
        counted = share if diffuse else share * clear
        r, g, b = kr * counted * r, kg * counted * g, kb * counted * b
        lit = shadowing(tilt, across)
        if scene.emitters.flags[e] & GLOSSY_ONLY:
            lit = _0
        if side < _0:
            r, g, b = lit * r * tr, lit * g * tg, lit * b * tb
        else:
            rise = glossy_rise(cosine, roughness)
            seen = _1 if scene.emitters.flags[e] & SEEN_BY_GLOSSY else _0
            fr, fg, fb = seen * r, seen * g, seen * b
            lr, lg, lb = f0r + rise * (f90r - f0r), f0g + rise * (f90g - f0g), f0b + rise * (f90b - f0b)
            if er + eg + eb > _0:
                dip = ggx.edge_dip(cosine, roughness)
                lr = max(lr - er * dip * ggx.edge(f0r, f90r - f0r), _0)
                lg = max(lg - eg * dip * ggx.edge(f0g, f90g - f0g), _0)
                lb = max(lb - eb * dip * ggx.edge(f0b, f90b - f0b), _0)
            if turned:
                lr, lg, lb, density = lobe_value(lobe, dx, dy, dz)
                each = kept / max(cosine, np.float32(1e-4))
                if e == shining and world:  # the share bounds it, too
                    each *= share_of(max(world_density(emitters.world, x, y, z, sx, sy, sz, dx, dy, dz), _LEAST), density)
                else:
                    each = min(each, kept * PEAK * lobe[ALBEDO] / (_PI * max(lr, lg, lb, np.float32(1e-20))))
                lr, lg, lb = each * lr, each * lg, each * lb
            rest = sheen
            if relied > _0 and turned:
                rest *= _1 - relied * carried_by_lights(roughness * roughness, sx, sy, sz, dx, dy, dz, gx, gy, gz, wx, wy, wz, reach)
            fr, fg, fb = fr * lr, fg * lg, fb * lb
            if sheened != _0:
                if towards > 1:
                    more = min(shape(sheened, cosine, sx * wx + sy * wy + sz * wz, wx * dx + wy * dy + wz * dz), PEAK) - _1
                else:
                    more = lit_from(sheened, cosine) - _1
                r, g, b = lit * r * (dr + more * hr), lit * g * (dg + more * hg), lit * b * (db + more * hb)
            else:
                r, g, b = lit * r * dr, lit * g * dg, lit * b * db
            if across > _0:
                shine[i, c] += rest * fr
                shine[i, c + 1] += rest * fg
                shine[i, c + 2] += rest * fb
                if apart and clear < _1:
                    glass[i, c] += (_1 - clear) * rest * fr
                    glass[i, c + 1] += (_1 - clear) * rest * fg
                    glass[i, c + 2] += (_1 - clear) * rest * fb
            else:
                r, g, b = r + fr, g + fg, b + fb
        landing = min(_1, MAX_ADJOINT * max(_0, across) / max(cosine, np.float32(1e-4)))
        out[i, c] += landing * r
        out[i, c + 1] += landing * g
        out[i, c + 2] += landing * b
        if landing < _1:
            rest = aside * (_1 - landing)
            beneath[i, c] += rest * r
            beneath[i, c + 1] += rest * g
            beneath[i, c + 2] += rest * b
        if apart and clear < _1:
            behind = (_1 - clear) * (landing + aside * (_1 - landing))
            glass[i, c] += behind * r
            glass[i, c + 1] += behind * g
            glass[i, c + 2] += behind * b
    if turned and roughness < BLUR:
        set_lobe(lobe, sx, sy, sz, gx, gy, gz, wx, wy, wz, roughness, f0r, f0g, f0b, f90r, f90g, f90b, top, er, eg, eb)
    glossy = lobe[ALBEDO] if lobe[ALPHA] > _0 else _0
    dull = _THIRD * (dr + dg + db) if diffuse else _0
    through = _THIRD * (tr + tg + tb)
    whole = glossy + dull + through
    if not whole > _0:
        return sx, sy, sz, _0, _0, _0, 0, _0
    chance = glossy / whole
    u1, u2 = uniform(seed, path, at, 6), uniform(seed, path, at, 7)
    kinds, beyond = GLOSSY, _0
    pick = uniform(seed, path, at, 4)
    if pick < chance:
        dx, dy, dz, r, g, b, _ = sample_above(lobe, gx, gy, gz, goes_past(scene, on, tilt), u1, u2)
        if world and max(r, g, b) > _0:
            if roughness < BLUR:
                set_lobe(lobe, sx, sy, sz, gx, gy, gz, wx, wy, wz, BLUR, f0r, f0g, f0b, f90r, f90g, f90b, top, er, eg, eb)
            _, _, _, density = lobe_value(lobe, dx, dy, dz)
            beyond = share_of(max(density, _LEAST), world_density(emitters.world, x, y, z, sx, sy, sz, dx, dy, dz))
            if relied > _0:
                beyond *= _1 - relied * carried_by_lights(roughness * roughness, sx, sy, sz, dx, dy, dz, gx, gy, gz, wx, wy, wz, reach)
    elif through > _0 and pick * whole < glossy + through:
        gx, gy, gz = -gx, -gy, -gz
        lx, ly, lz = cosine_hemisphere(u1, u2)
        dx, dy, dz = to_world(lx, ly, lz, -sx, -sy, -sz)
        r, g, b = tr, tg, tb
        chance = through / whole
        kinds = TRANSMISSION
    else:
        lx, ly, lz = cosine_hemisphere(u1, u2)
        dx, dy, dz = to_world(lx, ly, lz, sx, sy, sz)
        lit = shadowing(tilt, gx * dx + gy * dy + gz * dz)
        r, g, b = lit * dr, lit * dg, lit * db
        chance = _1 - chance if not through > _0 else dull / whole
        kinds = DIFFUSE
    if not max(r, g, b) > _0 or gx * dx + gy * dy + gz * dz <= _0:
        kinds = 0
    return dx, dy, dz, r / chance, g / chance, b / chance, kinds, beyond


@leaf
def _add_gain(scene, surface, cache, on, x, y, z, gx, gy, gz, cosine, seed, path, at, wr, wg, wb, out, i):
    """Adds to row i of `out` what a surface reflects, weighed by w, of the light that lobes throw on it and its links do not tell."""
    _, _, _, nx, ny, nz, _ = hit_point(scene.vertices, scene.triangles, on, _THIRD, _THIRD)
    side = surface_side(scene.materials, scene.material[on], nx * gx + ny * gy + nz * gz < _0)
    cell = find_cell(cache, x, y, z, gx, gy, gz, side, uniform(seed, path, at, 62), uniform(seed, path, at, 63))
    if cell < 0:
        return
    dr, dg, db = diffuse_albedo(surface, cosine)
    for c in range(0, out.shape[1], 3):
        out[i, c] += wr * dr * cache.gain[cell, c]
        out[i, c + 1] += wg * dg * cache.gain[cell, c + 1]
        out[i, c + 2] += wb * db * cache.gain[cell, c + 2]


@leaf
def path_light(
    scene, packet, rows, surface, lobe, cache, near, on, x, y, z, error, gx, gy, gz, sx, sy, sz, wx, wy, wz, entered, bounces, follows, seed, path,
    out, i, kr, kg, kb, own, sheen, whole, last, relied, reach, for_view, chained,
):  # fmt: skip
    """Adds one sample of pi times the radiance that a surface sends towards w, weighed by k, to row i of `out`.

    That is direct light, and light of further surfaces.

    The arguments as in `scatter_light`.  bounces: diffuse reflections at most; the first one after a lamp counts even if it
    is glossy.  follows: whether metal is not looked up.  cache: what surfaces farther away than `near` (m) are known to send ends the path; `no_cache()` knows none.
    own: how much of the lamps' light that the first surface reflects counts, 0 for no shadow ray, sheen: of that which it reflects as a glossy one,
    whole: of that which comes from below its facet.  last: of all light that has left as many surfaces as it may.  relied, reach: of the first surface.
    for_view: whether the first surface was evaluated for w.
    chained: how much of the lamps' light counts that lobes reflect to which others have led, 0 or 1.
    out: (N, 3 G) float32 W/m^2, three columns for each light group.
    """
    wr = wg = wb = _1
    left = bounces - 1
    by_lobes = _1  # how much counts of what lobes that are met show of the lamps
    # Where photons bring it, `cache.gain` has what diffuse surfaces get of it: by chance found, in a small lobe, it would be a spark.
    by_gain = cache.chained if len(cache.gain) > 0 else _1
    mirrored = _1
    for vertex in range(bounces + _MORE_SURFACES):
        at = vertex * DIMENSIONS
        if left > 0 and len(cache.gain) > 0:
            cosine = lobe_cosine(sx, sy, sz, gx, gy, gz, wx, wy, wz)
            full = last if left == 1 else _1  # to get there takes a bounce, as by a ray
            _add_gain(
                scene, surface, cache, on, x, y, z, gx, gy, gz, cosine, seed, path, at, full * kr * wr, full * kg * wg, full * kb * wb, out, i
            )  # fmt: skip
        first = own if vertex == 0 else _1
        shine = sheen / max(own, np.float32(1e-6)) if vertex == 0 else mirrored * by_lobes
        aside = whole / max(own, np.float32(1e-6)) if vertex == 0 else _1
        carried = relied if vertex == 0 else _0
        towards = np.int64(2) if for_view and vertex == 0 else np.int64(1)
        dx, dy, dz, tr, tg, tb, kinds, beyond = scatter_light(
            scene, packet, rows, surface, lobe, on, x, y, z, error, gx, gy, gz, sx, sy, sz, wx, wy, wz, entered, np.int64(first > _0), left > 0,
            towards, seed, path, at, out, out, out, out, False, i, first * kr * wr, first * kg * wg, first * kb * wb, shine, aside,
            carried, reach,
        )  # fmt: skip
        if kinds == 0:
            break
        if kinds == DIFFUSE:
            left -= 1
        if kinds != GLOSSY:
            entered = OUTSIDE
        if vertex > 0:
            beyond *= mirrored * by_lobes
        if kinds != GLOSSY:
            by_lobes = by_gain if kinds == DIFFUSE else _1
        elif vertex == 0:
            by_lobes = chained
        wr, wg, wb = wr * tr, wg * tg, wb * tb
        if vertex == 0 and kinds == GLOSSY:  # lights carry none of what lobes reflect of other surfaces, but all that comes through
            wr, wg, wb = whole * wr, whole * wg, whole * wb
            beyond *= sheen / max(whole, np.float32(1e-6))
            last = _1
        elif kinds == DIFFUSE and left == 0:
            wr, wg, wb = last * wr, last * wg, last * wb
        if vertex > 0:  # russian roulette by what the path still carries
            go_on = min(np.float32(0.95), max(wr, wg, wb))
            if uniform(seed, path, at, 5) >= go_on:
                break
            wr, wg, wb = wr / go_on, wg / go_on, wb / go_on
        ox, oy, oz = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
        triangle, u, v, t, r, g, b, clear, entered = nearest_surface(
            scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, np.float32(np.inf), kinds, seed, path, at + 8, entered
        )
        if triangle < 0:
            if beyond > _0:
                counted = _PI * beyond * (_1 if left > 0 else clear)
                c = 3 * scene.emitters.light_group[len(scene.emitters.source)]
                er, eg, eb = world_radiance(scene.emitters.world, dx, dy, dz)
                out[i, c] += counted * kr * wr * r * er
                out[i, c + 1] += counted * kg * wg * g * eg
                out[i, c + 2] += counted * kb * wb * b * eb
            break
        on = triangle
        wr, wg, wb = wr * r, wg * g, wb * b
        x, y, z, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
        sx, sy, sz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
        sx, sy, sz = mapped_normal(scene.materials, scene.material[triangle], surface, sx, sy, sz)
        behind = gx * dx + gy * dy + gz * dz > 0
        if behind:
            gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
        mirrored = _0 if encloses(scene.materials.flags[scene.material[triangle]], behind) else _1
        if t > near and left < len(cache.radiosity) and not (follows and scene.materials.flags[scene.material[triangle]] & METAL):
            cell = find_cell(
                cache, x, y, z, gx, gy, gz, surface_side(scene.materials, scene.material[triangle], behind), uniform(seed, path, at, 60), uniform(seed, path, at, 61)
            )  # fmt: skip
            if cell >= 0:
                add_known(cache, left, cell, -(gx * dx + gy * dy + gz * dz), kr * wr, kg * wg, kb * wb, out, i)
                if left > 0 and last != _1:
                    more = last - _1
                    for c in range(0, out.shape[1], 3):
                        out[i, c] += more * kr * wr * (cache.radiosity[left, cell, c] - cache.radiosity[left - 1, cell, c])
                        out[i, c + 1] += more * kg * wg * (cache.radiosity[left, cell, c + 1] - cache.radiosity[left - 1, cell, c + 1])
                        out[i, c + 2] += more * kb * wb * (cache.radiosity[left, cell, c + 2] - cache.radiosity[left - 1, cell, c + 2])
                if by_lobes < _1:
                    take_known(cache.shone, cell, kr * wr, kg * wg, kb * wb, out, i)
                break
        wx, wy, wz = -dx, -dy, -dz


@kernel
def _tail_chunk(scene, cache, near, points, further, begin, end, bounces, seed, out):
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    lobe = np.zeros(LOBE, np.float32)
    for i in range(begin, end):
        weight = _0
        for c in range(3):
            weight = max(weight, points.albedo[i, c] + max(points.f0[i, c], points.f90[i, c]))
        most = bounces + is_transmitting(points, i) + np.int64(further[i])
        if not weight > _0 or most < 1:
            continue
        # Albedos may be weighted: a path is judged by what it loses on its way alone.
        inverse = _1 / weight
        surface[:] = _0
        for c in range(3):
            surface[layout.DIFFUSE + c] = inverse * points.albedo[i, c]
            surface[GLOSSY_F0 + c], surface[GLOSSY_F90 + c] = inverse * points.f0[i, c], inverse * points.f90[i, c]
        surface[ROUGHNESS] = points.roughness[i]
        for c in range(4):
            surface[GLOSS + c] = points.gloss[i, c]
        for c in range(3):
            surface[SHEEN + c] = points.sheen[i, c] * surface[layout.DIFFUSE + c]
        surface[SHEEN_ROUGHNESS] = points.sheen[i, 3]
        path_light(
            scene, packet, rows, surface, lobe, cache, near, points.triangle[i], points.position[i, 0], points.position[i, 1], points.position[i, 2],
            points.error[i], points.ng[i, 0], points.ng[i, 1], points.ng[i, 2], points.ns[i, 0], points.ns[i, 1], points.ns[i, 2],
            points.wo[i, 0], points.wo[i, 1], points.wo[i, 2], np.int64(points.entered[i]), most, False, seed, np.uint32(i),
            out, i, weight, weight, weight, _1, _1, _1, _1, _0, _1, True, _1,
        )  # fmt: skip


def tail_light(
    scene: Transport,
    points: ShadingPoints,
    bounces: int,
    seed: int,
    threads: int = 0,
    cache: LightCache | None = None,
    near: float = np.inf,
    *,
    further: np.ndarray | None = None,
) -> np.ndarray:
    """One sample of `path_light` at each of N points towards their viewers, (N, 3 G) float32 W/m^2; one bounce more where it comes through.

    further: (N,) uint8, 1 where there is one bounce more, None for nowhere.
    """
    out = scene.emitters.no_light(len(points.pixel))
    further = np.zeros(len(out), np.uint8) if further is None else further
    known, starts = Reference(no_cache() if cache is None else cache), Reference(points)

    def work(begin, end):
        _tail_chunk(scene, known, np.float32(near), starts, further, begin, end, bounces, np.uint32(seed), out)

    run_chunks(work, len(out), CHUNK, threads)
    return out
