"""The pool of VPLs for a view: particles are flown until enough of their lights reach what is seen.

A sun, a spot through a window or a lamp in the next room sends most of its particles where no visible point
receives them.  Lights behind every point are dropped; of the others, the pool keeps a number by what they can
give to the view, with exact weights, so that the expected light is unchanged.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .jit import kernel
from .particles import BRIGHTEST, Vpls, trace_particles
from .rays.offsets import shadow_segment
from .rays.packet import is_occluded, new_packet, set_ray
from .rays.trace import OPAQUE, occluded_packet
from .references import Reference
from .sampling.hashing import uniform
from .scene import DIFFUSE, bounds
from .threads import Cancelled, Progress, run_chunks
from .transport import Transport
from .view.points import ShadingPoints

# (scene, count, bounces, seed, threads) -> the VPLs of as many particles, and the rays traced.
Particles = Callable[[Transport, int, int, int, int], tuple[Vpls, int]]

BATCH = 8  # particles a batch, for each VPL wanted
LARGE, LARGE_BATCH = 1 << 19, 2  # particles beyond which a batch has fewer: a million VPLs would take gigabytes
MOST_BATCHES = 16
FEWEST_BATCHES = 2  # where not all lights matter in the first one
BATCH_SEED = 7919  # between the seeds of batches
MOST_FLOWN = 1 << 23  # particles in all, which are in memory at once: the same for 65,536 VPLs as ever, 1 GiB for a million
ENOUGH = 1.5  # lights that matter, for each VPL wanted
# Lights kept, at most, for each that matters: of more the powers are too uneven, and the parts of the pool that one point looks at too unlike.
KEPT_OF_MATTERING = 8.0
SUBSET = 96  # shading points that stand for the view
RAYS_EACH = 8  # shadow rays that tell how much of the view a light reaches
DEFENSIVE = 0.2  # share of the density by flux alone: no light that could matter is impossible
SEQUENCE_TRIES = 4
SEQUENCE_OCTAVES = 6  # at most 2^6 particles a light of `vpl_sequence`
UNSEEN = np.float32(0.02)  # visible share of a light that none of its rays saw


@kernel
def _contributions(scene, vpls, begin, end, points, weights, g_max, rays_each, seed, reach, seen):
    """Of each VPL begin..end-1: its unshadowed light on the points, and the visible share of it by a few rays."""
    n = len(points.pixel)
    light = np.empty(n, np.float32)
    packet = new_packet()
    traced = 0
    for i in range(begin, end):
        x, y, z = vpls.position[i, 0], vpls.position[i, 1], vpls.position[i, 2]
        nx, ny, nz = vpls.normal[i, 0], vpls.normal[i, 1], vpls.normal[i, 2]
        sharp = vpls.sharpness[i]
        total = np.float32(0.0)
        for k in range(n):
            dx, dy, dz = x - points.position[k, 0], y - points.position[k, 1], z - points.position[k, 2]
            r2 = dx * dx + dy * dy + dz * dz
            c = max(np.float32(0.0), points.ns[k, 0] * dx + points.ns[k, 1] * dy + points.ns[k, 2] * dz)
            at_light = -(nx * dx + ny * dy + nz * dz)
            spread = r2 + sharp * (r2 - at_light * at_light)
            c *= (np.float32(1.0) + sharp) * max(np.float32(0.0), at_light)
            f = weights[k] * min(c / max(spread * spread, np.float32(1e-30)), min(np.float32(1.0) + sharp, BRIGHTEST) * g_max)
            light[k] = f
            total += f
        power = (vpls.flux[i, 0] + vpls.flux[i, 1] + vpls.flux[i, 2]) * np.float32(1 / 3)
        reach[i] = total * power
        seen[i] = np.float32(0.0)
        if not total > 0:
            continue
        # Stratified picks in proportion to the light, one shadow ray each.
        k = 0
        partial = light[0]
        for j in range(rays_each):
            target = (np.float32(j) + uniform(seed, i, j, 0)) / np.float32(rays_each) * total
            while k + 1 < n and partial < target:
                k += 1
                partial += light[k]
            ox, oy, oz, dx, dy, dz = shadow_segment(
                points.position[k, 0], points.position[k, 1], points.position[k, 2],
                points.ng[k, 0], points.ng[k, 1], points.ng[k, 2], points.error[k], x, y, z, nx, ny, nz, vpls.error[i],
            )  # fmt: skip
            set_ray(packet, j, ox, oy, oz, dx, dy, dz, np.float32(0.0), np.float32(1.0), DIFFUSE)
        occluded_packet(scene.rays, OPAQUE, packet, rays_each)
        traced += rays_each
        visible = 0
        for j in range(rays_each):
            if not is_occluded(packet, j):
                visible += 1
        seen[i] = np.float32(visible) / np.float32(rays_each)
    return traced


def drop_useless(vpls: Vpls, points: ShadingPoints, beyond: np.ndarray | None = None) -> Vpls:
    """Without the VPLs whose half-space holds no shading point, and none of the places `beyond` (N, 3), by their bounding box."""
    if len(points.pixel) == 0 or len(vpls.bounce) == 0:
        return vpls
    low, high = bounds(points.position)
    if beyond is not None and len(beyond):
        nearest, farthest = bounds(beyond)
        low, high = np.minimum(low, nearest), np.maximum(high, farthest)
    # Of the box's corner that lies farthest ahead; by components, for sums over an axis of three are ten times as slow.
    columns = zip(vpls.position.T, vpls.normal.T, low, high)
    ahead = sum(np.maximum((above - x) * n, (below - x) * n) for x, n, below, above in columns) > 0
    return vpls if ahead.all() else vpls.take(ahead)


def view_subset(points: ShadingPoints, count: int, seed: int) -> ShadingPoints:
    """`count` points spread evenly over the picture, in proportion to how much each shows."""
    weight = np.einsum("nc->n", points.albedo + points.f0) / 3 + 1e-6
    cdf = np.cumsum(weight, dtype=np.float64)
    at = (np.arange(count) + np.random.default_rng(seed).random()) / count
    return points.take(np.minimum(np.searchsorted(cdf, at * cdf[-1]), len(weight) - 1))


def contributions(scene: Transport, vpls: Vpls, subset: ShadingPoints, g_max: float, seed: int, threads: int = 0) -> tuple[np.ndarray, int]:
    """What each VPL gives to the points of `subset`, roughly: unshadowed light times the visible share (M,), which becomes its `seen`; rays traced."""
    m = len(vpls.bounce)
    weights = np.ones(len(subset.pixel), np.float32)
    reach = np.empty(m, np.float32)

    lights, points = Reference(vpls), Reference(subset)

    def work(begin, end):
        return _contributions(scene, lights, begin, end, points, weights, np.float32(g_max), RAYS_EACH, np.uint32(seed), reach, vpls.seen)

    rays = sum(run_chunks(work, m, 512, threads))
    return reach.astype(np.float64) * (vpls.seen + UNSEEN), rays


def resample(vpls: Vpls, importance: np.ndarray, count: int, seed: int) -> Vpls:
    """At most `count` VPLs drawn by `importance` (M,), which carry the light of all: the expected light is unchanged."""
    m = len(vpls.bounce)
    if m <= count:
        return vpls
    power = vpls.flux.astype(np.float64).mean(axis=1)
    if not power.sum() > 0:
        return vpls.take(slice(0, count))
    density = DEFENSIVE * power / power.sum()
    if importance.sum() > 0:
        density = density + (1 - DEFENSIVE) * importance / importance.sum()
    # Systematic resampling; a light that is picked k times is one light with k shares.
    cdf = np.cumsum(density)
    density = density / cdf[-1]
    picks = np.searchsorted(cdf / cdf[-1], (np.arange(count) + np.random.default_rng(seed).random()) / count)
    index, copies = np.unique(np.minimum(picks, m - 1), return_counts=True)
    kept = vpls.take(index)
    kept.flux[:] *= (copies / (count * density[index]))[:, None].astype(np.float32)
    return kept


def lights_that_matter(importance: np.ndarray) -> float:
    """How many lights of equal importance would make as good a pool as those of `importance` (M,): Kish's effective size."""
    squares = float((importance**2).sum())
    return float(importance.sum()) ** 2 / squares if 0 < squares < np.inf else 0.0


