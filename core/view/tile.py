"""The samples of a 4x4 pixel tile: traced 16 rays at a time, evaluated, and sorted by the surfaces that they show.

A tile's samples come in two turns.  The first ones tell which pixels hold edges, holes, textures or lamps; their neighbours get more.  Were a
pixel's own samples asked, those that by chance miss a thin thing would never be joined by others, and thin things would fade.

Frosted glass shows what lies behind it as a mirror does: by a lobe about the straight way (`surfaces.frosted`), which is the pane's own.  Where
the glass is only a little rough, samples go on by rays drawn from the lobe and the surfaces that they meet get points of their own; else they only look
whether further surfaces of rough glass follow, whose blur the lobe takes on.

Surfaces with transparency are passed through at random, with exact weights, as Cycles does, by numbers that are even over a pixel's
samples.  At the first surfaces of glass, and the first that is not, nothing is left to chance: a sample shows both what they
reflect and what lies behind.  So it is at mirrors: a sample shows both their own colour and, by a ray drawn from the lobe, what they show, which gets shading points of its own as what lies behind glass does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel, leaf
from ..lamps.links import in_set
from ..lamps.tables import SEEN_BY_CAMERA, SEEN_BY_GLOSSY, SEEN_THROUGH_GLASS
from ..lamps.world import world_radiance
from ..rays.offsets import hit_point, offset_origin
from ..rays.packet import T_FAR, WIDTH, disable_ray, hit_t, hit_triangle, hit_u, hit_v, set_ray
from ..rays.trace import ALL, COHERENT, intersect_packet
from ..sampling.hashing import hash_key, to_unit, uniform
from ..scene import (
    CAMERA,
    COATED,
    FROSTED,
    GLOSSY,
    MIRRORING,
    NORMAL_MAPPED,
    REFRACTIVE,
    SMOOTH_COAT,
    TRANSLUCENT,
    TRANSMISSION,
    TRANSPARENT,
)
from ..surfaces.arithmetic import normalized
from ..surfaces.bending import GOES_STRAIGHT, LOST, MOST_BENT, TURNS, bent, scattered
from ..surfaces.bumps import mean_shadowing
from ..surfaces.covers import looks_covered
from ..surfaces.frosted import joined_alpha
from ..surfaces.layout import (
    BEND,
    COAT,
    COAT_F0,
    COAT_ROUGHNESS,
    DIFFUSE_ROUGHNESS,
    EMISSION,
    FROST,
    GLOSS,
    GLOSSY_F0,
    GLOSSY_F90,
    NORMAL,
    REFRACTION,
    ROUGHNESS,
    SHEEN,
    SHEEN_ROUGHNESS,
    STRAY,
    TILT,
    TRANSPARENCY,
    bare,
    diffuse_albedo,
    diffuse_color,
    glossy_albedo,
    largest_kept,
    translucency,
)
from ..surfaces.lobes import ALPHA, LOBE, lobe_cosine, sample_lobe, seen_cosine, set_lobe
from ..surfaces.microfacet import SMALLEST_ALPHA
from ..surfaces.normals import mapped_normal, shading_normal
from ..surfaces.program import evaluate, from_within, specular_view
from ..surfaces.visibility import STRAIGHT_ON, passed_glass
from .camera import camera_ray, depth_along, pixel_sample
from .lamps import lamps_between

TILE = 4  # pixels along a tile's edge: 16 rays, one packet, for each sample index
PANES = 2  # surfaces of glass, mirrors, or one veil, that a sample shows as well as what lies behind them
POLISHED = np.float32(0.1)  # roughness of a mirror, at most
PERFECT = np.float32(0.02)  # the same where lamps are met by chance as well as by shadow rays
SHINY = np.float32(0.3)  # share of the glossy lobe in all that a mirror reflects, at least
MAX_LAYERS = 64  # transparent surfaces that one primary ray passes at most
WORLD_DEPTH = np.float32(1e10)  # what Blender's depth pass has where nothing is hit

# Two samples of a pixel lie on one surface where their normals agree and neither leaves the other's plane
# by more than this part of the pixel's width there.
SAME_NORMAL = np.float32(0.9)
SAME_PLANE = np.float32(0.5)
SAME_REACH = np.float32(3.0)
BENT = np.float32(4.0)  # times the width of a pixel beyond a mirror: it may be curved
# Squared deviation, by the squared mean, of what the samples of a pixel reflect and emit, above which their neighbours get more of them.
VARIED = np.float32(0.2)
# Columns of the pixels' layers; what is emitted by each light group, behind no glass, one surface of it, and more, comes last.
ALBEDO, NORMALS, MEAN_NORMALS, POSITION, DEPTH, CLEAR, EMITTED = 0, 3, 6, 9, 12, 13, 14
GLASS = 3  # kinds of what is emitted: behind no glass, one surface of it, and more
# Bits of the way that a sample takes at a surface: it shows it, passes straight through, passes through glass, is reflected.
SHOWN, STRAIGHT, REFRACTED, REFLECTED = 1, 2, 4, 8
LOOKING = SHOWN | 16  # shows a pane of frosted glass, whose lobe shows all that lies behind, and looks for more of it
SURFACES, ALL_LIGHT = 1, 2  # what rows of their own show of a mirror's lobe
# Columns of what is known of a row (`Tile.sample`) and of the sums over a surface's rows (`Tile.group`).
PLACE, ERROR, FACING, SHADED, TILTED, ROUGH, BEYOND, SHEENED, REFLECTED_PART, COAT_SHADED, SAMPLE = 0, 3, 4, 7, 10, 11, 12, 13, 17, 18, 21
MEMBERS, G_ALBEDO, G_F0, G_F90, G_ROUGHNESS, G_TRANSLUCENCY, G_THROUGH, G_FROST, G_GLOSS, G_COAT, G_COAT_F0, G_COAT_ROUGHNESS, G_COLUMNS = (
    0,
    1,
    4,
    7,
    10,
    11,
    14,
    17,
    18,
    22,
    25,
    26,
    27,
)
_GOLDEN = np.uint32(2654435769)  # 2^32 over the golden ratio
FINEST = np.float32(1e-3)  # shares of the samples below which what is left of their choice has too few bits
FAINT = np.float32(1e-12)  # albedo of which no share can be told
# Times the thickness of the frosted glass that a sample has passed: what is so far behind it lies beyond a hollow, in which the lamp of a shade hangs.
HOLLOW = np.float32(8.0)
WITHIN, LAST, THICKNESS = 0, 1, 2  # columns of `Tile.frosting`
BELOW_ONE = np.float32(1 - 2**-24)
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_THIRD = np.float32(1 / 3)


class Tile(NamedTuple):
    """What the 16 pixels of a tile show: a row for each sample, and one for each pane of glass, or veil, that samples look through.

    Rows 0..S-1 are the samples', rows S..count-1 the panes', of at most R = (1 + PANES) S.

    taken, count: (16,) int32, samples traced, and one more than the last row.
    hits: (16, R, 3) float32, bits of the triangle (-1 for none), u and v.  weight, direction: (16, R, 3) float32.
    depth: (16, R) float32 (m), by way of mirrors.  glass: (16, R) int32, surfaces of glass and mirrors before it.
    entered: (16, R) int32, solids of glass that the view has entered before and not left (see `surfaces.visibility`).
    kinds: (16, R) int32, of the ray that met it.  shining: (16, R) uint8, whether what shines there counts, which other rays may find.
    shown: (16, R) uint8, `SURFACES` where these, and `ALL_LIGHT` where also what shines in its lobe has a row of its own.
    frost: (16, R) float32, width of the lobe in which a row of frosted glass shows what lies behind it, 0 for none; through: (16, R) uint8, as shown, of that lobe.
    lamps: (16, GLASS, G, 3) float32, light of the lamps in view, summed over the samples, by the surfaces of glass before it.
    out: (16, C) float32, sums of the pixels' layers.  nearest: (16,) int32, the row nearest to the camera, -1 for none.
    sample: (16, R, SAMPLE) float32, position, its error, geometric and shading normal, tilt and diffuse roughness of each row, solids of glass that a view is in beyond it, `ShadingPoints.sheen`, its diffuse albedo, all channels together, and the shading normal of its coat.  group_of: (16, R) int32, which of the
    pixel's surfaces it shows, -1 for none.  groups: (16,) int32, how many there are.  first: (16, R) int32, the first row of each.
    group: (16, R, G_COLUMNS) float32, rows of each, sums of albedo, f0, f90, roughness, translucency, of what frosted glass lets through, of that by its lobe's width, of `layout.GLOSS`, and of coats and of them by their numbers.
    sums: (16, 2) float32, of what the samples reflect and emit, and of its square.  mixed: (16,) uint8, whether they show several things.
    origin: (16, 3), passed: (16,) float32, of the rays of a packet.  axial, before: (16,) float32, depth (m) by a meter of it, and before its origin.
    choice: (16, 2) float32, a uniform number for the next surface with transparency, and the share of all samples among which it is even.
    shown_by: (16, R) int32, triangle of the mirror or the glass through which a row is seen, -1 for none.  scattered: (16, R) uint8, whether a ray through frosted glass has met it.
    parted: (16,) int32, whether the sample shows a surface without glass as well as what lies behind it.
    frosted: (16,) int32, the row whose lobe shows what the sample meets, -1 for none.  looking: (16,) uint8, whether the sample only looks for more glass.
    frosting: (16, 3) float32, of the glass that the lobe of that row stands for: 1 where the ray of a packet is in it, else 0; where along the ray its last
    surface is (m); how thick it is (m), 0 where that is not known yet, below 0 where the ray is beyond it.
    every: (A,) int32, all lamps.  lobe: (LOBE,) float32, scratch.
    """

    taken: np.ndarray
    count: np.ndarray
    hits: np.ndarray
    weight: np.ndarray
    direction: np.ndarray
    depth: np.ndarray
    glass: np.ndarray
    entered: np.ndarray
    kinds: np.ndarray
    shining: np.ndarray
    shown: np.ndarray
    frost: np.ndarray
    through: np.ndarray
    lamps: np.ndarray
    out: np.ndarray
    nearest: np.ndarray
    sample: np.ndarray
    group_of: np.ndarray
    groups: np.ndarray
    first: np.ndarray
    group: np.ndarray
    sums: np.ndarray
    mixed: np.ndarray
    origin: np.ndarray
    passed: np.ndarray
    axial: np.ndarray
    before: np.ndarray
    choice: np.ndarray
    parted: np.ndarray
    frosted: np.ndarray
    looking: np.ndarray
    frosting: np.ndarray
    every: np.ndarray
    lobe: np.ndarray
    shown_by: np.ndarray
    scattered: np.ndarray


@kernel
def new_tile(samples, light_groups, lamps):
    """Room for a tile of up to `samples` samples a pixel, in a scene with so many lamps."""
    f, i, rows = np.float32, np.int32, (1 + PANES) * samples
    return Tile(
        np.zeros(WIDTH, i), np.zeros(WIDTH, i), np.empty((WIDTH, rows, 3), f), np.empty((WIDTH, rows, 3), f), np.empty((WIDTH, rows, 3), f),
        np.empty((WIDTH, rows), f), np.empty((WIDTH, rows), i), np.empty((WIDTH, rows), i), np.empty((WIDTH, rows), i),
        np.empty((WIDTH, rows), np.uint8), np.empty((WIDTH, rows), np.uint8), np.empty((WIDTH, rows), f), np.empty((WIDTH, rows), np.uint8),
        np.empty((WIDTH, GLASS, light_groups, 3), f),
        np.empty((WIDTH, EMITTED + 3 * GLASS * light_groups), f), np.empty(WIDTH, i), np.empty((WIDTH, rows, SAMPLE), f),
        np.empty((WIDTH, rows), i), np.empty(WIDTH, i), np.empty((WIDTH, rows), i), np.empty((WIDTH, rows, G_COLUMNS), f),
        np.empty((WIDTH, 2), f), np.empty(WIDTH, np.uint8), np.empty((WIDTH, 3), f), np.empty(WIDTH, f), np.empty(WIDTH, f), np.empty(WIDTH, f),
        np.empty((WIDTH, 2), f), np.empty(WIDTH, i), np.empty(WIDTH, i), np.empty(WIDTH, np.uint8), np.empty((WIDTH, 3), f),
        np.arange(lamps).astype(i), np.empty(LOBE, f),
        np.empty((WIDTH, rows), i), np.empty((WIDTH, rows), np.uint8),
    )  # fmt: skip


@leaf
def clear_tile(tile, most):
    """Empty, before the first of its up to `most` samples a pixel."""
    tile.lamps[:] = _0
    tile.out[:] = _0
    tile.sums[:] = _0
    for lane in range(WIDTH):
        tile.taken[lane] = tile.groups[lane] = 0
        tile.count[lane] = most
        tile.nearest[lane] = -1
        tile.mixed[lane] = 0


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


@inlined
def _signed(flags, cosine, behind, kind, entered):
    """What `program.evaluate` takes for a view at `cosine` (0..1) of the back of a triangle or not, by a ray of this kind."""
    signed = specular_view(-cosine if behind else cosine, kind)
    return from_within(signed) if behind and entered == 0 and flags & REFRACTIVE else signed


@inlined
def _view_cosine(vertices, triangles, corner_normals, flags, triangle, u, v, dx, dy, dz, kind, entered):
    """`_signed` of a view along d, and whether it sees the back."""
    a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
    ex, ey, ez = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    fx, fy, fz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    gx, gy, gz = normalized(ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx)
    sx, sy, sz = shading_normal(corner_normals, triangle, u, v, gx, gy, gz)
    cosine = seen_cosine(flags, sx, sy, sz, gx, gy, gz, dx, dy, dz)
    behind = gx * dx + gy * dy + gz * dz > 0
    return _signed(flags, cosine, behind, kind, entered), behind


@inlined
def _choice(sample, seed, pixel):
    """A uniform number in [0, 1), from which a sample draws its way through all surfaces with transparency: a golden section further for each.

    However many samples a pixel has, the share of them that pass is right to within about one sample.
    """
    return to_unit(np.uint32(np.uint32(sample) * _GOLDEN + hash_key(seed, pixel, 0, 300)))


@leaf
def _way_on(surface, x, part, split):
    """What a sample shows of a surface with transparency: (way, r, g, b, w, x, p).

    x: uniform in [0, 1), picks a way in proportion to what there is to see.  split: the surface may show both itself and
    what lies behind, as several samples would: glass, and with `part` what lets light straight through.  (r, g, b) weighs what lies behind, w the surface itself.  What x leaves is returned: again
    uniform, and as evenly spread among those samples that go this way, whose share of all is p.
    """
    rr, rg, rb = surface[REFRACTION], surface[REFRACTION + 1], surface[REFRACTION + 2]
    tr, tg, tb = surface[TRANSPARENCY] - rr, surface[TRANSPARENCY + 1] - rg, surface[TRANSPARENCY + 2] - rb
    straight, refracted, kept = max(tr, tg, tb), max(rr, rg, rb), largest_kept(surface)
    total = straight + refracted + kept
    if split and part and refracted == _0 and kept > _0 and straight > _0:
        return SHOWN | STRAIGHT, tr, tg, tb, _1, x, _1
    x *= total
    if x < straight:
        w = total / straight
        return STRAIGHT, w * tr, w * tg, w * tb, _0, x / straight, straight / total
    x -= straight
    if split and refracted > _0:
        w = total / (refracted + kept)
        return SHOWN | REFRACTED, w * rr, w * rg, w * rb, w, x / (refracted + kept), _1 / w
    if x < refracted:
        w = total / refracted
        return REFRACTED, w * rr, w * rg, w * rb, _0, x / refracted, _1 / w
    return SHOWN, _0, _0, _0, total / kept if kept > _0 else _1, _0, _1


@leaf
def _reflected(materials, geometry, material, triangle, u, v, dx, dy, dz, kind, entered, u1, u2, rows, surface, lobe):
    """How a sample along d goes on from a surface that may mirror: (whether it does, origin, direction, r, g, b), with weight 0 for nowhere."""
    x, y, z, gx, gy, gz, error = hit_point(geometry.vertices, geometry.triangles, triangle, u, v)
    sx, sy, sz = shading_normal(geometry.corner_normals, triangle, u, v, gx, gy, gz)
    behind = gx * dx + gy * dy + gz * dz > 0
    cosine = seen_cosine(materials.flags[material], sx, sy, sz, gx, gy, gz, dx, dy, dz)
    signed = _signed(materials.flags[material], cosine, behind, kind, entered)
    evaluate(materials, material, geometry.attributes, triangle, u, v, signed, rows, surface)
    if surface[ROUGHNESS] > POLISHED:
        return False, x, y, z, dx, dy, dz, _0, _0, _0
    sx, sy, sz = mapped_normal(materials, material, surface, sx, sy, sz)
    if behind:
        gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
    cosine = lobe_cosine(sx, sy, sz, gx, gy, gz, -dx, -dy, -dz)
    fr, fg, fb = glossy_albedo(surface, cosine)
    ar, ag, ab = diffuse_albedo(surface, cosine)
    tr, tg, tb = translucency(surface, cosine)
    shiny = fr + fg + fb
    if not shiny > SHINY * (shiny + ar + ag + ab + tr + tg + tb):
        return False, x, y, z, dx, dy, dz, _0, _0, _0
    set_lobe(
        lobe, sx, sy, sz, gx, gy, gz, -dx, -dy, -dz, surface[ROUGHNESS],
        surface[GLOSSY_F0], surface[GLOSSY_F0 + 1], surface[GLOSSY_F0 + 2], surface[GLOSSY_F90], surface[GLOSSY_F90 + 1], surface[GLOSSY_F90 + 2],
        surface[GLOSS], surface[GLOSS + 1], surface[GLOSS + 2], surface[GLOSS + 3],
    )  # fmt: skip
    if not lobe[ALPHA] > _0:
        return False, x, y, z, dx, dy, dz, _0, _0, _0
    dx, dy, dz, r, g, b, _ = sample_lobe(lobe, u1, u2)
    if gx * dx + gy * dy + gz * dz <= _0:
        return True, x, y, z, dx, dy, dz, _0, _0, _0
    x, y, z = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
    return True, x, y, z, dx, dy, dz, r, g, b


@inlined
def _filtered(film, u):
    """Where in the pixel a sample lies, by a uniform u in [0, 1) and the offsets of `Film`."""
    x = u * np.float32(len(film) - 1)
    at = min(np.int64(x), len(film) - 2)
    return np.float32(0.5) + film[at] + (x - np.float32(at)) * (film[at + 1] - film[at])


@leaf
def _belongs(frosting, t, behind):
    """Whether frosted glass, met at t (m), belongs to the lobe of the row that `frosting` (3,) is of: not where it lies beyond a hollow; see `Tile`."""
    apart = t - frosting[LAST]
    if frosting[WITHIN] > _0:
        frosting[THICKNESS] = max(frosting[THICKNESS], apart)
    elif frosting[THICKNESS] > _0 and apart > HOLLOW * frosting[THICKNESS]:
        frosting[THICKNESS] = -_1
    frosting[WITHIN], frosting[LAST] = _0 if behind else _1, t
    return frosting[THICKNESS] >= _0


@leaf
def trace_samples(
    rays, camera, film, materials, geometry, lamps, near_lamps, n_lamps, tx, ty, lanes, begin, ends, seed, packet, rows, surface, tile
):
    """Trace the samples begin..ends[lane]-1 of each pixel of the tile whose first pixel is (tx, ty); the number of rays.

    Pixels with the same number of samples to come fill packets of one sample each; otherwise packets are filled with what comes next.
    lanes: (16, 2) int32, scratch.
    """
    count = 0
    n = 0
    most = 0
    for pixel in range(WIDTH):
        most = max(most, ends[pixel])
    for s in range(begin, most):
        for pixel in range(WIDTH):
            if s >= ends[pixel]:
                continue
            lanes[n, 0], lanes[n, 1] = pixel, s
            n += 1
            if n == WIDTH:
                count += _trace_lanes(
                    rays, camera, film, materials, geometry, lamps, near_lamps, n_lamps, tx, ty, lanes, n, seed, packet, rows, surface, tile
                )
                n = 0
    if n > 0:
        count += _trace_lanes(
            rays, camera, film, materials, geometry, lamps, near_lamps, n_lamps, tx, ty, lanes, n, seed, packet, rows, surface, tile
        )
    for pixel in range(WIDTH):
        tile.taken[pixel] = max(tile.taken[pixel], ends[pixel])
    return count


@leaf
def _trace_lanes(rays, camera, film, materials, geometry, lamps, near_lamps, n_lamps, tx, ty, lanes, n, seed, packet, rows, surface, tile):
    """Trace a packet of `n` samples, each the pixel and number of its row of `lanes`; the number of rays."""
    vertices, triangle_vertices, corner_normals = geometry.vertices, geometry.triangles, geometry.corner_normals
    attributes, material = geometry.attributes, geometry.material
    weight, direction, depth, glass, entered, kinds = tile.weight, tile.direction, tile.depth, tile.glass, tile.entered, tile.kinds
    origin, passed = tile.origin, tile.passed
    triangles = tile.hits.view(np.int32)
    count = n
    for lane in range(n):
        pixel, s = lanes[lane, 0], lanes[lane, 1]
        px, py = tx + pixel % TILE, ty + pixel // TILE
        triangles[pixel, s, 0] = -1
        # Numbered by the full frame: a border shows the very pixels of the whole picture.
        jx, jy = pixel_sample(s, seed, py * camera.size[0] + px)
        if len(film) > 0:
            jx, jy = _filtered(film, jx), _filtered(film, jy)
        ox, oy, oz, dx, dy, dz, slant = camera_ray(camera, np.float32(px) + jx, np.float32(py) + jy)
        set_ray(packet, lane, ox, oy, oz, dx, dy, dz, _0, (camera.clip[1] - camera.clip[0]) * slant, CAMERA)
        origin[lane, 0], origin[lane, 1], origin[lane, 2] = ox, oy, oz
        direction[pixel, s, 0], direction[pixel, s, 1], direction[pixel, s, 2] = dx, dy, dz
        weight[pixel, s, 0] = weight[pixel, s, 1] = weight[pixel, s, 2] = _1
        depth[pixel, s] = WORLD_DEPTH
        glass[pixel, s] = entered[pixel, s] = 0
        kinds[pixel, s] = CAMERA
        tile.shown[pixel, s] = tile.through[pixel, s] = 0
        tile.shown_by[pixel, s] = -1
        tile.frost[pixel, s] = _0
        tile.shining[pixel, s], tile.scattered[pixel, s] = 1, 0
        passed[lane] = _0
        tile.parted[lane] = tile.looking[lane] = 0
        tile.frosted[lane] = -1
        tile.frosting[lane, LAST] = _0
        tile.choice[lane, 0], tile.choice[lane, 1] = _choice(s, seed, py * camera.size[0] + px), _1
        tile.axial[lane] = depth_along(camera, dx, dy, dz)
        tile.before[lane] = camera.clip[0]
    layer = 0
    active = True
    while active and layer < MAX_LAYERS:
        intersect_packet(rays, ALL | COHERENT, packet, n)
        active = False
        for lane in range(n):
            triangle = hit_triangle(packet, lane)
            if packet.f[T_FAR * WIDTH + lane] < 0:  # done already
                continue
            pixel, s = lanes[lane, 0], lanes[lane, 1]
            mirrored = kinds[pixel, s] == GLOSSY
            n_met = len(tile.every) if mirrored else n_lamps
            if n_met > 0 and tile.shining[pixel, s] and not tile.looking[lane]:
                end = hit_t(packet, lane) if triangle >= 0 else np.float32(np.inf)
                seen_by = SEEN_BY_GLOSSY if mirrored else SEEN_THROUGH_GLASS if glass[pixel, s] > 0 else SEEN_BY_CAMERA
                lamps_between(
                    lamps, tile.every if mirrored else near_lamps, n_met, seen_by,
                    origin[lane, 0], origin[lane, 1], origin[lane, 2],
                    direction[pixel, s, 0], direction[pixel, s, 1], direction[pixel, s, 2], passed[lane], end,
                    tile.shown_by[pixel, s], geometry, weight[pixel, s], materials, rows, surface, tile.lamps[pixel, min(glass[pixel, s], 2)],
                )  # fmt: skip
            if triangle < 0:
                disable_ray(packet, lane)
                continue
            u, v, t = hit_u(packet, lane), hit_v(packet, lane), hit_t(packet, lane)
            dx, dy, dz = direction[pixel, s, 0], direction[pixel, s, 1], direction[pixel, s, 2]
            number = (ty + pixel // TILE) * camera.size[0] + tx + pixel % TILE
            way, r, g, b, w = SHOWN, _0, _0, _0, _1
            ox, oy, oz = origin[lane, 0], origin[lane, 1], origin[lane, 2]
            flags = materials.flags[material[triangle]]
            if flags & REFRACTIVE and looks_covered(geometry.covered, triangle, u, v):  # glass that nothing comes through, nor back from
                flags &= ~(TRANSPARENT | REFRACTIVE | FROSTED)
            if tile.looking[lane] and not flags & FROSTED:
                disable_ray(packet, lane)
                continue
            held = is_held_out(tile, geometry, pixel, s, triangle)
            behind, mirroring, frost = False, 0 if held else flags & MIRRORING, _0
            if flags & TRANSPARENT:
                cosine, behind = _view_cosine(
                    vertices, triangle_vertices, corner_normals, flags, triangle, u, v, dx, dy, dz, kinds[pixel, s], entered[pixel, s]
                )
                evaluate(materials, material[triangle], attributes, triangle, u, v, cosine, rows, surface)
                if held:  # whatever is not clear, glass as well
                    for c in range(3):
                        surface[TRANSPARENCY + c] -= surface[REFRACTION + c]
                        surface[REFRACTION + c] = _0
                    surface[FROST] = _0
                frost = surface[FROST] if surface[FROST] > SMALLEST_ALPHA else _0
                beyond = False
                if frost > _0 and tile.frosted[lane] >= 0:
                    row = tile.frosted[lane]
                    beyond = tile.frosting[lane, THICKNESS] < _0 or not _belongs(tile.frosting[lane], t, behind)
                    if not beyond:
                        tile.frost[pixel, row] = joined_alpha(tile.frost[pixel, row], frost)
                if tile.looking[lane]:
                    if frost == _0 or beyond or layer == MAX_LAYERS - 1:
                        disable_ray(packet, lane)
                    else:
                        set_ray(
                            packet,
                            lane,
                            ox,
                            oy,
                            oz,
                            dx,
                            dy,
                            dz,
                            t + np.float32(4e-6) * (t + camera.clip[0]),
                            np.float32(np.inf),
                            TRANSMISSION,
                        )
                        count += 1
                        active = True
                    continue
                if tile.choice[lane, 1] < FINEST:
                    tile.choice[lane, 0], tile.choice[lane, 1] = uniform(seed, number, s, 2 + layer), _1
                # Through frosted glass a sample looks by the pane's own lobe, and needs no further row.
                room = glass[pixel, s] + tile.parted[lane] < PANES
                blurred = frost > (POLISHED * POLISHED if room else PERFECT * PERFECT)
                if abs(surface[BEND] - _1) > STRAIGHT_ON:  # to the lobe it would be as straight as a thin wall
                    blurred = frost > _0 and surface[STRAY] > MOST_BENT
                blurred = blurred and tile.frosted[lane] < 0
                way, r, g, b, w, x, p = _way_on(surface, tile.choice[lane, 0], tile.parted[lane] == 0, room or blurred)
                if way == SHOWN | STRAIGHT:
                    tile.parted[lane] = 1
                tile.choice[lane, 0], tile.choice[lane, 1] = min(x, BELOW_ONE), p * tile.choice[lane, 1]
                mirroring = way == SHOWN and behind and flags & REFRACTIVE  # what is reflected totally
                if way == SHOWN | REFRACTED and blurred:
                    way = LOOKING
            if mirroring and glass[pixel, s] + tile.parted[lane] < PANES:
                mirrors, ox, oy, oz, dx, dy, dz, r, g, b = _reflected(
                    materials, geometry, material[triangle], triangle, u, v, dx, dy, dz, kinds[pixel, s], entered[pixel, s],
                    uniform(seed, number, s, 100 + layer), uniform(seed, number, s, 200 + layer), rows, surface, tile.lobe,
                )  # fmt: skip
                r, g, b = w * r, w * g, w * b
                if mirrors:
                    tile.shown[pixel, s] = ALL_LIGHT if surface[ROUGHNESS] <= PERFECT else SURFACES
                    if max(r, g, b) > _0:
                        way = SHOWN | REFLECTED
            seen_by_lobe = frost > PERFECT * PERFECT and way & REFRACTED and tile.frosted[lane] < 0
            turn = GOES_STRAIGHT
            if way & REFRACTED and abs(surface[BEND] - _1) > STRAIGHT_ON:
                turn, bx, by, bz, ex, ey, ez = bent(materials, geometry, material[triangle], triangle, u, v, dx, dy, dz, surface, True)
                if turn == TURNS:
                    ox, oy, oz, dx, dy, dz = bx, by, bz, ex, ey, ez
                    if not behind:  # within, it is narrower
                        surface[FROST] /= surface[BEND]
                elif turn == LOST:
                    r = g = b = _0
            turns = turn == TURNS
            if way & REFRACTED and frost > _0 and turn != LOST:  # about the way that clear glass would send it
                ox, oy, oz, dx, dy, dz, x = scattered(
                    materials, geometry, material[triangle], triangle, u, v, dx, dy, dz,
                    uniform(seed, number, s, 100 + layer), uniform(seed, number, s, 200 + layer), surface, tile.lobe,
                )  # fmt: skip
                r, g, b = x * r, x * g, x * b
            if way & SHOWN:
                row = s
                if way & (STRAIGHT | REFRACTED | REFLECTED):  # the sample goes on beyond a pane, which gets a row of its own
                    row = tile.count[pixel]
                    tile.count[pixel] += 1
                    glass[pixel, row], kinds[pixel, row], entered[pixel, row] = glass[pixel, s], kinds[pixel, s], entered[pixel, s]
                    tile.shown[pixel, row], tile.shining[pixel, row] = tile.shown[pixel, s], tile.shining[pixel, s]
                    tile.scattered[pixel, row] = tile.scattered[pixel, s]
                    tile.shown_by[pixel, row] = tile.shown_by[pixel, s]
                    tile.shown[pixel, s] = tile.through[pixel, row] = 0
                    tile.frost[pixel, row] = _0
                    for c in range(3):
                        direction[pixel, row, c] = direction[pixel, s, c]
                for c in range(3):
                    weight[pixel, row, c] = w * weight[pixel, s, c]
                triangles[pixel, row, 0] = triangle
                tile.hits[pixel, row, 1], tile.hits[pixel, row, 2] = u, v
                depth[pixel, row] = tile.before[lane] + t * tile.axial[lane]
                if way == LOOKING or seen_by_lobe:
                    tile.frosted[lane], tile.frost[pixel, row] = row, frost
                    tile.frosting[lane, WITHIN] = _0 if behind else _1
                    tile.frosting[lane, LAST], tile.frosting[lane, THICKNESS] = t, _0
                    tile.through[pixel, row] = ALL_LIGHT if way == LOOKING else SURFACES
            if way == SHOWN:
                disable_ray(packet, lane)
                continue
            if way == LOOKING:
                tile.looking[lane] = 1
                set_ray(packet, lane, ox, oy, oz, dx, dy, dz, t + np.float32(4e-6) * (t + camera.clip[0]), np.float32(np.inf), TRANSMISSION)
                count += 1
                active = True
                continue
            weight[pixel, s, 0] *= r
            weight[pixel, s, 1] *= g
            weight[pixel, s, 2] *= b
            start, far = _0, np.float32(np.inf)
            if way & REFLECTED or (way & REFRACTED and (turns or frost > _0)):  # it goes on from here
                tile.frosting[lane, LAST] -= t
            if way & REFLECTED:
                origin[lane, 0], origin[lane, 1], origin[lane, 2] = ox, oy, oz
                direction[pixel, s, 0], direction[pixel, s, 1], direction[pixel, s, 2] = dx, dy, dz
                tile.before[lane] += t * tile.axial[lane]
                glass[pixel, s] += 1
                kinds[pixel, s] = GLOSSY
                tile.shown_by[pixel, s] = triangle
                tile.shining[pixel, s] = surface[ROUGHNESS] <= PERFECT
                passed[lane] = _0
            else:
                # Past the hit by a few rounding errors of t, so that the surface is not met again.
                start = t + np.float32(4e-6) * (t + camera.clip[0])
                passed[lane] = t
                if way & REFRACTED:
                    glass[pixel, s] += 1
                    if not turns:  # else it meets the back at the angle at which it is within
                        entered[pixel, s] = passed_glass(entered[pixel, s], behind)
                    kinds[pixel, s] = TRANSMISSION
                    tile.shown_by[pixel, s] = triangle
                    if turns or frost > _0:
                        origin[lane, 0], origin[lane, 1], origin[lane, 2] = ox, oy, oz
                        direction[pixel, s, 0], direction[pixel, s, 1], direction[pixel, s, 2] = dx, dy, dz
                        tile.before[lane] += t * tile.axial[lane]
                        if seen_by_lobe:
                            tile.shining[pixel, s], tile.scattered[pixel, s] = 0, 1
                        start = passed[lane] = _0
                elif kinds[pixel, s] == CAMERA:
                    far = (camera.clip[1] - camera.clip[0]) / tile.axial[lane]
            set_ray(packet, lane, ox, oy, oz, dx, dy, dz, start, far, kinds[pixel, s])
            count += 1
            active = True
        layer += 1
    return count


@inlined
def is_held_out(tile, geometry, pixel, s, triangle):
    """Whether row s has met a holdout that the camera sees itself."""
    return geometry.held_out[geometry.object[triangle]] != 0 and tile.kinds[pixel, s] == CAMERA and not tile.glass[pixel, s] > 0


@inlined
def is_scattered(tile, pixel, s):
    """Whether a row shows what a ray drawn from a lobe has met, which may be another surface for every sample."""
    return tile.kinds[pixel, s] == GLOSSY or not tile.shining[pixel, s]


@inlined
def _note(tile, pixel, s, most, seen):
    """Counts what row s shows for `_varies`, unless it is a pane's."""
    if s < most:
        tile.sums[pixel, 0] += seen
        tile.sums[pixel, 1] += seen * seen
        if tile.group_of[pixel, s] != tile.group_of[pixel, 0]:
            tile.mixed[pixel] = 1


