"""From the texels of a lightmap to shading points: what the camera is to pixels, a UV map is to texels.

A texel's value is the mean over the middle of its square, as of Blender's bake: stratified samples in UV space, and a shading point for each distinct surface
among them, at one drawn at random, as next to walls light varies steeply within a texel.  A texel whose middle shows nothing has samples in all of its square.
Samples that nobody can see are left out, so that no dark creeps out from under a wall: those inside closed or touching geometry, and those that a wall parts
from the middle of their texel.

A translucent surface is lit from both sides: its texels hold the irradiance that, times its whole colour, gives the light that it sends,
which is the mean of both sides by their shares of the colour.  (So does Cycles' bake of Diffuse without Color.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel, leaf
from ..lamps.departures import FACES, TURNS
from ..rays.offsets import hit_point, offset_origin
from ..rays.packet import WIDTH, disable_ray, hit_t, hit_triangle, is_occluded, new_packet, set_ray
from ..rays.trace import OPAQUE, intersect_packet, occluded_packet
from ..sampling.hashing import hash_combine, uniform
from ..sampling.maps import cosine_hemisphere, to_world
from ..sampling.sequences import r2
from ..scene import DIFFUSE, NORMAL_MAPPED, TRANSLUCENT
from ..surfaces.bumps import mean_shadowing
from ..surfaces.layout import EMISSION, NORMAL, SURFACE, TILT, diffuse_albedo_average, translucency_average
from ..surfaces.normals import shading_normal
from ..surfaces.program import MEAN_VIEW, evaluate, new_registers
from ..threads import Progress, run_chunks
from ..transport import Transport, is_translucent
from .camera import pixel_sample
from .points import SPREAD, ShadingPoints, further_member
from .tile import SAME_NORMAL, SAME_REACH

ROWS = 16  # of texels a chunk
MOST_SAMPLES = WIDTH  # a texel: they are traced as one packet
# The part of a texel's side that its samples fill: Blender's (`A = 0.5f / A` of `bake_differentials` in its bake.cc).  Renderers interpolate between
# texels, which blurs more than a square's mean does; and a step of light lies where it lies in Cycles' bake.
EXTENT = np.float32(0.5)
# A sample is hidden where this many rays all meet a back face, or anything nearer than this part of a texel; a texel where this
# share of its samples is.
PROBES = 4
CONTACT = np.float32(0.5)
MOSTLY = np.float32(0.75)
# How far off the surface, in texels, the samples of one texel must see each other.
LIFT = np.float32(0.05)
# What a texel is: beyond all charts, covered by hidden surfaces only, lit.
EMPTY, HIDDEN, LIT = 0, 1, 2
# Columns of the texels' layers.
ALBEDO, EMITTED, NORMALS, POSITION, LAYERS = 0, 3, 6, 9, 12
_0 = np.float32(0.0)
_1 = np.float32(1.0)


class Charts(NamedTuple):
    """T triangles laid out in an image of W x H texels.

    triangle: (T,) int32 into the scene's triangles.  uv: (T, 3, 2) float32, texels, x to the right, y down from the top.
    """

    triangle: np.ndarray
    uv: np.ndarray

    @staticmethod
    def of(triangle: np.ndarray, uv: np.ndarray, size: tuple[int, int]) -> Charts:
        """The charts of triangles whose `uv` (T, 3, 2) are 0..1, v up, in an image of `size` (width, height)."""
        texels = uv.astype(np.float64) * size
        texels[..., 1] = size[1] - texels[..., 1]
        return Charts(np.ascontiguousarray(triangle, np.int32), np.ascontiguousarray(texels, np.float32))


@dataclass
class Texels:
    """What a lightmap shows before any light.

    points: the shading points, whose `pixel` counts row-major over H x W and whose `albedo` is their share of the texel, grey but where
        a translucent surface has one on either side.
    state: (H, W) uint8, EMPTY, HIDDEN or LIT.  albedo (averaged over all views), emission, normal, position: (H, W, 3) float32,
        means over the samples; albedo and emission are zero unless asked for.
    rays: traced to find what is hidden.
    """

    points: ShadingPoints
    state: np.ndarray
    albedo: np.ndarray
    emission: np.ndarray
    normal: np.ndarray
    position: np.ndarray
    rays: int


@inlined
def texel_sample(sample, seed, texel, extent):
    """Position of a sample in the texel's square: in the middle of it, `extent` of its side wide."""
    x, y = pixel_sample(sample, seed, texel)
    half = np.float32(0.5)
    return half + extent * (x - half), half + extent * (y - half)


