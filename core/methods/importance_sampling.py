"""Importance sampling of VPLs, and final gathering from cached light: the accurate method.

Both estimate the same integral, and share it by what each is good at.  Of the light that a surface y sends to a
shading point x, virtual lights carry

    w(x, y) = B(y) / (B(y) + tau) min(1, G_max / G(x, y)),

where B is the radiosity around y by the cache of light and tau the mean irradiance of the view; gather rays carry the
rest.  So bright, far light comes from shadow rays aimed at it, dim and near light from cosine-distributed rays, whose
light is looked up in the cache (or followed on, close by), and nothing is counted twice.  With w = min(1, G_max / G)
this is the bias compensation of Kollig & Keller 2004.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, kernel, leaf
from ..lamps import Openings, focus_share, focused
from ..lamps.direct import set_point_lobe, unevenness
from ..lamps.escapes import ESCAPED, SHINING, VEIL, VEILED, GatherRays, gather_path, gather_ray
from ..particles import BRIGHTEST, SHINE, THROUGH, Vpls, by_lobe, is_ahead, surely_carried, trace_by_power
from ..rays.offsets import hit_point, offset_origin, shadow_segment
from ..rays.order import morton_codes
from ..rays.packet import (
    DIR_X,
    DIR_Y,
    DIR_Z,
    ORG_X,
    ORG_Y,
    ORG_Z,
    T_FAR,
    WIDTH,
    hit_t,
    hit_triangle,
    hit_u,
    hit_v,
    is_occluded,
    new_packet,
    set_ray,
)
from ..rays.trace import ALL, OPAQUE, intersect_packet, occluded_packet
from ..references import Reference
from ..sampling.hashing import hash_combine, uniform
from ..scene import DIFFUSE, EMISSIVE, METAL, TRANSPARENT
from ..surfaces.by_view import at_view, views
from ..surfaces.following import lobe_chances
from ..surfaces.layout import ROUGHNESS, SURFACE, take_lobe
from ..surfaces.lobes import ALPHA, LOBE, WIDE_ALPHA, lobe_value, reflection_count
from ..surfaces.normals import mapped_normal, shading_normal, surface_side
from ..surfaces.program import new_registers
from ..surfaces.sheen import factors
from ..surfaces.visibility import OUTSIDE, encloses, evaluate_along, nearest_surface, transmittance1
from ..threads import Progress, part, run_chunks
from ..transport import Transport, is_translucent
from ..view.points import ShadingPoints, is_transmitting, shares
from ..vpl_pool import BATCH_SEED, MOST_BATCHES, UNSEEN, Particles, vpl_pool
from .caustics import Caustics, add_caustics, by_lobes
from .exchange import DEPTH, LEVELS, Probes
from .foreseen import BLOCK, HIDDEN, VISIBLE, foreseen, light_up
from .glossy import has_lobes
from .instant_radiosity import clamp_of
from .light_cache import GROWTH, NEAR, CacheBuilder, LightCache, find_cell, look_up, more_by_view
from .partition import strengths, trusted
from .probes import Tracer, trace_farther, trace_probes
from .sparks import spread_sparks, spread_thrown
from .tails import path_light
from .thrown import redirected, shine_share, throwing
from .wide_lobes import SharedRays, bound, drawn_share, gather_density, is_mirror, is_wide, known_light, wide_part

CHUNK = 1024  # points a chunk
SUBSET = 512  # virtual lights that one point looks at
# Times the lights asked for stay in the pool, at most: a point looks at one subset, and all points at more lights, whose noise no denoiser sees.
KEPT = 16
KEPT_IN_TURN = 4  # of the fewer particles of pictures that are averaged
WHOLE = 2.0  # points that are half of what their pixel shows, or more, get all rays
PICKS = 8  # of a subset: more of them go to further subsets
PATHS = 0.16  # of the cache a point, times the root of its rays: what they find is noisier than what the cache knows
MIN_PATHS = 20000
# Of a lightmap half as many: its texels have thrice the rays of pixels, and its errors are the same (1 and 2 % more in Cornell box and sunlit room, 5 seeds).
TEXEL_PATHS = 0.5
# Beyond so many points, what all of them share grows as their root: the denoiser takes out their own noise over as many pixels as ever,
# so that less of it is left in a larger picture, but not what neighbours have in common.
MANY_POINTS = 200_000
# To fewer points than this fewer lights must matter: of a small picture the particles behind them would be up to half of the time.
ALL_LIGHTS = 1 << 17
# Where fewer probes than this tell nearly all direct light (Kish's effective number), as of a patch of sun from a small window, up to so many
# times more paths are traced: the light of all bounces hangs on them.
TELLING = 300.0
MOST_MORE = 3
# Where about as few as this tell, as of the patch below a spot lamp, half of what else would be left to the cache is the lights' to carry:
# particles find every patch, and as much of it as it has light.
FEW_TELL = 50.0
PATHS_A_POINT = 64  # at most: a view of a few points does not need as many
# Light that bounces on from outside of where sun and world are focused is told by few particles of much power, so many times as much as the
# others' as the focus is smaller than the scene: where that is more than this inverse, later bounces are the gather rays' to that extent.
RELIABLE = 20.0
NEVER_STRONG = 0.5  # of a strong light: where none is more, all are trusted
HUGE = 1e30  # a clamp that bounds nothing, and times a light of no power is none
BATCHES = 4  # of particles, which the pictures of a sequence take in turn
_WEIGHT, _CARRIED, _REACH, _GLOSSY, _SEEN = 0, 3, 4, 5, 6  # columns of what a gather ray counts for a wide lobe, and is to Cycles
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_INV_PI = np.float32(1.0 / np.pi)
_THIRD = np.float32(1 / 3)


@kernel
def _gather(scene, cache, points, counts, begin, end, first, g_max, near, bounces, seed, reflections, lights, out, shown, met):
    """Adds to the points begin..end-1 what their `counts` (N,) cosine-distributed rays find, less what lights carry; the rays traced.

    reflections: most rays that wide lobes have of their own, 0 where they take no part.  lights: whether virtual lights do.
    out: (N, 3 G) W/m^2.  shown: (N, 3 G) W/m^2/sr, what wide lobes reflect.  met: (N, R) uint8, as `GatherRays` has it.
    """
    owner, turn = np.empty(WIDTH, np.int64), np.empty(WIDTH, np.int64)
    direction, hit = np.empty((WIDTH, 3), np.float32), np.empty((WIDTH, 3), np.float32)
    return _gather_leaf(
        scene, cache, points, counts, begin, end, first, g_max, near, bounces, seed, reflections, lights, out, shown, met,
        new_packet(), new_packet(), np.zeros(SURFACE, np.float32), np.zeros(LOBE, np.float32), new_registers(scene.materials),
        owner, turn, direction, np.empty(WIDTH, np.int32), hit, np.zeros((WIDTH, LOBE), np.float32), np.zeros(WIDTH, np.int64),
        np.empty((WIDTH, _SEEN), np.float32),
    )  # fmt: skip


@leaf
def _gather_leaf(
    scene, cache, points, counts, begin, end, first, g_max, near, bounces, seed, reflections, lights, out, shown, met,
    packet, single, surface, lobe, rows, owner, turn, direction, found, hit, lobes, drawn, seen,
):  # fmt: skip
    """`_gather`, its scratch given: it counts no references."""
    n = np.int64(0)
    rays = 0
    lobed = reflections > 0 or len(cache.radiosity) > bounces
    for base in range(begin, end, WIDTH):
        top = min(base + WIDTH, end)
        most = 0
        for k in range(base, top):
            most = max(most, counts[k])
            if lobed:
                set_point_lobe(points, k, lobes[k - base])
                drawn[k - base] = reflection_count(
                    lobes[k - base], points.albedo[k, 0], points.albedo[k, 1], points.albedo[k, 2], reflections
                )
        for s in range(most):
            for k in range(base, top):
                if s >= counts[k]:
                    continue
                dx, dy, dz, lz = gather_ray(seed, k, first + s, points.ns[k, 0], points.ns[k, 1], points.ns[k, 2])
                gx, gy, gz = points.ng[k, 0], points.ng[k, 1], points.ng[k, 2]
                if dx * gx + dy * gy + dz * gz <= 0:
                    continue
                ox, oy, oz = offset_origin(
                    points.position[k, 0], points.position[k, 1], points.position[k, 2], gx, gy, gz, points.error[k], dx, dy, dz
                )
                set_ray(packet, n, ox, oy, oz, dx, dy, dz, _0, np.float32(np.inf), DIFFUSE)
                owner[n], turn[n] = k, first + s
                direction[n, 0], direction[n, 1], direction[n, 2] = dx, dy, dz
                seen[n, _REACH], seen[n, _GLOSSY] = np.float32(np.inf), _0
                if lobes[k - base, ALPHA] > _0:
                    beneath = _THIRD * (points.albedo[k, 0] + points.albedo[k, 1] + points.albedo[k, 2])
                    _weigh_lobe(
                        lobes[k - base], beneath, drawn[k - base], counts[k], lz, dx, dy, dz, reflections > 0, lights, cache.size, seen[n]
                    )
                n += 1
                rays += 1
                if n == WIDTH:
                    _gathered(
                        scene, cache, points, counts, n, first, g_max, near, bounces, seed, out, shown, met, packet, single, surface, lobe, rows,
                        owner, turn, direction, found, hit, seen,
                    )  # fmt: skip
                    n = np.int64(0)
    if n > 0:
        _gathered(
            scene, cache, points, counts, n, first, g_max, near, bounces, seed, out, shown, met, packet, single, surface, lobe, rows,
            owner, turn, direction, found, hit, seen,
        )  # fmt: skip
    return rays


@leaf
def _weigh_lobe(lobe, beneath, drawn, gather, cosine, dx, dy, dz, shared, lights, cell, seen):
    """What a gather ray along d counts for a wide lobe where it is `shared`, into the row `seen`, and how far it is a glossy one to Cycles.

    beneath: diffuse albedo under the lobe, mean of the channels.  cosine: of d with the shading normal.  cell: size of the cache's.
    """
    r, g, b, density = lobe_value(lobe, dx, dy, dz)
    if not density > _0:
        return
    seen[_GLOSSY] = drawn_share(lobe, beneath, density, cosine)
    if not (shared and is_wide(lobe)):
        return
    scale = _INV_PI / (gather_density(gather, cosine) + np.float32(drawn) * density)
    seen[_WEIGHT], seen[_WEIGHT + 1], seen[_WEIGHT + 2] = scale * r, scale * g, scale * b
    seen[_CARRIED] = bound(lobe, cosine, r, g, b) if lights else _0
    seen[_REACH] = cell / lobe[ALPHA]


@leaf
def _gathered(
    scene, cache, points, counts, lanes, first, g_max, near, bounces, seed, out, shown, met, packet, single, surface, lobe, rows,
    owner, turn, direction, found, hit, seen,
):  # fmt: skip
    """Traces the `lanes` gather rays of a packet and adds what they find to their owners.

    seen: (16, 6), what they count for wide lobes: their weight, the part that lights carry, the least distance; and what part of them is
        drawn from glossy lobes by Cycles (`wide_lobes.drawn_share`), whose light may have left one surface more.
    """
    intersect_packet(scene.rays, ALL, packet, lanes)
    for lane in range(lanes):
        found[lane] = hit_triangle(packet, lane) if packet.f[T_FAR * WIDTH + lane] >= 0 else -1
        hit[lane, 0], hit[lane, 1], hit[lane, 2] = hit_u(packet, lane), hit_v(packet, lane), hit_t(packet, lane)
    for lane in range(lanes):
        triangle, k = found[lane], owner[lane]
        if triangle < 0:
            met[k, turn[lane] - first] = ESCAPED
            continue
        dx, dy, dz = direction[lane, 0], direction[lane, 1], direction[lane, 2]
        path = gather_path(k, turn[lane])
        u, v, t = hit[lane, 0], hit[lane, 1], hit[lane, 2]
        wr = wg = wb = unevenness(points, k, dx, dy, dz) / np.float32(counts[k])
        tr = tg = tb = _1
        entered = OUTSIDE
        veiled = scene.materials.flags[scene.material[triangle]] & TRANSPARENT != 0
        if veiled:
            met[k, turn[lane] - first] = VEILED
            ox, oy, oz = offset_origin(
                points.position[k, 0], points.position[k, 1], points.position[k, 2],
                points.ng[k, 0], points.ng[k, 1], points.ng[k, 2], points.error[k], dx, dy, dz,
            )  # fmt: skip
            triangle, u, v, t, tr, tg, tb, _, entered = nearest_surface(
                scene, single, rows, surface, ox, oy, oz, dx, dy, dz, np.float32(np.inf), DIFFUSE, seed, path, VEIL, OUTSIDE
            )
            if triangle < 0:
                continue
            wr, wg, wb = wr * tr, wg * tg, wb * tb
        if points.sheen[k, 3] != _0:
            fr, fg, fb = factors(
                points.sheen[k],
                points.ns[k, 0],
                points.ns[k, 1],
                points.ns[k, 2],
                points.wo[k, 0],
                points.wo[k, 1],
                points.wo[k, 2],
                dx,
                dy,
                dz,
            )
            wr, wg, wb = fr * wr, fg * wg, fb * wb
        if scene.materials.flags[scene.material[triangle]] & EMISSIVE:
            met[k, turn[lane] - first] |= SHINING
        x, y, z, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
        cos_y = -(gx * dx + gy * dy + gz * dz)
        behind = cos_y < 0
        if behind:
            gx, gy, gz, cos_y = -gx, -gy, -gz, -cos_y
        cell = find_cell(
            cache, x, y, z, gx, gy, gz, surface_side(scene.materials, scene.material[triangle], behind), uniform(seed, path, 3, 0), uniform(seed, path, 3, 1)
        )  # fmt: skip
        own = whole = reach = _1
        sheen, relied = cache.shine, _0
        more = _0
        lobe_only = False
        if len(cache.radiosity) > bounces:
            more = _1 if is_transmitting(points, k) else seen[lane, _GLOSSY]  # to come through counts as no bounce
        if cell >= 0:
            cos_x = points.ns[k, 0] * dx + points.ns[k, 1] * dy + points.ns[k, 2] * dz
            clamped = min(_1, g_max * t * t / max(cos_x * cos_y, np.float32(1e-20)))
            if t > near and not scene.materials.flags[scene.material[triangle]] & METAL:
                turned = more_by_view(cache, cell, cos_y)
                by_view = turned * (_1 - clamped * cache.share[cell])
                for c in range(0, out.shape[1], 3):
                    out[k, c] += wr * (cache.matte[cell, c] - clamped * cache.matte_lit[cell, c] + by_view * cache.first[cell, c])
                    out[k, c + 1] += wg * (
                        cache.matte[cell, c + 1] - clamped * cache.matte_lit[cell, c + 1] + by_view * cache.first[cell, c + 1]
                    )
                    out[k, c + 2] += wb * (
                        cache.matte[cell, c + 2] - clamped * cache.matte_lit[cell, c + 2] + by_view * cache.first[cell, c + 2]
                    )
                    if more > _0:
                        out[k, c] += more * wr * (cache.radiosity[bounces, cell, c] - cache.radiosity[bounces - 1, cell, c])
                        out[k, c + 1] += more * wg * (cache.radiosity[bounces, cell, c + 1] - cache.radiosity[bounces - 1, cell, c + 1])
                        out[k, c + 2] += more * wb * (cache.radiosity[bounces, cell, c + 2] - cache.radiosity[bounces - 1, cell, c + 2])
                if t > seen[lane, _REACH] and not is_mirror(scene.materials, scene.material[triangle]):
                    carried = clamped * seen[lane, _CARRIED]
                    for c in range(0, out.shape[1], 3):
                        shown[k, c] += tr * seen[lane, _WEIGHT] * known_light(cache, cell, c, more, carried, turned)
                        shown[k, c + 1] += tg * seen[lane, _WEIGHT + 1] * known_light(cache, cell, c + 1, more, carried, turned)
                        shown[k, c + 2] += tb * seen[lane, _WEIGHT + 2] * known_light(cache, cell, c + 2, more, carried, turned)
                chance = at_view(cache.follow, cache.side[cell], cos_y)
                if not uniform(seed, path, 3, 3) < chance:
                    continue
                # What its lobe reflects is not looked up, for it has a direction.
                lobe_only = True
                wr, wg, wb = wr / chance, wg / chance, wb / chance
                sheen, more = cache.shine, _0
            else:
                share = clamped * cache.share[cell]
                rest = max(_1 - cache.later * share, np.float32(1e-6))
                wr, wg, wb = wr * rest, wg * rest, wb * rest
                own, sheen, whole = (_1 - share) / rest, cache.shine / rest, _1 / rest
            relied, reach = cache.trust[cell], g_max * t * t / max(cos_x, np.float32(1e-20))
        if veiled and encloses(scene.materials.flags[scene.material[triangle]], behind):
            sheen = _0
        if not veiled:
            evaluate_along(scene, triangle, u, v, dx, dy, dz, DIFFUSE, OUTSIDE, rows, surface)
        if lobe_only:
            take_lobe(surface)
            if not sheen > _0 or (relied >= _1 and reach >= surely_carried(surface[ROUGHNESS] * surface[ROUGHNESS])):
                own = sheen = _0
        sx, sy, sz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
        sx, sy, sz = mapped_normal(scene.materials, scene.material[triangle], surface, sx, sy, sz)
        if sx * gx + sy * gy + sz * gz < 0:
            sx, sy, sz = -sx, -sy, -sz
        further = uniform(seed, path, 3, 2) < more  # by one bounce, whose light no virtual light carries
        last = whole if further else _1
        path_light(
            scene, single, rows, surface, lobe, cache, near, triangle, x, y, z, error, gx, gy, gz, sx, sy, sz, -dx, -dy, -dz, entered,
            bounces + np.int64(further), True, seed, path, out, k, wr, wg, wb, own, sheen, whole, last, relied, reach, False, cache.chained,
        )  # fmt: skip


@inlined
def _is_first_diffuse(vpls, j):
    """Whether light j is a lamp's that a diffuse lobe has reflected: it shines about its surface's own normal."""
    if vpls.bounce[j] != 1 or vpls.shine[j] != 0:
        return False
    nx, ny, nz = vpls.surface_normal[j, 0], vpls.surface_normal[j, 1], vpls.surface_normal[j, 2]
    return vpls.normal[j, 0] == nx and vpls.normal[j, 1] == ny and vpls.normal[j, 2] == nz


@inlined
def _cosine_at(vpls, j, points, k):
    """Cosine of the direction from light j to point k with the light's normal."""
    dx, dy, dz = (
        points.position[k, 0] - vpls.position[j, 0],
        points.position[k, 1] - vpls.position[j, 1],
        points.position[k, 2] - vpls.position[j, 2],
    )
    along = vpls.normal[j, 0] * dx + vpls.normal[j, 1] * dy + vpls.normal[j, 2] * dz
    return along / max(np.float32(math.sqrt(dx * dx + dy * dy + dz * dz)), np.float32(1e-20))


