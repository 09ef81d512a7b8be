"""Faces that lie on others are found, and give back no light."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core import scene as sc
from lumigate.core.coincident import coincident
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.stress import arrays

SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
TILTED = SQUARE @ np.array([(1, 0, 0), (0, 0.8, 0.6), (0, -0.6, 0.8)])


def moved(x, y, z):
    """The square, somewhere else."""
    return np.add(SQUARE, (x, y, z))


def found(*quads, flags=0, origin=(0, 0, 0)):
    """Numbers of the quads whose triangles both lie on others."""
    made = arrays.scene(arrays.geometry(*arrays.quads(*quads)), arrays.materials((0.5, 0)))
    made.materials.tables.flags[0] |= flags
    made.origin = np.asarray(origin, float)
    counts = np.bincount(coincident(made) // 2, minlength=len(quads))
    assert set(counts.tolist()) <= {0, 2}
    return np.flatnonzero(counts).tolist()


@pytest.mark.parametrize("axis", range(3))
def test_doubled_faces_across_an_axis_are_found(axis):
    square = np.roll(SQUARE, axis, axis=1) + 0.3
    aside = square + 5
    for other in (square, square[::-1], np.roll(square, 1, axis=0)):  # the last two have the other diagonal, or the other side
        assert found(square, aside, other) == [0, 2]


def test_only_what_is_covered_as_a_whole_counts():
    rug = 0.5 * SQUARE
    assert found(SQUARE, rug) == [1]
    assert found(SQUARE, moved(1, 0, 0)) == []
    assert found(SQUARE, moved(2, 0, 0), moved(0, 2, 0)) == []  # they share edges
    assert found(SQUARE, moved(0, 0, 1e-5)) == []


def wide(x0, x1, y0, y1):
    return np.array([(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)], float)


@pytest.mark.parametrize("gap", [0.0, 0.2, 1.2])
def test_a_gap_between_those_that_cover_a_face_is_seen(gap):
    # The end of a wall behind the sill and the lintel of a window: lit where the window is, whatever lies at its corners.
    wall, sill, lintel = wide(0, 0.6, 0, 3), wide(-0.1, 0.7, -0.1, 0.9), wide(-0.1, 0.7, 0.9 + gap, 3.1)
    assert found(wall, sill, lintel) == ([] if gap else [0])


def test_other_faces_are_left_alone():
    assert found(TILTED, TILTED) == []
    assert found(SQUARE, SQUARE, flags=sc.TRANSPARENT) == []
    assert found(SQUARE[[0, 1, 1, 0]], SQUARE[[0, 1, 1, 0]]) == []  # without area


def test_last_places_far_from_the_origin_do_not_count():
    leaning = moved(0, 0, 1.6718748)
    leaning[2:, 2] = 1.6718746
    assert found(leaning, leaning, origin=(0, 0, 4)) == [0, 1]
    assert found(leaning, leaning) == []  # nearer, Cycles tells these from each other


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_as_the_definition_has_it(columns, rows, seed):
    # Tiles of a floor, some of them doubled.
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    tiles = [2.0 * SQUARE + np.array((4 * i, 4 * j, 0)) for i, j in zip(x.ravel(), y.ravel())]
    doubled = np.flatnonzero(rng.random(len(tiles)) < 0.4)
    assert found(*tiles, *(tiles[k][::-1] for k in doubled)) == sorted([*doubled, *(len(tiles) + np.arange(len(doubled)))])


def test_they_are_black_but_keep_their_colour(build):
    lower, upper = np.multiply(SQUARE, (2, 1, 1)) + np.array((0, 0, -2)), moved(-1, 0, -2)
    made = build.scene(build.geometry(*build.quads(lower, upper[::-1], upper)), build.materials((0.5, 0)), world=(1, 1, 1))
    result = render(made, RenderSettings(pixel_samples=4, denoise=False))
    left, right = np.s_[6:10, 4:7], np.s_[6:10, 9:12]
    assert np.allclose(result.layers["Albedo"][left], 0.5, atol=1e-3)
    assert result.layers["Direct"][right].mean() == pytest.approx(0.5, rel=0.02)
    assert not result.layers["Direct"][left].any() and not result.layers["Indirect"][left].any()
    (line,) = [line for line in result.stats["warnings"] if "exactly on others" in line]
    assert "triangles" in line


def test_no_light_comes_from_them(build):
    # A doubled wall beside a floor: what it would send to the floor is missing.
    floor, wall = moved(0, 0, -2), np.array([(-1, -1, -2), (-1, 1, -2), (-1, 1, 0), (-1, -1, 0)], float)
    light = build.lamp(sc.POINT, 5.0, position=(0.5, 0, -0.5))
    means = []
    for quads in ((floor, wall), (floor, wall, wall)):
        made = build.scene(build.geometry(*build.quads(*quads)), build.materials((0.8, 0)), lamps=light)
        means.append(render(made, RenderSettings(pixel_samples=4)).layers["DiffuseIndirect"][6:10, 6:10].mean())
    assert means[0] > 0 and means[1] < 0.02 * means[0]


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-42])
def test_coordinates_that_are_no_use_do_no_harm(odd):
    rng = np.random.default_rng(1)
    for _ in range(50):
        quads = [moved(0, 0, 0), moved(0, 0, 0), *(SQUARE * rng.uniform(0.5, 2) for _ in range(4))]
        for quad in quads[2:]:
            quad[rng.integers(4), rng.integers(3)] = odd
        made = arrays.scene(arrays.geometry(*arrays.quads(*quads)), arrays.materials((0.5, 0)))
        at = coincident(made)
        assert {0, 1, 2, 3} <= set(at.tolist()) and ((at >= 0) & (at < 12)).all()
