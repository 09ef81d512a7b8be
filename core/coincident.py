"""Faces that lie on other faces: whatever leaves one of them meets the other at once.

Cycles' rays leave a triangle without an offset and leave out that triangle alone, so that where it shares its place with another it is
black, in direct and in indirect light, wherever rounding does not lift the ray's origin off it by chance: always in a plane across an
axis of the world, whose coordinate is exact.  (Measured with Cycles 4.5 for all six directions; tests/headless/test_coincident.py does
so for three, with 5.2, too.  In other planes about half of the light gets through, and much of the rest comes back by the other face.)
It ends sharply where the other one ends, and takes both, whichever is seen and whatever sides they turn to the viewer.  Such places are
black here, too: layers of both renderers are added up, and have to show the same.

Triangles that others cover as a whole share a black material; one that they cover in part gets a material of its own, which looks up at each
hit whether it is covered there (`surfaces.covers`).  The camera's view knows nothing of either, for its albedo keeps its colour: its samples get no shading
points there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .jit import kernel, leaf
from .scene import ANGLED, CONSTANT, COVERED, DIFFUSE, EMISSIVE, REFRACTIVE, SHADOW, TELLING, TRANSPARENT, Geometry, Scene
from .surfaces.covers import BARE, WHOLE, CoveredPlaces, coverers
from .surfaces.layout import SURFACE
from .surfaces.program import COVERED_PARTS
from .transport import Transport

MOST_NAMES = 3  # in a warning
MOST_CELLS = 64  # that a triangle is listed in, on average
MOST_IN_A_CELL = 1024  # triangles, on average: a plane with more, all across each other, is left as it is
LOOKS = 24  # to a side of a triangle that no other one covers alone
MOST_PAIRS = 2**22  # of triangles in one cell, in all planes: planes with more are left without those that are covered in part
MOST_COVERING = 256  # one triangle in part, whose hits look at all of them; beyond that it is left as it is
MOST_LISTED = 2**17  # pairs of triangles that cover each other in part
TOUCH = 1e-4  # of the narrower triangle: by so little they only touch
ROUNDING = 2.0**-21  # of a coordinate: several last places, by which corners that are meant to meet may be apart
# Of its coordinate: a quarter of a last place, by which that of a triangle across an axis may differ here, and does not in Cycles.
FLAT = 2.0**-25


@kernel
def _across_axes(vertices, triangles, wanted, origin, index, axis_of, place):
    """Lists the wanted triangles that lie in a plane across an axis of the world, with that axis and their coordinate; their number."""
    n = 0
    for k in range(len(triangles)):
        if not wanted[k]:
            continue
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        for axis in range(3):
            # Of three, one that is no number makes the last comparison false.
            x, y, z = vertices[a, axis] + origin[axis], vertices[b, axis] + origin[axis], vertices[c, axis] + origin[axis]
            apart = max(abs(x - y), abs(y - z), abs(z - x)) + 0.0 * (x + y + z)
            if apart <= FLAT * (abs(x) + abs(y) + abs(z)) * (1 / 3):
                index[n], axis_of[n], place[n] = k, axis, np.float32(0.5 * (min(x, y, z) + max(x, y, z)))
                n += 1
                break
    return n


@leaf
def _cell(value, low, scale, side):
    """The cell of a coordinate among `side`; 0 for what is no number."""
    at = (value - low) * scale
    return np.int64(min(at, side - 1.0)) if at > 0 else np.int64(0)


@leaf
def _box(corners, k, low_x, low_y, scale_x, scale_y, side):
    """The cells that the box of a triangle meets: x0, x1, y0, y1."""
    ax, bx, cx = corners[k, 0, 0], corners[k, 1, 0], corners[k, 2, 0]
    ay, by, cy = corners[k, 0, 1], corners[k, 1, 1], corners[k, 2, 1]
    return (
        _cell(min(ax, bx, cx), low_x, scale_x, side),
        _cell(max(ax, bx, cx), low_x, scale_x, side),
        _cell(min(ay, by, cy), low_y, scale_y, side),
        _cell(max(ay, by, cy), low_y, scale_y, side),
    )


@leaf
def _within(corners, j, x, y, least):
    """Whether triangle j holds a place, all of its barycentric coordinates being above `least`."""
    ax, ay = corners[j, 0, 0] - x, corners[j, 0, 1] - y
    bx, by = corners[j, 1, 0] - x, corners[j, 1, 1] - y
    cx, cy = corners[j, 2, 0] - x, corners[j, 2, 1] - y
    u, v, w = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    area = u + v + w
    if area == 0:
        return False
    return u / area > least and v / area > least and w / area > least


@leaf
def _coverer(corners, clear, k, x, y, least, low_x, low_y, scale_x, scale_y, side, first, listed):
    """A triangle other than k that holds a place, -1 for none; cells are filled, and begin where their predecessor does in `first`."""
    cell = _cell(y, low_y, scale_y, side) * side + _cell(x, low_x, scale_x, side)
    for at in range(first[cell - 1] if cell > 0 else 0, first[cell]):
        j = listed[at]
        if j != k and not (clear[j] and clear[k]) and _within(corners, j, x, y, least):
            return j
    return np.int64(-1)


@leaf
def _is_covered(corners, clear, k, low_x, low_y, scale_x, scale_y, side, first, listed):
    """Whether other triangles cover triangle k wherever it is looked at."""
    ax, ay, bx, by, cx, cy = corners[k, 0, 0], corners[k, 0, 1], corners[k, 1, 0], corners[k, 1, 1], corners[k, 2, 0], corners[k, 2, 1]
    x, y = 0.5 * ax + 0.3 * bx + 0.2 * cx, 0.5 * ay + 0.3 * by + 0.2 * cy
    by_one = _coverer(corners, clear, k, x, y, 1e-4, low_x, low_y, scale_x, scale_y, side, first, listed)
    if by_one < 0:
        return False
    near, far = 0.99, 0.005
    for _ in range(3):  # all corners in one triangle: so is the rest
        x, y = near * ax + far * (bx + cx), near * ay + far * (by + cy)
        if not _within(corners, by_one, x, y, -1e-4):
            by_one = np.int64(-1)
            break
        ax, ay, bx, by, cx, cy = bx, by, cx, cy, ax, ay
    if by_one >= 0:
        return True
    # Some may cover it together, or leave a gap, as walls round a window do: the middles of many small triangles tell.
    ax, ay, bx, by, cx, cy = corners[k, 0, 0], corners[k, 0, 1], corners[k, 1, 0], corners[k, 1, 1], corners[k, 2, 0], corners[k, 2, 1]
    for i in range(LOOKS):
        for j in range(LOOKS - i):
            for upper in range(2 if i + j < LOOKS - 1 else 1):
                u, v = (i + (1 + upper) / 3) / LOOKS, (j + (1 + upper) / 3) / LOOKS
                x, y = u * ax + v * bx + (1 - u - v) * cx, u * ay + v * by + (1 - u - v) * cy
                # They may lie on the edge between two.
                if _coverer(corners, clear, k, x, y, -1e-4, low_x, low_y, scale_x, scale_y, side, first, listed) < 0:
                    return False
    return True


@leaf
def _parted(corners, k, j, x, y):
    """Whether the triangles k and j overlap along (x, y), which is not a unit vector, by no more than a touch."""
    k0, k1, k2 = (
        x * corners[k, 0, 0] + y * corners[k, 0, 1],
        x * corners[k, 1, 0] + y * corners[k, 1, 1],
        x * corners[k, 2, 0] + y * corners[k, 2, 1],
    )
    j0, j1, j2 = (
        x * corners[j, 0, 0] + y * corners[j, 0, 1],
        x * corners[j, 1, 0] + y * corners[j, 1, 1],
        x * corners[j, 2, 0] + y * corners[j, 2, 1],
    )
    k_low, k_high, j_low, j_high = min(k0, k1, k2), max(k0, k1, k2), min(j0, j1, j2), max(j0, j1, j2)
    largest = max(abs(corners[k, 0, 0]), abs(corners[k, 0, 1]), abs(corners[j, 0, 0]), abs(corners[j, 0, 1]))
    touch = TOUCH * min(k_high - k_low, j_high - j_low) + ROUNDING * largest * (abs(x) + abs(y))
    return not min(k_high, j_high) - max(k_low, j_low) > touch


@leaf
def _overlap(corners, k, j):
    """Whether the triangles k and j share more than an edge: no normal of their sides parts them.  False where one has no area or is no number."""
    for c in range(3):
        d = (c + 1) % 3
        if _parted(corners, k, j, corners[k, c, 1] - corners[k, d, 1], corners[k, d, 0] - corners[k, c, 0]):
            return False
        if _parted(corners, k, j, corners[j, c, 1] - corners[j, d, 1], corners[j, d, 0] - corners[j, c, 0]):
            return False
    return True


@kernel
def _list_overlaps(corners, clear, covered, low_x, low_y, scale_x, scale_y, side, first, listed, boxes, pairs, n):
    """Adds to the `n` rows of `pairs` (M, 2) the triangles that are not covered as a whole, each with one that overlaps it; how many there are then.

    boxes: (len(listed), 4) float64, the least and the largest x and y of the triangles, as they are listed.
    """
    for cell in range(side * side):
        begin, end = first[cell - 1] if cell > 0 else 0, first[cell]
        for one in range(begin, end):
            k = listed[one]
            for two in range(one + 1, end):
                x0, x1 = max(boxes[one, 0], boxes[two, 0]), min(boxes[one, 1], boxes[two, 1])
                if not x0 < x1:
                    continue
                y0, y1 = max(boxes[one, 2], boxes[two, 2]), min(boxes[one, 3], boxes[two, 3])
                j = listed[two]
                if not y0 < y1 or (covered[k] and covered[j]) or (clear[k] and clear[j]):
                    continue
                # Of the cells that list both, the one with this corner of what their boxes share.
                if _cell(y0, low_y, scale_y, side) * side + _cell(x0, low_x, scale_x, side) != cell or not _overlap(corners, k, j):
                    continue
                for a, b in ((k, j), (j, k)):
                    if not covered[a]:
                        if n < len(pairs):
                            pairs[n, 0], pairs[n, 1] = a, b
                        n += 1
    return n


@kernel
def _mark_covered(corners, clear, start, covered, pairs):
    """Marks the triangles (N,) that other triangles of their plane cover; how many pairs of one that is covered in part and its coverer there are.

    corners: (N, 3, 2) float64, plane by plane.  clear: (N,) bool, which of them are of glass, and do not count on each other.  start: (P + 1,), the
    planes.  pairs: (M, 2) int64, as many of them as there is room for.
    """
    listed_pairs, left = 0, MOST_PAIRS
    for p in range(len(start) - 1):
        begin, end = start[p], start[p + 1]
        if end - begin < 2:
            continue
        low_x = low_y = np.inf
        high_x = high_y = -np.inf
        for k in range(begin, end):
            for c in range(3):
                low_x, high_x = min(low_x, corners[k, c, 0]), max(high_x, corners[k, c, 0])
                low_y, high_y = min(low_y, corners[k, c, 1]), max(high_y, corners[k, c, 1])
        # Each cell lists the triangles whose boxes meet it; of wide boxes, as in a fan, fewer cells are made.
        side = max(1, int((end - begin) ** 0.5))
        while True:
            scale_x, scale_y = side / max(high_x - low_x, 1e-30), side / max(high_y - low_y, 1e-30)
            listings = 0
            for k in range(begin, end):
                x0, x1, y0, y1 = _box(corners, k, low_x, low_y, scale_x, scale_y, side)
                listings += (x1 - x0 + 1) * (y1 - y0 + 1)
            if side == 1 or listings <= MOST_CELLS * (end - begin):
                break
            side //= 2
        if listings > MOST_IN_A_CELL * side * side:
            continue
        first, listed = np.zeros(side * side + 1, np.int64), np.empty(listings, np.int64)
        for turn in range(2):  # counted, then filled in
            for k in range(begin, end):
                x0, x1, y0, y1 = _box(corners, k, low_x, low_y, scale_x, scale_y, side)
                for y in range(y0, y1 + 1):
                    for x in range(x0, x1 + 1):
                        cell = y * side + x
                        if turn == 0:
                            first[cell + 1] += 1
                        else:
                            listed[first[cell]] = k
                            first[cell] += 1
            if turn == 0:
                for cell in range(side * side):
                    first[cell + 1] += first[cell]
        for k in range(begin, end):
            covered[k] = _is_covered(corners, clear, k, low_x, low_y, scale_x, scale_y, side, first, listed)
        work = 0
        for cell in range(side * side):
            count = first[cell] - (first[cell - 1] if cell > 0 else 0)
            work += count * (count - 1) // 2
        if work <= left:
            left -= work
            boxes = np.empty((listings, 4))
            for at in range(listings):
                own = corners[listed[at]]
                boxes[at, 0], boxes[at, 1] = min(own[0, 0], own[1, 0], own[2, 0]), max(own[0, 0], own[1, 0], own[2, 0])
                boxes[at, 2], boxes[at, 3] = min(own[0, 1], own[1, 1], own[2, 1]), max(own[0, 1], own[1, 1], own[2, 1])
            listed_pairs = _list_overlaps(
                corners, clear, covered, low_x, low_y, scale_x, scale_y, side, first, listed, boxes, pairs, listed_pairs
            )
    return listed_pairs


class Coincident(NamedTuple):
    """Triangles that others lie on.

    whole: (K,) int64, those that are covered as a whole.  part: (L,) int64, in part.  first: (L + 1,) int64, where the coverers of each of these
    begin.  covers: (C, 4, 4) float32, coverers (`surfaces.covers`).
    """

    whole: np.ndarray
    part: np.ndarray
    first: np.ndarray
    covers: np.ndarray

    @staticmethod
    def none() -> Coincident:
        """No such triangles."""
        return Coincident(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(1, np.int64), np.zeros((0, 4, 4), np.float32))

    def __bool__(self) -> bool:
        return len(self.whole) + len(self.part) > 0


def coincident(scene: Scene) -> Coincident:
    """The triangles in planes across an axis that others cover, and in which parts: opaque ones and glass on them, which all rays see, on both sides."""
    geometry, materials = scene.geometry, scene.materials.tables
    seen = (geometry.object_visibility & (DIFFUSE | SHADOW)) == DIFFUSE | SHADOW
    glass = materials.flags & REFRACTIVE != 0
    counts = (materials.flags & TRANSPARENT == 0) | (glass & (materials.flags & (ANGLED | TELLING) == 0))
    wanted = seen[geometry.object] & counts[geometry.material]
    index, axis, place = (np.empty(len(wanted), kind) for kind in (np.int64, np.int64, np.float32))
    n = _across_axes(geometry.vertices, geometry.triangles, wanted, np.asarray(scene.origin, np.float64), index, axis, place)
    if n < 2:
        return Coincident.none()
    order = np.lexsort((place[:n], axis[:n]))
    index, axis, place = index[:n][order], axis[:n][order], place[:n][order]
    start = np.flatnonzero((np.diff(axis) != 0) | (np.diff(place) != 0)) + 1
    corners = geometry.vertices[geometry.triangles[index]].astype(np.float64)
    flat = np.empty((n, 3, 2))
    for k in range(3):
        here = axis == k
        flat[here] = corners[here][..., [(k + 1) % 3, (k + 2) % 3]]
    covered, pairs = np.zeros(n, np.bool_), np.empty((MOST_LISTED, 2), np.int64)
    listed = _mark_covered(flat, glass[geometry.material[index]], np.concatenate([[0], start, [n]]), covered, pairs)
    return _in_parts(index, flat, covered, pairs[:listed] if listed <= MOST_LISTED else pairs[:0])


def _in_parts(index: np.ndarray, flat: np.ndarray, covered: np.ndarray, pairs: np.ndarray) -> Coincident:
    """Sorts what `_mark_covered` has found among the triangles `index` (N,) by the triangles."""
    whole = np.sort(index[covered])
    pairs = pairs[np.bincount(pairs[:, 0], minlength=len(index))[pairs[:, 0]] <= MOST_COVERING]
    pairs = pairs[np.argsort(index[pairs[:, 0]], kind="stable")]
    part, first = np.unique(index[pairs[:, 0]], return_index=True)
    return Coincident(whole, part, np.append(first, len(pairs)), coverers(flat[pairs[:, 0]], flat[pairs[:, 1]]))


def without_reflection(tables: Transport, at: Coincident) -> Transport:
    """The tables with the triangles `at` black, as a whole or in part, but for those that shine."""
    materials = tables.materials
    shines = materials.flags & EMISSIVE != 0
    whole, partly = at.whole[~shines[tables.material[at.whole]]], np.flatnonzero(~shines[tables.material[at.part]])
    if not len(whole) + len(partly):
        return tables
    # One black material, then one of each triangle that is covered in part, whose program is one instruction.
    black, part = len(materials.flags), at.part[partly]
    own = tables.material[part]
    code = np.zeros((len(part), materials.code.shape[1]), materials.code.dtype)
    code[:, 0], code[:, 2], code[:, 3], code[:, 7] = COVERED_PARTS, at.first[partly], at.first[partly + 1], own
    material = tables.material.copy()
    material[whole] = black
    material[part] = black + 1 + np.arange(len(part))
    more = materials._replace(
        code=np.concatenate([materials.code, code]),
        start=np.concatenate([materials.start, [0], len(materials.code) + np.arange(len(part))]).astype(materials.start.dtype),
        flags=np.concatenate([materials.flags, [CONSTANT], materials.flags[own] & ~CONSTANT | COVERED]).astype(materials.flags.dtype),
        constant=np.concatenate([materials.constant, np.zeros((1 + len(part), SURFACE), np.float32)]),
        covers=at.covers,
    )
    return tables._replace(material=material, materials=more)


def covered_places(at: Coincident, triangles: int) -> CoveredPlaces:
    """What the camera's samples of so many triangles look up."""
    if not at:
        return CoveredPlaces.none()
    state = np.full(triangles, BARE, np.int32)
    state[at.part] = np.arange(len(at.part))
    state[at.whole] = WHOLE
    return CoveredPlaces(state, at.first, at.covers, np.zeros(triangles, np.uint8))


def warning_line(geometry: Geometry, at: np.ndarray) -> str:
    """Names the objects that have some of the triangles `at` (K,), which are seen where others cover them."""
    names = list(dict.fromkeys(geometry.object_names[o] for o in np.unique(geometry.object[at])))
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    named = ", ".join(f"'{name}'" for name in names[:MOST_NAMES])
    return (
        f"{len(at):,} triangles that are seen lie exactly on others, as a whole or in part (object {named}{more}): Cycles shows them black there, "
        "and so does Lumigate; delete the doubled faces, or move one of both a little"
    )
