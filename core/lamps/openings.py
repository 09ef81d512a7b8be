"""Openings: where sun and sky come in, as rectangles across the axes that rays which escape have in common.

A room is lit by its windows, a courtyard by what its roofs leave open.  Of the particles that sun and world send evenly into the box around a scene most end on
the outside of walls and roofs.  So a few rays from the places that matter are sent out; those that meet nothing are lines along which light comes, and where
they lie closest together is an opening.  Particles are then drawn through openings as through windows of a known place (`emission.focused`), with exact
weights: an opening that is missed, or is none, costs noise alone.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..rays.offsets import hit_point
from ..rays.packet import new_packet
from ..rays.trace import OPAQUE, intersect1, occluded1
from ..sampling.hashing import hash_combine, uniform
from ..sampling.maps import cosine_hemisphere, to_world, uniform_cone
from ..scene import DIFFUSE, SUN
from ..threads import run_chunks
from .tables import AXIS_Z, ONE_MINUS_COS, WORLD

RAYS, MOST_RAYS = 8192, 65536  # that look for the sky and the suns: so many, and on until enough have found some
ENOUGH, SURE = 32, 256  # lines that tell of an opening: at least, and so many that no more are looked for
MOST_LINES = 512
PLANES = 8  # along each axis, by the places' quantiles, and as many evenly
REFINED, FINER = 2, 5  # so often the best plane is looked for again, so much finer
EDGE = 0.02  # of the lines beyond each edge of an opening, before its margin
MARGIN = 0.08  # of an opening's size, on all sides
MOST = 4  # openings
NARROW = 0.25  # of half the surface of the scene's box: larger ones gain little
FEW = 0.1  # of all lines: fewer make no opening


class Openings(NamedTuple):
    """K openings.

    boxes: (K, 2, 3) float32, flat.  outwards: (K,) -1 or 1, which way along their axis light leaves.  share: (K,) of the lines that each has, whose
    sum is at most 1.  open: the part of the rays from the places, by the cosine, that meet nothing, 1 where there is no world.  rays: that have looked for them.
    """

    boxes: np.ndarray
    outwards: np.ndarray
    share: np.ndarray
    open: float
    rays: int

    def portals(self) -> np.ndarray:
        """(K, 3, 3) float32, as of `World`."""
        found = np.zeros((len(self.boxes), 3, 3), np.float32)
        for portal, box, outwards in zip(found, self.boxes, self.outwards):
            axis = int(np.argmin(box[1] - box[0]))
            x, y = ((axis + 1) % 3, (axis + 2) % 3)[:: -1 if outwards < 0 else 1]  # y cross x faces inwards
            half = 0.5 * (box[1] - box[0])
            portal[0], portal[1, x], portal[2, y] = box.mean(axis=0), half[x], half[y]
        return found


def no_openings() -> Openings:
    """None at all."""
    return Openings(np.zeros((0, 2, 3), np.float32), np.zeros(0), np.zeros(0), 1.0, 0)


@kernel
def _escape(scene, position, normal, error, suns, turns, seed, lines, begin, end):
    """Rays begin..end-1 to the `suns` in turn, and, where there are more `turns`, into the sky: those that escape get their direction in `lines` (R, 6), after their place.

    Half of them leave from places (N, 3), half from what rays from there meet.
    """
    packet = new_packet()
    emitters = scene.emitters
    for ray in range(begin, end):
        i = np.int64(hash_combine(seed, ray) % np.uint32(len(position)))
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        rise = np.float32(2) * error[i]
        x, y, z = position[i, 0] + rise * nx, position[i, 1] + rise * ny, position[i, 2] + rise * nz
        u1, u2 = uniform(seed, ray, 0, 0), uniform(seed, ray, 0, 1)
        if ray % 2 == 1:
            lx, ly, lz = cosine_hemisphere(uniform(seed, ray, 1, 0), uniform(seed, ray, 1, 1))
            dx, dy, dz = to_world(lx, ly, lz, nx, ny, nz)
            triangle, _, u, v = intersect1(scene.rays, OPAQUE, packet, x, y, z, dx, dy, dz, np.float32(0), np.float32(np.inf), DIFFUSE)
            if triangle >= 0:
                x, y, z, nx, ny, nz, rise = hit_point(scene.vertices, scene.triangles, triangle, u, v)
                if nx * dx + ny * dy + nz * dz > np.float32(0):
                    nx, ny, nz = -nx, -ny, -nz
                rise *= np.float32(2)
                x, y, z = x + rise * nx, y + rise * ny, z + rise * nz
        turn = (ray // 2) % turns
        if turn == len(suns):
            lx, ly, lz = cosine_hemisphere(u1, u2)
            dx, dy, dz = to_world(lx, ly, lz, nx, ny, nz)
        else:
            e = suns[turn]
            lx, ly, lz = uniform_cone(u1, u2, emitters.lamps[e, ONE_MINUS_COS])
            dx, dy, dz = to_world(lx, ly, lz, emitters.lamps[e, AXIS_Z], emitters.lamps[e, AXIS_Z + 1], emitters.lamps[e, AXIS_Z + 2])
        if not nx * dx + ny * dy + nz * dz > np.float32(0):
            continue
        if occluded1(scene.rays, OPAQUE, packet, x, y, z, dx, dy, dz, np.float32(0), np.float32(np.inf), DIFFUSE):
            continue
        lines[ray, 0], lines[ray, 1], lines[ray, 2], lines[ray, 3], lines[ray, 4], lines[ray, 5] = x, y, z, dx, dy, dz


def find_openings(scene, position: np.ndarray, normal: np.ndarray, error: np.ndarray, seed: int, threads: int = 0) -> Openings:
    """Openings by which sun and sky shine on places (N, 3) with their normals and rounding errors (N,) (m); none where they do not, or from everywhere.

    scene: Transport.
    """
    emitters = scene.emitters
    suns = np.flatnonzero(emitters.kind[: len(emitters.source)] == SUN)
    turns = len(suns) + int((emitters.kind == WORLD).any())
    if not len(position) or not turns:
        return no_openings()
    found, skies, sent, first = np.zeros((0, 6), np.float32), 0, 0, 0
    to_sky = (np.arange(RAYS) // 2) % turns == len(suns)
    for first in range(0, MOST_RAYS, RAYS):
        lines = np.zeros((RAYS, 6), np.float32)
        look = partial(_escape, scene, position, normal, error, suns, turns, np.uint32((seed + first) & 0xFFFFFFFF), lines)
        run_chunks(look, RAYS, RAYS // 8, threads)
        escaped = lines[:, 3:].any(axis=1)
        found, skies, sent = np.concatenate([found, lines[escaped]]), skies + np.count_nonzero(escaped & to_sky), sent + to_sky.sum()
        if len(found) >= SURE:
            break
    return _openings(found, position, np.asarray(emitters.box, np.float64), seed)._replace(
        open=skies / sent if sent else 1.0, rays=3 * (first + RAYS) // 2
    )


class _Gap(NamedTuple):
    """A rectangle across an axis, the lines that go through it, and how many these are for its area (0: none is worth it)."""

    density: float
    axis: int
    height: float
    low: np.ndarray
    high: np.ndarray
    inside: np.ndarray


def _densest(lines: np.ndarray, axis: int, heights: np.ndarray, box: np.ndarray, least: float) -> _Gap:
    """Of the planes across an axis the one where the lines (L, 6) that cross it within the box lie closest together."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    size = np.maximum(box[1] - box[0], 1e-30)
    half = size[0] * size[1] + size[1] * size[2] + size[2] * size[0]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        t = (heights[:, None] - lines[None, :, axis]) / lines[None, :, 3 + axis]
        u, v = (lines[None, :, k] + t * lines[None, :, 3 + k] for k in (b, c))
        crosses = (t >= 0) & (u > box[0, b]) & (u < box[1, b]) & (v > box[0, c]) & (v < box[1, c])
    best = _Gap(0.0, axis, 0.0, np.zeros(2), np.zeros(2), np.zeros(len(lines), bool))
    for plane, here in enumerate(crosses):
        n = np.count_nonzero(here)
        if n < least:
            continue
        places = np.stack([u[plane, here], v[plane, here]])
        low, high = np.quantile(places, (EDGE, 1 - EDGE), axis=1)
        margin = MARGIN * (high - low).max() + 1e-6 * size.max()
        low, high = low - margin, high + margin
        area = (high[0] - low[0]) * (high[1] - low[1])
        if area < NARROW * half and n / area > best.density:
            with np.errstate(invalid="ignore"):
                inside = here & (u[plane] >= low[0]) & (u[plane] <= high[0]) & (v[plane] >= low[1]) & (v[plane] <= high[1])
            best = _Gap(n / area, axis, float(heights[plane]), low, high, inside)
    return best


