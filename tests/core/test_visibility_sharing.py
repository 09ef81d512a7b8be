"""What points draw, and what neighbours make of it, against slow oracles."""

import numpy as np
import pytest

from lumigate.core.lamps import build_emitters
from lumigate.core.methods.instant_radiosity import InstantRadiosity
from lumigate.core.methods.virtual_area_lights import VirtualAreaLights
from lumigate.core.methods.visibility_sharing import BLOCK, LEAST_DOUBT, PART, _draw, _part_sums, _rank, _terms, _weigh
from lumigate.core.metrics import relmse
from lumigate.core.particles import Vpls
from lumigate.core.rays import RayScene
from lumigate.core.transport import transport
from lumigate.core.view.points import ShadingPoints

WIDTH, COUNT = 24, 128


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
    columns = np.zeros((11, COUNT), np.float32)
    columns[0:2], columns[2], columns[5] = rng.uniform(0, 2.4, (2, COUNT)), 1.5, -1
    columns[6:9] = rng.uniform(0.5, 1.5, (3, COUNT))
    columns[9] = columns[6:9].mean(axis=0)
    return columns


def test_terms_against_a_loop(points, lights):
    term = np.empty(COUNT, np.float32)
    p = points.position[77]
    _terms(lights, *p, np.float32(0.6), np.float32(0), np.float32(0.8), np.float32(0), np.float32(0), np.float32(1), np.float32(0.5), term)
    for j in range(len(term)):
        d = lights[:3, j].astype(np.float64) - p
        g = max(d @ [0.6, 0, 0.8], 0) * max(-d @ lights[3:6, j], 0) / (d @ d) ** 2
        assert term[j] == pytest.approx(min(g, 0.5), rel=1e-4, abs=1e-6)


def test_light_and_importance_against_numpy(lights):
    rng = np.random.default_rng(4)
    term, visible = rng.uniform(0, 1, (2, COUNT)).astype(np.float32)
    importance = np.empty(COUNT, np.float32)
    sums = _weigh(lights, term, visible, importance)
    assert np.allclose(sums[:3], (term * lights[6:9]).sum(axis=1), rtol=1e-5)
    assert np.allclose(sums[3:], (visible * term * lights[6:9]).sum(axis=1), rtol=1e-5)
    doubt = np.maximum(np.sqrt(visible * (1 - visible)), LEAST_DOUBT)
    assert np.allclose(importance, term * lights[9] * doubt, rtol=1e-5)


def drawn(importance, count, u):
    """Lights drawn, and the weights of what each gives."""
    parts = np.empty(COUNT // PART, np.float32)
    total = _part_sums(importance, parts)
    chosen, weight = np.empty(count, np.int64), np.empty(count, np.float32)
    _draw(importance, parts, total, np.float32(u), chosen, weight)
    return chosen, weight


@pytest.mark.parametrize("u", [0.0, 0.3, 0.99])
def test_draws_stand_for_all_importance(u):
    importance = np.random.default_rng(5).uniform(0, 1, COUNT).astype(np.float32) ** 4
    chosen, weight = drawn(importance, 16, u)
    assert (np.diff(chosen) >= 0).all()  # a stratum each
    assert len(np.unique(chosen[weight > 0])) == np.count_nonzero(weight)  # each light is traced once
    assert (weight * importance[chosen]).sum() == pytest.approx(importance.sum(), rel=1e-4)


def test_drawing_has_no_bias():
    rng = np.random.default_rng(6)
    importance, light = rng.uniform(0, 1, (2, COUNT)).astype(np.float32)
    sums = []
    for u in (np.arange(500) + 0.5) / 500:
        chosen, weight = drawn(importance, 16, u)
        sums.append((weight * light[chosen]).sum())
    assert np.mean(sums) == pytest.approx(light.sum(), rel=0.01)


def test_lights_without_importance_are_not_drawn():
    importance = np.zeros(COUNT, np.float32)
    importance[[3, 40, 41, 100]] = 1, 2, 1e-12, 1
    for u in np.linspace(0, 1, 33)[:-1]:
        chosen, weight = drawn(importance, 32, u)
        assert np.isin(chosen[weight > 1e-3], [3, 40, 100]).all() and weight.max() <= 4 / 32 * 32


def test_ranks_fill_blocks_evenly():
    ranks = np.array([[_rank(x, y) for x in range(BLOCK)] for y in range(BLOCK)])
    assert np.array_equal(np.sort(ranks, axis=None), np.arange(BLOCK**2))
    for y in range(0, BLOCK, 2):
        for x in range(0, BLOCK, 2):
            assert np.array_equal(np.sort(ranks[y : y + 2, x : x + 2] // 16, axis=None), np.arange(4))


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
