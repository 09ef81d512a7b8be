"""Light of all VPLs at every point: by what the area lights' maps show of them, set right by a few shadow rays that neighbours share.

The paper blurs light (Dong et al. 2009, Section 6): each pixel's is that of its share of the VPLs, and what its neighbours add was
meant for other places.  Here the light that VPLs would give if nothing were in their way is each point's own, and so is what the
soft shadow maps take from it (a control variate).  What both have wrong is estimated by shadow rays to VPLs that the pixels of a block
draw together, one stratified sample of a distribution by light and doubt; the mean over a point's neighbours on its surface is the part of its
unshadowed light that is still missing.

Light itself is interpolated between every fourth pixel of smooth surfaces whose light hardly differs.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..particles import Vpls, is_ahead
from ..rays.offsets import shadow_segment
from ..rays.packet import DIR_X, DIR_Y, DIR_Z, OCCLUDED, ORG_X, ORG_Y, ORG_Z, T_FAR, T_NEAR, WIDTH, new_packet, set_ray
from ..rays.trace import CUTOUT, OPAQUE, occluded_packet
from ..scene import DIFFUSE
from ..shadowmaps.convolution import SoftShadowMaps, soft_visibility
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..surfaces.visibility import OUTSIDE, transmittance1
from ..threads import Progress, part, run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints
from .interleaving import ALPHA, Pixels, alike, by_place

LEVELS = 255  # of visibility by maps
BLOCK = 8  # pixels along the edge of a piece of work, and of what is filled evenly by draws
DRAWN = 256  # VPLs of interleave x interleave pixels
STEP = 4  # pixels between the points whose light is computed everywhere
COARSE_DRAWN = 12  # VPLs of such a point
MAP_STEP = 16  # pixels between the points that look at maps
WINDOW = 3  # points on each side at most that share rays
LEAST_DOUBT = 0.35  # of a VAL, against 0.5 of one that is half seen: maps err
LEAST_WEIGHT = np.float32(1e-3)  # of what one draw stands for: bounds the weight of a light that rounding alone has drawn
SURE = 0.02  # of the unshadowed light: differences that are always taken for noise
ALIKE = 1.5  # variances by which two points' findings differ that no longer share rays
STRATIFIED = 0.25  # of the variance of independent rays: that of a whole window's
# Variances by which findings about a point are off its window's mean: at most to take that, at least for the shaped one.
EVEN, SHAPED = 0.4, 1.0
CUT, CUT_OFF = 0.1, 0.3  # share of a window that lies on other surfaces: the same
ENOUGH = 64  # rays of a window of which none passes: it is dark
NOISE = 0.2  # of a point's light: error to expect with which no more rays are wanted
MOST = 32  # rays that a point may want in addition
FLOOR = 0.1  # of the mean light: errors of it matter everywhere
FLAT = 0.998  # least cosine of the normals of points whose light is interpolated
SMOOTH = 0.15  # of the light: most that it may differ between them
BLOCKS = 32  # in one piece of work
POINTS = 1024  # the same
COARSE_POINTS = 256  # the same, of those that look at maps
PART = 32  # lights whose importance is added up before one is drawn
COARSE, FINE, MORE = range(3)  # stages
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)
_THIRD = np.float32(1 / 3)
_TINY = np.float32(1e-15)


class Lights(NamedTuple):
    """N VPLs, VAL by VAL.

    columns: (11, L) float32, L >= N a multiple of PART: positions, normals, flux / pi (rgb) and its mean, error of the position; zeros for none.
    first: (M + 1,) int32, borders of the VALs.  bounds: (M, 4) float32, a ball about each one's VPLs (m).  vpls: the same VPLs.
    maps, front, back: shadow maps, and the numbers of those of each VAL's half-spaces; back is -1 where no light goes.
    """

    columns: np.ndarray
    first: np.ndarray
    bounds: np.ndarray
    vpls: Vpls
    maps: SoftShadowMaps
    front: np.ndarray
    back: np.ndarray


class Found(NamedTuple):
    """What N points, by pixel, know.

    clear, mapped: (N, 3) light of all VPLs if nothing were in the way, and as the maps show it.  rest: (N, 3) what rays add to the latter.
    rays: (N,) float32, how many of them.  squares: (N,) float32, of what each adds, channels' mean.  open: (N,) bool, whether one passed.
    """

    clear: np.ndarray
    mapped: np.ndarray
    rest: np.ndarray
    rays: np.ndarray
    squares: np.ndarray
    open: np.ndarray


@inlined
def area_visibility(maps, front, back, x, y, z, sums):
    """What a point sees of a VAL: by the map of the half-space that it lies in."""
    if back >= 0:
        ahead = _0
        for c, p in enumerate((x, y, z)):
            ahead += (p - maps.origin[front, c]) * maps.frame[front, 2, c]
        if ahead < _0:
            return soft_visibility(maps, back, x, y, z, sums)
    return soft_visibility(maps, front, x, y, z, sums)


@kernel
def _terms(lights, px, py, pz, sx, sy, sz, gx, gy, gz, g_max, term):
    """Clamped geometry terms of all lights at a point into term (L,)."""
    x, y, z, nx, ny, nz = lights[0], lights[1], lights[2], lights[3], lights[4], lights[5]
    for j in range(len(term)):
        dx, dy, dz = x[j] - px, y[j] - py, z[j] - pz
        r2 = max(dx * dx + dy * dy + dz * dz, np.float32(1e-30))
        at_point = max(_0, sx * dx + sy * dy + sz * dz)
        at_light = max(_0, -(nx[j] * dx + ny[j] * dy + nz[j] * dz))
        term[j] = min(at_point * at_light / (r2 * r2), g_max) if gx * dx + gy * dy + gz * dz > _0 else _0


@kernel
def _weigh(lights, term, visible, importance):
    """The importance of each light into importance (L,); all light, unshadowed and as far as it is visible."""
    r, g, b, mean = lights[6], lights[7], lights[8], lights[9]
    red = green = blue = seen_red = seen_green = seen_blue = _0
    for j in range(len(term)):
        t, v = term[j], visible[j]
        tr, tg, tb = t * r[j], t * g[j], t * b[j]
        red += tr
        green += tg
        blue += tb
        seen_red += v * tr
        seen_green += v * tg
        seen_blue += v * tb
        importance[j] = t * mean[j] * np.sqrt(max(v * (_1 - v), np.float32(LEAST_DOUBT * LEAST_DOUBT)))
    return red, green, blue, seen_red, seen_green, seen_blue


@kernel
def _part_sums(importance, parts):
    """Sums of PART neighbours into parts (L / PART,); that of all."""
    total = _0
    for p in range(len(parts)):
        part = _0
        for j in range(PART):
            part += importance[PART * p + j]
        parts[p] = part
        total += part
    return total


@kernel
def _draw(importance, parts, total, u, chosen, weight):
    """Lights drawn by importance, one in each of len(chosen) strata, at u (0 to 1) of it; the weights of what each gives.

    One that is drawn more than once keeps the weights of all in the first, 0 in the others, and is traced once.
    """
    count = len(chosen)
    step = total / np.float32(count)
    p, j = 0, 0
    before, within = _0, _0  # of the parts before p, and of p's lights before j
    last = -1
    for i in range(count):
        wanted = (np.float32(i) + u) * step
        while p + 1 < len(parts) and before + parts[p] <= wanted:
            before += parts[p]
            p += 1
            j, within = 0, _0
        while j + 1 < PART and before + within + importance[PART * p + j] <= wanted:
            within += importance[PART * p + j]
            j += 1
        light = PART * p + j
        chosen[i] = light
        w = step / max(importance[light], LEAST_WEIGHT * step)
        weight[i] = w
        if i > 0 and light == chosen[last]:
            weight[last] += w
            weight[i] = _0
        else:
            last = i


@inlined
def _rank(x, y):
    """Place, 0 to 63, of a pixel in the order in which a block of 8 x 8 is filled evenly (Bayer 1973)."""
    rank = 0
    for bit in range(3):
        a, b = (x >> bit) & 1, (y >> bit) & 1
        rank = 4 * rank + 2 * (a ^ b) + b
    return rank


@kernel
def _shadow(scene, packet, rows, surface, count, cutouts, through):
    """What the rays in lanes 0..count-1, which go any way, let through, into through (16, 3)."""
    occluded_packet(scene.rays, OPAQUE, packet, count)
    f = packet.f
    waiting = False
    for lane in range(count):
        open_ = _0 if f[T_FAR * WIDTH + lane] == OCCLUDED else _1
        through[lane, 0] = through[lane, 1] = through[lane, 2] = open_
        waiting |= open_ > _0
    if not cutouts or not waiting:
        return
    occluded_packet(scene.rays, CUTOUT, packet, count)
    for lane in range(count):
        if through[lane, 0] > _0 and f[T_FAR * WIDTH + lane] == OCCLUDED:
            through[lane, 0], through[lane, 1], through[lane, 2], _ = transmittance1(
                scene, packet, rows, surface,
                f[ORG_X * WIDTH + lane], f[ORG_Y * WIDTH + lane], f[ORG_Z * WIDTH + lane],
                f[DIR_X * WIDTH + lane], f[DIR_Y * WIDTH + lane], f[DIR_Z * WIDTH + lane],
                f[T_NEAR * WIDTH + lane], _1, DIFFUSE, DIFFUSE, OUTSIDE, False,
            )  # fmt: skip


@kernel
def _trace(scene, packet, rows, surface, cutouts, through, points, pixels, lights, drawn, filled, found):
    """What rays find of what up to 16 points have drawn, stratum by stratum, beyond what maps show, into `found`; the rays traced."""
    columns = lights.columns
    places, light_of, weight_of, seen_of = drawn
    lane_of = np.empty(WIDTH, np.int64)
    rays = 0
    for s in range(light_of.shape[0]):
        lanes = 0
        for q in range(filled):
            if not weight_of[s, q] > _0:
                continue
            i, j = pixels.order[places[q]], light_of[s, q]
            ox, oy, oz, dx, dy, dz = shadow_segment(
                points.position[i, 0], points.position[i, 1], points.position[i, 2],
                points.ng[i, 0], points.ng[i, 1], points.ng[i, 2], points.error[i],
                columns[0, j], columns[1, j], columns[2, j], columns[3, j], columns[4, j], columns[5, j], columns[10, j],
            )  # fmt: skip
            set_ray(packet, lanes, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE)
            lane_of[lanes] = q
            lanes += 1
        if lanes == 0:
            continue
        _shadow(scene, packet, rows, surface, lanes, cutouts, through)
        rays += lanes
        for lane in range(lanes):
            q = lane_of[lane]
            place, j, w, v = places[q], light_of[s, q], weight_of[s, q], seen_of[s, q]
            at = points.position[pixels.order[place]]
            if cutouts and not is_ahead(lights.vpls, j, at[0], at[1], at[2]):
                through[lane] = _0
            found.open[place] |= max(through[lane, 0], through[lane, 1], through[lane, 2]) > _0
            for c in range(3):
                found.rest[place, c] += w * columns[6 + c, j] * (through[lane, c] - v)
            off = w * columns[9, j] * ((through[lane, 0] + through[lane, 1] + through[lane, 2]) * _THIRD - v)
            found.squares[place] += off * off
    return rays


@kernel
def _visible(pixels, table, codes, number, first_light, place, x, y, reach2, of_val, visible):
    """What maps show of each light to a point of pixel (x, y): a bilinear mean of what they show to the points about it, into visible (L,).

    codes: (C, M) uint8, known to the points that look at maps.  number: (N,) int32, which one of them each is.
    """
    width, first = pixels.width, pixels.first
    last = len(first) - 1
    left, top = x // MAP_STEP * MAP_STEP, y // MAP_STEP * MAP_STEP
    total = _0
    of_val[:] = _0
    for others in range(2):
        for corner in range(4):
            u, v = left + (corner & 1) * MAP_STEP, top + (corner >> 1) * MAP_STEP
            across = np.float32(x - left) * np.float32(1 / MAP_STEP)
            down = np.float32(y - top) * np.float32(1 / MAP_STEP)
            w = (across if corner & 1 else _1 - across) * (down if corner >> 1 else _1 - down)
            at = v * width + u
            if w == _0 or u >= width or at >= last:
                continue
            for k in range(first[at], first[at + 1]):
                if others or alike(table, place, k, reach2):
                    total += w
                    known = codes[number[k]]
                    for m in range(len(of_val)):
                        of_val[m] += w * np.float32(known[m])
                    break
        if total > _0:
            break
    scale = np.float32(1 / LEVELS) / total if total > _0 else _0
    for m in range(len(of_val)):
        visible[first_light[m] : first_light[m + 1]] = of_val[m] * scale if total > _0 else _HALF


@kernel
def _smooth(points, pixels, table, place, x, y, reach2, out):
    """Whether the light at a point of pixel (x, y) may be taken from the four points about it whose light is known; sets it if so."""
    width, first = pixels.width, pixels.first
    last = len(first) - 1
    i = pixels.order[place]
    left, top = x // STEP * STEP, y // STEP * STEP
    red = green = blue = total = _0
    least, most = np.float32(np.inf), _0
    for corner in range(4):
        u, v = left + (corner & 1) * STEP, top + (corner >> 1) * STEP
        across = np.float32(x - left) * np.float32(1 / STEP)
        down = np.float32(y - top) * np.float32(1 / STEP)
        w = (across if corner & 1 else _1 - across) * (down if corner >> 1 else _1 - down)
        at = v * width + u
        if u >= width or at >= last:
            return False
        found = False
        for place_k in range(first[at], first[at + 1]):
            k = pixels.order[place_k]
            bend = points.ns[i, 0] * points.ns[k, 0] + points.ns[i, 1] * points.ns[k, 1] + points.ns[i, 2] * points.ns[k, 2]
            if bend > np.float32(FLAT) and alike(table, place, place_k, reach2):
                red, green, blue = red + w * out[k, 0], green + w * out[k, 1], blue + w * out[k, 2]
                light = out[k, 0] + out[k, 1] + out[k, 2]
                least, most, total = min(least, light), max(most, light), total + w * light
                found = True
                break
        if not found:
            return False
    if most - least > np.float32(SMOOTH) * total:
        return False
    out[i, 0], out[i, 1], out[i, 2] = red, green, blue
    return True


@kernel
def _map_codes(points, pixels, lights, at, begin, end, codes):
    """What the maps of all VALs that they may face show to the points at places at[begin:end], into codes (C, M)."""
    bounds = lights.bounds
    sums = np.empty(lights.maps.tables.shape[3], np.float32)
    for m in range(len(lights.front)):  # map by map, for the processor's cache
        for c in range(begin, end):
            i = pixels.order[at[c]]
            x, y, z = points.position[i, 0], points.position[i, 1], points.position[i, 2]
            ahead = points.ns[i, 0] * (bounds[m, 0] - x) + points.ns[i, 1] * (bounds[m, 1] - y) + points.ns[i, 2] * (bounds[m, 2] - z)
            seen = _0
            if ahead + bounds[m, 3] > _0:
                seen = area_visibility(lights.maps, lights.front[m], lights.back[m], x, y, z, sums)
            codes[c, m] = np.uint8(seen * np.float32(LEVELS) + _HALF)


@kernel
def _look(scene, points, pixels, table, lights, number, begin, end, reach2, g_max, most, seed, cutouts, stage, codes, wanted, found, out):
    """Light and rays of the points of the blocks begin..end-1; the rays traced.

    stage: COARSE: of every STEP-th point.  FINE: of the others, or their light itself where it is smooth.  MORE: of those that want more.
    most: rays of one point, all but those of MORE have as many.
    """
    width, first = pixels.width, pixels.first
    last = len(first) - 1
    across = (width - 1) // BLOCK + 1
    count = lights.columns.shape[1]
    term, visible, importance = np.empty(count, np.float32), np.zeros(count, np.float32), np.empty(count, np.float32)
    parts, of_val = np.empty(count // PART, np.float32), np.empty(len(lights.front), np.float32)
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    rows = new_registers(scene.materials)
    through = np.ones((WIDTH, 3), np.float32)
    chosen, weight = np.empty(most, np.int64), np.empty(most, np.float32)
    places = np.empty(WIDTH, np.int64)
    light_of, weight_of, seen_of = (
        np.empty((most, WIDTH), np.int64),
        np.empty((most, WIDTH), np.float32),
        np.empty((most, WIDTH), np.float32),
    )
    drawn = (places, light_of, weight_of, seen_of)
    filled = rays = 0
    step = STEP if stage == COARSE else 1
    for block in range(begin, end):
        left, top = block % across * BLOCK, block // across * BLOCK
        for y in range(top, top + BLOCK, step):
            for x in range(left, min(left + BLOCK, width), step):
                if y * width + x >= last or (stage == FINE and x % STEP == 0 and y % STEP == 0):
                    continue
                u = (np.float32((_rank(x // step % BLOCK, y // step % BLOCK) + seed) % (BLOCK * BLOCK)) + _HALF) * np.float32(
                    1 / (BLOCK * BLOCK)
                )
                for place in range(first[y * width + x], first[y * width + x + 1]):
                    i = pixels.order[place]
                    if stage == FINE and _smooth(points, pixels, table, place, x, y, reach2, out):
                        continue
                    mine = np.int64(wanted[place]) if stage == MORE else most
                    if mine == 0:
                        continue
                    _terms(
                        lights.columns, points.position[i, 0], points.position[i, 1], points.position[i, 2],
                        points.ns[i, 0], points.ns[i, 1], points.ns[i, 2], points.ng[i, 0], points.ng[i, 1], points.ng[i, 2], g_max, term,
                    )  # fmt: skip
                    _visible(pixels, table, codes, number, lights.first, place, x, y, reach2, of_val, visible)
                    red, green, blue, seen_red, seen_green, seen_blue = _weigh(lights.columns, term, visible, importance)
                    share = _1
                    if stage == MORE:
                        share = np.float32(mine) / (found.rays[place] + np.float32(mine))
                        found.rest[place] *= _1 - share
                        found.squares[place] *= (_1 - share) * (_1 - share)
                        found.rays[place] += np.float32(mine)
                    else:
                        found.clear[place, 0], found.clear[place, 1], found.clear[place, 2] = red, green, blue
                        found.mapped[place, 0], found.mapped[place, 1], found.mapped[place, 2] = seen_red, seen_green, seen_blue
                        found.rest[place] = _0
                        found.squares[place] = _0
                        found.open[place] = False
                        found.rays[place] = np.float32(mine)
                    total = _part_sums(importance, parts)
                    if not total > _0:
                        continue
                    _draw(importance, parts, total, u, chosen[:mine], weight)
                    for s in range(mine):
                        j = chosen[s]
                        light_of[s, filled], weight_of[s, filled], seen_of[s, filled] = j, weight[s] * term[j] * share, visible[j]
                    weight_of[mine:, filled] = _0
                    places[filled] = place
                    filled += 1
                    if filled == WIDTH:
                        rays += _trace(scene, packet, rows, surface, cutouts, through, points, pixels, lights, drawn, filled, found)
                        filled = 0
    rays += _trace(scene, packet, rows, surface, cutouts, through, points, pixels, lights, drawn, filled, found)
    return rays


@inlined
def _is_drawn(pixels, found, place, x, y, step):
    """Whether a point's light is to be found in windows of so many pixels: coarse ones in fine windows only beside others that have drawn."""
    if not found.rays[place] > _0:
        return False
    if x % STEP != 0 or y % STEP != 0:
        return step == 1
    if step == STEP:
        return True
    width, first = pixels.width, pixels.first
    last = len(first) - 1
    for v in range(max(y - 1, 0), y + 2):
        for u in range(max(x - 1, 0), min(x + 2, width)):
            if (u != x or v != y) and v * width + u < last:
                for k in range(first[v * width + u], first[v * width + u + 1]):
                    if found.rays[k] > _0:
                        return True
    return False