@kernel
def cover(uv, y0, y1, width, samples, seed, found, weights, extent):
    """Which triangle of `uv` (T, 3, 2) holds each sample of the texels in the rows y0..y1-1.

    found: ((y1 - y0) * width, S) int32, -1 for none.  weights: (..., S, 2) float32, of corners 1 and 2.  extent: (texels,) float32, by which samples
    `texel_sample` are found: `EXTENT`, or 1 where none of those shows anything.  A texel that no sample
    of a triangle falls into, but its middle does, gets that: no triangle, however small, is lost.
    """
    found[:] = -1
    extent[:] = EXTENT
    _find(uv, y0, y1, width, samples, seed, found, weights, extent)
    for texel in range(len(found)):
        if (found[texel] < 0).all():
            extent[texel] = _1
    _find(uv, y0, y1, width, samples, seed, found, weights, extent)
    for k in range(len(uv)):
        x = int(np.floor((uv[k, 0, 0] + uv[k, 1, 0] + uv[k, 2, 0]) * np.float32(1 / 3)))
        y = int(np.floor((uv[k, 0, 1] + uv[k, 1, 1] + uv[k, 2, 1]) * np.float32(1 / 3)))
        if y0 <= y < y1 and 0 <= x < width and (found[(y - y0) * width + x] < 0).all():
            found[(y - y0) * width + x, 0] = k
            weights[(y - y0) * width + x, 0] = np.float32(1 / 3)


@leaf
def _find(uv, y0, y1, width, samples, seed, found, weights, extent):
    """`cover` by samples alone: of those that have found nothing yet."""
    for k in range(len(uv)):
        ax, ay = np.float64(uv[k, 0, 0]), np.float64(uv[k, 0, 1])
        ex, ey, fx, fy = uv[k, 1, 0] - ax, uv[k, 1, 1] - ay, uv[k, 2, 0] - ax, uv[k, 2, 1] - ay
        low, high = ay + min(0.0, ey, fy), ay + max(0.0, ey, fy)
        if high < y0 or low >= y1:
            continue
        area = ex * fy - fx * ey
        if area == 0.0:
            continue
        inverse = 1.0 / area
        x_begin, x_end = max(0, int(np.floor(ax + min(0.0, ex, fx)))), min(width, int(np.floor(ax + max(0.0, ex, fx))) + 1)
        for y in range(max(y0, int(np.floor(low))), min(y1, int(np.floor(high)) + 1)):
            for x in range(x_begin, x_end):
                texel = (y - y0) * width + x
                for s in range(samples):
                    if found[texel, s] >= 0:
                        continue
                    jx, jy = texel_sample(s, seed, y * width + x, extent[texel])
                    px, py = x + np.float64(jx) - ax, y + np.float64(jy) - ay
                    u, v = (px * fy - fx * py) * inverse, (ex * py - px * ey) * inverse
                    if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                        found[texel, s] = k
                        weights[texel, s, 0], weights[texel, s, 1] = u, v


class _Samples(NamedTuple):
    """S samples of one texel: positions and geometric normals (S, 3), errors, footprints (m) and whether each counts (S,).

    ns: (S, 3) float32, normals that corners interpolate.  triangle, material: (S,) int32.  first: (S,) int32, the first sample that shows the same surface, -1 for those that do not count.
    standing: (S,) int32, samples that each one stands for.  member: (S,) int32, scratch.
    """

    position: np.ndarray
    ng: np.ndarray
    ns: np.ndarray
    error: np.ndarray
    footprint: np.ndarray
    valid: np.ndarray
    triangle: np.ndarray
    material: np.ndarray
    first: np.ndarray
    standing: np.ndarray
    member: np.ndarray


