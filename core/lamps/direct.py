"""Direct light: shadow rays from shading points to emitters.

Emitters near the scene are few and are then sampled one by one ("groups"), or many and then share a tree, which
is one group.  A point's samples are dealt to the groups by what each could send there unshadowed, at least one to
each that can send anything; where there are fewer samples than groups, the groups are drawn at random.

The same rays carry the light that glossy lobes reflect, which they share with rays drawn from the lobes (see
`methods.glossy`) by multiple importance sampling.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel, leaf
from ..rays.offsets import hit_point, offset_origin, shadow_segment
from ..rays.packet import WIDTH, disable_ray, is_occluded, new_packet, set_ray
from ..rays.trace import OPAQUE, occluded1, occluded_packet
from ..sampling.hashing import hash_combine, to_unit, uniform
from ..sampling.sequences import sobol
from ..scene import SHADOW, SUN
from ..surfaces.layout import SURFACE
from ..surfaces.lobes import ALPHA, LOBE, lobe_value, reflection_count, set_lobe
from ..surfaces.program import new_registers
from ..surfaces.visibility import transmittance1
from ..threads import Progress, run_chunks
from .lookup import can_be_met, emitter_density, share_of
from .sample import sample_emitter
from .tables import AXIS_Z, CASTS_SHADOW, ONE_MINUS_COS, SEEN_BY_GLOSSY, TRIANGLE, WORLD
from .tree import CUT, choose, cut_estimate, cut_for, descend, importance

CHUNK = 4096  # points a chunk
_BLOCK = 64  # points whose rays are traced together, lamp by lamp
_DEFENSIVE = np.float32(0.1)  # share of the samples dealt evenly to the groups that can send light
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_THIRD = np.float32(1 / 3)
# A lamp is no surface that a ray could hit, but one often lies in a surface: stop short of it, by some tens of the rounding
# errors of the distance and no more, for what is as close as that behind a wall shines through it.
_SHORT = np.float32(1.0 - 1e-5)


class Receivers(NamedTuple):
    """N points to be lit, as `view.points.ShadingPoints`; the arrays from wo on are empty where no point has a lobe."""

    position: np.ndarray
    ns: np.ndarray
    ng: np.ndarray
    error: np.ndarray
    wo: np.ndarray
    f0: np.ndarray
    f90: np.ndarray
    roughness: np.ndarray
    albedo: np.ndarray


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


@leaf
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


@leaf
def expected_samples(emitters, px, py, pz, nx, ny, nz, samples, estimate, count, expected):
    """How many of `samples` each group gets at p with normal n, on average, into `expected` (G,).

    estimate (G,) float32, count (G,) int32: scratch.
    """
    for g in range(len(emitters.groups)):
        estimate[g] = group_estimate(emitters, g, px, py, pz, nx, ny, nz)
    deal(estimate, samples, np.float32(0.5), count, expected)
    for g in range(len(emitters.groups)):
        expected[g] = _1 / expected[g] if expected[g] > _0 else _0


@leaf
def aimed_density(emitters, expected, e, px, py, pz, nx, ny, nz, dx, dy, dz):
    """Light samples per steradian in a direction d that meets emitter e, where groups get `expected` samples each.

    Nearly: what the tree gives to one emitter is taken from its bounds.  Weights of multiple importance sampling may
    be anything that is the same for all of the samplers.
    """
    if nx * dx + ny * dy + nz * dz <= _0:
        return _0
    number = _0
    for g in range(len(emitters.groups)):
        if emitters.groups[g] == e:
            number = expected[g]
            break
        if emitters.groups[g] < 0:
            tree = emitters.tree
            own = importance(tree.nodes, tree.two_sided, e, px, py, pz, nx, ny, nz)
            number = expected[g] * min(_1, own / max(group_estimate(emitters, g, px, py, pz, nx, ny, nz), np.float32(1e-30)))
    return number * emitter_density(emitters, e, px, py, pz, nx, ny, nz, dx, dy, dz) if number > _0 else _0


@inlined
def _lobe_share(emitters, e, lobe, reflections, expected, px, py, pz, nx, ny, nz, dx, dy, dz):
    """Lobe times cosine (r, g, b) towards a sample of emitter e, times the share that rays drawn from the lobe leave to it."""
    r, g, b, density = lobe_value(lobe, dx, dy, dz)
    if not (density > _0 and emitters.flags[e] & SEEN_BY_GLOSSY):
        return _0, _0, _0
    if reflections > 0 and can_be_met(emitters, e):
        aimed = aimed_density(emitters, expected, e, px, py, pz, nx, ny, nz, dx, dy, dz)
        share = share_of(aimed, np.float32(reflections) * density)
        return r * share, g * share, b * share
    return r, g, b


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


@leaf
def passed(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, end):
    """Share of light (r, g, b) that a shadow ray lets through up to t = end."""
    if occluded1(scene.rays, OPAQUE, packet, ox, oy, oz, dx, dy, dz, _0, end, SHADOW):
        return _0, _0, _0
    if not scene.emitters.cutouts:
        return _1, _1, _1
    r, g, b, _ = transmittance1(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, _0, end, SHADOW)
    return r, g, b


@leaf
def direct_sample_at(scene, packet, rows, surface, x, y, z, error, gx, gy, gz, sx, sy, sz, seed, path, dimension):
    """Irradiance (r, g, b) at one point by one shadow ray, W/m^2, the cosine and the emitter of its light (-1: none); the mean is exact.

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
        return _0, _0, _0, _0, -1
    e, probability = emitters.groups[chosen], _1
    if e < 0:
        tree = emitters.tree
        e, probability = descend(
            tree.nodes, tree.two_sided, tree.children, tree.root, x, y, z, sx, sy, sz, uniform(seed, path, dimension, 1)
        )
        if e < 0:
            return _0, _0, _0, _0, -1
    dx, dy, dz, t, r, g, b, u, v = sample_emitter(
        emitters, e, x, y, z, sx, sy, sz, uniform(seed, path, dimension, 2), uniform(seed, path, dimension, 3), rows, surface
    )
    cosine = sx * dx + sy * dy + sz * dz
    if cosine <= _0 or gx * dx + gy * dy + gz * dz <= _0 or not max(r, g, b) > _0:
        return _0, _0, _0, _0, -1
    w = cosine * total / (chosen_estimate * probability)
    if emitters.flags[e] & CASTS_SHADOW:
        ox, oy, oz, dx, dy, dz, end = shadow_ray(scene, e, u, v, x, y, z, gx, gy, gz, error, dx, dy, dz, t)
        tr, tg, tb = passed(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, end)
        r, g, b = r * tr, g * tg, b * tb
    return w * r, w * g, w * b, cosine, e


