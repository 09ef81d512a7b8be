"""Sequences, hashes, discrete tables and warps against closed forms and slow oracles."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, kstest, qmc

from lumigate.core.jit import kernel
from lumigate.core.sampling import discrete, hashing, maps, sequences


@kernel
def _sobol_raw(start, count, dimensions):
    out = np.empty((count, dimensions), np.uint32)
    for i in range(count):
        for d in range(dimensions):
            out[i, d] = sequences.reverse_bits(sequences.sobol_u32(start + i, d))
    return out


@kernel
def _map(which, u, a):
    out = np.zeros((u.shape[0], 3), np.float32)
    for i in range(u.shape[0]):
        if which == 0:
            out[i, 0], out[i, 1] = maps.concentric_disk(u[i, 0], u[i, 1])
        elif which == 1:
            out[i, 0], out[i, 1], out[i, 2] = maps.cosine_hemisphere(u[i, 0], u[i, 1])
        elif which == 2:
            out[i, 0], out[i, 1], out[i, 2] = maps.uniform_sphere(u[i, 0], u[i, 1])
        elif which == 3:
            out[i, 0], out[i, 1], out[i, 2] = maps.uniform_cone(u[i, 0], u[i, 1], a)
        else:
            out[i, 0], out[i, 1] = maps.uniform_triangle(u[i, 0], u[i, 1])
    return out


@kernel
def _frames(n):
    out = np.empty((n.shape[0], 2, 3), np.float32)
    for i in range(n.shape[0]):
        t = maps.orthonormal_basis(n[i, 0], n[i, 1], n[i, 2])
        for k in range(3):
            out[i, 0, k] = t[k]
            out[i, 1, k] = t[3 + k]
    return out


@kernel
def _alias(table, u):
    index = np.empty(u.shape[0], np.int64)
    rest = np.empty(u.shape[0], np.float32)
    for i in range(u.shape[0]):
        index[i], rest[i] = discrete.sample_alias(table, u[i])
    return index, rest


@kernel
def _cdf(cdf, u):
    index = np.empty(u.shape[0], np.int64)
    rest = np.empty(u.shape[0], np.float32)
    probability = np.empty(u.shape[0], np.float64)
    for i in range(u.shape[0]):
        index[i], rest[i], probability[i] = discrete.sample_cdf(cdf, u[i])
    return index, rest, probability


@kernel
def _shuffle(count, seed):
    out = np.empty(count, np.uint32)
    for i in range(count):
        out[i] = sequences.shuffled_index(i, seed)
    return out


@kernel
def _rotate(u, shift):
    out = np.empty(u.shape[0], np.float32)
    for i in range(u.shape[0]):
        out[i] = hashing.rotate_unit(u[i], shift[i])
    return out


def test_sobol_direction_numbers_are_scipys():
    ours = _sobol_raw(0, 256, 16).astype(np.float64) / 2**32
    gray = np.arange(256) ^ (np.arange(256) >> 1)  # SciPy walks the same points in Gray code order
    assert np.array_equal(ours[gray], qmc.Sobol(16, scramble=False, bits=32).random(256))


@pytest.mark.parametrize("seed", [0, 1, 77, 2**31 + 5])
def test_scrambled_sobol_keeps_its_stratification(seed):
    p = sequences.sobol_points(0, 64, 16, seed)
    assert p.min() >= 0 and p.max() < 1
    for d in range(16):  # one point in each of 64 intervals
        assert np.array_equal(np.sort((p[:, d] * 64).astype(int)), np.arange(64))
    for a in range(7):  # the first two dimensions: a (0, m, 2)-net, one point in each elementary box of 2^-6
        cells = (p[:, 0] * 2**a).astype(int) * 2 ** (6 - a) + (p[:, 1] * 2 ** (6 - a)).astype(int)
        assert len(np.unique(cells)) == 64


def test_scrambles_are_independent_and_uniform():
    first = np.array([sequences.sobol_points(0, 1, 2, s)[0] for s in range(4000)])
    for d in range(2):
        assert kstest(first[:, d], "uniform").pvalue > 1e-4
    assert abs(np.corrcoef(first.T)[0, 1]) < 0.06


def test_shuffled_index_permutes_blocks():
    order = _shuffle(64, 9)
    for size in (2, 8, 64):
        for block in order.reshape(-1, size):  # aligned blocks go to aligned blocks
            assert len(np.unique(block // size)) == 1
    assert len(np.unique(order)) == 64


@pytest.mark.parametrize("dimension,base", [(0, 2), (1, 3), (2, 5), (5, 13), (15, 53)])
def test_scrambled_halton_keeps_its_stratification(dimension, base):
    for seed in (3, 4):
        u = sequences.halton_points(0, base * base, 16, seed)[:, dimension].astype(np.float64)
        for n in (base, base * base):  # one point in each interval, up to float32 rounding
            inside = np.sort(u[:n]) * n - np.arange(n)
            assert inside.min() > -1e-3 and inside.max() < 1 + 1e-3


@pytest.mark.parametrize("points", [lambda n, s: sequences.sobol_points(0, n, 4, s), lambda n, s: sequences.halton_points(0, n, 4, s)])
def test_sequences_integrate_without_bias(points):
    """The mean over scrambles of a short sum is the integral; its spread is far below random sampling's."""

    def f(p):
        return np.prod(0.5 + p.astype(np.float64), axis=1)  # integral 1

    means = np.array([f(points(64, s)).mean() for s in range(200)])
    random_error = math.sqrt((13 / 12) ** 4 - 1) / 8
    assert abs(means.mean() - 1) < 4 * means.std() / math.sqrt(200) + 1e-6
    assert means.std() < 0.25 * random_error


