"""A cache of the light that surfaces send out, found again by a hash of place and normal.

Paths from the visible points probe the scene; every surface that they meet is a probe: one sample of its direct
light, and a link to the surface that one cosine-distributed ray from it meets.  Probes in the same cell of a grid
share what they know (Binder, Fricke & Keller 2018, "Fast Path Space Filtering by Jittered Spatial Hashing"): the
radiosity of a cell is the mean of its probes', bounce after bounce over their links.  Probes and lookups are
displaced at random within the surface by up to half a cell, so that cells overlap smoothly and the light of a
surface as a whole is kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel, leaf
from ..sampling.hashing import uniform
from ..sampling.maps import orthonormal_basis
from ..scene import bounds
from ..surfaces.by_view import VIEWS, at_view, differences
from ..threads import Cancelled, Progress, run_chunks
from .exchange import CHUNK, DEPTH, DIFFUSE_LINK, GLOSSY_LINK, LEVELS, MISSED, Exchange, Probes, Thrown, half_of
from .partition import divided

PROBES_A_CELL = 2  # of the finest cells, on average
GROWTH = 3.0
LATER = np.float32(0.2)  # weight of probes that no visible point has met itself
NEAR = 2.0  # cells: surfaces nearer than this are not looked up but followed on
BRIGHT_PRIOR = 4.0  # probes that a coarser cell counts as where it tells how bright a finer one is
LEAST_SEEN = np.float32(0.2)  # of the mean over all views: what a probe tells that sees less, all but along the surface, would be a spark
FEW_PROBES = 16384  # which tell about the size of the cells
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)
_THIRD = np.float32(1 / 3)


class Links(NamedTuple):
    """How N probes and C cells of a cache hang together, for light whose direction is found later (`thrown`).

    cells: (N, LEVELS) int32, of the probes, from the finest on.  link_cell: (N,) int64, where their links end, negative where nothing is known.
    weight: (N,) float32, of the probes in their cells.  shine: (C, 3 G) float32 W/m^2, of what cells send the lamps' light that lobes reflect;
    shone: (C, 3 G), that and what several lobes have reflected, one after the other;  reflected: (C, 3 G), the other light that they do.
    parent: (C,) int64, the next coarser cell, -1 for none.  order: (C,) int64, the cells, the coarsest first.  unit: (C,) float32, what a probe of each weighs.
    """

    cells: np.ndarray
    link_cell: np.ndarray
    weight: np.ndarray
    shine: np.ndarray
    shone: np.ndarray
    reflected: np.ndarray
    parent: np.ndarray
    order: np.ndarray
    unit: np.ndarray


class LightCache(NamedTuple):
    """Cells of all levels and the hash table that finds them.

    origin: (3,) float32.  size: float32, side of the finest cells (m).
    keys: (T,) uint64, slot: (T,) int32, cell of a key, -1 where the slot is free; T is a power of two.
    radiosity: (B, C, 3 G) float32 W/m^2, in row b the light that left up to b + 1 surfaces, by light groups.
    sent: (C, 3 G) float32 W/m^2, the row that gather rays look up again, the mean of what either half of the paths tells of it.
    lit: (C, 3 G) float32 W/m^2, the part of `sent` that virtual lights carry to where their geometry term is not clamped.  How bright a
        cell is, on which that hangs, is told for each half by the other one: the product has no bias by their noise.
    dull: (C, 3 G) float32, of `sent`, what diffuse light and wide lobes get: all of it, or where photons bring what lobes reflect of the lamps (`caustics`) the rest.
    matte, matte_lit: (C, 3 G) float32 W/m^2, of `dull` and `lit` what diffuse light gets where it follows lobes by the chances `follow` (2 M, `VIEWS`), as of
        `following.lobe_chances`: nothing that those reflect.  lobes: (C, 3 G), what they reflect of all light.
    share: (C,) float32, how much of a virtual light's flux that is.
    tau: float32, mean indirect irradiance of the view (W/m^2, mean of the channels).
    later: float32, by which `share` is less for light that has left several surfaces.
    trust: (C,) float32, by which `share` is less than how bright the cell is would have it: see `trusted`.
    shine: float32, of what lobes that gather rays meet reflect of the lamps the part that photons do not bring, 0 or 1.  chained: float32, the same of
        what several lobes reflect, one after the other.  shone: (C, 3 G) W/m^2, what cells send of either that photons bring; no rows for none.
    chains: (C, 3 G) W/m^2, of `shone` what several lobes have reflected, of surfaces that are not followed: photons do not bring it to wide lobes.
    gain: (C, 3 G) float32 W/m^2, how much more irradiance each cell gets than paths find that go on from it, by what lobes throw on it (`thrown`);
        no rows for nothing.
    centre: (C, 6) float32, middle and normal of the cells.  side: (C,) int32, their sides.
    root: (C,) int64, the coarsest cell around each.
    first: (C, 3 G) float32 W/m^2, of `sent`, what has come straight from lamps but for what narrow lobes reflect: the mean over all views, from which
        one view differs by a side's row of by_view (2 M, `VIEWS`), as of `by_view.views`.
    """

    origin: np.ndarray
    size: np.float32
    keys: np.ndarray
    slot: np.ndarray
    radiosity: np.ndarray
    sent: np.ndarray
    lit: np.ndarray
    dull: np.ndarray
    matte: np.ndarray
    matte_lit: np.ndarray
    lobes: np.ndarray
    share: np.ndarray
    tau: np.float32
    later: np.float32
    trust: np.ndarray
    shine: np.float32
    chained: np.float32
    shone: np.ndarray
    chains: np.ndarray
    gain: np.ndarray
    centre: np.ndarray
    side: np.ndarray
    root: np.ndarray
    first: np.ndarray
    by_view: np.ndarray
    follow: np.ndarray


def no_cache() -> LightCache:
    """A cache that knows nothing."""
    none = np.zeros(0, np.float32)
    return LightCache(
        np.zeros(3, np.float32),
        np.float32(1),
        np.zeros(1, np.uint64),
        np.full(1, -1, np.int32),
        none.reshape(1, 0, 3),
        none.reshape(0, 3),
        none.reshape(0, 3),
        none.reshape(0, 3),
        none.reshape(0, 3),
        none.reshape(0, 3),
        none.reshape(0, 3),
        none,
        np.float32(1),
        np.float32(1),
        none,
        np.float32(1),
        np.float32(1),
        none.reshape(0, 3),
        none.reshape(0, 3),
        none.reshape(0, 3),
        none.reshape(0, 6),
        np.zeros(0, np.int32),
        np.zeros(0, np.int64),
        none.reshape(0, 3),
        np.zeros((0, VIEWS), np.float32),
        np.zeros((0, VIEWS), np.float32),
    )


@inlined
def _floor(x):
    """Without a call: Numba's own is one."""
    whole = np.int64(x)
    return whole - (x < np.float32(whole))


