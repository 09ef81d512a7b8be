"""What cells of the cache send each other, against the same sums written out in 64 bits."""

import numpy as np
import pytest

from lumigate.core.methods.exchange import (
    BALANCE,
    DEPTH,
    DIFFUSE_LINK,
    GLOSSY_LINK,
    LEVELS,
    MISSED,
    MOST_BALANCE,
    PRIOR,
    TRANSLUCENT_LINK,
    Exchange,
    Probes,
    Thrown,
    turns_to_settle,
)
from lumigate.core.methods.partition import RARE, divided

CELLS = (120, 40, 12, 4)  # of each level


def random_room(groups=2, glass=True, bend=True, seed=1):
    """Arguments of `Exchange` but the threads: probes in cells at random, whose links end at others, at nothing (-2) or at places that none knows (-1)."""
    rng = np.random.default_rng(seed)
    first = np.cumsum((0, *CELLS))
    level_of = np.repeat(np.arange(LEVELS), CELLS).astype(np.uint8)
    parent = np.concatenate(
        [*(rng.integers(first[level + 1], first[level + 2], CELLS[level]) for level in range(LEVELS - 1)), np.full(CELLS[-1], -1)]
    )
    parent[:3] = -1  # cells that nothing surrounds
    root = np.arange(len(parent))
    for _ in range(LEVELS - 1):
        root = np.where(parent[root] >= 0, parent[root], root)
    n = 300 * DEPTH
    probes = Probes.allocate(n, groups)
    probes.valid[:] = rng.random(n) < 0.9
    cells = np.stack([rng.integers(first[level], first[level + 1] - CELLS[level] // 4, n) for level in range(LEVELS)], axis=1).astype(
        np.int32
    )  # some stay empty
    probes.direct[:] = rng.random(probes.direct.shape) ** 4
    for part, of in zip((probes.shine, probes.beneath, probes.glass), (bend, bend, glass), strict=True):
        part[:] = of * probes.direct * rng.random((n, 1)) * 0.3
    probes.link[:] = rng.choice([MISSED, DIFFUSE_LINK, *([GLOSSY_LINK, TRANSLUCENT_LINK] if bend else [DIFFUSE_LINK])], n)
    probes.carry[:], probes.albedo[:] = rng.random((2, n, 3)) * 0.8
    link_cell = np.where(probes.link == MISSED, -2, np.where(rng.random(n) < 0.1, -1, cells[rng.permutation(n), 0])).astype(np.int64)
    seen_cell = np.where(rng.random(n) < 0.1, -1, cells[np.arange(n), rng.integers(0, 2, n)]).astype(np.int64)
    weight = np.where(np.arange(n) % DEPTH, 0.2, 1.0).astype(np.float32)
    return probes, cells, link_cell, seen_cell, parent, root, level_of, weight, rng.random(n) < 0.5


def written_out(room, bounces, row, thrown=None):
    """What `Exchange.solve` finds, with `number_of` and `unit`, cell by cell."""
    probes, cells, link_cell, seen_cell, parent, root, level_of, weight, looked = room
    probes = probes._replace(
        **{name: getattr(probes, name).astype(np.float64) for name in ("direct", "shine", "beneath", "glass", "carry", "albedo")}
    )
    knows, half = probes.valid > 0, np.arange(len(weight)) // DEPTH % 2
    weight = weight.astype(np.float64) * knows
    number_of = np.zeros((2, len(parent)))
    linked_of = np.zeros_like(number_of)

    def sums(values, rows=slice(None), halves=True):
        found = np.zeros((2, len(parent), values.shape[1]))
        for level in range(LEVELS):
            np.add.at(found, (half[rows], cells[rows, level]), values[rows])
        return found if halves else found.sum(axis=0)

    number_of, linked_of = sums(weight[:, None])[..., 0], sums((weight * (link_cell != -1))[:, None])[..., 0]
    number, linked = number_of.sum(axis=0), linked_of.sum(axis=0)
    bright = probes.direct.sum(axis=1) / 3
    light, squared, squares = (sums((weight * of)[:, None], halves=False)[:, 0] for of in (bright, bright**2, weight))
    unit = np.where(number > 0, squares / np.maximum(number, 1e-30), 1)

    likeness = np.full(len(parent), PRIOR)
    for up in range(len(parent)):
        inner = np.flatnonzero((parent == up) & (number > 0))
        n, effective = number[inner], number[inner] ** 2 / squares[inner]
        several = effective > 1.5
        if several.any():
            variance = np.maximum(0, squared[inner] / n - (light[inner] / n) ** 2)
            deviation = np.sqrt(variance * effective / np.maximum(effective - 1, 1e-30))
            within = ((n * deviation)[several].sum() / n[several].sum()) ** 2
            between = squared[inner].sum() / n.sum() - (light[inner].sum() / n.sum()) ** 2 - within
            if between > 0:
                likeness[parent == up] = min(PRIOR, within / between)

    def means(total, number, likeness):
        found = np.zeros_like(total)
        for c in np.argsort(-level_of.astype(int), kind="stable"):
            around = 0.0 if parent[c] < 0 else likeness[c] * unit[c] if number[c] > 0 else 1.0
            found[c] = (total[c] + (around * found[parent[c]] if parent[c] >= 0 else 0)) / max(number[c] + around, 1e-6)
        return found

    def both(values):
        return np.stack([means(of, n, likeness / 2) for of, n in zip(sums(values), number_of, strict=True)])

    def brought(values):
        return means(sums(values, halves=False), linked, flat)

    flat, wide = np.full(len(parent), PRIOR), np.tile(weight[:, None] * probes.carry, probes.direct.shape[1] // 3)
    whole = {name: weight[:, None] * getattr(probes, name) for name in ("direct", "shine", "beneath", "glass")}
    direct, glass = (means(sums(whole[name], halves=False), number, likeness) for name in ("direct", "glass"))
    direct_of, shine, beneath, glass_of = (both(whole[name]) for name in ("direct", "shine", "beneath", "glass"))
    one = (number_of / np.maximum(number, 1e-6))[..., None] * shine
    one, glossy, sends = one.sum(axis=0), (probes.link == GLOSSY_LINK) & (link_cell >= 0) & knows, (link_cell >= 0) & knows
    turns, free, at = turns_to_settle(probes), probes.link != DIFFUSE_LINK, np.maximum(link_cell, 0)

    def reflected(shone):
        return one + brought(np.where(glossy[:, None], wide * shone[at], 0))

    gained, several, shone, known = np.zeros_like(probes.direct), one.any() and glossy.any(), one, np.zeros(len(weight))
    if thrown is None:
        for _ in range(turns * several):
            shone = reflected(shone)
    else:
        several = several and thrown.chains
        known = np.where(free, 0, thrown.part)
        gained = np.tile(probes.albedo, probes.direct.shape[1] // 3) * thrown.irradiance[cells[:, 0]]
    gained_mean, gained_of = means(sums(weight[:, None] * gained, halves=False), number, likeness), both(weight[:, None] * gained)

    radiosity, scale = np.zeros((bounces, *direct.shape)), np.ones(len(parent))
    lookups = looked & knows & (link_cell != -1) & (seen_cell >= 0)
    for bounce in range(bounces):
        before = radiosity[bounce - 1] if bounce else np.zeros_like(direct)
        now, less = before, known[:, None] * wide * shone[at]
        for _ in range(turns):
            carried = wide * np.where(free[:, None], now[at], before[at] if bounce else 0)
            carried = np.where(sends[:, None], np.maximum(carried - less if bounce else carried, 0), 0)
            now = (direct + gained_mean if bounce else np.maximum(direct - glass, 0)) + brought(carried)
            own = (probes.direct + gained if bounce else probes.direct - probes.glass) + carried / np.maximum(weight, 1e-30)[:, None]
            wanted, met = np.zeros(len(parent)), np.zeros(len(parent))
            np.add.at(wanted, root[seen_cell[lookups]], own[lookups].sum(axis=1))
            np.add.at(met, root[seen_cell[lookups]], now[seen_cell[lookups]].sum(axis=1))
            trust = BALANCE / (len(weight) // DEPTH) * met.sum()
            factor = np.where(met > 0, (wanted + trust * wanted.sum() / met.sum()) / (met + trust), 1)
            scale = np.clip(factor, 1 / MOST_BALANCE, MOST_BALANCE)[root]
            now = now * scale[:, None]
            if thrown is not None:
                shone = (reflected(shone) if several else one) * scale[:, None]
        radiosity[bounce] = now
        if bounce == row:
            halves, through = (
                np.stack([means(of, n, flat / 2) for of, n in zip(sums(values), linked_of, strict=True)])
                for values in (carried, np.where(glossy[:, None], carried, 0))
            )
            clear = (
                1 if bounce else np.divide(np.maximum(direct_of - glass_of, 0), direct_of, out=np.ones_like(direct_of), where=direct_of > 0)
            )
            found = halves + direct_of * clear + (gained_of if bounce else 0), shine * clear, direct_of * clear, beneath * clear, through
            found = [part * scale[:, None] for part in found]
    return radiosity, *found, shone, number_of, unit


@pytest.mark.parametrize("row", [0, 3])
@pytest.mark.parametrize("chains", [None, False, True])
@pytest.mark.parametrize(("glass", "bend"), [(True, True), (False, True), (True, False), (False, False)])
def test_cells_send_each_other_what_the_sums_say(glass, bend, chains, row):
    room = random_room(glass=glass, bend=bend)
    rng, (probes, *_) = np.random.default_rng(2), room
    thrown = (
        chains if chains is None else Thrown(rng.random((sum(CELLS), 6), np.float32), rng.random(len(probes.valid), np.float32), chains)
    )
    exchange = Exchange(*room, threads=2)
    exchange.solve(4, row, Thrown(np.ones((sum(CELLS), 6), np.float32), np.ones(len(probes.valid), np.float32), True), lambda done: None)
    found = exchange.solve(4, row, thrown, lambda done: None)  # nothing of the time before is left
    expected = written_out(room, 4, row, thrown)
    for name, value, of in zip((*found._fields, "number_of", "unit"), (*found, exchange.number_of, exchange.unit), expected, strict=True):
        np.testing.assert_allclose(value, of, rtol=2e-4, atol=2e-6, err_msg=name)


def test_cells_of_one_light_group_and_of_nothing():
    room = random_room(groups=1)
    for value, of in zip(Exchange(*room, threads=1).solve(3, 2, None, lambda done: None), written_out(room, 3, 2), strict=False):
        np.testing.assert_allclose(value, of, rtol=2e-4, atol=2e-6)
    probes, cells, *rest = room
    probes.valid[:] = 0
    found = Exchange(probes, cells, *rest, threads=2).solve(2, 1, None, lambda done: None)
    assert not any(part.any() for part in found)


def test_nothing_is_looked_up_where_no_bounce_is():
    found = Exchange(*random_room(), threads=1).solve(1, -1, None, lambda done: None)
    assert found.radiosity.any() and not any(
        part.any() for part in (found.halves, found.shine, found.first_of, found.beneath, found.through)
    )


def test_light_is_the_same_for_any_number_of_threads():
    found = [Exchange(*random_room(seed=3), threads=threads).solve(4, 3, None, lambda done: None) for threads in (1, 3)]
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_light_is_divided_between_lights_and_rays_as_written_out():
    """`divided`: by how bright the other half of the paths finds a cell; what is rare goes to all cells of the same parent."""
    rng = np.random.default_rng(4)
    n, tau, later, relied = 400, 0.3, 0.6, 0.1
    halves = rng.random((2, n, 6)) ** 6 * 9
    shine, first, beneath, through = (rng.random((2, n, 1)) * part * halves for part in (0.2, 0.6, 0.1, 0.1))
    counts = rng.random((1, n)) * np.array([[1.0], [-1.0]]) + np.array([[0.0], [1.0]])
    bright, number, parent = rng.random((2, n)) ** 3, rng.random(n), np.where(np.arange(n) < 350, rng.integers(350, n, n), -1)
    share = bright / (bright + tau)
    share += relied * (1 - share)
    own, bound = halves.sum(axis=2) / 3, RARE * bright + tau
    beyond = np.where((own > bound) & (parent >= 0), 1 - bound / own, 0)[..., None]
    lights = share[..., None] * (first - beneath + later * (halves - first - through)) + (1 - share)[..., None] * shine
    expected = []
    for part in (halves, lights, shine, through):
        rare, kept = ((counts[..., None] * of * part).sum(axis=0) for of in (beyond, 1 - beyond))
        sums, weights = np.zeros_like(kept), np.zeros(n)
        inner = parent >= 0
        np.add.at(sums, parent[inner], (number[:, None] * rare)[inner])
        np.add.at(weights, parent[inner], number[inner])
        expected.append(kept + np.where(inner[:, None], (sums / np.maximum(weights, 1e-20)[:, None])[parent], 0))
    assert beyond.any()
    arrays = (of.astype(np.float32) for of in (halves, shine, first, beneath, through, counts, bright, number))
    found = divided(*arrays, np.float32(tau), parent, np.float32(later), np.float32(relied))
    for value, of in zip(found, (*expected, (counts * share).sum(axis=0)), strict=True):
        np.testing.assert_allclose(value, of, rtol=1e-4, atol=1e-5)
