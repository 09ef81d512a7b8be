"""Instant radiosity by cube shadow maps, and direct light of point and spot lamps by the same maps.

The look of the papers' rasterised renderers, without a rasteriser: one map a light, filled by rays, read by all
shading points.  Maps are made and used in batches, so that memory stays bounded and sums keep their order.
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..lamps.links import is_unlinked
from ..lamps.sample import sample_emitter
from ..lamps.tables import CASTS_SHADOW, POSITION
from ..particles import Vpls
from ..scene import DIFFUSE, POINT, SHADOW, SPOT
from ..shadowmaps.cube import cube_maps, lit_share
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..threads import Progress, run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints
from .instant_radiosity import clamp_of

VPL_RESOLUTION = 32  # texels along a face's edge, for one of thousands of VPLs
LAMP_RESOLUTION = 512  # for a lamp, whose shadow is seen by itself
BATCH = 64  # maps in memory at once
CHUNK = 1024
_0 = np.float32(0.0)
_INV_PI = np.float32(1.0 / np.pi)


@kernel
def _shade(vpls, first, last, maps, points, begin, end, g_max, samples, seed, out):
    """Adds the VPLs first..last-1 to the points begin..end-1; maps: of these VPLs."""
    for i in range(begin, end):
        r = g = b = _0
        for j in range(first, last):
            dx = vpls.position[j, 0] - points.position[i, 0]
            dy = vpls.position[j, 1] - points.position[i, 1]
            dz = vpls.position[j, 2] - points.position[i, 2]
            at_point = points.ns[i, 0] * dx + points.ns[i, 1] * dy + points.ns[i, 2] * dz
            above = points.ng[i, 0] * dx + points.ng[i, 1] * dy + points.ng[i, 2] * dz
            at_light = -(vpls.normal[j, 0] * dx + vpls.normal[j, 1] * dy + vpls.normal[j, 2] * dz)
            if at_point <= 0 or above <= 0 or at_light <= 0:
                continue
            r2 = max(dx * dx + dy * dy + dz * dz, np.float32(1e-30))
            f = min(at_point * at_light / (r2 * r2), g_max) * _INV_PI
            f *= lit_share(
                maps, j - first, -dx, -dy, -dz, at_point / np.sqrt(r2), samples, seed, np.uint32(i) * np.uint32(8191) + np.uint32(j)
            )
            r += f * vpls.flux[j, 0]
            g += f * vpls.flux[j, 1]
            b += f * vpls.flux[j, 2]
        out[i, 0] += r
        out[i, 1] += g
        out[i, 2] += b


class ShadowMappedRadiosity:
    """All VPLs on all shading points, visibility from one cube shadow map a VPL; the geometry term is clamped.

    resolution: texels along a face's edge.  filtering: look-ups of percentage-closer filtering (1: none).
    """

    def __init__(self, *, resolution: int = VPL_RESOLUTION, filtering: int = 4, seed: int = 0, threads: int = 0):
        self.resolution = resolution
        self.filtering = filtering
        self.seed = seed
        self.threads = threads
        self.rays = 0
        self.pairs = 0

    def prepare(self, scene: Transport, vpls: Vpls, points: ShadingPoints) -> None:
        """Takes the scene and its VPLs; `points` only sets the scale of the clamp."""
        self.scene = scene
        self.vpls = vpls
        self.g_max = np.float32(clamp_of(vpls, points))

    def irradiance(self, points: ShadingPoints, progress: Progress | None = None) -> np.ndarray:
        """Indirect irradiance at N points, (N, 3) float32, W/m^2."""
        n, m, v = len(points.pixel), len(self.vpls.bounce), self.vpls
        out = np.zeros((n, 3), np.float32)
        for first in range(0, m, BATCH):
            last = min(first + BATCH, m)
            maps, rays = cube_maps(
                self.scene.rays, v.position[first:last], v.error[first:last], v.normal[first:last], self.resolution, DIFFUSE, self.threads
            )
            self.rays += rays
            step = None if progress is None else (lambda fraction, done=first: progress((done + fraction * BATCH) / m))

            def work(begin, end, first=first, last=last, maps=maps):
                _shade(v, first, last, maps, points, begin, end, self.g_max, self.filtering, np.uint32(self.seed), out)

            run_chunks(work, n, CHUNK, self.threads, step)
        self.pairs += n * m
        return out


@kernel
def _direct(emitters, lamps, maps, points, begin, end, samples, seed, rows_of, out):
    """Direct light of the lamps (their emitter numbers) on the points begin..end-1 by their maps."""
    rows = new_registers(rows_of)
    surface = np.zeros(SURFACE, np.float32)
    half = np.float32(0.5)
    for i in range(begin, end):
        x, y, z = points.position[i, 0], points.position[i, 1], points.position[i, 2]
        sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
        for k in range(len(lamps)):
            dx, dy, dz, t, r, g, b, _, _ = sample_emitter(emitters, lamps[k], x, y, z, sx, sy, sz, half, half, rows, surface)
            cosine = sx * dx + sy * dy + sz * dz
            if cosine <= 0 or points.ng[i, 0] * dx + points.ng[i, 1] * dy + points.ng[i, 2] * dz <= 0:
                continue
            w = cosine
            if emitters.flags[lamps[k]] & CASTS_SHADOW:
                w *= lit_share(maps, k, -dx * t, -dy * t, -dz * t, cosine, samples, seed, np.uint32(i) * np.uint32(8191) + np.uint32(k))
            out[i, 0] += w * r
            out[i, 1] += w * g
            out[i, 2] += w * b


def point_lamps(emitters) -> np.ndarray:
    """Numbers of the emitters that a cube map serves: point and spot lamps."""
    return np.flatnonzero(((emitters.kind == POINT) | (emitters.kind == SPOT)) & is_unlinked(emitters)).astype(np.int32)


def direct_by_maps(
    scene: Transport, points: ShadingPoints, *, resolution: int = LAMP_RESOLUTION, filtering: int = 16, seed: int = 0, threads: int = 0
) -> tuple[np.ndarray, int]:
    """Direct irradiance (N, 3) of all point and spot lamps by cube shadow maps, and the rays that filled them.

    A lamp's radius only blurs as far as the filter reaches; its light is that of its middle.
    """
    lamps = point_lamps(scene.emitters)
    out = np.zeros((len(points.pixel), 3), np.float32)
    if len(lamps) == 0:
        return out, 0
    position = np.ascontiguousarray(scene.emitters.lamps[lamps, POSITION : POSITION + 3])
    free = np.zeros((len(lamps), 3), np.float32)
    maps, rays = cube_maps(scene.rays, position, np.zeros(len(lamps), np.float32), free, resolution, SHADOW, threads)

    def work(begin, end):
        _direct(scene.emitters, lamps, maps, points, begin, end, filtering, np.uint32(seed), scene.materials, out)

    run_chunks(work, len(points.pixel), CHUNK, threads)
    return out, rays
