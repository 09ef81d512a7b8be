"""Faces that lie on others are found, and give back no light."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core import coincident as co
from lumigate.core import scene as sc
from lumigate.core.coincident import coincident
from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.core.surfaces.batch import evaluate_batch
from lumigate.core.surfaces.by_view import views
from lumigate.core.surfaces.covers import is_covered, own_materials
from lumigate.core.surfaces.normals import surface_side
from lumigate.core.transport import transport
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
    counts = np.bincount(coincident(made).whole // 2, minlength=len(quads))
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


def in_part(*quads):
    """What `coincident` finds among the quads, and the corners of their triangles (T, 3, 2) across z."""
    made = arrays.scene(arrays.geometry(*arrays.quads(*quads)), arrays.materials((0.5, 0)))
    return coincident(made), made.geometry.vertices[made.geometry.triangles][..., :2].astype(float)


def black(at, triangle, places):
    """Whether each of the places (N, 2), barycentric, on a triangle is covered."""
    if triangle in at.whole:
        return np.ones(len(places), bool)
    k = np.searchsorted(at.part, triangle)
    if k == len(at.part) or at.part[k] != triangle:
        return np.zeros(len(places), bool)
    return np.array([is_covered(at.covers, at.first[k], at.first[k + 1], *place) for place in places.astype(np.float32)])


def weights(corners, places):
    """Barycentric weights (N, 3) of places (N, 2) in a triangle (3, 2)."""
    return np.linalg.solve(np.vstack([corners.T, np.ones(3)]), np.vstack([places.T, np.ones(len(places))])).T


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 7), st.floats(0.05, 3), st.integers(0, 2**32 - 1))
def test_parts_are_those_that_another_triangle_holds(count, size, seed):
    rng = np.random.default_rng(seed)
    quads = []
    for _ in range(count):
        angle, wide, high, x, y = rng.uniform(0, 6), *rng.uniform(0.3, size + 0.3, 2), *rng.uniform(-1, 1, 2)
        turned = SQUARE[:: rng.choice((1, -1)), :2] * (wide, high) @ [(np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))]
        quads.append(np.column_stack([turned + np.array((x, y)), np.full(4, 0.7)]))
    at, corners = in_part(*quads)
    assert not set(at.whole) & set(at.part)
    u, v = np.sort(rng.random((2, 300)), axis=0)
    for triangle, own in enumerate(corners):
        places = np.column_stack([u, v - u])
        world = own[0] + places @ (own[1:] - own[0])
        least = np.array([weights(other, world).min(axis=1) for k, other in enumerate(corners) if k != triangle])
        clear = (np.abs(least) > 2e-3).all(axis=0)  # of the others' edges
        expected, found = (least > 0).any(axis=0), black(at, triangle, places)
        # A gap along an edge, so small that none of the looks finds it, may count as covered.
        assert (found != expected)[clear].mean() < (0.03 if triangle in at.whole else 1e-9)


def test_faces_that_only_touch_cover_nothing():
    # Tiles whose corners are rounded apart, walls that meet, a triangle's corner on another's edge.
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(12), np.arange(9))
    tiles = [1.1 * moved(2 * i, 2 * j, 0) + (1000.3, -77.7, 0) for i, j in zip(x.ravel(), y.ravel())]
    tiles = [(tile + rng.uniform(-3e-5, 3e-5, (4, 3)) * (1, 1, 0)).astype(np.float32) for tile in tiles]
    at, _ = in_part(*tiles)
    assert not len(at.whole) and not len(at.part)
    at, _ = in_part(SQUARE, np.array([(1, 0, 0), (2, -1, 0), (3, 0, 0), (2, 1, 0)], float))
    assert not len(at.part)


def test_a_face_under_many_others_is_left_as_it_is(monkeypatch):
    floor, legs = 9 * SQUARE, [0.1 * SQUARE + (x, y, 0) for x in range(-5, 6) for y in range(-5, 6)]
    at, _ = in_part(floor, *legs)
    assert at.part.tolist() == [0, 1] and len(at.whole) == 2 * len(legs)
    for name, few in (("MOST_COVERING", 60), ("MOST_LISTED", 100)):
        with monkeypatch.context() as patched:
            patched.setattr(co, name, few)
            at, _ = in_part(floor, *legs)
            assert not len(at.part) and len(at.whole) == 2 * len(legs)


def test_other_faces_are_left_alone():
    assert found(TILTED, TILTED) == []
    assert found(SQUARE, SQUARE, flags=sc.TRANSPARENT) == []
    assert found(SQUARE[[0, 1, 1, 0]], SQUARE[[0, 1, 1, 0]]) == []  # without area


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ((0, sc.REFRACTIVE | sc.TRANSPARENT), [0, 1]),  # a tumbler on a table
        ((sc.REFRACTIVE | sc.TRANSPARENT,) * 2, []),  # water in it: glass on glass lets light through
        ((0, sc.REFRACTIVE | sc.TRANSPARENT | sc.TELLING), []),  # no glass to shadow rays
        ((0, sc.REFRACTIVE | sc.TRANSPARENT | sc.ANGLED), []),
    ],
)
def test_glass_counts_on_what_is_opaque(flags, expected):
    made = arrays.scene(arrays.geometry(*arrays.quads(SQUARE, SQUARE), np.repeat([0, 1], 2)), arrays.materials((0.5, 0), (0.0, 0)))
    made.materials.tables.flags[:2] |= np.array(flags, np.int32)
    at = coincident(made)
    assert np.unique(at.whole // 2).tolist() == expected
    # The table is larger than the tumbler: covered in part, by opaque things alone unless it is opaque itself.
    made.geometry.vertices[4:] *= 0.5
    at = coincident(made)
    assert np.unique(at.whole // 2).tolist() == expected[1:] and np.unique(at.part // 2).tolist() == expected[:1]


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


def test_parts_are_black_but_keep_their_colour(build):
    # Each of two boards, one upside down, ends in the middle of a column of pixels.
    left, right = wide(-2, 0.375, -1, 1), wide(-0.375, 2, -1, 1)[::-1]
    boards = [board - (0, 0, 2) for board in (left, right)]
    layers = {}
    for name, quads in (("apart", boards[:1]), ("both", boards)):
        made = build.scene(build.geometry(*build.quads(*quads)), build.materials((0.5, 0)), world=(1, 1, 1))
        result = render(made, RenderSettings(pixel_samples=16, denoise=False))
        layers[name] = result.layers
    rows, lit, middle = slice(6, 10), layers["apart"]["Direct"][6:10, 4:6].mean(), layers["both"]["Direct"]
    assert np.allclose(layers["both"]["Albedo"][rows, 4:12], 0.5, atol=1e-3)
    columns = middle[rows].mean(axis=(0, 2)) / lit
    black = np.flatnonzero(columns == 0)
    assert len(black) >= 2 and np.array_equal(black, np.arange(black[0], black[-1] + 1))
    assert columns[4 : black[0] - 1] == pytest.approx(1, rel=0.02) and columns[black[-1] + 2 : 12] == pytest.approx(1, rel=0.02)
    assert columns[4:12].sum() * 0.25 == pytest.approx(2 - 0.75, abs=0.06)  # metres of both boards that are lit
    (line,) = [line for line in result.stats["warnings"] if "exactly on others" in line]
    assert "in part" in line


def test_parts_send_no_light(build):
    # Half of a wall beside a floor is doubled: as if that half were black.
    floor, light = moved(0, 0, -2), build.lamp(sc.POINT, 5.0, position=(0.5, 0, -0.5))
    wall, half, rest = (np.array([(-1, y0, -2), (-1, y1, -2), (-1, y1, 0), (-1, y0, 0)], float) for y0, y1 in ((-1, 1), (-1, 0), (0, 1)))
    means = []
    for quads, materials in (((floor, wall), (0, 0)), ((floor, wall, half), (0, 0, 0)), ((floor, half, rest), (0, 1, 0))):
        geometry = build.geometry(*build.quads(*quads), material=np.repeat(materials, 2).astype(np.int32))
        made = build.scene(geometry, build.materials((0.8, 0), (0, 0)), lamps=light)
        means.append(render(made, RenderSettings(pixel_samples=4, gather=64, denoise=False)).layers["DiffuseIndirect"][6:10, 6:10].mean())
    assert means[1] == pytest.approx(means[2], rel=0.06) and means[1] < 0.8 * means[0]


def test_a_part_is_black_and_the_rest_what_it_was(build):
    # Of materials one is constant, one textured, and one shines; each has a face whose first triangle is covered at its second corner.
    texels = np.array([[(0.2, 0.4, 0.6)]], np.float32)
    stuff = build.textured(build.materials((0.5, 0), (0, 0), (0.5, 2)), 1, texels)
    quads = [face for x in (0, 5, 10) for face in (moved(x, 0, 0), 0.1 * SQUARE + (x + 0.9, -0.9, 0))]
    geometry = build.geometry(*build.quads(*quads), material=np.repeat([0, 0, 1, 0, 2, 0], 2).astype(np.int32))
    geometry.attributes = np.zeros((1, len(geometry.triangles), 3, 4), np.float32)
    made = build.scene(geometry, stuff)
    at = coincident(made)
    before = transport(geometry, stuff.tables, (), ())
    after = co.without_reflection(before, at)
    assert after.material[8] == before.material[8] == 2 and after.materials.flags[2] & sc.EMISSIVE
    assert own_materials(after.materials)[after.material[[0, 4, 8]]].tolist() == [0, 1, 2]
    # Light is cached by the surface, not by the triangle: a cell of one triangle would know few paths.
    assert [surface_side(after.materials, after.material[k], k > 0) for k in (0, 4, 8)] == [0, 3, 5]
    for triangle, colour in ((0, (0.5, 0.5, 0.5)), (4, (0.2, 0.4, 0.6))):
        u, v = np.array([[0.3, 0.95], [0.3, 0.02]])
        surfaces = evaluate_batch(after.materials, after.material, geometry.attributes, np.full(2, triangle), u, v)
        assert surfaces[0, :3] == pytest.approx(colour, rel=1e-3) and not surfaces[1].any()
    known, expected = (views(t.materials, t.material, geometry.attributes)[0] for t in (after, before))
    assert np.array_equal(known[2 * after.material[[0, 4]]], expected[[0, 2]])


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
        assert {0, 1, 2, 3} <= set(at.whole.tolist())
        assert all(((k >= 0) & (k < 12)).all() for k in (at.whole, at.part)) and np.isfinite(at.covers).all()