@kernel
def _guide(points, pixels, table, found, begin, end, reach2, step, guide):
    """What rays add to the points at places begin..end-1, of their unshadowed light, by windows of 3 x 3, and its variance, into guide (N, 2)."""
    width, first = pixels.width, pixels.first
    last = len(first) - 1
    for place in range(begin, end):
        i = pixels.order[place]
        x, y = points.pixel[i] % width, points.pixel[i] // width
        if not _is_drawn(pixels, found, place, x, y, step):
            continue
        rest = clear = squares = rays = _0
        for dv in range(-1, 2):
            v = y + dv * step
            if v < 0 or v * width >= last:
                continue
            for du in range(-1, 2):
                u = x + du * step
                if u < 0 or u >= width or v * width + u >= last:
                    continue
                for k in range(first[v * width + u], first[v * width + u + 1]):
                    if found.rays[k] > _0 and (k == place or alike(table, place, k, reach2)):
                        w = found.rays[k] * (_HALF if du != 0 else _1) * (_HALF if dv != 0 else _1)
                        rest += w * (found.rest[k, 0] + found.rest[k, 1] + found.rest[k, 2]) * _THIRD
                        clear += w * (found.clear[k, 0] + found.clear[k, 1] + found.clear[k, 2]) * _THIRD
                        squares += w * w * found.squares[k]
                        rays += w
        clear = max(clear, _TINY)
        guide[place, 0] = rest / clear
        guide[place, 1] = squares / (clear * clear) + _1 / (rays * rays) + np.float32(SURE * SURE)


