"""What lobes throw on the surfaces that gather rays meet: the cache of light has it where it falls, and no more of it."""

import numpy as np
import pytest

from lumigate.core.methods.exchange import DEPTH, DIFFUSE_LINK, GLOSSY_LINK, Probes
from lumigate.core.methods.light_cache import CacheBuilder, build_light_cache
from lumigate.core.methods.thrown import FEW, redirected, throwing, without_sparks

ALBEDO, SHINE = 0.5, 0.4
HUGE = np.float32(1e30)


def facing_planes(n=4000):
    """Two planes a metre apart that see only each other, of albedo ALBEDO: what the lower one sends is in part what lobes reflect of lamps."""
    rng = np.random.default_rng(1)
    probes = Probes.allocate(n * DEPTH)
    first = np.arange(0, n * DEPTH, DEPTH)
    upper = np.arange(n) >= n // 2
    probes.valid[first], probes.distance[first] = 1, 10.0
    probes.position[first, :2], probes.position[first, 2] = rng.random((n, 2)), upper
    probes.normal[first, 2] = np.where(upper, -1, 1)
    probes.direct[first], probes.shine[first] = np.where(upper, 0.0, 1.0)[:, None], np.where(upper, 0.0, SHINE)[:, None]
    probes.albedo[first], probes.carry[first], probes.link[first] = ALBEDO, ALBEDO, DIFFUSE_LINK
    probes.link_position[first] = probes.position[first] * (1, 1, -1) + (0, 0, 1)
    probes.link_normal[first] = -probes.normal[first]
    return probes, first, upper


@pytest.fixture(scope="module")
def planes():
    """(probes, rows of the first ones, which of them lie on the upper plane, cache, links, what has made these)."""
    probes, first, upper = facing_planes()
    builder = CacheBuilder(probes, 4, seed=1)
    return probes, first, upper, *builder.solve(), builder


def sent_by(planes, radiosity):
    """What the finest cells around the probes of the upper plane send after each bounce (B, N), and the x of the probes."""
    probes, first, upper, _, links, _ = planes
    return radiosity[:, links.cells[first[upper], 0], 0], probes.position[first[upper], 0]


def test_light_that_falls_evenly_stays_as_it_was(planes):
    probes, first, upper, cache, links, builder = planes
    rows = throwing(probes, links, cache)
    np.testing.assert_array_equal(rows, first)  # of the others none is valid
    irradiance = np.where(upper, SHINE, 0.0)[:, None].repeat(3, axis=1).astype(np.float32)
    found, _ = redirected(builder, cache, links, rows, irradiance, HUGE)
    np.testing.assert_allclose(found.radiosity, cache.radiosity, rtol=1e-4)
    np.testing.assert_allclose(found.sent, cache.sent, rtol=1e-4)
    np.testing.assert_allclose(found.lit, cache.lit, rtol=1e-4)
    np.testing.assert_allclose(found.gain, 0, atol=1e-4)


def test_light_falls_where_it_is_thrown_and_is_reflected_on(planes):
    # All of it on the half x > .5 of the upper plane, which sends twice as much of it; the lower plane, right below, hears of it a bounce later.
    probes, first, upper, cache, links, builder = planes
    irradiance = np.where(upper & (probes.position[first, 0] > 0.5), 2 * SHINE, 0.0)[:, None].repeat(3, axis=1).astype(np.float32)
    found, _ = redirected(builder, cache, links, first, irradiance, HUGE)
    sent, x = sent_by(planes, found.radiosity)
    before, _ = sent_by(planes, cache.radiosity)
    bright, dark = x > 0.6, x < 0.4
    np.testing.assert_allclose(sent[0], before[0], atol=1e-6)  # what left one surface is known as it is
    for half, sign in ((bright, 1), (dark, -1)):
        assert (sent - before)[1, half].mean() == pytest.approx(sign * ALBEDO * SHINE, rel=0.05)
        # The way there and back: ALBEDO^2 of it is added for each two bounces.
        assert (sent - before)[3, half].mean() == pytest.approx(sign * ALBEDO * SHINE * (1 + ALBEDO**2), rel=0.05)
        assert (found.gain[links.cells[first[upper], 0], 0])[half].mean() == pytest.approx(sign * SHINE, rel=0.05)
    assert sent.mean() == pytest.approx(before.mean(), rel=0.01)
    assert found.sent.mean() == pytest.approx(cache.sent.mean(), rel=0.01)


