"""Lightmaps from arrays: a closed form, what UV maps are refused, margins, seams, and denoised edges."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.denoise import Denoiser
from lumigate.core.errors import SceneError
from lumigate.core.lightmaps import Target, bake, check_charts, filling, seams
from lumigate.core.settings import BakeSettings, RenderSettings
from lumigate.core.stages import AVAILABLE as METHODS
from lumigate.core.threads import Cancelled
from lumigate.core.view.texels import EMPTY, HIDDEN, LIT, Charts

CORNERS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
INWARD = [(2, 3, 1, 0), (5, 7, 6, 4), (1, 5, 4, 0), (6, 7, 3, 2), (4, 6, 2, 0), (3, 7, 5, 1)]


def cells(count, columns, gap=0.1):
    """UV coordinates (2 count, 3, 2) of quads, each in a cell of its own."""
    rows = -(-count // columns)
    low = np.array([(k % columns, k // columns) for k in range(count)], float)
    square = np.array([(gap, gap), (1 - gap, gap), (1 - gap, 1 - gap), (gap, 1 - gap)])
    corners = (low[:, None] + square) / (columns, rows)
    return corners[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 2).astype(np.float32)


@pytest.fixture(scope="module")
def furnace(build):
    """A closed cube of albedo 0.5 and radiance 1, without a camera, and the target of all its walls."""
    scene = build.scene(build.geometry(*build.quads(*[[CORNERS[k] for k in face] for face in INWARD])), build.materials((0.5, 1.0)))
    scene.camera = None
    return scene, Target("Walls", np.arange(12, dtype=np.int32), cells(6, 3), (48, 32))


def settings(method="auto", seed=3, content="irradiance", **more):
    return BakeSettings(RenderSettings(method=method, vpls=512, bounces=2, direct_samples=32, seed=seed), content=content, **more)


@pytest.mark.parametrize("method", METHODS)
def test_furnace(furnace, method):
    # Radiance 1 from everywhere: irradiance pi directly, and (rho + rho^2) pi after two bounces.
    scene, target = furnace
    direct, indirect = np.pi, np.pi * (0.5 + 0.25)
    if method == "fuzzy-clustering":  # its clusters of points are as large as the walls where texels are few
        target = replace(target, size=(96, 64))
    expected = {"irradiance": direct + indirect, "indirect": indirect, "full": 0.5 * (direct + indirect) / np.pi + 1.0}
    for content, value in expected.items():
        found = [bake(scene, [target], settings(method, seed, content)).lightmaps[0] for seed in (1, 2)]
        lit = found[0].state == LIT
        assert np.mean([lightmap.image[lit] for lightmap in found]) == pytest.approx(value, rel=0.01), content


def test_every_texel_of_the_furnace_is_right(furnace):
    scene, target = furnace
    lightmap = bake(scene, [target], settings()).lightmaps[0]
    expected = 1.75 * np.pi
    assert np.percentile(np.abs(lightmap.image[lightmap.state == LIT] - expected), 99) < 0.15 * expected


@pytest.mark.filterwarnings("error")
def test_what_no_light_reaches_is_black_and_told(build):
    # The outside of a shining cube sees nothing.
    outward = [[CORNERS[k] for k in face[::-1]] for face in INWARD]
    scene = build.scene(build.geometry(*build.quads(*outward)), build.materials((0.5, 1.0)))
    result = bake(scene, [Target("Walls", np.arange(12, dtype=np.int32), cells(6, 3), (48, 32))], settings())
    lightmap = result.lightmaps[0]
    assert (lightmap.state == LIT).any() and not lightmap.image.any()
    assert any(line.startswith("no light reaches 'Walls'") and "Recalculate Outside" in line for line in result.stats["warnings"])


def test_shadows_of_leaves_stay_sharp(build, monkeypatch):
    """Of a texel or two: the denoiser takes them for noise."""
    floor = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    low = np.random.default_rng(1).uniform(-1.3, 1.3, (900, 2))
    leaves = [[(x, y, 0.3), (x, y + 0.04, 0.3), (x + 0.04, y + 0.04, 0.3), (x + 0.04, y, 0.3)] for x, y in low]
    scene = build.scene(
        build.geometry(*build.quads(floor, *leaves), np.repeat([0] + len(leaves) * [1], 2)),
        build.materials((0.5, 0.0), (0.0, 0.0)),
        lamps=build.lamp(sc.SUN, 4.0, axes=np.linalg.qr([[1, 0, 0.1], [0, 1, 0.3], [-0.1, -0.3, 1.0]])[0].T, angle=0.009),
    )
    scene.camera = None
    target = Target("Floor", np.arange(2, dtype=np.int32), cells(1, 1, gap=0.05), (64, 64))

    def image(**more):
        render = RenderSettings(vpls=256, bounces=1, seed=1, **more)
        return bake(scene, [target], BakeSettings(render, content="irradiance", texel_samples=16)).lightmaps[0]

    expected = image(denoise=False, direct_samples=256)
    lit = expected.state == LIT

    def error():
        return np.mean((image().image[lit] - expected.image[lit]) ** 2)

    sharp = error()
    monkeypatch.setattr(filling, "give_shadows_back", lambda clean, light, threads: None)
    smeared = error()
    assert sharp < 0.1 * smeared


def test_images_are_lit_together_and_kept_apart(furnace):
    scene, target = furnace
    one, two = (Target(f"{k}", target.triangles[part], target.uv[part], (48, 32)) for k, part in enumerate((slice(0, 4), slice(4, 12))))
    result = bake(scene, [one, two], settings())
    assert [lightmap.image.shape for lightmap in result.lightmaps] == [(32, 48, 3)] * 2
    assert result.stats["images"] == {"0": [48, 32], "1": [48, 32]}
    covered = [(lightmap.state == LIT).sum() for lightmap in result.lightmaps]
    assert covered[1] == pytest.approx(2 * covered[0], rel=0.05)
    for lightmap in result.lightmaps:
        assert lightmap.image[lightmap.state == LIT].mean() == pytest.approx(1.75 * np.pi, rel=0.05)


def test_same_bits_for_any_number_of_threads(furnace):
    scene, target = furnace
    a, b = (
        bake(scene, [target], BakeSettings(RenderSettings(vpls=256, bounces=2, seed=3, threads=n, denoise=False))).lightmaps[0]
        for n in (1, 3)
    )
    assert np.array_equal(a.image, b.image)


def test_a_bake_can_be_cancelled(furnace):
    scene, target = furnace
    with pytest.raises(Cancelled):
        bake(scene, [target], settings(), lambda stage, fraction: stage != "indirect")


def test_unknown_content_is_refused(furnace):
    with pytest.raises(SceneError, match="irradiance, indirect, full"):
        bake(furnace[0], [furnace[1]], settings(content="albedo"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda uv: uv.__setitem__(0, uv[0] + 1), ["'A'", "outside"]),
        (lambda uv: uv.__setitem__((11, 0), np.nan), ["'B'", "invalid"]),
        (lambda uv: uv.__setitem__(slice(6, 12), 0.5), ["'B'", "no area"]),
        (lambda uv: uv.__setitem__(slice(10, 12), uv[:2]), ["'A', 'B'", "overlap"]),
        (lambda uv: uv.__setitem__(3, uv[3] + (0.02, 0)), ["'A'", "overlap", "Array"]),
    ],
)
def test_unfit_maps_are_refused_in_one_line(change, words):
    uv, owner = cells(6, 3), np.repeat([0, 1], 6)
    check_charts(uv, owner, ["A", "B"], "Map")
    change(uv)
    with pytest.raises(SceneError) as error:
        check_charts(uv, owner, ["A", "B"], "Map")
    assert "\n" not in str(error.value)
    assert all(word in str(error.value) for word in [*words, "'Map'"])


def test_faces_that_share_edges_do_not_overlap():
    # A fan of slivers about a point, and a grid turned by an odd angle: rounding is no overlap.
    angle = np.linspace(0, 2 * np.pi, 101)
    rim = 0.5 + 0.4 * np.column_stack([np.cos(angle), np.sin(angle)])
    fan = np.stack([np.full((100, 2), 0.5), rim[:-1], rim[1:]], axis=1).astype(np.float32)
    check_charts(fan, np.zeros(100, int), ["Fan"], "Map")


def extended(image, state, margin):
    return filling.extended(image, state, filling.surroundings(state), margin)


def test_margins_are_the_nearest_texels_light():
    rng = np.random.default_rng(2)
    state = np.where(rng.random((20, 30)) < 0.05, LIT, EMPTY).astype(np.uint8)
    image = rng.random((20, 30, 3)).astype(np.float32) * (state == LIT)[..., None]
    out, filled = extended(image, state, 2)
    at = np.argwhere(state == LIT)
    for y in range(20):
        for x in range(30):
            distance = np.hypot(*(at - (y, x)).T)
            assert filled[y, x] == (distance.min() <= 2)
            nearest = image[tuple(at[np.isclose(distance, distance.min())].T)]
            assert (filled[y, x] and (out[y, x] == nearest).all(axis=1).any()) or not out[y, x].any()


def test_hidden_texels_are_filled_however_far_and_strays_are_hidden():
    state = np.full((40, 40), HIDDEN, np.uint8)
    state[:, 0] = LIT
    state[20, 20] = LIT
    cleaned = filling.without_strays(state)
    assert cleaned[20, 20] == HIDDEN and (cleaned[:, 0] == LIT).all()
    image = np.zeros((40, 40, 3), np.float32)
    image[:, 0] = 3.0
    out, filled = extended(image, cleaned, 1)
    assert filled.all() and (out == 3).all()


def test_strays_at_the_edge_of_a_chart_are_hidden_and_small_charts_are_not():
    state = np.zeros((20, 20), np.uint8)
    state[5:15, 5:15] = HIDDEN
    state[5, 9] = state[5, 5] = LIT  # amid the upper edge, and in its corner
    state[5:15, 12:15] = LIT
    state[17, 3:5] = HIDDEN, LIT  # a chart of two texels
    cleaned = filling.without_strays(state)
    assert cleaned[5, 9] == cleaned[5, 5] == HIDDEN
    assert (cleaned[5:15, 12:15] == LIT).all() and cleaned[17, 4] == LIT


def test_denoising_leaves_no_dark_edges():
    rng = np.random.default_rng(3)
    state = np.zeros((64, 64), np.uint8)
    state[8:30, 8:56] = state[40:60, 8:56] = LIT
    lit = state == LIT
    noisy = np.where(lit[..., None], rng.gamma(4, 0.25, (64, 64, 1)), 0).astype(np.float32) * np.ones(3, np.float32)
    normal = np.zeros((64, 64, 3), np.float32)
    normal[:35, :, 2], normal[35:, :, 0] = lit[:35], lit[35:]
    with closing(Denoiser()) as denoiser:
        clean = filling.denoised(noisy, normal, normal * 0, filling.surroundings(state), denoiser, 2)
    assert not clean[~lit].any()
    assert clean[lit].mean() == pytest.approx(noisy[lit].mean(), rel=0.01)
    assert clean[lit].std() < 0.1 * noisy[lit].std()
    rim = lit & ~np.pad(lit, 1)[2:, 1:-1] | lit & ~np.pad(lit, 1)[:-2, 1:-1]
    assert clean[rim].mean() == pytest.approx(1.0, abs=0.1)


class Unchanged:
    """Denoises nothing, and keeps what it was given."""

    def denoise(self, color, albedo, normal, **_):
        assert color.shape == albedo.shape == normal.shape
        self.color, self.normal = color, normal
        return color


def test_charts_are_denoised_close_together_and_come_back_to_their_places():
    rng = np.random.default_rng(4)
    state = np.zeros((200, 120), np.uint8)
    for y, x, height, width in ((3, 2, 30, 40), (90, 70, 20, 50), (150, 5, 1, 9), (170, 100, 30, 20)):
        state[y : y + height, x : x + width] = LIT
    state[93:100, 80:90] = HIDDEN
    lit = state == LIT
    image, normal = (np.where(lit[..., None], rng.random((200, 120, 3)), 0).astype(np.float32) for _ in range(2))
    denoiser, around = Unchanged(), filling.surroundings(state)
    clean = filling.denoised(image, normal, normal, around, denoiser, 1)
    assert clean == pytest.approx(image, abs=1e-6)
    assert denoiser.color[..., 0].size < 0.5 * state.size
    # Each chart is seen with its mirror image around it, as in the whole image.
    packed = filling.packing(lit)
    whole = image.reshape(-1, 3)[around.mirrored]
    assert np.array_equal(denoiser.color, whole.reshape(-1, 3)[packed.source])
    y, x = np.argwhere(lit)[::97].T
    down, right = packed.place[y, x] // packed.source.shape[1], packed.place[y, x] % packed.source.shape[1]
    for dy, dx in ((-5, 0), (0, -2), (4, 4)):
        inside = (y + dy >= 0) & (y + dy < 200) & (x + dx >= 0) & (x + dx < 120)
        beside = packed.source[(down + dy)[inside], (right + dx)[inside]]
        assert np.array_equal(beside, ((y + dy) * 120 + x + dx)[inside])


def test_charts_that_fill_their_image_stay_where_they_are():
    assert filling.packing(np.ones((40, 30), bool)) is None
    scattered = np.zeros((60, 60), bool)
    scattered[::5, ::5] = True  # each would take its surroundings along
    assert filling.packing(scattered) is None


@pytest.fixture
def cut_plane(build):
    """Geometry of two unit squares side by side, and charts that hold them apart: the shared edge x = 1 is a seam of two texel columns."""
    left, right = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(1, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0)]
    uv = np.concatenate([cells(1, 1, 0.2) * (0.5, 1), cells(1, 1, 0.2)[:, :, ::-1] * (0.5, 1) + (0.5, 0)]).astype(np.float32)
    return build.geometry(*build.quads(left, right)), Charts.of(np.arange(4), uv, (64, 32))


def state_of(charts, size):
    """Texels whose middles lie in a chart's bounding box."""
    y, x = np.mgrid[0 : size[1], 0 : size[0]] + 0.5
    state = np.zeros((size[1], size[0]), np.uint8)
    for pair in charts.uv.reshape(2, 6, 2):
        (x0, y0), (x1, y1) = pair.min(axis=0), pair.max(axis=0)
        state[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = LIT
    return state


def test_seams_are_the_cut_edges_only(cut_plane):
    found = seams.find_seams(*cut_plane)
    assert len(found.a) == 1
    # The right square is laid out turned: its edge x = 1 lies along its chart's bottom.
    ends = np.sort(found.b[0], axis=0)
    assert ends[:, 1] == pytest.approx(ends[0, 1])


def test_sharp_edges_are_no_seams(build):
    floor, wall = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(1, 0, 0), (1, 0, 1), (1, 1, 1), (1, 1, 0)]
    assert len(seams.find_seams(build.geometry(*build.quads(floor, wall)), Charts.of(np.arange(4), cells(2, 2), (64, 32))).a) == 0