@inlined
def _lit(found, place, c, rest, clear):
    """Light of a point in one channel, by what rays add to its unshadowed light, between none and all of that."""
    own = found.clear[place, c]
    return min(max(found.mapped[place, c] + own * rest / max(clear, _TINY), _0), own)


@kernel
def _share(points, pixels, table, found, guide, begin, end, reach2, reach, step, again, wanted, even, shaped):
    """Light at the points at places begin..end-1 that have drawn, with the rays of those alike in windows of 2 `reach` `step` pixels.

    Of all of them into even (N, 6): light; by how many of its variances the guide is off; the light's variance; the share of the window on other surfaces.
    Of those whose guides agree into shaped (N, 4): light and its variance.  Variances are of parts of the unshadowed light.
    again: only of those that wanted more rays.
    """
    width, first = pixels.width, pixels.first
    last = len(first) - 1
    for place in range(begin, end):
        i = pixels.order[place]
        x, y = points.pixel[i] % width, points.pixel[i] // width
        if (again and wanted[place] == 0) or not _is_drawn(pixels, found, place, x, y, step):
            continue
        others = same = _0
        red = green = blue = clear_red = clear_green = clear_blue = all_squares = all_rays = _0
        closed = True
        rest = clear = squares = rays = _0
        for dv in range(-reach, reach + 1):
            v = y + dv * step
            if v < 0 or v * width >= last:
                continue
            wy = _HALF if abs(dv) == reach else _1
            for du in range(-reach, reach + 1):
                u = x + du * step
                if u < 0 or u >= width or v * width + u >= last:
                    continue
                wx = _HALF if abs(du) == reach else _1
                for k in range(first[v * width + u], first[v * width + u + 1]):
                    if not found.rays[k] > _0:
                        continue
                    if not (k == place or alike(table, place, k, reach2)):
                        others += wx * wy
                        continue
                    same += wx * wy
                    closed &= not found.open[k]
                    w = wx * wy
                    r, g, b = found.rest[k, 0], found.rest[k, 1], found.rest[k, 2]
                    cr, cg, cb = found.clear[k, 0], found.clear[k, 1], found.clear[k, 2]
                    red, green, blue = red + w * r, green + w * g, blue + w * b
                    clear_red, clear_green, clear_blue = clear_red + w * cr, clear_green + w * cg, clear_blue + w * cb
                    all_squares, all_rays = all_squares + w * w * found.squares[k], all_rays + w * found.rays[k]
                    off = guide[k, 0] - guide[place, 0]
                    like = _1 - off * off / (np.float32(ALIKE) * (guide[k, 1] + guide[place, 1]))
                    if like > _0:
                        w *= like * found.rays[k]
                        rest, clear = rest + w * (r + g + b), clear + w * (cr + cg + cb)
                        squares, rays = squares + w * w * found.squares[k], rays + w
        light = even[place]
        light[0], light[1], light[2] = (
            _lit(found, place, 0, red, clear_red), _lit(found, place, 1, green, clear_green), _lit(found, place, 2, blue, clear_blue)
        )  # fmt: skip
        mean = max((clear_red + clear_green + clear_blue) * _THIRD, _TINY)
        off = guide[place, 0] - (red + green + blue) * _THIRD / mean
        light[3] = off * off / guide[place, 1]
        light[4] = np.float32(STRATIFIED) * all_squares / (mean * mean) + _1 / (all_rays * all_rays)
        if not again:
            light[5] = others / (others + same)
        # Its colour is that of the whole window: few rays tell brightness well enough, but not colour.
        own, mapped = found.clear[place], found.mapped[place]
        own_sum = own[0] + own[1] + own[2]
        wanted_sum = min(max(mapped[0] + mapped[1] + mapped[2] + own_sum * rest / max(clear, _TINY), _0), own_sum)
        sum_ = light[0] + light[1] + light[2]
        for c in range(3):
            shaped[place, c] = wanted_sum * (light[c] / sum_ if sum_ > np.float32(0.01) * own_sum else own[c] / max(own_sum, _TINY))
        mean = max(clear * _THIRD, _TINY)
        shaped[place, 3] = squares / (mean * mean) + _1 / (rays * rays)
        if closed:
            # What maps leak does not cancel in so few draws; many rays of which none passed say more.
            left = max(_0, _1 - all_rays * np.float32(1 / ENOUGH))
            for c in range(3):
                light[c] *= left
                shaped[place, c] *= left