@leaf
def _trace_lights(scene, packet, rows, surface, cutouts, by_view, points, vpls, owner, light, value, turn, seen, lanes, out, shown, sights):
    """Traces the shadow rays of `lanes` pairs of a point and a light and adds what arrives; whether it does goes into `sights`.

    seen: (16, 3), what wide lobes reflect of irradiance from there (1/sr), negative for nothing.  by_view: of the `LightCache`.
    """
    for lane in range(lanes):
        k, j = owner[lane], light[lane]
        ox, oy, oz, dx, dy, dz = shadow_segment(
            points.position[k, 0], points.position[k, 1], points.position[k, 2], points.ng[k, 0], points.ng[k, 1], points.ng[k, 2],
            points.error[k], vpls.position[j, 0], vpls.position[j, 1], vpls.position[j, 2],
            vpls.normal[j, 0], vpls.normal[j, 1], vpls.normal[j, 2], vpls.error[j],
        )  # fmt: skip
        set_ray(packet, lane, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE)
    occluded_packet(scene.rays, OPAQUE, packet, lanes)
    for lane in range(lanes):
        k, j = owner[lane], light[lane]
        if is_occluded(packet, lane):
            sights[k, turn[lane]] = HIDDEN
            continue
        sights[k, turn[lane]] = VISIBLE
        r = g = b = _1
        if cutouts:
            f = packet.f
            r, g, b, _ = transmittance1(
                scene, packet, rows, surface,
                f[ORG_X * WIDTH + lane], f[ORG_Y * WIDTH + lane], f[ORG_Z * WIDTH + lane],
                f[DIR_X * WIDTH + lane], f[DIR_Y * WIDTH + lane], f[DIR_Z * WIDTH + lane], _0, _1, DIFFUSE, DIFFUSE, OUTSIDE, False,
            )  # fmt: skip
            if not is_ahead(vpls, j, points.position[k, 0], points.position[k, 1], points.position[k, 2]):
                r = g = b = _0
        w = value[lane] * np.float32(3.0) / (picked(vpls.seen[j]) * (vpls.flux[j, 0] + vpls.flux[j, 1] + vpls.flux[j, 2]))
        if _is_first_diffuse(vpls, j):
            w *= _1 + at_view(by_view, vpls.side[j], _cosine_at(vpls, j, points, k))
        else:
            w *= by_lobe(vpls, j, points.position[k, 0], points.position[k, 1], points.position[k, 2])
        c = 3 * scene.emitters.light_group[vpls.emitter[j]]
        r, g, b = w * r * vpls.flux[j, 0], w * g * vpls.flux[j, 1], w * b * vpls.flux[j, 2]
        if seen[lane, 0] >= _0:
            shown[k, c] += seen[lane, 0] * r
            shown[k, c + 1] += seen[lane, 1] * g
            shown[k, c + 2] += seen[lane, 2] * b
        if points.sheen[k, 3] != _0 or points.tilt[k] > _0 or points.rough[k] > _0:
            dx, dy, dz = (
                vpls.position[j, 0] - points.position[k, 0],
                vpls.position[j, 1] - points.position[k, 1],
                vpls.position[j, 2] - points.position[k, 2],
            )
            inverse = _1 / max(np.float32(math.sqrt(dx * dx + dy * dy + dz * dz)), np.float32(1e-20))
            dx, dy, dz = inverse * dx, inverse * dy, inverse * dz
            factor = unevenness(points, k, dx, dy, dz)
            r, g, b = factor * r, factor * g, factor * b
            if points.sheen[k, 3] != _0:
                fr, fg, fb = factors(
                    points.sheen[k], points.ns[k, 0], points.ns[k, 1], points.ns[k, 2], points.wo[k, 0], points.wo[k, 1], points.wo[k, 2],
                    dx, dy, dz,
                )  # fmt: skip
                r, g, b = fr * r, fg * g, fb * b
        out[k, c] += r
        out[k, c + 1] += g
        out[k, c + 2] += b