@leaf
def direct_irradiance_at(scene, packet, rows, surface, x, y, z, error, gx, gy, gz, sx, sy, sz, seed, path, dimension):
    """The irradiance of `direct_sample_at`."""
    r, g, b, _, _ = direct_sample_at(scene, packet, rows, surface, x, y, z, error, gx, gy, gz, sx, sy, sz, seed, path, dimension)
    return r, g, b


@inlined
def _add_light(out, i, c, share, r, g, b):
    """Adds a share of (r, g, b) to row i of `out`, from column c on."""
    out[i, c] += share * r
    out[i, c + 1] += share * g
    out[i, c + 2] += share * b


@kernel
def _trace_pending(scene, packet, rows, surface, pending, owner, column, n, out, glossy):
    """Trace the n pending rays and add what gets through to their points, from column (WIDTH,) on; what passes glass to the second half."""
    half = out.shape[1] // 2
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
        tr = tg = tb = clear = _1
        if scene.emitters.cutouts:
            tr, tg, tb, clear = transmittance1(
                scene, packet, rows, surface,
                p[0], p[1], p[2], p[3], p[4], p[5], _0, p[6], SHADOW,
            )  # fmt: skip
        if clear < _0:  # a lens throws it elsewhere: a caustic, which is not found
            continue
        c, i = column[lane], owner[lane]
        _add_light(out, i, c, clear, p[7] * tr, p[8] * tg, p[9] * tb)
        if clear < _1:
            _add_light(out, i, c + half, _1 - clear, p[7] * tr, p[8] * tg, p[9] * tb)
        if len(glossy) > 0:
            _add_light(glossy, i, c, clear, p[10] * tr, p[11] * tg, p[12] * tb)
            if clear < _1:
                _add_light(glossy, i, c + half, _1 - clear, p[10] * tr, p[11] * tg, p[12] * tb)


