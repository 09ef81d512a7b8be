"""What the points of a block tell each other, against slow oracles."""

import numpy as np
import pytest

from lumigate.core.lamps import build_emitters
from lumigate.core.methods.instant_radiosity import InstantRadiosity
from lumigate.core.methods.interleaving import by_place, pixels_of
from lumigate.core.methods.virtual_area_lights import VirtualAreaLights
from lumigate.core.methods.visibility_sharing import DRAWN, LEVELS, _draw, _holders, _mix, _narrow, _surprise, _terms
from lumigate.core.metrics import relmse
from lumigate.core.particles import Vpls
from lumigate.core.rays import RayScene
from lumigate.core.transport import transport
from lumigate.core.view.points import ShadingPoints

WIDTH, SIZE, EACH = 24, 4, 8
SHARES = SIZE**2


@pytest.fixture
def points():
    """The plane z = 0 seen from above, a point a pixel."""
    found = ShadingPoints.allocate(WIDTH * WIDTH)
    for field in found:
        field[...] = 0
    found.pixel[:] = np.arange(WIDTH * WIDTH)
    found.position[:, 0], found.position[:, 1] = found.pixel % WIDTH * 0.1, found.pixel // WIDTH * 0.1
    found.ng[:, 2] = found.ns[:, 2] = found.albedo[:] = 1
    found.error[:] = 1e-6
    return found


@pytest.fixture
def lights():
    """Columns of 128 lights above that shine down."""
    rng = np.random.default_rng(7)
    columns = np.zeros((11, SHARES * EACH), np.float32)
    columns[0:2], columns[2], columns[5] = rng.uniform(0, 2.4, (2, SHARES * EACH)), 1.5, -1
    columns[6:9] = rng.uniform(0.5, 1.5, (3, SHARES * EACH))
    columns[9] = columns[6:9].mean(axis=0)
    return columns


def test_terms_against_a_loop(points, lights):
    term = np.empty(SHARES * EACH, np.float32)
    p = points.position[77]
    _terms(lights, *p, np.float32(0.6), np.float32(0), np.float32(0.8), np.float32(0), np.float32(0), np.float32(1), np.float32(0.5), term)
    for j in range(len(term)):
        d = lights[:3, j].astype(np.float64) - p
        g = max(d @ [0.6, 0, 0.8], 0) * max(-d @ lights[3:6, j], 0) / (d @ d) ** 2
        assert term[j] == pytest.approx(min(g, 0.5), rel=1e-4, abs=1e-6)


def test_bilinear_mean_of_those_that_hold_a_share(points):
    pixels = pixels_of(points, WIDTH, SIZE)
    codes = np.random.default_rng(1).integers(1, LEVELS + 1, (WIDTH * WIDTH, EACH)).astype(np.uint8)
    agreed, facing, guessed = np.zeros(SHARES, bool), np.ones(SHARES, bool), np.empty(SHARES, bool)
    holder, weight = np.empty((SHARES, 4), np.int64), np.empty((SHARES, 4), np.float32)
    visible, low, high = (np.empty(SHARES * EACH, np.float32) for _ in range(3))
    x, y = 10, 9
    place = y * WIDTH + x
    _holders(
        pixels, by_place(points, pixels), place, x, y, x // SIZE * SIZE, y // SIZE * SIZE, np.float32(1e9), agreed, facing, holder, weight, guessed
    )  # fmt: skip
    _mix(codes, agreed, facing, holder, weight, guessed, visible, low, high)
    assert not guessed.any()
    for share in range(SHARES):
        expected, total, around = np.zeros(EACH), 0, []
        for v in range(y - SIZE + 1, y + SIZE):
            for u in range(x - SIZE + 1, x + SIZE):
                if u % SIZE == pixels.across[share] and v % SIZE == pixels.down[share]:
                    w = (1 - abs(u - x) / SIZE) * (1 - abs(v - y) / SIZE)
                    seen = (codes[v * WIDTH + u] - 1.0) / (LEVELS - 1)
                    expected, total = expected + w * seen, total + w
                    around.append(seen)
        at = slice(share * EACH, (share + 1) * EACH)
        assert total == pytest.approx(1)
        assert np.allclose(visible[at], expected, atol=1e-5)
        assert np.allclose(low[at], np.min(around, axis=0), atol=1e-6) and np.allclose(high[at], np.max(around, axis=0), atol=1e-6)


def test_other_surfaces_are_a_guess(points):
    points.ng[:, 2], points.ng[:, 0] = 0, 1
    points.ng[100] = 0, 0, 1
    pixels = pixels_of(points, WIDTH, SIZE)
    agreed, facing, guessed = np.zeros(SHARES, bool), np.ones(SHARES, bool), np.empty(SHARES, bool)
    holder, weight = np.empty((SHARES, 4), np.int64), np.empty((SHARES, 4), np.float32)
    y, x = divmod(100, WIDTH)
    _holders(
        pixels, by_place(points, pixels), 100, x, y, x // SIZE * SIZE, y // SIZE * SIZE, np.float32(1e9), agreed, facing, holder, weight, guessed
    )  # fmt: skip
    assert guessed.sum() == SHARES - 1  # it knows its own


