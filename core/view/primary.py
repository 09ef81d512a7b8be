"""From camera rays to pixel layers and shading points, one 4x4 pixel tile at a time.

A pixel's value is the mean over its square (design.md, section 3): P stratified primary samples, which
all count for albedo, emission and coverage, while light is computed once for each distinct surface among
them, as multisample antialiasing does.  Nothing is kept per sample beyond its tile.

Surfaces with transparency are passed through at random, with exact weights, as Cycles does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..jit import kernel
from ..lamps.world import world_radiance
from ..rays.offsets import hit_point
from ..rays.packet import T_FAR, WIDTH, disable_ray, hit_t, hit_triangle, hit_u, hit_v, new_packet, set_ray
from ..rays.trace import ALL, COHERENT, intersect_packet
from ..sampling.hashing import uniform
from ..scene import CAMERA, NORMAL_MAPPED, TRANSPARENT, Scene
from ..surfaces.layout import EMISSION, GLOSSY_F0, GLOSSY_F90, NORMAL, ROUGHNESS, SURFACE, TRANSPARENCY, diffuse_albedo, passing_chance
from ..surfaces.normals import shading_normal
from ..surfaces.program import evaluate, new_registers
from ..threads import Progress, run_chunks
from .camera import camera_ray, camera_tables, pixel_sample
from .lamps import lamps_between, lamps_in_tile, visible_lamps
from .points import ShadingPoints

TILE = 4  # pixels along a tile's edge: 16 rays, one packet, for each sample index
MAX_LAYERS = 64  # transparent surfaces that one primary ray passes at most
WORLD_DEPTH = np.float32(1e10)  # what Blender's depth pass has where nothing is hit

# Two samples of a pixel lie on one surface where their normals agree and neither leaves the other's plane
# by more than this part of the pixel's width there.
SAME_NORMAL = np.float32(0.9)
SAME_PLANE = np.float32(0.5)
SAME_REACH = np.float32(3.0)
_1 = np.float32(1.0)


@dataclass
class View:
    """What the camera sees of a scene, before any light but that of surfaces, lamps and world themselves.

    albedo, emission: (H, W, 3);  normal, position: (H, W, 3);  depth: (H, W); all float32.
    points: the shading points, whose `pixel` counts row-major over H x W.  rays: primary rays traced.
    """

    albedo: np.ndarray
    emission: np.ndarray
    normal: np.ndarray
    position: np.ndarray
    depth: np.ndarray
    points: ShadingPoints
    rays: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.depth.shape


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


@kernel
def _trace_tile(
    rays,
    camera,
    materials,
    material,
    attributes,
    lamps,
    tx,
    ty,
    samples,
    seed,
    packet,
    rows,
    surface,
    hits,
    weight,
    direction,
    depth,
    shine,
):
    """Trace the samples of one tile. hits: (16, P, 3) float32 bits of triangle, u, v; the number of rays comes back.

    shine: (16, 3) float32, the sum over a pixel's samples of the lamps' light in front of the surfaces.
    """
    x1, y1 = camera.border[2], camera.border[3]
    origin = np.empty((WIDTH, 3), np.float32)
    passed = np.empty(WIDTH, np.float32)
    near_lamps = np.empty(len(lamps.kind), np.int32)
    n_lamps = lamps_in_tile(lamps, camera, tx, ty, tx + TILE, ty + TILE, near_lamps)
    shine[:] = np.float32(0.0)
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
            ox, oy, oz, dx, dy, dz, slant = camera_ray(camera, np.float32(px) + jx, np.float32(py) + jy)
            set_ray(packet, lane, ox, oy, oz, dx, dy, dz, np.float32(0.0), (camera.clip[1] - camera.clip[0]) * slant, CAMERA)
            origin[lane, 0], origin[lane, 1], origin[lane, 2] = ox, oy, oz
            direction[lane, s, 0], direction[lane, s, 1], direction[lane, s, 2] = dx, dy, dz
            weight[lane, s, 0] = weight[lane, s, 1] = weight[lane, s, 2] = np.float32(1.0)
            depth[lane, s] = WORLD_DEPTH
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
                    r, g, b = lamps_between(
                        lamps, near_lamps, n_lamps, origin[lane, 0], origin[lane, 1], origin[lane, 2],
                        direction[lane, s, 0], direction[lane, s, 1], direction[lane, s, 2], passed[lane], end,
                    )  # fmt: skip
                    shine[lane, 0] += weight[lane, s, 0] * r
                    shine[lane, 1] += weight[lane, s, 1] * g
                    shine[lane, 2] += weight[lane, s, 2] * b
                if triangle < 0:
                    disable_ray(packet, lane)
                    continue
                u, v, t = hit_u(packet, lane), hit_v(packet, lane), hit_t(packet, lane)
                dx, dy, dz = direction[lane, s, 0], direction[lane, s, 1], direction[lane, s, 2]
                axial = -(dx * camera.matrix[0, 2] + dy * camera.matrix[1, 2] + dz * camera.matrix[2, 2])
                if materials.flags[material[triangle]] & TRANSPARENT:
                    evaluate(materials, material[triangle], attributes, triangle, u, v, _1, rows, surface)
                    tr, tg, tb = surface[TRANSPARENCY], surface[TRANSPARENCY + 1], surface[TRANSPARENCY + 2]
                    chance = passing_chance(surface)
                    number = (ty + lane // TILE) * camera.size[0] + tx + lane % TILE
                    if uniform(seed, number, s, 2 + layer) < chance:
                        weight[lane, s, 0] *= tr / chance
                        weight[lane, s, 1] *= tg / chance
                        weight[lane, s, 2] *= tb / chance
                        # Past the hit by a few rounding errors of t, so that the surface is not met again.
                        start = t + np.float32(4e-6) * (t + camera.clip[0])
                        far = (camera.clip[1] - camera.clip[0]) / axial
                        set_ray(packet, lane, origin[lane, 0], origin[lane, 1], origin[lane, 2], dx, dy, dz, start, far, CAMERA)
                        passed[lane] = t
                        count += 1
                        active = True
                        continue
                    rest = _1 / (_1 - chance)  # what the surface keeps is already without what it lets through
                    weight[lane, s, 0] *= rest
                    weight[lane, s, 1] *= rest
                    weight[lane, s, 2] *= rest
                triangles[lane, s, 0] = triangle
                hits[lane, s, 1], hits[lane, s, 2] = u, v
                depth[lane, s] = camera.clip[0] + t * axial
                disable_ray(packet, lane)
            layer += 1
    return count


@kernel
def _view_tiles(rays, camera, materials, geometry, lamps, world, begin, end, samples, seed, points, layers):
    """Trace, evaluate and group the samples of the tiles begin..end-1.

    geometry: (vertices, triangles, corner_normals, attributes, material, object).  points: room for all that
    can come.  layers: (H * W, 13) float32: albedo, emission, normal, position, depth.
    Returns the number of points and of rays.
    """
    vertices, triangle_vertices, corner_normals, attributes, material, object_of = geometry
    x0, y0, x1, y1 = camera.border[0], camera.border[1], camera.border[2], camera.border[3]
    width = x1 - x0
    tiles_x = (width + TILE - 1) // TILE
    share = np.float32(1.0 / samples)
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    rows = new_registers(materials)
    hits = np.empty((WIDTH, samples, 3), np.float32)
    triangles = hits.view(np.int32)
    weight = np.empty((WIDTH, samples, 3), np.float32)
    direction = np.empty((WIDTH, samples, 3), np.float32)
    depth = np.empty((WIDTH, samples), np.float32)
    shine = np.empty((WIDTH, 3), np.float32)
    # Of each sample: position, error, ng, ns.  Of each group: first sample; count and sums.
    sample = np.empty((samples, 10), np.float32)
    group_of = np.empty(samples, np.int32)
    first = np.empty(samples, np.int32)
    group = np.empty((samples, 11), np.float32)
    pixel_width = abs(camera.window[1] - camera.window[0]) / np.float32(camera.size[0])
    n_points = 0
    n_rays = 0
    for tile in range(begin, end):
        tx = x0 + (tile % tiles_x) * TILE
        ty = y0 + (tile // tiles_x) * TILE
        n_rays += _trace_tile(
            rays,
            camera,
            materials,
            material,
            attributes,
            lamps,
            tx,
            ty,
            samples,
            seed,
            packet,
            rows,
            surface,
            hits,
            weight,
            direction,
            depth,
            shine,
        )
        for lane in range(WIDTH):
            px, py = tx + lane % TILE, ty + lane // TILE
            if px >= x1 or py >= y1:
                continue
            pixel = (py - y0) * width + (px - x0)
            out = layers[pixel]
            for c in range(3):
                out[3 + c] = share * shine[lane, c]
            nearest = -1
            groups = 0
            for s in range(samples):
                triangle = triangles[lane, s, 0]
                dx, dy, dz = direction[lane, s, 0], direction[lane, s, 1], direction[lane, s, 2]
                wr, wg, wb = weight[lane, s, 0] * share, weight[lane, s, 1] * share, weight[lane, s, 2] * share
                group_of[s] = -1
                if triangle < 0:
                    er, eg, eb = world_radiance(world, dx, dy, dz)
                    out[3] += wr * er
                    out[4] += wg * eg
                    out[5] += wb * eb
                    continue
                u, v = hits[lane, s, 1], hits[lane, s, 2]
                x, y, z, gx, gy, gz, error = hit_point(vertices, triangle_vertices, triangle, u, v)
                sx, sy, sz = shading_normal(corner_normals, triangle, u, v, gx, gy, gz)
                behind = gx * dx + gy * dy + gz * dz > 0
                cosine = min(_1, abs(sx * dx + sy * dy + sz * dz))
                evaluate(materials, material[triangle], attributes, triangle, u, v, -cosine if behind else cosine, rows, surface)
                if materials.flags[material[triangle]] & NORMAL_MAPPED:
                    sx, sy, sz = surface[NORMAL], surface[NORMAL + 1], surface[NORMAL + 2]
                    cosine = min(_1, abs(sx * dx + sy * dy + sz * dz))
                if behind:
                    gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
                ar, ag, ab = diffuse_albedo(surface, cosine)
                ar, ag, ab = ar * wr, ag * wg, ab * wb
                out[0] += ar
                out[1] += ag
                out[2] += ab
                out[3] += wr * surface[EMISSION]
                out[4] += wg * surface[EMISSION + 1]
                out[5] += wb * surface[EMISSION + 2]
                sample[s, 0], sample[s, 1], sample[s, 2], sample[s, 3] = x, y, z, error
                sample[s, 4], sample[s, 5], sample[s, 6] = gx, gy, gz
                sample[s, 7], sample[s, 8], sample[s, 9] = sx, sy, sz
                if nearest < 0 or depth[lane, s] < depth[lane, nearest]:
                    nearest = s
                footprint = pixel_width if camera.orthographic else pixel_width * depth[lane, s]
                k = 0
                while k < groups:
                    f = first[k]
                    if object_of[triangles[lane, f, 0]] == object_of[triangle] and _same_surface(
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
                out[12] = WORLD_DEPTH
                continue
            out[6], out[7], out[8] = sample[nearest, 7], sample[nearest, 8], sample[nearest, 9]
            out[9], out[10], out[11] = sample[nearest, 0], sample[nearest, 1], sample[nearest, 2]
            out[12] = depth[lane, nearest]
            for k in range(groups):
                light = np.float32(0.0)
                for c in range(1, 10):
                    light += group[k, c]
                if not light > 0:  # black: no light would show
                    continue
                # A member drawn at random stands for all: right in the mean, however steeply the light varies in the pixel.
                inverse = np.float32(1.0) / group[k, 0]
                number = py * camera.size[0] + px
                left = np.int64(uniform(seed, number, k, 1) * group[k, 0])
                best = -1
                for s in range(samples):
                    if group_of[s] == k:
                        best = s
                        left -= 1
                        if left < 0:
                            break
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
                points.pixel[i] = pixel
                points.triangle[i] = triangles[lane, best, 0]
                points.roughness[i] = group[k, 10] * inverse
    return n_points, n_rays


def view(scene: Scene, rays, world, samples: int, seed: int, threads: int = 0, progress: Progress | None = None) -> View:
    """Trace `samples` primary rays a pixel of the camera's border; `rays` and `world` are the tables of those rooms."""
    camera = camera_tables(scene.camera)
    x0, y0, x1, y1 = (int(b) for b in camera.border)
    height, width = y1 - y0, x1 - x0
    layers = np.zeros((height * width, 13), np.float32)
    tiles = -(-width // TILE) * -(-height // TILE)
    chunk = 16
    g = scene.geometry
    geometry = (g.vertices, g.triangles, g.corner_normals, g.attributes, g.material, g.object)
    lamps = visible_lamps(scene)

    def work(begin, end):
        room = ShadingPoints.allocate((end - begin) * WIDTH * samples)
        n, n_rays = _view_tiles(
            rays, camera, scene.materials.tables, geometry, lamps, world, begin, end, samples, np.uint32(seed), room, layers
        )
        return room.take(slice(0, n)), n_rays

    parts = run_chunks(work, tiles, chunk, threads, progress)
    shaped = layers.reshape(height, width, 13)
    return View(
        np.ascontiguousarray(shaped[..., 0:3]),
        np.ascontiguousarray(shaped[..., 3:6]),
        np.ascontiguousarray(shaped[..., 6:9]),
        np.ascontiguousarray(shaped[..., 9:12]),
        np.ascontiguousarray(shaped[..., 12]),
        ShadingPoints.concatenate([part for part, _ in parts]),
        sum(n for _, n in parts),
    )
