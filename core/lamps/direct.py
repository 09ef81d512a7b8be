"""Direct light: shadow rays from shading points to emitters.

Emitters near the scene are few and are then sampled one by one ("groups"), or many and then share a tree, which
is one group.  A point's samples are dealt to the groups by what each could send there unshadowed, at least one to
each that can send anything; where there are fewer samples than groups, the groups are drawn at random.

Half of the rays to the world are aimed at where the other half of the neighbours' rays have found it (`world_guide`), and so are those to large lamps
(`lamp_guide`).  Where gather rays of indirect light have been traced before, these tell of the world as well, and count themselves for what they find of it,
and of surfaces that shine.  Which lamps of the tree are seen at all, a few rays ahead of the others tell (`seen`).  Shadow rays leave from
all places where a pixel shows the surface, so that edges of shadows within it are smooth.

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
from ..references import Reference
from ..sampling.hashing import hash_combine, to_unit, uniform
from ..sampling.sequences import sobol
from ..scene import DIFFUSE, SHADOW, SUN
from ..surfaces.bumps import mean_shadowing, shadowing
from ..surfaces.layout import EMISSION, SURFACE
from ..surfaces.lobes import ALPHA, LOBE, WIDE_ALPHA, lobe_value, reflection_count, set_lobe
from ..surfaces.program import new_registers
from ..surfaces.rough_diffuse import shape
from ..surfaces.sheen import factors
from ..surfaces.terminator import LOW, lift
from ..surfaces.visibility import BY_LENS, OUTSIDE, nearest_surface, transmittance1
from ..threads import Progress, run_chunks
from .departures import REFLECTS, VARIED, differs, is_patterned, on_one_facet, place_for_world, place_of, position_at, surface_at
from .escapes import ESCAPED, SHINING, VEIL, VEILED, GatherRays, gather_path, gather_ray, no_gather_rays
from .lamp_guide import (
    aim_at_lamp,
    cell_on_lamp,
    draw_on_lamp,
    forget_lamps,
    keep_lamps_in_mind,
    look_around_lamps,
    new_lamp_guide,
    remember_lamp,
)
from .links import is_hidden_alike, lights
from .lookup import BOTH, EACH, can_be_met, emitter_density, emitter_of, ray_kind, share_of, sought
from .sample import sample_emitter
from .seen import learn
from .sharp import sharp_emitters
from .tables import AXIS_Z, CASTS_SHADOW, GLOSSY_ONLY, ONE_MINUS_COS, SEEN_BY_GLOSSY, SHARP, TRIANGLE, WORLD
from .tree import CUT, choose, cut_estimate, cut_for, descend, importance, importance_around
from .world import faces_portals, world_density, world_radiance
from .world_guide import NEAR, aim, draw, expect, forget, keep_in_mind, look_around, new_world_guide, own_density, remember

CHUNK = 4096  # points a chunk
_BLOCK, _BLOCK_RAYS = 1024, 8192  # points whose rays are traced together, lamp by lamp, and the most of these rays, nearly
_GUIDED = np.uint32(0x6D1D)
# One point of so many sends at most so many rays ahead, which tell what lamps of the tree are seen from there: 1/32 of all rays.  So many are traced at once.
_PILOT_STEP, _PILOTS_A_POINT, _PILOTS = 16, 8, 256
_FORGOTTEN = np.float32(0.5)  # of what the blocks before have told
_SEES_WORLD = 1  # escaped gather rays of a point, on average, that tell enough of where the world is seen
_LEAST_LEARNT = 512  # points of a chunk, for which that is worth it
_MOST_NODES = 1 << 12  # of the tree, all of which are looked at for each block
_PILOT = np.uint32(0x9107)
_DEFENSIVE = np.float32(0.1)  # share of the samples dealt evenly to the groups that can send light
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_THIRD = np.float32(1 / 3)
_INV_PI = np.float32(1 / math.pi)
_UNGUIDED = 4  # one of so many rays to the world is not aimed where gather rays tell of it, too
# A lamp is no surface that a ray could hit, but one often lies in a surface: stop short of it, by some tens of the rounding
# errors of the distance and no more, for what is as close as that behind a wall shines through it.
_SHORT = np.float32(1.0 - 1e-5)


class Receivers(NamedTuple):
    """N points to be lit, as `view.points.ShadingPoints`.

    The arrays from wo to albedo are empty where no point has a lobe; spread is (N, 0, 3) where each has one place, and so are facet, varied and turned.
    triangle: -1 where rays leave from the facets themselves.
    gathered, met, gather_number, gather_key: count, met, number, and (seed, first) of `GatherRays`.
    """

    position: np.ndarray
    ns: np.ndarray
    ng: np.ndarray
    error: np.ndarray
    triangle: np.ndarray
    wo: np.ndarray
    f0: np.ndarray
    f90: np.ndarray
    roughness: np.ndarray
    albedo: np.ndarray
    spread: np.ndarray
    facet: np.ndarray
    varied: np.ndarray
    turned: np.ndarray
    tilt: np.ndarray
    rough: np.ndarray
    sheen: np.ndarray
    gloss: np.ndarray
    entered: np.ndarray
    gathered: np.ndarray
    met: np.ndarray
    gather_number: np.ndarray
    gather_key: np.ndarray


@inlined
def group_estimate(emitters, group, px, py, pz, around, nx, ny, nz):
    """Estimate of the unshadowed irradiance (mean of the channels) of a group at p, and up to `around` (m) beside it; 0 only where it sends none."""
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
    return importance_around(tree.nodes, tree.two_sided, e, px, py, pz, around, nx, ny, nz)


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


@inlined
def _counts(scene, e, triangle, glossy):
    """Whether emitter e shines on a point of a triangle (-1: of none); glossy: whether that reflects by a lobe."""
    return lights(scene.emitters, e, scene.object, triangle) and (glossy or not scene.emitters.flags[e] & GLOSSY_ONLY)


@leaf
def expected_samples(scene, triangle, px, py, pz, nx, ny, nz, samples, estimate, count, expected):
    """How many of `samples` each group gets at p, of a triangle, with normal n, on average, into `expected` (G,), and its unshadowed light into `estimate` (G,).

    count: (G,) int32, scratch.
    """
    emitters = scene.emitters
    for g in range(len(emitters.groups)):
        estimate[g] = group_estimate(emitters, g, px, py, pz, _0, nx, ny, nz)
        if emitters.groups[g] >= 0 and not lights(emitters, emitters.groups[g], scene.object, triangle):
            estimate[g] = _0
    deal(estimate, samples, np.float32(0.5), count, expected)
    for g in range(len(emitters.groups)):
        expected[g] = _1 / expected[g] if expected[g] > _0 else _0


@leaf
def aimed_density(emitters, expected, estimate, e, px, py, pz, nx, ny, nz, dx, dy, dz):
    """Light samples per steradian in a direction d that meets emitter e, where groups of a `group_estimate` get `expected` samples each.

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
            number = expected[g] * min(_1, own / max(estimate[g], np.float32(1e-30)))
    return number * emitter_density(emitters, e, px, py, pz, nx, ny, nz, dx, dy, dz) if number > _0 else _0