@inlined
def _key(origin, size, level, x, y, z, nx, ny, nz, side):
    """The cell of a place on a side of a material, with a normal, at a level: one integer."""
    mask = np.int64(0x1FFFF)
    edge = size
    for _ in range(level):
        edge *= np.float32(GROWTH)
    ix, iy, iz = _floor((x - origin[0]) / edge) & mask, _floor((y - origin[1]) / edge) & mask, _floor((z - origin[2]) / edge) & mask
    # Rounded halves: normals along the axes, the most common ones, lie in the middle of their bins.
    ax = np.int64(nx * np.float32(2.0) + np.float32(2.5))
    ay = np.int64(ny * np.float32(2.0) + np.float32(2.5))
    az = np.int64(nz * np.float32(2.0) + np.float32(2.5))
    place = np.uint64(((((ix << 17 | iy) << 17 | iz) << 8) + (ax * 25 + ay * 5 + az)) << 2 | np.int64(level))
    return place ^ (np.uint64(side) * np.uint64(0xD1B54A32D192ED03))


@inlined
def _home(key, n):
    """The slot where the search for a key begins, of n."""
    mixed = (key ^ (key >> np.uint64(32))) * np.uint64(0x9E3779B97F4A7C15)
    return np.int64((mixed >> np.uint64(29)) & np.uint64(n - 1))


