"""A binary bounding volume hierarchy by binned surface area heuristic.

Wald 2007, "On fast construction of SAH-based bounding volume hierarchies".
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel

BINS = 16
LEAF_SIZE = 4
TRAVERSAL_COST = np.float32(2.0)  # of one node, in units of one triangle test

# Words of a node (float32; the last four are int32 in the same memory): the boxes of both children, then
# where they are. A child of `count` > 0 triangles is a leaf and `child` its first triangle; else a node.
LEFT_LOW, LEFT_HIGH, RIGHT_LOW, RIGHT_HIGH, CHILD, COUNT = 0, 3, 6, 9, 12, 14
NODE_WORDS = 16
# No path is deeper: SAH splits stop at half of it, and halving splits need 32 more at most.
MAX_DEPTH = 96
_SAH_DEPTH = 60


@kernel
def _bounds(low, high, order, begin, end, box):
    for a in range(3):
        box[a] = np.inf
        box[3 + a] = -np.inf
    for k in range(begin, end):
        p = order[k]
        for a in range(3):
            box[a] = min(box[a], low[p, a])
            box[3 + a] = max(box[3 + a], high[p, a])


@kernel
def _half_area(box):
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x if x >= 0 else np.float32(0.0)


@kernel
def _grow(box, low, high):
    for a in range(3):
        box[a] = min(box[a], low[a])
        box[3 + a] = max(box[3 + a], high[a])


@kernel
def _best_split(low, high, centre, order, begin, end, area, box, bins, counts, right_area):
    """(axis or -1 for a leaf, bin border, lowest centre, bins per unit) of the cheapest split."""
    count = end - begin
    best = np.float32(count) if count <= LEAF_SIZE else np.float32(np.inf)
    best_axis, best_bin, best_low, best_scale = -1, 0, np.float32(0.0), np.float32(0.0)
    for axis in range(3):
        c_low, c_high = np.float32(np.inf), np.float32(-np.inf)
        for k in range(begin, end):
            c = centre[order[k], axis]
            c_low, c_high = min(c_low, c), max(c_high, c)
        scale = np.float32(BINS * 0.9999) / (c_high - c_low)
        if not (c_high > c_low) or not np.isfinite(scale):
            continue
        counts[:] = 0
        bins[:, :3] = np.inf
        bins[:, 3:] = -np.inf
        for k in range(begin, end):
            p = order[k]
            b = int((centre[p, axis] - c_low) * scale)
            counts[b] += 1
            _grow(bins[b], low[p], high[p])
        box[:3] = np.inf
        box[3:] = -np.inf
        for b in range(BINS - 1, 0, -1):
            _grow(box, bins[b, :3], bins[b, 3:])
            right_area[b] = _half_area(box)
        box[:3] = np.inf
        box[3:] = -np.inf
        n_left = 0
        for b in range(1, BINS):
            _grow(box, bins[b - 1, :3], bins[b - 1, 3:])
            n_left += counts[b - 1]
            if n_left == 0 or n_left == count:
                continue
            cost = TRAVERSAL_COST + (_half_area(box) * n_left + right_area[b] * (count - n_left)) / area
            if cost < best:
                best, best_axis, best_bin, best_low, best_scale = cost, axis, b, c_low, scale
    return best_axis, best_bin, best_low, best_scale


@kernel
def _partition(centre, order, begin, end, axis, border, c_low, scale):
    left, right = begin, end - 1
    while left <= right:
        if int((centre[order[left], axis] - c_low) * scale) < border:
            left += 1
        else:
            order[left], order[right] = order[right], order[left]
            right -= 1
    return left


@kernel
def build(low, high, order, first, first_node, nodes, words):
    """Build over triangles order[0..P-1]; returns the number of nodes (the first is the root).

    low, high: (T, 3) float32 boxes.  order: (P,) int32, permuted in place; leaves hold ranges of it,
        counted from `first`.  nodes: (max(1, P - 1), NODE_WORDS) float32 and words: the same as int32;
        nodes[0] is node `first_node` of the whole table.
    """
    centre = np.float32(0.5) * low + np.float32(0.5) * high
    bins = np.empty((BINS, 6), np.float32)
    counts = np.empty(BINS, np.int64)
    right_area = np.empty(BINS, np.float32)
    box = np.empty(6, np.float32)
    # A task is (begin, end, node that waits for it, side of that node, depth).
    tasks = np.empty((MAX_DEPTH + 2, 5), np.int64)
    tasks[0] = (0, len(order), -1, 0, 0)
    n_tasks, n_nodes = 1, 0
    while n_tasks > 0:
        n_tasks -= 1
        begin, end, parent, side, depth = tasks[n_tasks]
        _bounds(low, high, order, begin, end, box)
        if parent >= 0:
            at = RIGHT_LOW if side else LEFT_LOW
            nodes[parent, at : at + 6] = box
        area = max(_half_area(box), np.float32(1e-37))
        axis, border, c_low, scale = -1, 0, np.float32(0.0), np.float32(0.0)
        if end - begin > 1 and depth < _SAH_DEPTH:
            axis, border, c_low, scale = _best_split(low, high, centre, order, begin, end, area, box, bins, counts, right_area)
        if axis < 0 and end - begin <= LEAF_SIZE:
            if parent >= 0:
                words[parent, CHILD + side], words[parent, COUNT + side] = first + begin, end - begin
                continue
            if end == 1:  # one triangle in all: both sides of the root, since a node has two children
                for s in range(2):
                    nodes[0, LEFT_LOW + 6 * s : LEFT_LOW + 6 * s + 6] = box
                    words[0, CHILD + s], words[0, COUNT + s] = first, 1
                return 1
        if axis < 0:  # all centres alike, or too deep: halves
            middle = (begin + end) // 2
        else:
            middle = _partition(centre, order, begin, end, axis, border, c_low, scale)
        node = n_nodes
        n_nodes += 1
        if parent >= 0:
            words[parent, CHILD + side], words[parent, COUNT + side] = first_node + node, 0
        tasks[n_tasks] = (middle, end, node, 1, depth + 1)
        tasks[n_tasks + 1] = (begin, middle, node, 0, depth + 1)
        n_tasks += 2
    return n_nodes
