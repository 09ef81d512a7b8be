"""Learnt visibility of the lamps of the tree: it spares rays into walls, and takes no light away."""

from types import SimpleNamespace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.jit import kernel
from lumigate.core.lamps import build_emitters
from lumigate.core.lamps import tree_build as tb
from lumigate.core.lamps.direct import direct_irradiance
from lumigate.core.lamps.seen import LEAST, learn
from lumigate.core.lamps.tables import AXIS, COS_O, ENERGY, LOWER, UPPER
from lumigate.core.rays import RayScene
from lumigate.core.stages import one_by_one
from lumigate.core.transport import transport

SIDE = 40  # points along each side of the floor
TOO_FEW = 400  # points, for which nothing is learnt


@kernel
def _learn(tree, known, nodes):
    learn(tree, known[0], known[1], known[2], nodes)


def _tree(count):
    """Lamps in a row that shine to all sides, each of energy 1."""
    rows = np.zeros((count, tb.COLUMNS))
    rows[:, LOWER] = rows[:, UPPER] = np.arange(count)
    rows[:, AXIS + 2], rows[:, COS_O], rows[:, ENERGY] = 1, -1, 1
    return tb.light_tree(rows, np.arange(count))


def _energies(tree, tried, seen):
    known = np.zeros((3, len(tree.nodes)), np.float32)
    known[0, : len(tried)], known[1, : len(seen)] = tried, seen
    nodes = tree.nodes.copy()
    _learn(tree, known, nodes)
    return nodes[:, ENERGY]


def test_energies_go_with_the_root_of_what_is_seen():
    tree, n = _tree(16), 16
    tried, seen = np.full(n, 1e4), np.where(np.arange(n) < 8, 1e4, 2.5e3)
    assert _energies(tree, tried, seen)[:n] == pytest.approx(np.where(np.arange(n) < 8, 1, 0.5), rel=1e-3)
    assert np.array_equal(_energies(tree, np.zeros(n), np.zeros(n)), tree.nodes[:, ENERGY])
    assert np.array_equal(_energies(tree, tried, tried), tree.nodes[:, ENERGY])


def test_no_lamp_is_given_up():
    tree, n = _tree(50), 50
    energy = _energies(tree, np.full(n, 1e6), np.zeros(n))
    assert energy[:n] == pytest.approx(LEAST**0.5)
    assert energy[tree.root] == pytest.approx(energy[:n].sum())
    for k, (left, right) in enumerate(tree.children):
        assert energy[n + k] == pytest.approx(energy[left] + energy[right])


def test_lamps_that_no_ray_has_tried_are_taken_for_their_neighbours():
    tree, n = _tree(32), 32
    tried = np.where(np.arange(n) % 2, 20, 0)
    energy = _energies(tree, tried, np.where(np.arange(n) < 16, tried, 0))[:n]
    assert energy[:14:2].min() > 0.9 and energy[18::2].max() < 0.5


@pytest.fixture(scope="module")
def halves(build):
    """A floor before and behind a wall with a slit under it; 2 lamps before it, 30 behind, low ones among them -> (tables, points of the floor before it, (N, 3) m)."""
    floor = [[-4, -4, 0], [4, -4, 0], [-4, 4, 0], [4, 4, 0]]
    wall = [[0, -9, 0.06], [0, 9, 0.06], [0, -9, 9], [0, 9, 9]]
    scene = build.scene(build.geometry(floor + wall, [[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]]), build.materials((0.6, 0.0)))
    rng = np.random.default_rng(4)
    position = np.concatenate([[[-2, -1, 2], [-1, 2, 2.5]], rng.uniform([0.3, -4, 0.1], [2, 4, 0.8], (30, 3))]).astype(np.float32)
    scene.lamps = build.lamps(*(build.lamp(sc.POINT, 10, at) for at in position))
    u = (np.arange(SIDE) + 0.5) / SIDE
    position = np.zeros((SIDE**2, 3), np.float32)
    position[:, :2] = np.stack(np.meshgrid(-3.9 * u, 8 * u - 4, indexing="ij"), axis=-1).reshape(-1, 2)
    with RayScene(scene.geometry.vertices, scene.geometry.triangles) as rays:
        yield transport(scene.geometry, scene.materials.tables, rays.tables, build_emitters(scene)), position


def _light(tables, at, samples, seed, threads=0):
    """Irradiance at N points of the floor, (N, 3) float64, and the number of rays."""
    up = np.tile(np.float32([0, 0, 1]), (len(at), 1))
    points = SimpleNamespace(position=at, ns=up, ng=up, error=np.full(len(at), 1e-6, np.float32))
    light, rays = direct_irradiance(tables, points, samples, seed, threads)
    return light.astype(np.float64), rays


def _truth(tables, at):
    """Each lamp by a ray of its own: points have no size, so that this is exact."""
    every = tables._replace(emitters=one_by_one(tables.emitters))
    return _light(every, at, len(tables.emitters.kind), 0)[0]


def _error(light, truth):
    return ((light - truth) ** 2 / (truth**2 + 0.01 * truth.mean() ** 2)).mean()


def _unlearnt(tables, at, seed):
    """By pieces for which nothing is learnt."""
    pieces = range(0, len(at), TOO_FEW)
    return np.concatenate([_light(tables, at[k : k + TOO_FEW], 8, 7919 * seed + k)[0] for k in pieces])


def test_light_through_a_slit_stays(halves):
    tables, at = halves
    assert list(tables.emitters.groups) == [-1]
    truth = _truth(tables, at)
    front = one_by_one(tables.emitters)
    front = front._replace(groups=front.groups[:2].copy())
    by_slit = truth - _light(tables._replace(emitters=front), at, 2, 0)[0]
    assert by_slit.sum() > 0.02 * truth.sum()  # the lamps behind matter
    mean = np.mean([_light(tables, at, 8, seed)[0] for seed in range(200)], axis=0)
    assert mean.mean() == pytest.approx(truth.mean(), rel=0.003)
    lit = by_slit > 1e-3 * truth
    assert (mean - truth)[lit].sum() == pytest.approx(0, abs=0.05 * by_slit[lit].sum())


def test_rays_go_where_lamps_are_seen(halves):
    tables, at = halves
    truth = _truth(tables, at)
    learnt = np.mean([_error(_light(tables, at, 8, seed)[0], truth) for seed in range(20)])
    unlearnt = np.mean([_error(_unlearnt(tables, at, seed), truth) for seed in range(20)])
    assert learnt < 0.5 * unlearnt


def test_pilots_are_few(halves):
    tables, at = halves
    for samples in (1, 4, 16):
        assert _light(tables, at, samples, 0)[1] <= len(at) * (samples + max(1, samples // 2) / 16)


def test_the_same_bits_for_any_number_of_threads(halves):
    tables, at = halves
    many = np.tile(at, (6, 1))  # several chunks
    one, three = (_light(tables, many, 4, 3, threads)[0] for threads in (1, 3))
    assert np.array_equal(one, three)
