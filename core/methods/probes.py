"""Probes of the light in a scene: paths from the visible points, whose vertices fill the cache of light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..jit import kernel, leaf
from ..rays.offsets import hit_point, offset_origin
from ..rays.packet import new_packet
from ..sampling.hashing import uniform
from ..sampling.maps import cosine_hemisphere, to_world
from ..scene import DIFFUSE
from ..surfaces.layout import SURFACE
from ..surfaces.lobes import LOBE
from ..surfaces.normals import shading_normal, surface_side
from ..surfaces.program import new_registers
from ..surfaces.visibility import nearest_surface
from ..threads import Progress, run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints
from .light_cache import DEPTH, DIFFUSE_LINK, GLOSSY_LINK, Probes
from .tails import DIMENSIONS, scatter_light

# (scene, points, paths, seed, threads, progress) -> probes along about as many paths from the points, and the rays traced.
Tracer = Callable[[Transport, ShadingPoints, int, int, int, Progress | None], tuple[Probes, int]]

CHUNK = 512  # paths a chunk
LAMP_RAYS = 4  # shadow rays of a probe: what is stored serves many
_1 = np.float32(1.0)


@leaf
def _probe_path(scene, packet, rows, surface, lobe, probes, first, depth, x, y, z, error, gx, gy, gz, sx, sy, sz, seed, path):
    """One path from a visible point: up to `depth` probes from row `first` on, each with its link; the rays traced."""
    lx, ly, lz = cosine_hemisphere(uniform(seed, path, 0, 6), uniform(seed, path, 0, 7))
    dx, dy, dz = to_world(lx, ly, lz, sx, sy, sz)
    if gx * dx + gy * dy + gz * dz <= 0:
        return 0
    kinds = DIFFUSE
    rays = 0
    for vertex in range(depth + 1):
        at = (vertex + 1) * DIMENSIONS
        probe = first + vertex
        ox, oy, oz = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
        rays += 1
        triangle, u, v, t, r, g, b = nearest_surface(
            scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, np.float32(np.inf), kinds, seed, path, at + 8
        )
        if triangle < 0:
            return rays
        x, y, z, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
        sx, sy, sz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
        behind = gx * dx + gy * dy + gz * dz > 0
        side = surface_side(scene.material[triangle], behind)
        if behind:
            gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
        if vertex > 0:
            link = probe - 1
            probes.link[link] = DIFFUSE_LINK if kinds == DIFFUSE else GLOSSY_LINK  # translucent surfaces count as no bounce, either
            probes.link_position[link, 0], probes.link_position[link, 1], probes.link_position[link, 2] = x, y, z
            probes.link_side[link] = side
            probes.link_normal[link, 0], probes.link_normal[link, 1], probes.link_normal[link, 2] = gx, gy, gz
            probes.carry[link, 0] *= r
            probes.carry[link, 1] *= g
            probes.carry[link, 2] *= b
        if vertex == depth:
            return rays
        probes.valid[probe] = 1
        probes.distance[probe] = t
        probes.side[probe] = side
        probes.position[probe, 0], probes.position[probe, 1], probes.position[probe, 2] = x, y, z
        probes.normal[probe, 0], probes.normal[probe, 1], probes.normal[probe, 2] = gx, gy, gz
        tx, ty, tz, r, g, b, kinds = scatter_light(
            scene, packet, rows, surface, lobe, x, y, z, error, gx, gy, gz, sx, sy, sz, -dx, -dy, -dz, LAMP_RAYS, True, seed, path, at,
            probes.direct, probes.shine, probe, _1, _1, _1, _1,
        )  # fmt: skip
        rays += LAMP_RAYS
        probes.carry[probe, 0], probes.carry[probe, 1], probes.carry[probe, 2] = r, g, b
        if kinds == 0:
            return rays
        dx, dy, dz = tx, ty, tz
    return rays


@kernel
def _probe_chunk(scene, points, start, begin, end, depth, seed, probes):
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    lobe = np.zeros(LOBE, np.float32)
    rays = 0
    for path in range(begin, end):
        i = start[path]
        rays += _probe_path(
            scene, packet, rows, surface, lobe, probes, path * depth, depth,
            points.position[i, 0], points.position[i, 1], points.position[i, 2], points.error[i],
            points.ng[i, 0], points.ng[i, 1], points.ng[i, 2], points.ns[i, 0], points.ns[i, 1], points.ns[i, 2], seed, np.uint32(path),
        )  # fmt: skip
    return rays


def trace_probes(
    scene: Transport, points: ShadingPoints, paths: int, seed: int, threads: int = 0, progress: Progress | None = None
) -> tuple[Probes, int]:
    """Probes along `paths` paths that begin at points spread evenly over the view; the number of rays traced."""
    probes = Probes.allocate(paths * DEPTH, scene.emitters.light_groups)
    offsets = np.random.default_rng(seed).random(paths)
    start = np.minimum(((np.arange(paths) + offsets) * (len(points.pixel) / paths)).astype(np.int64), len(points.pixel) - 1)

    def work(begin, end):
        return _probe_chunk(scene, points, start, begin, end, DEPTH, np.uint32(seed), probes)

    rays = sum(run_chunks(work, paths, CHUNK, threads, progress))
    np.add(probes.direct, probes.shine, out=probes.direct)
    return probes, rays