@kernel
def _new_samples(samples):
    f = np.float32
    return _Samples(
        np.empty((samples, 3), f), np.empty((samples, 3), f), np.empty((samples, 3), f), np.empty(samples, f), np.empty(samples, f),
        np.empty(samples, np.uint8), np.empty(samples, np.int32),
        np.empty(samples, np.int32), np.empty(samples, np.int32), np.empty(samples, np.int32), np.empty(samples, np.int32),
    )  # fmt: skip


@leaf
def _meets_back_or_touches(scene, packet, lane, dx, dy, dz, contact):
    """Whether the ray in a lane met a back face, or anything nearer than `contact`."""
    triangle = hit_triangle(packet, lane)
    if triangle < 0:
        return False
    if hit_t(packet, lane) < contact:
        return True
    a, b, c = scene.triangles[triangle, 0], scene.triangles[triangle, 1], scene.triangles[triangle, 2]
    v = scene.vertices
    ex, ey, ez = v[b, 0] - v[a, 0], v[b, 1] - v[a, 1], v[b, 2] - v[a, 2]
    fx, fy, fz = v[c, 0] - v[a, 0], v[c, 1] - v[a, 1], v[c, 2] - v[a, 2]
    return (ey * fz - ez * fy) * dx + (ez * fx - ex * fz) * dy + (ex * fy - ey * fx) * dz > _0


@kernel
def _drop_hidden(scene, packet, at, direction, key):
    """Clears `at.valid` where every one of `PROBES` rays says that nobody can see the sample; the rays traced.

    Where the first ray of every sample finds open space, no more are traced.
    """
    rays = 0
    n = len(at.valid)
    hidden = 0
    for probe in range(PROBES):
        for s in range(n):
            # Bit 1: in the texel; bit 2: hidden so far.
            if not at.valid[s] or (probe > 0 and not at.valid[s] & 2):
                disable_ray(packet, s)
                continue
            u1, u2 = r2(probe * n + s, key)
            lx, ly, lz = cosine_hemisphere(u1, u2)
            gx, gy, gz = at.ng[s, 0], at.ng[s, 1], at.ng[s, 2]
            dx, dy, dz = to_world(lx, ly, lz, gx, gy, gz)
            ox, oy, oz = offset_origin(at.position[s, 0], at.position[s, 1], at.position[s, 2], gx, gy, gz, at.error[s], dx, dy, dz)
            direction[s, 0], direction[s, 1], direction[s, 2] = dx, dy, dz
            set_ray(packet, s, ox, oy, oz, dx, dy, dz, _0, np.float32(np.inf), DIFFUSE)
            rays += 1
        intersect_packet(scene.rays, OPAQUE, packet, n)
        hidden = 0
        for s in range(n):
            if not at.valid[s] or (probe > 0 and not at.valid[s] & 2):
                continue
            contact = CONTACT * at.footprint[s]
            meets = _meets_back_or_touches(scene, packet, s, direction[s, 0], direction[s, 1], direction[s, 2], contact)
            at.valid[s] = 3 if meets else 1
            hidden += meets
        if hidden == 0:
            break
    if hidden > 0:
        for s in range(n):
            at.valid[s] = at.valid[s] == 1
    return rays