@inlined
def _lobe_share(emitters, e, lobe, reflections, expected, estimate, px, py, pz, nx, ny, nz, dx, dy, dz):
    """Lobe times cosine (r, g, b) towards a sample of emitter e, times the share that rays drawn from the lobe leave to it."""
    r, g, b, density = lobe_value(lobe, dx, dy, dz)
    if not (density > _0 and emitters.flags[e] & SEEN_BY_GLOSSY):
        return _0, _0, _0
    if reflections > 0 and can_be_met(emitters, e):
        aimed = aimed_density(emitters, expected, estimate, e, px, py, pz, nx, ny, nz, dx, dy, dz)
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
def _shadow_ray_from(scene, triangle, e, u, v, px, py, pz, gx, gy, gz, error, dx, dy, dz, t, across):
    """The `shadow_ray` from the point p of a triangle (-1 for none) to the light at distance t along d, as Cycles has it leave smooth surfaces.

    across: cosine of d with g.  Where it is 0 or less, the light comes from below the facet.
    """
    if across < LOW and triangle >= 0:
        lx, ly, lz = lift(scene.vertices, scene.triangles, scene.corner_normals, triangle, px, py, pz, gx, gy, gz, dx, dy, dz)
        px, py, pz = px + lx, py + ly, pz + lz
        # To the lamp from there: beside the old way it may end in a wall.
        if t < np.float32(np.inf) and max(abs(lx), abs(ly), abs(lz)) > _0:
            dx, dy, dz = t * dx - lx, t * dy - ly, t * dz - lz
            t = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz))
            inverse = _1 / max(t, np.float32(1e-20))
            dx, dy, dz = inverse * dx, inverse * dy, inverse * dz
    if across <= _0:  # start above, from where `shadow_ray` goes down by half: the facet is in the way of what does not pass beside it
        rise = np.float32(2.0) * error
        px, py, pz = px + rise * gx, py + rise * gy, pz + rise * gz
    return shadow_ray(scene, e, u, v, px, py, pz, gx, gy, gz, error, dx, dy, dz, t)


@inlined
def _is_apart(emitters, kind):
    """Whether a ray of this `ray_kind` stands for a shadow ray and a diffuse one that may meet different objects."""
    return emitters.parted and (kind == BOTH or kind == EACH)


@leaf
def _unhidden(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, end, kind, entered, lamp):
    """The `transmittance1` of a ray of one kind, nothing where what is opaque is in the way."""
    if occluded1(scene.rays, OPAQUE, packet, ox, oy, oz, dx, dy, dz, _0, end, kind):
        return _0, _0, _0, _1
    return transmittance1(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, _0, end, kind, kind, entered, lamp)


@leaf
def _through(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, end, kinds, kind, entered, cosine, lamp):
    """The `transmittance1` of a ray to an emitter, of this `ray_kind`, from a surface that it leaves at `cosine`.

    Where `_is_apart`, opaque things count, too: no ray need have been traced before.
    lamp: as `transmittance1` takes it.
    Of BOTH kinds, Cycles gives each sampler its share, but what scattered rays find beyond glass it takes whole.
    """
    if kind != BOTH and kind != EACH:
        return transmittance1(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, _0, end, kinds, kind, entered, lamp)
    if scene.emitters.parted:
        r, g, b, clear = _unhidden(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, end, DIFFUSE, entered, lamp)
        sr, sg, sb, shadowed = _unhidden(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, end, SHADOW, entered, lamp)
    else:
        r, g, b, clear = transmittance1(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, _0, end, kinds, DIFFUSE, entered, lamp)
        sr, sg, sb, shadowed = transmittance1(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, _0, end, kinds, SHADOW, entered, lamp)
    if clear < _0 and shadowed < _0:
        return r, g, b, clear
    if clear < _0:  # by a lens or frosted glass: `methods.caustics`
        r = g = b = _0
        clear = _1
    if shadowed < _0:
        sr = sg = sb = _0
    share = _1 if kind == EACH else sought(scene.emitters.world, dx, dy, dz, cosine)
    own, rest, glass = share * shadowed, (_1 - share) * clear, _1 - clear
    direct = own * (sr + sg + sb) + rest * (r + g + b)
    whole = direct + glass * (r + g + b)
    r, g, b = own * sr + (rest + glass) * r, own * sg + (rest + glass) * g, own * sb + (rest + glass) * b
    return r, g, b, direct / whole if whole > _0 else _1


@leaf
def passed(scene, packet, rows, surface, e, ox, oy, oz, dx, dy, dz, end, entered, cosine):
    """`passed_straight`, with what a lens or frosted glass throws elsewhere as if it went straight on."""
    r, g, b, clear = passed_straight(scene, packet, rows, surface, e, ox, oy, oz, dx, dy, dz, end, entered, cosine, True)
    return r, g, b, max(_0, clear)


@leaf
def passed_straight(scene, packet, rows, surface, e, ox, oy, oz, dx, dy, dz, end, entered, cosine, aimed):
    """Share of light (r, g, b) of emitter e that a shadow ray lets through up to t = end, and the share of that which passed no glass, or `BY_LENS`, `BY_FROST`.

    entered: solids of glass that the path has entered before.  cosine: at which the ray leaves its surface.  aimed: whether it is a shadow ray, or has
    met the emitter by chance.
    """
    kinds = scene.emitters.shadow_kinds[e]
    kind = ray_kind(scene.emitters, e, dx, dy, dz)
    if kind == EACH and not aimed:
        kind = DIFFUSE
    if not _is_apart(scene.emitters, kind):
        if occluded1(scene.rays, OPAQUE, packet, ox, oy, oz, dx, dy, dz, _0, end, kinds):
            return _0, _0, _0, _1
        if not scene.emitters.cutouts:
            return _1, _1, _1, _1
    lamp = scene.emitters.kind[e] != WORLD
    return _through(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, end, kinds, kind, entered, cosine, lamp)


@leaf
def direct_sample_at(
    scene, packet, rows, surface, triangle, glossy, x, y, z, error, gx, gy, gz, sx, sy, sz, entered, seed, path, dimension
):
    """Irradiance (r, g, b) at one point by one shadow ray, W/m^2, the cosine and the emitter of its light (-1: none), its cosine with g, the share
    that passed no glass, and its direction; the mean is exact.

    That cosine is 0 or less where light comes from below the facet, yet above the smooth surface.
    For the tails of paths: random numbers are hashed from (seed, path, dimension, 0..3).
    scene: Transport.  packet, rows, surface: scratch.  triangle: that the point is of, -1 for none.
    glossy: whether what shines on glossy surfaces alone counts.
    g, s: geometric and shading normal, on the lit side.  entered: solids of glass that the path has entered.
    """
    emitters = scene.emitters
    chosen = -1
    total = chosen_estimate = _0
    u = uniform(seed, path, dimension, 0)
    for group in range(len(emitters.groups)):  # reservoir sampling with one recycled random number
        if len(emitters.groups) == 1 and emitters.groups[0] < 0:
            estimate = _1  # nothing else to choose
        else:
            estimate = group_estimate(emitters, group, x, y, z, _0, sx, sy, sz)
        if estimate > _0 and (emitters.groups[group] < 0 or _counts(scene, emitters.groups[group], triangle, glossy)):
            total += estimate
            p = estimate / total
            if u < p:
                chosen, chosen_estimate = group, estimate
                u = u / p
            else:
                u = (u - p) / (_1 - p)
            u = min(u, np.float32(0.99999994))
    if chosen < 0:
        return _0, _0, _0, _0, -1, _0, _1, _0, _0, _0
    e, probability = emitters.groups[chosen], _1
    if e < 0:
        tree = emitters.tree
        e, probability = descend(
            tree.nodes, tree.two_sided, tree.children, tree.root, x, y, z, sx, sy, sz, uniform(seed, path, dimension, 1)
        )
        if e < 0 or not _counts(scene, e, triangle, glossy):
            return _0, _0, _0, _0, -1, _0, _1, _0, _0, _0
    dx, dy, dz, t, r, g, b, u, v = sample_emitter(
        emitters, e, x, y, z, sx, sy, sz, uniform(seed, path, dimension, 2), uniform(seed, path, dimension, 3), rows, surface
    )
    cosine, across = sx * dx + sy * dy + sz * dz, gx * dx + gy * dy + gz * dz
    if cosine <= _0 or not max(r, g, b) > _0:
        return _0, _0, _0, _0, -1, _0, _1, _0, _0, _0
    if across <= _0 and (triangle < 0 or emitters.kind[e] == WORLD):
        return _0, _0, _0, _0, -1, _0, _1, _0, _0, _0
    w = cosine * total / (chosen_estimate * probability)
    clear = _1
    if emitters.flags[e] & CASTS_SHADOW:
        ox, oy, oz, rx, ry, rz, end = _shadow_ray_from(scene, triangle, e, u, v, x, y, z, gx, gy, gz, error, dx, dy, dz, t, across)
        tr, tg, tb, clear = passed(scene, packet, rows, surface, e, ox, oy, oz, rx, ry, rz, end, entered, cosine)
        r, g, b = r * tr, g * tg, b * tb
    return w * r, w * g, w * b, cosine, e, across, clear, dx, dy, dz


