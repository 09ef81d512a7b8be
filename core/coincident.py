"""Faces that lie on other faces: whatever leaves one of them meets the other at once.

Cycles' rays leave a triangle without an offset and leave out that triangle alone, so that one which shares its place with another is
black, in direct and in indirect light, wherever rounding does not lift the ray's origin off it by chance: always in a plane across an
axis of the world, whose coordinate is exact.  (Measured with Cycles 4.5 for all six directions; tests/headless/test_coincident.py does
so for three, with 5.2, too.  In other planes about half of the light gets through, and much of the rest comes back by the other face.)  Such faces are black here, too:
layers of both renderers are added up, and have to show the same.
"""

from __future__ import annotations

import numpy as np

from .jit import kernel, leaf
from .scene import CONSTANT, DIFFUSE, EMISSIVE, REFRACTIVE, SHADOW, TRANSPARENT, Geometry, Scene
from .surfaces.layout import SURFACE
from .transport import Transport
from .view.points import ShadingPoints

MOST_NAMES = 3  # in a warning
MOST_CELLS = 64  # that a triangle is listed in, on average
MOST_IN_A_CELL = 1024  # triangles, on average: a plane with more, all across each other, is left as it is
LOOKS = 24  # to a side of a triangle that no other one covers alone
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
def _coverer(corners, k, x, y, least, low_x, low_y, scale_x, scale_y, side, first, listed):
    """A triangle other than k that holds a place, -1 for none; cells are filled, and begin where their predecessor does in `first`."""
    cell = _cell(y, low_y, scale_y, side) * side + _cell(x, low_x, scale_x, side)
    for at in range(first[cell - 1] if cell > 0 else 0, first[cell]):
        if listed[at] != k and _within(corners, listed[at], x, y, least):
            return listed[at]
    return np.int64(-1)


@leaf
def _is_covered(corners, k, low_x, low_y, scale_x, scale_y, side, first, listed):
    """Whether other triangles cover triangle k wherever it is looked at."""
    ax, ay, bx, by, cx, cy = corners[k, 0, 0], corners[k, 0, 1], corners[k, 1, 0], corners[k, 1, 1], corners[k, 2, 0], corners[k, 2, 1]
    x, y = 0.5 * ax + 0.3 * bx + 0.2 * cx, 0.5 * ay + 0.3 * by + 0.2 * cy
    by_one = _coverer(corners, k, x, y, 1e-4, low_x, low_y, scale_x, scale_y, side, first, listed)
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
                if _coverer(corners, k, x, y, -1e-4, low_x, low_y, scale_x, scale_y, side, first, listed) < 0:
                    return False
    return True


@kernel
def _mark_covered(corners, start, covered):
    """Marks the triangles (N,) that other triangles of their plane cover.

    corners: (N, 3, 2) float64, plane by plane.  start: (P + 1,), the planes.
    """
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
            covered[k] = _is_covered(corners, k, low_x, low_y, scale_x, scale_y, side, first, listed)


def coincident(scene: Scene) -> np.ndarray:
    """The triangles (K,) int64 in planes across an axis that others cover: opaque ones, which all rays see, on both sides."""
    geometry, materials = scene.geometry, scene.materials.tables
    seen = (geometry.object_visibility & (DIFFUSE | SHADOW)) == DIFFUSE | SHADOW
    opaque = (materials.flags & (TRANSPARENT | REFRACTIVE)) == 0
    wanted = seen[geometry.object] & opaque[geometry.material]
    index, axis, place = (np.empty(len(wanted), kind) for kind in (np.int64, np.int64, np.float32))
    n = _across_axes(geometry.vertices, geometry.triangles, wanted, np.asarray(scene.origin, np.float64), index, axis, place)
    if n < 2:
        return np.zeros(0, np.int64)
    order = np.lexsort((place[:n], axis[:n]))
    index, axis, place = index[:n][order], axis[:n][order], place[:n][order]
    start = np.flatnonzero((np.diff(axis) != 0) | (np.diff(place) != 0)) + 1
    corners = geometry.vertices[geometry.triangles[index]].astype(np.float64)
    flat = np.empty((n, 3, 2))
    for k in range(3):
        here = axis == k
        flat[here] = corners[here][..., [(k + 1) % 3, (k + 2) % 3]]
    covered = np.zeros(n, np.bool_)
    _mark_covered(flat, np.concatenate([[0], start, [n]]), covered)
    return np.sort(index[covered])


def without_reflection(tables: Transport, at: np.ndarray) -> Transport:
    """The tables with the triangles `at` (K,) black, but for those that shine."""
    materials = tables.materials
    at = at[(materials.flags[tables.material[at]] & EMISSIVE) == 0]
    if not len(at):
        return tables
    black = len(materials.flags)
    material = tables.material.copy()
    material[at] = black
    more = materials._replace(
        start=np.append(materials.start, materials.start.dtype.type(0)),
        flags=np.append(materials.flags, materials.flags.dtype.type(CONSTANT)),
        constant=np.concatenate([materials.constant, np.zeros((1, SURFACE), np.float32)]),
    )
    return tables._replace(material=material, materials=more)


def darken(points: ShadingPoints, at: np.ndarray) -> np.ndarray:
    """Takes all reflection from the points on the triangles `at` (K,); those of them that are seen."""
    if not len(at) or not len(points.triangle):
        return at[:0]
    marked = np.zeros(max(int(points.triangle.max()), int(at.max())) + 1, bool)
    marked[at] = True
    here = marked[points.triangle]
    for reflectance in (points.albedo, points.f0, points.f90):
        reflectance[here] = 0
    return np.unique(points.triangle[here])


def warning_line(geometry: Geometry, at: np.ndarray) -> str:
    """Names the objects that have some of the seen triangles `at` (K,)."""
    names = list(dict.fromkeys(geometry.object_names[o] for o in np.unique(geometry.object[at])))
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    named = ", ".join(f"'{name}'" for name in names[:MOST_NAMES])
    return (
        f"{len(at):,} triangles that are seen lie exactly on others (object {named}{more}): Cycles shows them black, and so does Lumigate; "
        "delete the doubled faces, or move one of both a little"
    )
