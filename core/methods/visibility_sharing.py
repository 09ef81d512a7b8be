"""Light of all VPLs at every point, by what the points of its block see of them.

The paper blurs light (Dong et al. 2009, Section 6): each pixel's is that of its share of the VPLs, and what its neighbours add was
meant for other places.  Here the geometry terms of all VPLs are a point's own, and only the visibility comes from neighbours: a bilinear mean of
the four points about it that hold a share.  That is wrong where they do not know, and it shows: where they
disagree, or lie on other surfaces, what may give a visible part of the light has shadow rays; and where a point sees its own share otherwise
than others on both sides of it, it lies in something narrower than a block (the dark strip beside a moulding), and takes a
sample of all VPLs, drawn by the light they would give, by shadow rays.

Light itself is interpolated between every fourth pixel of smooth surfaces whose light hardly differs.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..rays.offsets import shadow_segment
from ..rays.packet import WIDTH, new_packet, set_ray
from ..sampling.hashing import uniform
from ..scene import DIFFUSE
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..surfaces.visibility import shadow_packet
from ..threads import run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints
from .interleaving import ALPHA, Pixels, alike, by_place, shares_of_residues

LEVELS = 16  # of visibility, so that points agree
DOUBT = 0.03  # of a point's light: a VPL that may give so much more than it surely does has a ray
UNSURE = 0.5  # of a point's sure light: with more doubts left, all is drawn
SURPRISE = 0.1  # of the light of a point's neighbourhood: that may be unlike what is seen on both sides
DRAWN = 24  # VPLs
STEP = 4  # pixels between the points whose light is computed everywhere
FLAT = 0.998  # least cosine of the normals of points whose light is interpolated
SMOOTH = 0.1  # of the light: most that it may differ between them
BLOCKS = 32  # in one piece of work
POINTS = 4096  # the same
DIMENSION = 62  # of the random numbers
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_THIRD = np.float32(1 / 3)
_UNIT = np.float32(1 / (LEVELS - 1))


@inlined
def code_of(visible):
    """Visibility, 0 to 1, as a code of `seen`; 0 stands for what the point does not face."""
    return np.uint8(np.uint8(visible * np.float32(LEVELS - 1) + np.float32(0.5)) + np.uint8(1))


@kernel
def _terms(lights, px, py, pz, sx, sy, sz, gx, gy, gz, g_max, term):
    """Clamped geometry terms of all lights at a point into term (S K,)."""
    x, y, z, nx, ny, nz = lights[0], lights[1], lights[2], lights[3], lights[4], lights[5]
    for j in range(len(term)):
        dx, dy, dz = x[j] - px, y[j] - py, z[j] - pz
        r2 = max(dx * dx + dy * dy + dz * dz, np.float32(1e-30))
        at_point = max(_0, sx * dx + sy * dy + sz * dz)
        at_light = max(_0, -(nx[j] * dx + ny[j] * dy + nz[j] * dz))
        term[j] = min(at_point * at_light / (r2 * r2), g_max) if gx * dx + gy * dy + gz * dz > _0 else _0


@kernel
def _sums(lights, term, visible, low):
    """Light of all lights as far as they are visible, and the mean of its channels that is not sure."""
    r, g, b, mean = lights[6], lights[7], lights[8], lights[9]
    red = green = blue = unsure = _0
    for j in range(len(term)):
        w = visible[j] * term[j]
        red += w * r[j]
        green += w * g[j]
        blue += w * b[j]
        unsure += (visible[j] - low[j]) * term[j] * mean[j]
    return red, green, blue, unsure


@kernel
def _unshadowed(term, each, facing):
    """Which shares have a light that the point faces, into facing (S,)."""
    for share in range(len(facing)):
        total = _0
        for j in range(share * each, (share + 1) * each):
            total += term[j]
        facing[share] = total > _0


@inlined
def _value(code):
    """Visibility, 0 to 1, of a code of `seen`."""
    return (np.float32(max(code, np.uint8(1))) - _1) * _UNIT


@kernel
def _agreement(pixels, words, seen, lights, left_edge, top_edge, agreed, visible, low, high):
    """Which shares all points of the 3 x 3 blocks about one find alike, into agreed (S,), and what they find into visible, low, high."""
    size, width, first = pixels.interleave, pixels.width, pixels.first
    last = len(first) - 1
    each = seen.shape[1]
    for share in range(size * size):
        found = -1
        same = True
        for v in range(top_edge - size + pixels.down[share], top_edge + 2 * size, size):
            if v < 0:
                continue
            for u in range(max(left_edge - size, 0) + pixels.across[share], min(left_edge + 2 * size, width), size):
                at = v * width + u
                if at >= last:
                    continue
                for k in range(first[at], first[at + 1]):
                    if found < 0:
                        found = k
                        for c in range(each):
                            same &= seen[k, c] > 0 or lights[9, share * each + c] == _0
                    for w in range(words.shape[1]):
                        same &= words[k, w] == words[found, w]
            if not same:
                break
        agreed[share] = same and found >= 0
        if agreed[share]:
            for c in range(each):
                at = share * each + c
                visible[at] = low[at] = high[at] = _value(seen[found, c])


@kernel
def _holders(pixels, table, place, x, y, left_edge, top_edge, reach2, agreed, facing, holder, weight, guessed):
    """The (up to) four points about one at (x, y) that hold a share, for every share; their weights are those of a bilinear mean.

    Into holder (S, 4), of places, weight (S, 4) and guessed (S,): whether there are none but points of other surfaces.
    """
    size, width, first = pixels.interleave, pixels.width, pixels.first
    last = len(first) - 1
    inverse = _1 / np.float32(size)
    for share in range(size * size):
        guessed[share] = False
        if agreed[share] or not facing[share]:
            continue
        right, below = left_edge + pixels.across[share], top_edge + pixels.down[share]
        if right < x:
            right += size
        if below < y:
            below += size
        fx, fy = np.float32(right - x) * inverse, np.float32(below - y) * inverse
        total = _0
        found = 0
        for corner in range(4):
            left, up = corner & 1, corner >> 1
            if (left and right == x) or (up and below == y):
                continue
            u, v = right - left * size, below - up * size
            at = v * width + u
            if u < 0 or v < 0 or u >= width or at >= last:
                continue
            itself = u == x and v == y
            for k in range(first[at], first[at + 1]):
                if k == place or (not itself and alike(table, place, k, reach2)):
                    if total == _0:
                        found = 0
                    holder[share, found] = k
                    weight[share, found] = (fx if left else _1 - fx) * (fy if up else _1 - fy)
                    total += weight[share, found]
                    found += 1
                    break
                if not itself and total == _0:
                    holder[share, found], weight[share, found] = k, _1
                    found += 1
                    break
        guessed[share] = total == _0
        scale = _UNIT / (total if total > _0 else np.float32(max(found, 1)))
        for h in range(4):
            if h < found:
                weight[share, h] *= scale
            else:
                holder[share, h], weight[share, h] = holder[share, 0] if found > 0 else place, _0


@kernel
def _mix(seen, agreed, facing, holder, weight, guessed, visible, low, high):
    """Weighted mean, least and largest of what the holders of each share see, into arrays (S K,)."""
    each = seen.shape[1]
    for share in range(len(agreed)):
        if agreed[share] or not facing[share]:
            continue
        a, b, c, d = seen[holder[share, 0]], seen[holder[share, 1]], seen[holder[share, 2]], seen[holder[share, 3]]
        wa, wb, wc, wd = weight[share, 0], weight[share, 1], weight[share, 2], weight[share, 3]
        base = share * each
        v, lo, hi = visible[base : base + each], low[base : base + each], high[base : base + each]
        for j in range(each):
            sa, sb, sc, sd = np.float32(a[j]), np.float32(b[j]), np.float32(c[j]), np.float32(d[j])
            v[j] = wa * max(sa - _1, _0) + wb * max(sb - _1, _0) + wc * max(sc - _1, _0) + wd * max(sd - _1, _0)
            lo[j] = max(min(min(sa, sb), min(sc, sd)) - _1, _0) * _UNIT
            hi[j] = max(max(max(sa, sb), max(sc, sd)) - _1, _0) * _UNIT
        if guessed[share]:
            lo[:] = _0
            hi[:] = _1


@kernel
def _doubtful(lights, term, low, high, bound, chosen):
    """Numbers of the lights that may give a point more light by more than `bound` than they surely do, into chosen (S K,).

    Returns how many, and what the others may give in all.
    """
    mean = lights[9]
    count = 0
    rest = _0
    for j in range(len(term)):
        doubt = (high[j] - low[j]) * term[j] * mean[j]
        count += doubt > bound
        rest += _0 if doubt > bound else doubt
    if count > 0:
        count = 0
        for j in range(len(term)):
            chosen[count] = j
            count += (high[j] - low[j]) * term[j] * mean[j] > bound
    return count, rest


@kernel
def _draw(lights, term, u, chosen, scale):
    """Numbers of DRAWN lights, by what each gives to a point if nothing is in its way, and the weights of what is seen of them."""
    mean = lights[9]
    total = _0
    for j in range(len(term)):
        total += term[j] * mean[j]
    if not total > _0:
        return 0
    step = total / np.float32(DRAWN)
    reached = -u * step
    count = 0
    for j in range(len(term)):
        reached += term[j] * mean[j]
        if reached > _0:
            # Those that are drawn more than once are traced once.
            times = np.ceil(reached / step)
            chosen[count], scale[count] = j, times * step / (term[j] * mean[j])
            reached -= times * step
            count += 1
    return count


@kernel
def _smooth(points, pixels, table, narrow, place, x, y, reach2, out):
    """Whether the light at a point of pixel (x, y) may be taken from the four points about it whose light is known; sets it if so."""
    width, first = pixels.width, pixels.first
    last = len(first) - 1
    i = pixels.order[place]
    if narrow[place]:
        return False
    left, top = x // STEP * STEP, y // STEP * STEP
    red = green = blue = total = _0
    least, most = np.float32(np.inf), _0
    for corner in range(4):
        u, v = left + (corner & 1) * STEP, top + (corner >> 1) * STEP
        across = np.float32(x - left) * np.float32(1 / STEP)
        down = np.float32(y - top) * np.float32(1 / STEP)
        w = (across if corner & 1 else _1 - across) * (down if corner >> 1 else _1 - down)
        if w == _0:
            continue
        at = v * width + u
        if u >= width or at >= last:
            return False
        found = False
        for place_k in range(first[at], first[at + 1]):
            k = pixels.order[place_k]
            bend = points.ns[i, 0] * points.ns[k, 0] + points.ns[i, 1] * points.ns[k, 1] + points.ns[i, 2] * points.ns[k, 2]
            if not narrow[place_k] and bend > np.float32(FLAT) and alike(table, place, place_k, reach2):
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
def _traced(scene, packet, rows, surface, cutouts, through, points, i, lights, term, chosen, scale, count):
    """Light of the lights chosen[:count] at point i, by shadow rays, weighted by `scale`."""
    red = green = blue = _0
    for base in range(0, count, WIDTH):
        lanes = min(WIDTH, count - base)
        for lane in range(lanes):
            j = chosen[base + lane]
            ox, oy, oz, dx, dy, dz = shadow_segment(
                points.position[i, 0], points.position[i, 1], points.position[i, 2],
                points.ng[i, 0], points.ng[i, 1], points.ng[i, 2], points.error[i],
                lights[0, j], lights[1, j], lights[2, j], lights[3, j], lights[4, j], lights[5, j], lights[10, j],
            )  # fmt: skip
            set_ray(packet, lane, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE)
        shadow_packet(scene, packet, rows, surface, lanes, DIFFUSE, cutouts, through)
        for lane in range(lanes):
            j = chosen[base + lane]
            w = term[j] * scale[base + lane]
            red += w * lights[6, j] * through[lane, 0]
            green += w * lights[7, j] * through[lane, 1]
            blue += w * lights[8, j] * through[lane, 2]
    return red, green, blue


@kernel
def _gather(scene, points, pixels, table, lights, seen, words, begin, end, reach2, g_max, floor, narrow, seed, cutouts, coarse, out):
    """Light of all VPLs at the points of the blocks begin..end-1 into out (N, 3): at every STEP-th if coarse, else at the others.

    Returns the rays traced.
    words: `seen` as (N, K / 8) uint64.  narrow: (N,) bool, by pixel.
    """
    size, width, first = pixels.interleave, pixels.width, pixels.first
    last = len(first) - 1
    columns = (width - 1) // size + 1
    shares, each = size * size, seen.shape[1]
    visible, term = np.zeros(shares * each, np.float32), np.empty(shares * each, np.float32)
    low, high = np.zeros(shares * each, np.float32), np.zeros(shares * each, np.float32)
    chosen, scale = np.empty(shares * each + 1, np.int64), np.empty(shares * each + 1, np.float32)
    count = 0
    agreed, facing, guessed = np.empty(shares, np.bool_), np.empty(shares, np.bool_), np.empty(shares, np.bool_)
    holder, weight = np.empty((shares, 4), np.int64), np.empty((shares, 4), np.float32)
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    rows = new_registers(scene.materials)
    through = np.ones((WIDTH, 3), np.float32)
    rays = 0
    for block in range(begin, end):
        left_edge, top_edge = block % columns * size, block // columns * size
        known = False
        agreed[:] = False
        for within in range(shares):
            x, y = left_edge + within % size, top_edge + within // size
            if x >= width or y * width + x >= last:
                continue
            for place in range(first[y * width + x], first[y * width + x + 1]):
                i = pixels.order[place]
                if coarse != (x % STEP == 0 and y % STEP == 0):
                    continue
                if not coarse:
                    if _smooth(points, pixels, table, narrow, place, x, y, reach2, out):
                        continue
                    if not known:
                        _agreement(pixels, words, seen, lights, left_edge, top_edge, agreed, visible, low, high)
                        known = True
                _terms(
                    lights, points.position[i, 0], points.position[i, 1], points.position[i, 2],
                    points.ns[i, 0], points.ns[i, 1], points.ns[i, 2], points.ng[i, 0], points.ng[i, 1], points.ng[i, 2], g_max, term,
                )  # fmt: skip
                red = green = blue = _0
                draw = narrow[place]
                if not draw:
                    _unshadowed(term, each, facing)
                    _holders(pixels, table, place, x, y, left_edge, top_edge, reach2, agreed, facing, holder, weight, guessed)
                    _mix(seen, agreed, facing, holder, weight, guessed, visible, low, high)
                    red, green, blue, unsure = _sums(lights, term, visible, low)
                    sure = max((red + green + blue) * _THIRD - unsure, floor)
                    count, rest = _doubtful(lights, term, low, high, np.float32(DOUBT) * sure, chosen)
                    draw = count > DRAWN or rest > np.float32(UNSURE) * sure
                if draw:
                    red = green = blue = _0
                    count = _draw(lights, term, uniform(seed, np.uint32(i), np.uint32(0), np.uint32(DIMENSION)), chosen, scale)
                else:
                    for d in range(count):
                        j = chosen[d]
                        scale[d] = _1
                        red -= visible[j] * term[j] * lights[6, j]
                        green -= visible[j] * term[j] * lights[7, j]
                        blue -= visible[j] * term[j] * lights[8, j]
                r, g, b = _traced(scene, packet, rows, surface, cutouts, through, points, i, lights, term, chosen, scale, count)
                red, green, blue = red + r, green + g, blue + b
                rays += count
                out[i, 0], out[i, 1], out[i, 2] = max(red, _0), max(green, _0), max(blue, _0)
    return rays


@kernel
def _surprise(points, pixels, table, lights, seen, begin, end, reach2, g_max, own, light):
    """What is unlike between what the points at places begin..end-1 see and what others on both sides do that hold the same share.

    own: (N,) shares.  Into light (N, 2): the light of their shares that is unlike, and all of it.
    """
    size, width, first = pixels.interleave, pixels.width, pixels.first
    last = len(first) - 1
    each = seen.shape[1]
    for place in range(begin, end):
        i = pixels.order[place]
        x, y = points.pixel[i] % width, points.pixel[i] // width
        light[place, 0] = light[place, 1] = _0
        for axis in range(2):
            a = b = -1
            for side in range(-1, 2, 2):
                u, v = (x + side * size, y) if axis == 0 else (x, y + side * size)
                at = v * width + u
                if u < 0 or v < 0 or u >= width or at >= last:
                    continue
                for k in range(first[at], first[at + 1]):
                    if alike(table, place, k, reach2):
                        a, b = k, a
                        break
            if a < 0:
                continue
            b = a if b < 0 else b
            off = total = _0
            for c in range(each):
                s, sa, sb = _value(seen[place, c]), _value(seen[a, c]), _value(seen[b, c])
                j = own[place] * each + c
                dx, dy, dz = lights[0, j] - table[place, 0], lights[1, j] - table[place, 1], lights[2, j] - table[place, 2]
                r2 = max(dx * dx + dy * dy + dz * dz, np.float32(1e-30))
                at_point = max(_0, points.ns[i, 0] * dx + points.ns[i, 1] * dy + points.ns[i, 2] * dz)
                at_light = max(_0, -(lights[3, j] * dx + lights[4, j] * dy + lights[5, j] * dz))
                g = min(at_point * at_light / (r2 * r2), g_max) * lights[9, j]
                off += g * max(max(s - max(sa, sb), min(sa, sb) - s), _0)
                total += g * max(s, max(sa, sb))
            if light[place, 1] == _0 or off * light[place, 1] > light[place, 0] * total:
                light[place, 0], light[place, 1] = off, total


@kernel
def _narrow(points, pixels, light, begin, end, narrow):
    """Which points at places begin..end-1 lie in or at features too narrow for interleaving, by the surprises around them, into narrow (N,)."""
    width, first = pixels.width, pixels.first
    last = len(first) - 1
    for place in range(begin, end):
        pixel = points.pixel[pixels.order[place]]
        x, y = pixel % width, pixel // width
        off = total = _0
        for v in range(max(y - 1, 0), y + 2):
            for u in range(max(x - 1, 0), min(x + 2, width)):
                if v * width + u < last:
                    for k in range(first[v * width + u], first[v * width + u + 1]):
                        off += light[k, 0]
                        total += light[k, 1]
        narrow[place] = off > np.float32(SURPRISE) * total


def gather(
    scene: Transport,
    points: ShadingPoints,
    pixels: Pixels,
    lights: np.ndarray,
    seen: np.ndarray,
    extent: float,
    g_max: float,
    floor: float,
    cutouts: bool,
    seed: int = 0,
    threads: int = 0,
) -> tuple[np.ndarray, int]:
    """Light of all VPLs (N, 3) at N points, and the shadow rays traced.

    lights: (11, S * K) float32, S shares of K VPLs: positions, normals, flux / pi (rgb) and its mean, error of the position; zeros for none.
    seen: (N, K) uint8, what the points, by pixel, see of their own shares, as `code_of` has it; K is a multiple of 8.
    extent: of the scene (m).  g_max: clamp.  floor: light (W/m^2) of which errors matter everywhere.
    """
    n = len(points.pixel)
    out = np.zeros((n, 3), np.float32)
    table, reach2 = by_place(points, pixels), np.float32((ALPHA * extent) ** 2)
    words, size = seen.view(np.uint64), pixels.interleave
    g_max, floor = np.float32(g_max), np.float32(floor)
    pixel = points.pixel[pixels.order]
    own = shares_of_residues(size)[(pixel // pixels.width % size) * size + pixel % pixels.width % size]
    light, narrow = np.empty((n, 2), np.float32), np.empty(n, np.bool_)
    run_chunks(lambda b, e: _surprise(points, pixels, table, lights, seen, b, e, reach2, g_max, own, light), n, POINTS, threads)
    run_chunks(lambda b, e: _narrow(points, pixels, light, b, e, narrow), n, POINTS, threads)
    rows = (len(pixels.first) - 2) // pixels.width + 1
    blocks = -(-pixels.width // size) * -(-rows // size)
    rays = 0
    for coarse in (True, False):

        def work(begin, end, coarse=coarse):
            return _gather(
                scene, points, pixels, table, lights, seen, words, begin, end, reach2, g_max, floor, narrow, np.uint32(seed), cutouts, coarse, out
            )  # fmt: skip

        rays += sum(run_chunks(work, blocks, BLOCKS, threads))
    return out, rays