@leaf
def direct_irradiance_at(scene, packet, rows, surface, x, y, z, error, gx, gy, gz, sx, sy, sz, seed, path, dimension):
    """The irradiance of `direct_sample_at`."""
    r, g, b, _, _, _, _, _, _, _ = direct_sample_at(
        scene, packet, rows, surface, -1, False, x, y, z, error, gx, gy, gz, sx, sy, sz, OUTSIDE, seed, path, dimension
    )
    return r, g, b


class _Block(NamedTuple):
    """What is known of the B points of a block and their G groups of emitters.

    estimate, weight: (B, G) float32, unshadowed irradiance, and weight of a sample.  count: (B, G) int32, samples of each group.
    first: (B,) int32, how many of the world's samples come first, where the others are aimed by what neighbours found.
    members, cdf: (B, CUT), size: (B,), the cut through the tree of emitters.
    lobe: (B, LOBE) float32.  drawn: (B,) int64, rays drawn from the lobe.  expected: (B, G) float32, samples beside those.
    number: (B, G) float32, samples of each group on average.  unshadowed: (B, G) float32, `group_estimate` of the tree, as `aimed_density` takes it.
    patterned: (B, G) float32, mean of `ShadingPoints.varied` over the albedos at the places that a group's samples leave from.
    turned: (LOBE,) float32, scratch: the lobe about the normal of one place.
    lead: (B, G) int32, how many samples of a group come first, where the others are aimed at what neighbours have seen of a lamp.
    """

    estimate: np.ndarray
    weight: np.ndarray
    count: np.ndarray
    first: np.ndarray
    members: np.ndarray
    cdf: np.ndarray
    size: np.ndarray
    lobe: np.ndarray
    drawn: np.ndarray
    expected: np.ndarray
    number: np.ndarray
    unshadowed: np.ndarray
    patterned: np.ndarray
    turned: np.ndarray
    lead: np.ndarray


class _Rays(NamedTuple):
    """R shadow rays of a block.

    ray: (R, 7) float32, origin, direction, end of the range; the end is below 0 where nothing may stand in the way.
    light, glossy: (R, 3) float32, what they bring if nothing does.
    point, column: (R,) int32, of the block and of the output.  turn: (R,) int32, number among the first samples of the world, gather rays after the others, or of a lamp with a slot; -1 for the rest.
    kinds: (R,) int64, kinds of what may stand in the way.  kind: (R,) int64, what it is to materials, see `ray_kind`.  lamp: (R,) bool, whether it goes to a lamp, not to the world.
    through: (R, 3) float32, the part that gets through.  clear: (R,) float32, the part of that which passed no glass.
    slot: (R,) int32, of the lamp in `LampGuide`, -1 for none.  cell: (R,) int32, sent: (R,) float32, its `cell_on_lamp` and light, of those with a slot.
    """

    ray: np.ndarray
    light: np.ndarray
    glossy: np.ndarray
    point: np.ndarray
    column: np.ndarray
    turn: np.ndarray
    kinds: np.ndarray
    kind: np.ndarray
    lamp: np.ndarray
    through: np.ndarray
    clear: np.ndarray
    slot: np.ndarray
    cell: np.ndarray
    sent: np.ndarray


@kernel
def _new_block(points, groups):
    f, i = np.float32, np.int32
    return _Block(
        np.zeros((points, groups), f), np.zeros((points, groups), f), np.zeros((points, groups), i), np.zeros(points, i),
        np.empty((points, CUT), i), np.empty((points, CUT), f), np.empty(points, np.int64),
        np.full((points, LOBE), -_1), np.zeros(points, np.int64), np.zeros((points, groups), f),
        np.zeros((points, groups), f), np.zeros((points, groups), f), np.zeros((points, groups), f), np.empty(LOBE, f),
        np.zeros((points, groups), i),
    )  # fmt: skip


@kernel
def _new_rays(n):
    f, i = np.float32, np.int32
    return _Rays(
        np.empty((n, 7), f), np.empty((n, 3), f), np.zeros((n, 3), f), np.empty(n, i), np.empty(n, i), np.empty(n, i), np.empty(n, np.int64),
        np.empty(n, np.int64), np.zeros(n, np.bool_), np.empty((n, 3), f), np.empty(n, f), np.empty(n, i), np.empty(n, i), np.empty(n, f),
    )  # fmt: skip