def _openings(lines: np.ndarray, position: np.ndarray, box: np.ndarray, seed: int) -> Openings:
    """Openings that lines (L, 6) of place and direction have in common: again and again the rectangle with the most lines for its area.

    Planes are tried evenly over the box, and where the places (N, 3) and the lines' own lie, then close to the best of them.
    """
    if len(lines) < ENOUGH:
        return no_openings()
    if len(lines) > MOST_LINES:
        lines = np.random.default_rng(seed).choice(lines, MOST_LINES, replace=False)
    boxes, outwards, share = [], [], []
    starts = np.concatenate([position[:: 1 + len(position) // 4096], lines[:, :3]])
    heights = np.concatenate([np.quantile(starts, np.linspace(0, 1, PLANES), axis=0), np.linspace(*box, PLANES)])
    left, least = lines.astype(np.float64), max(ENOUGH / 2, FEW * len(lines))
    while len(boxes) < MOST and len(left) >= least:
        found = max((_densest(left, axis, heights[:, axis], box, least) for axis in range(3)), key=lambda gap: gap.density)
        if not found.density > 0:
            break
        axis = found.axis
        step = (box[1, axis] - box[0, axis]) / (PLANES - 1)
        for _ in range(REFINED):
            step /= FINER
            close = found.height + step * np.arange(1 - FINER, FINER)
            found = max(found, _densest(left, axis, np.clip(close, *box[:, axis]), box, least), key=lambda gap: gap.density)
        opening = np.empty((2, 3))
        opening[:, axis], opening[:, (axis + 1) % 3], opening[:, (axis + 2) % 3] = found.height, *np.stack([found.low, found.high]).T
        boxes.append(np.clip(opening, *box))
        outwards.append(np.sign(left[found.inside, 3 + axis].sum()))
        share.append(np.count_nonzero(found.inside) / len(lines))
        left = left[~found.inside]
    return Openings(np.array(boxes, np.float32).reshape(-1, 2, 3), np.array(outwards), np.array(share), 1.0, 0)