@kernel
def _settle(points, pixels, table, found, even, shaped, begin, end, reach2, step, floor, again, wanted, out):
    """Light of the points at places begin..end-1 into out (N, 3): the even mean where nothing is unlike it, else the shaped one.

    How many rays they want beyond what they have, into wanted (N,).
    """
    width, first = pixels.width, pixels.first
    last = len(first) - 1
    for place in range(begin, end):
        i = pixels.order[place]
        x, y = points.pixel[i] % width, points.pixel[i] // width
        if (again and wanted[place] == 0) or not _is_drawn(pixels, found, place, x, y, step):
            continue
        if not again:
            off = count = _0
            around = 2 if step > 1 else 1
            for dv in range(-around, around + 1):
                v = y + 2 * dv * step
                if v < 0 or v * width >= last:
                    continue
                for du in range(-around, around + 1):
                    u = x + 2 * du * step
                    if u < 0 or u >= width or v * width + u >= last:
                        continue
                    for k in range(first[v * width + u], first[v * width + u + 1]):
                        if k == place or (_is_drawn(pixels, found, k, u, v, step) and alike(table, place, k, reach2)):
                            off, count = off + even[k, 3], count + _1
            t = (off / count - np.float32(EVEN)) / np.float32(SHAPED - EVEN)
            if step == 1:
                t = max(t, (even[place, 5] - np.float32(CUT)) / np.float32(CUT_OFF - CUT))
            even[place, 5] = min(max(t, _0), _1)
        t = even[place, 5]
        for c in range(3):
            out[i, c] = even[place, c] + t * (shaped[place, c] - even[place, c])
        if step == 1 and not again:
            # The error to expect, of the light.
            variance = even[place, 4] + t * (shaped[place, 3] - even[place, 4])
            clear = found.clear[place, 0] + found.clear[place, 1] + found.clear[place, 2]
            error = np.sqrt(variance) * clear / (out[i, 0] + out[i, 1] + out[i, 2] + floor)
            times = error * error * np.float32(1 / (NOISE * NOISE)) - _1
            wanted[place] = np.uint8(min(times * found.rays[place], np.float32(MOST))) if times > _0 else np.uint8(0)


