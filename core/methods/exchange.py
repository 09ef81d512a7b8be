"""The light that the cells of a cache send each other along the links of their probes, bounce after bounce."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..threads import run_chunks

DEPTH = 2  # probes a path: seen from the visible points, and from there
LEVELS = 4  # cells of 1, 3, 9 and 27 sizes: the coarser ones answer where the finer ones know little
PRIOR = 0.25  # a coarser cell counts as at most this many probes of the finer one: it may lie across the edge of a shadow
BALANCE = 50.0  # probes of mean brightness that the balance of the whole view counts for in each place
MOST_BALANCE = 1.5
MOST_TURNS = 8  # of glossy reflections in the cache
CHUNK = 16384  # probes a chunk
MISSED, DIFFUSE_LINK, GLOSSY_LINK, TRANSLUCENT_LINK = 0, 1, 2, 3
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)
_THIRD = np.float32(1 / 3)
_LEAST = np.float32(1e-6)


class Probes(NamedTuple):
    """N surfaces that paths met.

    position, normal: (N, 3) float32, the geometric normal on the side that was met.
    direct: (N, 3 G) float32, pi times the radiance towards the path by direct light, one sample (W/m^2), by light groups.
    shine: (N, 3 G) float32, the part of it that a glossy lobe has reflected, spread as by a diffuse one.
    beneath: (N, 3 G) float32, the part of it that comes from below the facet of a smooth surface, or nearly along it: no particle has it.
    glass: (N, 3 G) float32, the part of it that came by way of glass.
    carry: (N, 3) float32, the same for each unit that the linked surface sends.
    albedo: (N, 3) float32, what it reflects of any irradiance by its diffuse lobe.  error: (N,) float32, rounding error of the position (m).
    link_position, link_normal: (N, 3) float32.  link: (N,) uint8: 0 the ray met nothing, else a surface: 1 by a diffuse
    reflection, 2 by a glossy one, 3 through a translucent surface.  side, link_side: (N,) int32, as `surface_side` has them.
    distance: (N,) float32, from where the path came (m).  cosine: (N,) float32, of the way there with the normal.  valid: (N,) uint8, whether the path came so far.
    """

    position: np.ndarray
    normal: np.ndarray
    direct: np.ndarray
    shine: np.ndarray
    beneath: np.ndarray
    glass: np.ndarray
    carry: np.ndarray
    albedo: np.ndarray
    link_position: np.ndarray
    link_normal: np.ndarray
    link: np.ndarray
    side: np.ndarray
    link_side: np.ndarray
    distance: np.ndarray
    cosine: np.ndarray
    error: np.ndarray
    valid: np.ndarray

    @staticmethod
    def concatenate(parts: list[Probes]) -> Probes:
        """All probes of the parts, one after the other."""
        return Probes(*(np.concatenate(columns) for columns in zip(*parts)))

    @staticmethod
    def allocate(n: int, light_groups: int = 1) -> Probes:
        """Room for n probes, none of them valid."""
        rows = [np.zeros((n, columns), np.float32) for columns in (3, 3, *[3 * light_groups] * 4, 3, 3, 3, 3)]
        sides, lengths = ([np.zeros(n, kind) for _ in range(number)] for kind, number in ((np.int32, 2), (np.float32, 3)))
        return Probes(*rows, np.zeros(n, np.uint8), *sides, *lengths, np.zeros(n, np.uint8))


class Thrown(NamedTuple):
    """What lobes throw on surfaces of the lamps' light, in place of what links tell of it, which do not know where to lobes reflect it.

    irradiance: (C, 3 G) float32 W/m^2, of the cells.  part: (N,) float32, of the light of lobes that the probes' links bring, the part in whose
    place it stands.  chains: whether it is that of several lobes, too.
    """

    irradiance: np.ndarray
    part: np.ndarray
    chains: bool


class Exchanged(NamedTuple):
    """What C cells send after B bounces, in W/m^2, by G light groups.

    radiosity: (B, C, 3 G) float32.  halves: (2, C, 3 G), the row that gather rays look up, as half of the paths tells it;  of it, shine:
    (2, C, 3 G), what came from lamps and was reflected by a glossy lobe, first_of: all that came straight from lamps, beneath: of that, what came
    from below facets, through: what glossy links have brought.  shone: (C, 3 G), what one lobe after another reflects of the lamps.
    """

    radiosity: np.ndarray
    halves: np.ndarray
    shine: np.ndarray
    first_of: np.ndarray
    beneath: np.ndarray
    through: np.ndarray
    shone: np.ndarray


class Exchange:
    """What the probes of C cells tell, which is found once, and what the cells send each other: `solve`, with and without what is thrown.

    cells: (N, LEVELS) int32, of the probes.  link_cell: (N,) int64, where their links end: -1 none known, -2 they met nothing.  seen_cell: (N,), the cell that a lookup
    at each probe finds.  parent, root: (C,) int64, the next coarser cell (-1 for none) and the coarsest.  level_of: (C,) uint8.  weight: (N,) float32, of the probes.
    looked: (N,) bool, those where light is looked up.

    number_of: (2, C) float32, the weight of the probes of each cell, of either half of the paths.  order: (C,) int64, the cells, the coarsest first.
    unit: (C,) float32, what a probe of each weighs.
    """

    def __init__(
        self, probes: Probes, cells: np.ndarray, link_cell: np.ndarray, seen_cell: np.ndarray, parent: np.ndarray, root: np.ndarray,
        level_of: np.ndarray, weight: np.ndarray, looked: np.ndarray, threads: int,
    ):  # fmt: skip
        self.probes, self.threads, self.parent, self.root = probes, threads, parent, root
        self.turns = turns_to_settle(probes)
        self.order = np.argsort((LEVELS - level_of).astype(np.uint8), kind="stable")
        self.knows = knows = np.flatnonzero(probes.valid > 0)
        self.half = half_of(knows)
        self.weight = weight = weight[knows].astype(np.float32)
        self.places = np.ascontiguousarray(cells[knows].T)
        self.trust = BALANCE / max(1, len(probes.valid) // DEPTH)
        self._tell(probes, weight * (link_cell[knows] != -1))
        self._link(probes, link_cell, seen_cell, looked)

    def _tell(self, probes: Probes, linked: np.ndarray) -> None:
        """Direct light and its parts, means over the probes of each cell and of either half of the paths."""
        width = probes.direct.shape[1]
        known = [of.any() for of in (probes.shine, probes.beneath, probes.glass)]
        parts = [probes.direct, *(of for of, is_known in zip((probes.shine, probes.beneath, probes.glass), known, strict=True) if is_known)]
        columns = np.empty((len(self.knows), 4 + width * len(parts)), np.float32)

        def weigh(begin: int, end: int) -> None:
            _weigh_numbers(probes.direct, self.knows, self.weight, linked, begin, end, columns)
            for k, part in enumerate(parts):
                _weigh(part, self.knows, self.weight, begin, end, 4 + k * width, columns)

        run_chunks(weigh, len(self.knows), CHUNK, self.threads)
        sums = self._sums_of_halves(self.places, self.half, columns)
        self.number_of, linked_of = np.ascontiguousarray(sums[:, :, 0]), np.ascontiguousarray(sums[:, :, 1])
        number, squares = self.number_of.sum(axis=0), sums[0, :, 2:4] + sums[1, :, 2:4]
        self.unit = np.divide(squares[:, 1], number, out=np.ones_like(number), where=number > 0)
        told = [np.ascontiguousarray(sums[:, :, begin : begin + width]) for begin in range(4, columns.shape[1], width)]
        direct, glass = told[0].sum(axis=0), told[-1].sum(axis=0)
        likeness = _likeness(self.parent, number, squares, direct)
        flat = np.full_like(likeness, PRIOR)

        def share(of: np.ndarray, likeness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return _shares(of, self.unit, self.parent, likeness)

        # Half of the probes know half as much, of what is around them, too.
        self.all, self.each = share(number, likeness), [share(of, _HALF * likeness) for of in self.number_of]
        self.linked, self.linked_each = share(linked_of.sum(axis=0), flat), [share(of, _HALF * flat) for of in linked_of]
        self.direct = self.soonest = self._filled(direct, self.all)
        for part in told:
            for h in range(2):
                self._filled(part[h], self.each[h])
        self.direct_of, *others = told
        self.shine, self.beneath = (others.pop(0) if is_known else np.zeros_like(self.direct_of) for is_known in known[:2])
        # Glass is a surface to Cycles, where the last bounce ends: what came by way of it takes one bounce more.
        self.clear = np.ones_like(self.direct_of)
        if known[2]:
            self.soonest = np.maximum(self.direct - self._filled(glass, self.all), _0)
            np.divide(np.maximum(self.direct_of - others.pop(0), _0), self.direct_of, out=self.clear, where=self.direct_of > 0)
        # Of all that cells send, what lobes reflect of the lamps' light: one of them, or by glossy links several.
        self.one = np.einsum("hc,hck->ck", self.number_of / np.maximum(number, _LEAST), self.shine)

    def _link(self, probes: Probes, link_cell: np.ndarray, seen_cell: np.ndarray, looked: np.ndarray) -> None:
        """The links that bring light: those that take a bounce (`fixed` of them), then glossy ones (up to `glossy`), then others that take none."""
        knows, weight, kinds = self.knows, self.weight, probes.link[self.knows]
        sends = np.flatnonzero(link_cell[knows] >= 0)
        sends = sends[np.argsort(kinds[sends], kind="stable")]
        self.sends, self.link = sends, link_cell[knows[sends]].astype(np.int32)
        self.fixed, self.glossy = np.searchsorted(kinds[sends], (GLOSSY_LINK, TRANSLUCENT_LINK))
        self.carry = np.empty((len(sends), 3), np.float32)
        _weigh(probes.carry, knows[sends], weight[sends], 0, len(sends), 0, self.carry)
        self.send_places, self.send_half = np.ascontiguousarray(self.places[:, sends]), self.half[sends]
        # Cells send as much as is found by lookups at the probes: of those that are looked up, what they send, by the coarsest cell of what a lookup finds.
        here = np.flatnonzero(looked[knows] & (link_cell[knows] != -1) & (seen_cell[knows] >= 0))
        seen = seen_cell[knows[here]]
        self.here, self.seen_root = here, self.root[seen]
        self.lookups = np.bincount(seen, minlength=len(self.root)).astype(np.float32)
        self.sent = probes.direct[knows[here]].sum(axis=1)
        self.sent_soonest = self.sent - probes.glass[knows[here]].sum(axis=1) if probes.glass.any() else self.sent
        root_of = np.full(len(knows), -1, np.int64)
        root_of[here] = self.seen_root
        self.send_root, self.send_weight = root_of[sends], weight[sends]

    def _gained(self, thrown: Thrown) -> tuple[np.ndarray, np.ndarray]:
        """What the probes that know (K, 3 G) reflect of what is thrown on them, and its means (2, C, 3 G) over cells and halves."""
        gained = np.empty((len(self.knows), self.direct.shape[1]), np.float32)

        def gain(begin: int, end: int) -> None:
            _gain(self.probes.albedo, self.knows, thrown.irradiance, self.places[0], begin, end, gained)

        run_chunks(gain, len(gained), CHUNK, self.threads)
        weighed = self._sums_of_halves(self.places, self.half, self.weight[:, None] * gained)
        return gained, weighed

    def solve(self, bounces: int, row: int, thrown: Thrown | None, go_on: Callable[[float], None]) -> Exchanged:
        """The light after each of the bounces.

        row: which of them gather rays look up, -1 for none.  thrown: what lobes throw on surfaces, if that is known.  go_on: told the done fraction.
        """
        fixed, shone, later, sent = self.fixed, self.one, self.direct, self.sent
        several, known, gained_of = bool(self.one.any() and self.glossy > fixed), np.zeros(0, np.float32), _0
        if thrown is None:
            for _ in range(self.turns * several):
                shone = self._reflected(shone)
        else:
            several = several and thrown.chains
            known = thrown.part[self.knows[self.sends[:fixed]]]
            gained, gained_of = self._gained(thrown)
            later = self.direct + self._filled(gained_of.sum(axis=0), self.all)
            for h in range(2):
                self._filled(gained_of[h], self.each[h])
            sent = sent + gained[self.here].sum(axis=1)
        radiosity, carried = (
            np.zeros((bounces, *self.direct.shape), np.float32),
            np.zeros((len(self.link), self.direct.shape[1]), np.float32),
        )
        scale, found = np.ones(len(self.parent), np.float32), [np.zeros_like(self.direct_of)] * 5
        for bounce in range(bounces):
            light = radiosity[bounce]
            before, to_find = np.zeros_like(light), np.bincount(self.seen_root, sent if bounce else self.sent_soonest, len(self.parent))
            if bounce:
                self._send(0, fixed, radiosity[bounce - 1], known, shone, carried)
                self._bring(0, fixed, carried, before, to_find)
                light[:] = radiosity[bounce - 1]
            # Glossy and translucent links take no bounce: what they carry is found turn by turn.
            for turn in range(self.turns):
                go_on((bounce + turn / self.turns) / bounces)
                total, wanted = before.copy(), to_find.copy()
                self._send(fixed, len(carried), light, known[:0], shone, carried)
                self._bring(fixed, len(carried), carried, total, wanted)
                np.add(later if bounce else self.soonest, self._filled(total, self.linked), out=light)
                _balance(wanted, self.lookups, np.float32(self.trust), self.root, light, scale)
                if thrown is not None:  # as it goes into the cells' own light, turn by turn: a tenth would be left otherwise
                    shone = self._reflected(shone) if several else self.one.copy()
                    _scale(shone, scale)
            if bounce == row:
                found = self._divide(carried, scale, bounce, gained_of)
        return Exchanged(radiosity, *found, shone)

    def _divide(self, carried: np.ndarray, scale: np.ndarray, bounce: int, gained_of: np.ndarray) -> tuple[np.ndarray, ...]:
        """`halves`, `shine`, `first_of`, `beneath` and `through` of a bounce whose links have `carried` (L, 3 G) light."""
        some, clear = slice(self.fixed, self.glossy), _1 if bounce else self.clear
        halves = self._sums_of_halves(self.send_places, self.send_half, carried)
        through = self._sums_of_halves(np.ascontiguousarray(self.send_places[:, some]), self.send_half[some], carried[some])
        for h in range(2):
            self._filled(halves[h], self.linked_each[h])
            self._filled(through[h], self.linked_each[h])
        first_of = self.direct_of * clear
        halves += first_of
        if bounce:
            halves += gained_of
        parts = halves, self.shine * clear, first_of, self.beneath * clear, through
        for part in parts:
            for half in part:
                _scale(half, scale)
        return parts

    def _send(self, begin: int, end: int, light: np.ndarray, known: np.ndarray, shone: np.ndarray, carried: np.ndarray) -> None:
        """What the links begin..end-1 carry of `light` (C, 3 G), into `carried` (L, 3 G); arguments as of `_carry`."""
        link, carry, into = self.link[begin:end], self.carry[begin:end], carried[begin:end]
        run_chunks(lambda b, e: _carry(link, carry, light, known, shone, b, e, into), len(link), CHUNK, self.threads)

    def _bring(self, begin: int, end: int, carried: np.ndarray, total: np.ndarray, wanted: np.ndarray) -> None:
        """Adds what the links begin..end-1 carry to the sums of the cells (C, 3 G), and to what lookups are to find in the coarsest (C,)."""
        add_to_cells(self.send_places[:, begin:end], carried[begin:end], total, self.threads)
        _want(self.send_root, self.send_weight, carried, begin, end, wanted)

    def _reflected(self, light: np.ndarray) -> np.ndarray:
        """What one lobe reflects of the lamps' light, and the next one of `light` (C, 3 G)."""
        carried, total = np.empty((self.glossy, light.shape[1]), np.float32), np.zeros_like(light)
        self._send(self.fixed, self.glossy, light, np.zeros(0, np.float32), light, carried)
        add_to_cells(self.send_places[:, self.fixed : self.glossy], carried[self.fixed :], total, self.threads)
        return self.one + self._filled(total, self.linked)

    def _sums_of_halves(self, places: np.ndarray, half: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Sums (2, C, K) of values (N, K) over the cells (LEVELS, N), of either half (N,) of the paths."""
        sums = np.zeros((2, len(self.parent), values.shape[1]), np.float32)

        def add(begin: int, end: int) -> None:
            for level in range(begin, end):
                _scatter_halves(places[level], half, values, sums)

        run_chunks(add, LEVELS, 1, self.threads if len(values) > CHUNK else 1)
        return sums

    def _filled(self, values: np.ndarray, shares: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """The sums (C, K), turned into means by `shares`."""
        _fill(values, *shares, self.parent, self.order)
        return values


def half_of(probes: np.ndarray) -> np.ndarray:
    """To which half of the paths probes belong, (N,) uint8: 0 or 1."""
    return ((probes // DEPTH) % 2).astype(np.uint8)


def turns_to_settle(probes: Probes) -> int:
    """Rounds after which chains of links that take no bounce carry less than a hundredth of what they began with."""
    free = probes.link > DIFFUSE_LINK
    kept = float(probes.carry[free].mean(axis=1).sum()) / max(1, int((probes.valid > 0).sum()))
    return 1 + (int(np.clip(np.ceil(np.log(0.01) / np.log(min(kept, 0.8))), 1, MOST_TURNS)) if kept > 0 else 0)


def add_to_cells(places: np.ndarray, values: np.ndarray, out: np.ndarray, threads: int) -> None:
    """Adds values (N, K) to the cells (LEVELS, N) of each level in out (C, K)."""

    def add(begin: int, end: int) -> None:
        for level in range(begin, end):
            _scatter(places[level], values, out)

    run_chunks(add, LEVELS, 1, threads if len(values) > CHUNK else 1)


def smooth(values: np.ndarray, number: np.ndarray, unit: np.ndarray, parent: np.ndarray, order: np.ndarray, likeness: np.ndarray) -> None:
    """Turns the sums (C, K) of cells into means; a coarser cell stands in for what a finer one has not seen.

    number: (C,) the sum of the weights.  unit: (C,) what a probe of the cell weighs.  likeness: (C,) as how many probes the
    coarser cell counts.  order: (C,) the cells, the coarsest first.
    """
    _fill(values, *_shares(number, unit, parent, likeness), parent, order)


@kernel
def _shares(number, unit, parent, likeness):
    """How much of the mean of a cell its own sum makes (C,), and that of the coarser one around it (C,)."""
    own, above = np.empty(len(parent), np.float32), np.empty(len(parent), np.float32)
    for c in range(len(parent)):
        weight = _0
        if parent[c] >= 0:
            # What knows nothing itself takes all from the coarser one.
            weight = likeness[c] * unit[c] if number[c] > _0 else _1
        own[c] = _1 / max(number[c] + weight, _LEAST)
        above[c] = weight * own[c]
    return own, above


@kernel
def _fill(values, own, above, parent, order):
    for c in order:
        up = parent[c]
        for k in range(values.shape[1]):
            values[c, k] *= own[c]
        if up >= 0:
            for k in range(values.shape[1]):
                values[c, k] += above[c] * values[up, k]


@kernel
def _scatter(cell, values, out):
    for i in range(len(cell)):
        for k in range(values.shape[1]):
            out[cell[i], k] += values[i, k]


@kernel
def _scatter_halves(cell, half, values, out):
    for i in range(len(cell)):
        for k in range(values.shape[1]):
            out[half[i], cell[i], k] += values[i, k]


@kernel
def _weigh(values, rows, weight, begin, end, column, out):
    """values (N, K) of `rows` (M,), times their weight (M,), into the columns of `out` (M, L) from `column` on."""
    for i in range(begin, end):
        for k in range(values.shape[1]):
            out[i, column + k] = weight[i] * values[rows[i], k]


@kernel
def _weigh_numbers(direct, rows, weight, linked, begin, end, out):
    """The first four columns of `out` (M, L): the weight, that of probes whose link is known, and weighted squares of brightness and of the weight."""
    for i in range(begin, end):
        bright = _0
        for k in range(direct.shape[1]):
            bright += direct[rows[i], k]
        bright *= _THIRD
        out[i, 0], out[i, 1] = weight[i], linked[i]
        out[i, 2], out[i, 3] = weight[i] * bright * bright, weight[i] * weight[i]


@kernel
def _gain(albedo, rows, irradiance, cell, begin, end, gained):
    for i in range(begin, end):
        for c in range(0, irradiance.shape[1], 3):
            for k in range(3):
                gained[i, c + k] = albedo[rows[i], k] * irradiance[cell[i], c + k]


@kernel
def _carry(link, carry, light, known, shone, begin, end, carried):
    """What the links begin..end-1 carry of the light (C, 3 G) of cells, into `carried` (L, 3 G).

    known: (L,), the part of what lobes reflect of the lamps, `shone` (C, 3 G), that is not the links' to bring; no rows for nothing.
    """
    for i in range(begin, end):
        for c in range(0, carried.shape[1], 3):
            for k in range(3):
                carried[i, c + k] = carry[i, k] * light[link[i], c + k]
        if len(known):
            for c in range(0, carried.shape[1], 3):
                for k in range(3):
                    carried[i, c + k] = max(carried[i, c + k] - known[i] * carry[i, k] * shone[link[i], c + k], _0)


@kernel
def _want(root, weight, carried, begin, end, wanted):
    """Adds what the links begin..end-1 carry, sum of the channels, to what lookups are to find in the coarsest cells; root: -1 where nothing is looked up."""
    for i in range(begin, end):
        if root[i] >= 0:
            light = _0
            for k in range(carried.shape[1]):
                light += carried[i, k]
            wanted[root[i]] += light / weight[i]


@kernel
def _balance(wanted, lookups, trust, root, light, scale):
    """Scales the cells of each coarsest one so that lookups find as much light there as the probes themselves sent.

    What is looked up from afar lies brighter than what hides close by; smoothing over both takes from the first.
    wanted: (C,) what the probes of the coarsest cells sent that may be looked up, sum of the channels.  lookups: (C,) how many of them look up each cell.
    trust: probes of mean brightness that the whole view counts for.  light: (C, 3 G).  scale: (C,), becomes the factors.
    """
    found = np.zeros(len(root))
    for c in range(len(root)):
        if lookups[c] > _0:
            mean = _0
            for k in range(light.shape[1]):
                mean += light[c, k]
            found[root[c]] += lookups[c] * mean
    whole_wanted, whole_found = wanted.sum(), found.sum()
    if not whole_found > 0:
        return
    known = trust * whole_found
    for c in range(len(root)):
        if root[c] == c:
            # The factor of the whole view stands in where few probes know better, but none of it where nothing is looked up: from link to link it
            # would be taken again and again.
            factor = (wanted[c] + known * whole_wanted / whole_found) / max(found[c] + known, 1e-30) if found[c] > 0 else 1.0
            scale[c] = min(MOST_BALANCE, max(1 / MOST_BALANCE, factor))
    for c in range(len(root)):
        scale[c] = scale[root[c]]
        for k in range(light.shape[1]):
            light[c, k] *= scale[c]


@kernel
def _scale(values, scale):
    """values (C, K) times scale (C,)."""
    for c in range(values.shape[0]):
        for k in range(values.shape[1]):
            values[c, k] *= scale[c]


@kernel
def _likeness(parent, number, squares, light):
    """As how many probes of each cell the coarser one around it counts (C,) float32, `PRIOR` at most: by how alike its cells are.

    That is the variance within cells over the variance between them (the linear empirical Bayes estimator): where a patch
    of sun lies beside the dark, its cells tell little of each other.  The mean deviation within cells is taken, for the
    few cells on the patch's edge have a large one.

    number: (C,), light: (C, 3 G), sums of the probes' weights and of their weighted light.  squares: (C, 2) sums of the weighted squares of
    their brightness, and of the squared weights.
    """
    count = len(parent)
    sums, likeness = (
        np.zeros((count, 5)),
        np.full(count, np.float32(PRIOR)),
    )  # of each coarser cell: deviations, and their weight; weight, squares, light
    for c in range(count):
        up, n = parent[c], np.float64(number[c])
        if up < 0 or not n > 0:
            continue
        bright = 0.0
        for k in range(light.shape[1]):
            bright += light[c, k]
        bright /= 3.0
        effective = n * n / squares[c, 1]
        if effective > 1.5:
            variance = max(0.0, squares[c, 0] / n - (bright / n) * (bright / n))
            sums[up, 0] += n * np.sqrt(variance * effective / (effective - 1.0))
            sums[up, 1] += n
        sums[up, 2] += n
        sums[up, 3] += squares[c, 0]
        sums[up, 4] += bright
    for c in range(count):
        if parent[c] >= 0:
            deviation, several, whole, square, bright = sums[parent[c]]
            if several > 0:
                within = (deviation / several) ** 2
                between = square / whole - (bright / whole) ** 2 - within
                if between > 0:
                    likeness[c] = min(PRIOR, within / between)
    return likeness