@leaf
def _reflect_light(points, vpls, k, j, lobe, near, seen):
    """What the wide lobe of point k reflects of the irradiance by light j (1/sr), less what is left to other rays, into the row `seen`."""
    dx, dy, dz = (
        vpls.position[j, 0] - points.position[k, 0],
        vpls.position[j, 1] - points.position[k, 1],
        vpls.position[j, 2] - points.position[k, 2],
    )
    distance = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz))
    if not distance > near:
        return
    dx, dy, dz = dx / distance, dy / distance, dz / distance
    cosine = points.ns[k, 0] * dx + points.ns[k, 1] * dy + points.ns[k, 2] * dz
    if not cosine > _0:
        return
    r, g, b, _ = lobe_value(lobe, dx, dy, dz)
    scale = bound(lobe, cosine, r, g, b) / cosine
    seen[0], seen[1], seen[2] = scale * r, scale * g, scale * b


@inlined
def picked(seen):
    """How much likelier than by what it gives unshadowed a light is picked of which a share is `seen`: the variance of what arrives by chance is least
    where rays go by the root of how often they do."""
    return np.float32(math.sqrt(seen + UNSEEN))


@inlined
def looks_of(samples, subsets):
    """At how many subsets of the lights a point of so many shadow rays looks."""
    return min(max(1, samples // PICKS), subsets)


@kernel
def _sample_lights(
    scene, points, vpls, lights, counts, begin, end, first, g_max, cutouts, by_view, near, cell, seed, reflections, out, shown, sights, parts
):  # fmt: skip
    """Adds to the points begin..end-1 the light of `counts` (N,) VPLs each, picked by what they give unshadowed and `picked`; the shadow rays traced.

    Each point looks at a few of the subsets of `lights` (S, 9, K), drawn by a hash.  sights, parts: (N, R), what its rays find, and in
    which of a subset's blocks the light lies.
    """
    size = lights.shape[2]
    owner, light, value = np.empty(WIDTH, np.int64), np.empty(WIDTH, np.int64), np.empty(WIDTH, np.float32)
    return _sample_lights_leaf(
        scene, points, vpls, lights, counts, begin, end, first, g_max, cutouts, by_view, near, cell, seed, reflections, out, shown, sights, parts,
        new_packet(), np.zeros(SURFACE, np.float32), new_registers(scene.materials), np.empty(size, np.float32),
        np.empty(size // BLOCK, np.float32), owner, light, value, np.empty(WIDTH, np.int64), np.zeros(LOBE, np.float32),
        np.empty((WIDTH, 3), np.float32),
    )  # fmt: skip


@leaf
def _sample_lights_leaf(
    scene, points, vpls, lights, counts, begin, end, first, g_max, cutouts, by_view, near, cell, seed, reflections, out, shown, sights, parts,
    packet, surface, rows, f, blocks, owner, light, value, turn, lobe, seen,
):  # fmt: skip
    """`_sample_lights`, its scratch given: it counts no references."""
    subsets = len(lights)
    n = np.int64(0)
    rays = 0
    for k in range(begin, end):
        samples = counts[k]
        looks = looks_of(samples, subsets)
        key = hash_combine(hash_combine(seed, k), first)
        start = uniform(key, 0, 0, 0)
        wide = False
        if reflections > 0:
            set_point_lobe(points, k, lobe)
            wide = is_wide(lobe)
        done = traced = 0
        for look in range(looks):
            picks = (samples - done) // (looks - look)
            done += picks
            # Spread over the subsets, each of which is as likely as the others.
            chosen = np.int64((start + np.float32(look) / np.float32(looks)) * np.float32(subsets)) % subsets
            total = light_up(
                lights, chosen, points.position[k, 0], points.position[k, 1], points.position[k, 2],
                points.ns[k, 0], points.ns[k, 1], points.ns[k, 2], points.ng[k, 0], points.ng[k, 1], points.ng[k, 2], g_max, True, f, blocks,
            )  # fmt: skip
            if not total > _0:
                continue
            each = total * np.float32(subsets) / np.float32(looks * picks)
            block = at = 0
            upto, inside = blocks[0], f[0]
            shift = uniform(key, look, 0, 1)
            for s in range(picks):
                target = (np.float32(s) + shift) / np.float32(picks) * total
                while block + 1 < len(blocks) and upto <= target:
                    block += 1
                    at = block * BLOCK
                    inside = upto + f[at]
                    upto += blocks[block]
                while at + 1 < (block + 1) * BLOCK and inside <= target:
                    at += 1
                    inside += f[at]
                if not f[at] > _0:
                    continue
                owner[n], light[n], value[n], turn[n] = k, chosen + at * subsets, each, traced
                parts[k, traced] = block
                seen[n, 0] = -_1
                if wide and not is_mirror(scene.materials, vpls.side[light[n]] >> 1):
                    _reflect_light(points, vpls, k, light[n], lobe, max(near, cell / lobe[ALPHA]), seen[n])
                traced += 1
                n += 1
                rays += 1
                if n == WIDTH:
                    _trace_lights(
                        scene, packet, rows, surface, cutouts, by_view, points, vpls, owner, light, value, turn, seen, n, out, shown, sights
                    )
                    n = np.int64(0)
    if n > 0:
        _trace_lights(scene, packet, rows, surface, cutouts, by_view, points, vpls, owner, light, value, turn, seen, n, out, shown, sights)
    return rays


def cache_paths(points: int, rays: float) -> int:
    """Of a cache of light for so many points with so many rays each."""
    return max(min(MIN_PATHS, PATHS_A_POINT * points), int(PATHS * min(points, (points * MANY_POINTS) ** 0.5) * rays**0.5))


def pool_growth(points: int) -> int:
    """By which factor the lights for so many points are more than what is asked for: a power of two, so that frames of a sequence agree."""
    return 2 ** max(0, round(0.5 * math.log2(max(points, 1) / MANY_POINTS)))


def lights_wanted(points: int) -> float:
    """How far as many lights as usual must matter to so many points: what all points share is the less of a picture's noise the smaller it is."""
    return min(1.0, points / ALL_LIGHTS)


def _places(probes: Probes) -> np.ndarray:
    """Where the view's light comes from last, (N, 3): of what visible points have met all that reflects anything, and not a dome that only shines, which lies around them."""
    seen = probes.valid[::DEPTH] > 0
    reflects = (probes.albedo[::DEPTH] > 0).any(axis=1) | (probes.carry[::DEPTH] > 0).any(axis=1) | (probes.shine[::DEPTH] > 0).any(axis=1)
    return probes.position[::DEPTH][seen & reflects if (seen & reflects).any() else seen]


def _telling(direct: np.ndarray) -> float:
    """Kish's effective number of the probes that know of the direct light (N, 3 G); 0 where there is none."""
    light = np.einsum("nc->n", direct.astype(np.float64))
    squares = float(light @ light)
    return float(light.sum()) ** 2 / squares if squares > 0 else 0.0


def light_table(vpls: Vpls, subsets: int) -> np.ndarray:
    """The lights by subsets, (S, 10, K) float32; zeros fill whole blocks.

    Rows: position, normal, power times (1 + sharpness) / pi, sharpness, power / pi times 1 + sharpness, of which no more than `BRIGHTEST`
    counts, where the clamp of the geometry term decides, and `picked`.

    Every subset takes each so-manyth light, so that where neighbours follow each other all subsets look alike.
    """
    lights = np.zeros((subsets, 10, -(-len(vpls.bounce) // (subsets * BLOCK)) * BLOCK), np.float32)
    for k in range(subsets):
        part = vpls.take(slice(k, None, subsets))
        power, sharp = part.flux.mean(axis=1) * _INV_PI, _1 + part.sharpness
        rows = [
            part.position.T,
            part.normal.T,
            [sharp * power],
            [part.sharpness],
            [np.minimum(sharp, BRIGHTEST) * power],
            [np.sqrt(part.seen + UNSEEN)],
        ]
        lights[k, :, : len(part.bounce)] = np.vstack(rows)
    return lights


class ImportanceSampling:
    """Virtual lights picked by what they can give, and gather rays into a cache of light.

    samples: shadow rays, gather: gather rays a point.
    """

    def __init__(self, *, samples: int = 32, gather: int = 8, bounces: int = 4, seed: int = 0, threads: int = 0):
        self.samples = samples
        self.gather = gather
        self.bounces = bounces
        self.seed = seed
        self.threads = threads
        self.rays = 0
        self.pairs = 0
        self.lights: np.ndarray | None = None  # until `prepare`
        self.shared: SharedRays | None = None
        self.gathered: GatherRays | None = None
        # What glossy surfaces throw on what is seen, where that is much, by one lobe, and by several, one after the other.
        self.caustics: Caustics | None = None
        self.further: Caustics | None = None
        # Of what `irradiance` has found last, and of `reflected`, the part by photons.
        self.thrown: tuple[np.ndarray, np.ndarray] | None = None

    def cache_light(
        self,
        scene: Transport,
        points: ShadingPoints,
        progress: Progress | None = None,
        *,
        paths: int | None = None,
        texels: int | None = None,
        tracer: Tracer = trace_probes,
        focus: bool = True,
        openings: Openings | None = None,
    ) -> int:
        """Fill the cache of light from `paths` paths that begin at the points (None: as the samples need); the rays traced.

        texels: how many values of a lightmap the points are samples of, None of a picture, where most points are one: several that share a texel count as rays of it.
        tracer: traces them, or knows some of them already.  focus: whether particles are drawn to this view, which then serve no other one.
        openings: by which sun and world shine in, None for none that are known.
        """
        self.scene = scene
        own = paths is None
        if own:
            n = len(points.pixel)
            values = texels or n
            paths = cache_paths(values, (self.samples + self.gather) * n / max(1, values))
            if texels is not None:
                paths = math.ceil(TEXEL_PATHS * paths)
        seed = self.seed ^ 0x51AB5
        probes, rays = tracer(scene, points, paths, seed, self.threads, part(progress, 0.0, 0.4))
        first = probes
        if own and focus:
            telling = _telling(probes.direct[::DEPTH])  # what visible points know
            more = min(MOST_MORE, math.ceil(TELLING / max(1.0, telling)) - 1)
            if more > 0 and telling > 0:
                others, found = tracer(scene, points, more * paths, seed + 1, self.threads, part(progress, 0.4, 0.58))
                probes, rays = Probes.concatenate([probes, others]), rays + found
        if tracer is trace_probes:
            others, found = trace_farther(scene, points, first, seed, self.threads, part(progress, 0.58, 0.6))
            probes, rays = Probes.concatenate([probes, others]), rays + found
        self.relied = FEW_TELL**2 / (FEW_TELL**2 + _telling(probes.direct) ** 2)
        # Where the view's light comes from last: there the particles are wanted.
        self.lit_from = _places(probes)
        self.emitters = focused(scene.emitters, self.lit_from, openings) if focus else scene.emitters
        by_view, probed_by_view = views(scene.materials, scene.material, scene.attributes, self.threads)
        self.builder = CacheBuilder(
            probes, self.bounces + (has_lobes(points) or is_translucent(scene)), self.seed, self.threads, part(progress, 0.6, 0.8),
            gathered=self.bounces, later=min(1.0, RELIABLE * focus_share(self.emitters)), relied=self.relied,
            by_view=by_view, probed_by_view=probed_by_view,
            follow=lobe_chances(scene.materials, scene.material, scene.attributes, self.threads), mirrors=scene.materials.flags & METAL > 0,
        )  # fmt: skip
        self.cache, self.links = self.builder.solve(part(progress, 0.8, 1.0))
        self.probes = probes
        self.near = np.float32(NEAR * self.cache.size)
        self.weighed = False
        self.caustics = None
        return rays

    def shares(self, vpls: Vpls) -> np.ndarray:
        """Part of each VPL's light that is the virtual lights' to carry where G is below the clamp, (M,) float32."""
        if not len(self.cache.share):
            return np.zeros(len(vpls.bounce), np.float32)
        if not self.weighed:
            self._weigh(vpls)
        cell = look_up(self.cache, vpls.position, vpls.surface_normal, vpls.side, self.seed + 2)
        share = self.cache.share[cell] * np.where(vpls.bounce == 1, np.float32(1), self.cache.later)
        # What a glossy surface reflects of the lamps has a direction, which the cache does not know.
        share = np.where(vpls.shine == SHINE, self.cache.shine * self.cache.trust[cell], share)
        # Other light that they reflect has one too: gather rays find it, for a cosine would spread it to where none is.
        return np.where((cell >= 0) & (vpls.shine != THROUGH), share, np.float32(0))

    def _weigh(self, vpls: Vpls) -> None:
        """Leaves light to the gather rays from where lights are too strong, by the first of them."""
        self.weighed = True
        first = vpls.bounce == 1
        if not first.any():
            return
        strength = strengths(vpls.flux[first], float(self.cache.tau), self.lit_from)
        if not strength.max() > NEVER_STRONG:
            return
        lights = vpls.position[first], vpls.surface_normal[first], vpls.side[first]
        size = float(self.cache.size) * GROWTH ** (LEVELS - 1)
        trust = trusted(strength, *lights, self.cache.root, self.cache.centre, self.cache.side, size, self.threads)
        trust += np.float32(self.relied) * (1 - trust)  # what the cache does not know must come from lights, however strong
        self.cache = self.cache._replace(lit=trust[:, None] * self.cache.lit, share=trust * self.cache.share, trust=trust)

    def prepare(
        self,
        scene: Transport,
        points: ShadingPoints,
        count: int,
        progress: Progress | None = None,
        *,
        particles: Particles = trace_by_power,
        turn: int | None = None,
    ) -> tuple[Vpls, dict]:
        """Trace about `count` VPLs for what is left to them: the VPLs and the counts of `vpl_pool`, whose `particles` these are.

        turn: of pictures that are averaged, which then take one batch of particles each, in turn.
        """
        scene = scene._replace(emitters=self.emitters)
        self.shine = self.links.shine
        thrown_on = throwing(self.probes, self.links, self.cache)
        beside = count if turn is None else -(-count // BATCHES)  # so many pictures' photons are averaged, too
        photon_rays = self._trace_photons(scene, points, beside, self.seed + 6 + BATCH_SEED * (turn or 0), part(progress, 0.0, 0.0))
        vpls, counts = vpl_pool(
            scene,
            points,
            count * pool_growth(len(points.pixel)),
            self.bounces,
            clamp_of,
            self.seed if turn is None else self.seed + BATCH_SEED * (turn % BATCHES),
            self.threads,
            progress,
            share=self.shares,
            batches=MOST_BATCHES if turn is None else 1,
            enough=lights_wanted(len(points.pixel)),
            particles=particles,
            kept=KEPT if turn is None else KEPT_IN_TURN,
            beyond=self.probes.position[thrown_on],
        )
        if not len(vpls.bounce) and len(self.cache.share):  # none found their way: gather rays carry all
            self.cache = self.cache._replace(lit=0 * self.cache.lit, share=0 * self.cache.share, trust=0 * self.cache.trust)
        self.g_max = np.float32(min(clamp_of(vpls, points), HUGE))
        order = np.argsort(morton_codes(vpls.position), kind="stable") if len(vpls.bounce) else np.zeros(0, np.int64)
        self.vpls = vpls.take(order)
        self.lights = light_table(self.vpls, max(1, round(len(order) / SUBSET)))
        counts["light"] += photon_rays
        counts["shadow"] += self._redirect(thrown_on)
        self.cache = self._without_lobes()
        return self.vpls, counts

    def _without_lobes(self) -> LightCache:
        """The cache with what gather rays look up of surfaces whose lobes they follow, and what wide lobes look up beside that."""
        cache, links = self.cache, self.links
        chains = np.maximum(0, cache.shone - self.shine) if self.caustics else cache.shone
        if not len(cache.share) or not cache.follow.any():
            return cache._replace(matte=cache.dull, matte_lit=cache.lit, lobes=np.zeros_like(cache.dull), chains=chains)
        followed = cache.follow.any(axis=1)[cache.side, None]
        reflected, shine = followed * links.reflected, followed * self.shine
        if self.caustics:
            reflected, chains = np.maximum(0, reflected - followed * chains), ~followed * chains
        matte, lit = cache.dull - reflected - cache.shine * shine, cache.lit - (cache.shine * cache.trust)[:, None] * shine
        return cache._replace(matte=matte, matte_lit=lit, lobes=reflected + shine, chains=chains)

    def _trace_photons(self, scene: Transport, points: ShadingPoints, count: int, seed: int, progress: Progress | None) -> int:
        """Photons in place of virtual lights and gather rays for what lobes reflect of the lamps, where that is much; the rays traced."""
        share = shine_share(self.probes, self.links, self.cache)
        count *= pool_growth(len(points.pixel))
        self.caustics, self.further, rays = by_lobes(
            scene, points.position, share, wide_part(points), count, self.bounces, seed, self.threads, progress
        )
        if self.caustics:
            cache, links = self.cache, self.links
            lit, dull = np.maximum(0, cache.lit - cache.trust[:, None] * links.shine), np.maximum(0, cache.dull - links.shone)
            self.cache = cache._replace(lit=lit, dull=dull, shine=np.float32(0), chained=np.float32(0), shone=links.shone)
        return rays

    def _redirect(self, first: np.ndarray) -> int:
        """Tells the cache where lobes throw the lamps' light, of the probes `first` (P,); the shadow rays traced."""
        vpls, n = self.vpls.take(self.vpls.shine == SHINE), len(first)
        if not (n and (len(vpls.bounce) or self.caustics)):
            return 0
        points = ShadingPoints.allocate(n)
        points.position[:], points.error[:] = self.probes.position[first], self.probes.error[first]
        points.ng[:] = points.ns[:] = points.wo[:] = self.probes.normal[first]
        irradiance, lights = self.scene.emitters.no_light(n), light_table(vpls, max(1, round(len(vpls.bounce) / SUBSET)))
        cutouts = bool((self.scene.materials.flags & TRANSPARENT).any())
        receivers, sources, counts = Reference(points), Reference(vpls), np.ones(n, np.int32)
        scratch = [np.empty((n, 1), np.uint8) for _ in range(2)]

        def work(begin, end):
            return _sample_lights(
                self.scene, receivers, sources, lights, counts, begin, end, 0, self.g_max, cutouts, self.cache.by_view, self.near, self.cache.size,
                np.uint32(self.seed + 5), 0, irradiance, irradiance, *scratch,
            )  # fmt: skip

        rays = sum(run_chunks(work, n, CHUNK, self.threads)) if lights.size else 0
        if self.caustics:
            rays += add_caustics(self.scene, self.caustics, points, self.seed + 7, self.threads, irradiance)
        if self.further:
            rays += add_caustics(self.scene, self.further, points, self.seed + 9, self.threads, irradiance)
        self.cache, links = redirected(
            self.builder, self.cache, self.links, first, irradiance, self.g_max, self.threads,
            by_photons=self.caustics is not None,
        )  # fmt: skip
        self.links = links._replace(shine=links.shine[:0])  # once is enough
        self.pairs += n * lights.shape[2]
        return rays

    def irradiance(
        self, points: ShadingPoints, progress: Progress | None = None, *, first: int = 0, by_share: bool = False, reflections: int = 0
    ) -> np.ndarray:
        """Indirect irradiance at N points, (N, 3 G) float32, W/m^2: three columns for each of G light groups.

        What the same rays find for wide lobes (`wide_lobes`) is then in `reflected`, (N, 3 G) float32 W/m^2/sr, and `shared` says what is left
        to rays from the lobes.

        by_share: points that are a small part of what their pixel shows get fewer rays.  reflections: most rays from the lobes, as `glossy.reflect`
            has them, 0 where these are not wanted.
        """
        n = len(points.pixel)
        out = self.scene.emitters.no_light(n)
        cutouts = bool((self.scene.materials.flags & TRANSPARENT).any())
        reflections = reflections if len(self.cache.radiosity) > self.bounces else 0
        share = shares(points, WIDE_ALPHA**0.5 if reflections else None) if by_share else np.ones(n, np.float32)
        gather, samples = (np.ceil(most * np.minimum(1, WHOLE * share)).astype(np.int32) for most in (self.gather, self.samples))
        gather, samples = (np.maximum(counts, min(1, most)) for counts, most in ((gather, self.gather), (samples, self.samples)))
        lights = bool(self.lights.size and self.samples)
        shown = np.zeros_like(out) if reflections else out[:0]
        self.reflected, self.shared = shown, SharedRays(gather, lights, self.g_max) if reflections else None

        gathered = np.zeros(n, np.float32)
        cache, receivers, vpls = (Reference(table) for table in (self.cache, points, self.vpls))
        met = np.zeros((n, self.gather), np.uint8)
        sights, parts = np.zeros((n, self.samples), np.uint8), np.empty((n, self.samples), np.uint8)

        def work(begin, end):
            rays = _gather(
                self.scene, cache, receivers, gather, begin, end, first, self.g_max, self.near, self.bounces,
                np.uint32(self.seed + 3), reflections, lights, out, shown, met,
            )  # fmt: skip
            gathered[begin:end] = np.einsum("nc->n", out[begin:end]) * np.float32(1 / 3)
            if lights:
                rays += _sample_lights(
                    self.scene, receivers, vpls, self.lights, samples, begin, end, first, self.g_max, cutouts, self.cache.by_view, self.near, self.cache.size,
                    np.uint32(self.seed + 4), reflections, out, shown, sights, parts,
                )  # fmt: skip
            return rays

        self.rays += sum(run_chunks(work, n, CHUNK, self.threads, progress))
        self.thrown = None
        if self.caustics:
            self.thrown = np.zeros_like(out), np.zeros_like(shown)
            self.rays += add_caustics(
                self.scene, self.caustics, points, self.seed + 8 + first, self.threads, *self.thrown, self.near, self.cache.size
            )
            if self.further:
                self.rays += add_caustics(self.scene, self.further, points, self.seed + 10 + first, self.threads, self.thrown[0])
            out += self.thrown[0]
            shown += self.thrown[1]
        self.found = sights, parts, gathered
        self.gathered = GatherRays(gather, met, np.arange(n, dtype=np.int32), self.seed + 3, first)
        looks = np.minimum(np.maximum(1, samples // PICKS), len(self.lights))
        self.pairs += int(looks.sum()) * self.lights.shape[2]
        return out

    def foreseen(self, points: ShadingPoints, shape: tuple[int, int], wanted: ShadingPoints | None = None) -> np.ndarray:
        """About what `irradiance` has just found of the points of a picture of `shape`, (N,) without noise: see the module `foreseen`.

        wanted: N other points of the picture, of which it is foreseen then.
        """
        wanted = points if wanted is None else wanted
        self.pairs += len(wanted.pixel) * self.lights.shape[2]
        return foreseen(points, shape, self.lights, self.g_max, *self.found, self.threads, wanted=wanted)

    def without_sparks(self, points: ShadingPoints, irradiance: np.ndarray, foreseen: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """The irradiance (N, 3 G) that was found last without sparks, as what is `foreseen` (N,) of it tells; `reflected` is without those by photons."""
        if self.thrown:
            light, shown = spread_thrown(points, *self.thrown, foreseen, shape)
            irradiance = irradiance + (light - self.thrown[0])
            self.reflected += shown - self.thrown[1]
            self.thrown = light, shown
        return spread_sparks(points, irradiance, foreseen, shape)