def shared_lights(vpls: Vpls, val: np.ndarray, maps: SoftShadowMaps, front: np.ndarray, back: np.ndarray) -> Lights:
    """`Lights` of N VPLs that are in the order of their VALs, val (N,); front, back: (M,) int32, as in `Lights`."""
    n = len(val)
    columns = np.zeros((11, -(-n // PART) * PART), np.float32)
    columns[0:3, :n], columns[3:6, :n], columns[6:9, :n] = vpls.position.T, vpls.normal.T, vpls.flux.T * np.float32(1 / np.pi)
    columns[9], columns[10, :n] = columns[6:9].mean(axis=0), vpls.error
    first = np.searchsorted(val, np.arange(len(front) + 1)).astype(np.int32)
    bounds = np.zeros((len(front), 4), np.float32)
    for m, (begin, end) in enumerate(itertools.pairwise(first)):
        if end > begin:
            bounds[m, :3] = vpls.position[begin:end].mean(axis=0)
            bounds[m, 3] = np.linalg.norm(vpls.position[begin:end] - bounds[m, :3], axis=1).max()
    return Lights(columns, first, bounds, vpls, maps, front, back)


def gather(
    scene: Transport,
    points: ShadingPoints,
    pixels: Pixels,
    lights: Lights,
    extent: float,
    g_max: float,
    cutouts: bool,
    seed: int = 0,
    threads: int = 0,
    progress: Progress | None = None,
    timed: Callable[[str], AbstractContextManager] = nullcontext,
) -> tuple[np.ndarray, int]:
    """Light of all VPLs (N, 3) at N points, and the shadow rays traced.

    extent: of the scene (m).  g_max: clamp.  timed: gets the names of stages, "indirect light" and "blur".
    """
    n = len(points.pixel)
    out = np.zeros((n, 3), np.float32)
    table, reach2 = by_place(points, pixels), np.float32((ALPHA * extent) ** 2)
    pixel = points.pixel[pixels.order]
    x, y = pixel % pixels.width, pixel // pixels.width
    looking = (x % MAP_STEP == 0) & (y % MAP_STEP == 0)
    at, number = np.flatnonzero(looking), np.cumsum(looking, dtype=np.int32) - np.int32(1)
    codes = np.empty((len(at), len(lights.front)), np.uint8)
    found = Found(
        *(np.empty((n, 3), np.float32) for _ in range(3)), np.zeros(n, np.float32), np.empty(n, np.float32), np.zeros(n, np.bool_)
    )
    guide, even, shaped = np.empty((n, 2), np.float32), np.zeros((n, 6), np.float32), np.empty((n, 4), np.float32)
    wanted = np.zeros(n, np.uint8)
    rows = (len(pixels.first) - 2) // pixels.width + 1
    blocks = -(-pixels.width // BLOCK) * -(-rows // BLOCK)
    g_max, seed, floor = np.float32(g_max), seed % BLOCK**2, _0
    rays = 0
    with timed("indirect light"):
        run_chunks(lambda b, e: _map_codes(points, pixels, lights, at, b, e, codes), len(at), COARSE_POINTS, threads)
    for stage in (COARSE, FINE, MORE):
        again = stage == MORE
        if again and not wanted.any():
            break
        most = (COARSE_DRAWN, max(DRAWN // pixels.interleave**2, 1), MOST)[stage]
        step, window = (STEP, WINDOW) if stage == COARSE else (1, min(max(pixels.interleave // 2, 1), WINDOW))

        def look(begin, end, stage=stage, most=most):
            return _look(
                scene, points, pixels, table, lights, number, begin, end, reach2, g_max, most, seed, cutouts, stage, codes, wanted, found, out
            )  # fmt: skip

        def guides(begin, end, step=step):
            _guide(points, pixels, table, found, begin, end, reach2, step, guide)

        def share(begin, end, step=step, window=window, again=again):
            _share(points, pixels, table, found, guide, begin, end, reach2, window, step, again, wanted, even, shaped)

        def settle(begin, end, step=step, again=again, floor=floor):
            _settle(points, pixels, table, found, even, shaped, begin, end, reach2, step, floor, again, wanted, out)

        with timed("indirect light"):
            rays += sum(run_chunks(look, blocks, BLOCKS, threads, part(progress, stage / 3, (stage + 1) / 3)))
        with timed("blur"):
            for work in (guides, share, settle):
                run_chunks(work, n, POINTS, threads)
        if stage == COARSE:
            coarse = out[pixels.order[(x % STEP == 0) & (y % STEP == 0)]]
            floor = np.float32(3 * FLOOR) * coarse.mean(dtype=np.float32) if len(coarse) else _0
    return out, rays
