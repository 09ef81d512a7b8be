"""Texels as shading points: rasterisation against an oracle, shares, and what nobody can see."""

import numpy as np
import pytest

from lumigate.core.lamps import build_emitters
from lumigate.core.rays import RayScene
from lumigate.core.transport import transport
from lumigate.core.view import texels as tx
from lumigate.core.view.camera import pixel_sample
from lumigate.core.view.corners import corner_weights

SEED = 5


@pytest.fixture
def seen(build):
    """Views the texels of a scene: (texels, charts) for a list of triangles with a uv layout of one quad each."""

    def seen(vertices, triangles, chosen, uv, size, samples=4, threads=0, material=None):
        scene = build.scene(build.geometry(vertices, triangles, material), build.materials((0.5, 0.0), (0.8, 2.0)))
        with RayScene(scene.geometry.vertices, scene.geometry.triangles) as rays:
            tables = transport(scene.geometry, scene.materials.tables, rays.tables, build_emitters(scene))
            charts = tx.Charts.of(np.array(chosen), np.asarray(uv, np.float32), size)
            return tx.view_texels(tables, charts, size, samples, SEED, threads, materials=True)

    return seen


def quad_uv(low=(0, 0), high=(1, 1)):
    """UV coordinates of a quad's two triangles, the corners of a rectangle in the order of `build.quads`."""
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])], float)
    return corners[[[0, 1, 2], [0, 2, 3]]]


FLOOR = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def oracle(uv, width, height, samples):
    """What `cover` finds of the samples, one by one, in float64; centroids left out."""
    found = np.full((height * width, samples), -1)
    for y in range(height):
        for x in range(width):
            for extent in (tx.EXTENT, 1):
                if (found[y * width + x] < 0).all():
                    found[y * width + x] = [holder(uv, x, y, s, y * width + x, extent) for s in range(samples)]
    return found


def holder(uv, x, y, s, texel, extent):
    """The first triangle that holds sample s of a texel, -1 for none."""
    jx, jy = pixel_sample(s, np.uint32(SEED), texel)
    place = x + 0.5 + extent * (jx - 0.5), y + 0.5 + extent * (jy - 0.5)
    for k, (a, b, c) in enumerate(uv.astype(float)):
        m = np.column_stack([b - a, c - a])
        if abs(np.linalg.det(m)) > 0:
            u, v = np.linalg.solve(m, place - a)
            if u >= 0 and v >= 0 and u + v <= 1:
                return k
    return -1