@kernel
def _direct_chunk(scene, points, begin, end, samples, reflections, seed, first, out, glossy):
    """Direct irradiance of the points begin..end-1 into `out`, what their lobes reflect into `glossy` -> number of rays."""
    position, ns, ng, error = points.position, points.ns, points.ng, points.error
    emitters = scene.emitters
    tree = emitters.tree
    n_groups = len(emitters.groups)
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    pending = np.zeros((WIDTH, 13), np.float32)
    owner, column = np.zeros(WIDTH, np.int64), np.zeros(WIDTH, np.int64)
    estimate = np.empty(n_groups, np.float32)
    members = np.empty((_BLOCK, CUT), np.int32)
    cdf = np.empty((_BLOCK, CUT), np.float32)
    cut_size = np.empty(_BLOCK, np.int64)
    count = np.zeros((_BLOCK, n_groups), np.int32)
    weight = np.zeros((_BLOCK, n_groups), np.float32)
    lobes = np.full((_BLOCK, LOBE), -_1)
    drawn = np.zeros(_BLOCK, np.int64)
    expected = np.zeros((_BLOCK, n_groups), np.float32)
    spare = np.empty(n_groups, np.int32)
    n_rays = 0
    for start in range(begin, end, _BLOCK):
        size = min(_BLOCK, end - start)
        for k in range(size):
            i = start + k
            out[i] = _0
            px, py, pz, sx, sy, sz = position[i, 0], position[i, 1], position[i, 2], ns[i, 0], ns[i, 1], ns[i, 2]
            for g in range(n_groups):
                if emitters.groups[g] < 0:
                    cut_size[k], estimate[g] = cut_for(
                        tree.nodes, tree.two_sided, tree.children, tree.root, px, py, pz, sx, sy, sz, members[k], cdf[k]
                    )
                else:
                    estimate[g] = group_estimate(emitters, g, px, py, pz, sx, sy, sz)
            deal(estimate, samples, to_unit(hash_combine(hash_combine(seed, i), first)), count[k], weight[k])
            if len(glossy) > 0:
                glossy[i] = _0
                set_point_lobe(points, i, lobes[k])
                drawn[k] = reflection_count(lobes[k], points.albedo[i, 0], points.albedo[i, 1], points.albedo[i, 2], reflections)
                if drawn[k] > 0:
                    expected_samples(emitters, px, py, pz, sx, sy, sz, samples, estimate, spare, expected[k])
        n = np.int64(0)  # no literal, for which the callee would be compiled again
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
                    e = emitters.groups[g]
                    rarity = _1
                    if e < 0:
                        pick = to_unit(hash_combine(scramble, index))
                        e, rarity = choose(
                            tree.nodes, tree.two_sided, tree.children, px, py, pz, sx, sy, sz, members[k], cdf[k], cut_size[k],
                            sobol(index, 2, scramble), pick,
                        )  # fmt: skip
                        if e < 0:
                            continue
                    u1, u2 = sobol(index, 0, scramble), sobol(index, 1, scramble)
                    dx, dy, dz, t, r, gr, b, u, v = sample_emitter(emitters, e, px, py, pz, sx, sy, sz, u1, u2, rows, surface)
                    cosine = sx * dx + sy * dy + sz * dz
                    gx, gy, gz = ng[i, 0], ng[i, 1], ng[i, 2]
                    if cosine <= _0 or gx * dx + gy * dy + gz * dz <= _0 or not max(r, gr, b) > _0:
                        continue
                    w = rarity * weight[k, g]
                    fr = fg = fb = _0
                    if lobes[k, ALPHA] > _0:
                        fr, fg, fb = _lobe_share(emitters, e, lobes[k], drawn[k], expected[k], px, py, pz, sx, sy, sz, dx, dy, dz)
                        fr, fg, fb = fr * w * r, fg * w * gr, fb * w * b
                    w *= cosine
                    c = 3 * np.int64(emitters.light_group[e])
                    if not emitters.flags[e] & CASTS_SHADOW:
                        out[i, c] += w * r
                        out[i, c + 1] += w * gr
                        out[i, c + 2] += w * b
                        if lobes[k, ALPHA] > _0:
                            glossy[i, c] += fr
                            glossy[i, c + 1] += fg
                            glossy[i, c + 2] += fb
                        continue
                    p = pending[n]
                    p[0], p[1], p[2], p[3], p[4], p[5], p[6] = shadow_ray(scene, e, u, v, px, py, pz, gx, gy, gz, error[i], dx, dy, dz, t)
                    p[7], p[8], p[9] = w * r, w * gr, w * b
                    p[10], p[11], p[12] = fr, fg, fb
                    owner[n], column[n] = i, c
                    n += 1
                    n_rays += 1
                    if n == WIDTH:
                        _trace_pending(scene, packet, rows, surface, pending, owner, column, n, out, glossy)
                        n = np.int64(0)
        if n > 0:
            _trace_pending(scene, packet, rows, surface, pending, owner, column, n, out, glossy)
    return n_rays


