"""Thinning of a cubical complex to curves: directional, parallel collapse, on words of 64 cells and only where something changed.

A free pair is a cell f and the only cell g of one dimension more that contains it; taking both away changes neither the Euler
characteristic nor the number of components.  All free pairs of one direction and one type go at once.  Chaussard & Couprie 2009,
"Surface Thinning in 3D Cubical Complexes"; what is kept of the curves follows design.md, section 5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel, leaf
from .bits import WORD
from .cells import CUBE, EDGES, FACES, Complex

_UNBORN = 65535
_LAST = 60_000  # iterations, far beyond the diameter of any volume here


class Keep(NamedTuple):
    """Which free edges stay: those that have lasted, bare of faces, for longer than a bound.

    In iteration i an edge of birth b (the first iteration in which it lay in no face), opening O and distance D (largest over the
    voxels around it) stays if i - b > opening * O - distance * D + birth * b + least.  It must go on staying in later iterations.
    """

    opening: float = 1.0
    distance: float = 1.0
    birth: float = 1.0
    least: float = 0.0


CURVES = Keep()
OPENED = Keep(opening=1.0, distance=0.0, birth=0.0)  # where the first face was taken out: births tell no distance there
TOPOLOGY = Keep(opening=0.0, distance=0.0, birth=0.0, least=_LAST)  # keeps nothing that can go


class Births(NamedTuple):
    """Since when edges lie in no face.

    known: (3, words) uint64, edges along x, y, z that do.  iteration: (3, words * 64) uint16.
    """

    known: np.ndarray
    iteration: np.ndarray


@inlined
def _behind(cells, i, axis, row, slice_):
    """The word of the cells one place lower along an axis."""
    if axis == 0:
        return (cells[i] << np.uint64(1)) | (cells[i - 1] >> np.uint64(63))
    return cells[i - (row if axis == 1 else slice_)]


@inlined
def _ahead(cells, i, axis, row, slice_):
    """The word of the cells one place higher along an axis."""
    if axis == 0:
        return (cells[i] >> np.uint64(1)) | (cells[i + 1] << np.uint64(63))
    return cells[i + (row if axis == 1 else slice_)]


@leaf
def _ahead_behind(cells, i, ahead, behind, row, slice_):
    """The word of the cells one place higher along one axis and one lower along another one."""
    step = (row if ahead == 1 else slice_) if ahead else 0
    if ahead:
        return _behind(cells, i + step, behind, row, slice_)
    step = row if behind == 1 else slice_
    return _ahead(cells, i - step, 0, row, slice_)


@leaf
def _free(cells, i, kind, axis, high, row, slice_):
    """Bits of word i whose cell of type `kind` is the only one around its facet on one side of an axis."""
    own = cells[kind]
    found = own[i]
    if found == 0:
        return found
    facet = kind & ~(1 << axis)
    found &= ~(_ahead(own, i, axis, row, slice_) if high else _behind(own, i, axis, row, slice_))
    for b in range(3):
        if kind & (1 << b):
            continue
        other = cells[facet | (1 << b)]
        if high:
            found &= ~(_ahead(other, i, axis, row, slice_) | _ahead_behind(other, i, axis, b, row, slice_))
        else:
            found &= ~(other[i] | _behind(other, i, b, row, slice_))
    return found


@leaf
def _around(volume, shape, axis, x, y, z):
    """The largest value over the voxels around an edge at lattice place (x, y, z)."""
    most = 0
    for k in range(z - (axis != 2), z + 1):
        for j in range(y - (axis != 1), y + 1):
            for i in range(x - (axis != 0), x + 1):
                if 0 <= k < shape[0] and 0 <= j < shape[1] and 0 <= i < shape[2]:
                    most = max(most, np.int64(volume[k, j, i]))
    return most


@leaf
def _kept(found, i, axis, births, distance, opening, shape, row, slice_, iteration, keep):
    """Those of the edges `found` in word i that stay."""
    kept = np.uint64(0)
    waiting = found & births.known[axis, i]
    z, y, word = i // slice_ - 1, i % slice_ // row - 1, i % row
    while waiting:
        lowest = waiting & (~waiting + np.uint64(1))
        waiting ^= lowest
        bit = _index(lowest)
        born = np.float64(births.iteration[axis, i * 64 + bit])
        x = word * 64 + bit - 1
        o, d = _around(opening, shape, axis, x, y, z), _around(distance, shape, axis, x, y, z)
        if iteration - born > keep.opening * o - keep.distance * d + keep.birth * born + keep.least:
            kept |= lowest
    return kept


@leaf
def _index(lowest):
    """The number of the only bit that is set."""
    bit = 0
    for step in (32, 16, 8, 4, 2, 1):
        if lowest >> np.uint64(step):
            lowest >>= np.uint64(step)
            bit += step
    return bit


@leaf
def _remove(cells, due, i, found, kind, axis, high, row, slice_, until):
    """Take the pairs of the cells `found` away, and mark the words around them as due."""
    cells[kind][i] &= ~found
    facets = cells[kind & ~(1 << axis)]
    if not high:
        facets[i] &= ~found
    elif axis == 0:
        facets[i] &= ~(found << np.uint64(1))
        facets[i + 1] &= ~(found >> np.uint64(63))
    else:
        facets[i + (row if axis == 1 else slice_)] &= ~found
    first = -1 if found & np.uint64(3) else 0
    last = 1 if found >> np.uint64(62) else 0
    for k in range(-1, 2):
        for j in range(-1, 2):
            at = i + k * slice_ + j * row
            for word in range(at + first, at + last + 1):
                due[word] = until


@leaf
def _listed(due, since, words):
    """The words due in iteration `since`, in order, into `words`; how many."""
    n = 0
    for block in range(0, len(due), 64):
        end = min(block + 64, len(due))
        some = False
        for i in range(block, end):
            some |= due[i] >= since
        if some:
            for i in range(block, end):
                if due[i] >= since:
                    words[n] = i
                    n += 1
    return n


@leaf
def _bear(cells, births, words, n, row, slice_, iteration):
    """Note the edges of the words listed that lie in no face now."""
    for k in range(n):
        i = words[k]
        for axis in range(3):
            bare = cells[1 << axis][i] & ~births.known[axis, i]
            for b in range(3):
                if b != axis:
                    face = cells[(1 << axis) | (1 << b)]
                    bare &= ~(face[i] | _behind(face, i, b, row, slice_))
            births.known[axis, i] |= bare
            while bare:
                lowest = bare & (~bare + np.uint64(1))
                bare ^= lowest
                births.iteration[axis, i * 64 + _index(lowest)] = iteration


@kernel
def _collapse(cells, due, births, distance, opening, shape, row, slice_, kinds, keep, iteration, last):
    """Collapse until nothing is removed; the number of the last iteration in which something was.

    cells: (8, words) flat.  due: (words,) uint16, until which iteration a word must be looked at.
    kinds: cell types, cubes first, edges last.
    """
    words = np.empty(len(due), np.int64)
    while iteration < last:
        iteration += 1
        removed = False
        for axis in range(3):
            for high in range(2):
                for kind in kinds:
                    if not kind & (1 << axis):
                        continue
                    n = _listed(due, iteration, words)
                    # In this order no word is read after its neighbour has changed in the same pass: all pairs go at once.
                    for k in range(n):
                        i = words[k] if high else words[n - 1 - k]
                        found = _free(cells, i, kind, axis, high, row, slice_)
                        if found and kind == 1 << axis:
                            found ^= _kept(found, i, axis, births, distance, opening, shape, row, slice_, iteration, keep)
                        if found:
                            _remove(cells, due, i, found, kind, axis, high, row, slice_, iteration + 1)
                            removed = True
        if not removed:
            return iteration - 1
        _bear(cells, births, words, _listed(due, iteration + 1, words), row, slice_, iteration)
    return iteration


class Thinning:
    """A complex that is being thinned, in place.

    complex: `cells.Complex`.  distance, opening: (Z, Y, X) uint8 of its voxels (core/topology/distance.py).
    iterations: so far.
    """

    def __init__(self, complex_: Complex, distance: np.ndarray, opening: np.ndarray):
        self.complex = complex_
        self.distance, self.opening = distance, opening
        words = complex_.cells[0].size
        self.iterations = 0
        self._births = Births(np.zeros((3, words), np.uint64), np.zeros((3, words * WORD), np.uint16))

    def collapse(self, keep: Keep = CURVES) -> int:
        """Thin until nothing is left that may go; the number of iterations so far."""
        cells, (_, rows, row) = self.complex.cells.reshape(8, -1), self.complex.cells.shape[1:]
        due = np.where((cells != 0).any(axis=0), np.uint16(self.iterations + 1), np.uint16(0))
        kinds = np.array((CUBE, *FACES, *EDGES))
        shape = np.array(self.complex.shape)
        self.iterations = _collapse(
            cells, due, self._births, self.distance, self.opening, shape, row, row * rows, kinds, keep, self.iterations, _LAST
        )
        return self.iterations


def thin(complex_: Complex, distance: np.ndarray, opening: np.ndarray, keep: Keep = CURVES) -> Complex:
    """`complex_` thinned to what `keep` keeps: curves, but closed surfaces round what floats in the empty space.

    The result is new; it has the Euler characteristic and the components of `complex_`.
    """
    thinning = Thinning(complex_.copy(), distance, opening)
    thinning.collapse(keep)
    return thinning.complex