def test_stitching_closes_seams_and_leaves_the_rest(cut_plane):
    geometry, charts = cut_plane
    found = seams.find_seams(geometry, charts)
    state = state_of(charts, (64, 32))
    rng = np.random.default_rng(4)
    image = (rng.random((32, 64, 3)) * 0.4 + 0.8).astype(np.float32)
    image[:, 32:] *= 1.3
    image, filled = extended(image, state, 3)
    out = seams.stitched(image, state == LIT, filled, found)
    assert seams.seam_error(image, filled, found) > 0.2
    assert seams.seam_error(out, filled, found) < 0.2 * seams.seam_error(image, filled, found)
    assert out[state == LIT].mean() == pytest.approx(image[state == LIT].mean(), rel=0.01)
    # Nothing but the texels around the seam has moved.
    changed = (out != image).any(axis=2)
    assert 0 < changed.sum() < 4 * 32
    assert (out >= 0).all()


def test_what_agrees_stays_as_it_is(cut_plane):
    geometry, charts = cut_plane
    image, filled = extended(np.full((32, 64, 3), 2.5, np.float32), state_of(charts, (64, 32)), 3)
    out = seams.stitched(image, filled, filled, seams.find_seams(geometry, charts))
    np.testing.assert_allclose(out, image, rtol=1e-5)