@kernel
def _drop_beyond_walls(scene, packet, at, seed, texel):
    """Clears `at.valid` of the samples that do not see the one nearest to the texel's middle; the rays traced."""
    n = len(at.valid)
    anchor, nearest = -1, np.float32(np.inf)
    for s in range(n):
        if at.valid[s]:
            jx, jy = pixel_sample(s, seed, texel)
            d = (jx - np.float32(0.5)) ** 2 + (jy - np.float32(0.5)) ** 2
            if d < nearest:
                anchor, nearest = s, d
    rays = 0
    for s in range(n):
        disable_ray(packet, s)
        # Around an edge of one chart the straight line is no way.
        if s == anchor or not at.valid[s] or _cosine(at.ng, s, anchor) < SAME_NORMAL:
            continue
        p, q, g, h = at.position[anchor], at.position[s], at.ng[anchor], at.ng[s]
        lift = max(LIFT * at.footprint[anchor], at.error[anchor])
        ox, oy, oz = p[0] + lift * g[0], p[1] + lift * g[1], p[2] + lift * g[2]
        lift = max(LIFT * at.footprint[s], at.error[s])
        ex, ey, ez = q[0] + lift * h[0], q[1] + lift * h[1], q[2] + lift * h[2]
        set_ray(packet, s, ox, oy, oz, ex - ox, ey - oy, ez - oz, _0, _1, DIFFUSE)
        rays += 1
    if rays > 0:
        occluded_packet(scene.rays, OPAQUE, packet, n)
        for s in range(n):
            if is_occluded(packet, s):
                at.valid[s] = 0
    return rays


@leaf
def _cosine(normals, i, j):
    return normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1] + normals[i, 2] * normals[j, 2]


@leaf
def _draw(at, flags, apart, seed, texel):
    """Sorts the samples that count by the surfaces that they show, and draws one of each, which stands for all: right in the mean.

    apart: each stands for itself.
    """
    n = len(at.valid)
    for s in range(n):
        at.first[s], at.standing[s] = -1, 0
    for s in range(n):
        if not at.valid[s] or at.first[s] >= 0:
            continue
        members = 0
        alone = apart or flags[at.material[s]] & NORMAL_MAPPED != 0  # whose normals differ from sample to sample
        for other in range(s, n):
            if other != s and (
                alone
                or not at.valid[other]
                or at.first[other] >= 0
                or at.material[other] != at.material[s]
                or _cosine(at.ng, s, other) < SAME_NORMAL
                or _farther(at, s, other, SAME_REACH * at.footprint[s])
            ):
                continue
            at.first[other] = s
            members += 1
        drawn = np.int64(uniform(seed, texel, s, 7) * np.float32(members))
        for other in range(s, n):
            if at.first[other] == s:
                if drawn == 0:
                    at.standing[other] = members
                drawn -= 1


@leaf
def _farther(at, i, j, reach):
    """Whether two samples lie farther from each other than that (m)."""
    d = _0
    for c in range(3):
        d += (at.position[i, c] - at.position[j, c]) ** 2
    return d > reach * reach


@leaf
def _spread_out(at, drawn, points, i):
    """Gives point i, which stands for the surface of the drawn sample, further places on it."""
    members = 0
    for s in range(len(at.valid)):
        if at.first[s] == at.first[drawn]:
            at.member[members] = s
            members += 1
    chosen = 0
    while at.member[chosen] != drawn:
        chosen += 1
    for j in range(SPREAD):
        other = at.member[further_member(chosen, j, members)]
        points.error[i] = max(points.error[i], at.error[other])
        for c in range(3):
            points.spread[i, j, c] = at.position[other, c] - at.position[drawn, c]
            points.varied[i, j + 1, TURNS + c] = at.ns[other, c] - at.ns[drawn, c]
            points.varied[i, j + 1, FACES + c] = at.ng[other, c] - at.ng[drawn, c]
        points.facet[i, j] = at.triangle[other]


