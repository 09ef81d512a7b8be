"""Probes of the light in a scene: paths from the visible points, whose vertices fill the cache of light."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..jit import inlined, kernel, leaf
from ..lamps.direct import set_point_lobe
from ..rays.offsets import hit_point, offset_origin
from ..rays.packet import new_packet
from ..references import Reference
from ..sampling.hashing import hash_combine, uniform
from ..sampling.maps import cosine_hemisphere, to_world
from ..scene import DIFFUSE, GLOSSY, REFRACTIVE
from ..surfaces.bumps import mean_shadowing
from ..surfaces.layout import DIFFUSE as SURFACE_DIFFUSE
from ..surfaces.layout import GLOSS, GLOSSY_F0, GLOSSY_F90, ROUGHNESS, SURFACE, TILT, TRANSLUCENCY, diffuse_albedo
from ..surfaces.lobes import ALBEDO, ALPHA, LOBE, goes_past, lobe_cosine, sample_above, sample_lobe, set_lobe
from ..surfaces.normals import mapped_normal, shading_normal, surface_side
from ..surfaces.program import new_registers
from ..surfaces.visibility import OUTSIDE, encloses, nearest_surface
from ..threads import Progress, run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints
from .exchange import DEPTH, DIFFUSE_LINK, GLOSSY_LINK, TRANSLUCENT_LINK, Probes
from .light_cache import unknown_paths
from .tails import DIMENSIONS, scatter_light
from .wide_lobes import NARROW

# (scene, points, paths, seed, threads, progress) -> probes along about as many paths from the points, and the rays traced.
Tracer = Callable[[Transport, ShadingPoints, int, int, int, Progress | None], tuple[Probes, int]]

CHUNK = 512  # paths a chunk
MOST_MIRRORS = 4  # inner sides of panes that one link goes by, one after the other
FARTHEST = 8  # probes of a path that is followed on
FEWER, MOST_TURNS = 1 / 16, 32  # of all paths are followed on at most, and each so many times
IMPORTANT = 0.1  # of the direct light that all probes tell: where those beyond tell so much, all turns are worth it
BY_LOBE = np.float32(0.5)  # of the share of its lobe in what a point reflects: the part of its paths that the lobe begins
LAMP_RAYS = 4  # shadow rays of a probe: what is stored serves many
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_THIRD = np.float32(1 / 3)


@inlined
def _is_matt_black(surface):
    """Whether a surface scatters nothing diffusely."""
    most = _0
    for c in range(3):
        most = max(most, surface[SURFACE_DIFFUSE + c], surface[TRANSLUCENCY + c])
    return not most > _0


@leaf
def _probe_path(scene, packet, rows, surface, lobe, probes, first, depth, points, i, seed, path, turn):
    """One path from the visible point i: up to `depth` probes from row `first` on, each with its link; the rays traced.

    turn: paths that differ in it alone part at the surface after `DEPTH` probes.
    """
    x, y, z, error, entered = (
        points.position[i, 0],
        points.position[i, 1],
        points.position[i, 2],
        points.error[i],
        np.int64(points.entered[i]),
    )
    gx, gy, gz = points.ng[i, 0], points.ng[i, 1], points.ng[i, 2]
    sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
    set_point_lobe(points, i, lobe)
    glossy = lobe[ALBEDO] if lobe[ALPHA] > _0 else _0
    dull = _THIRD * (points.albedo[i, 0] + points.albedo[i, 1] + points.albedo[i, 2])
    u1, u2 = uniform(seed, path, 0, 6), uniform(seed, path, 0, 7)
    # A floor seen at a grazing angle mirrors what lies far off, where few diffuse rays go.
    if glossy > _0 and uniform(seed, path, 0, 5) * (glossy + dull) < BY_LOBE * glossy:
        kinds = GLOSSY
        dx, dy, dz, _, _, _, density = sample_above(lobe, gx, gy, gz, goes_past(scene, points.triangle[i], points.tilt[i]), u1, u2)
        if not density > _0:
            return 0
    else:
        kinds = DIFFUSE
        lx, ly, lz = cosine_hemisphere(u1, u2)
        dx, dy, dz = to_world(lx, ly, lz, sx, sy, sz)
    if gx * dx + gy * dy + gz * dz <= _0:
        return 0
    in_glass = False
    rays = mirrors = 0
    for vertex in range(depth + 1):
        at = (vertex + 1) * DIMENSIONS
        probe = first + vertex
        if vertex == DEPTH:
            seed = hash_combine(seed, turn)
        own = seed
        while True:
            ox, oy, oz = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
            rays += 1
            triangle, u, v, t, r, g, b, _, entered = nearest_surface(
                scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, np.float32(np.inf), kinds, own, path, at + 8, entered
            )
            if triangle < 0:
                return rays
            x, y, z, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
            sx, sy, sz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
            sx, sy, sz = mapped_normal(scene.materials, scene.material[triangle], surface, sx, sy, sz)
            behind = gx * dx + gy * dy + gz * dz > 0
            side = surface_side(scene.materials, scene.material[triangle], behind)
            if behind:
                gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
            # A cell of a pane knows what it mirrors to those who have met it, at other angles than the next ones do: a link goes on to what it mirrors.
            if (
                vertex == 0
                or mirrors == MOST_MIRRORS
                or not (
                    encloses(scene.materials.flags[scene.material[triangle]], behind)
                    and surface[ROUGHNESS] < NARROW
                    and _is_matt_black(surface)
                )
            ):
                break
            mirrors += 1
            set_lobe(
                lobe, sx, sy, sz, gx, gy, gz, -dx, -dy, -dz, surface[ROUGHNESS], surface[GLOSSY_F0], surface[GLOSSY_F0 + 1], surface[GLOSSY_F0 + 2],
                surface[GLOSSY_F90], surface[GLOSSY_F90 + 1], surface[GLOSSY_F90 + 2], surface[GLOSS], surface[GLOSS + 1], surface[GLOSS + 2], surface[GLOSS + 3],
            )  # fmt: skip
            own = hash_combine(seed, np.uint32(mirrors))
            u1, u2 = uniform(own, path, at, 6), uniform(own, path, at, 7)
            dx, dy, dz, kr, kg, kb, _ = sample_lobe(lobe, u1, u2)
            if gx * dx + gy * dy + gz * dz <= _0 or not max(kr, kg, kb) > _0:
                return rays
            probes.carry[probe - 1, 0] *= r * kr
            probes.carry[probe - 1, 1] *= g * kg
            probes.carry[probe - 1, 2] *= b * kb
        if vertex > 0:
            link = probe - 1
            probes.link[link] = DIFFUSE_LINK if kinds == DIFFUSE else GLOSSY_LINK if kinds == GLOSSY else TRANSLUCENT_LINK
            probes.link_position[link, 0], probes.link_position[link, 1], probes.link_position[link, 2] = x, y, z
            probes.link_side[link] = side
            probes.link_normal[link, 0], probes.link_normal[link, 1], probes.link_normal[link, 2] = gx, gy, gz
            probes.carry[link, 0] *= r
            probes.carry[link, 1] *= g
            probes.carry[link, 2] *= b
            if in_glass:  # the cells of a solid's sides do not know which light leaves it: none may give more than it gets
                for c in range(3):
                    probes.carry[link, c] = min(probes.carry[link, c], _1)
        in_glass = scene.materials.flags[scene.material[triangle]] & REFRACTIVE != 0
        if vertex == depth:
            return rays
        probes.valid[probe] = 1
        probes.distance[probe] = t
        probes.cosine[probe] = -(gx * dx + gy * dy + gz * dz)
        probes.side[probe] = side
        probes.position[probe, 0], probes.position[probe, 1], probes.position[probe, 2] = x, y, z
        probes.normal[probe, 0], probes.normal[probe, 1], probes.normal[probe, 2] = gx, gy, gz
        probes.error[probe] = error
        lit = mean_shadowing(surface[TILT])
        r, g, b = diffuse_albedo(surface, lobe_cosine(sx, sy, sz, gx, gy, gz, -dx, -dy, -dz))
        probes.albedo[probe, 0], probes.albedo[probe, 1], probes.albedo[probe, 2] = lit * r, lit * g, lit * b
        mirrored = _0 if encloses(scene.materials.flags[scene.material[triangle]], behind) else _1
        tx, ty, tz, r, g, b, kinds, _ = scatter_light(
            scene, packet, rows, surface, lobe, triangle, x, y, z, error, gx, gy, gz, sx, sy, sz, -dx, -dy, -dz, entered, LAMP_RAYS, True, 0, seed, path, at,
            probes.direct, probes.shine, probes.beneath, probes.glass, True, probe, _1, _1, _1, mirrored, _1, _0, _1,
        )  # fmt: skip
        rays += LAMP_RAYS
        probes.carry[probe, 0], probes.carry[probe, 1], probes.carry[probe, 2] = r, g, b
        if kinds == 0:
            return rays
        if kinds != GLOSSY:
            entered = OUTSIDE
        dx, dy, dz = tx, ty, tz
    return rays


@kernel
def _probe_chunk(scene, points, start, number, begin, end, depth, turn, seed, probes):
    """Paths number[begin..end-1] (P,), which begin at the points start[number], of up to `depth` probes each; the rays traced."""
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    lobe = np.zeros(LOBE, np.float32)
    rays = 0
    for k in range(begin, end):
        path = number[k]
        i = start[path]
        rays += _probe_path(
            scene, packet, rows, surface, lobe, probes, k * depth, depth, points, i, seed, np.uint32(path), np.uint32(turn + k)
        )
    return rays


def trace_probes(
    scene: Transport, points: ShadingPoints, paths: int, seed: int, threads: int = 0, progress: Progress | None = None
) -> tuple[Probes, int]:
    """Probes along `paths` paths that begin at points spread evenly over the view; the number of rays traced."""
    return _trace(scene, points, paths, np.arange(paths), DEPTH, seed, threads, progress)


def trace_farther(
    scene: Transport, points: ShadingPoints, probes: Probes, seed: int, threads: int = 0, progress: Progress | None = None
) -> tuple[Probes, int]:
    """The probes that paths of `trace_probes`, with the same points and seed, find beyond what these know, and the rays traced.

    Where light comes round corners, the last links of many paths end at surfaces of which no probe tells; these paths are followed on.
    """
    paths = len(probes.valid) // DEPTH
    number = unknown_paths(probes)
    found, rays = _follow(scene, points, paths, number, 0, seed, threads, progress)
    known, beyond = (float(part.direct.sum(dtype=np.float64)) for part in (probes, found))
    # Few of them may carry most of the light, or all: then each is followed on many times.
    turns = MOST_TURNS * min(1.0, beyond / (IMPORTANT * known)) if known > 0 else MOST_TURNS
    further = number.repeat(max(0, round(turns) - 1))
    further = further[:: max(1, math.ceil(len(further) / max(1.0, FEWER * paths)))].copy()  # contiguous: the kernel is compiled once
    others, more = _follow(scene, points, paths, further, len(number), seed, threads, progress)
    return Probes.concatenate([found, others]), rays + more


def _follow(
    scene: Transport, points: ShadingPoints, paths: int, number: np.ndarray, turn: int, seed: int, threads: int, progress: Progress | None
) -> tuple[Probes, int]:
    """What the paths `number` of `paths` find beyond `DEPTH` probes: each that in the last row of a path of its own, for no visible point
    has met it.  turn: the first one's number, which no other call may share."""
    found, rays = _trace(scene, points, paths, number, FARTHEST, seed, threads, progress, turn)
    beyond = np.flatnonzero((found.valid > 0) & (np.arange(len(found.valid)) % FARTHEST >= DEPTH))
    others = Probes.allocate(DEPTH * len(beyond), scene.emitters.light_groups)
    for column, values in zip(others, found, strict=True):
        column[DEPTH - 1 :: DEPTH] = values[beyond]
    return others, rays


def _trace(
    scene: Transport, points: ShadingPoints, paths: int, number: np.ndarray, depth: int, seed: int, threads: int, progress: Progress | None,
    turn: int = 0,
) -> tuple[Probes, int]:  # fmt: skip
    """The paths `number` (P,) of `paths`, of up to `depth` probes each; turn: as of `_probe_path`, of the first of them."""
    probes = Probes.allocate(len(number) * depth, scene.emitters.light_groups)
    offsets = np.random.default_rng(seed).random(paths)
    start = np.minimum(((np.arange(paths) + offsets) * (len(points.pixel) / paths)).astype(np.int64), len(points.pixel) - 1)

    seen, found = Reference(points), Reference(probes)

    def work(begin, end):
        return _probe_chunk(scene, seen, start, number, begin, end, depth, turn, np.uint32(seed), found)

    rays = sum(run_chunks(work, len(number), CHUNK, threads, progress))
    for part in (probes.shine, probes.beneath):
        np.add(probes.direct, part, out=probes.direct)
    return probes, rays
