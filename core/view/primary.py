"""From camera rays to pixel layers and shading points, one 4x4 pixel tile at a time.

A pixel's value is the mean over its square (design.md, section 3): P stratified primary samples, which
all count for albedo, emission and coverage, while light is computed once for each distinct surface among
them, as multisample antialiasing does.  Nothing is kept per sample beyond its tile.

Surfaces with transparency are passed through at random, with exact weights, as Cycles does.  At the first surfaces of
glass nothing is left to chance: a sample shows both what they reflect and what lies behind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..film import SQUARE, Film
from ..jit import inlined, kernel, leaf
from ..lamps.groups import LightGroups
from ..lamps.tables import SEEN_BY_CAMERA, SEEN_THROUGH_GLASS
from ..lamps.world import world_radiance
from ..rays.offsets import hit_point
from ..rays.packet import T_FAR, WIDTH, disable_ray, hit_t, hit_triangle, hit_u, hit_v, new_packet, set_ray
from ..rays.trace import ALL, COHERENT, intersect_packet
from ..sampling.hashing import uniform
from ..scene import CAMERA, NORMAL_MAPPED, TRANSMISSION, TRANSPARENT, Scene
from ..surfaces.arithmetic import normalized
from ..surfaces.layout import (
    EMISSION,
    GLOSSY_F0,
    GLOSSY_F90,
    NORMAL,
    REFRACTION,
    ROUGHNESS,
    SURFACE,
    TRANSPARENCY,
    diffuse_albedo,
    largest_kept,
)
from ..surfaces.normals import shading_normal
from ..surfaces.program import evaluate, new_registers, reflected_view
from ..threads import Progress, run_chunks
from .camera import camera_ray, camera_tables, pixel_sample
from .lamps import lamps_between, lamps_in_tile, visible_lamps
from .points import SPREAD, ShadingPoints

TILE = 4  # pixels along a tile's edge: 16 rays, one packet, for each sample index
PANES = 2  # surfaces of glass that a sample shows as well as what lies behind them
MAX_LAYERS = 64  # transparent surfaces that one primary ray passes at most
WORLD_DEPTH = np.float32(1e10)  # what Blender's depth pass has where nothing is hit

# Two samples of a pixel lie on one surface where their normals agree and neither leaves the other's plane
# by more than this part of the pixel's width there.
SAME_NORMAL = np.float32(0.9)
SAME_PLANE = np.float32(0.5)
SAME_REACH = np.float32(3.0)
# Columns of the pixels' layers; what is emitted by each light group, behind no glass, one surface of it, and more, comes last.
ALBEDO, NORMALS, MEAN_NORMALS, POSITION, DEPTH, CLEAR, EMITTED = 0, 3, 6, 9, 12, 13, 14
GLASS = 3  # kinds of what is emitted: behind no glass, one surface of it, and more
# Bits of the way that a sample takes at a surface: it shows it, passes straight through, passes through glass.
SHOWN, STRAIGHT, REFRACTED = 1, 2, 4
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@dataclass
class View:
    """What the camera sees of a scene, before any light but that of surfaces, lamps and world themselves.

    albedo, normal, position: (H, W, 3);  depth: (H, W); all float32.  Where there is glass they are the pane's.
    mean_normal: (H, W, 3) float32, of all samples; `normal`, position and depth are those of the nearest one.
    clear: (H, W) float32, the part of each pixel in which the camera sees the world, behind no glass.
    emitted: (G, 3, H, W, 3) float32, light of each light group that is emitted behind no glass, one surface of it, and more.
    points: the shading points, whose `pixel` counts row-major over H x W.  rays: primary rays traced.
    """

    albedo: np.ndarray
    normal: np.ndarray
    mean_normal: np.ndarray
    position: np.ndarray
    depth: np.ndarray
    clear: np.ndarray
    emitted: np.ndarray
    points: ShadingPoints
    rays: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.depth.shape

    @property
    def emission(self) -> np.ndarray:
        """(H, W, 3) float32, what all light groups emit behind no glass."""
        return self.emitted[:, 0].sum(axis=0)

    @property
    def emission_behind_one(self) -> np.ndarray:
        """The same behind one surface of glass."""
        return self.emitted[:, 1].sum(axis=0)

    @property
    def emission_behind_more(self) -> np.ndarray:
        """The same behind several."""
        return self.emitted[:, 2].sum(axis=0)


@kernel
def _same_surface(px, py, pz, nx, ny, nz, qx, qy, qz, mx, my, mz, width):
    """Whether two samples (positions p, q; normals n, m) may share their light, `width` m being the pixel's there."""
    if nx * mx + ny * my + nz * mz < SAME_NORMAL:
        return False
    dx, dy, dz = px - qx, py - qy, pz - qz
    if abs(dx * nx + dy * ny + dz * nz) > SAME_PLANE * width or abs(dx * mx + dy * my + dz * mz) > SAME_PLANE * width:
        return False
    reach = SAME_REACH * width
    return dx * dx + dy * dy + dz * dz < reach * reach