@leaf
def add_rows(camera, materials, geometry, world, world_visibility, world_group, pixel_width, pixel, begin, end, most, rows, surface, tile):
    """Evaluate the rows begin..end-1 of a pixel: add them to its layers, each with the weight of one, and to the surface that they show.

    pixel_width: of a pixel at a depth of 1 m (of an orthographic camera at any depth).  most: rows from there on are panes.
    """
    vertices, triangle_vertices, corner_normals = geometry.vertices, geometry.triangles, geometry.corner_normals
    attributes, material, object_of, light_group = geometry.attributes, geometry.material, geometry.object, geometry.light_group
    weight, direction, depth, glass = tile.weight, tile.direction, tile.depth, tile.glass
    triangles = tile.hits.view(np.int32)
    out, sample, group_of, first, group = tile.out[pixel], tile.sample[pixel], tile.group_of[pixel], tile.first[pixel], tile.group[pixel]
    groups, nearest = tile.groups[pixel], tile.nearest[pixel]
    for s in range(begin, end):
        triangle = triangles[pixel, s, 0]
        dx, dy, dz = direction[pixel, s, 0], direction[pixel, s, 1], direction[pixel, s, 2]
        wr, wg, wb = weight[pixel, s, 0], weight[pixel, s, 1], weight[pixel, s, 2]
        behind_glass = glass[pixel, s] > 0
        before = EMITTED + 3 * min(glass[pixel, s], 2)
        group_of[s] = -1
        seen = _0
        held = triangle >= 0 and is_held_out(tile, geometry, pixel, s, triangle)
        if triangle < 0 or held:
            emitted = before + 3 * GLASS * world_group
            if not behind_glass:
                out[CLEAR] += (wr + wg + wb) * _THIRD
            if not held and world_visibility & tile.kinds[pixel, s] and tile.shining[pixel, s]:
                if tile.kinds[pixel, s] == CAMERA:
                    er, eg, eb = world_radiance(world.seen, dx, dy, dz)
                else:
                    er, eg, eb = world_radiance(world.met, dx, dy, dz)
                out[emitted] += wr * er
                out[emitted + 1] += wg * eg
                out[emitted + 2] += wb * eb
                seen = wr * er + wg * eg + wb * eb
        else:
            u, v = tile.hits[pixel, s, 1], tile.hits[pixel, s, 2]
            x, y, z, gx, gy, gz, error = hit_point(vertices, triangle_vertices, triangle, u, v)
            sx, sy, sz = shading_normal(corner_normals, triangle, u, v, gx, gy, gz)
            behind = gx * dx + gy * dy + gz * dz > 0
            cosine = seen_cosine(materials.flags[material[triangle]], sx, sy, sz, gx, gy, gz, dx, dy, dz)
            signed = _signed(materials.flags[material[triangle]], cosine, behind, tile.kinds[pixel, s], tile.entered[pixel, s])
            evaluate(materials, material[triangle], attributes, triangle, u, v, signed, rows, surface)
            cx, cy, cz = sx, sy, sz
            if materials.flags[material[triangle]] & NORMAL_MAPPED:
                sx, sy, sz = surface[NORMAL], surface[NORMAL + 1], surface[NORMAL + 2]
                if not materials.flags[material[triangle]] & SMOOTH_COAT:
                    cx, cy, cz = sx, sy, sz
            if behind:
                gx, gy, gz, sx, sy, sz, cx, cy, cz = -gx, -gy, -gz, -sx, -sy, -sz, -cx, -cy, -cz
            cosine = lobe_cosine(sx, sy, sz, gx, gy, gz, -dx, -dy, -dz)
            sample[s, BEYOND] = np.float32(passed_glass(np.int64(tile.entered[pixel, s]), behind))
            if not (behind and materials.flags[material[triangle]] & REFRACTIVE):
                tile.entered[pixel, s] = 0
            ar, ag, ab = diffuse_color(surface, cosine)
            sample[s, SHEENED + 3] = surface[SHEEN_ROUGHNESS]
            if surface[SHEEN_ROUGHNESS] != _0:
                sample[s, SHEENED] = surface[SHEEN] / max(ar, FAINT)
                sample[s, SHEENED + 1] = surface[SHEEN + 1] / max(ag, FAINT)
                sample[s, SHEENED + 2] = surface[SHEEN + 2] / max(ab, FAINT)
            ar, ag, ab = ar * wr, ag * wg, ab * wb
            tr = tg = tb = _0
            if materials.flags[material[triangle]] & TRANSLUCENT:
                tr, tg, tb = translucency(surface, cosine)
                tr, tg, tb = tr * wr, tg * wg, tb * wb
            if not behind_glass:
                out[ALBEDO] += ar + tr
                out[ALBEDO + 1] += ag + tg
                out[ALBEDO + 2] += ab + tb
                part = (wr + wg + wb) * _THIRD
                out[MEAN_NORMALS] += part * sx
                out[MEAN_NORMALS + 1] += part * sy
                out[MEAN_NORMALS + 2] += part * sz
            emitted = before + 3 * GLASS * light_group[object_of[triangle]]
            er, eg, eb = wr * surface[EMISSION], wg * surface[EMISSION + 1], wb * surface[EMISSION + 2]
            lights = in_set(geometry.receiver_sets, geometry.receivers[object_of[triangle]], object_of, tile.shown_by[pixel, s])
            if not tile.shining[pixel, s] or not lights:
                er = eg = eb = _0
            out[emitted] += er
            out[emitted + 1] += eg
            out[emitted + 2] += eb
            sample[s, PLACE], sample[s, PLACE + 1], sample[s, PLACE + 2], sample[s, ERROR] = x, y, z, error
            sample[s, FACING], sample[s, FACING + 1], sample[s, FACING + 2] = gx, gy, gz
            sample[s, SHADED], sample[s, SHADED + 1], sample[s, SHADED + 2], sample[s, TILTED] = sx, sy, sz, surface[TILT]
            sample[s, COAT_SHADED], sample[s, COAT_SHADED + 1], sample[s, COAT_SHADED + 2] = cx, cy, cz
            sample[s, ROUGH] = surface[DIFFUSE_ROUGHNESS]
            if nearest < 0 or depth[pixel, s] < depth[pixel, nearest]:
                nearest = s
            if looks_covered(geometry.covered, triangle, u, v):  # it keeps its colour, and belongs to no surface that is lit
                _note(tile, pixel, s, most, er + eg + eb)
                continue
            footprint = pixel_width if camera.orthographic else pixel_width * depth[pixel, s]
            if is_scattered(tile, pixel, s):
                footprint *= BENT
            k = 0
            while k < groups:
                f = first[k]
                alike = object_of[triangles[pixel, f, 0]] == object_of[triangle] and (glass[pixel, f] > 0) == behind_glass
                alike = alike and tile.shown[pixel, f] == tile.shown[pixel, s] and tile.through[pixel, f] == tile.through[pixel, s]
                if alike and _same_surface(
                    x, y, z, sx, sy, sz, sample[f, PLACE], sample[f, PLACE + 1], sample[f, PLACE + 2],
                    sample[f, SHADED], sample[f, SHADED + 1], sample[f, SHADED + 2], footprint,
                ):  # fmt: skip
                    break
                k += 1
            if k == groups:
                groups += 1
                first[k] = s
                group[k, :] = _0
            group_of[s] = k
            group[k, MEMBERS] += _1
            lit = mean_shadowing(surface[TILT])  # direct light puts its own in place of the mean
            if surface[DIFFUSE_ROUGHNESS] > _0:
                ar, ag, ab = diffuse_albedo(surface, cosine)
                ar, ag, ab = ar * wr, ag * wg, ab * wb
            sample[s, REFLECTED_PART] = lit * (ar + ag + ab)
            group[k, G_ALBEDO] += lit * ar
            group[k, G_ALBEDO + 1] += lit * ag
            group[k, G_ALBEDO + 2] += lit * ab
            if materials.flags[material[triangle]] & COATED and tile.shown[pixel, s] != ALL_LIGHT:
                bare(surface)
                cr, cg, cb = wr * surface[COAT], wg * surface[COAT + 1], wb * surface[COAT + 2]
                group[k, G_COAT] += cr
                group[k, G_COAT + 1] += cg
                group[k, G_COAT + 2] += cb
                group[k, G_COAT_F0] += (cr + cg + cb) * surface[COAT_F0]
                group[k, G_COAT_ROUGHNESS] += (cr + cg + cb) * surface[COAT_ROUGHNESS]
            if tile.shown[pixel, s] == ALL_LIGHT:
                for c in range(3):
                    surface[GLOSSY_F0 + c] = surface[GLOSSY_F90 + c] = _0
            fr, fg, fb = surface[GLOSSY_F90] * wr, surface[GLOSSY_F90 + 1] * wg, surface[GLOSSY_F90 + 2] * wb
            group[k, G_F0] += surface[GLOSSY_F0] * wr
            group[k, G_F0 + 1] += surface[GLOSSY_F0 + 1] * wg
            group[k, G_F0 + 2] += surface[GLOSSY_F0 + 2] * wb
            group[k, G_F90] += fr
            group[k, G_F90 + 1] += fg
            group[k, G_F90 + 2] += fb
            group[k, G_ROUGHNESS] += surface[ROUGHNESS]
            for c in range(4):
                group[k, G_GLOSS + c] += surface[GLOSS + c]
            group[k, G_TRANSLUCENCY] += tr
            group[k, G_TRANSLUCENCY + 1] += tg
            group[k, G_TRANSLUCENCY + 2] += tb
            if tile.through[pixel, s]:
                pr, pg, pb = wr * surface[REFRACTION], wg * surface[REFRACTION + 1], wb * surface[REFRACTION + 2]
                group[k, G_THROUGH] += pr
                group[k, G_THROUGH + 1] += pg
                group[k, G_THROUGH + 2] += pb
                group[k, G_FROST] += (pr + pg + pb) * tile.frost[pixel, s]
            ar, ag, ab = ar + tr, ag + tg, ab + tb
            seen = ar + ag + ab + er + eg + eb + surface[GLOSSY_F0] * wr + surface[GLOSSY_F0 + 1] * wg + surface[GLOSSY_F0 + 2] * wb
        _note(tile, pixel, s, most, seen)
    tile.groups[pixel], tile.nearest[pixel] = groups, nearest


@leaf
def _varies(tile, pixel):
    """Whether the samples of a pixel show several surfaces, a lamp or a pattern."""
    n = np.float32(tile.taken[pixel])
    if n == _0:
        return False
    if tile.mixed[pixel]:
        return True
    for light in tile.lamps[pixel].flat:
        if light > _0:
            return True
    mean = tile.sums[pixel, 0] / n
    return tile.sums[pixel, 1] / n - mean * mean > VARIED * mean * mean


@leaf
def pick_varied(tile, most, ends):
    """Sets ends (16,) int32 of the pixels that have samples to `most` where a pixel beside them varies, else to what they have."""
    for pixel in range(WIDTH):
        ends[pixel] = tile.taken[pixel]
    for pixel in range(WIDTH):
        if not _varies(tile, pixel):
            continue
        x, y = pixel % TILE, pixel // TILE
        for qy in range(max(y - 1, 0), min(y + 2, TILE)):
            for qx in range(max(x - 1, 0), min(x + 2, TILE)):
                other = qy * TILE + qx
                if other != pixel and tile.taken[other] > 0:
                    ends[other] = most
