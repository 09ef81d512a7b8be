"""Exact nearest centres of many points: regular grids over the centres, searched in expanding shells.

The grid is the paper's acceleration structure (fuzzy clustering, Section 3.3, Algorithm 1); its 27-cell
neighbourhood is the mode `neighbourhood`, which may miss the nearest centre.  The mode `shells` goes on
outwards until no centre further away can be nearer, and equals brute force bit for bit:
squared distances are float32 sums in one order, without contraction, and equal ones go to the lower index.

Where normals have a threshold, centres are split by their normal's dominant axis into up to six grids (a
floor's centres make a flat one), and a block of points looks only into those its normals can agree with.  Where
centres crowd in a small part of a grid (a landscape seen from the ground), the crowd gets a finer grid of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..threads import run_chunks
from .blocks import LANES, PointBlocks, as_vectors, gather, gather_normals

SEARCHES = ("shells", "neighbourhood")
ANY_NORMAL = -8.0  # a threshold below every cosine

_BLOCKS_PER_CHUNK = 256
_SPLIT = 7  # two signs of three axes, and one for centres without a normal
_LEVELS = 5  # of ever finer grids
_CELLS_PER_CENTRE = 16  # at most
_CROWD = 4  # more centres than that in a cell are a crowd, which moves to a finer grid ...
_SHRINK = 0.25  # ... where it is that much smaller than this one
_MOST_CELLS = 2048  # along an axis
_SLACK = 1e-3  # of a cell: above the float32 rounding of a coordinate in cells, of which there are at most 2048
_POINT = 1e-30  # m: a grid with no larger extent is one cell
_ROUNDING = 1 - 1e-5  # of a distance, far above float32 rounding
_INF = np.float32(np.inf)


class Metric(NamedTuple):
    """Squared distance of a point to a centre, in m^2: |dx|^2 + turn (1 - cos) + plane h^2.

    threshold: pairs with cos <= threshold are infinitely far apart (Eq. 7).
    turn: m^2; 2 s^2 embeds the unit normals, scaled by s metres, into the metric (0: positions alone).
    plane: factor of h^2, h the larger of the distances of either to the other's plane (0: none).
    """

    threshold: float = ANY_NORMAL
    turn: float = 0.0
    plane: float = 0.0


BY_POSITION = Metric()


class Grid(NamedTuple):
    """K centres in B grids, sorted by grid and cell.

    positions: (3, K) float32;  normals: (4, K) float32 (see PointBlocks);  ids: (K,) int32, given indices.
    first: (B,) int32, where each grid's cells begin in `start`;  start: first centre of each cell (x fastest), of
        one cell more than there are in each grid.
    origin: (B, 3) float32 (m);  cell: (B,) float32, edge (m);  size: (B, 3) int32, cells.
    normal_bounds: (B, 2, 4) float32, smallest and largest component of the grid's normals.
    """

    positions: np.ndarray
    normals: np.ndarray
    ids: np.ndarray
    first: np.ndarray
    start: np.ndarray
    origin: np.ndarray
    cell: np.ndarray
    size: np.ndarray
    normal_bounds: np.ndarray


def build_grid(centres: np.ndarray, normals: np.ndarray | None = None, split: bool = True) -> Grid:
    """Grids over (K, 3) finite centres; cells small enough that an occupied one holds about two.

    split: by normal, which pays where the search has a threshold.

    Raises:
        ValueError: no centres, or centres that are not finite.
    """
    centres = as_vectors(centres, "centres")
    if len(centres) == 0 or not np.isfinite(centres).all():
        raise ValueError("centres: expected at least one, all finite")
    normals = as_vectors(normals, "centre normals") if normals is not None else np.zeros_like(centres)
    if len(normals) != len(centres):
        raise ValueError(f"centre normals: {len(normals)} rows for {len(centres)} centres")
    rows = gather_normals(normals, np.arange(len(centres), dtype=np.int32))
    order, first, start, origin, cell, size, bounds = _build(centres, rows, _SPLIT if split else 1)
    return Grid(gather(centres, order), np.ascontiguousarray(rows[:, order]), order, first, start, origin, cell, size, bounds)


def nearest(
    points: PointBlocks,
    grid: Grid,
    count: int = 1,
    metric: Metric = BY_POSITION,
    search: str = "shells",
    threads: int = 0,
    within: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The `count` nearest centres of each point, nearest first, in the points' sorted order.

    within: (P,) float32, squared distances that the centres must stay below; infinity by default.

    Returns: (ids, squared distances), both (count, P): int32 and float32; -1 and `within` where no more centres
        are near enough and within the metric's threshold.  With `search="neighbourhood"` only centres in the cells
        of the point's block and the 26 around are compared, unless one of the block's points finds none there.

    Raises:
        ValueError: unknown search.
    """
    if search not in SEARCHES:
        raise ValueError(f"search: expected one of {', '.join(SEARCHES)}, got {search!r}")
    places = points.positions.shape[1]
    ids = np.full((count, places), -1, np.int32)
    squared = np.full((count, places), np.inf if within is None else within, np.float32)
    plane = None if metric.plane == 0 else np.float32(metric.plane)
    threshold, turn = np.float32(metric.threshold), np.float32(metric.turn)

    def work(begin, end):
        _search(LANES, points.positions, points.normals, grid, begin, end, threshold, turn, plane, search == "shells", ids, squared)

    run_chunks(work, places // LANES, _BLOCKS_PER_CHUNK, threads)
    return ids, squared


@kernel(fast=False)
def _build(centres, normals, parts):
    """Distribute centres over `parts` by normal, each over grids and their cells; the fields of Grid in their order."""
    k = len(centres)
    most = parts * _LEVELS
    first, start = np.zeros(most, np.int32), np.empty((_CELLS_PER_CENTRE * k + 64) * _LEVELS, np.int32)
    origin, cell, size = np.zeros((most, 3), np.float32), np.zeros(most, np.float32), np.zeros((most, 3), np.int32)
    bounds = np.zeros((most, 2, 4), np.float32)
    part_of = np.zeros(k, np.int32)
    if parts > 1:
        for i in range(k):
            part_of[i] = _part_of(normals[0, i], normals[1, i], normals[2, i], normals[3, i])
    order, cells = np.empty(k, np.int32), np.empty(k, np.int32)
    counted = np.empty(_CELLS_PER_CENTRE * k + 64, np.int32)
    own = np.empty(k, np.int32)
    high = np.empty(3, np.float32)
    g = next_cell = next_centre = 0
    for part in range(parts):
        n = 0
        for i in range(k):
            if part_of[i] == part:
                own[n] = i
                n += 1
        for level in range(_LEVELS):
            if n == 0:
                break
            for axis in range(3):
                origin[g, axis] = high[axis] = centres[own[0], axis]
            for axis in range(4):
                bounds[g, 0, axis] = bounds[g, 1, axis] = normals[axis, own[0]]
            for i in own[1:n]:
                for axis in range(3):
                    origin[g, axis] = min(origin[g, axis], centres[i, axis])
                    high[axis] = max(high[axis], centres[i, axis])
                for axis in range(4):
                    bounds[g, 0, axis] = min(bounds[g, 0, axis], normals[axis, i])
                    bounds[g, 1, axis] = max(bounds[g, 1, axis], normals[axis, i])
            longest = max(high[0] - origin[g, 0], high[1] - origin[g, 1], high[2] - origin[g, 2])
            resolution = 1.0
            while True:
                cell[g] = longest / resolution if longest > _POINT else 1.0
                finer = 1.0
                for axis in range(3):
                    size[g, axis] = int((high[axis] - origin[g, axis]) / cell[g]) + 1
                    finer *= size[g, axis] * 1.25 + 1
                total = size[g, 0] * size[g, 1] * size[g, 2]
                filled = _count(centres, own[:n], origin[g], cell[g], size[g], cells, counted[:total])
                if 2 * filled >= n or longest <= _POINT or finer > _CELLS_PER_CENTRE * n or resolution * 1.25 > _MOST_CELLS - 1:
                    break
                resolution *= 1.25
            crowd = 0
            if 2 * filled < n and level < _LEVELS - 1:
                crowd = _crowd(centres, own[:n], cells, counted, _SHRINK * longest)
            first[g] = next_cell
            for c in range(total):
                members = counted[c] if crowd == 0 or counted[c] <= _CROWD else 0
                crowded = members < counted[c]
                start[next_cell + c] = next_centre
                counted[c] = -1 if crowded else next_centre
                next_centre += members
            start[next_cell + total] = next_centre
            next_cell += total + 1
            n_left = 0
            for i in own[:n]:
                c = cells[i]
                if counted[c] < 0:
                    own[n_left] = i
                    n_left += 1
                else:
                    order[counted[c]] = i
                    counted[c] += 1
            n = n_left
            g += 1
    return order, first[:g].copy(), start[:next_cell].copy(), origin[:g].copy(), cell[:g].copy(), size[:g].copy(), bounds[:g].copy()


@kernel(fast=False)
def _count(centres, own, origin, cell, size, cells, counted):
    """Cell of each of the centres `own`, and how many lie in each cell; returns the number of occupied cells."""
    counted[:] = 0
    filled = 0
    for i in own:
        x = _cell(centres[i, 0], origin[0], cell, size[0])
        y = _cell(centres[i, 1], origin[1], cell, size[1])
        z = _cell(centres[i, 2], origin[2], cell, size[2])
        c = (z * size[1] + y) * size[0] + x
        cells[i] = c
        filled += counted[c] == 0
        counted[c] += 1
    return filled


@kernel(fast=False)
def _crowd(centres, own, cells, counted, largest):
    """Number of centres in crowded cells; 0 where these extend over more than `largest` (m), as a finer grid would not help."""
    low, high = np.empty(3, np.float32), np.empty(3, np.float32)
    n = 0
    for i in own:
        if counted[cells[i]] > _CROWD:
            for axis in range(3):
                low[axis] = min(low[axis], centres[i, axis]) if n else centres[i, axis]
                high[axis] = max(high[axis], centres[i, axis]) if n else centres[i, axis]
            n += 1
    return n if max(high[0] - low[0], high[1] - low[1], high[2] - low[2]) <= largest else 0


@inlined(fastmath=False)
def _part_of(x, y, z, free):
    largest = max(abs(x), abs(y), abs(z))
    if free > 0:
        return 6
    if abs(x) == largest:
        return 0 if x > 0 else 1
    if abs(y) == largest:
        return 2 if y > 0 else 3
    return 4 if z > 0 else 5


@inlined(fastmath=False)
def _cell(x, origin, cell, size):
    # Clamped as a float: far points would overflow the integer.
    return np.int32(min(max((x - origin) / cell, np.float32(0)), np.float32(size - 1)))


@inlined(fastmath=False)
def _squared(dx, dy, dz, nx, ny, nz, free, mx, my, mz, mfree, threshold, turn, plane):
    d = dx * dx + dy * dy + dz * dz
    cos = nx * mx + ny * my + nz * mz + free + mfree
    d += turn * max(np.float32(0), np.float32(1) - cos)
    if plane is not None:
        h = max(abs(nx * dx + ny * dy + nz * dz), abs(mx * dx + my * dy + mz * dz))
        d += plane * (h * h)
    return d if cos > threshold else _INF


@kernel(fast=False)
def _search(lanes, positions, normals, grid, first_block, last_block, threshold, turn, plane, exact, ids, squared):
    """`nearest` for blocks [first_block, last_block); `ids` and `squared` hold what a lane has before the search.

    `lanes` is LANES, passed so that the compiler keeps the lane loops as loops and makes vector code of them.
    """
    count = len(ids)
    grids = len(grid.cell)
    trial, trial_id = np.empty(lanes, np.float32), np.empty(lanes, np.int32)
    low, high = np.empty(3, np.float32), np.empty(3, np.float32)
    normal_low, normal_high = np.empty(4, np.float32), np.empty(4, np.float32)
    # Per grid: the box [0], [1] of cells visited, the steps it took, and the distance to what lies outside it.
    visited = np.empty((grids, 2, 3), np.int32)
    box = np.empty((2, 3), np.int32)
    steps = np.empty(grids, np.int32)
    reached = np.empty(grids, np.float32)
    for block in range(first_block, last_block):
        base = block * lanes
        px, py, pz = positions[0, base : base + lanes], positions[1, base : base + lanes], positions[2, base : base + lanes]
        for axis in range(3):
            low[axis], high[axis] = _extent(positions[axis, base : base + lanes])
        nx, ny, nz = normals[0, base : base + lanes], normals[1, base : base + lanes], normals[2, base : base + lanes]
        free = normals[3, base : base + lanes]
        for axis in range(4):
            normal_low[axis], normal_high[axis] = _extent(normals[axis, base : base + lanes])
        farthest = squared[count - 1, base : base + lanes]
        _, reach = _extent(farthest)  # no centre with a larger squared distance can enter any lane's list
        for g in range(grids):
            steps[g] = 0
            reached[g] = _distance_to_grid(grid, g, low, high)
            if _largest_cos(normal_low, normal_high, grid.normal_bounds[g]) <= threshold:
                reached[g] = _INF
        while True:
            g = np.int64(0)
            for other in range(1, grids):
                if _urgency(exact, steps[other], reached[other]) < _urgency(exact, steps[g], reached[g]):
                    g = other
            if reached[g] == _INF or (not exact and steps[g] > 1 and reach < _INF):
                break
            if exact and reached[g] * reached[g] * np.float32(_ROUNDING) > reach:
                break
            cell = grid.cell[g]
            _next_box(grid, g, steps[g], low, high, visited[g], box)
            for z in range(box[0, 2], box[1, 2]):
                gap_z = _gap(grid.origin[g, 2], z * cell, (z + 1) * cell, cell, low[2], high[2])
                for y in range(box[0, 1], box[1, 1]):
                    gap_y = _gap(grid.origin[g, 1], y * cell, (y + 1) * cell, cell, low[1], high[1])
                    if gap_y * gap_y + gap_z * gap_z > reach:
                        continue
                    row = grid.first[g] + (z * grid.size[g, 1] + y) * grid.size[g, 0]
                    seen = visited[g, 0, 2] <= z < visited[g, 1, 2] and visited[g, 0, 1] <= y < visited[g, 1, 1]
                    improved = False
                    for part in range(2 if seen else 1):  # left and right of the cells already visited
                        begin = visited[g, 1, 0] if part == 1 else box[0, 0]
                        end = visited[g, 0, 0] if seen and part == 0 else box[1, 0]
                        for c in range(grid.start[row + begin], grid.start[row + end]):
                            cx, cy, cz = grid.positions[0, c], grid.positions[1, c], grid.positions[2, c]
                            better = np.int32(0)
                            mx, my, mz, mfree = grid.normals[0, c], grid.normals[1, c], grid.normals[2, c], grid.normals[3, c]
                            for j in range(lanes):
                                d = _squared(
                                    px[j] - cx, py[j] - cy, pz[j] - cz, nx[j], ny[j], nz[j], free[j], mx, my, mz, mfree,
                                    threshold, turn, plane,
                                )  # fmt: skip
                                trial[j] = d
                                better |= np.int32((d <= farthest[j]) & (d < _INF))
                            if better:
                                improved = True
                                _insert(lanes, trial, trial_id, grid.ids[c], base, ids, squared)
                    if improved:
                        _, reach = _extent(farthest)
            for axis in range(3):
                visited[g, 0, axis], visited[g, 1, axis] = box[0, axis], box[1, axis]
            steps[g] += 1
            reached[g] = _distance_outside(grid, g, low, high, box)


@inlined(fastmath=False)
def _extent(values):
    low = high = values[0]
    for i in range(1, len(values)):
        low = min(low, values[i])
        high = max(high, values[i])
    return low, high


@inlined(fastmath=False)
def _urgency(exact, steps, reached):
    """Grids are grown nearest first; in the neighbourhood mode each first gets its 27 cells (two steps)."""
    return np.float32(-1) if not exact and steps < 2 and reached < _INF else reached


@inlined(fastmath=False)
def _distance_to_grid(grid, g, low, high):
    """Lower bound of the distance between the box [low, high] and the grid's centres."""
    squared = np.float32(0)
    for axis in range(3):
        gap = _gap(grid.origin[g, axis], np.float32(0), grid.size[g, axis] * grid.cell[g], grid.cell[g], low[axis], high[axis])
        squared += gap * gap
    return np.sqrt(squared)


@inlined(fastmath=False)
def _largest_cos(low, high, bounds):
    """Upper bound of the cosine between normals of two boxes of normals."""
    total = np.float32(1e-5)
    for axis in range(3):
        a, b, c, d = low[axis], high[axis], bounds[0, axis], bounds[1, axis]
        total += max(a * c, a * d, b * c, b * d)
    return total + high[3] + bounds[1, 3]


@inlined(fastmath=False)
def _next_box(grid, g, step, low, high, visited, box):
    """The cells under [low, high] at first, then boxes that grow by one cell, later by more."""
    margin = 1 + step // 4
    for axis in range(3):
        if step == 0:
            visited[0, axis] = visited[1, axis] = 0
            box[0, axis] = _cell(low[axis], grid.origin[g, axis], grid.cell[g], grid.size[g, axis])
            box[1, axis] = _cell(high[axis], grid.origin[g, axis], grid.cell[g], grid.size[g, axis]) + 1
        else:
            box[0, axis] = max(visited[0, axis] - margin, 0)
            box[1, axis] = min(visited[1, axis] + margin, grid.size[g, axis])


@inlined(fastmath=False)
def _distance_outside(grid, g, low, high, box):
    """Lower bound of the distance from [low, high] to centres outside the box of cells; infinite where there are none."""
    distance = _INF
    for axis in range(3):
        slack = np.float32(_SLACK) * grid.cell[g]
        # Relative to the grid's origin, where differences of large coordinates lose nothing.
        if box[0, axis] > 0:
            distance = min(distance, (low[axis] - grid.origin[g, axis]) - box[0, axis] * grid.cell[g] - slack)
        if box[1, axis] < grid.size[g, axis]:
            distance = min(distance, box[1, axis] * grid.cell[g] - (high[axis] - grid.origin[g, axis]) - slack)
    return max(distance, np.float32(0)) * np.float32(_ROUNDING)


@inlined(fastmath=False)
def _gap(origin, begin, end, cell, low, high):
    """Lower bound of the distance along an axis between [low, high] and the part [begin, end] (m) of a grid."""
    slack = np.float32(_SLACK) * cell
    return max((low - origin) - end - slack, begin - (high - origin) - slack, np.float32(0)) * np.float32(_ROUNDING)


@inlined(fastmath=False)
def _insert(lanes, trial, trial_id, centre, base, ids, squared):
    """Bubble one centre into every lane's sorted list where it belongs."""
    trial_id[:] = centre
    for slot in range(len(ids)):
        d, i = squared[slot, base : base + lanes], ids[slot, base : base + lanes]
        for j in range(lanes):
            swap = (trial[j] < d[j]) | ((trial[j] == d[j]) & (trial_id[j] < i[j]) & (trial[j] < _INF))
            a, b = d[j], i[j]
            d[j] = trial[j] if swap else a
            i[j] = trial_id[j] if swap else b
            trial[j] = a if swap else trial[j]
            trial_id[j] = b if swap else trial_id[j]
