"""Direct light: shadow rays from shading points to emitters.

Emitters near the scene are few and are then sampled one by one ("groups"), or many and then share a tree, which
is one group.  A point's samples are dealt to the groups by what each could send there unshadowed, at least one to
each that can send anything; where there are fewer samples than groups, the groups are drawn at random.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, kernel
from ..rays.offsets import hit_point, offset_origin, shadow_segment
from ..rays.packet import WIDTH, disable_ray, is_occluded, new_packet, set_ray
from ..rays.trace import OPAQUE, occluded1, occluded_packet
from ..sampling.hashing import hash_combine, to_unit, uniform
from ..sampling.sequences import sobol
from ..scene import SHADOW, SUN
from ..surfaces.layout import SURFACE
from ..surfaces.program import new_registers
from ..surfaces.visibility import transmittance1
from ..threads import Progress, run_chunks
from .sample import sample_emitter
from .tables import AXIS_Z, CASTS_SHADOW, ONE_MINUS_COS, TRIANGLE, WORLD
from .tree import cut_estimate, descend, importance

CHUNK = 4096  # points a chunk
_BLOCK = 64  # points whose rays are traced together, lamp by lamp
_DEFENSIVE = np.float32(0.1)  # share of the samples dealt evenly to the groups that can send light
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_THIRD = np.float32(1 / 3)
# A lamp is no surface that a ray could hit, but one often lies in a surface: stop short of it.
_SHORT = np.float32(0.9999)


@inlined
def group_estimate(emitters, group, px, py, pz, nx, ny, nz):
    """Estimate of the unshadowed irradiance (mean of the channels) of a group at p; 0 only where it sends none."""
    e = emitters.groups[group]
    tree = emitters.tree
    if e < 0:
        return cut_estimate(tree.nodes, tree.two_sided, tree.cut, px, py, pz, nx, ny, nz)
    if emitters.kind[e] == WORLD:
        w = emitters.world.estimate
        return max(w[0] + w[1] * nx + w[2] * ny + w[3] * nz, _DEFENSIVE * w[0])
    if emitters.kind[e] == SUN:
        lamps = emitters.lamps
        narrow = lamps[e, ONE_MINUS_COS]
        mean = (emitters.radiance[e, 0] + emitters.radiance[e, 1] + emitters.radiance[e, 2]) * _THIRD
        if narrow > _0:
            mean *= np.float32(math.pi) * narrow * (np.float32(2.0) - narrow)  # sin^2 of the half angle
        rise = np.float32(math.sqrt(max(_0, narrow * (np.float32(2.0) - narrow))))
        return mean * max(_0, nx * lamps[e, AXIS_Z] + ny * lamps[e, AXIS_Z + 1] + nz * lamps[e, AXIS_Z + 2] + rise)
    return importance(tree.nodes, tree.two_sided, e, px, py, pz, nx, ny, nz)


@kernel
def deal(estimate, samples, offset, count, weight):
    """Deal `samples` to groups by their estimates; writes how many each gets and the weight of each sample.

    estimate, weight: (G,) float32.  count: (G,) int32.  offset: uniform in [0, 1), used where samples are scarce.
    """
    total = _0
    active = 0
    for g in range(len(estimate)):
        total += estimate[g]
        active += estimate[g] > _0
    scarce = samples < active
    rest = np.float32(samples if scarce else samples - active)
    edge = offset if scarce else np.float32(0.5)
    dealt = 0
    for g in range(len(estimate)):
        count[g] = 0
        weight[g] = _0
        if not estimate[g] > _0:
            continue
        share = (_1 - _DEFENSIVE) * estimate[g] / total + _DEFENSIVE / np.float32(active)
        edge += rest * share
        upto = np.int64(edge)
        n = upto - dealt
        dealt = upto
        if scarce:
            count[g] = n
            weight[g] = _1 / (rest * share)
        else:
            count[g] = n + 1
            weight[g] = _1 / np.float32(n + 1)


@inlined
def shadow_ray(scene, e, u, v, px, py, pz, gx, gy, gz, error, dx, dy, dz, t):
    """Ray from the surface at p to the light at distance t along d -> (origin, direction, end of the range)."""
    emitters = scene.emitters
    if emitters.kind[e] == TRIANGLE:
        triangle = emitters.triangle[e - emitters.first_triangle]
        qx, qy, qz, nx, ny, nz, q_error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
        ox, oy, oz, dx, dy, dz = shadow_segment(px, py, pz, gx, gy, gz, error, qx, qy, qz, nx, ny, nz, q_error)
        return ox, oy, oz, dx, dy, dz, _1
    ox, oy, oz = offset_origin(px, py, pz, gx, gy, gz, error, dx, dy, dz)
    return ox, oy, oz, dx, dy, dz, t * _SHORT


@inlined
def _choose(emitters, e, px, py, pz, nx, ny, nz, u):
    """The emitter of a group, chosen from the tree where the group is one -> (emitter or -1, probability)."""
    if e >= 0:
        return e, _1
    tree = emitters.tree
    return descend(tree.nodes, tree.two_sided, tree.children, tree.root, px, py, pz, nx, ny, nz, u)


@kernel
def direct_irradiance_at(scene, packet, rows, surface, x, y, z, error, gx, gy, gz, sx, sy, sz, seed, path, dimension):
    """Irradiance (r, g, b) at one point by one shadow ray, W/m^2; its mean is exact.

    For the tails of paths: random numbers are hashed from (seed, path, dimension, 0..3).
    scene: Transport.  packet, rows, surface: scratch.  g, s: geometric and shading normal, on the lit side.
    """
    emitters = scene.emitters
    chosen = -1
    total = chosen_estimate = _0
    u = uniform(seed, path, dimension, 0)
    for group in range(len(emitters.groups)):  # reservoir sampling with one recycled random number
        estimate = group_estimate(emitters, group, x, y, z, sx, sy, sz)
        if estimate > _0:
            total += estimate
            p = estimate / total
            if u < p:
                chosen, chosen_estimate = group, estimate
                u = u / p
            else:
                u = (u - p) / (_1 - p)
            u = min(u, np.float32(0.99999994))
    if chosen < 0:
        return _0, _0, _0
    e, probability = _choose(emitters, emitters.groups[chosen], x, y, z, sx, sy, sz, uniform(seed, path, dimension, 1))
    if e < 0:
        return _0, _0, _0
    dx, dy, dz, t, r, g, b, u, v = sample_emitter(
        emitters, e, x, y, z, sx, sy, sz, uniform(seed, path, dimension, 2), uniform(seed, path, dimension, 3), rows, surface
    )
    cosine = sx * dx + sy * dy + sz * dz
    if cosine <= _0 or gx * dx + gy * dy + gz * dz <= _0 or not max(r, g, b) > _0:
        return _0, _0, _0
    w = cosine * total / (chosen_estimate * probability)
    if emitters.flags[e] & CASTS_SHADOW:
        ox, oy, oz, dx, dy, dz, end = shadow_ray(scene, e, u, v, x, y, z, gx, gy, gz, error, dx, dy, dz, t)
        if occluded1(scene.rays, OPAQUE, packet, ox, oy, oz, dx, dy, dz, _0, end, SHADOW):
            return _0, _0, _0
        if emitters.cutouts:
            tr, tg, tb = transmittance1(
                scene.rays, scene.materials, scene.material, scene.attributes, packet, rows, surface,
                ox, oy, oz, dx, dy, dz, _0, end, SHADOW,
            )  # fmt: skip
            r, g, b = r * tr, g * tg, b * tb
    return w * r, w * g, w * b


@kernel
def _trace_pending(scene, packet, rows, surface, pending, owner, n, out):
    """Trace the n pending rays and add what gets through to their points."""
    for lane in range(WIDTH):
        if lane < n:
            p = pending[lane]
            set_ray(packet, lane, p[0], p[1], p[2], p[3], p[4], p[5], _0, p[6], SHADOW)
        else:
            disable_ray(packet, lane)
    occluded_packet(scene.rays, OPAQUE, packet, n)
    for lane in range(n):
        if is_occluded(packet, lane):
            continue
        p = pending[lane]
        tr = tg = tb = _1
        if scene.emitters.cutouts:
            tr, tg, tb = transmittance1(
                scene.rays, scene.materials, scene.material, scene.attributes, packet, rows, surface,
                p[0], p[1], p[2], p[3], p[4], p[5], _0, p[6], SHADOW,
            )  # fmt: skip
        out[owner[lane], 0] += p[7] * tr
        out[owner[lane], 1] += p[8] * tg
        out[owner[lane], 2] += p[9] * tb


@kernel
def _direct_chunk(scene, position, ns, ng, error, begin, end, samples, seed, first, out):
    """Direct irradiance of the points begin..end-1 into `out` -> number of rays."""
    emitters = scene.emitters
    n_groups = len(emitters.groups)
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    pending = np.zeros((WIDTH, 10), np.float32)
    owner = np.zeros(WIDTH, np.int64)
    estimate = np.empty(n_groups, np.float32)
    count = np.zeros((_BLOCK, n_groups), np.int32)
    weight = np.zeros((_BLOCK, n_groups), np.float32)
    n_rays = 0
    for start in range(begin, end, _BLOCK):
        size = min(_BLOCK, end - start)
        for k in range(size):
            i = start + k
            out[i] = _0
            for g in range(n_groups):
                estimate[g] = group_estimate(emitters, g, position[i, 0], position[i, 1], position[i, 2], ns[i, 0], ns[i, 1], ns[i, 2])
            deal(estimate, samples, to_unit(hash_combine(hash_combine(seed, i), first)), count[k], weight[k])
        n = 0
        # Lamp by lamp, so that the rays of a packet go the same way.
        for g in range(n_groups):
            most = 0
            for k in range(size):
                most = max(most, count[k, g])
            for sample in range(most):
                for k in range(size):
                    if sample >= count[k, g]:
                        continue
                    i = start + k
                    px, py, pz = position[i, 0], position[i, 1], position[i, 2]
                    sx, sy, sz = ns[i, 0], ns[i, 1], ns[i, 2]
                    scramble = hash_combine(hash_combine(seed, i), g)
                    # Later passes go on where this group's samples (rounded up, where they vary) end.
                    index = first * np.int64(_1 / weight[k, g] + np.float32(0.999)) + sample
                    e, probability = _choose(emitters, emitters.groups[g], px, py, pz, sx, sy, sz, sobol(index, 2, scramble))
                    if e < 0:
                        continue
                    u1, u2 = sobol(index, 0, scramble), sobol(index, 1, scramble)
                    dx, dy, dz, t, r, gr, b, u, v = sample_emitter(emitters, e, px, py, pz, sx, sy, sz, u1, u2, rows, surface)
                    cosine = sx * dx + sy * dy + sz * dz
                    gx, gy, gz = ng[i, 0], ng[i, 1], ng[i, 2]
                    if cosine <= _0 or gx * dx + gy * dy + gz * dz <= _0 or not max(r, gr, b) > _0:
                        continue
                    w = cosine * weight[k, g] / probability
                    if not emitters.flags[e] & CASTS_SHADOW:
                        out[i, 0] += w * r
                        out[i, 1] += w * gr
                        out[i, 2] += w * b
                        continue
                    p = pending[n]
                    p[0], p[1], p[2], p[3], p[4], p[5], p[6] = shadow_ray(scene, e, u, v, px, py, pz, gx, gy, gz, error[i], dx, dy, dz, t)
                    p[7], p[8], p[9] = w * r, w * gr, w * b
                    owner[n] = i
                    n += 1
                    n_rays += 1
                    if n == WIDTH:
                        _trace_pending(scene, packet, rows, surface, pending, owner, n, out)
                        n = 0
        if n > 0:
            _trace_pending(scene, packet, rows, surface, pending, owner, n, out)
    return n_rays


def direct_irradiance(scene, points, samples: int, seed: int, threads: int = 0, progress: Progress | None = None, *, first: int = 0):
    """Direct irradiance at shading points.

    Args:
        scene: Transport.
        points: with arrays position, ns, ng (N, 3) and error (N,) float32, such as `view.points.ShadingPoints`; in an
            order in which neighbours lie close together.
        samples: shadow rays a point (some fewer where light cannot arrive).
        first: number of the pass; passes of one seed and sample count go on in the same sequences.

    Returns:
        ((N, 3) float32 W/m^2, number of rays traced).
    """
    n = len(points.position)
    out = np.zeros((n, 3), np.float32)
    if len(scene.emitters.groups) == 0 or samples < 1:
        return out, 0

    def work(begin, end):
        return _direct_chunk(
            scene, points.position, points.ns, points.ng, points.error, begin, end, samples, np.uint32(seed), np.int64(first), out
        )

    return out, sum(run_chunks(work, n, CHUNK, threads, progress))
