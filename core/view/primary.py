"""From camera rays to pixel layers and shading points, one 4x4 pixel tile at a time.

A pixel's value is the mean over its square (design.md, section 3): stratified primary samples, which
all count for albedo, emission and coverage, while light is computed once for each distinct surface among
them, as multisample antialiasing does.  Nothing is kept per sample beyond its tile (`tile.py`).

P samples are meant a pixel: half of them are taken everywhere, and up to twice as many where what is beside a pixel varies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..film import SQUARE, Film
from ..jit import inlined, kernel, leaf
from ..lamps.departures import FACES, REFLECTS, TURNS
from ..lamps.groups import LightGroups
from ..lamps.links import object_links, receiver_sets
from ..lamps.tables import WorldTable
from ..lamps.world import world_tables
from ..rays.packet import WIDTH, new_packet
from ..references import Reference
from ..sampling.hashing import uniform
from ..sampling.maps import orthonormal_basis
from ..scene import CAMERA, COATED, FROSTED, HOLDOUT, TRANSLUCENT, Scene
from ..surfaces.covers import CoveredPlaces
from ..surfaces.frosted import seen_through
from ..surfaces.layout import COAT_TOP, SURFACE
from ..surfaces.program import new_registers, with_viewer
from ..threads import Progress, run_chunks
from .camera import camera_tables
from .lamps import lamps_in_tile, visible_lamps
from .mirrors import with_mirrors
from .points import BEHIND, SCATTERED, SPREAD, ShadingPoints, blank, further_member
from .tile import (
    ALBEDO,
    BEYOND,
    CLEAR,
    COAT_SHADED,
    DEPTH,
    EMITTED,
    ERROR,
    FACING,
    G_ALBEDO,
    G_COAT,
    G_COAT_F0,
    G_COAT_ROUGHNESS,
    G_F0,
    G_F90,
    G_FROST,
    G_GLOSS,
    G_ROUGHNESS,
    G_THROUGH,
    G_TRANSLUCENCY,
    GLASS,
    MEAN_NORMALS,
    MEMBERS,
    NORMALS,
    PANES,
    PLACE,
    POSITION,
    REFLECTED_PART,
    ROUGH,
    SHADED,
    SHEENED,
    SURFACES,
    TILE,
    TILTED,
    WORLD_DEPTH,
    add_rows,
    clear_tile,
    is_scattered,
    new_tile,
    pick_varied,
    trace_samples,
)  # fmt: skip

MOST_MIRRORED = 4  # surfaces that a pixel shows by way of mirrors: a curved one may show another in every sample, of which these are drawn
WIDEST = np.float32(0.5)  # half width, as a tangent: beyond it a pixel shows most of a thing
LEAST_MEMBERS = 4  # samples of a surface that tell how its normals are spread
FLAT = np.float32(1e-9)  # squared distance of shading and geometric normal, at most, of a flat face
REFLECTING, COAT_POINTS, TRANSLUCENT_POINTS, FROSTED_POINTS = 0, 1, 2, 3  # kinds of shading points, in the order in which they are made
EVEN = 4  # samples a pixel: fewer tell too little of what varies, and every pixel has the same


class Worlds(NamedTuple):
    """The world that mirrors and glass show, and what the camera sees of it itself."""

    met: WorldTable
    seen: WorldTable


class _Geometry(NamedTuple):
    """As in `scene.Geometry`, and of each object whether it is a holdout, its light group, and the set of those that it lights, of `receiver_sets`; what is black because it is covered."""

    vertices: np.ndarray
    triangles: np.ndarray
    corner_normals: np.ndarray
    attributes: np.ndarray
    material: np.ndarray
    object: np.ndarray
    held_out: np.ndarray
    light_group: np.ndarray
    receivers: np.ndarray
    receiver_sets: np.ndarray
    covered: CoveredPlaces


@dataclass
class View:
    """What the camera sees of a scene, before any light but that of surfaces, lamps and world themselves.

    albedo, normal, position: (H, W, 3);  depth: (H, W); all float32.  Where there is glass they are the pane's.
    mean_normal: (H, W, 3) float32, of all samples; `normal`, position and depth are those of the nearest one.
    clear: (H, W) float32, the part of each pixel in which the camera sees the world, behind no glass.
    emitted: (G, 3, H, W, 3) float32, light of each light group that is emitted behind no glass, one surface of it, and more.
    points: the shading points, whose `pixel` counts row-major over H x W.  rays: primary rays traced.
    covered: (K,) int64, triangles that are seen where others cover them: black, and without points.
    """

    albedo: np.ndarray
    normal: np.ndarray
    mean_normal: np.ndarray
    position: np.ndarray
    depth: np.ndarray
    clear: np.ndarray
    emitted: np.ndarray
    points: ShadingPoints
    rays: int
    covered: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.depth.shape

    @property
    def emission(self) -> np.ndarray:
        """(H, W, 3) float32, what all light groups emit behind no glass."""
        return self.emitted[:, 0].sum(axis=0)

    @property
    def emission_behind_one(self) -> np.ndarray:
        """The same behind one surface of glass."""
        return self.emitted[:, 1].sum(axis=0)

    @property
    def emission_behind_more(self) -> np.ndarray:
        """The same behind several."""
        return self.emitted[:, 2].sum(axis=0)


def sample_counts(samples: int) -> tuple[int, int]:
    """Fewest and most samples of a pixel where `samples` are meant."""
    return (samples, samples) if samples < EVEN else ((samples + 1) // 2, 2 * samples)


@leaf
def _add(camera, materials, geometry, world, world_visibility, world_group, pixel_width, pixel, begin, panes, most, rows, surface, tile):
    """`add_rows` of the samples from `begin` and of the panes from row `panes` on."""
    add_rows(
        camera, materials, geometry, world, world_visibility, world_group, pixel_width, pixel, begin, tile.taken[pixel], most,
        rows, surface, tile,
    )  # fmt: skip
    if tile.count[pixel] > panes:
        add_rows(
            camera, materials, geometry, world, world_visibility, world_group, pixel_width, pixel, panes, tile.count[pixel], most,
            rows, surface, tile,
        )  # fmt: skip


@leaf
def _mirrored_light(tile, lane, begin, end):
    """What the surfaces that a pixel shows by way of mirrors send, by the columns begin..end-1 of their sums; 0 where they are few."""
    number, light = 0, np.float32(0.0)
    for k in range(tile.groups[lane]):
        if is_scattered(tile, lane, tile.first[lane, k]):
            sent = np.float32(0.0)
            for c in range(begin, end):
                sent += tile.group[lane, k, c]
            number += sent > 0
            light += sent
    return light if number > MOST_MIRRORED else np.float32(0.0)


@inlined
def _compare(varied, own, whole, members):
    """Makes of the albedos in `ShadingPoints.varied` by how much they differ from their mean.

    own: albedo at the first place.  whole: that of all `members`, together.
    """
    mean = own
    for j in range(1, len(varied)):
        mean += varied[j, REFLECTS]
    mean /= np.float32(len(varied))
    varied[0, REFLECTS] = own
    # Of few members the places are nearly all, which have no more in common with the light than all have.
    scale = (members - np.float32(1.0)) / whole if whole > 0 else np.float32(0.0)
    for j in range(len(varied)):
        varied[j, REFLECTS] = scale * (varied[j, REFLECTS] - mean)


@leaf
def _turn(sample, member, members, chosen, shaded, turned):
    """Sets what `ShadingPoints.turned` says of a point's members, where their normals differ.

    shaded: column of the normals.  By however little: were it a matter of degree, it would be one of chance, and the denoiser would see holes where highlights are kept from it.
    """
    ax = ay = az = np.float32(0.0)
    for j in range(members):
        own = sample[member[j]]
        apart = np.float32(0.0)
        for c in range(3):
            apart += (own[shaded + c] - own[FACING + c]) ** 2
        if apart <= FLAT:  # normals of faces with an edge between them do not turn
            return
        ax, ay, az = ax + own[shaded], ay + own[shaded + 1], az + own[shaded + 2]
    length = np.float32(math.sqrt(ax * ax + ay * ay + az * az))
    if members < LEAST_MEMBERS or length < np.float32(0.5) * np.float32(members):
        return
    ax, ay, az = ax / length, ay / length, az / length
    tx, ty, tz, bx, by, bz = orthonormal_basis(ax, ay, az)
    xx = xy = yy = np.float32(0.0)
    for j in range(members):
        own = sample[member[j]]
        x = own[shaded] * tx + own[shaded + 1] * ty + own[shaded + 2] * tz
        y = own[shaded] * bx + own[shaded + 1] * by + own[shaded + 2] * bz
        xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
    # Principal axes of the covariance; a uniform spread of half width h has the variance h^2 / 3.
    scale = np.float32(3.0) / np.float32(members - 1)
    xx, xy, yy = scale * xx, scale * xy, scale * yy
    if not xx + yy > 0:
        return
    root = np.float32(math.sqrt(np.float32(0.25) * (xx - yy) * (xx - yy) + xy * xy))
    middle = np.float32(0.5) * (xx + yy)
    angle = np.float32(0.5 * math.atan2(np.float32(2.0) * xy, xx - yy))
    c, s = np.float32(math.cos(angle)), np.float32(math.sin(angle))
    wide = min(np.float32(math.sqrt(max(middle + root, np.float32(0.0)))), WIDEST)
    thin = min(np.float32(math.sqrt(max(middle - root, np.float32(0.0)))), WIDEST)
    own = sample[member[chosen]]
    turned[0, 0], turned[0, 1], turned[0, 2] = ax - own[shaded], ay - own[shaded + 1], az - own[shaded + 2]
    turned[1, 0], turned[1, 1], turned[1, 2] = wide * (c * tx + s * bx), wide * (c * ty + s * by), wide * (c * tz + s * bz)
    turned[2, 0], turned[2, 1], turned[2, 2] = thin * (c * bx - s * tx), thin * (c * by - s * ty), thin * (c * bz - s * tz)


@leaf
def _shade(tile, lane, most, seed, number, pixel, turn, member, points, n_points):
    """Makes shading points of the surfaces that a pixel of the tile shows; how many there are then.

    number: of the pixel in the full frame.  turn: REFLECTING, COAT_POINTS, with the lobe of a coat alone, or, lit from the side that is not seen, TRANSLUCENT_POINTS, without lobes, or FROSTED_POINTS, with
    a lobe alone, that of a mirror whose image is what lies behind.
    member: (R,) int32, scratch.
    """
    sample, group = tile.sample[lane], tile.group[lane]
    triangles = tile.hits.view(np.int32)
    share = np.float32(1.0) / np.float32(tile.taken[lane])
    side, lobe = np.float32(1.0), np.float32(1.0)
    shaded = COAT_SHADED if turn == COAT_POINTS else SHADED
    albedo, upto = G_ALBEDO, G_ROUGHNESS
    if turn == TRANSLUCENT_POINTS:
        albedo, upto = G_TRANSLUCENCY, G_TRANSLUCENCY + 3
    elif turn == FROSTED_POINTS:
        albedo, upto = G_THROUGH, G_THROUGH + 3
    elif turn == COAT_POINTS:
        albedo, upto = G_COAT, G_COAT + 3
    if turn >= TRANSLUCENT_POINTS:
        side, lobe = np.float32(-1.0), np.float32(0.0)
    step = _mirrored_light(tile, lane, albedo, upto) / np.float32(MOST_MIRRORED)
    start, seen = uniform(seed, number, 0, 2), np.float32(0.0)
    for k in range(tile.groups[lane]):
        sent = np.float32(0.0)
        for c in range(albedo, upto):
            sent += group[k, c]
        if not sent > 0:  # black: no light would show
            continue
        weight = share
        if step > 0 and is_scattered(tile, lane, tile.first[lane, k]):
            # Picked as often as one of the steps from `start` on falls into its part of the light.
            picks = math.ceil((seen + sent) / step - start) - math.ceil(seen / step - start)
            seen += sent
            if picks <= 0:
                continue
            weight = share * np.float32(picks) * step / sent
        # A member drawn at random stands for all: right in the mean, however steeply the light varies in the pixel.
        members = np.int64(group[k, MEMBERS])
        drawn = np.int64(uniform(seed, number, k, 1) * group[k, MEMBERS])
        n = 0
        for s in range(tile.taken[lane]):
            if tile.group_of[lane, s] == k:
                member[n] = s
                n += 1
        for s in range(most, tile.count[lane]):
            if tile.group_of[lane, s] == k:
                member[n] = s
                n += 1
        chosen = min(drawn, members - 1)
        best = member[chosen]
        i = n_points
        n_points += 1
        blank(points, i)
        for c in range(3):
            points.position[i, c] = sample[best, PLACE + c]
            points.ng[i, c] = side * sample[best, FACING + c]
            points.ns[i, c] = side * sample[best, shaded + c]
            points.wo[i, c] = -tile.direction[lane, best, c]
            points.albedo[i, c] = weight * group[k, albedo + c]
            points.f0[i, c] = lobe * weight * group[k, G_F0 + c]
            points.f90[i, c] = lobe * weight * group[k, G_F90 + c]
        if turn == FROSTED_POINTS:
            points.wo[i, 0], points.wo[i, 1], points.wo[i, 2] = seen_through(
                sample[best, SHADED], sample[best, SHADED + 1], sample[best, SHADED + 2], points.wo[i, 0], points.wo[i, 1], points.wo[i, 2]
            )
            for c in range(3):
                points.f0[i, c] = points.f90[i, c] = points.albedo[i, c]
                points.albedo[i, c] = np.float32(0.0)
        if turn == COAT_POINTS:
            light = group[k, G_COAT] + group[k, G_COAT + 1] + group[k, G_COAT + 2]
            for c in range(3):
                points.f0[i, c] = group[k, G_COAT_F0] / light * points.albedo[i, c]
                points.f90[i, c] = points.albedo[i, c]
                points.albedo[i, c] = np.float32(0.0)
        points.error[i] = sample[best, ERROR]
        for j in range(SPREAD):
            other = member[further_member(chosen, j, members)]
            points.error[i] = max(points.error[i], sample[other, ERROR])
            for c in range(3):
                points.spread[i, j, c] = sample[other, PLACE + c] - sample[best, PLACE + c]
                points.varied[i, j + 1, TURNS + c] = side * (sample[other, shaded + c] - sample[best, shaded + c])
                points.varied[i, j + 1, FACES + c] = side * (sample[other, FACING + c] - sample[best, FACING + c])
            points.varied[i, j + 1, REFLECTS] = sample[other, REFLECTED_PART]
            points.facet[i, j] = triangles[lane, other, 0]
        whole = np.float32(0.0)
        # What lobes of diffuse light reflect goes by view and light at once, which direct light knows of the chosen member.
        if turn == REFLECTING and sample[best, ROUGH] == 0 and sample[best, SHEENED + 3] == 0:
            whole = group[k, G_ALBEDO] + group[k, G_ALBEDO + 1] + group[k, G_ALBEDO + 2]
        _compare(points.varied[i], sample[best, REFLECTED_PART], whole, group[k, MEMBERS])
        shine = points.f0[i, 0] + points.f0[i, 1] + points.f0[i, 2] + points.f90[i, 0] + points.f90[i, 1] + points.f90[i, 2]
        if shine > 0 and turn <= COAT_POINTS:  # the straight way through glass knows no normal
            _turn(sample, member, members, chosen, shaded, points.turned[i])
        points.pixel[i] = pixel
        points.triangle[i] = triangles[lane, best, 0]
        points.roughness[i] = group[k, G_ROUGHNESS] / group[k, MEMBERS]
        if turn == REFLECTING:
            for c in range(4):
                points.gloss[i, c] = group[k, G_GLOSS + c] / group[k, MEMBERS]
        elif turn == COAT_POINTS:
            points.roughness[i], points.gloss[i, 0] = group[k, G_COAT_ROUGHNESS] / light, COAT_TOP
        points.behind_glass[i] = 0
        if tile.glass[lane, best] > 0:
            points.behind_glass[i] = SCATTERED if tile.scattered[lane, best] else BEHIND
        points.tilt[i] = sample[best, TILTED] if turn == REFLECTING else np.float32(0.0)
        points.rough[i] = sample[best, ROUGH] if turn == REFLECTING else np.float32(0.0)
        if turn == REFLECTING and sample[best, SHEENED + 3] != 0:
            for c in range(4):
                points.sheen[i, c] = sample[best, SHEENED + c]
        points.shown[i] = tile.shown[lane, best] > 0
        points.entered[i] = min(tile.entered[lane, best], 255)
        if turn == FROSTED_POINTS:
            light = group[k, G_THROUGH] + group[k, G_THROUGH + 1] + group[k, G_THROUGH + 2]
            points.roughness[i] = np.float32(math.sqrt(group[k, G_FROST] / light))
            points.shown[i] = SCATTERED if tile.through[lane, best] == SURFACES else 0
            points.entered[i] = np.uint8(min(sample[best, BEYOND], np.float32(255)))
    return n_points


@kernel
def _view_tiles(
    rays, camera, film, materials, geometry, lamps, world, world_visibility, world_group, begin, end, least, most, seed, points, layers, tile
):  # fmt: skip
    """Trace, evaluate and group the samples of the tiles begin..end-1, `least` to `most` a pixel.

    film: (K,) float32 as `Film.offsets` has them.  materials: from `with_mirrors`.
    world_group: light group of the world.  points: room for all that can come.  tile: room for one.  layers: (H * W, EMITTED + 9 G) float32.
    Returns the number of points and of rays.
    """
    light_groups = (layers.shape[1] - EMITTED) // (3 * GLASS)
    some = 0
    for flags in materials.flags:
        some |= flags
    x0, y0, x1, y1 = camera.border[0], camera.border[1], camera.border[2], camera.border[3]
    # Tiles lie on the full frame: what varies beside a pixel is the same for any border.
    left, top = x0 // TILE, y0 // TILE
    tiles_x = (x1 + TILE - 1) // TILE - left
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    rows = new_registers(materials)
    near_lamps = np.empty(len(lamps.kind), np.int32)
    lanes, ends, panes = np.empty((WIDTH, 2), np.int32), np.empty(WIDTH, np.int32), np.empty(WIDTH, np.int32)
    member = np.empty((1 + PANES) * most, np.int32)
    reach = 0 if len(film) == 0 else max(0, np.int64(math.ceil(film[len(film) - 1] - np.float32(0.5))))  # pixels beyond its square
    pixel_width = abs(camera.window[1] - camera.window[0]) / np.float32(camera.size[0])
    n_points = 0
    n_rays = 0
    for number in range(begin, end):
        tx, ty = (left + number % tiles_x) * TILE, (top + number // tiles_x) * TILE
        n_lamps = lamps_in_tile(lamps, camera, tx - reach, ty - reach, tx + TILE + reach, ty + TILE + reach, near_lamps)
        clear_tile(tile, most)
        for lane in range(WIDTH):
            px, py = tx + lane % TILE, ty + lane // TILE
            within = px < camera.size[0] and py < camera.size[1]
            ends[lane] = least if within else 0
        n_rays += trace_samples(
            rays, camera, film, materials, geometry, lamps, near_lamps, n_lamps, tx, ty, lanes, 0, ends, seed, packet, rows, surface, tile
        )
        for lane in range(WIDTH):
            _add(camera, materials, geometry, world, world_visibility, world_group, pixel_width, lane, 0, most, most, rows, surface, tile)
            panes[lane] = tile.count[lane]
        if most > least:
            pick_varied(tile, most, ends)
            for lane in range(WIDTH):
                px, py = tx + lane % TILE, ty + lane // TILE
                if px < x0 or px >= x1 or py < y0 or py >= y1:
                    ends[lane] = tile.taken[lane]
            n_rays += trace_samples(
                rays, camera, film, materials, geometry, lamps, near_lamps, n_lamps, tx, ty, lanes, least, ends, seed, packet, rows, surface, tile,
            )  # fmt: skip
            for lane in range(WIDTH):
                if ends[lane] > least:
                    _add(
                        camera, materials, geometry, world, world_visibility, world_group, pixel_width, lane, least, panes[lane], most,
                        rows, surface, tile,
                    )  # fmt: skip
        for lane in range(WIDTH):
            px, py = tx + lane % TILE, ty + lane // TILE
            if px < x0 or px >= x1 or py < y0 or py >= y1:
                continue
            pixel = (py - y0) * (x1 - x0) + (px - x0)
            share = np.float32(1.0) / np.float32(tile.taken[lane])
            out, sample = layers[pixel], tile.sample[lane]
            for column in range(out.shape[0]):
                out[column] = share * tile.out[lane, column]
            for before in range(GLASS):
                for lit_by in range(light_groups):
                    for c in range(3):
                        out[EMITTED + 3 * (GLASS * lit_by + before) + c] += share * tile.lamps[lane, before, lit_by, c]
            nearest = tile.nearest[lane]
            if nearest < 0:
                out[DEPTH] = WORLD_DEPTH
                continue
            for c in range(3):
                out[NORMALS + c], out[POSITION + c] = sample[nearest, SHADED + c], sample[nearest, PLACE + c]
            out[DEPTH] = tile.depth[lane, nearest]
        for turn in range(4):
            if (
                (turn == COAT_POINTS and not some & COATED)
                or (turn == TRANSLUCENT_POINTS and not some & TRANSLUCENT)
                or (turn == FROSTED_POINTS and not some & FROSTED)
            ):
                continue
            # Light from the other side comes last: neighbours that are lit from one side follow each other.
            for lane in range(WIDTH):
                px, py = tx + lane % TILE, ty + lane // TILE
                if px >= x0 and px < x1 and py >= y0 and py < y1:
                    pixel = (py - y0) * (x1 - x0) + (px - x0)
                    n_points = _shade(tile, lane, most, seed, py * camera.size[0] + px, pixel, turn, member, points, n_points)
    return n_points, n_rays


def view(
    scene: Scene, rays, world, samples: int, seed: int, threads: int = 0, progress: Progress | None = None,
    groups: LightGroups | None = None, film: Film = SQUARE, covered: CoveredPlaces | None = None,
) -> View:  # fmt: skip
    """Trace about `samples` primary rays a pixel of the camera's border; `rays` and `world` are the tables of those rooms.

    groups: the light groups to tell apart, None for none.  film: how the samples lie in a pixel, and whether they see the world.
    covered: what is black because other triangles cover it, None for nothing.
    """
    groups = LightGroups.one(scene) if groups is None else groups
    camera = camera_tables(scene.camera)
    x0, y0, x1, y1 = (int(b) for b in camera.border)
    height, width = y1 - y0, x1 - x0
    layers = np.zeros((height * width, EMITTED + 3 * GLASS * len(groups.names)), np.float32)
    tiles = (-(-x1 // TILE) - x0 // TILE) * (-(-y1 // TILE) - y0 // TILE)
    least, most = sample_counts(samples)
    chunk = 128
    g = scene.geometry
    geometry = _Geometry(
        g.vertices,
        g.triangles,
        g.corner_normals,
        g.attributes,
        g.material,
        g.object,
        ((g.object_visibility & HOLDOUT) > 0).astype(np.uint8),
        groups.objects,
        object_links(scene)[0],
        receiver_sets(g),
        CoveredPlaces.none() if covered is None else covered,
    )
    places = geometry.covered
    seen = world if scene.world.seen is None else world_tables(replace(scene.world, radiance=scene.world.seen))
    tables = (rays, camera, with_mirrors(with_viewer(scene, directly=True), g), geometry, visible_lamps(scene, groups), Worlds(world, seen))
    n_lamps = len(tables[4].kind)
    rays, camera, materials, geometry, lamps, world = (Reference(table) for table in tables)
    offsets = film.offsets()
    seen_by = scene.world.visibility & ~CAMERA if film.transparent else scene.world.visibility

    sides = 1 + sum((scene.materials.tables.flags & flag).any() for flag in (COATED, TRANSLUCENT, FROSTED))

    def work(begin, end):
        room = ShadingPoints.room((end - begin) * WIDTH * (1 + PANES) * most * sides)
        n, n_rays = _view_tiles(
            rays, camera, offsets, materials, geometry, lamps, world, seen_by, groups.world,
            begin, end, least, most, np.uint32(seed), Reference(room), layers, Reference(new_tile(most, len(groups.names), n_lamps)),
        )  # fmt: skip
        return room.first(n), n_rays

    parts = run_chunks(work, tiles, chunk, threads, progress)
    shaped = layers.reshape(height, width, -1)
    emitted = shaped[..., EMITTED:].reshape(height, width, len(groups.names), GLASS, 3)
    return View(
        *(np.ascontiguousarray(shaped[..., at : at + 3]) for at in (ALBEDO, NORMALS, MEAN_NORMALS, POSITION)),
        *(np.ascontiguousarray(shaped[..., at]) for at in (DEPTH, CLEAR)),
        np.ascontiguousarray(emitted.transpose(2, 3, 0, 1, 4)),
        ShadingPoints.concatenate([part for part, _ in parts]),
        sum(n for _, n in parts),
        np.flatnonzero(places.seen),
    )
