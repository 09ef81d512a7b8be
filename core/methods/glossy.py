"""Glossy reflections at shading points: emitters and lit surfaces found by rays drawn from each point's lobe.

What such a ray finds shining is direct light, which it shares with the shadow rays of `lamps.direct` by multiple
importance sampling: narrow lobes find broad lights, shadow rays find small lights for broad lobes.  The lit surfaces
that it finds are shading points themselves: diffuse ones are lit by paths (`tails`) or, for lobes that would blur it
anyway, by the cache of light, and mirrors reflect in turn.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel, leaf
from ..lamps.departures import place_of
from ..lamps.direct import (
    aimed_density,
    direct_light,
    expected_samples,
    is_turned,
    is_turned_at,
    passed_straight,
    set_place_lobe,
    set_point_lobe,
)
from ..lamps.links import is_hidden_alike, lights
from ..lamps.lookup import emitter_of, lamp_along, share_of
from ..lamps.tables import CASTS_SHADOW, SEEN_BY_GLOSSY, SEEN_THROUGH_GLASS, SHARP, TEXTURED, WORLD
from ..lamps.textured import shown_from
from ..lamps.world import world_radiance
from ..rays.offsets import hit_point, offset_origin
from ..rays.packet import new_packet
from ..references import Reference
from ..sampling.hashing import hash_combine, uniform
from ..sampling.sequences import sobol
from ..scene import CONSTANT, EMISSIVE, GLOSSY, NORMAL_MAPPED, REFRACTIVE, TRANSLUCENT
from ..surfaces.bending import ALONG, BEGIN, END, ORIGIN, PART, PARTS, WEIGHT, nearest_reflected
from ..surfaces.brushed import is_brushed
from ..surfaces.bumps import mean_shadowing
from ..surfaces.by_view import at_view
from ..surfaces.layout import (
    DIFFUSE,
    EMISSION,
    GLOSS,
    GLOSSY_F0,
    GLOSSY_F90,
    NORMAL,
    ROUGHNESS,
    SHEEN,
    SHEEN_ROUGHNESS,
    SURFACE,
    TILT,
    as_if_whole,
    diffuse_albedo,
    glossy_albedo,
    take_lobe,
    translucency,
)
from ..surfaces.lobes import ALPHA, LOBE, NEGLIGIBLE, goes_past, is_behind, lobe_cosine, reflection_count, sample_above, seen_cosine
from ..surfaces.normals import shading_normal, surface_side
from ..surfaces.program import evaluate, from_within, new_registers, specular_view
from ..surfaces.visibility import BY_FROST, BY_LENS, OUTSIDE
from ..threads import Cancelled, Progress, run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints
from ..view.tile import FAINT, PERFECT
from .light_cache import LightCache, add_known, find_cell, more_by_view, no_cache, take_known
from .tails import path_light, tail_light
from .wide_lobes import (
    NARROW,
    SharedRays,
    balance,
    bound,
    by_photons,
    drawn_share,
    gather_density,
    is_mirror,
    is_wide,
    known_light,
    no_sharing,
)

CHUNK, LARGE_CHUNK = 512, 4096  # points a chunk, of few and of many: what Python does for each takes as long as the rays of 200
CHUNKS = 16  # at least, of more points than those few
BLOCK = 65536  # points whose reflections are followed together: bounds the memory
MAX_REFLECTIONS = 32  # from mirror to mirror
SHARED, WHOLE = 1, 2  # lamps that rays find, beside shadow rays and alone: from within glass shadow rays would go straight
_SURE = 3  # reflections after which chance ends dim paths
# Shares of the narrow lobe in all that a surface reflects: beyond the first the cache, to which all is diffuse, does not know
# what is seen; beyond the second the surface is a mirror to the denoiser's guide.
_SHINY, _MIRROR = np.float32(0.5), np.float32(0.9)
# Of the roughness of the lobe that a ray was drawn from: as rough is, at least, what it shows of the mirror that it meets (Kaplanyan & Dachsbacher 2013, "Path Space
# Regularization for Holistic and Robust Light Transport").  A lamp in it would be a spark of thousands of times the light of what is around; its image is a fifth less bright, and as much larger, at most.
AS_ROUGH = np.float32(0.5)
_SHARP = np.float32(0.2)  # roughness of what mirrors well enough to show edges
_SEED = 0x9E3779B9  # sets these rays apart from those of other stages
_0 = np.float32(0.0)
_INV_PI = np.float32(1 / np.pi)
_THIRD = np.float32(1 / 3)
_1 = np.float32(1.0)
_SHORT = np.float32(0.9999)  # as for shadow rays: a lamp often lies in a surface


@inlined
def _add_shining(shown, by_glass, i, c, clear, r, g, b):
    """Adds emission, of light group c / 3, to row i: to `by_glass` the part that passed glass, which is a bounce to Cycles."""
    shown[i, c] += clear * r
    shown[i, c + 1] += clear * g
    shown[i, c + 2] += clear * b
    if clear < _1:
        by_glass[i, c] += (_1 - clear) * r
        by_glass[i, c + 1] += (_1 - clear) * g
        by_glass[i, c + 2] += (_1 - clear) * b


@leaf
def _radiance_along(emitters, e, rows, surface, x, y, z, dx, dy, dz, t):
    """Radiance (r, g, b) of lamp e at the distance t along d."""
    r, g, b = emitters.radiance[e, 0], emitters.radiance[e, 1], emitters.radiance[e, 2]
    if emitters.flags[e] & TEXTURED:
        sr, sg, sb = shown_from(
            emitters.materials,
            emitters.attributes,
            emitters.kind[e],
            emitters.flags[e],
            emitters.lamps,
            e,
            x,
            y,
            z,
            dx,
            dy,
            dz,
            t,
            rows,
            surface,
        )
        r, g, b = r * sr, g * sg, b * sb
    return r, g, b


@leaf
def _lamps_along(
    scene, packet, rows, surface, on, expected, estimate, drawn, turned, elsewhere, x, y, z, error, gx, gy, gz, sx, sy, sz, dx, dy, dz, entered,
    blurred, wr, wg, wb, shown, by_glass, i,
):  # fmt: skip
    """Adds the radiance of the lamps along d, weighed by w and the share of rays drawn with the density `drawn`, to row i of `shown`, or of
    `by_glass`, of a point of the triangle `on`.  Lamps hide nothing, neither each other nor what lies behind them.  turned: whether sharp ones have `highlights` there.
    What a lens lets through is left to `_lamps_beyond` where glass bends the ray, or to photons, where `elsewhere`; shadow rays have none of it.  What frosted glass scatters is
    left to photons where the lobe is so wide that these light it (`blurred`); narrower ones see it straight through.
    """
    emitters = scene.emitters
    for e in range(len(emitters.source)):
        if not emitters.flags[e] & SEEN_BY_GLOSSY or (turned and emitters.flags[e] & SHARP):
            continue
        t, w = lamp_along(emitters, e, x, y, z, dx, dy, dz)
        if not w > _0 or not lights(emitters, e, scene.object, on):
            continue
        tr = tg = tb = clear = _1
        if emitters.flags[e] & CASTS_SHADOW:
            ox, oy, oz = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
            tr, tg, tb, clear = passed_straight(
                scene, packet, rows, surface, e, ox, oy, oz, dx, dy, dz, t * _SHORT, entered, max(_0, sx * dx + sy * dy + sz * dz), False
            )
        if clear == BY_LENS:
            if elsewhere:
                continue
            clear = _0
        elif clear == BY_FROST and blurred:
            continue
        else:
            clear = max(_0, clear)
            w *= share_of(drawn, aimed_density(emitters, expected, estimate, e, x, y, z, sx, sy, sz, dx, dy, dz))
        r, g, b = _radiance_along(emitters, e, rows, surface, x, y, z, dx, dy, dz, t)
        _add_shining(shown, by_glass, i, 3 * emitters.light_group[e], clear, wr * w * tr * r, wg * w * tg * g, wb * w * tb * b)


@leaf
def _lamps_beyond(scene, rows, surface, on, seen_by, part, wr, wg, wb, by_glass, i):
    """Adds the radiance of the lamps on a `part` of a way (see `nearest_reflected`) to a point of the triangle `on`, weighed by w, to row i of `by_glass`.

    seen_by: SEEN_BY_GLOSSY or, beyond glass, SEEN_THROUGH_GLASS.
    """
    emitters = scene.emitters
    x, y, z, dx, dy, dz = part[ORIGIN], part[ORIGIN + 1], part[ORIGIN + 2], part[ALONG], part[ALONG + 1], part[ALONG + 2]
    for e in range(len(emitters.source)):
        if not emitters.flags[e] & seen_by:
            continue
        t, w = lamp_along(emitters, e, x, y, z, dx, dy, dz)
        if not w > _0 or not part[BEGIN] <= t < part[END] or not lights(emitters, e, scene.object, on):
            continue
        r, g, b = _radiance_along(emitters, e, rows, surface, x, y, z, dx, dy, dz, t)
        c = 3 * emitters.light_group[e]
        by_glass[i, c] += w * wr * part[WEIGHT] * r
        by_glass[i, c + 1] += w * wg * part[WEIGHT + 1] * g
        by_glass[i, c + 2] += w * wb * part[WEIGHT + 2] * b


@kernel
def _reflect_chunk(
    scene, cache, near, row, points, owner, begin, end, samples, most, roulette, seed, first, clear, shared, further, lit, shown, known, guide, hits,
    mirror, sure, more, lit_hits,
):  # fmt: skip
    """Draw up to `most` rays from the lobe of each point begin..end-1: emission that they meet is added to `shown` (N, 3 G), or to `known`
    where it passed glass.

    The surfaces met go into `hits`, whose `pixel` is the `owner` (N,) of their point and whose albedo, f0 and f90 hold the
    weight of their ray; one with a narrow lobe reflects (mirror (H,) is 1) or is diffuse (0) at random.  Where the lobe is
    wider than the cells of the cache, and the surface farther than `near`, what it sends by row `row` is added to `known` (N, 3 G), and by the
    row before to the extent that Cycles counts the ray as a diffuse one (`wide_lobes.drawn_share`); more (H,) is 0 where it does, at random, else 1.
    lit: (N,) uint8, how their points get the emitters' light: 0 by photons, `WHOLE` by these rays alone, else by shadow rays, too.  lit_hits: (H,) uint8, the same of the hits.
    further: (N,) uint8, the `more` that stays what it was found to be, empty where it is to be found.
    clear: (N,) uint8, whether only mirrors lie between the point and the eye; then what its rays meet adds its diffuse albedo to
    `guide` (N, 3), as it is on average, and sure (H,) says whether that meets a mirror itself.
    shared: `SharedRays` of the points, with which wide lobes share what the cache knows.
    Returns the number of hits and of rays.
    """
    emitters = scene.emitters
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface, lamp = np.zeros(SURFACE, np.float32), np.zeros(SURFACE, np.float32)
    lobe, another = np.zeros(LOBE, np.float32), np.zeros(LOBE, np.float32)
    parts = np.empty((PARTS, PART), np.float32)
    groups = len(emitters.groups)
    estimate, count, expected = np.empty(groups, np.float32), np.empty(groups, np.int32), np.empty(groups, np.float32)
    shining = len(emitters.source)
    world = shining < len(emitters.kind) and emitters.kind[shining] == WORLD and emitters.flags[shining] & SEEN_BY_GLOSSY
    n_hits = rays = 0
    for i in range(begin, end):
        set_point_lobe(points, i, lobe)
        n = reflection_count(lobe, points.albedo[i, 0], points.albedo[i, 1], points.albedo[i, 2], most)
        if n == 0:
            continue
        x, y, z, error = points.position[i, 0], points.position[i, 1], points.position[i, 2], points.error[i]
        gx, gy, gz = points.ng[i, 0], points.ng[i, 1], points.ng[i, 2]
        sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
        expected_samples(scene, points.triangle[i], x, y, z, sx, sy, sz, samples, estimate, count, expected)
        key = hash_combine(seed, i)
        entered = np.int64(points.entered[i])
        wide = (shared.gather[i] > 0 or shared.lights) and is_wide(lobe)
        turned = is_turned(points, i)
        # Photons that lenses and sheets have bent bring lamps' light to wide lobes, but to none of glass, where they do not land.
        bent_by_photons = lit[i] == SHARED and is_wide(lobe) and not scene.materials.flags[scene.material[points.triangle[i]]] & REFRACTIVE
        elsewhere = bent_by_photons or not wide
        beneath = _THIRD * (points.albedo[i, 0] + points.albedo[i, 1] + points.albedo[i, 2])
        past = goes_past(scene, points.triangle[i], points.tilt[i])
        for s in range(n):
            index = first * n + s
            if turned:
                place = place_of(points, i, index, key)
                if is_turned_at(points, i, place):
                    set_place_lobe(points, i, place, lobe)
                else:
                    set_point_lobe(points, i, lobe)
            dx, dy, dz, wr, wg, wb, density = sample_above(lobe, gx, gy, gz, past, sobol(index, 0, key), sobol(index, 1, key))
            if not max(wr, wg, wb) > _0:
                continue
            # There shadow rays find no lamp that the lobe shows: chance alone would meet small ones.
            aside = is_behind(lobe, dx, dy, dz)
            drawn = np.float32(n) * density
            wr, wg, wb = wr / np.float32(n), wg / np.float32(n), wb / np.float32(n)
            vr, vg, vb = wr, wg, wb  # before what lies on the way
            rays += 1
            if lit[i] == SHARED and not aside:
                _lamps_along(
                    scene, packet, rows, surface, points.triangle[i], expected, estimate, drawn, turned, elsewhere, x, y, z, error, gx, gy, gz,
                    sx, sy, sz, dx, dy, dz, entered, is_wide(lobe), wr, wg, wb, shown, known, i,
                )  # fmt: skip
            ox, oy, oz = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
            # What wide lobes find straight rays find, too: both must go the same way.
            triangle, u, v, t, tr, tg, tb, unbroken, inside, brighter, by_lens, ex, ey, ez, n_parts = nearest_reflected(
                scene, packet, rows, surface, not wide, lit[i] == WHOLE, ox, oy, oz, dx, dy, dz, key, index, 0, entered, parts
            )
            if lit[i] and not (bent_by_photons or wide or aside):
                for k in range(n_parts):
                    seen_by = SEEN_BY_GLOSSY if lit[i] == WHOLE and k == 0 else SEEN_THROUGH_GLASS
                    _lamps_beyond(scene, rows, lamp, points.triangle[i], seen_by, parts[k], wr, wg, wb, known, i)
            wr, wg, wb = wr * tr, wg * tg, wb * tb
            alone = lit[i] == WHOLE or by_lens > 0
            if triangle < 0:
                if world and lit[i]:
                    share = _1
                    if not (lit[i] == WHOLE or by_lens > 1):
                        share = share_of(drawn, aimed_density(emitters, expected, estimate, shining, x, y, z, sx, sy, sz, dx, dy, dz))
                    r, g, b = world_radiance(emitters.world, ex, ey, ez)
                    c = 3 * emitters.light_group[shining]
                    _add_shining(shown, known, i, c, unbroken, share * wr * r, share * wg * g, share * wb * b)
                continue
            material = scene.material[triangle]
            flags = scene.materials.flags[material]
            px, py, pz, hx, hy, hz, p_error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
            nx, ny, nz = shading_normal(scene.corner_normals, triangle, u, v, hx, hy, hz)
            behind = hx * ex + hy * ey + hz * ez > 0
            cosine = seen_cosine(flags, nx, ny, nz, hx, hy, hz, ex, ey, ez)
            narrow = max(surface[GLOSSY_F90], surface[GLOSSY_F90 + 1], surface[GLOSSY_F90 + 2]) > NEGLIGIBLE and (
                surface[ROUGHNESS] < NARROW or is_brushed(surface)
            )
            if (narrow or surface[SHEEN_ROUGHNESS] != _0 or flags & EMISSIVE) and not flags & CONSTANT:  # it may depend on the view
                view = specular_view(-cosine if behind else cosine, GLOSSY)
                if flags & REFRACTIVE and behind and inside == OUTSIDE:
                    view = from_within(view)
                evaluate(scene.materials, material, scene.attributes, triangle, u, v, view, rows, surface)
                if brighter != _1:
                    as_if_whole(surface, brighter)
            if flags & NORMAL_MAPPED:
                nx, ny, nz = surface[NORMAL], surface[NORMAL + 1], surface[NORMAL + 2]
            if behind:
                hx, hy, hz, nx, ny, nz = -hx, -hy, -hz, -nx, -ny, -nz
            cosine = lobe_cosine(nx, ny, nz, hx, hy, hz, -ex, -ey, -ez)
            e = emitter_of(emitters, triangle) if flags & EMISSIVE else -1
            found = e >= 0 and not (lit[i] and is_hidden_alike(emitters, e) and lights(emitters, e, scene.object, points.triangle[i]))
            if flags & EMISSIVE and not found and not (e >= 0 and (aside or (bent_by_photons and by_lens > 0))):
                share = _1
                if e >= 0 and not alone:
                    share = share_of(drawn, aimed_density(emitters, expected, estimate, e, x, y, z, sx, sy, sz, dx, dy, dz))
                c = 3 * emitters.object_light_group[scene.object[triangle]]
                r, g, b = share * wr * surface[EMISSION], share * wg * surface[EMISSION + 1], share * wb * surface[EMISSION + 2]
                _add_shining(shown, known, i, c, unbroken, r, g, b)
            if points.shown[i]:
                continue
            ar, ag, ab = diffuse_albedo(surface, cosine)
            hits.sheen[n_hits, 0] = surface[SHEEN] / max(ar, FAINT)
            hits.sheen[n_hits, 1] = surface[SHEEN + 1] / max(ag, FAINT)
            hits.sheen[n_hits, 2] = surface[SHEEN + 2] / max(ab, FAINT)
            hits.sheen[n_hits, 3] = surface[SHEEN_ROUGHNESS]
            shadowed = mean_shadowing(surface[TILT])
            ar, ag, ab = shadowed * ar, shadowed * ag, shadowed * ab
            lr = lg = lb = _0
            if flags & TRANSLUCENT:
                lr, lg, lb = translucency(surface, cosine)
            through = lr + lg + lb
            chance = _0  # of a mirror, rather than of what is diffuse
            if narrow:
                fr, fg, fb = glossy_albedo(surface, cosine)
                chance = (fr + fg + fb) / max(fr + fg + fb + ar + ag + ab + through, np.float32(1e-6))
            across = max(_0, sx * dx + sy * dy + sz * dz)
            glossy = np.float32(further[i]) if len(further) > 0 else drawn_share(lobe, beneath, density, across)
            shares = wide and not aside and not is_mirror(scene.materials, material)
            # Whether what it throws of the lamps' light comes by photons, and the part that does.
            thrown = wide and cache.shine == _0 and t > near and t * lobe[ALPHA] > cache.size
            each = density * np.float32(n)
            brought = by_photons(lobe, across, each * vr, each * vg, each * vb) if thrown else _0
            if (chance < _SHINY or shares) and t > near and t * lobe[ALPHA] > cache.size and row < len(cache.radiosity):
                cell = find_cell(
                    cache, px, py, pz, hx, hy, hz, surface_side(scene.materials, material, behind), uniform(key, index, 1, 2), uniform(key, index, 1, 3)
                )  # fmt: skip
                seen = -(hx * ex + hy * ey + hz * ez)
                carried = _0
                if cell >= 0 and (shares or thrown):
                    part = _1
                    if shares:
                        part = balance(drawn, gather_density(shared.gather[i], across))
                    if shares and shared.lights:
                        clamped = min(_1, shared.g_max * t * t / max(across * abs(hx * ex + hy * ey + hz * ez), np.float32(1e-20)))
                        carried = clamped * bound(lobe, across, each * vr, each * vg, each * vb)
                    turned = more_by_view(cache, cell, seen)
                    for c in range(0, known.shape[1], 3):
                        known[i, c] += part * wr * _INV_PI * known_light(cache, cell, c, glossy, carried, turned)
                        known[i, c + 1] += part * wg * _INV_PI * known_light(cache, cell, c + 1, glossy, carried, turned)
                        known[i, c + 2] += part * wb * _INV_PI * known_light(cache, cell, c + 2, glossy, carried, turned)
                elif cell >= 0:
                    part = glossy * _INV_PI
                    add_known(cache, row, cell, seen, part * wr, part * wg, part * wb, known, i)
                    if row > 0 and glossy < _1:
                        part = _INV_PI - part
                        add_known(cache, row - 1, cell, seen, part * wr, part * wg, part * wb, known, i)
                    take_known(cache.lobes, cell, _INV_PI * wr, _INV_PI * wg, _INV_PI * wb, known, i)
                if cell >= 0:
                    follow = at_view(cache.follow, cache.side[cell], seen)
                    if uniform(key, index, 1, 6) < follow:  # what its lobe reflects has a direction
                        take_lobe(surface)
                        scale = _INV_PI / follow
                        sheen = _1 - (brought if thrown else cache.trust[cell] * carried)
                        own = _1 if sheen > _0 else _0
                        path_light(
                            scene, packet, rows, surface, another, cache, near, triangle, px, py, pz, p_error, hx, hy, hz, nx, ny, nz, -ex, -ey, -ez,
                            inside, row + np.int64(uniform(key, index, 1, 5) < glossy), True, hash_combine(key, np.uint32(1)), np.uint32(index),
                            known, i, scale * wr, scale * wg, scale * wb, own, sheen, _1, _1, _0, _1, False, _1,
                        )  # fmt: skip
                    continue
            if roulette:
                go_on = min(np.float32(0.95), max(wr, wg, wb))
                if uniform(key, index, 1, 0) >= go_on:
                    continue
                wr, wg, wb = wr / go_on, wg / go_on, wb / go_on
            mirror[n_hits] = sure[n_hits] = 0
            lit_hits[n_hits] = WHOLE if flags & REFRACTIVE and behind else SHARED
            if thrown and uniform(key, index, 1, 7) < brought:
                lit_hits[n_hits] = 0
            more[n_hits] = uniform(key, index, 1, 5) < glossy
            if clear[i]:
                guide[i, 0] += wr * (ar + lr)
                guide[i, 1] += wg * (ag + lg)
                guide[i, 2] += wb * (ab + lb)
            kr, kg, kb = wr, wg, wb  # of the lobe that the hit keeps
            if narrow:
                mirror[n_hits] = uniform(key, index, 1, 1) < chance
                sure[n_hits] = clear[i] != 0 and chance > _MIRROR
                if mirror[n_hits]:
                    kr, kg, kb = wr / chance, wg / chance, wb / chance
                    ar = ag = ab = through = _0
                else:
                    kr = kg = kb = _0
                    ar, ag, ab = ar / (_1 - chance), ag / (_1 - chance), ab / (_1 - chance)
                    lr, lg, lb = lr / (_1 - chance), lg / (_1 - chance), lb / (_1 - chance)
            if through > _0:  # what it reflects, or what comes through it
                kept = _0
                for c in range(3):
                    kept += surface[DIFFUSE + c] + (_0 if narrow else max(surface[GLOSSY_F0 + c], surface[GLOSSY_F90 + c]))
                part = through / (through + kept)
                if uniform(key, index, 1, 4) < part:
                    hx, hy, hz, nx, ny, nz = -hx, -hy, -hz, -nx, -ny, -nz
                    hits.sheen[n_hits, 3] = kr = kg = kb = _0
                    ar, ag, ab = lr / part, lg / part, lb / part
                else:
                    part = _1 - part
                    kr, kg, kb, ar, ag, ab = kr / part, kg / part, kb / part, ar / part, ag / part, ab / part
            if not max(kr, kg, kb, ar, ag, ab) > _0:
                continue
            hits.f0[n_hits, 0], hits.f90[n_hits, 0] = kr * surface[GLOSSY_F0], kr * surface[GLOSSY_F90]
            hits.f0[n_hits, 1], hits.f90[n_hits, 1] = kg * surface[GLOSSY_F0 + 1], kg * surface[GLOSSY_F90 + 1]
            hits.f0[n_hits, 2], hits.f90[n_hits, 2] = kb * surface[GLOSSY_F0 + 2], kb * surface[GLOSSY_F90 + 2]
            hits.albedo[n_hits, 0], hits.albedo[n_hits, 1], hits.albedo[n_hits, 2] = wr * ar, wg * ag, wb * ab
            hits.position[n_hits, 0], hits.position[n_hits, 1], hits.position[n_hits, 2] = px, py, pz
            hits.ng[n_hits, 0], hits.ng[n_hits, 1], hits.ng[n_hits, 2] = hx, hy, hz
            hits.ns[n_hits, 0], hits.ns[n_hits, 1], hits.ns[n_hits, 2] = nx, ny, nz
            hits.wo[n_hits, 0], hits.wo[n_hits, 1], hits.wo[n_hits, 2] = -ex, -ey, -ez
            hits.error[n_hits], hits.roughness[n_hits] = p_error, max(surface[ROUGHNESS], AS_ROUGH * np.float32(math.sqrt(lobe[ALPHA])))
            for c in range(4):
                hits.gloss[n_hits, c] = surface[GLOSS + c]
            hits.pixel[n_hits], hits.triangle[n_hits] = owner[i], triangle
            hits.entered[n_hits] = min(inside, 255)
            n_hits += 1
    return n_hits, rays


def _draw(
    scene: Transport, cache: LightCache, near: float, row: int, points: ShadingPoints, owner: np.ndarray, samples: int, most: int,
    roulette: bool, seed: int, threads: int, first: int, clear: np.ndarray, shared: SharedRays, further: np.ndarray, lit: np.ndarray,
):  # fmt: skip
    """Rays from all points -> (emission met (N, 3 G), light of the cache (N, 3 G), guide (N, 3), diffuse hits, mirrors hit, whether
    each of these is sure to be one, whether diffuse hits and mirrors have one bounce more, how mirrors get the lamps' light, number of rays)."""
    shown, known = (scene.emitters.no_light(len(owner)) for _ in range(2))
    guide = np.zeros((len(owner), 3), np.float32)
    known_by, starts = Reference(cache), Reference(points)

    def work(begin, end):
        room = ShadingPoints.allocate((end - begin) * most)
        mirror, sure, more, lamps = (np.empty((end - begin) * most, np.uint8) for _ in range(4))
        n, rays = _reflect_chunk(
            scene, known_by, np.float32(near), row, starts, owner, begin, end, samples, most, roulette, np.uint32(seed), np.int64(first), clear,
            shared, further, lit, shown, known, guide, Reference(room), mirror, sure, more, lamps,
        )  # fmt: skip
        matt, mirror = np.flatnonzero(mirror[:n] == 0), np.flatnonzero(mirror[:n])
        return room.take(matt), room.take(mirror), sure[mirror], more[matt], more[mirror], lamps[mirror], rays

    parts = run_chunks(work, len(owner), int(np.clip(len(owner) // CHUNKS, CHUNK, LARGE_CHUNK)), threads)
    diffuse, mirrors = (ShadingPoints.concatenate([part[k] for part in parts]) for k in (0, 1))
    sure, *more, lit = (np.concatenate([part[k] for part in parts]) if parts else np.zeros(0, np.uint8) for k in (2, 3, 4, 5))
    return shown, known, guide, diffuse, mirrors, sure, more, lit, sum(part[6] for part in parts)


def has_lobes(points: ShadingPoints) -> bool:
    """Whether any point reflects enough to be worth a ray."""
    return bool((points.f90 > NEGLIGIBLE).any() or (points.f0 > NEGLIGIBLE).any())


def lamps_by_rays(scene: Transport, points: ShadingPoints) -> np.ndarray:
    """(N,) bool, of which points rays from the lobe alone find the lamps: backs of clear glass that a view has come to, bent, from within.

    What they mirror leaves by the front, which bends it, too.  A shadow ray would go straight, and the lamp show where it is not.
    """
    backs = np.zeros(len(points.pixel), bool)
    if not (scene.materials.flags & REFRACTIVE).any():
        return backs
    clear = points.behind_glass.astype(bool) & (points.entered == 0) & (points.roughness <= PERFECT)
    chosen = np.flatnonzero(clear & (points.f90 > NEGLIGIBLE).any(axis=1))
    triangle = points.triangle[chosen]
    chosen = chosen[scene.materials.flags[scene.material[triangle]] & REFRACTIVE != 0]
    a, b, c = (scene.vertices[scene.triangles[points.triangle[chosen], k]] for k in range(3))
    backs[chosen] = np.einsum("ij,ij->i", np.cross(b - a, c - a), points.ng[chosen]) < 0
    return backs


@kernel
def _add(out, owner, radiance):
    """Adds radiance (M, D) to the rows owner (M,), in order, of out (N, D)."""
    sums = np.empty(out.shape[1])
    i = 0
    while i < len(owner):
        k = owner[i]
        sums[:] = 0.0
        while i < len(owner) and owner[i] == k:
            for c in range(len(sums)):
                sums[c] += radiance[i, c]
            i += 1
        for c in range(len(sums)):
            out[k, c] = np.float32(np.float64(out[k, c]) + sums[c])


class Reflections(NamedTuple):
    """What rays from the lobes of N points found.

    direct, indirect: (N, 3 G) float32, radiance, W/m^2/sr, by light groups.  rays: how many were drawn.  albedo: (N, 3) float32, diffuse
    albedo of what mirrors show, times their own: it tells a denoiser where the edges in a mirror are.
    """

    direct: np.ndarray
    indirect: np.ndarray
    rays: int
    albedo: np.ndarray


def reflect(
    scene: Transport, points: ShadingPoints, samples: int, reflections: int, bounces: int, seed: int,
    threads: int = 0, progress: Progress | None = None, *, first: int = 0, cache: LightCache | None = None, near: float = np.inf,
    shared: SharedRays | None = None,
) -> Reflections:  # fmt: skip
    """What the glossy lobes of shading points show, by rays drawn from the lobes.

    Args:
        samples, reflections, first: as in the call of `lamps.direct_light` that gives the rest of the direct light.
            A point gets up to `reflections` rays, fewer where its lobe is faint beside its diffuse albedo.
        bounces: diffuse bounces of the indirect light.  A glossy one counts as none, but to the extent that Cycles draws
            its directions from the diffuse lobe beneath (`wide_lobes.drawn_share`).
        cache, near: what surfaces farther than `near` (m) are known to send, with a row for `bounces` + 1 surfaces.
        shared: what other rays have found for wide lobes, None for nothing.

    Raises:
        Cancelled: `progress` returned False.
    """
    n = len(points.position)
    direct, indirect, albedo = scene.emitters.no_light(n), scene.emitters.no_light(n), np.zeros((n, 3), np.float32)
    sharp = points.roughness < _SHARP
    lamps = np.where(lamps_by_rays(scene, points), WHOLE, SHARED).astype(np.uint8)
    cache = no_cache() if cache is None else cache
    shared = no_sharing(n) if shared is None else shared
    total = 0
    for begin in range(0, n, BLOCK):
        block = slice(begin, min(begin + BLOCK, n))
        part = ShadingPoints(*(a[block] for a in points))
        key = (seed ^ _SEED) + begin & 0xFFFFFFFF
        owner = np.arange(len(part.pixel), dtype=np.int32)
        shown, known, guide, diffuse, mirrors, sure, (more, further), lit_by, rays = _draw(
            scene, cache, near, bounces, part, owner, samples, reflections, False, key, threads, first, sharp[block].view(np.uint8),
            shared._replace(gather=shared.gather[block]), np.zeros(0, np.uint8), lamps[block],
        )  # fmt: skip
        direct[block], indirect[block], albedo[block] = shown, known, guide
        total += rays
        lit, deeper = [diffuse], [more]
        for depth in range(1, MAX_REFLECTIONS):
            if len(mirrors.pixel) == 0:
                break
            key = key + 1 & 0xFFFFFFFF
            light, rays = direct_light(scene, mirrors, 1, key, threads, reflections=1)
            shown, known, guide, diffuse, seen, surely, (more, beyond), beyond_lamps, drawn = _draw(
                scene, cache, near, bounces, mirrors, mirrors.pixel, 1, 1, depth >= _SURE, key, threads, 0, sure,
                no_sharing(len(mirrors.pixel)), further, lit_by,
            )  # fmt: skip
            _add(albedo[block], mirrors.pixel, guide)
            _add(indirect[block], mirrors.pixel, (lit_by == SHARED)[:, None] * (light.glossy + light.glossy_by_glass) + shown + known)
            lit.append(diffuse)
            deeper.append(more)
            mirrors, sure, further, lit_by = seen, surely, beyond, beyond_lamps
            total += rays + drawn
        hits = ShadingPoints.concatenate(lit)
        light = tail_light(scene, hits, bounces, key, threads, cache, near, further=np.concatenate(deeper))
        _add(indirect[block], hits.pixel, light * _INV_PI)
        if progress is not None and not progress(block.stop / n):
            raise Cancelled
    return Reflections(direct, indirect, total, albedo)