def test_r2_is_the_plastic_lattice():
    g = 1.3247179572447460
    p = sequences.r2_points(0, 1000, 5).astype(np.float64)
    steps = (p[1:] - p[:-1]) % 1
    assert np.abs(steps - [1 / g, 1 / g**2]).max() < 3e-7
    assert qmc.discrepancy(p) < 0.1 * qmc.discrepancy(np.random.default_rng(0).random((1000, 2)))


def test_hash_is_uniform_in_every_counter():
    u = np.stack(
        [
            hashing.uniform_points(1, np.arange(20000), 0, 1)[:, 0],
            np.array([hashing.uniform_points(1, np.array([4]), s, 1)[0, 0] for s in range(20000)]),
            hashing.uniform_points(1, np.array([4]), 0, 20000)[0],
            np.array([hashing.uniform_points(s, np.array([4]), 0, 1)[0, 0] for s in range(20000)]),
        ]
    )
    assert u.min() >= 0 and u.max() < 1
    for row in u:
        counts = np.histogram(row, 64, (0, 1))[0]
        assert chi2.sf(((counts - 312.5) ** 2 / 312.5).sum(), 63) > 1e-4
        assert abs(np.corrcoef(row[1:], row[:-1])[0, 1]) < 0.03


def test_rotation_is_modulo_one():
    rng = np.random.default_rng(0)
    u, s = rng.random((2, 1000), np.float32)
    r = _rotate(u, s)
    assert r.min() >= 0 and r.max() < 1
    distance = np.abs(r.astype(np.float64) - (u.astype(np.float64) + s) % 1)
    assert np.minimum(distance, 1 - distance).max() < 1e-6


weights = st.lists(st.floats(0, 1e6, width=32), min_size=1, max_size=40)


@settings(max_examples=60, deadline=None)
@given(weights)
def test_alias_table_holds_the_weights(w):
    table = discrete.alias_table(np.array(w))
    n = len(w)
    share = np.bincount(np.arange(n), table.threshold, n) + np.bincount(table.alias, 1 - table.threshold, n)
    expected = np.array(w) / sum(w) if sum(w) > 0 else np.full(n, 1 / n)
    assert np.abs(share / n - expected).max() < 1e-6
    assert np.abs(table.probability - expected).max() < 1e-6