@pytest.mark.parametrize("u", [0.0, 0.3, 0.99])
def test_drawn_lights_give_all_light_where_all_are_seen(points, lights, u):
    term = np.random.default_rng(5).uniform(0, 1, SHARES * EACH).astype(np.float32) ** 4
    chosen, scale = np.empty(SHARES * EACH + 1, np.int64), np.empty(SHARES * EACH + 1, np.float32)
    count = _draw(lights, term, np.float32(u), chosen, scale)
    assert 0 < count <= DRAWN + 1 and len(np.unique(chosen[:count])) == count
    light = term * lights[9]
    assert (scale[:count] * light[chosen[:count]]).sum() == pytest.approx(light.sum(), rel=1.5 / DRAWN)


def test_drawing_has_no_bias(lights):
    term = np.random.default_rng(6).uniform(0, 1, SHARES * EACH).astype(np.float32)
    visible = np.random.default_rng(7).uniform(0, 1, SHARES * EACH)
    chosen, scale = np.empty(SHARES * EACH + 1, np.int64), np.empty(SHARES * EACH + 1, np.float32)
    light = term * lights[9]
    sums = []
    for u in (np.arange(500) + 0.5) / 500:
        count = _draw(lights, term, np.float32(u), chosen, scale)
        at = chosen[:count]
        sums.append((scale[:count] * light[at] * visible[at]).sum())
    assert np.mean(sums) == pytest.approx((light * visible).sum(), rel=0.01)


def test_a_strip_that_is_narrower_than_a_block_is_noticed(points, lights):
    pixels = pixels_of(points, WIDTH, SIZE)
    x = points.pixel % WIDTH
    seen = np.full((WIDTH * WIDTH, EACH), LEVELS, np.uint8)
    seen[x == 12] = 1
    share = np.argsort(pixels.down * SIZE + pixels.across)[(points.pixel // WIDTH % SIZE) * SIZE + x % SIZE]
    light, narrow = np.empty((WIDTH * WIDTH, 2), np.float32), np.empty(WIDTH * WIDTH, bool)
    table = by_place(points, pixels)
    _surprise(points, pixels, table, lights, seen, 0, len(seen), np.float32(1e9), np.float32(1e9), share, light)
    _narrow(points, pixels, light, 0, len(seen), narrow)
    assert narrow[(x >= 11) & (x <= 13)].all() and not narrow[(x < 11) | (x > 13)].any()


def test_a_slit_between_lit_floors(build):
    # A floor below two boards a hand above it, whose gap lets light through to a strip three pixels wide; all have one normal.
    boards = [
        [(-2, -2, 0.1), (-0.05, -2, 0.1), (-0.05, 2, 0.1), (-2, 2, 0.1)],
        [(0.05, -2, 0.1), (2, -2, 0.1), (2, 2, 0.1), (0.05, 2, 0.1)],
    ]
    shade = [(-0.5, -0.5, 1), (0.5, -0.5, 1), (0.5, 0.5, 1), (-0.5, 0.5, 1)]
    geometry = build.geometry(*build.quads([(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], *boards, shade))
    scene = build.scene(geometry, build.materials((0.5, 0.0)))
    side = 96
    at = ShadingPoints.allocate(side * side)
    for field in at:
        field[...] = 0
    at.pixel[:] = np.arange(side * side)
    at.position[:, 0] = (at.pixel % side + 0.5) / side * 3 - 1.5
    at.position[:, 1] = (at.pixel // side + 0.5) / side * 3 - 1.5
    at.position[:, 2] = np.where(np.abs(at.position[:, 0]) < 0.05, 0, 0.1)
    at.ng[:, 2] = at.ns[:, 2] = 1
    at.error[:] = 1e-6
    rng = np.random.default_rng(3)
    vpls = Vpls.allocate(512)
    for field in vpls:
        field[...] = 0
    vpls.position[:] = np.column_stack([rng.uniform(-1.9, 1.9, (512, 2)), np.full(512, 2.0)])
    vpls.normal[:, 2], vpls.flux[:], vpls.error[:], vpls.bounce[:] = -1, 1, 1e-6, 1
    vpls.surface_normal[:] = vpls.normal
    with RayScene(geometry.vertices, geometry.triangles) as rays:
        tables = transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))
        found = []
        for solver in (VirtualAreaLights(vals=30, width=side, compensation=0), InstantRadiosity(compensation=0)):
            solver.prepare(tables, vpls, at)
            found.append(solver.irradiance(at).reshape(side, side, 3))
    assert relmse(*found) < 0.03
    assert found[0].mean() == pytest.approx(found[1].mean(), rel=0.02)
    strip = np.abs(at.position[:side, 0]) < 0.05
    assert found[0][:, strip].mean() == pytest.approx(found[1][:, strip].mean(), rel=0.15)