class _Samples(NamedTuple):
    """What the 16 pixels of a tile show: P samples each, and after them the panes of glass that these look through.

    count: (16,) int32, rows of each pixel, at most R = (1 + PANES) P.
    hits: (16, R, 3) float32, bits of the triangle (-1 for none), u and v.  weight, direction: (16, R, 3) float32.
    depth: (16, R) float32 (m).  glass: (16, R) int32, surfaces of glass before it.
    lamps: (16, GLASS, G, 3) float32, light of the lamps in view, summed over the samples, by the surfaces of glass before it.
    """

    count: np.ndarray
    hits: np.ndarray
    weight: np.ndarray
    direction: np.ndarray
    depth: np.ndarray
    glass: np.ndarray
    lamps: np.ndarray


@kernel
def _new_samples(samples, light_groups):
    """Room for a tile."""
    f, rows = np.float32, (1 + PANES) * samples
    return _Samples(
        np.empty(WIDTH, np.int32), np.empty((WIDTH, rows, 3), f), np.empty((WIDTH, rows, 3), f), np.empty((WIDTH, rows, 3), f),
        np.empty((WIDTH, rows), f), np.empty((WIDTH, rows), np.int32), np.empty((WIDTH, GLASS, light_groups, 3), f),
    )  # fmt: skip


@inlined
def _view_cosine(vertices, triangles, corner_normals, triangle, u, v, dx, dy, dz, glass):
    """Cosine for `program.evaluate` of a view along d that has passed `glass` surfaces of glass."""
    a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
    ex, ey, ez = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    fx, fy, fz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    gx, gy, gz = normalized(ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx)
    sx, sy, sz = shading_normal(corner_normals, triangle, u, v, gx, gy, gz)
    cosine = min(_1, abs(sx * dx + sy * dy + sz * dz))
    cosine = -cosine if gx * dx + gy * dy + gz * dz > 0 else cosine
    return reflected_view(cosine) if glass > 0 else cosine


@leaf
def _way_on(surface, x, split):
    """What a sample shows of a surface with transparency: (way, r, g, b, w).

    x: uniform in [0, 1), picks a way in proportion to what there is to see.  split: glass shows both itself and what
    lies behind, as several samples would.  (r, g, b) weighs what lies behind, w the surface itself.
    """
    rr, rg, rb = surface[REFRACTION], surface[REFRACTION + 1], surface[REFRACTION + 2]
    tr, tg, tb = surface[TRANSPARENCY] - rr, surface[TRANSPARENCY + 1] - rg, surface[TRANSPARENCY + 2] - rb
    straight, refracted, kept = max(tr, tg, tb), max(rr, rg, rb), largest_kept(surface)
    total = straight + refracted + kept
    x *= total
    if x < straight:
        w = total / straight
        return STRAIGHT, w * tr, w * tg, w * tb, _0
    if split and refracted > _0:
        w = total / (refracted + kept)
        return SHOWN | REFRACTED, w * rr, w * rg, w * rb, w
    if x < straight + refracted:
        w = total / refracted
        return REFRACTED, w * rr, w * rg, w * rb, _0
    return SHOWN, _0, _0, _0, total / kept if kept > _0 else _1


@inlined
def _filtered(film, u):
    """Where in the pixel a sample lies, by a uniform u in [0, 1) and the offsets of `Film`."""
    x = u * np.float32(len(film) - 1)
    at = min(np.int64(x), len(film) - 2)
    return np.float32(0.5) + film[at] + (x - np.float32(at)) * (film[at + 1] - film[at])