@settings(max_examples=60, deadline=None)
@given(weights, st.integers(0, 2**31))
def test_discrete_samplers_never_return_the_impossible(w, seed):
    w = np.array(w)
    u = np.append(np.random.default_rng(seed).random(200), [0, 1 - 2**-24]).astype(np.float32)
    possible = w > 0 if w.sum() > 0 else np.ones(len(w), bool)
    for index, rest in (_alias(discrete.alias_table(w), u), _cdf(discrete.cumulative(w), u)[:2]):
        assert possible[index].all()
        assert rest.min() >= 0 and rest.max() < 1


def test_discrete_samplers_follow_the_weights():
    w = np.array([3.0, 0, 1, 7, 0.5, 0])
    u = ((np.arange(100000) + 0.5) / 100000).astype(np.float32)
    index, rest = _alias(discrete.alias_table(w), u)
    cdf_index, cdf_rest, probability = _cdf(discrete.cumulative(w, np.float64), u.astype(np.float64))
    for i, r in ((index, rest), (cdf_index, cdf_rest)):
        assert np.abs(np.bincount(i, minlength=6) / 1e5 - w / w.sum()).max() < 5e-5
        for k in np.flatnonzero(w):  # the rest of the number is uniform again
            assert kstest(r[i == k], "uniform").statistic < 0.002
    assert np.allclose(probability, (w / w.sum())[cdf_index])
    assert (np.diff(cdf_index) >= 0).all()


def test_cumulative_in_rows():
    c = discrete.cumulative(np.array([[1.0, 3], [0, 0]]))
    assert np.allclose(c, [[0, 0.25, 1], [0, 0.5, 1]])


U = sequences.sobol_points(0, 2**14, 2, 11)


def test_concentric_disk_is_uniform():
    p = _map(0, U, 0).astype(np.float64)
    r2, phi = p[:, 0] ** 2 + p[:, 1] ** 2, np.arctan2(p[:, 1], p[:, 0])
    assert r2.max() <= 1 + 1e-6
    counts = np.histogram2d(r2, phi, (8, 8), ((0, 1 + 1e-6), (-np.pi, np.pi)))[0]
    assert np.abs(counts / len(U) * 64 - 1).max() < 0.02


def test_cosine_hemisphere_density():
    d = _map(1, U, 0).astype(np.float64)
    assert np.abs((d**2).sum(1) - 1).max() < 1e-6
    assert abs(d[:, 2].mean() - 2 / 3) < 1e-4  # integral of cos^2 / pi
    assert abs((d[:, 2] ** 2).mean() - 1 / 2) < 1e-4
    assert np.abs(d[:, :2].mean(0)).max() < 1e-3


def test_sphere_and_cone_densities():
    s = _map(2, U, 0).astype(np.float64)
    assert np.abs((s**2).sum(1) - 1).max() < 1e-6
    assert np.abs(s.mean(0)).max() < 1e-3 and np.abs((s**2).mean(0) - 1 / 3).max() < 1e-3
    for half in (1e-3, 0.4, np.pi / 2):
        omc = np.float32(2 * np.sin(half / 2) ** 2)
        c = _map(3, U, omc).astype(np.float64)
        height = (c[:, 0] ** 2 + c[:, 1] ** 2) / (1 + c[:, 2])  # 1 - cos, without cancellation
        assert height.max() <= omc * (1 + 1e-5)
        assert kstest(height / omc, "uniform").statistic < 2e-3


def test_uniform_triangle_is_uniform():
    b = _map(4, U, 0).astype(np.float64)
    u, v = b[:, 0], b[:, 1]
    assert u.min() >= 0 and v.min() >= 0 and (u + v).max() <= 1 + 1e-6
    assert abs(u.mean() - 1 / 3) < 1e-4 and abs(v.mean() - 1 / 3) < 1e-4
    assert abs((u * u).mean() - 1 / 6) < 1e-4 and abs((u * v).mean() - 1 / 12) < 1e-4


def test_basis_is_orthonormal_everywhere():
    n = _map(2, U, 0)
    n = np.concatenate([n, np.float32([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1e-4, 0, -1]])])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t, b = _frames(n).astype(np.float64).transpose(1, 0, 2)
    assert np.abs(np.cross(t, b) - n).max() < 2e-6
    assert np.abs((t * t).sum(1) - 1).max() < 2e-6 and np.abs((t * b).sum(1)).max() < 2e-6
