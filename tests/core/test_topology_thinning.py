"""Thinning keeps the topology, and takes away exactly what the definition says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from lumigate.core.topology.cells import EDGES, FACES, POINT, closure
from lumigate.core.topology.distance import distance_map, opening_map
from lumigate.core.topology.opening import open_shells
from lumigate.core.topology.skeleton import skeleton_of
from lumigate.core.topology.thinning import CURVES, TOPOLOGY, Thinning, thin

from . import topology_oracle as oracle


@st.composite
def volumes(draw):
    """Random voxels of any density, and rooms with random solid boxes in them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = draw(st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(1, 140)))
    if draw(st.booleans()):
        return rng.random(shape) < draw(st.floats(0, 1))
    empty = np.ones(shape, bool)
    for _ in range(draw(st.integers(0, 8))):
        low = rng.integers(0, shape)
        high = low + rng.integers(1, 5, 3)
        empty[tuple(slice(a, b) for a, b in zip(low, high))] = False
    return empty


@settings(max_examples=300, deadline=None)
@given(volumes())
def test_euler_characteristic_and_components_never_change(empty):
    whole = closure(empty)
    distance = distance_map(empty)
    thinned = thin(whole, distance, opening_map(distance))
    before, after = oracle.cells_of(whole), oracle.cells_of(thinned)
    assert np.array_equal(before, oracle.closure(empty))
    assert whole.euler_characteristic() == oracle.euler(before) == thinned.euler_characteristic() == oracle.euler(after)
    assert oracle.components(after) == ndimage.label(empty, np.ones((3, 3, 3)))[1]
    assert not after[7].any()
    assert not (after & ~before).any()


@settings(max_examples=60, deadline=None)
@given(volumes(), st.sampled_from([CURVES, TOPOLOGY]))
def test_the_same_cells_as_sweeps_over_everything(empty, keep):
    distance = distance_map(empty)
    opening = opening_map(distance)

    def kept(i, birth, o, d):
        return i - birth > keep.opening * o - keep.distance * d + keep.birth * birth + keep.least

    expected = oracle.thin(oracle.closure(empty), distance, opening, kept)
    assert np.array_equal(oracle.cells_of(thin(closure(empty), distance, opening, keep)), expected)


@settings(max_examples=100, deadline=None)
@given(volumes())
def test_opened_shells_leave_curves(empty):
    distance = distance_map(empty)
    thinning = Thinning(closure(empty), distance, opening_map(distance))
    before = thinning.complex.euler_characteristic()
    thinning.collapse()
    opened = open_shells(thinning)
    assert not any(thinning.complex.of_type(kind).any() for kind in FACES)
    assert thinning.complex.euler_characteristic() == before - opened
    # One for each solid part that floats, but for Bing's houses, of which so small a volume has none.
    solid = ndimage.label(np.pad(~empty, 1, constant_values=True))[1]
    assert opened == solid - 1
    assert oracle.components(oracle.cells_of(thinning.complex)) == ndimage.label(empty, np.ones((3, 3, 3)))[1]


def test_a_cube_is_a_point_and_a_long_room_a_line():
    cube = skeleton_of(np.ones((9, 9, 9), bool))
    assert len(cube.radius) == 1 and cube.components == 1
    room = skeleton_of(np.ones((9, 9, 60), bool))
    degree = np.bincount(room.arcs.ravel(), minlength=len(room.radius))
    assert degree.max() == 2 and np.count_nonzero(degree == 1) == 2
    # On the middle, up to the half voxel that the lattice cannot show.
    assert np.abs(room.place[:, 1:] - 4.5).max() <= 0.5 + 1e-6
    assert room.radius.max() == 5


def test_a_ring_stays_a_ring():
    empty = np.ones((5, 30, 30), bool)
    empty[:, 10:20, 10:20] = False
    ring = skeleton_of(empty)
    assert len(ring.arcs) - len(ring.radius) == 0 and ring.components == 1


def test_two_rooms_are_two_components_and_a_door_joins_them():
    empty = np.ones((10, 20, 41), bool)
    empty[:, :, 20] = False
    assert skeleton_of(empty).components == 2
    empty[3:6, 8:11, 20] = True
    assert skeleton_of(empty).components == 1


def test_open_space_has_no_outer_wall():
    empty = np.ones((16, 16, 16), bool)
    empty[7:9, 7:9, 7:9] = False
    assert distance_map(empty, closed=False)[0, 0, 0] == 7
    assert skeleton_of(empty, closed=False).components == 1


@pytest.mark.parametrize("volume", [np.zeros((4, 4, 4), bool), np.ones((1, 1, 1), bool)])
def test_the_smallest_volumes(volume):
    skeleton = skeleton_of(volume)
    assert skeleton.components == len(skeleton.radius) == volume.any()
    assert not any(thin(closure(volume), distance_map(volume), distance_map(volume)).of_type(k).any() for k in EDGES)
    assert closure(volume).of_type(POINT).sum() == (8 if volume.any() else 0)