@leaf
def _prepare(scene, nodes, points, i, k, samples, reflections, seed, first, spare, slot, block):
    """Row k of `block` for point i; nodes: of the tree, by which its lamps are chosen."""
    emitters = scene.emitters
    tree = emitters.tree
    px, py, pz = points.position[i, 0], points.position[i, 1], points.position[i, 2]
    sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
    around = _0  # from all places, some of which a lamp's cone may leave out
    for j in range(points.spread.shape[1]):
        x, y, z = points.spread[i, j, 0], points.spread[i, j, 1], points.spread[i, j, 2]
        around = max(around, x * x + y * y + z * z)
    around = np.float32(math.sqrt(around))
    for g in range(len(emitters.groups)):
        if emitters.groups[g] < 0:
            block.size[k], block.estimate[k, g] = cut_for(
                nodes, tree.two_sided, tree.children, tree.root, px, py, pz, around, sx, sy, sz, block.members[k], block.cdf[k]
            )
        else:
            block.estimate[k, g] = group_estimate(emitters, g, px, py, pz, around, sx, sy, sz)
            for j in range(points.varied.shape[1]):  # what the one normal is turned from another may face
                if not block.estimate[k, g] > _0 and differs(points, i, j):
                    ax, ay, az, _, _, _, _ = surface_at(points, i, j)
                    block.estimate[k, g] = group_estimate(emitters, g, px, py, pz, around, ax, ay, az)
            if not _counts(scene, emitters.groups[g], points.triangle[i], len(points.wo) > 0 and _has_lobe(points, i)):
                block.estimate[k, g] = _0
    deal(block.estimate[k], samples, to_unit(hash_combine(hash_combine(seed, i), first)), block.count[k], block.weight[k])
    for g in range(len(emitters.groups)):
        block.number[k, g] = _1 / block.weight[k, g] if block.weight[k, g] > _0 else _0
        block.patterned[k, g] = _0
        n = block.count[k, g]
        if n > 0 and is_patterned(points, i):
            scramble = hash_combine(hash_combine(seed, i), g)
            index = first * _samples_a_pass(block.weight[k, g])
            albedo = _0
            for sample in range(n):
                albedo += points.varied[i, place_of(points, i, index + sample, scramble), REFLECTS]
            block.patterned[k, g] = albedo / np.float32(n)
    if len(points.wo) > 0:
        set_point_lobe(points, i, block.lobe[k])
        block.drawn[k] = reflection_count(block.lobe[k], points.albedo[i, 0], points.albedo[i, 1], points.albedo[i, 2], reflections)
        if block.drawn[k] > 0:
            expected_samples(scene, points.triangle[i], px, py, pz, sx, sy, sz, samples, block.unshadowed[k], spare, block.expected[k])
    if tree.root >= 0 and points.gathered[i] > 0 and not block.drawn[k] > 0:
        for g in range(len(emitters.groups)):
            if emitters.groups[g] < 0:
                block.unshadowed[k, g] = group_estimate(emitters, g, px, py, pz, _0, sx, sy, sz)
    block.first[k] = 0
    for g in range(len(emitters.groups)):
        n = block.count[k, g]
        by_chance = abs(np.float32(n) * block.weight[k, g] - _1) > np.float32(1e-3)  # where samples are scarce
        block.lead[k, g] = n if by_chance or slot[g] < 0 else (n + 1) // 2
        if _is_world(emitters, g):
            if by_chance or n < 1 or faces_portals(emitters.world, px, py, pz, sx, sy, sz):
                block.first[k] = n
            elif points.gathered[i] > 0:
                block.first[k] = max(1, n // _UNGUIDED)
            else:
                block.first[k] = (n + 1) // 2


@inlined
def _has_lobe(points, i):
    return max(points.f0[i, 0], points.f0[i, 1], points.f0[i, 2], points.f90[i, 0], points.f90[i, 1], points.f90[i, 2]) > _0


@inlined
def unevenness(points, i, dx, dy, dz):
    """What point i reflects of diffuse light from direction d over what its albedo says, which is the mean over all directions."""
    factor = _1
    if points.tilt[i] > _0:
        across = points.ng[i, 0] * dx + points.ng[i, 1] * dy + points.ng[i, 2] * dz
        factor = shadowing(points.tilt[i], across) / mean_shadowing(points.tilt[i])
    if points.rough[i] > _0 and len(points.wo) > 0:
        vx, vy, vz = points.wo[i, 0], points.wo[i, 1], points.wo[i, 2]
        sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
        factor *= shape(points.rough[i], sx * dx + sy * dy + sz * dz, sx * vx + sy * vy + sz * vz, dx * vx + dy * vy + dz * vz)
    return factor


@inlined
def _is_sheen(points, i):
    return len(points.sheen) > 0 and points.sheen[i, 3] != _0


@inlined
def _by_sheen(points, i, dx, dy, dz, r, g, b):
    """Light (r, g, b) from d, as it counts at a point that `_is_sheen`."""
    fr, fg, fb = factors(
        points.sheen[i], points.ns[i, 0], points.ns[i, 1], points.ns[i, 2], points.wo[i, 0], points.wo[i, 1], points.wo[i, 2], dx, dy, dz
    )
    return fr * r, fg * g, fb * b


@inlined
def is_turned(points, i):
    """Whether the normals of point i differ, so that `highlights` are found apart."""
    for j in range(points.turned.shape[1]):
        if points.turned[i, j, 0] != _0 or points.turned[i, j, 1] != _0 or points.turned[i, j, 2] != _0:
            return True
    return False


@inlined
def is_turned_at(points, i, place):
    """Whether lobes of point i are about another normal at one of its places: a small ball mirrors a lamp in a part of a pixel alone."""
    return place > 0 and points.varied.shape[1] > 0 and is_turned(points, i) and on_one_facet(points, i, place)


@inlined
def _is_world(emitters, g):
    return emitters.groups[g] >= 0 and emitters.kind[emitters.groups[g]] == WORLD


@inlined
def _pattern_weight(points, i, place, mean, count):
    """Weight of the light at one of the places of point i for its albedo, of `count` samples with the mean of `varied` given.

    The weights of all samples are 1 on average, so that even light shows the mean albedo without noise, and what they add is n / (n - 1) times the
    covariance of albedo and light at n places: as much as that of all places, in the mean.
    """
    n = min(count, points.spread.shape[1] + 1)
    if n < 2:
        return _1
    return max(_0, _1 + np.float32(n) / np.float32(n - 1) * (points.varied[i, place, REFLECTS] - mean))


@inlined
def _samples_a_pass(weight):
    """By how many samples of a weight the passes of a group are apart: rounded up, where they vary."""
    return np.int64(_1 / weight + np.float32(0.999))


@inlined
def _put(scene, points, block, i, k, e, place, dx, dy, dz, t, u, v, r, g, b, w, shine, turn, rays, n):
    """Ray n from a place of point i to the light (r, g, b) of emitter e in the direction d, weighed by w, for lobes by `shine` -> n + 1, or n where none of it can arrive."""
    emitters = scene.emitters
    px, py, pz = position_at(points, i, place)
    sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
    nx, ny, nz, gx, gy, gz, triangle = sx, sy, sz, points.ng[i, 0], points.ng[i, 1], points.ng[i, 2], points.triangle[i]
    if place > 0 and emitters.kind[e] != WORLD and points.varied.shape[1] > 0:
        nx, ny, nz, gx, gy, gz, triangle = surface_at(points, i, place)
    own, across = sx * dx + sy * dy + sz * dz, gx * dx + gy * dy + gz * dz
    cosine = max(_0, nx * dx + ny * dy + nz * dz)
    if max(own, cosine) <= _0 or not max(r, g, b) > _0:
        return n
    if across <= _0:  # from below the facet, yet above the smooth surface: by this ray alone, for no gather ray or ray of a lobe goes there
        if points.tilt[i] > _0 or triangle < 0 or emitters.kind[e] == WORLD:
            return n
    elif points.gathered[i] > 0 and emitters.kind[e] == TRIANGLE and is_hidden_alike(emitters, e):
        w *= share_of(
            aimed_density(emitters, block.number[k], block.unshadowed[k], e, px, py, pz, sx, sy, sz, dx, dy, dz),
            _gather_density(points.gathered[i], own),
        )
    light, glossy, ray = rays.light[n], rays.glossy[n], rays.ray[n]
    cosine *= unevenness(points, i, dx, dy, dz)
    light[0], light[1], light[2] = w * cosine * r, w * cosine * g, w * cosine * b
    if _is_sheen(points, i):
        light[0], light[1], light[2] = _by_sheen(points, i, dx, dy, dz, light[0], light[1], light[2])
    if block.lobe[k, ALPHA] > _0 and shine > _0 and own > _0 and not (emitters.flags[e] & SHARP and is_turned(points, i)):
        drawn = block.drawn[k] if across > _0 else np.int64(0)
        lobe = block.lobe[k]
        if is_turned_at(points, i, place):
            lobe = block.turned
            set_place_lobe(points, i, place, lobe)
        fr, fg, fb = _lobe_share(emitters, e, lobe, drawn, block.expected[k], block.unshadowed[k], px, py, pz, sx, sy, sz, dx, dy, dz)
        glossy[0], glossy[1], glossy[2] = shine * fr * r, shine * fg * g, shine * fb * b
    else:
        glossy[0] = glossy[1] = glossy[2] = _0
    if emitters.flags[e] & GLOSSY_ONLY:
        light[0] = light[1] = light[2] = _0
    if not max(light[0], light[1], light[2], glossy[0], glossy[1], glossy[2]) > _0:
        return n
    ray[3], ray[4], ray[5], ray[6] = dx, dy, dz, -_1
    if emitters.flags[e] & CASTS_SHADOW:
        ray[0], ray[1], ray[2], ray[3], ray[4], ray[5], ray[6] = _shadow_ray_from(
            scene, triangle, e, u, v, px, py, pz, gx, gy, gz, points.error[i], dx, dy, dz, t, across
        )
    rays.point[n], rays.column[n], rays.turn[n], rays.kinds[n] = k, 3 * emitters.light_group[e], turn, emitters.shadow_kinds[e]
    rays.kind[n] = ray_kind(emitters, e, dx, dy, dz)
    rays.lamp[n] = emitters.kind[e] != WORLD
    rays.slot[n] = -1
    return n + 1


@leaf
def _aim(scene, nodes, points, start, size, block, slot, seed, first, rows, surface, rays):
    """Shadow rays of the `size` points from `start` on, but for the later ones of the world and of lamps with a `slot` -> how many; nodes: as for `_prepare`."""
    emitters = scene.emitters
    tree = emitters.tree
    n = np.int64(0)  # no literal, for which the callee would be compiled again
    # Lamp by lamp, so that the rays of a packet go the same way.
    for g in range(len(emitters.groups)):
        world = _is_world(emitters, g)
        most = 0
        for k in range(size):
            most = max(most, block.first[k] if world else block.lead[k, g])
        for sample in range(most):
            for k in range(size):
                if sample >= (block.first[k] if world else block.lead[k, g]):
                    continue
                i = start + k
                scramble = hash_combine(hash_combine(seed, i), g)
                # Later passes go on where this group's samples end.
                index = first * _samples_a_pass(block.weight[k, g]) + sample
                place = place_for_world(points, i, index, scramble) if world else place_of(points, i, index, scramble)
                px, py, pz = position_at(points, i, place)
                sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
                part = _1
                if points.varied.shape[1] > 0 and not world:  # whose light varies little within a pixel, and gather rays know one normal
                    sx, sy, sz, _, _, _, _ = surface_at(points, i, place)
                    part = _pattern_weight(points, i, place, block.patterned[k, g], block.count[k, g])
                e = emitters.groups[g]
                w = block.weight[k, g]
                if e < 0:
                    e, rarity = choose(
                        nodes, tree.two_sided, tree.children, px, py, pz, sx, sy, sz, block.members[k], block.cdf[k], block.size[k],
                        sobol(index, 2, scramble), to_unit(hash_combine(scramble, index)),
                    )  # fmt: skip
                    if e < 0 or not lights(emitters, e, scene.object, points.triangle[i]):
                        continue
                    w *= rarity
                u1, u2 = sobol(index, 0, scramble), sobol(index, 1, scramble)
                dx, dy, dz, t, r, gr, b, u, v = sample_emitter(emitters, e, px, py, pz, sx, sy, sz, u1, u2, rows, surface)
                guided = slot[g] >= 0
                before = n
                n = _put(
                    scene, points, block, i, k, e, place, dx, dy, dz, t, u, v, r, gr, b, part * w, w, sample if world or guided else -1, rays, n
                )  # fmt: skip
                if guided and n > before:
                    rays.slot[before], rays.cell[before], rays.sent[before] = slot[g], cell_on_lamp(u1, u2), r + gr + b
        if world:
            n = _add_gathered(scene, points, start, size, block, g, rays, n)
    return n


@leaf
def _pilot(scene, packet, rows, surface, points, begin, end, samples, seed, spare, slot, block, rays, nodes, lamp, known):
    """Rays of some of the points begin..end-1 to lamps of the tree, which bring no light but tell `nodes`, a copy of the tree's, who is seen -> how many.

    lamp: (_PILOTS,) int64, scratch.  known: (3, K) float32, what `learn` takes; rays are added to its first two rows.
    They are the same in all passes, for samples of later passes go on in the sequences only where each group gets as many.
    """
    emitters = scene.emitters
    tree = emitters.tree
    seed = hash_combine(seed, _PILOT)
    draws = min(_PILOTS_A_POINT, max(1, samples // 2))
    cast = np.int64(0)
    n = np.int64(0)
    last = end - _PILOT_STEP + 1
    for at in range(begin, last, _PILOT_STEP):
        i = at + np.int64(hash_combine(seed, at) % np.uint32(_PILOT_STEP))
        _prepare(scene, nodes, points, i, 0, samples, 0, seed, np.int64(0), spare, slot, block)
        px, py, pz = points.position[i, 0], points.position[i, 1], points.position[i, 2]
        sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
        key = hash_combine(seed, i)
        for j in range(draws):
            e, _ = choose(
                nodes, tree.two_sided, tree.children, px, py, pz, sx, sy, sz, block.members[0], block.cdf[0], block.size[0],
                sobol(j, 2, key), to_unit(hash_combine(key, j)),
            )  # fmt: skip
            if e < 0 or not lights(emitters, e, scene.object, points.triangle[i]):
                continue
            dx, dy, dz, t, r, g, b, u, v = sample_emitter(
                emitters, e, px, py, pz, sx, sy, sz, sobol(j, 0, key), sobol(j, 1, key), rows, surface
            )
            before = n
            n = _put(scene, points, block, i, 0, e, np.int64(0), dx, dy, dz, t, u, v, r, g, b, _1, _1, -1, rays, n)
            if n > before:
                lamp[before], rays.point[before] = e, i - begin
        if n + _PILOTS_A_POINT > _PILOTS or at + _PILOT_STEP >= last:
            cast += _trace(scene, packet, rows, surface, points, begin, rays, n)
            for j in range(n):
                known[0, lamp[j]] += _1
                known[1, lamp[j]] += np.float32(max(rays.through[j, 0], rays.through[j, 1], rays.through[j, 2]) > _0)
            n = np.int64(0)
    learn(tree, known[0], known[1], known[2], nodes)
    return cast


@leaf
def _add_gathered(scene, points, start, size, block, g, rays, n):
    """The gather rays of these points that the world may shine along, by group g, as its first samples -> how many rays there are then."""
    emitters = scene.emitters
    e = emitters.groups[g]
    seed, first = np.uint32(points.gather_key[0]), points.gather_key[1]
    for k in range(size):
        i = start + k
        if not block.estimate[k, g] > _0:
            continue
        for s in range(points.gathered[i]):
            if not points.met[i, s] & (ESCAPED | VEILED):
                continue
            dx, dy, dz, _ = gather_ray(seed, points.gather_number[i], first + s, points.ns[i, 0], points.ns[i, 1], points.ns[i, 2])
            r, gr, b = world_radiance(emitters.world, dx, dy, dz)
            before = n
            n = _put(
                scene, points, block, i, k, e, np.int64(0), dx, dy, dz,
                np.float32(np.inf), _0, _0, r, gr, b, _1, _0, block.first[k] + s, rays, n,
            )  # fmt: skip
            if n > before and points.met[i, s] & ESCAPED:
                rays.ray[before, 6] = -_1
    return n


@leaf
def _aim_at_world(scene, points, start, size, block, guide, seed, first, rows, surface, rays, n):
    """The world's later rays of these points, aimed at where neighbours have found it, after n others -> how many there are then; the shares of the first ones are set."""
    emitters = scene.emitters
    for g in range(len(emitters.groups)):
        if not _is_world(emitters, g):
            continue
        e = emitters.groups[g]
        for k in range(size):
            i = start + k
            before, gathered = np.int64(block.first[k]), points.gathered[i]
            if not block.weight[k, g] > _0:
                continue
            later = block.count[k, g] - before
            sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
            number = block.number[k, g]
            guided = aim(guide, k, sx, sy, sz, before, later, number, gathered)
            scramble = hash_combine(hash_combine(seed, i), g)
            for s in range(later):
                # Unguided, they end the sequence that the first ones have begun; guided, they are one of their own.
                index = first * np.int64(block.count[k, g]) + before + s
                key = scramble
                if guided:
                    key, index = hash_combine(scramble, _GUIDED), first * later + s
                place = place_for_world(points, i, index, key)
                px, py, pz = position_at(points, i, place)
                u1, u2 = sobol(index, 0, key), sobol(index, 1, key)
                if guided:
                    dx, dy, dz, density = draw(guide, u1, u2)
                    r, gr, b = world_radiance(emitters.world, dx, dy, dz)
                    own = own_density(
                        world_density(emitters.world, px, py, pz, sx, sy, sz, dx, dy, dz), density, before, later, number, guided
                    )
                    even = _gather_density(gathered, sx * dx + sy * dy + sz * dz)
                    w, shine = _1 / (own + even), _1 / own
                else:
                    dx, dy, dz, _, r, gr, b, _, _ = sample_emitter(emitters, e, px, py, pz, sx, sy, sz, u1, u2, rows, surface)
                    w = shine = block.weight[k, g]
                    if gathered > 0:
                        own = number * world_density(emitters.world, px, py, pz, sx, sy, sz, dx, dy, dz)
                        even = _gather_density(gathered, sx * dx + sy * dy + sz * dz)
                        w *= own / (own + even)
                n = _put(
                    scene, points, block, i, k, e, place, dx, dy, dz, np.float32(np.inf), _0, _0, r, gr, b, w, shine, -1, rays, n
                )  # fmt: skip
    return n


@leaf
def _aim_at_lamps(scene, points, start, size, block, guide, seed, first, rows, surface, rays):
    """Later rays of these points to lamps with a slot, aimed at what neighbours have seen of them -> how many; the shares of the first ones are set."""
    emitters = scene.emitters
    n = np.int64(0)
    for g in range(len(emitters.groups)):
        slot = guide.slot[g]
        if slot < 0:
            continue
        e = emitters.groups[g]
        for k in range(size):
            i = start + k
            before = np.int64(block.lead[k, g])
            later = block.count[k, g] - before
            if later < 1:
                continue
            guided = aim_at_lamp(guide, slot, k, before, later)
            scramble = hash_combine(hash_combine(seed, i), g)
            aimed = hash_combine(scramble, _GUIDED)
            for s in range(later):
                index = first * _samples_a_pass(block.weight[k, g]) + before + s
                place = place_of(points, i, index, scramble)
                px, py, pz = position_at(points, i, place)
                sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
                part = _1
                if points.varied.shape[1] > 0:
                    sx, sy, sz, _, _, _, _ = surface_at(points, i, place)
                    part = _pattern_weight(points, i, place, block.patterned[k, g], block.count[k, g])
                w = block.weight[k, g]
                if guided:  # by a sequence of their own
                    u1, u2 = sobol(first * later + s, 0, aimed), sobol(first * later + s, 1, aimed)
                    u1, u2, density = draw_on_lamp(guide, u1, u2)
                    w = _1 / (np.float32(before) + np.float32(later) * density)
                else:
                    u1, u2 = sobol(index, 0, scramble), sobol(index, 1, scramble)
                dx, dy, dz, t, r, gr, b, u, v = sample_emitter(emitters, e, px, py, pz, sx, sy, sz, u1, u2, rows, surface)
                n = _put(scene, points, block, i, k, e, place, dx, dy, dz, t, u, v, r, gr, b, part * w, w, -1, rays, n)
    return n


@leaf
def _learn_lamps(size, rays, n, guide):
    """What the first n rays of `size` points tell of lamps with a slot."""
    forget_lamps(guide)
    for j in range(n):
        if rays.slot[j] >= 0:
            through = (rays.through[j, 0] + rays.through[j, 1] + rays.through[j, 2]) * _THIRD
            remember_lamp(guide, rays.slot[j], rays.point[j], rays.turn[j], rays.cell[j], rays.sent[j], through)
    look_around_lamps(guide, size)


@inlined
def _gather_density(rays, cosine):
    """Density (1/sr) of so many gather rays."""
    return np.float32(rays) * max(_0, cosine) * _INV_PI


@leaf
def _add_shining(scene, packet, rows, surface, points, start, size, block, out):
    """Adds what the gather rays of the `size` points from `start` on have found to shine, less the share of shadow rays, to their rows of `out`."""
    emitters = scene.emitters
    half = out.shape[1] // 2
    seed, first = np.uint32(points.gather_key[0]), points.gather_key[1]
    for k in range(size):
        i = start + k
        px, py, pz = points.position[i, 0], points.position[i, 1], points.position[i, 2]
        gx, gy, gz = points.ng[i, 0], points.ng[i, 1], points.ng[i, 2]
        sx, sy, sz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2]
        for s in range(points.gathered[i]):
            if not points.met[i, s] & SHINING:
                continue
            dx, dy, dz, cosine = gather_ray(seed, points.gather_number[i], first + s, sx, sy, sz)
            ox, oy, oz = offset_origin(px, py, pz, gx, gy, gz, points.error[i], dx, dy, dz)
            triangle, _, _, t, r, g, b, clear, _ = nearest_surface(
                scene,
                packet,
                rows,
                surface,
                ox,
                oy,
                oz,
                dx,
                dy,
                dz,
                np.float32(np.inf),
                DIFFUSE,
                seed,
                gather_path(points.gather_number[i], first + s),
                VEIL,
                OUTSIDE,
            )
            e = emitter_of(emitters, triangle) if triangle >= 0 else -1
            if e < 0 or not (is_hidden_alike(emitters, e) and lights(emitters, e, scene.object, points.triangle[i])):
                continue
            er, eg, eb = surface[EMISSION], surface[EMISSION + 1], surface[EMISSION + 2]
            if clear < _1:
                _, _, _, straight = transmittance1(
                    scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, _0, _SHORT * t, DIFFUSE, DIFFUSE, np.int64(points.entered[i]), True
                )  # fmt: skip
                if straight < _0:  # by a lens or frosted glass: `methods.caustics`
                    continue
            aimed = aimed_density(emitters, block.number[k], block.unshadowed[k], e, px, py, pz, sx, sy, sz, dx, dy, dz)
            density = _gather_density(points.gathered[i], cosine)
            w = cosine * unevenness(points, i, dx, dy, dz) * share_of(density, aimed) / density
            r, g, b = w * r * er, w * g * eg, w * b * eb
            if _is_sheen(points, i):
                r, g, b = _by_sheen(points, i, dx, dy, dz, r, g, b)
            c = 3 * emitters.light_group[e]
            out[i, c] += clear * r
            out[i, c + 1] += clear * g
            out[i, c + 2] += clear * b
            out[i, c + half] += (_1 - clear) * r
            out[i, c + half + 1] += (_1 - clear) * g
            out[i, c + half + 2] += (_1 - clear) * b


@leaf
def _trace(scene, packet, rows, surface, points, start, rays, n):
    """Trace the first n rays of the points from `start` on -> how many shadow rays these are."""
    cast = 0
    for begin in range(0, n, WIDTH):
        end = min(begin + WIDTH, n)
        for lane in range(WIDTH):
            if begin + lane < end and rays.ray[begin + lane, 6] >= _0:
                cast += 1
                if _is_apart(scene.emitters, rays.kind[begin + lane]):
                    cast += 1
                    disable_ray(packet, lane)
                    continue
                p = rays.ray[begin + lane]
                set_ray(packet, lane, p[0], p[1], p[2], p[3], p[4], p[5], _0, p[6], rays.kinds[begin + lane])
            else:
                disable_ray(packet, lane)
        occluded_packet(scene.rays, OPAQUE, packet, end - begin)
        for j in range(begin, end):
            p = rays.ray[j]
            tr = tg = tb = clear = _1
            if p[6] >= _0:
                apart = _is_apart(scene.emitters, rays.kind[j])
                if not apart and is_occluded(packet, j - begin):
                    tr = tg = tb = _0
                elif apart or scene.emitters.cutouts:
                    entered = np.int64(points.entered[start + rays.point[j]])
                    normal = points.ns[start + rays.point[j]]
                    cosine = max(_0, normal[0] * p[3] + normal[1] * p[4] + normal[2] * p[5])
                    tr, tg, tb, clear = _through(
                        scene, packet, rows, surface, p[0], p[1], p[2], p[3], p[4], p[5], p[6], rays.kinds[j], rays.kind[j], entered,
                        cosine, rays.lamp[j],
                    )  # fmt: skip
                    if clear == BY_LENS:  # it throws it elsewhere: `methods.caustics`
                        tr = tg = tb = _0
            rays.through[j, 0], rays.through[j, 1], rays.through[j, 2], rays.clear[j] = tr, tg, tb, clear
    return cast


@leaf
def _learn(scene, points, start, size, block, rays, n, guide):
    """What the first n rays tell of the world."""
    emitters = scene.emitters
    forget(guide)
    for g in range(len(emitters.groups)):
        if _is_world(emitters, g):
            for k in range(size):
                expect(guide, k, block.estimate[k, g])
    for j in range(n):
        turn = rays.turn[j]
        if turn < 0 or rays.slot[j] >= 0 or not max(rays.through[j, 0], rays.through[j, 1], rays.through[j, 2]) > _0:
            continue
        i, k = start + rays.point[j], rays.point[j]
        dx, dy, dz = rays.ray[j, 3], rays.ray[j, 4], rays.ray[j, 5]
        r, gr, b = world_radiance(emitters.world, dx, dy, dz)
        light = r * rays.through[j, 0] + gr * rays.through[j, 1] + b * rays.through[j, 2]
        cosine = points.ns[i, 0] * dx + points.ns[i, 1] * dy + points.ns[i, 2] * dz
        # From where the ray leaves: from elsewhere in the pixel a portal lies elsewhere, and its edge with it.
        px, py, pz = rays.ray[j, 0], rays.ray[j, 1], rays.ray[j, 2]
        density = world_density(emitters.world, px, py, pz, points.ns[i, 0], points.ns[i, 1], points.ns[i, 2], dx, dy, dz)
        remember(guide, k, turn, dx, dy, dz, light, density, cosine, block.first[k], points.gathered[i])
    look_around(guide, size)


@leaf
def _collect(points, rays, n, start, guide, lamps, out, glossy, apart, unshadowed):
    """Add what the first n rays bring to the points from `start` on; what passed glass goes to the second half.

    unshadowed: (N, 4) float32, what those to columns from `apart` on would bring were nothing in their way, and how many they are; of no rows where nobody asks.
    """
    half = out.shape[1] // 2
    for j in range(n):
        i, c = start + rays.point[j], rays.column[j]
        if len(unshadowed) > 0 and c >= apart:
            for channel in range(3):
                unshadowed[i, channel] += rays.light[j, channel]
            unshadowed[i, 3] += _1
        share = shine_share = _1
        if rays.slot[j] >= 0:
            share = shine_share = lamps.share[rays.slot[j], rays.point[j], rays.turn[j]]
        elif rays.turn[j] >= 0:
            share, shine_share = guide.share[rays.point[j], rays.turn[j]], guide.shine[rays.point[j], rays.turn[j]]
        clear = rays.clear[j]
        if clear < _0:  # `BY_FROST`, of which diffuse surfaces and wide lobes have what photons bring: `methods.caustics`
            share = clear = _0
            if points.roughness[i] ** 2 > WIDE_ALPHA:
                shine_share = _0
        for channel in range(3):
            light = share * rays.through[j, channel] * rays.light[j, channel]
            out[i, c + channel] += clear * light
            out[i, c + channel + half] += (_1 - clear) * light
            if len(glossy) > 0:
                shine = shine_share * rays.through[j, channel] * rays.glossy[j, channel]
                glossy[i, c + channel] += clear * shine
                glossy[i, c + channel + half] += (_1 - clear) * shine


@leaf
def _looks_ahead(scene, points, begin, middle, end):
    """Whether gather rays of the points begin..middle-1 have found too little of the world, and those up to `end` may tell more."""
    world = False
    for g in range(len(scene.emitters.groups)):
        world = world or _is_world(scene.emitters, g)
    if not world:
        return False
    escaped = 0
    for i in range(begin, min(middle, end)):
        for s in range(points.gathered[i]):
            escaped += points.met[i, s] & ESCAPED != 0
    if escaped >= _SEES_WORLD * (middle - begin):
        return False
    for i in range(middle, end):
        for s in range(points.gathered[i]):
            if points.met[i, s] & (ESCAPED | VEILED):
                return True
    return False


@kernel
def _direct_chunk(scene, points, begin, end, samples, reflections, seed, first, out, glossy, apart, unshadowed):
    """Direct irradiance of the points begin..end-1 into `out`, what their lobes reflect into `glossy` -> number of rays.

    apart, unshadowed: as of `_collect`.
    """
    groups = len(scene.emitters.groups)
    packet = new_packet()
    rows = new_registers(scene.materials)
    surface = np.zeros(SURFACE, np.float32)
    spare = np.empty(groups, np.int32)
    gather = points.met.shape[1]
    block_size = max(NEAR, min(_BLOCK, end - begin, _BLOCK_RAYS // (samples + gather // 2) // NEAR * NEAR))
    rays, later = _new_rays(block_size * (samples + gather)), _new_rays(block_size * samples)
    block = _new_block(block_size, groups)
    guide = new_world_guide(block_size, samples + gather)
    lamps = new_lamp_guide(scene.emitters, block_size, samples)
    ahead = begin + block_size
    if _looks_ahead(scene, points, begin, ahead, min(ahead + block_size, end)):
        size = min(block_size, end - ahead)
        for k in range(size):
            _prepare(scene, scene.emitters.tree.nodes, points, ahead + k, k, samples, reflections, seed, first, spare, lamps.slot, block)
            for g in range(groups):
                if not _is_world(scene.emitters, g):
                    block.count[k, g] = block.lead[k, g] = 0
        n = _aim(scene, scene.emitters.tree.nodes, points, ahead, size, block, lamps.slot, seed, first, rows, surface, rays)
        ahead_rays = _trace(scene, packet, rows, surface, points, ahead, rays, n)
        _learn(scene, points, ahead, size, block, rays, n, guide)
        keep_in_mind(guide, size)
    else:
        ahead_rays = 0
    out[begin:end] = _0
    if len(glossy) > 0:
        glossy[begin:end] = _0
    n_rays = np.int64(ahead_rays)
    tree = scene.emitters.tree
    nodes = tree.nodes
    learns = False
    for g in range(groups):  # `stages.one_by_one` has a tree, but no group of it
        learns = learns or scene.emitters.groups[g] < 0
    learns = learns and end - begin >= _LEAST_LEARNT and len(nodes) <= _MOST_NODES
    known = np.zeros((3, len(nodes) if learns else 0), np.float32)
    lamp = np.empty(_PILOTS, np.int64)
    if learns:
        nodes = nodes.copy()
    for start in range(begin, end, block_size):
        size = min(block_size, end - start)
        if learns:
            nodes[:] = tree.nodes
            known *= _FORGOTTEN
            n_rays += _pilot(
                scene, packet, rows, surface, points, start, start + size, samples, seed, spare, lamps.slot, block, rays, nodes, lamp, known
            )
        guided = False
        for k in range(size):
            _prepare(scene, nodes, points, start + k, k, samples, reflections, seed, first, spare, lamps.slot, block)
            guided = guided or block.first[k] > 0 or points.gathered[start + k] > 0
        n = _aim(scene, nodes, points, start, size, block, lamps.slot, seed, first, rows, surface, rays)
        n_rays += _trace(scene, packet, rows, surface, points, start, rays, n)
        n_later = np.int64(0)
        if len(lamps.seen) > 0:
            _learn_lamps(size, rays, n, lamps)
            n_later = _aim_at_lamps(scene, points, start, size, block, lamps, seed, first, rows, surface, later)
            if start == begin:
                lamps.before[:] = _0
            keep_lamps_in_mind(lamps, size)
        if guided:
            _learn(scene, points, start, size, block, rays, n, guide)
            n_later = _aim_at_world(scene, points, start, size, block, guide, seed, first, rows, surface, later, n_later)
            if start == begin:  # it counts for itself
                guide.before[:] = _0
            keep_in_mind(guide, size)
        # Not before the later ones are aimed, which tell what share the first have.
        _collect(points, rays, n, start, guide, lamps, out, glossy, apart, unshadowed)
        n_rays += _trace(scene, packet, rows, surface, points, start, later, n_later)
        _collect(points, later, n_later, start, guide, lamps, out, glossy, apart, unshadowed)
        if len(scene.emitters.triangle) > 0:
            _add_shining(scene, packet, rows, surface, points, start, size, block, out)
    return n_rays


@leaf
def set_point_lobe(points, i, lobe):
    """The lobe of point i (of `Receivers` or `ShadingPoints`) into a row."""
    set_lobe(
        lobe, points.ns[i, 0], points.ns[i, 1], points.ns[i, 2], points.ng[i, 0], points.ng[i, 1], points.ng[i, 2],
        points.wo[i, 0], points.wo[i, 1], points.wo[i, 2], points.roughness[i],
        points.f0[i, 0], points.f0[i, 1], points.f0[i, 2], points.f90[i, 0], points.f90[i, 1], points.f90[i, 2],
        points.gloss[i, 0], points.gloss[i, 1], points.gloss[i, 2], points.gloss[i, 3],
    )  # fmt: skip


@leaf
def set_place_lobe(points, i, place, lobe):
    """The lobe of point i about the shading normal at one of its places into a row."""
    nx, ny, nz, _, _, _, _ = surface_at(points, i, place)
    set_lobe(
        lobe, nx, ny, nz, points.ng[i, 0], points.ng[i, 1], points.ng[i, 2],
        points.wo[i, 0], points.wo[i, 1], points.wo[i, 2], points.roughness[i],
        points.f0[i, 0], points.f0[i, 1], points.f0[i, 2], points.f90[i, 0], points.f90[i, 1], points.f90[i, 2],
        points.gloss[i, 0], points.gloss[i, 1], points.gloss[i, 2], points.gloss[i, 3],
    )  # fmt: skip


class DirectLight(NamedTuple):
    """Direct light at N points, three columns for each of G light groups.

    irradiance: (N, 3 G) float32 W/m^2.  glossy: (N, 3 G) float32 W/m^2/sr, what lobes reflect to the viewer.
    irradiance_by_glass, glossy_by_glass: the same, of light that passed glass on its way from the lamp: glass is a bounce to
    Cycles, which counts it as indirect light.
    sharp: (N, 3 G) float32, what of `irradiance` is of lamps with sharp shadows, None where it is not told apart; unshadowed: (N, 3) float32, what that of all groups
    would be without anything in its way, and sharp_rays: (N,) float32, how many rays have told.
    shine: (N, 3 G) float32, what of `glossy` are `highlights`, None for none.
    """

    irradiance: np.ndarray
    glossy: np.ndarray
    irradiance_by_glass: np.ndarray
    glossy_by_glass: np.ndarray
    sharp: np.ndarray | None = None
    unshadowed: np.ndarray | None = None
    sharp_rays: np.ndarray | None = None
    shine: np.ndarray | None = None


def direct_irradiance(
    scene, points, samples: int, seed: int, threads: int = 0, progress: Progress | None = None, *, first: int = 0,
    gathered: GatherRays | None = None,
):  # fmt: skip
    """Direct irradiance at shading points, as `direct_light`; points need the arrays position, ns, ng and error only.

    Returns:
        ((N, 3 G) float32 W/m^2, with what passes glass, number of rays traced).
    """
    light, rays = direct_light(scene, points, samples, seed, threads, progress, first=first, lobes=False, gathered=gathered)
    return light.irradiance + light.irradiance_by_glass, rays


def direct_light(
    scene, points, samples: int, seed: int, threads: int = 0, progress: Progress | None = None, *, first: int = 0, reflections: int = 0,
    lobes: bool = True, apart: bool = False, gathered: GatherRays | None = None,
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
        lobes: whether the points' lobes matter at all; without, they need the arrays position, ns, ng and error only (and may have spread, facet, varied and tilt; rough surfaces are lit as smooth ones).
        apart: whether to tell apart what comes from lamps with sharp shadows (`sharp_emitters`), if there are any.
        gathered: gather rays that the points have traced, which then count for what they find of the world and of shining surfaces; None for none.

    Returns:
        (DirectLight, number of rays traced).
    """
    if gathered is None:
        gathered = no_gather_rays(len(points.position))
    others = gathered.count, gathered.met, gathered.number, np.array([gathered.seed, gathered.first], np.int64)
    if lobes:
        receivers = Receivers(*(getattr(points, name) for name in Receivers._fields[: -len(others)]), *others)
    else:
        none = np.zeros((0, 3), np.float32)
        tilt, rough = (getattr(points, name, np.zeros(len(points.position), np.float32)) for name in ("tilt", "rough"))
        spread = getattr(points, "spread", np.zeros((len(points.position), 0, 3), np.float32))
        facet = getattr(points, "facet", np.zeros((len(points.position), 0), np.int32))
        varied = getattr(points, "varied", np.zeros((len(points.position), 0, VARIED), np.float32))
        entered = np.zeros(len(points.position), np.uint8)
        triangle = getattr(points, "triangle", np.full(len(points.position), -1, np.int32))
        receivers = Receivers(
            points.position, points.ns, points.ng, points.error, triangle, none, none, none, np.zeros(0, np.float32), none, spread, facet, varied,
            np.zeros((0, 0, 3), np.float32), tilt, rough, np.zeros((0, 4), np.float32), np.zeros((0, 4), np.float32), entered, *others,
        )  # fmt: skip
    receivers = Reference(receivers)
    n, columns = len(points.position), 3 * scene.emitters.light_groups
    sharp = sharp_emitters(scene.emitters, samples) if apart else None
    if sharp is not None:  # further light groups, to the kernels
        group = scene.emitters.light_group + scene.emitters.light_groups * sharp
        scene = scene._replace(emitters=scene.emitters._replace(light_group=group.astype(np.int32)))
        columns *= 2
    # Side by side: light that met no glass, light that passed it.
    out = np.zeros((n, 2 * columns), np.float32)
    reflected = np.zeros((n if lobes else 0, 2 * columns), np.float32)
    unshadowed = np.zeros((n if sharp is not None else 0, 4), np.float32)
    apart = 3 * scene.emitters.light_groups
    rays = 0

    def work(begin, end):
        numbers = np.uint32(seed), np.int64(first)
        return _direct_chunk(scene, receivers, begin, end, samples, reflections, *numbers, out, reflected, np.int64(apart), unshadowed)

    if len(scene.emitters.groups) and samples >= 1:
        rays = sum(run_chunks(work, n, CHUNK, threads, progress))
    if not lobes:
        reflected = np.zeros_like(out)
    halves = [light[:, part] for part in (slice(columns), slice(columns, None)) for light in (out, reflected)]
    if sharp is None:
        return DirectLight(*map(np.ascontiguousarray, halves)), rays
    soft, hard = ([half[:, part] for half in halves] for part in (slice(columns // 2), slice(columns // 2, None)))
    told = np.ascontiguousarray(hard[0]), np.ascontiguousarray(unshadowed[:, :3]), unshadowed[:, 3]
    return DirectLight(*(a + b for a, b in zip(soft, hard)), *told), rays