@leaf
def set_point_lobe(points, i, lobe):
    """The lobe of point i (of `Receivers` or `ShadingPoints`) into a row."""
    set_lobe(
        lobe, points.ns[i, 0], points.ns[i, 1], points.ns[i, 2], points.ng[i, 0], points.ng[i, 1], points.ng[i, 2],
        points.wo[i, 0], points.wo[i, 1], points.wo[i, 2], points.roughness[i],
        points.f0[i, 0], points.f0[i, 1], points.f0[i, 2], points.f90[i, 0], points.f90[i, 1], points.f90[i, 2],
    )  # fmt: skip


class DirectLight(NamedTuple):
    """Direct light at N points, three columns for each of G light groups.

    irradiance: (N, 3 G) float32 W/m^2.  glossy: (N, 3 G) float32 W/m^2/sr, what lobes reflect to the viewer.
    irradiance_by_glass, glossy_by_glass: the same, of light that passed glass on its way from the lamp: glass is a bounce to
    Cycles, which counts it as indirect light.
    """

    irradiance: np.ndarray
    glossy: np.ndarray
    irradiance_by_glass: np.ndarray
    glossy_by_glass: np.ndarray


def direct_irradiance(scene, points, samples: int, seed: int, threads: int = 0, progress: Progress | None = None, *, first: int = 0):
    """Direct irradiance at shading points, as `direct_light`; points need the arrays position, ns, ng and error only.

    Returns:
        ((N, 3 G) float32 W/m^2, with what passes glass, number of rays traced).
    """
    light, rays = direct_light(scene, points, samples, seed, threads, progress, first=first, lobes=False)
    return light.irradiance + light.irradiance_by_glass, rays


def direct_light(
    scene, points, samples: int, seed: int, threads: int = 0, progress: Progress | None = None, *, first: int = 0, reflections: int = 0,
    lobes: bool = True,
):  # fmt: skip
    """Direct light at shading points: irradiance, and what their glossy lobes reflect to the viewer.

    Args:
        scene: Transport.
        points: with the arrays of `Receivers`, such as `view.points.ShadingPoints`; in an order in which neighbours
            lie close together.
        samples: shadow rays a point (some fewer where light cannot arrive).
        first: number of the pass; passes of one seed and sample count go on in the same sequences.
        reflections: most rays drawn from a point's lobe; where above 0, the light that they find is theirs to add
            (`methods.glossy.reflect`, called with the same numbers).
        lobes: whether the points' lobes matter at all; without, they need the arrays position, ns, ng and error only.

    Returns:
        (DirectLight, number of rays traced).
    """
    if lobes:
        receivers = Receivers(*(getattr(points, name) for name in Receivers._fields))
    else:
        none = np.zeros((0, 3), np.float32)
        receivers = Receivers(points.position, points.ns, points.ng, points.error, none, none, none, np.zeros(0, np.float32), none)
    n, columns = len(points.position), 3 * scene.emitters.light_groups
    # Side by side: light that met no glass, light that passed it.
    out = np.zeros((n, 2 * columns), np.float32)
    reflected = np.zeros((n if lobes else 0, 2 * columns), np.float32)
    rays = 0

    def work(begin, end):
        return _direct_chunk(scene, receivers, begin, end, samples, reflections, np.uint32(seed), np.int64(first), out, reflected)

    if len(scene.emitters.groups) and samples >= 1:
        rays = sum(run_chunks(work, n, CHUNK, threads, progress))
    if not lobes:
        reflected = np.zeros_like(out)
    halves = [light[:, part] for part in (slice(columns), slice(columns, None)) for light in (out, reflected)]
    return DirectLight(*map(np.ascontiguousarray, halves)), rays
