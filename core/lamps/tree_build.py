"""Building the light tree: top down, splitting where bounds, orientation and energy fall apart best.

Conty Estevez & Kulla 2018, section 4: surface area orientation heuristic over binned splits.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import kernel
from .tables import AGAINST, AXIS, COS_E, COS_O, ENERGY, LOWER, NODE, PLANE, UPPER, LightTree

# Rows of bounds, float64: the columns of `LightTree.nodes` and one more.
TWO_SIDED, COLUMNS = NODE, NODE + 1

_BINS = 12
_CUT = 16
_ALIKE = 1 - 1e-12  # cosine between the axes of lamps that face the same way


@kernel(fast=False)
def _angle(cosine):
    return math.acos(min(max(cosine, -1.0), 1.0))


@kernel(fast=False)
def _merge_cones(total, bx, by, bz, cos_b):
    """Smallest cone around the cone of row `total` and another one (PBRT 4th ed., section 3.8.4)."""
    ax, ay, az = total[AXIS], total[AXIS + 1], total[AXIS + 2]
    theta_a, theta_b = _angle(total[COS_O]), _angle(cos_b)
    between = _angle(ax * bx + ay * by + az * bz)
    if min(between + theta_b, math.pi) <= theta_a:
        return
    if min(between + theta_a, math.pi) <= theta_b:
        total[AXIS], total[AXIS + 1], total[AXIS + 2], total[COS_O] = bx, by, bz, cos_b
        return
    theta = 0.5 * (theta_a + between + theta_b)
    kx, ky, kz = bx - ax * math.cos(between), by - ay * math.cos(between), bz - az * math.cos(between)
    length = math.sqrt(kx * kx + ky * ky + kz * kz)
    if theta >= math.pi or length < 1e-9:
        total[COS_O] = -1.0
        return
    s, c = math.sin(theta - theta_a) / length, math.cos(theta - theta_a)
    total[AXIS], total[AXIS + 1], total[AXIS + 2] = c * ax + s * kx, c * ay + s * ky, c * az + s * kz
    total[COS_O] = math.cos(theta)


@kernel(fast=False)
def merge(total, row):
    """Let the bounds `total` take in another row; rows without energy are empty."""
    if row[ENERGY] <= 0.0:
        return
    if total[ENERGY] <= 0.0:
        for j in range(COLUMNS):
            total[j] = row[j]
        return
    for j in range(3):
        total[LOWER + j] = min(total[LOWER + j], row[LOWER + j])
        total[UPPER + j] = max(total[UPPER + j], row[UPPER + j])
    bx, by, bz = row[AXIS], row[AXIS + 1], row[AXIS + 2]
    alike = total[AXIS] * bx + total[AXIS + 1] * by + total[AXIS + 2] * bz > _ALIKE
    total[PLANE] = min(total[PLANE], row[PLANE]) if alike else -np.inf
    if total[TWO_SIDED] > 0.0 and row[TWO_SIDED] > 0.0:
        flip = -1.0 if total[AXIS] * bx + total[AXIS + 1] * by + total[AXIS + 2] * bz < 0.0 else 1.0
        _merge_cones(total, flip * bx, flip * by, flip * bz, row[COS_O])
    elif total[TWO_SIDED] > 0.0 or row[TWO_SIDED] > 0.0:
        total[COS_O] = -1.0
        total[TWO_SIDED] = 0.0
    else:
        _merge_cones(total, bx, by, bz, row[COS_O])
    total[AGAINST] = max(total[AGAINST], row[AGAINST])
    total[COS_E] = min(total[COS_E], row[COS_E])
    total[ENERGY] += row[ENERGY]


@kernel(fast=False)
def _cost(row):
    """Energy x surface area x orientation measure of bounds (the paper's section 4.2)."""
    if row[ENERGY] <= 0.0:
        return 0.0
    x, y, z = row[UPPER] - row[LOWER], row[UPPER + 1] - row[LOWER + 1], row[UPPER + 2] - row[LOWER + 2]
    # Lamps in a line span no area, so a little of the squared diagonal counts as well.
    area = x * y + y * z + z * x + 0.01 * (x * x + y * y + z * z)
    o = _angle(row[COS_O])
    w = min(o + _angle(row[COS_E]), math.pi)
    orientation = 2 * math.pi * (1 - math.cos(o)) + 0.5 * math.pi * (
        2 * w * math.sin(o) - math.cos(o - 2 * w) - 2 * o * math.sin(o) + math.cos(o)
    )
    return row[ENERGY] * area * orientation


@kernel(fast=False)
def _split(bounds, order, begin, end):
    """Partition order[begin:end] in two by the cheapest binned plane -> the border; halves where none helps."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(begin, end):
        for j in range(3):
            c = bounds[order[i], LOWER + j] + bounds[order[i], UPPER + j]
            low[j] = min(low[j], c)
            high[j] = max(high[j], c)
    widest = max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    best, best_axis, best_bin = np.inf, -1, 0
    bins = np.zeros((_BINS, COLUMNS))
    right_cost = np.zeros(_BINS)
    running = np.zeros(COLUMNS)
    for axis in range(3):
        width = high[axis] - low[axis]
        if width <= 1e-6 * widest or width <= 0.0:
            continue
        bins[:] = 0.0
        for i in range(begin, end):
            c = bounds[order[i], LOWER + axis] + bounds[order[i], UPPER + axis]
            merge(bins[min(int(_BINS * (c - low[axis]) / width), _BINS - 1)], bounds[order[i]])
        running[:] = 0.0
        for k in range(_BINS - 1, 0, -1):
            merge(running, bins[k])
            right_cost[k] = _cost(running)
        running[:] = 0.0
        for k in range(1, _BINS):
            merge(running, bins[k - 1])
            # Thin boxes are split across their long side (the paper's k_r).
            cost = widest / width * (_cost(running) + right_cost[k])
            if cost < best:
                best, best_axis, best_bin = cost, axis, k
    if best_axis < 0:
        return (begin + end) // 2
    width = high[best_axis] - low[best_axis]
    i, j = begin, end - 1
    while i <= j:
        c = bounds[order[i], LOWER + best_axis] + bounds[order[i], UPPER + best_axis]
        if min(int(_BINS * (c - low[best_axis]) / width), _BINS - 1) < best_bin:
            i += 1
        else:
            order[i], order[j] = order[j], order[i]
            j -= 1
    return i if begin < i < end else (begin + end) // 2


@kernel(fast=False)
def _build(bounds, n, order, children):
    """Interior nodes n, n + 1, ... over the emitters `order`; fills their rows of `bounds` and their children."""
    stack = [(0, len(order), -1, 0)]
    n_nodes = 0
    while len(stack) > 0:
        begin, end, above, side = stack.pop()
        if end - begin == 1:
            node = order[begin]
        else:
            node = n + n_nodes
            n_nodes += 1
            border = _split(bounds, order, begin, end)
            stack.append((border, end, node, 1))
            stack.append((begin, border, node, 0))
        if above >= 0:
            children[above - n, side] = node
    for k in range(n_nodes - 1, -1, -1):  # children come after their parents
        bounds[n + k] = 0.0
        merge(bounds[n + k], bounds[children[k, 0]])
        merge(bounds[n + k], bounds[children[k, 1]])


def light_tree(bounds: np.ndarray, members: np.ndarray) -> LightTree:
    """Tree over some of E emitters.

    bounds: (E, COLUMNS) float64, one row for each emitter (rows of sun and world are not used).
    members: (M,) emitters that the tree holds; none, one or many.
    """
    n, m = len(bounds), len(members)
    inner = max(m - 1, 0)
    rows = np.concatenate([bounds, np.zeros((inner, COLUMNS))])
    children = np.zeros((inner, 2), np.int32)
    if inner:
        _build(rows, n, np.array(members, np.int64), children)
    root = -1 if m == 0 else int(members[0]) if m == 1 else n
    cut = [root] if m else []
    while cut and len(cut) < _CUT:
        inside = [k for k in cut if k >= n]
        if not inside:
            break
        widest = max(inside, key=lambda k: rows[k, ENERGY] * np.sum((rows[k, UPPER : UPPER + 3] - rows[k, :3]) ** 2))
        cut.remove(widest)
        cut += children[widest - n].tolist()
    nodes = rows[:, :NODE].astype(np.float32)
    # Boxes grow by a rounding error, so that float32 bounds still hold float64 ones.
    nodes[:, LOWER : LOWER + 3] = np.nextafter(nodes[:, LOWER : LOWER + 3], np.float32(-np.inf))
    nodes[:, UPPER : UPPER + 3] = np.nextafter(nodes[:, UPPER : UPPER + 3], np.float32(np.inf))
    two_sided = (rows[:, TWO_SIDED] > 0).astype(np.uint8)
    return LightTree(nodes, two_sided, children, np.array(cut, np.int32), root)
