"""Direct light of area lamps with soft shadows from convolution soft shadow maps: no noise, one depth map a lamp.

Annen et al. 2008.  Right where a lamp is small beside its distance to what blocks it; a large one's shadows ring and leak, as
Dong et al. 2009 show in their Fig. 5.
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..lamps.links import is_unlinked
from ..lamps.sample import sample_emitter
from ..lamps.tables import AXIS_X, CASTS_SHADOW, POSITION, SIZE
from ..sampling.sequences import r2
from ..scene import AREA, SHADOW, TRANSPARENT
from ..shadowmaps.convolution import soft_shadow_maps, soft_visibility
from ..shadowmaps.paraboloid import paraboloid_maps
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..threads import run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints

RESOLUTION = 512  # of a lamp's depth map, whose shadow is seen by itself
FOURIER_TERMS = 8
SAMPLES = 16  # of a lamp's unshadowed light
CHUNK = 1024
_0 = np.float32(0.0)


@kernel
def _direct(emitters, lamps, maps, points, begin, end, samples, seed, materials, out):
    """Light of the lamps (their emitter numbers) on the points begin..end-1, times what these see of them."""
    rows = new_registers(materials)
    surface = np.zeros(SURFACE, np.float32)
    sums = np.empty(maps.tables.shape[3], np.float32)
    share = np.float32(1.0 / samples)
    for i in range(begin, end):
        x, y, z = points.position[i, 0], points.position[i, 1], points.position[i, 2]
        sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
        for k in range(len(lamps)):
            red = green = blue = _0
            for s in range(samples):
                u1, u2 = r2(s, seed)
                dx, dy, dz, _, r, g, b, _, _ = sample_emitter(emitters, lamps[k], x, y, z, sx, sy, sz, u1, u2, rows, surface)
                if points.ng[i, 0] * dx + points.ng[i, 1] * dy + points.ng[i, 2] * dz > _0:
                    w = share * max(_0, sx * dx + sy * dy + sz * dz)
                    red, green, blue = red + w * r, green + w * g, blue + w * b
            if max(red, green, blue) > _0:
                seen = np.float32(1.0)
                if emitters.flags[lamps[k]] & CASTS_SHADOW:
                    seen = soft_visibility(maps, k, x, y, z, sums)
                out[i, 0] += seen * red
                out[i, 1] += seen * green
                out[i, 2] += seen * blue


def area_lamps(emitters) -> np.ndarray:
    """Numbers of the emitters that are area lamps."""
    return np.flatnonzero((emitters.kind == AREA) & is_unlinked(emitters)).astype(np.int32)


def direct_by_soft_maps(
    scene: Transport, points: ShadingPoints, *, resolution: int = RESOLUTION, terms: int = FOURIER_TERMS, seed: int = 0, threads: int = 0
) -> tuple[np.ndarray, int]:
    """Direct irradiance (N, 3) of all area lamps by soft shadow maps, and the rays that filled them."""
    emitters = scene.emitters
    lamps = area_lamps(emitters)
    out = np.zeros((len(points.pixel), 3), np.float32)
    if len(lamps) == 0:
        return out, 0
    table = emitters.lamps[lamps]
    origin = np.ascontiguousarray(table[:, POSITION : POSITION + 3])
    # A lamp shines along -z: about its x axis turned over, so that the map's axis is the light's.
    frame = np.ascontiguousarray(table[:, AXIS_X : AXIS_X + 9].reshape(-1, 3, 3) * np.array([[1], [-1], [-1]], np.float32))
    half = np.ascontiguousarray(table[:, SIZE : SIZE + 2] * np.float32(0.5))
    cutouts = bool((scene.materials.flags & TRANSPARENT).any())
    depth, rays = paraboloid_maps(scene, origin, frame, resolution, cutouts, kinds=SHADOW, seed=seed, threads=threads)
    maps = soft_shadow_maps(depth, origin, frame, half, terms, threads)

    def work(begin, end):
        _direct(emitters, lamps, maps, points, begin, end, SAMPLES, np.uint32(seed), scene.materials, out)

    run_chunks(work, len(points.pixel), CHUNK, threads)
    return out, rays
