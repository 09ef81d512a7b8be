"""Virtual area lights (Dong et al. 2009): every VPL shades, what a point sees of it is what it sees of its area light.

VPLs are grouped into M area lights (VALs), each with one soft shadow map; nothing is precomputed, so that all of it may change in every
frame.  Two things are done beyond the paper.  A VPL that is so near that it gives a point a visible part of its light has a
shadow ray of its own: there an area's shadow, and the map's texels, are too coarse (contacts, corners).  And interleaved
pixels share what a few rays find beyond the maps, not their light, see `visibility_sharing`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from ..clustering.area_lights import WEIGHT_ANGLE, WEIGHT_POSITION, AreaLights, chained, cluster_area_lights, nearest_area_light
from ..jit import kernel
from ..particles import Vpls, is_ahead
from ..rays.offsets import shadow_segment
from ..rays.packet import WIDTH, new_packet, set_ray
from ..rays.trace import OPAQUE, occluded1
from ..scene import DIFFUSE, TRANSPARENT
from ..shadowmaps.convolution import TERMS, soft_shadow_maps
from ..shadowmaps.paraboloid import paraboloid_maps
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..surfaces.visibility import shadow_packet
from ..threads import Progress, run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints, pixel_maxima
from .instant_radiosity import clamp_of, compensate, geometry_terms
from .interleaving import LARGEST, blur, pixels_of
from .light_cache import no_cache
from .visibility_sharing import area_visibility, gather, shared_lights

RESOLUTION = 128  # texels of a depth map
NEAR = 0.02  # of the clamp: VPLs with a larger geometry term have rays of their own
FLAT = 0.05  # of its size: a VAL whose members lie closer to its plane has its map at their mean
ALIGNED = 0.9  # least cosine of the members' normals of such a VAL, and of one that needs no second map
LIFT = 1e-3  # of the scene's extent, from the VAL's surface to its map
KERNEL = 0.5  # of a VAL's rectangle, for its shadows: VPLs are sparse at the borders; least error in every scene measured
TOGETHER = 128  # neighbouring points that are lit together
CHUNK = 1024  # points in one piece of work
GATHER_CHUNK = 1024
LEAST_GATHERED = 1 << 14  # gather rays in all
SHOWN = 4  # VALs of the most flux, each with debug layers of its own
VALS = (8, 128)  # bounds of M where it is not given
NEIGHBOURS = 0.2  # distance of VPLs, as k-means measures it, that one VAL serves
MOST_PLACES = 4096  # VPLs by which M is chosen
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)
_THIRD = np.float32(1 / 3)
_INV_PI = np.float32(1.0 / np.pi)


class SharedLights(NamedTuple):
    """N VPLs, VAL by VAL.

    vpls: the VPLs.  val: (N,) int32.  front, back: (M,) int32, the maps of each VAL's half-spaces; back is -1 where no
    light goes.
    """

    vpls: Vpls
    val: np.ndarray
    front: np.ndarray
    back: np.ndarray


@kernel
def _trace_near(scene, vpls, points, packet, rows, surface, cutouts, base, lane_of, of_vpl, count, through, visible):
    """What `count` pairs of a point and a near VPL see of each other, by shadow rays, into visible (P, K).

    base: number of the first of P points.  lane_of: (16, 2) int64, where to write a lane's finding.  of_vpl: (16,) int64.
    """
    for lane in range(count):
        i, j = base + lane_of[lane, 0], of_vpl[lane]
        ox, oy, oz, dx, dy, dz = shadow_segment(
            points.position[i, 0], points.position[i, 1], points.position[i, 2], points.ng[i, 0], points.ng[i, 1], points.ng[i, 2], points.error[i],
            vpls.position[j, 0], vpls.position[j, 1], vpls.position[j, 2],
            vpls.normal[j, 0], vpls.normal[j, 1], vpls.normal[j, 2], vpls.error[j],
        )  # fmt: skip
        set_ray(packet, lane, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE)
    shadow_packet(scene, packet, rows, surface, count, DIFFUSE, cutouts, through)
    for lane in range(count):
        visible[lane_of[lane, 0], lane_of[lane, 1]] = (through[lane, 0] + through[lane, 1] + through[lane, 2]) * _THIRD


@kernel
def _look(scene, lights, maps, points, base, n, room, g_near, cutouts, visible, g):
    """What n points from `base` on see of the VPLs, 0 to 1, into visible (P, N), and the geometry terms into g (P, N); the rays traced.

    room: what `_room` allocates.
    """
    vpls, val = lights.vpls, lights.val
    position, ng, ns, column, far, sums, packet, surface, rows, lane_of, of_vpl, through = room
    for k in range(n):
        for c in range(3):
            position[k, c], ng[k, c], ns[k, c] = points.position[base + k, c], points.ng[base + k, c], points.ns[base + k, c]
        far[k] = 0
    lanes = rays = begin = 0
    for j in range(len(val)):
        x, y, z = vpls.position[j, 0], vpls.position[j, 1], vpls.position[j, 2]
        geometry_terms(position, ns, ng, 0, n, x, y, z, vpls.normal[j, 0], vpls.normal[j, 1], vpls.normal[j, 2], column)
        for k in range(n):
            if cutouts and not is_ahead(vpls, j, position[k, 0], position[k, 1], position[k, 2]):
                column[k] = _0
            g[k, j] = column[k]
            visible[k, j] = _0
            if column[k] > g_near:
                lane_of[lanes, 0], lane_of[lanes, 1], of_vpl[lanes] = k, j, j
                lanes += 1
                if lanes == WIDTH:
                    _trace_near(scene, vpls, points, packet, rows, surface, cutouts, base, lane_of, of_vpl, lanes, through, visible)
                    rays += lanes
                    lanes = 0
            elif column[k] > _0:
                far[k] = 1
        if j + 1 == len(val) or val[j + 1] != val[j]:
            for k in range(n):
                if far[k]:
                    far[k] = 0
                    seen = area_visibility(
                        maps, lights.front[val[j]], lights.back[val[j]], position[k, 0], position[k, 1], position[k, 2], sums
                    )
                    for i in range(begin, j + 1):
                        if _0 < g[k, i] <= g_near:
                            visible[k, i] = seen
            begin = j + 1
    if lanes > 0:
        _trace_near(scene, vpls, points, packet, rows, surface, cutouts, base, lane_of, of_vpl, lanes, through, visible)
        rays += lanes
    return rays


@kernel
def _room(scene, maps):
    """Scratch memory of `_look`."""
    return (
        np.empty((TOGETHER, 3), np.float32), np.empty((TOGETHER, 3), np.float32), np.empty((TOGETHER, 3), np.float32),
        np.empty(TOGETHER, np.float32), np.empty(TOGETHER, np.uint8), np.empty(maps.tables.shape[3], np.float32),
        new_packet(), np.zeros(SURFACE, np.float32), new_registers(scene.materials),
        np.empty((WIDTH, 2), np.int64), np.empty(WIDTH, np.int64), np.ones((WIDTH, 3), np.float32),
    )  # fmt: skip


@kernel
def _shade(scene, lights, maps, points, begin, end, g_max, g_near, cutouts, out):
    """Irradiance at the points begin..end-1 into out (N, 3); the shadow rays traced."""
    count = len(lights.val)
    visible, g = np.empty((TOGETHER, count), np.float32), np.empty((TOGETHER, count), np.float32)
    room = _room(scene, maps)
    flux = lights.vpls.flux
    rays = 0
    for base in range(begin, end, TOGETHER):
        n = min(TOGETHER, end - base)
        rays += _look(scene, lights, maps, points, base, n, room, g_near, cutouts, visible, g)
        for k in range(n):
            red = green = blue = _0
            for j in range(count):
                w = min(g[k, j], g_max) * visible[k, j] * _INV_PI
                red += w * flux[j, 0]
                green += w * flux[j, 1]
                blue += w * flux[j, 2]
            out[base + k, 0], out[base + k, 1], out[base + k, 2] = red, green, blue
    return rays


class VirtualAreaLights:
    """All VPLs on all points, visibility by M area lights.

    vals: M; None: as many as the lighting needs (`wanted_area_lights`).
    interleave: I, 1 to 8: each pixel of a block of I x I draws a part of the VPLs for its rays, and its neighbours tell it what they found.
    width: pixels of the picture's rows; None, for points that are no picture, turns interleaving off.
    terms: of the shadow maps' Fourier series.  resolution: of their depth maps, a multiple of 32.
    compensation: gather rays that give back the light taken by the clamp, from the I x I points of a block together (0: none).
    """

    def __init__(
        self,
        *,
        vals: int | None = None,
        interleave: int = LARGEST,
        width: int | None = None,
        terms: int = TERMS[0],
        resolution: int = RESOLUTION,
        compensation: int = 16,
        bounces: int = 4,
        seed: int = 0,
        threads: int = 0,
    ):
        if not 1 <= interleave <= LARGEST:
            raise ValueError(f"interleave: expected 1 to {LARGEST}, got {interleave}")
        self.vals = vals
        self.interleave = interleave if width else 1
        self.width = width
        self.terms = terms
        self.resolution = resolution
        self.compensation = compensation
        self.bounces = bounces
        self.seed = seed
        self.threads = threads
        self.rays = 0
        self.pairs = 0
        self.seconds: dict[str, float] = {}  # CPU time of the paper's stages (its Table 2)

    @contextmanager
    def _stage(self, name: str) -> Iterator[None]:
        begin = time.process_time()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - begin

    def prepare(self, scene: Transport, vpls: Vpls, points: ShadingPoints) -> None:
        """Groups the VPLs and makes the VALs' shadow maps; `points` only sets the scale of the clamp."""
        self.scene = scene
        self.cutouts = bool((scene.materials.flags & TRANSPARENT).any())
        self.g_max = np.float32(clamp_of(vpls, points))
        self.extent = max(float(np.ptp(vpls.position, axis=0).max()), 1e-6)
        with self._stage("clustering"):
            self.area_lights = chained(self.group(vpls), self.extent)
        order = self._order(vpls)
        front, back = _slots(self.area_lights)
        self.lights = SharedLights(vpls.take(order), self.area_lights.assignment[order], front, back)
        with self._stage("shadow maps"):
            self.make_maps(vpls)

    def group(self, vpls: Vpls) -> AreaLights:
        """The VALs of these VPLs, by the normals of their surfaces, which bound the light of glossy ones, too.

        k-means starts at VPLs of the first bounce, whose places in the sequence change least.
        """
        first = np.flatnonzero(vpls.bounce == vpls.bounce.min())
        count = min(self.vals or wanted_area_lights(vpls, self.extent), len(vpls.bounce))
        guess = first if len(first) >= count else np.arange(len(vpls.bounce))
        return cluster_area_lights(vpls.position, vpls.surface_normal, guess[np.arange(count) * len(guess) // count], self.extent)

    def _order(self, vpls: Vpls) -> np.ndarray:
        """VPLs by VAL, each VAL's along its rectangle's longer side: neighbours are seen alike, so strata of them help."""
        lights = self.area_lights
        axis = lights.frame[np.arange(len(lights)), lights.half.argmax(axis=1)]
        along = np.einsum("nc,nc->n", vpls.position - lights.centre[lights.assignment], axis[lights.assignment])
        return np.lexsort((along, lights.assignment))

    def make_maps(self, vpls: Vpls) -> None:
        """The shadow maps of the VALs, those of the half-spaces behind them last."""
        lights = self.area_lights
        behind = np.flatnonzero(self.lights.back >= 0)
        origin = map_origins(self.scene, vpls, lights, np.float32(LIFT * self.extent))
        origin = np.concatenate([origin, origin[behind]])
        frame = np.concatenate([lights.frame, lights.frame[behind] * np.array([[1], [-1], [-1]], np.float32)])
        self.depth, rays = paraboloid_maps(self.scene, origin, frame, self.resolution, self.cutouts, seed=self.seed, threads=self.threads)
        half = np.float32(KERNEL) * np.concatenate([lights.half, lights.half[behind]])
        self.maps = soft_shadow_maps(self.depth, origin, frame, half, self.terms, self.threads)
        self.rays += rays

    def irradiance(self, points: ShadingPoints, progress: Progress | None = None) -> np.ndarray:
        """Indirect irradiance at N points, (N, 3) float32, W/m^2."""
        n = len(points.pixel)
        self.pairs += n * len(self.lights.val)
        if self.interleave == 1 or n == 0:
            return self._shade(points, progress) + self._lost(points, self.compensation)
        pixels = pixels_of(points, self.width, self.interleave)
        lights = shared_lights(self.lights.vpls, self.lights.val, self.maps, self.lights.front, self.lights.back)
        out, rays = gather(
            self.scene, points, pixels, lights, self.extent, self.g_max, self.cutouts, self.seed, self.threads, progress, self._stage
        )
        self.rays += rays
        with self._stage("compensation"):
            # A few gather rays a point are enough where there are many points, for those of a block share them.
            few = max(-(-self.compensation // self.interleave**2), min(self.compensation, -(-LEAST_GATHERED // n)))
            if few:
                out += blur(points, pixels, self._lost(points, few), self.extent, self.threads)
        return out

    def _shade(self, points: ShadingPoints, progress: Progress | None) -> np.ndarray:
        """Light (N, 3) of all VPLs: of near ones by shadow rays, of the others by their VALs' maps."""
        out = np.empty((len(points.pixel), 3), np.float32)

        def work(begin, end):
            return _shade(
                self.scene, self.lights, self.maps, points, begin, end, self.g_max, np.float32(NEAR * self.g_max), self.cutouts, out
            )

        self.rays += sum(run_chunks(work, len(out), CHUNK, self.threads, progress))
        return out

    def _lost(self, points: ShadingPoints, samples: int) -> np.ndarray:
        """Light (N, 3) that the clamp took, by gather rays."""
        out = np.zeros((len(points.pixel), 3), np.float32)
        if samples == 0 or not np.isfinite(self.g_max):
            return out

        def work(begin, end):
            return compensate(self.scene, no_cache(), points, begin, end, self.g_max, samples, self.bounces, np.uint32(self.seed + 1), out)

        self.rays += sum(run_chunks(work, len(out), GATHER_CHUNK, self.threads))
        return out

    def debug_layers(self, points: ShadingPoints, shape: tuple[int, int]) -> dict[str, np.ndarray]:
        """Pictures (H, W, 1) of the VALs, by layer name.

        AreaLights: the number of the VAL that a surface would belong to, from 1 (0: no surface).  AreaLightShadow0, ...: what the points
        see of the VALs with the most flux, by their maps.  AreaLightDepth0, ...: their depth maps (m), stretched over the picture.
        """
        lights = self.area_lights
        flux = np.bincount(self.lights.val, self.lights.vpls.flux.sum(axis=1), len(lights))
        pictures = {
            "AreaLights": pixel_maxima(
                nearest_area_light(lights, points.position, points.ns, self.extent)[:, None] + 1.0, points.pixel, shape
            )
        }
        for rank, k in enumerate(np.argsort(-flux, kind="stable")[:SHOWN]):
            seen = np.empty((len(points.pixel), 1), np.float32)
            _visibilities(self.maps, self.lights, k, points.position, seen)
            pictures[f"AreaLightShadow{rank}"] = pixel_maxima(seen, points.pixel, shape)
            rows, columns = (np.arange(side) * self.resolution // side for side in shape)
            depth = self.depth[k][rows[:, None], columns]
            pictures[f"AreaLightDepth{rank}"] = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))[..., None]
        return pictures


@kernel
def _visibilities(maps, lights, val, position, seen):
    """What each position (N, 3) sees of one VAL, into seen (N, 1)."""
    sums = np.empty(maps.tables.shape[3], np.float32)
    for i in range(len(position)):
        seen[i, 0] = area_visibility(maps, lights.front[val], lights.back[val], position[i, 0], position[i, 1], position[i, 2], sums)


def _slots(lights: AreaLights) -> tuple[np.ndarray, np.ndarray]:
    """`front` and `back` of `SharedLights`: a VAL that is no flat patch lights points behind its plane, too."""
    m = len(lights)
    behind = (lights.spread < ALIGNED) | (lights.depth > FLAT * lights.half.max(axis=1))
    back = np.full(m, -1, np.int32)
    back[behind] = m + np.arange(np.count_nonzero(behind), dtype=np.int32)
    return np.arange(m, dtype=np.int32), back


@kernel
def _seen_from(scene, vpls, assignment, origin, axis, lift, seen):
    """How many of its members each origin (M, 3) sees, into seen (M,)."""
    packet = new_packet()
    for i in range(len(assignment)):
        k = assignment[i]
        ox, oy, oz, dx, dy, dz = shadow_segment(
            origin[k, 0], origin[k, 1], origin[k, 2], axis[k, 0], axis[k, 1], axis[k, 2], _0,
            vpls.position[i, 0], vpls.position[i, 1], vpls.position[i, 2],
            vpls.surface_normal[i, 0], vpls.surface_normal[i, 1], vpls.surface_normal[i, 2], vpls.error[i] + _HALF * lift,
        )  # fmt: skip
        seen[k] += 0 if occluded1(scene.rays, OPAQUE, packet, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE) else 1


def map_origins(scene: Transport, vpls: Vpls, lights: AreaLights, lift: np.float32) -> np.ndarray:
    """Where the VALs' shadow maps are made, (M, 3) float32: in the middle of its members, or where that is inside geometry at one of them.

    The middle moves smoothly with the members; but between members on both sides of a wall, or of a column, it sees nothing.
    A member's own place on a surface is never hidden from everything.  lift: off the surface (m).
    """
    middle = lights.centre + lift * lights.frame[:, 2]
    member = vpls.position[lights.medoid] + lift * vpls.surface_normal[lights.medoid]
    seen = np.zeros(len(lights), np.int64)
    _seen_from(scene, vpls, lights.assignment, middle, lights.frame[:, 2], lift, seen)
    free = (2 * seen > np.bincount(lights.assignment)) & (lights.depth < FLAT * lights.half.max(axis=1) + lift)
    return np.where(free[:, None], middle, member).astype(np.float32)


def wanted_area_lights(vpls: Vpls, extent: float) -> int:
    """M by the lighting's complexity: a power of two, so that it stays the same while a scene moves.

    The number of places, farther than NEIGHBOURS apart as k-means measures it, that the VPLs cover.
    """
    weight = np.float32(WEIGHT_POSITION / extent)
    place, normal = vpls.position[:MOST_PLACES] * weight, vpls.surface_normal[:MOST_PLACES]
    free = np.ones(len(place), bool)
    places = 0
    for i in range(len(place)):
        if free[i]:
            places += 1
            angle = np.arccos(np.clip(normal @ normal[i], -1, 1))
            free &= np.linalg.norm(place - place[i], axis=1) + WEIGHT_ANGLE * angle > NEIGHBOURS
    return int(np.clip(2 ** np.ceil(np.log2(max(places, 1))), *VALS))
