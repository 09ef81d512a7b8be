"""The skeleton reduced to the nodes that hold its topology and its geometry (visibility gates paper, Section IV.B.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..jit import kernel
from .skeleton import Skeleton, neighbours

PLAIN, TOPOLOGY, CURVATURE, COVERAGE = 0, 1, 2, 3  # kinds of nodes; plain ones are left out


@dataclass(frozen=True)
class Segmented:
    """K nodes of a skeleton of N, and E edges between them.

    node: (K,) int32 into the skeleton's nodes.  kind: (K,) uint8.  edges: (E, 2) int32 into these.
    owner: (N,) int32, the one of these that stands for each node: the nearest along its line.
    """

    node: np.ndarray
    kind: np.ndarray
    edges: np.ndarray
    owner: np.ndarray


@kernel
def _lines(first, to, seed, line, start):
    """Walk all lines from the nodes where `seed` is set to the next such nodes; the number of lines.

    line: room for all lines' nodes, extrema included.  start: room for where each begins, and where the last one ends.
    """
    lines = at = 0
    start[0] = 0
    for n in range(len(seed)):
        if not seed[n]:
            continue
        for a in range(first[n], first[n + 1]):
            begin = at
            line[at], line[at + 1] = n, to[a]
            at += 2
            while not seed[line[at - 1]]:
                here, before = line[at - 1], line[at - 2]
                other = to[first[here]]
                line[at] = to[first[here] + 1] if other == before else other
                at += 1
            # Both ends meet the line: it is walked from the lower one, and a loop from its lower neighbour.
            if line[at - 1] < n or (line[at - 1] == n and line[at - 2] < line[begin + 1]):
                at = begin
                continue
            lines += 1
            start[lines] = at
    return lines


@kernel
def _off_line(place, radius, a, b, begin, end, line):
    """The node between two places of a line that lies farthest from the straight line a b, in its radii, and how far."""
    ex, ey, ez = place[b, 0] - place[a, 0], place[b, 1] - place[a, 1], place[b, 2] - place[a, 2]
    length2 = np.float64(ex * ex + ey * ey + ez * ez)
    most, chosen = 0.0, -1
    for k in range(begin + 1, end):
        n = line[k]
        dx, dy, dz = place[n, 0] - place[a, 0], place[n, 1] - place[a, 1], place[n, 2] - place[a, 2]
        along = (dx * ex + dy * ey + dz * ez) / length2 if length2 > 0 else 0.0
        qx, qy, qz = dx - along * ex, dy - along * ey, dz - along * ez
        curvature = np.sqrt(qx * qx + qy * qy + qz * qz) / radius[n]
        if curvature > most:
            most, chosen = curvature, k
    return chosen, most


@kernel
def _in_ball(place, radius, centre, n):
    dx, dy, dz = place[n, 0] - place[centre, 0], place[n, 1] - place[centre, 1], place[n, 2] - place[centre, 2]
    return dx * dx + dy * dy + dz * dz <= radius[centre] * radius[centre]


@kernel
def _uncovered(place, radius, a, b, begin, end, line):
    """The node of the largest ball among those of a line that neither extremum's ball holds; the middlemost of equals; -1 if none."""
    chosen = -1
    for k in range(begin + 1, end):
        n = line[k]
        if _in_ball(place, radius, a, n) or _in_ball(place, radius, b, n):
            continue
        if chosen >= 0:
            best = line[chosen]
            nearer = abs(2 * k - begin - end) < abs(2 * chosen - begin - end)
            if radius[n] < radius[best] or (radius[n] == radius[best] and not nearer):
                continue
        chosen = k
    return chosen


@kernel
def _cut(place, radius, line, start, lines, kind, owner, edges):
    """Cut the lines at curvature and coverage nodes; edges between extrema into `edges`, their number."""
    count = 0
    stack = np.empty((64 + len(line), 2), np.int64)
    for l in range(lines):  # noqa: E741
        depth = 1
        stack[0, 0], stack[0, 1] = start[l], start[l + 1] - 1
        while depth > 0:
            depth -= 1
            begin, end = stack[depth, 0], stack[depth, 1]
            a, b = line[begin], line[end]
            at, curvature = _off_line(place, radius, a, b, begin, end, line)
            why = CURVATURE
            if not curvature > 1.0:
                at, why = _uncovered(place, radius, a, b, begin, end, line), COVERAGE
            if at >= 0:
                kind[line[at]] = why
                owner[line[at]] = line[at]
                stack[depth, 0], stack[depth, 1] = begin, at
                stack[depth + 1, 0], stack[depth + 1, 1] = at, end
                depth += 2
                continue
            edges[count, 0], edges[count, 1] = a, b
            count += 1
            for k in range(begin + 1, end):
                owner[line[k]] = a if k - begin <= end - k else b
    return count


def segment(skeleton: Skeleton) -> Segmented:
    """Keep the nodes of a degree other than two, and of the lines between them those that a straight edge would lose.

    Curvature: distance to the straight line between a line's ends over the ball's radius, beyond 1.  Coverage: in no ball of the ends.
    A ring without any such node keeps its first one.
    """
    n = len(skeleton.radius)
    first, to = neighbours(n, skeleton.arcs)
    kind = np.where(np.diff(first) != 2, np.uint8(TOPOLOGY), np.uint8(PLAIN))
    marked = np.zeros(skeleton.components, bool)
    marked[skeleton.component[kind == TOPOLOGY]] = True
    lowest = np.full(skeleton.components, n)
    np.minimum.at(lowest, skeleton.component, np.arange(n))
    kind[lowest[~marked]] = TOPOLOGY
    line, start = np.empty(4 * len(skeleton.arcs) + 4, np.int64), np.empty(len(skeleton.arcs) + 2, np.int64)
    lines = _lines(first, to, kind == TOPOLOGY, line, start)
    owner = np.arange(n)
    edges = np.empty((len(skeleton.arcs) + 1, 2), np.int64)
    count = _cut(skeleton.place.astype(np.int64), skeleton.radius, line[: start[lines] + 1], start, lines, kind, owner, edges)
    node = np.flatnonzero(kind)
    index = np.zeros(n, np.int32)
    index[node] = np.arange(len(node))
    edges = np.unique(np.sort(index[edges[:count]], axis=1), axis=0)
    edges = np.ascontiguousarray(edges[edges[:, 0] != edges[:, 1]])
    return Segmented(node.astype(np.int32), kind[node], edges, index[owner])