@leaf
def _find(keys, slot, key):
    """Cell of a key, -1 where there is none."""
    at = _home(key, len(keys))
    while slot[at] >= 0:
        if keys[at] == key:
            return np.int64(slot[at])
        at = (at + 1) & (len(keys) - 1)
    return np.int64(-1)


@inlined
def _displaced(size, level, x, y, z, nx, ny, nz, u1, u2):
    """The place moved within its tangent plane by up to half a cell of a level along either axis."""
    tx, ty, tz, bx, by, bz = orthonormal_basis(nx, ny, nz)
    side = size
    for _ in range(level):
        side *= np.float32(GROWTH)
    a, b = (u1 - _HALF) * side, (u2 - _HALF) * side
    return x + a * tx + b * bx, y + a * ty + b * by, z + a * tz + b * bz


@leaf
def find_cell(cache, x, y, z, nx, ny, nz, side, u1, u2):
    """The finest cell that knows the surface at a place with geometric normal n, -1 where none does.

    side: as `surface_side` has it.  u1, u2: uniform in [0, 1), the displacement.
    """
    for level in range(LEVELS):
        px, py, pz = _displaced(cache.size, level, x, y, z, nx, ny, nz, u1, u2)
        cell = _find(cache.keys, cache.slot, _key(cache.origin, cache.size, level, px, py, pz, nx, ny, nz, side))
        if cell >= 0:
            return cell
    return np.int64(-1)


@inlined
def more_by_view(cache, cell, cosine):
    """How much more of its `first` light a cell shows a view at a cosine than in the mean."""
    return at_view(cache.by_view, cache.side[cell], cosine)


@leaf
def add_known(cache, row, cell, cosine, wr, wg, wb, out, i):
    """Adds the light of a cell that left up to `row` + 1 surfaces towards a view at `cosine`, weighed by w, to row i of `out` (N, 3 G)."""
    more = more_by_view(cache, cell, cosine)
    for c in range(0, out.shape[1], 3):
        out[i, c] += wr * (cache.radiosity[row, cell, c] + more * cache.first[cell, c])
        out[i, c + 1] += wg * (cache.radiosity[row, cell, c + 1] + more * cache.first[cell, c + 1])
        out[i, c + 2] += wb * (cache.radiosity[row, cell, c + 2] + more * cache.first[cell, c + 2])


@leaf
def take_known(light, cell, wr, wg, wb, out, i):
    """Takes from row i of `out` (N, 3 G), weighed by w, what a part `light` (C, 3 G) of what cells send is in one of them."""
    for c in range(0, out.shape[1], 3):
        out[i, c] -= wr * light[cell, c]
        out[i, c + 1] -= wg * light[cell, c + 1]
        out[i, c + 2] -= wb * light[cell, c + 2]


@kernel
def _insert(probes, origin, size, seed, keys, slot, cells, level_of, centre, side_of):
    """Hash all probes at all levels: `cells` (N, LEVELS) int32; the number of cells, or -1 where the table is too small.

    level_of (C,) uint8, centre (C, 6) float32, side_of (C,) int32: level, middle and normal, side of each new cell.
    """
    n = 0
    for p in range(len(probes.valid)):
        if not probes.valid[p]:
            continue
        nx, ny, nz = probes.normal[p, 0], probes.normal[p, 1], probes.normal[p, 2]
        u1, u2 = uniform(seed, p, 0, 0), uniform(seed, p, 0, 1)
        for level in range(LEVELS):
            x, y, z = _displaced(size, level, probes.position[p, 0], probes.position[p, 1], probes.position[p, 2], nx, ny, nz, u1, u2)
            key = _key(origin, size, level, x, y, z, nx, ny, nz, probes.side[p])
            at = _home(key, len(keys))
            while slot[at] >= 0 and keys[at] != key:
                at = (at + 1) & (len(keys) - 1)
            if slot[at] < 0:
                if n >= len(level_of) or 2 * n >= len(keys):
                    return -1
                keys[at], slot[at] = key, n
                level_of[n] = level
                centre[n, 0], centre[n, 1], centre[n, 2] = x, y, z
                centre[n, 3], centre[n, 4], centre[n, 5] = nx, ny, nz
                side_of[n] = probes.side[p]
                n += 1
            cells[p, level] = slot[at]
    return n