@leaf
def _add_other_side(points, i, share, r, g, b, tr, tg, tb):
    """Makes point i the other side of the one before it, a translucent surface with the albedo (r, g, b) and the transmittance t."""
    j = i - 1
    for c in range(3):
        albedo = r if c == 0 else g if c == 1 else b
        through = tr if c == 0 else tg if c == 1 else tb
        through = share * through / (albedo + through) if through > _0 else _0
        points.albedo[i, c] = through
        points.albedo[j, c] *= _1 - through / share
        points.position[i, c], points.wo[i, c] = points.position[j, c], points.wo[j, c]
        points.ng[i, c], points.ns[i, c] = -points.ng[j, c], -points.ns[j, c]
        points.f0[i, c] = points.f90[i, c] = _0
        for k in range(SPREAD):
            points.spread[i, k, c] = points.spread[j, k, c]
            points.varied[i, k + 1, TURNS + c] = -points.varied[j, k + 1, TURNS + c]
            points.varied[i, k + 1, FACES + c] = -points.varied[j, k + 1, FACES + c]
    for k in range(SPREAD):
        points.facet[i, k] = points.facet[j, k]
    points.error[i], points.roughness[i] = points.error[j], points.roughness[j]
    points.pixel[i], points.triangle[i] = points.pixel[j], points.triangle[j]


@kernel
def shade_rows(scene, triangles, footprint, found, weights, y0, width, seed, materials, apart, points, state, layers):
    """Points and layers of the texels whose samples are given (as by `cover`); the numbers of points and rays.

    materials: whether to read albedo and emission.  apart: whether each sample has a point of its own.  points: room for one a sample, for two where there are translucent materials.
    """
    samples = found.shape[1]
    packet = new_packet()
    rows, surface = new_registers(scene.materials), np.zeros(SURFACE, np.float32)
    at = _new_samples(samples)
    direction = np.empty((samples, 3), np.float32)
    n_points = rays = 0
    for k in range(len(found)):
        texel = y0 * width + k
        for s in range(samples):
            at.valid[s] = found[k, s] >= 0
            if at.valid[s]:
                triangle = triangles[found[k, s]]
                x, y, z, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, weights[k, s, 0], weights[k, s, 1])
                at.position[s, 0], at.position[s, 1], at.position[s, 2] = x, y, z
                at.ng[s, 0], at.ng[s, 1], at.ng[s, 2] = gx, gy, gz
                sx, sy, sz = shading_normal(scene.corner_normals, triangle, weights[k, s, 0], weights[k, s, 1], gx, gy, gz)
                if sx * gx + sy * gy + sz * gz < 0:
                    sx, sy, sz = -sx, -sy, -sz
                at.ns[s, 0], at.ns[s, 1], at.ns[s, 2], at.triangle[s] = sx, sy, sz, triangle
                at.error[s], at.footprint[s], at.material[s] = error, footprint[found[k, s]], scene.material[triangle]
        inside = at.valid.astype(np.int64).sum()
        if inside == 0:
            continue
        rays += _drop_hidden(scene, packet, at, direction, hash_combine(seed, texel))
        left = at.valid.astype(np.int64).sum()
        if left <= (_1 - MOSTLY) * np.float32(inside):
            state[texel] = HIDDEN
            continue
        state[texel] = LIT
        if samples > 1:
            rays += _drop_beyond_walls(scene, packet, at, np.uint32(seed), texel)
        _draw(at, scene.materials.flags, apart, np.uint32(seed), texel)
        share = _1 / np.float32(at.valid.astype(np.int64).sum())
        out = layers[texel]
        for s in range(samples):
            if not at.valid[s]:
                continue
            triangle, u, v = triangles[found[k, s]], weights[k, s, 0], weights[k, s, 1]
            gx, gy, gz = at.ng[s, 0], at.ng[s, 1], at.ng[s, 2]
            sx, sy, sz = at.ns[s, 0], at.ns[s, 1], at.ns[s, 2]
            material = scene.material[triangle]
            mapped = scene.materials.flags[material] & NORMAL_MAPPED
            translucent = scene.materials.flags[material] & TRANSLUCENT
            if materials or mapped or translucent:
                evaluate(scene.materials, material, scene.attributes, triangle, u, v, np.float32(MEAN_VIEW), rows, surface)
            if mapped:
                sx, sy, sz = surface[NORMAL], surface[NORMAL + 1], surface[NORMAL + 2]
            if sx * gx + sy * gy + sz * gz < 0:
                sx, sy, sz = -sx, -sy, -sz
            tilt = surface[TILT] if mapped else _0
            lit = mean_shadowing(tilt)
            tr = tg = tb = _0
            if translucent:
                tr, tg, tb = translucency_average(surface)
            if materials:
                r, g, b = diffuse_albedo_average(surface)
                out[ALBEDO] += share * (r + tr)
                out[ALBEDO + 1] += share * (g + tg)
                out[ALBEDO + 2] += share * (b + tb)
            for c in range(3):
                if materials:
                    out[EMITTED + c] += share * surface[EMISSION + c]
                out[POSITION + c] += share * at.position[s, c]
            out[NORMALS] += share * sx
            out[NORMALS + 1] += share * sy
            out[NORMALS + 2] += share * sz
            if at.standing[s] == 0:
                continue
            part = np.float32(at.standing[s]) * share
            for c in range(3):
                points.position[n_points, c] = at.position[s, c]
                points.ng[n_points, c] = points.wo[n_points, c] = at.ng[s, c]
                points.albedo[n_points, c] = lit * part
                points.f0[n_points, c] = points.f90[n_points, c] = _0
            points.ns[n_points, 0], points.ns[n_points, 1], points.ns[n_points, 2] = sx, sy, sz
            points.error[n_points], points.roughness[n_points], points.tilt[n_points] = at.error[s], _1, tilt
            points.pixel[n_points], points.triangle[n_points] = texel, triangle
            _spread_out(at, s, points, n_points)
            n_points += 1
            if tr + tg + tb > _0:
                r, g, b = diffuse_albedo_average(surface)
                _add_other_side(points, n_points, part, r, g, b, tr, tg, tb)
                n_points += 1
    return n_points, rays