@pytest.mark.parametrize("several", [False, True])
def test_light_of_few_bright_lobes_is_taken_whole(several):
    """A fiftieth of the lower plane has all of it: no cell above can lack as much as its few links tell, in place of light that falls evenly.

    Of `several` lobes in turn, half of the probes of the lower plane show the other half by glossy links.
    """
    probes, first, upper = facing_planes(20000)
    bright = probes.position[first, 0] < 0.02
    probes.shine[first], probes.direct[first] = np.where(upper | ~bright, 0.0, 50 * SHINE)[:, None], np.where(upper, 0.0, 0.2)[:, None]
    probes.direct[first] += probes.shine[first]
    mirrors = np.flatnonzero(~upper & (np.arange(len(first)) % 2 == 0)) if several else np.zeros(0, np.int64)
    rows = first[mirrors]
    probes.link[rows], probes.carry[rows] = GLOSSY_LINK, 0.5
    probes.link_position[rows], probes.link_normal[rows] = probes.position[rows], probes.normal[rows]
    builder = CacheBuilder(probes, 4, seed=1)
    cache, links = builder.solve()
    sent = float(links.shone[links.link_cell[first[upper]], 0].mean())
    assert sent == pytest.approx(SHINE / (1 - 0.25) if several else SHINE, rel=0.1)  # half of the probes, half of the light
    irradiance = np.where(upper, sent, 0.0)[:, None].repeat(3, axis=1).astype(np.float32)
    found, _ = redirected(builder, cache, links, first, irradiance, HUGE, by_photons=True)
    cells = links.cells[first[upper], 0]
    assert found.sent[cells].mean() == pytest.approx(cache.sent[cells].mean(), rel=0.03)
    assert found.sent[cells].std() < 0.3 * cache.sent[cells].std()


def test_what_lights_do_not_carry_stays_with_the_links(planes):
    # A clamp of the geometry term at a quarter of what it is between the planes: lights have a quarter, as irradiance has.
    _, first, upper, cache, links, builder = planes
    irradiance = np.where(upper, SHINE / 4, 0.0)[:, None].repeat(3, axis=1).astype(np.float32)
    found, _ = redirected(builder, cache, links, first, irradiance, np.float32(0.25))
    np.testing.assert_allclose(found.radiosity, cache.radiosity, rtol=1e-4)


def test_no_ray_is_spent_where_lobes_throw_next_to_nothing():
    probes, _, _ = facing_planes()
    probes.shine[:] *= 0.01
    cache, links = build_light_cache(probes, 4, seed=1)
    assert not len(throwing(probes, links, cache))
    cache, links = build_light_cache(facing_planes()[0], 1, seed=1)  # one bounce: nobody looks up what has left two surfaces
    probes, _, _ = facing_planes()
    assert not len(throwing(probes, links, cache))
    probes.link[:] = 0  # all rays miss
    assert not len(throwing(probes, *build_light_cache(probes, 4, seed=1)[::-1]))


def test_a_spark_among_links_takes_no_light_from_the_paths_around():
    """One link that tells a thousand times what the others tell: its light is all that was there, and no place lacks much of it."""
    rng = np.random.default_rng(3)
    light, around = rng.random((400, 3), np.float32), np.repeat([0, 1, 2], (200, 200 - FEW // 2, FEW // 2))
    weight = np.where(np.arange(400) % 2, 1.0, 0.2)
    np.testing.assert_array_equal(without_sparks(light, weight, around), light)
    for spark in (7, 399):  # 399: in a cell of few
        told = light.copy()
        told[spark] = 1000.0
        spread = without_sparks(told, weight, around)
        np.testing.assert_allclose(weight @ spread, weight @ told, rtol=1e-5)
        assert spread.max() < 50
        assert (spread >= told)[np.arange(400) != spark].all()


def test_a_spark_in_one_cell_does_not_blacken_the_paths_that_end_beside_it(planes):
    """Without spreading it, one cell of a hundred times the light is taken from them whole: -34."""
    _, first, upper, cache, links, builder = planes
    cell = links.link_cell[first[upper]][0]
    shine = links.shine.copy()
    shine[cell] *= 100.0
    gains = [
        redirected(
            builder,
            cache,
            links._replace(shine=told),
            first,
            np.where(upper, SHINE, 0.0).astype(np.float32)[:, None] * np.ones(3, np.float32),
            HUGE,
        )[0].gain
        for told in (links.shine, shine)
    ]
    assert gains[0].min() > -0.5
    assert gains[1].min() > -25 * SHINE