def vpl_pool(
    scene: Transport,
    points: ShadingPoints,
    count: int,
    bounces: int,
    g_max_of,
    seed: int,
    threads: int = 0,
    progress: Progress | None = None,
    *,
    share: Callable[[Vpls], np.ndarray] | None = None,
    batches: int = MOST_BATCHES,
    particles: Particles = trace_particles,
    kept: int = 1,
    enough: float = 1.0,
    beyond: np.ndarray | None = None,
) -> tuple[Vpls, dict]:
    """About `count` VPLs, times `kept`, that light the view, after at most `bounces` diffuse surfaces.

    g_max_of: (vpls, points) -> the clamp of the geometry term, which bounds what one light can seem to give.
    share: vpls -> the part of each one's light (M,) that is wanted (None: all of it).
    batches: of particles, at most.  particles: traces them, or knows them already; they may be changed here.
    beyond: (N, 3), where else than at the points the light is wanted.
    enough: part of the usual number of lights that must matter, once `FEWEST_BATCHES` of particles have flown.
    kept: above 1, more of the lights of as many particles, as far as they matter: for whoever looks at a part of the pool at each point.

    Returns:
        The VPLs, and counts: `light` and `shadow` rays, `traced` VPLs, `useless` ones (behind every point).
    """
    counts = {"light": 0, "shadow": 0, "traced": 0, "useless": 0}
    subset = view_subset(points, min(SUBSET, len(points.pixel)), seed) if len(points.pixel) else points
    parts: list[Vpls] = []
    importance: list[np.ndarray] = []
    g_max = None
    flown = max(64, min(count * BATCH, max(count * LARGE_BATCH, LARGE)))
    batches = min(batches, max(1, MOST_FLOWN // flown))
    for batch in range(batches):
        vpls, rays = particles(scene, flown, bounces, seed + BATCH_SEED * batch, threads)
        counts["light"] += rays
        counts["traced"] += len(vpls.bounce)
        useful = drop_useless(vpls, points, beyond)
        counts["useless"] += len(vpls.bounce) - len(useful.bounce)
        if len(useful.bounce):
            if share is not None:
                useful.flux[:] *= share(useful)[:, None]
            g_max = g_max_of(useful, points) if g_max is None else g_max
            light, rays = contributions(scene, useful, subset, g_max, seed + batch, threads)
            counts["shadow"] += rays
            parts.append(useful)
            importance.append(light)
            matter = lights_that_matter(np.concatenate(importance))
            if matter >= (enough if batch + 1 >= FEWEST_BATCHES else 1.0) * ENOUGH * count:
                break
        elif counts["traced"] == 0:
            break
        if progress is not None and not progress((batch + 1) / batches):
            raise Cancelled
    pool = Vpls.concatenate(parts)
    if parts:
        pool.flux[:] *= np.float32(1.0 / (batch + 1))
        if kept > 1:
            count = max(count, min(kept * count, int(KEPT_OF_MATTERING * lights_that_matter(np.concatenate(importance)))))
        pool = resample(pool, np.concatenate(importance), count, seed)
    return pool, counts


def vpl_sequence(scene: Transport, points: ShadingPoints, count: int, bounces: int, seed: int, threads: int = 0) -> tuple[Vpls, dict]:
    """About `count` VPLs of one fixed quasi-random sequence, so that those of a scene that has changed little have moved little.

    Nothing depends on the view but how many particles are flown, a power of two times `count`, such that from 0.7 to 1.4 times
    `count` lights lie before some visible point.  Returns what `vpl_pool` does.
    """
    counts = {"light": 0, "shadow": 0, "traced": 0, "useless": 0}
    particles, kept = count, None
    for _ in range(SEQUENCE_TRIES):
        vpls, rays = trace_particles(scene, particles, bounces, seed, threads)
        counts["light"] += rays
        counts["traced"] = len(vpls.bounce)
        kept = drop_useless(vpls, points)
        counts["useless"] = len(vpls.bounce) - len(kept.bounce)
        octaves = min(round(np.log2(count / max(len(kept.bounce), 1))), SEQUENCE_OCTAVES)
        wanted = max(int(particles * 2.0**octaves), 1)
        if wanted == particles or len(vpls.bounce) == 0 or wanted > count << SEQUENCE_OCTAVES:
            break
        particles = wanted
    return kept, counts
