"""Visibility between clusters of shading points and clusters of VPLs, and shading that blends it.

Fuzzy clustering paper, Section 3.1, Steps 5 and 6 (Eqs. 6, 8, 9).  A row of `visible` is what one point cluster sees, a byte
for each light, 255 or 0: a point's weights are bytes that add up to 255, and its blended visibility is a sum of
their bitwise products, 64 lights to an AVX-512 instruction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..particles import Vpls
from ..rays.offsets import shadow_segment
from ..rays.packet import WIDTH, new_packet, set_ray
from ..sampling.hashing import uniform
from ..scene import DIFFUSE
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..surfaces.visibility import shadow_packet

SEEN = 255  # what the weights of a point add up to
LIGHT_TILE = 512  # lights whose table stays in the first cache, while a chunk of points is lit by them
# A light that gives a point less than FAINT times the mean of all lights, unshadowed, is asked for by one of several neighbouring points for all of
# them, as far as these lie no farther from it than NEARBY times the light: what lies in between is much the same.
FAINT = np.float32(3.0)
NEARBY = np.float32(0.35)
_TINY = np.float32(1e-15)  # m^2: keeps r^4 above zero
_GOLDEN = 0.6180339887498949  # its multiples fill the unit interval evenly
_0 = np.float32(0.0)
_1 = np.float32(1.0)


class Lights(NamedTuple):
    """M lights that shade, cluster by cluster; neighbouring clusters are neighbours in space and normal.

    vpls: the lights.  power: (M,) float32, the sum of the flux's channels (W).
    table: (9, M) float32: position (m), normal, and flux / (pi 255) (W), which folds in the scale of the visibility.
    first: (K + 1,) int32: the lights first[k]..first[k + 1] - 1 are a cluster and share their visibility.
    """

    vpls: Vpls
    power: np.ndarray
    table: np.ndarray
    first: np.ndarray


def light_tables(vpls: Vpls, first: np.ndarray) -> Lights:
    """`Lights` of M VPLs sorted by cluster."""
    scaled = vpls.flux * np.float32(1 / (np.pi * SEEN))
    table = np.ascontiguousarray(np.concatenate([vpls.position, vpls.normal, scaled], axis=1).T)
    return Lights(vpls, vpls.flux.sum(axis=1), table, first.astype(np.int32))


@kernel
def _drawn_member(lights, begin, end, px, py, pz, gx, gy, gz, g_max, u):
    """One of the lights begin..end-1, with the probability of its share of their unshadowed light at a point; -1 if none faces it.

    g: the point's geometric normal.  u: in [0, 1).  Also returns that light's sum, without the factor 1 / pi.
    """
    position, normal = lights.vpls.position, lights.vpls.normal
    chosen, total = -1, _0
    for m in range(begin, end):
        dx, dy, dz = position[m, 0] - px, position[m, 1] - py, position[m, 2] - pz
        at_point = gx * dx + gy * dy + gz * dz
        at_light = -(normal[m, 0] * dx + normal[m, 1] * dy + normal[m, 2] * dz)
        if at_point > _0 and at_light > _0:
            r2 = dx * dx + dy * dy + dz * dz + _TINY
            light = lights.power[m] * min(at_point * at_light / (r2 * r2), g_max)
            total += light
            share = light / total if total > _0 else _1
            if u < share:
                chosen, u = m, u / share
            else:
                u = (u - share) / (_1 - share)
    return chosen, total


@kernel
def _light_at(lights, m, places, g_max, out):
    """What light m gives to N points unshadowed, without the factor 1 / pi; places: (6, N), positions and normals."""
    x, y, z = lights.vpls.position[m, 0], lights.vpls.position[m, 1], lights.vpls.position[m, 2]
    nx, ny, nz = lights.vpls.normal[m, 0], lights.vpls.normal[m, 1], lights.vpls.normal[m, 2]
    px, py, pz, gx, gy, gz = places[0], places[1], places[2], places[3], places[4], places[5]
    power = lights.power[m]
    for n in range(len(out)):
        dx, dy, dz = x - px[n], y - py[n], z - pz[n]
        r2 = dx * dx + dy * dy + dz * dz + _TINY
        facing = max(gx[n] * dx + gy[n] * dy + gz[n] * dz, _0) * max(-(nx * dx + ny * dy + nz * dz), _0)
        out[n] = power * min(facing / (r2 * r2), g_max)


@kernel
def _faintest(lights, begin, end, places, g_max, out):
    """What a light must give to each of N points for a ray of its own, into out (N,); places: (6, N), positions and normals."""
    light = np.empty(len(out), np.float32)
    out[:] = _0
    for m in range(begin, end):
        _light_at(lights, m, places, g_max, light)
        for n in range(len(out)):
            out[n] += light[n]
    share = FAINT / np.float32(max(end - begin, 1))
    for n in range(len(out)):
        out[n] *= share


@inlined
def _asked(places, light, least, lights, m, n, k, sharers):
    """The point whose ray to light m, of cluster k, tells point n, too: n itself unless the light is faint, and the other, which faces it, is near."""
    other = n // sharers * sharers + k % sharers
    if light[n] >= least[n] or other >= len(light) or not light[other] > _0:
        return n
    position = lights.vpls.position
    apart, away = _0, _0
    for c in range(3):
        apart += (places[c, n] - places[c, other]) ** 2
        away += (places[c, n] - position[m, c]) ** 2
    return other if apart <= NEARBY * NEARBY * away else n


@kernel
def trace_clusters(scene, points, begin, end, lights, light_begin, light_end, g_max, cutouts, sharers, seed, visible, seen):
    """Shadow rays from the points begin..end-1, representatives of clusters, to one light of each cluster light_begin..light_end-1.

    A cluster's light is drawn by what it gives to the point, with one number for all points: its visibility is that of the
    cluster's light in the mean, and changes smoothly.  Where no light faces the point, nothing is visible.
    visible: (C, columns) uint8, whose column 0 is light `lights.first[light_begin]`; set to 255 or 0.
    seen: (C, 2) float32; gathers the visible light and all light.
    sharers: neighbouring points that share rays to faint lights, 1 where each has its own; only of clusters of one light.
    What lets some of the light through is open or closed at random.  Returns the number of rays.
    """
    lane_of, through = np.empty(WIDTH, np.int64), np.ones((WIDTH, 3), np.float32)
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    rows = new_registers(scene.materials)
    vpls, first = lights.vpls, lights.first
    places = np.empty((6, end - begin), np.float32)
    for i in range(begin, end):
        for c in range(3):
            places[c, i - begin], places[3 + c, i - begin] = points.position[i, c], points.ng[i, c]
    light, member = np.empty(end - begin, np.float32), np.empty(end - begin, np.int64)
    least, asked = np.zeros(end - begin, np.float32), np.arange(end - begin)
    if sharers > 1:
        _faintest(lights, light_begin, light_end, places, g_max, least)
    rays = 0
    for k in range(light_begin, light_end):
        column, last = first[k] - first[light_begin], first[k + 1] - first[light_begin]
        u = np.float32((uniform(seed, 0, 0, 0) + (k + 0.5) * _GOLDEN) % 1.0)
        if first[k + 1] == first[k] + 1:
            member[:] = first[k]
            _light_at(lights, first[k], places, g_max, light)
            for n in range(end - begin):
                asked[n] = _asked(places, light, least, lights, first[k], n, k, sharers)
        else:
            for n in range(end - begin):
                member[n], light[n] = _drawn_member(
                    lights, first[k], first[k + 1], places[0, n], places[1, n], places[2, n], places[3, n], places[4, n], places[5, n], g_max, u
                )  # fmt: skip
        i = begin
        while i < end:
            lanes = 0
            while i < end and lanes < WIDTH:
                n = i - begin
                if asked[n] != n:
                    i += 1
                    continue
                if light[n] > _0:
                    seen[i, 1] += light[n]
                    m = member[n]
                    ox, oy, oz, dx, dy, dz = shadow_segment(
                        places[0, n], places[1, n], places[2, n], places[3, n], places[4, n], places[5, n], points.error[i],
                        vpls.position[m, 0], vpls.position[m, 1], vpls.position[m, 2],
                        vpls.normal[m, 0], vpls.normal[m, 1], vpls.normal[m, 2], vpls.error[m],
                    )  # fmt: skip
                    set_ray(packet, lanes, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE)
                    lane_of[lanes] = i
                    lanes += 1
                else:
                    visible[i, column:last] = 0
                i += 1
            if lanes == 0:
                break
            shadow_packet(scene, packet, rows, surface, lanes, DIFFUSE, cutouts, through)
            rays += lanes
            for lane in range(lanes):
                at = lane_of[lane]
                share = (through[lane, 0] + through[lane, 1] + through[lane, 2]) * np.float32(1 / 3)
                seen[at, 0] += light[at - begin] * share
                is_open = share >= _1 or (share > _0 and uniform(seed, at, k, 1) < share)
                visible[at, column:last] = SEEN if is_open else 0
        for n in range(end - begin):
            if asked[n] != n:
                is_open = light[n] > _0 and visible[begin + asked[n], column] > 0
                visible[begin + n, column] = SEEN if is_open else 0
                seen[begin + n, 1] += light[n]
                if is_open:
                    seen[begin + n, 0] += light[n]
    return rays


@kernel
def quantised(weights, out):
    """Write weights (F,) that add up to 1 as bytes that add up to 255 exactly; all zero stay zero."""
    total = _0
    before = 0
    for f in range(len(weights)):
        total += weights[f]
        upto = int(total * np.float32(SEEN) + np.float32(0.5))
        out[f] = upto - before
        before = upto


@kernel
def _blend(visible, clusters, weights, begin, end, out):
    """Blended visibility (Eq. 9) of the columns begin..end-1, in 255ths."""
    out[: end - begin] = 0
    for f in range(len(clusters)):
        w = weights[f]
        if w == 0:
            continue
        row = visible[clusters[f], begin:end]
        for j in range(end - begin):
            out[j] = out[j] + (w & row[j])


@kernel
def _light_of(table, begin, end, visibility, px, py, pz, nx, ny, nz, g_max):
    """Irradiance (r, g, b) at a point by the lights begin..end-1, each with its visibility in 255ths."""
    x, y, z = table[0, begin:end], table[1, begin:end], table[2, begin:end]
    mx, my, mz = table[3, begin:end], table[4, begin:end], table[5, begin:end]
    red, green, blue = table[6, begin:end], table[7, begin:end], table[8, begin:end]
    r = g = b = _0
    for j in range(end - begin):
        dx, dy, dz = x[j] - px, y[j] - py, z[j] - pz
        r2 = dx * dx + dy * dy + dz * dz + _TINY
        facing = max(nx * dx + ny * dy + nz * dz, _0) * max(-(mx[j] * dx + my[j] * dy + mz[j] * dz), _0)
        w = min(facing / (r2 * r2), g_max) * np.float32(visibility[j])
        r += w * red[j]
        g += w * green[j]
        b += w * blue[j]
    return r, g, b


@kernel
def shade(points, order, begin, end, table, first_light, visible, clusters, weights, g_max, out):
    """Adds the lights from `first_light` on that `visible` (C, columns) has columns for to the points order[begin..end-1].

    clusters, weights: (N, F) int32 and float32, the fuzzy assignment of all points.
    """
    columns = visible.shape[1]
    blended = np.empty(LIGHT_TILE, np.uint8)
    shares = np.empty((end - begin, clusters.shape[1]), np.uint8)
    for k in range(begin, end):
        quantised(weights[order[k]], shares[k - begin])
    for light in range(0, columns, LIGHT_TILE):
        last = min(light + LIGHT_TILE, columns)
        for k in range(begin, end):
            i = order[k]
            _blend(visible, clusters[i], shares[k - begin], light, last, blended)
            r, g, b = _light_of(
                table, first_light + light, first_light + last, blended,
                points.position[i, 0], points.position[i, 1], points.position[i, 2], points.ns[i, 0], points.ns[i, 1], points.ns[i, 2], g_max,
            )  # fmt: skip
            out[i, 0] += r
            out[i, 1] += g
            out[i, 2] += b


@kernel
def blend_values(values, clusters, weights, begin, end, out):
    """Adds the blend of the clusters' values (C, D) to the points begin..end-1 of out (N, D)."""
    for i in range(begin, end):
        for f in range(clusters.shape[1]):
            for c in range(out.shape[1]):
                out[i, c] += weights[i, f] * values[clusters[i, f], c]