@kernel
def _count_cells(probes, origin, size, seed, keys, slot):
    """Number of the finest cells that the probes would fill at a size."""
    n = 0
    for p in range(len(probes.valid)):
        if not probes.valid[p]:
            continue
        nx, ny, nz = probes.normal[p, 0], probes.normal[p, 1], probes.normal[p, 2]
        x, y, z = _displaced(
            size, 0, probes.position[p, 0], probes.position[p, 1], probes.position[p, 2], nx, ny, nz,
            uniform(seed, p, 0, 0), uniform(seed, p, 0, 1),
        )  # fmt: skip
        key = _key(origin, size, 0, x, y, z, nx, ny, nz, probes.side[p])
        at = _home(key, len(keys))
        while slot[at] >= 0 and keys[at] != key:
            at = (at + 1) & (len(keys) - 1)
        if slot[at] < 0:
            keys[at], slot[at] = key, 0
            n += 1
    return n


@kernel
def _links(probes, cache, begin, end, seed, link_cell):
    """Cell of the links of the probes begin..end-1: -1 none known, -2 the ray met nothing."""
    for p in range(begin, end):
        link_cell[p] = -2
        if not probes.valid[p] or probes.link[p] == MISSED:
            continue
        link_cell[p] = find_cell(
            cache, probes.link_position[p, 0], probes.link_position[p, 1], probes.link_position[p, 2],
            probes.link_normal[p, 0], probes.link_normal[p, 1], probes.link_normal[p, 2], probes.link_side[p],
            uniform(seed, p, 1, 0), uniform(seed, p, 1, 1),
        )  # fmt: skip


@leaf
def _carried(carry, i, radiosity, row, cell):
    """What link i carries of a cell's light, sum of the channels of all light groups."""
    total = _0
    for c in range(0, radiosity.shape[2], 3):
        for k in range(3):
            total += carry[i, k] * radiosity[row, cell, c + k]
    return total


@kernel
def _brightness(probes, half, cells, link_cell, parent, level_of, prior, radiosity, bright, number):
    """Mean of the channels of the radiosity (C,) of all cells, by the own samples of the probes of one half (N,) of the paths."""
    for p in range(len(probes.valid)):
        if not probes.valid[p] or not half[p] or link_cell[p] == -1:
            continue
        light = _0
        for k in range(probes.direct.shape[1]):
            light += probes.direct[p, k]
        row = len(radiosity) - (2 if probes.link[p] == DIFFUSE_LINK else 1)
        if link_cell[p] >= 0 and row >= 0:
            light += _carried(probes.carry, p, radiosity, row, link_cell[p])
        for level in range(LEVELS):
            bright[cells[p, level]] += light * _THIRD
            number[cells[p, level]] += _1
    for level in range(LEVELS - 1, -1, -1):
        for c in range(len(parent)):
            if level_of[c] == level:
                up = parent[c]
                weight = prior if up >= 0 else _0
                bright[c] = (bright[c] + (weight * bright[up] if up >= 0 else _0)) / max(number[c] + weight, np.float32(1e-6))