@kernel
def _trace_tile(rays, camera, film, materials, geometry, lamps, tx, ty, samples, seed, packet, rows, surface, seen):
    """Trace the samples of the tile whose first pixel is (tx, ty) into `seen`; the number of rays."""
    vertices, triangle_vertices, corner_normals, attributes, material, _, _ = geometry
    hits, weight, direction, depth, glass = seen.hits, seen.weight, seen.direction, seen.depth, seen.glass
    x1, y1 = camera.border[2], camera.border[3]
    origin = np.empty((WIDTH, 3), np.float32)
    passed = np.empty(WIDTH, np.float32)
    near_lamps = np.empty(len(lamps.kind), np.int32)
    reach = 0 if len(film) == 0 else max(0, np.int64(math.ceil(film[len(film) - 1] - np.float32(0.5))))  # pixels beyond its square
    n_lamps = lamps_in_tile(lamps, camera, tx - reach, ty - reach, tx + TILE + reach, ty + TILE + reach, near_lamps)
    seen.lamps[:] = np.float32(0.0)
    seen.count[:] = samples
    count = 0
    triangles = hits.view(np.int32)
    for s in range(samples):
        for lane in range(WIDTH):
            px, py = tx + lane % TILE, ty + lane // TILE
            triangles[lane, s, 0] = -1
            if px >= x1 or py >= y1:
                disable_ray(packet, lane)
                continue
            # Numbered by the full frame: a border shows the very pixels of the whole picture.
            number = py * camera.size[0] + px
            jx, jy = pixel_sample(s, seed, number)
            if len(film) > 0:
                jx, jy = _filtered(film, jx), _filtered(film, jy)
            ox, oy, oz, dx, dy, dz, slant = camera_ray(camera, np.float32(px) + jx, np.float32(py) + jy)
            set_ray(packet, lane, ox, oy, oz, dx, dy, dz, np.float32(0.0), (camera.clip[1] - camera.clip[0]) * slant, CAMERA)
            origin[lane, 0], origin[lane, 1], origin[lane, 2] = ox, oy, oz
            direction[lane, s, 0], direction[lane, s, 1], direction[lane, s, 2] = dx, dy, dz
            weight[lane, s, 0] = weight[lane, s, 1] = weight[lane, s, 2] = np.float32(1.0)
            depth[lane, s] = WORLD_DEPTH
            glass[lane, s] = 0
            passed[lane] = np.float32(0.0)
            count += 1
        layer = 0
        active = True
        while active and layer < MAX_LAYERS:
            intersect_packet(rays, ALL | COHERENT, packet, WIDTH)
            active = False
            for lane in range(WIDTH):
                triangle = hit_triangle(packet, lane)
                if packet.f[T_FAR * WIDTH + lane] < 0:  # done already
                    continue
                if n_lamps > 0:
                    end = hit_t(packet, lane) if triangle >= 0 else np.float32(np.inf)
                    lamps_between(
                        lamps, near_lamps, n_lamps, SEEN_THROUGH_GLASS if glass[lane, s] > 0 else SEEN_BY_CAMERA,
                        origin[lane, 0], origin[lane, 1], origin[lane, 2],
                        direction[lane, s, 0], direction[lane, s, 1], direction[lane, s, 2], passed[lane], end,
                        weight[lane, s], seen.lamps[lane, min(glass[lane, s], 2)],
                    )  # fmt: skip
                if triangle < 0:
                    disable_ray(packet, lane)
                    continue
                u, v, t = hit_u(packet, lane), hit_v(packet, lane), hit_t(packet, lane)
                dx, dy, dz = direction[lane, s, 0], direction[lane, s, 1], direction[lane, s, 2]
                axial = -(dx * camera.matrix[0, 2] + dy * camera.matrix[1, 2] + dz * camera.matrix[2, 2])
                way, r, g, b, w = SHOWN, _0, _0, _0, _1
                if materials.flags[material[triangle]] & TRANSPARENT:
                    cosine = _view_cosine(vertices, triangle_vertices, corner_normals, triangle, u, v, dx, dy, dz, glass[lane, s])
                    evaluate(materials, material[triangle], attributes, triangle, u, v, cosine, rows, surface)
                    number = (ty + lane // TILE) * camera.size[0] + tx + lane % TILE
                    way, r, g, b, w = _way_on(surface, uniform(seed, number, s, 2 + layer), glass[lane, s] < PANES)
                if way & SHOWN:
                    row = s
                    if way != SHOWN:  # the sample goes on beyond a pane, which gets a row of its own
                        row = seen.count[lane]
                        seen.count[lane] += 1
                        glass[lane, row] = glass[lane, s]
                        direction[lane, row, 0], direction[lane, row, 1], direction[lane, row, 2] = dx, dy, dz
                    for c in range(3):
                        weight[lane, row, c] = w * weight[lane, s, c]
                    triangles[lane, row, 0] = triangle
                    hits[lane, row, 1], hits[lane, row, 2] = u, v
                    depth[lane, row] = camera.clip[0] + t * axial
                if way == SHOWN:
                    disable_ray(packet, lane)
                    continue
                weight[lane, s, 0] *= r
                weight[lane, s, 1] *= g
                weight[lane, s, 2] *= b
                if way & REFRACTED:
                    glass[lane, s] += 1
                # Past the hit by a few rounding errors of t, so that the surface is not met again.
                start = t + np.float32(4e-6) * (t + camera.clip[0])
                far = (camera.clip[1] - camera.clip[0]) / axial
                kinds = TRANSMISSION if glass[lane, s] > 0 else CAMERA
                set_ray(packet, lane, origin[lane, 0], origin[lane, 1], origin[lane, 2], dx, dy, dz, start, far, kinds)
                passed[lane] = t
                count += 1
                active = True
            layer += 1
    return count


@kernel
def _view_tiles(
    rays, camera, film, materials, geometry, lamps, world, world_visibility, world_group, begin, end, samples, seed, points, layers
):  # fmt: skip
    """Trace, evaluate and group the samples of the tiles begin..end-1.

    film: (K,) float32 as `Film.offsets` has them.
    geometry: (vertices, triangles, corner_normals, attributes, material, object, light group of each object).
    world_group: light group of the world.  points: room for all that can come.  layers: (H * W, EMITTED + 9 G) float32.
    Returns the number of points and of rays.
    """
    vertices, triangle_vertices, corner_normals, attributes, material, object_of, light_group = geometry
    light_groups = (layers.shape[1] - EMITTED) // (3 * GLASS)
    x0, y0, x1, y1 = camera.border[0], camera.border[1], camera.border[2], camera.border[3]
    width = x1 - x0
    tiles_x = (width + TILE - 1) // TILE
    share = np.float32(1.0 / samples)
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    rows = new_registers(materials)
    seen = _new_samples(samples, light_groups)
    weight, direction, depth, glass = seen.weight, seen.direction, seen.depth, seen.glass
    triangles = seen.hits.view(np.int32)
    # Of each row of a pixel: position, error, ng, ns.  Of each group: first row; count and sums.
    most = (1 + PANES) * samples
    sample = np.empty((most, 10), np.float32)
    group_of = np.empty(most, np.int32)
    first, member = np.empty(most, np.int32), np.empty(most, np.int32)
    group = np.empty((most, 11), np.float32)
    pixel_width = abs(camera.window[1] - camera.window[0]) / np.float32(camera.size[0])
    n_points = 0
    n_rays = 0
    for tile in range(begin, end):
        tx = x0 + (tile % tiles_x) * TILE
        ty = y0 + (tile // tiles_x) * TILE
        n_rays += _trace_tile(rays, camera, film, materials, geometry, lamps, tx, ty, samples, seed, packet, rows, surface, seen)
        for lane in range(WIDTH):
            px, py = tx + lane % TILE, ty + lane // TILE
            if px >= x1 or py >= y1:
                continue
            pixel = (py - y0) * width + (px - x0)
            out = layers[pixel]
            for before in range(GLASS):
                for lit_by in range(light_groups):
                    for c in range(3):
                        out[EMITTED + 3 * (GLASS * lit_by + before) + c] = share * seen.lamps[lane, before, lit_by, c]
            nearest = -1
            groups = 0
            for s in range(seen.count[lane]):
                triangle = triangles[lane, s, 0]
                dx, dy, dz = direction[lane, s, 0], direction[lane, s, 1], direction[lane, s, 2]
                wr, wg, wb = weight[lane, s, 0] * share, weight[lane, s, 1] * share, weight[lane, s, 2] * share
                behind_glass = glass[lane, s] > 0
                before = EMITTED + 3 * min(glass[lane, s], 2)
                group_of[s] = -1
                if triangle < 0:
                    emitted = before + 3 * GLASS * world_group
                    if not behind_glass:
                        out[CLEAR] += (wr + wg + wb) * np.float32(1 / 3)
                    if world_visibility & (TRANSMISSION if behind_glass else CAMERA):
                        er, eg, eb = world_radiance(world, dx, dy, dz)
                        out[emitted] += wr * er
                        out[emitted + 1] += wg * eg
                        out[emitted + 2] += wb * eb
                    continue
                u, v = seen.hits[lane, s, 1], seen.hits[lane, s, 2]
                x, y, z, gx, gy, gz, error = hit_point(vertices, triangle_vertices, triangle, u, v)
                sx, sy, sz = shading_normal(corner_normals, triangle, u, v, gx, gy, gz)
                behind = gx * dx + gy * dy + gz * dz > 0
                cosine = min(_1, abs(sx * dx + sy * dy + sz * dz))
                signed = -cosine if behind else cosine
                view_cosine = reflected_view(signed) if behind_glass else signed
                evaluate(materials, material[triangle], attributes, triangle, u, v, view_cosine, rows, surface)
                if materials.flags[material[triangle]] & NORMAL_MAPPED:
                    sx, sy, sz = surface[NORMAL], surface[NORMAL + 1], surface[NORMAL + 2]
                    cosine = min(_1, abs(sx * dx + sy * dy + sz * dz))
                if behind:
                    gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
                ar, ag, ab = diffuse_albedo(surface, cosine)
                ar, ag, ab = ar * wr, ag * wg, ab * wb
                if not behind_glass:
                    out[ALBEDO] += ar
                    out[ALBEDO + 1] += ag
                    out[ALBEDO + 2] += ab
                    part = (wr + wg + wb) * np.float32(1 / 3)
                    out[MEAN_NORMALS] += part * sx
                    out[MEAN_NORMALS + 1] += part * sy
                    out[MEAN_NORMALS + 2] += part * sz
                emitted = before + 3 * GLASS * light_group[object_of[triangle]]
                out[emitted] += wr * surface[EMISSION]
                out[emitted + 1] += wg * surface[EMISSION + 1]
                out[emitted + 2] += wb * surface[EMISSION + 2]
                sample[s, 0], sample[s, 1], sample[s, 2], sample[s, 3] = x, y, z, error
                sample[s, 4], sample[s, 5], sample[s, 6] = gx, gy, gz
                sample[s, 7], sample[s, 8], sample[s, 9] = sx, sy, sz
                if nearest < 0 or depth[lane, s] < depth[lane, nearest]:
                    nearest = s
                footprint = pixel_width if camera.orthographic else pixel_width * depth[lane, s]
                k = 0
                while k < groups:
                    f = first[k]
                    alike = object_of[triangles[lane, f, 0]] == object_of[triangle] and (glass[lane, f] > 0) == behind_glass
                    if alike and _same_surface(
                        x, y, z, sx, sy, sz, sample[f, 0], sample[f, 1], sample[f, 2], sample[f, 7], sample[f, 8], sample[f, 9], footprint
                    ):
                        break
                    k += 1
                if k == groups:
                    groups += 1
                    first[k] = s
                    group[k, :] = np.float32(0.0)
                group_of[s] = k
                group[k, 0] += np.float32(1.0)
                group[k, 1] += ar
                group[k, 2] += ag
                group[k, 3] += ab
                group[k, 4] += surface[GLOSSY_F0] * wr
                group[k, 5] += surface[GLOSSY_F0 + 1] * wg
                group[k, 6] += surface[GLOSSY_F0 + 2] * wb
                group[k, 7] += surface[GLOSSY_F90] * wr
                group[k, 8] += surface[GLOSSY_F90 + 1] * wg
                group[k, 9] += surface[GLOSSY_F90 + 2] * wb
                group[k, 10] += surface[ROUGHNESS]
            if nearest < 0:
                out[DEPTH] = WORLD_DEPTH
                continue
            for c in range(3):
                out[NORMALS + c], out[POSITION + c] = sample[nearest, 7 + c], sample[nearest, c]
            out[DEPTH] = depth[lane, nearest]
            for k in range(groups):
                reflected = _0
                for c in range(1, 10):
                    reflected += group[k, c]
                if not reflected > 0:  # black: no light would show
                    continue
                # A member drawn at random stands for all: right in the mean, however steeply the light varies in the pixel.
                inverse = np.float32(1.0) / group[k, 0]
                number = py * camera.size[0] + px
                members = np.int64(group[k, 0])
                left = np.int64(uniform(seed, number, k, 1) * group[k, 0])
                n = 0
                for s in range(seen.count[lane]):
                    if group_of[s] == k:
                        member[n] = s
                        n += 1
                best = member[min(left, members - 1)]
                i = n_points
                n_points += 1
                for c in range(3):
                    points.position[i, c] = sample[best, c]
                    points.ng[i, c] = sample[best, 4 + c]
                    points.ns[i, c] = sample[best, 7 + c]
                    points.wo[i, c] = -direction[lane, best, c]
                    points.albedo[i, c] = group[k, 1 + c]
                    points.f0[i, c] = group[k, 4 + c]
                    points.f90[i, c] = group[k, 7 + c]
                points.error[i] = sample[best, 3]
                for j in range(SPREAD):
                    other = member[(left + (j + 1) * members // (SPREAD + 1)) % members]
                    points.error[i] = max(points.error[i], sample[other, 3])
                    for c in range(3):
                        points.spread[i, j, c] = sample[other, c] - sample[best, c]
                points.pixel[i] = pixel
                points.triangle[i] = triangles[lane, best, 0]
                points.roughness[i] = group[k, 10] * inverse
                points.behind_glass[i] = glass[lane, best] > 0
    return n_points, n_rays


def view(
    scene: Scene, rays, world, samples: int, seed: int, threads: int = 0, progress: Progress | None = None,
    groups: LightGroups | None = None, film: Film = SQUARE,
) -> View:  # fmt: skip
    """Trace `samples` primary rays a pixel of the camera's border; `rays` and `world` are the tables of those rooms.

    groups: the light groups to tell apart, None for none.  film: how the samples lie in a pixel, and whether they see the world.
    """
    groups = LightGroups.one(scene) if groups is None else groups
    camera = camera_tables(scene.camera)
    x0, y0, x1, y1 = (int(b) for b in camera.border)
    height, width = y1 - y0, x1 - x0
    layers = np.zeros((height * width, EMITTED + 3 * GLASS * len(groups.names)), np.float32)
    tiles = -(-width // TILE) * -(-height // TILE)
    chunk = 64
    g = scene.geometry
    geometry = (g.vertices, g.triangles, g.corner_normals, g.attributes, g.material, g.object, groups.objects)
    lamps = visible_lamps(scene, groups)
    offsets = film.offsets()
    seen_by = scene.world.visibility & ~CAMERA if film.transparent else scene.world.visibility

    def work(begin, end):
        room = ShadingPoints.allocate((end - begin) * WIDTH * (1 + PANES) * samples)
        n, n_rays = _view_tiles(
            rays, camera, offsets, scene.materials.tables, geometry, lamps, world, seen_by, groups.world,
            begin, end, samples, np.uint32(seed), room, layers,
        )  # fmt: skip
        return room.first(n), n_rays

    parts = run_chunks(work, tiles, chunk, threads, progress)
    shaped = layers.reshape(height, width, -1)
    emitted = shaped[..., EMITTED:].reshape(height, width, len(groups.names), GLASS, 3)
    return View(
        *(np.ascontiguousarray(shaped[..., at : at + 3]) for at in (ALBEDO, NORMALS, MEAN_NORMALS, POSITION)),
        *(np.ascontiguousarray(shaped[..., at]) for at in (DEPTH, CLEAR)),
        np.ascontiguousarray(emitted.transpose(2, 3, 0, 1, 4)),
        ShadingPoints.concatenate([part for part, _ in parts]),
        sum(n for _, n in parts),
    )