def view_texels(
    scene: Transport,
    charts: Charts,
    size: tuple[int, int],
    samples: int,
    seed: int,
    threads: int = 0,
    progress: Progress | None = None,
    *,
    materials: bool = False,
) -> Texels:
    """The texels of an image of `size` (width, height) that `charts` cover, by `samples` (1 to 16) samples each.

    materials: whether albedo and emission are wanted.
    """
    if not 1 <= samples <= MOST_SAMPLES:
        raise ValueError(f"{samples} samples a texel; wanted 1 to {MOST_SAMPLES}")
    width, height = size
    layers = np.zeros((height * width, LAYERS), np.float32)
    state = np.zeros(height * width, np.uint8)
    footprint = _footprints(scene, charts)

    def work(begin, end):
        texels = (end - begin) * width
        found, weights = np.empty((texels, samples), np.int32), np.empty((texels, samples, 2), np.float32)
        cover(charts.uv, begin, end, width, samples, np.uint32(seed), found, weights, np.empty(texels, np.float32))
        room = ShadingPoints.allocate(int((found >= 0).sum()) * (1 + is_translucent(scene)))
        n, rays = shade_rows(
            scene, charts.triangle, footprint, found, weights, begin, width, np.uint32(seed), materials, False, room, state, layers
        )
        return room.first(n), rays

    parts = run_chunks(work, height, ROWS, threads, progress)
    shaped = layers.reshape(height, width, LAYERS)
    return Texels(
        ShadingPoints.concatenate([part for part, _ in parts]),
        state.reshape(height, width),
        *(np.ascontiguousarray(shaped[..., start : start + 3]) for start in (ALBEDO, EMITTED, NORMALS, POSITION)),
        sum(rays for _, rays in parts),
    )


def _footprints(scene: Transport, charts: Charts) -> np.ndarray:
    """(T,) float32, side of a texel on each triangle (m)."""
    a, b, c = (scene.vertices[scene.triangles[charts.triangle, k]].astype(np.float64) for k in range(3))
    e, f = (charts.uv[:, k].astype(np.float64) - charts.uv[:, 0] for k in (1, 2))
    texels = np.abs(e[:, 0] * f[:, 1] - f[:, 0] * e[:, 1])
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return np.sqrt(area / np.maximum(texels, 1e-12)).astype(np.float32)