def cell_size(probes: Probes, origin: np.ndarray, extent: float, seed: int) -> float:
    """The side of the finest cells (m) at which they hold `PROBES_A_CELL` probes on average."""
    smallest = extent / 40000.0  # the key's bits
    size = 0.02 * extent
    if len(probes.valid) > FEW_PROBES:  # a few of them tell nearly as much: cells go about with the square of the size
        step = -(-len(probes.valid) // FEW_PROBES) | 1  # odd: first and second probes of paths
        some = Probes(*(np.ascontiguousarray(rows[::step]) for rows in probes))
        size = _size_for(some, origin, size * step**0.5, smallest, extent, seed) / step**0.5
    return max(_size_for(probes, origin, size, smallest, extent, seed), smallest)


def _size_for(probes: Probes, origin: np.ndarray, size: float, low: float, high: float, seed: int) -> float:
    """`cell_size` between low and high, by a search that begins at `size`."""
    n = int(probes.valid.sum())
    bits = max(10, int(np.ceil(np.log2(2 * max(n, 1) + 2))))
    keys = np.empty(1 << bits, np.uint64)
    wanted = max(1.0, n / PROBES_A_CELL)
    for _ in range(6):
        count = _count_cells(probes, origin, np.float32(size), np.uint32(seed), keys, np.full(1 << bits, -1, np.int32))
        if 0.8 < count / wanted < 1.25:
            break
        low, high = (low, size) if count < wanted else (size, high)
        size = float(np.clip(size * np.sqrt(count / wanted), low, high))
    return size


@kernel
def _mark_unknown(probes, origin, size, keys, used, unknown):
    """Marks the rows of `unknown` (N,) whose links end where no probe lies in the same coarsest cell; keys, used: (T,) an empty hash table."""
    for turn in range(2):
        for p in range(len(probes.valid)):
            if not probes.valid[p] or (turn == 1 and probes.link[p] == MISSED):
                continue
            at_link = turn == 1
            position = probes.link_position if at_link else probes.position
            normal = probes.link_normal if at_link else probes.normal
            key = _key(
                origin, size, LEVELS - 1, position[p, 0], position[p, 1], position[p, 2], normal[p, 0], normal[p, 1], normal[p, 2],
                probes.link_side[p] if at_link else probes.side[p],
            )  # fmt: skip
            at = _home(key, len(keys))
            while used[at] and keys[at] != key:
                at = (at + 1) & (len(keys) - 1)
            if at_link:
                unknown[p] = not used[at]
            else:
                keys[at], used[at] = key, True


def unknown_paths(probes: Probes) -> np.ndarray:
    """Which paths (P,) meet a surface last around which no probe lies, not even in the coarsest of the cells that there would be."""
    n = int((probes.valid > 0).sum())
    if n == 0:
        return np.zeros(0, np.int64)
    origin, extent = _grid(probes)
    size = np.float32(cell_size(probes, origin, extent, 0))
    slots = 1 << max(10, int(np.ceil(np.log2(2 * n + 2))))
    unknown = np.zeros(len(probes.valid), np.bool_)
    _mark_unknown(probes, origin, size, np.empty(slots, np.uint64), np.zeros(slots, np.bool_), unknown)
    return np.unique(np.flatnonzero(unknown) // DEPTH)


def _grid(probes: Probes) -> tuple[np.ndarray, float]:
    """Origin (3,) float32 of the cells of some probes, and the extent of what they tell of (m)."""
    known = probes.position[probes.valid > 0] if probes.valid.any() else np.zeros((1, 3), np.float32)
    low, high = bounds(known)
    extent = float(max((high - low).max(), 1e-6 * np.abs(known).max(), 1e-9))
    return (low - extent).astype(np.float32), extent


def build_light_cache(
    probes: Probes, bounces: int, seed: int, threads: int = 0, progress: Progress | None = None, **settings
) -> tuple[LightCache, Links]:
    """Cells that hold what the probes know of light that left 1 to `bounces` surfaces, and how they hang together; arguments as of `CacheBuilder`."""
    return CacheBuilder(probes, bounces, seed, threads, progress, **settings).solve(progress)


class CacheBuilder:
    """Cells around probes, for light that left 1 to `bounces` surfaces: `solve` finds it.

    gathered: how many of them the light has left that gather rays look up, None for `bounces`.
    later: what virtual lights carry of light that has left several surfaces, as a part of what they carry of other light.
    relied: the part of what would be left to the cache that virtual lights carry all the same, as far as their geometry term is not clamped.
    by_view: (2 M, `VIEWS`) of the materials' sides, None where all views are alike.  probed_by_view: the part of it that the probes' light has, None for all.
    follow: (2 M, `VIEWS`), chances that gather rays follow lobes, None for none.  mirrors: (M,) bool, those whose lobes gather rays follow; None for none.

    Raises:
        core.threads.Cancelled: `progress` returned False.
    """

    def __init__(
        self,
        probes: Probes,
        bounces: int,
        seed: int,
        threads: int = 0,
        progress: Progress | None = None,
        *,
        gathered: int | None = None,
        later: float = 1.0,
        relied: float = 0.0,
        by_view: np.ndarray | None = None,
        probed_by_view: np.ndarray | None = None,
        follow: np.ndarray | None = None,
        mirrors: np.ndarray | None = None,
    ):
        n = int(probes.valid.sum())
        if by_view is None:
            by_view = np.zeros((1 + int(probes.side.max(initial=0)), VIEWS), np.float32)
        follow = np.zeros_like(by_view) if follow is None else follow
        self.probes = probes = _of_all_views(probes, by_view if probed_by_view is None else probed_by_view)
        self.seed, self.threads = seed, threads
        self.bounces, self.row = bounces, (bounces if gathered is None else gathered) - 1
        self.relied = np.float32(relied)
        self.later = np.float32(later + relied * (1 - later))
        origin, extent = _grid(probes)
        size = np.float32(cell_size(probes, origin, extent, seed))
        go_on(progress, 0.1)
        cells = np.zeros((len(probes.valid), LEVELS), np.int32)
        # Rarely more cells than probes; a table that is no larger than it must be stays in the processor's caches.
        room, count = max(64, n), -1
        while count < 0:
            bits = max(10, int(np.ceil(np.log2(2 * room + 2))))
            keys, slot = np.zeros(1 << bits, np.uint64), np.full(1 << bits, -1, np.int32)
            level_of, centre, side_of = np.empty(room, np.uint8), np.empty((room, 6), np.float32), np.empty(room, np.int32)
            count = _insert(probes, origin, size, np.uint32(seed), keys, slot, cells, level_of, centre, side_of)
            room *= 2
        go_on(progress, 0.3)
        self.level_of, centre, side_of = level_of[:count].copy(), centre[:count].copy(), side_of[:count].copy()
        self.cells = cells
        dark, one = np.zeros((bounces, count, probes.direct.shape[1]), np.float32), np.float32(1)
        self.empty = LightCache(
            origin, size, keys, slot, dark, *(dark[0] for _ in range(6)), np.zeros(count, np.float32), one, self.later,
            np.ones(count, np.float32), one, one, dark[0, :0], dark[0, :0], dark[0, :0], centre, side_of, np.arange(count), dark[0], by_view, follow,
        )  # fmt: skip
        self.parent = _parents(self.empty, self.level_of, centre, side_of)
        root = np.arange(count)
        for _ in range(LEVELS - 1):
            root = np.where(self.parent[root] >= 0, self.parent[root], root)
        self.empty = self.empty._replace(root=root)
        self.link_cell = np.empty(len(probes.valid), np.int64)
        run_chunks(
            lambda begin, end: _links(probes, self.empty, begin, end, np.uint32(seed), self.link_cell), len(self.link_cell), CHUNK, threads
        )
        self.weight = _weights(probes, NEAR * size)
        looked = (probes.distance > NEAR * size) & _met(probes, mirrors)
        self.shared: tuple[np.float32, np.ndarray] | None = None  # tau, and how bright cells are, by which light was divided first
        go_on(progress, 0.4)
        self.exchange = Exchange(
            probes, cells, self.link_cell, look_up(self.empty, probes.position, probes.normal, probes.side, seed + 3, threads), self.parent, root,
            self.level_of, self.weight, looked, threads,
        )  # fmt: skip
        go_on(progress, 0.5)

    def solve(self, progress: Progress | None = None, thrown: Thrown | None = None) -> tuple[LightCache, Links]:
        """The cache, and how its cells hang together; a second time with what is `thrown`, divided between lights and rays as the first time."""
        probes, empty, parent = self.probes, self.empty, self.parent
        exchange = self.exchange
        radiosity, halves, shine, first_of, beneath, through, shone = exchange.solve(
            self.bounces, self.row, thrown, lambda done: go_on(progress, 0.5 + 0.5 * done)
        )
        cache = empty._replace(radiosity=radiosity)
        if self.shared is None:
            tau = np.float32(max(seen_light(cache, probes, self.seed + 1, self.threads), 1e-30))
            half, bright = half_of(np.arange(len(probes.valid))), np.zeros((2, len(parent)), np.float32)
            for h in range(2):
                _brightness(
                    probes, half != h, self.cells, self.link_cell, parent, self.level_of, np.float32(BRIGHT_PRIOR), radiosity, bright[h],
                    np.zeros(len(parent), np.float32),
                )  # fmt: skip
            self.shared = tau, bright
        tau, bright = self.shared
        number = exchange.number_of.sum(axis=0)
        counts = exchange.number_of / np.maximum(number, np.float32(1e-6))
        sent, lit, shine, reflected, share = divided(
            halves, shine, first_of, beneath, through, counts, bright, number, tau, parent, self.later, self.relied
        )
        first = np.maximum(0, np.einsum("hc,hck->ck", counts, first_of) - shine)
        links = Links(self.cells, self.link_cell, self.weight, shine, shone, reflected, parent, exchange.order, exchange.unit)
        return cache._replace(
            sent=sent, lit=lit, dull=sent, matte=sent, matte_lit=lit, lobes=0 * sent, share=share, tau=tau, first=first
        ), links


def go_on(progress: Progress | None, done: float) -> None:
    """Raises `Cancelled` where `progress` says so."""
    if progress is not None and not progress(done):
        raise Cancelled


def _of_all_views(probes: Probes, by_view: np.ndarray) -> Probes:
    """The probes with direct light that is the mean over all views, not what their own path sees: but for that which lobes reflect."""
    if not by_view.any():
        return probes
    seen = np.maximum(LEAST_SEEN, _1 + differences(by_view, probes.side, probes.cosine))[:, None]
    direct = probes.shine + (probes.direct - probes.shine) / seen
    return probes._replace(direct=direct, beneath=probes.beneath / seen, glass=probes.glass / seen)


def _weights(probes: Probes, near: np.float32) -> np.ndarray:
    """Of the probes in their cells, (N,) float32: as far as no visible point has met them from afar, they tell of other places than those looked up."""
    first = np.arange(len(probes.valid)) % DEPTH == 0
    return (probes.valid > 0) * np.where(first & (probes.distance > near), _1, LATER)


def _met(probes: Probes, mirrors: np.ndarray | None) -> np.ndarray:
    """Which probes (N,) a visible point has met itself, or by way of one of the materials `mirrors` (M,)."""
    met = np.arange(len(probes.valid)) % DEPTH == 0
    if mirrors is not None:
        met[np.flatnonzero(met & mirrors[probes.side >> 1] & (probes.link == GLOSSY_LINK)) + 1] = True
    return met


@kernel
def _parents(cache, level_of, centre, side_of):
    """The next coarser cell around each cell, -1 where there is none."""
    parent = np.full(len(level_of), -1, np.int64)
    for c in range(len(level_of)):
        if level_of[c] + 1 < LEVELS:
            x, y, z, nx, ny, nz = centre[c, 0], centre[c, 1], centre[c, 2], centre[c, 3], centre[c, 4], centre[c, 5]
            parent[c] = _find(
                cache.keys, cache.slot, _key(cache.origin, cache.size, np.int64(level_of[c]) + 1, x, y, z, nx, ny, nz, side_of[c])
            )
    return parent


@kernel
def _look_up(cache, position, normal, side, begin, end, seed, cell):
    for i in range(begin, end):
        cell[i] = find_cell(
            cache, position[i, 0], position[i, 1], position[i, 2], normal[i, 0], normal[i, 1], normal[i, 2], side[i],
            uniform(seed, i, 2, 0), uniform(seed, i, 2, 1),
        )  # fmt: skip


def look_up(cache: LightCache, position: np.ndarray, normal: np.ndarray, side: np.ndarray, seed: int, threads: int = 0) -> np.ndarray:
    """Cells (N,) int64 of places (N, 3) with geometric normals (N, 3) and sides (N,), -1 where none knows them."""
    cell = np.empty(len(position), np.int64)
    run_chunks(lambda begin, end: _look_up(cache, position, normal, side, begin, end, np.uint32(seed), cell), len(position), CHUNK, threads)
    return cell


def seen_light(cache: LightCache, probes: Probes, seed: int, threads: int = 0) -> float:
    """Mean indirect irradiance of the view (W/m^2, mean of the channels): what the first probe of each path sends back."""
    first = slice(0, None, DEPTH)
    cell = look_up(cache, probes.position[first], probes.normal[first], probes.side[first], seed, threads)
    found = (probes.valid[first] > 0) & (cell >= 0)
    return float(np.where(found, _THIRD * cache.radiosity[-1].sum(axis=1)[np.maximum(cell, 0)] if len(cache.share) else 0.0, 0.0).mean())