def test_cover_equals_the_oracle():
    rng = np.random.default_rng(1)
    width, height, samples = 11, 7, 3
    uv = (rng.random((9, 3, 2)) * (width + 4, height + 4) - 2).astype(np.float32)
    uv[4] = uv[4, :1]  # no area
    expected = oracle(uv, width, height, samples)
    for y0, y1 in ((0, height), (2, 5)):
        found = np.empty(((y1 - y0) * width, samples), np.int32)
        weights = np.empty((*found.shape, 2), np.float32)
        extent = np.empty(len(found), np.float32)
        tx.cover(uv, y0, y1, width, samples, np.uint32(SEED), found, weights, extent)
        assert set(extent) == {tx.EXTENT, 1}
        rows = expected[y0 * width : y1 * width]
        centroids = (found != rows).any(axis=1)
        # Only a texel that no sample has found may hold a triangle's middle.
        assert (rows[centroids] < 0).all()
        assert (found[~centroids] == rows[~centroids]).all() and (~centroids).sum() > 0.8 * len(rows)
        k, s = np.nonzero(found >= 0)
        corners = uv[found[k, s]].astype(float)
        w = weights[k, s].astype(float)
        places = corners[:, 0] + w[:, :1] * (corners[:, 1] - corners[:, 0]) + w[:, 1:] * (corners[:, 2] - corners[:, 0])
        assert (np.floor(places + 1e-4) >= np.column_stack([k % width, y0 + k // width])).all()
        assert (places <= np.column_stack([k % width, y0 + k // width]) + 1 + 1e-4).all()


def test_a_triangle_smaller_than_the_samples_still_has_a_texel(build, seen):
    uv = quad_uv((0.501, 0.501), (0.502, 0.502))
    texels = seen(*build.quads(FLOOR), [0, 1], uv, (8, 8), samples=1)
    assert (texels.state == tx.LIT).sum() == 1
    assert texels.state[3, 4] == tx.LIT  # v is up, rows go down


def test_a_texel_is_seen_in_its_middle_and_at_an_edge_wherever_it_shows_something(build, seen):
    # The floor ends at 7.1 of 8 columns, before the middle of the last one, whose samples are found in what it does reach.
    texels = seen(*build.quads(FLOOR), [0, 1], quad_uv((0, 0), (7.1 / 8, 1)), (8, 8), samples=16)
    across = (texels.points.position[:, None, 0] + np.pad(texels.points.spread[..., 0], ((0, 0), (1, 0)))) * 7.1
    offset = across - texels.points.pixel[:, None] % 8
    last = texels.points.pixel % 8 == 7
    assert (texels.state == tx.LIT).mean() > 0.9 and last.sum() > 4
    assert (np.abs(offset[~last] - 0.5) <= tx.EXTENT / 2 + 1e-4).all() and (np.abs(offset[~last] - 0.5) > 0.2).any()
    assert (offset[last] > 0).all() and (offset[last] < 0.1 + 1e-4).all()


def test_points_lie_where_the_map_says(build, seen):
    texels = seen(*build.quads(FLOOR), [0, 1], quad_uv(), (16, 12))
    assert (texels.state == tx.LIT).all()
    y, x = np.mgrid[0:12, 0:16]
    middle = np.stack([(x + 0.5) / 16, 1 - (y + 0.5) / 12, np.zeros_like(x)], -1)
    assert np.abs(texels.position - middle).max(axis=(0, 1)) == pytest.approx((0, 0, 0), abs=0.5 / 12)
    assert np.allclose(texels.normal, (0, 0, 1))
    assert np.abs(texels.position - middle)[..., :2].mean() < 0.02  # stratified samples, not one in a corner
    at = texels.points.pixel
    assert np.abs(texels.points.position - middle.reshape(-1, 3)[at]).max() < 0.51 / 12
    np.testing.assert_allclose(np.bincount(at, texels.points.albedo[:, 0]), 1, rtol=1e-5)


def test_materials_are_means_over_the_texel(build, seen):
    # Two quads of different materials meet in the middle of a column of texels.
    left, right = [(0, 0, 0), (0.5, 0, 0), (0.5, 1, 0), (0, 1, 0)], [(0.5, 0, 0), (1, 0, 0), (1, 1, 0), (0.5, 1, 0)]
    uv = np.concatenate([quad_uv((0, 0), (0.5, 1)), quad_uv((0.5, 0), (1, 1))])
    texels = seen(*build.quads(left, right), range(4), uv, (3, 3), samples=16, material=[0, 0, 1, 1])
    assert texels.albedo[:, 0] == pytest.approx(0.5)
    assert texels.albedo[:, 2] == pytest.approx(0.8)
    assert texels.albedo[:, 1].mean() == pytest.approx(0.65, abs=0.02)
    assert texels.emission[:, 1].mean() == pytest.approx(1.0, abs=0.15)


def test_an_edge_in_a_texel_gives_a_point_for_each_side(build, seen):
    # A fold along x = 0.5, charted in one piece: the texels on it are lit from both sides by their shares.
    flat, steep = [(0, 0, 0), (0.5, 0, 0), (0.5, 1, 0), (0, 1, 0)], [(0.5, 0, 0), (0.5, 0, -0.5), (0.5, 1, -0.5), (0.5, 1, 0)]
    uv = np.concatenate([quad_uv((0, 0), (0.5, 1)), quad_uv((0.5, 0), (1, 1))])
    texels = seen(*build.quads(flat, steep), range(4), uv, (3, 3), samples=16)
    middle = texels.points.pixel % 3 == 1
    assert np.bincount(texels.points.pixel).tolist() == 3 * [1, 2, 1]
    upward = texels.points.ns[:, 2] > 0.9
    assert np.bincount(texels.points.pixel[middle & upward] // 3, texels.points.albedo[middle & upward, 0]) == pytest.approx(0.5, abs=0.13)


def test_points_stand_for_surfaces(build, seen):
    # In one plane, of one material: a point a texel, somewhere in it, that knows other places there.
    left, right = [(0, 0, 0), (0.5, 0, 0), (0.5, 1, 0), (0, 1, 0)], [(0.5, 0, 0), (1, 0, 0), (1, 1, 0), (0.5, 1, 0)]
    uv = np.concatenate([quad_uv((0, 0), (0.5, 1)), quad_uv((0.5, 0), (1, 1))])
    points = seen(*build.quads(left, right), range(4), uv, (31, 31), samples=4).points
    assert (np.sort(points.pixel) == np.arange(31 * 31)).all()
    assert (points.albedo == 1).all()
    within = 31 * points.position[:, :2] % 1
    assert np.abs(within.mean(axis=0) - 0.5) == pytest.approx(0, abs=0.04)  # drawn among all samples
    assert np.histogramdd(within, (2, 2), ((0, 1), (0, 1)))[0].min() > 0.2 * len(within)
    places = points.position[:, None] + points.spread
    assert (np.linalg.norm(points.spread, axis=-1) > 0).all()
    assert (np.floor(31 * places[..., :2]) == np.floor(31 * points.position[:, None, :2])).all()
    # Of two materials: two points in the texels in between.
    points = seen(*build.quads(left, right), range(4), uv, (31, 31), samples=16, material=[0, 0, 1, 1]).points
    assert np.bincount(points.pixel % 31).tolist() == 15 * [31] + [62] + 15 * [31]


def box(low, high):
    """The six quads of a closed box, facing out."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    corners = [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)]
    return [[corners[k] for k in face] for face in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))]


@pytest.mark.parametrize("bottom", [-0.2, 0.0, 0.001])
def test_what_stands_on_a_floor_hides_it(build, seen, bottom):
    # Sunk in, flush, or a hair above: the same texels are out of sight, and no other.
    texels = seen(*build.quads(FLOOR, *box((0.25, 0.25, bottom), (0.75, 0.75, 0.6))), [0, 1], quad_uv(), (16, 16))
    hidden = texels.state == tx.HIDDEN
    assert hidden[5:11, 5:11].mean() > 0.97
    hidden[4:12, 4:12] = False
    assert not hidden.any()


def test_texels_that_a_wall_cuts_show_one_side_of_it(build, seen):
    # A thin wall at x = 0.515 through the ninth of 16 columns, whose middle, 0.531, lies beyond it.
    wall = [(0.515, -1, -1), (0.515, 2, -1), (0.515, 2, 1), (0.515, -1, 1)]
    texels = seen(*build.quads(FLOOR, wall), [0, 1], quad_uv(), (16, 16), samples=16)
    cut = texels.points.pixel % 16 == 8
    sides = texels.points.position[:, 0] > 0.515
    assert cut.sum() >= 16
    for texel in np.unique(texels.points.pixel[cut]):
        assert len(np.unique(sides[texels.points.pixel == texel])) == 1
    assert sides[cut].mean() > 0.9


def test_same_bits_for_any_number_of_threads(build, seen):
    a, b = (seen(*build.quads(FLOOR, *box((0.2, 0.2, 0), (0.6, 0.6, 1))), [0, 1], quad_uv(), (40, 50), threads=n) for n in (1, 3))
    assert all(np.array_equal(x, y) for x, y in zip(a.points, b.points))
    assert np.array_equal(a.state, b.state)


def test_number_of_samples_is_bounded(build, seen):
    with pytest.raises(ValueError, match="1 to 16"):
        seen(*build.quads(FLOOR), [0, 1], quad_uv(), (4, 4), samples=17)


def test_corner_weights_are_largest_at_their_own_corner():
    weights = corner_weights(30, 16, 1)
    full = np.concatenate([1 - weights.sum(axis=2, keepdims=True), weights], axis=2)
    assert (full.argmax(axis=2) == np.arange(30)[:, None] % 3).all() and (full >= -1e-6).all()
    # The centroid of that third of a triangle.
    assert full[0::3].mean(axis=(0, 1)) == pytest.approx((11 / 18, 7 / 36, 7 / 36), abs=0.03)
