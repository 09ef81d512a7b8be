"""The thinning beside an independent oracle: the Python package of DGtal, whose collapse of cubical complexes is Chaussard and Couprie's (2009)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core.topology.cells import closure
from lumigate.core.topology.distance import distance_map, opening_map
from lumigate.core.topology.thinning import CURVES, TOPOLOGY, thin

from . import topology_oracle as oracle

dgtal = pytest.importorskip("dgtal", reason="DGtal has no wheel for this machine")

POINT = type(dgtal.Point(dim=3))


def _space(shape):
    depth, height, width = shape
    space = dgtal.KSpace(dim=3)
    space.init(lower=POINT(-1, -1, -1), upper=POINT(width, height, depth), is_closed=True)
    return space


def _complex(empty):
    """DGtal's complex of the empty voxels (Z, Y, X), and its space."""
    depth, height, width = empty.shape
    voxels = dgtal.DigitalSet(domain=dgtal.Domain(lower_bound=POINT(0, 0, 0), upper_bound=POINT(width - 1, height - 1, depth - 1)))
    for z, y, x in np.argwhere(empty).tolist():
        voxels.insert(POINT(x, y, z))
    space = _space(empty.shape)
    complex_ = dgtal._dgtal.topology.CubicalComplex3D(space)
    complex_.construct(voxels)
    return complex_, space


def _of_dgtal(complex_, space, shape):
    """(8, Z + 1, Y + 1, X + 1) bool cells by type, of Khalimsky coordinates: odd along the axes that a cell extends in."""
    cells = np.zeros((8, *(n + 1 for n in shape)), bool)
    for dimension in range(4):
        for cell, _ in complex_.iter(dimension):
            x, y, z = (int(space.uKCoords(cell)[a]) for a in range(3))
            cells[(x & 1) | (y & 1) << 1 | (z & 1) << 2, z // 2, y // 2, x // 2] = True
    return cells


def _to_dgtal(cells, space):
    """DGtal's complex of our cells."""
    complex_ = dgtal._dgtal.topology.CubicalComplex3D(space)
    for kind, z, y, x in np.argwhere(cells).tolist():
        complex_.insertCell(space.uCell(POINT(2 * x + (kind & 1), 2 * y + (kind >> 1 & 1), 2 * z + (kind >> 2 & 1))))
    return complex_


@st.composite
def volumes(draw):
    """Small random voxels of any density."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = draw(st.tuples(*[st.integers(1, 6)] * 3))
    return rng.random(shape) < draw(st.floats(0.2, 1))


@settings(max_examples=60, deadline=None)
@given(volumes(), st.sampled_from([CURVES, TOPOLOGY]))
def test_thinned_complexes_have_the_topology_that_dgtal_finds(empty, keep):
    theirs, space = _complex(empty)
    whole = closure(empty)
    assert np.array_equal(_of_dgtal(theirs, space, empty.shape), oracle.cells_of(whole))
    distance = distance_map(empty)
    ours = oracle.cells_of(thin(whole, distance, opening_map(distance), keep))
    again = _to_dgtal(ours, space)
    assert again.euler() == theirs.euler() == whole.euler_characteristic()
    theirs.thinning(method="pardir")
    again.thinning(method="pardir")
    # What both collapse to in the end has the same pieces, and as many tunnels more than hollows in all.
    ends = [_of_dgtal(complex_, space, empty.shape) for complex_ in (theirs, again)]
    assert oracle.components(ends[0]) == oracle.components(ends[1]) == oracle.components(ours)
    assert theirs.euler() == again.euler()


@pytest.mark.parametrize("name, euler", [("ball", 1), ("ring", 0), ("shell", 2), ("two", 2)])
def test_dgtal_and_ours_agree_on_known_bodies(name, euler):
    empty = np.ones((5, 5, 5), bool)
    if name == "ring":
        empty[:, 2, 2] = False
    elif name == "shell":
        empty[2, 2, 2] = False
    elif name == "two":
        empty[2] = False
    theirs, _ = _complex(empty)
    distance = distance_map(empty)
    thinned = thin(closure(empty), distance, opening_map(distance), TOPOLOGY)
    theirs.thinning(method="pardir")
    assert theirs.euler() == thinned.euler_characteristic() == euler
    dimensions = [sum(int(oracle.cells_of(thinned)[kind].sum()) for kind in range(8) if kind.bit_count() == d) for d in range(4)]
    counts = [theirs.nbCells(d) for d in range(4)]
    # Neither leaves a cube, and each leaves faces only round the hollow.
    assert counts[3] == dimensions[3] == 0
    assert bool(counts[2]) == bool(dimensions[2]) == (name == "shell")
