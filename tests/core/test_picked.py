"""Points of crowded pixels that stand for the others: few, by what they show, and right in the mean."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core import pipeline
from lumigate.core.pipeline import render
from lumigate.core.view.picked import most_each, picked
from lumigate.core.view.points import ShadingPoints, glossy_albedos
from lumigate.headless.stress import rooms


def crowd(counts, seed=0):
    """Points of pixels that show so many each, in no order, of different albedos; one in five shows nothing."""
    random = np.random.default_rng(seed)
    pixel = random.permutation(np.repeat(np.arange(len(counts)), counts))
    points = ShadingPoints.allocate(len(pixel))
    points.pixel[:] = pixel
    points.ns[:] = points.ng[:] = points.wo[:] = 0, 0, 1
    points.albedo[:] = random.random((len(pixel), 3)) ** 4 * (random.random((len(pixel), 1)) > 0.2)
    points.f0[:] = points.f90[:] = 0.1 * random.random((len(pixel), 1)) * (points.albedo > 0)
    points.roughness[:] = 0.5
    return points


def shown(points):
    return (points.albedo + glossy_albedos(points)).sum(axis=1)


def test_nothing_is_picked_where_pixels_are_not_crowded():
    assert picked(crowd([1, 5, 0, 2]), 3, 0) is None
    assert picked(ShadingPoints.allocate(0), 3, 0) is None


@given(st.lists(st.integers(0, 20), max_size=30), st.floats(1, 20))
def test_pixels_have_so_many_in_the_mean(counts, mean):
    pixel = np.repeat(np.arange(len(counts)), counts)
    most, lit = most_each(pixel, mean), np.count_nonzero(counts)
    if most is None:
        assert sum(counts) <= mean * lit
        return
    kept = [np.minimum(counts, k).sum() for k in (most, most + 1)]
    assert kept[0] <= mean * lit < kept[1]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 20), min_size=1, max_size=30), st.floats(1, 5), st.integers(0, 2**31))
def test_as_many_as_there_may_be_show_as_much_as_all(counts, mean, seed):
    points = crowd(counts, seed)
    few, most = picked(points, mean, seed), most_each(points.pixel, mean)
    assert (few is None) == (most is None)
    if few is None:
        return
    assert (np.diff(few.index) > 0).all()
    np.testing.assert_array_equal(np.bincount(few.points.pixel, minlength=len(counts)), np.minimum(counts, most))
    alone = np.asarray(counts)[points.pixel[few.index]] <= most
    assert (few.factor[alone] == 1).all() and (few.factor >= np.float32(1 - 1e-6)).all()
    whole = np.bincount(points.pixel, shown(points), len(counts))
    np.testing.assert_allclose(
        np.bincount(few.points.pixel, shown(few.points), len(counts)), whole, rtol=0.02, atol=0.01 * shown(points).mean()
    )


def test_light_is_right_in_the_mean():
    points = crowd([12, 5, 30, 2])
    light = np.random.default_rng(1).random(len(points.pixel))
    wanted = np.bincount(points.pixel, points.albedo[:, 0] * light)
    found = []
    for seed in range(2000):
        few = picked(points, 3, seed)
        found.append(np.bincount(few.points.pixel, few.points.albedo[:, 0] * light[few.index]))
    noise = np.std(found, axis=0) / len(found) ** 0.5
    assert (np.abs(np.mean(found, axis=0) - wanted) <= 4 * noise + 1e-6).all()
    assert (noise[:3] < 0.02 * wanted[:3]).all() and noise[3] == pytest.approx(0, abs=1e-9)


def test_rows_find_their_places():
    points = crowd([9, 1])
    few = picked(points, 2, 0)
    spread = few.spread(np.arange(1, len(few.index) + 1, dtype=np.float32)[:, None], len(points.pixel))
    assert spread.shape == (10, 1) and np.count_nonzero(spread) == len(few.index)
    np.testing.assert_array_equal(spread[few.index, 0], np.arange(1, len(few.index) + 1))


def test_crowded_pixels_keep_their_light(monkeypatch):
    # Crumbs in a room, some a tenth of a pixel wide, as grass is: the same light by a few of a pixel's points as by all.
    random = np.random.default_rng(4)
    corners = 0.02 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    frames = np.linalg.qr(random.normal(size=(1500, 3, 3)))[0]
    places = np.einsum("kc,ncd->nkd", corners, frames) + random.uniform((-0.9, -0.9, -0.95), (0.9, 0.9, 0.3), (1500, 1, 3))
    quads = (places.reshape(-1, 3), (np.arange(1500)[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3), 1)
    scene = rooms.room(extra=(quads,), size=(24, 16))
    asked = replace(rooms.SETTINGS, method="importance-sampling", pixel_samples=16, vpls=512)
    numbers = []

    def counted(points, mean, seed):
        few = picked(points, mean, seed)
        numbers.append((len(points.pixel), len(few.index)))
        return few

    def mean(name):
        return np.mean([render(scene, replace(asked, seed=seed)).layers[name].mean(dtype=np.float64) for seed in range(4)])

    for name in ("DiffuseIndirect", "Direct"):
        monkeypatch.setattr(pipeline, "picked", counted)
        few = mean(name)
        monkeypatch.setattr(pipeline, "picked", lambda points, mean, seed: None)
        assert few == pytest.approx(mean(name), rel=0.03)
    assert all(some < 0.7 * whole for whole, some in numbers)
