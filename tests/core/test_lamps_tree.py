"""The light tree: bounds that hold, probabilities that are what they say, against slow float64 oracles."""

import math

import numpy as np

from lumigate.core.jit import kernel
from lumigate.core.lamps import tree_build as tb
from lumigate.core.lamps.tables import AGAINST, AXIS, COS_E, COS_O, ENERGY, LOWER, PLANE, UPPER
from lumigate.core.lamps.tree import CUT, choose, cut_estimate, cut_for, descend, importance


def random_bounds(n, seed=0, spread=4.0):
    """Rows of n emitters: a third points, a third one-sided, some of these a little of the other side, too, a third two-sided; a few without extent."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((n, tb.COLUMNS))
    centre = rng.uniform(-spread, spread, (n, 3))
    extent = rng.uniform(0, 0.3, (n, 3)) * (rng.random((n, 1)) < 0.8)
    rows[:, LOWER : LOWER + 3], rows[:, UPPER : UPPER + 3] = centre - extent, centre + extent
    axis = rng.normal(size=(n, 3))
    rows[:, AXIS : AXIS + 3] = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    rows[:, COS_O] = np.where(np.arange(n) % 3 == 0, -1, 1)
    rows[:, COS_E] = np.where(np.arange(n) % 2, 0.0, math.cos(0.6))
    rows[:, ENERGY] = rng.lognormal(size=n)
    rows[:, tb.TWO_SIDED] = np.arange(n) % 3 == 2
    one_sided = np.arange(n) % 3 == 1
    rows[:, AGAINST] = np.where(one_sided & (np.arange(n) % 2 == 1), 0.1, 0.0)
    first = ((centre * rows[:, AXIS : AXIS + 3]) - extent * np.abs(rows[:, AXIS : AXIS + 3])).sum(1)
    rows[:, PLANE] = np.where(one_sided, first, -np.inf)
    return rows


@kernel
def _importances(tree, p, n, out):
    for k in range(len(tree.nodes)):
        out[k] = importance(tree.nodes, tree.two_sided, k, p[0], p[1], p[2], n[0], n[1], n[2])


@kernel
def _descents(tree, p, n, count, hits, inverse):
    ends = 0
    for i in range(count):
        e, q = descend(
            tree.nodes, tree.two_sided, tree.children, tree.root, p[0], p[1], p[2], n[0], n[1], n[2], np.float32((i + 0.5) / count)
        )
        if e < 0:
            ends += 1
        else:
            hits[e] += 1
            inverse[e] = q
    return ends


@kernel
def _choices(tree, p, n, count, picks, total):
    members = np.empty(CUT, np.int32)
    cdf = np.empty(CUT, np.float32)
    size, _ = cut_for(tree.nodes, tree.two_sided, tree.children, tree.root, p[0], p[1], p[2], np.float32(0), n[0], n[1], n[2], members, cdf)
    for i in range(count):
        u = np.float32((i + 0.5) / count)
        e, rarity = choose(tree.nodes, tree.two_sided, tree.children, p[0], p[1], p[2], n[0], n[1], n[2], members, cdf, size, u, picks[i])
        if e >= 0:
            total[e] += rarity / count
    return cut_estimate(tree.nodes, tree.two_sided, tree.cut, p[0], p[1], p[2], n[0], n[1], n[2])


def exact(tree, node, p, n):
    """`importance` in float64, from the angles themselves."""
    row = tree.nodes[node].astype(np.float64)
    centre, half = 0.5 * (row[LOWER : LOWER + 3] + row[UPPER : UPPER + 3]), 0.5 * (row[UPPER : UPPER + 3] - row[LOWER : LOWER + 3])
    radius, v = np.linalg.norm(half), centre - p
    d = np.linalg.norm(v)
    ahead = p @ row[AXIS : AXIS + 3] > row[PLANE]
    if v @ n + half @ np.abs(n) <= 0:
        return 0.0
    if d <= radius:
        return (1.0 if ahead else row[AGAINST]) * row[ENERGY] / radius**2
    theta_u = math.asin(radius / d)
    theta_i = max(0.0, math.acos(np.clip(v @ n / d, -1, 1)) - theta_u)
    cosine = -v @ row[AXIS : AXIS + 3] / d
    cosine = abs(cosine) if tree.two_sided[node] else cosine
    sent = 0.0
    for share, side in ((ahead, 1), (row[AGAINST], -1)):
        theta = max(0.0, math.acos(np.clip(side * cosine, -1, 1)) - math.acos(np.clip(row[COS_O], -1, 1)) - theta_u)
        if math.cos(theta) >= row[COS_E] - 1e-4:
            sent = max(sent, share * max(math.cos(theta), 1e-3))
    return row[ENERGY] * math.cos(theta_i) * sent / d**2 if theta_i < math.pi / 2 else 0.0


def places(count, seed=1):
    rng = np.random.default_rng(seed)
    n = rng.normal(size=(count, 3))
    return rng.uniform(-5, 5, (count, 3)).astype(np.float32), (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32)


def test_importance_is_the_formula():
    tree = tb.light_tree(random_bounds(40), np.arange(40))
    for p, n in zip(*places(20)):
        found = np.zeros(len(tree.nodes))
        _importances(tree, p, n, found)
        expected = np.array([exact(tree, k, p.astype(float), n.astype(float)) for k in range(len(tree.nodes))])
        # At the very edge of a cone one of the two may be zero: the values there are compared loosely.
        close = np.isclose(found, expected, rtol=2e-3, atol=1e-3 * expected.max())
        assert close.mean() > 0.98


def test_nodes_hold_their_children():
    n = 100
    tree = tb.light_tree(random_bounds(n, 3), np.arange(n))
    seen = np.zeros(n, int)
    stack = [(tree.root, [])]
    while stack:
        node, above = stack.pop()
        if node < n:
            seen[node] += 1
            row, two = tree.nodes[node].astype(float), tree.two_sided[node]
            for k in above:
                parent = tree.nodes[k].astype(float)
                assert (parent[LOWER : LOWER + 3] <= row[LOWER : LOWER + 3]).all()
                assert (parent[UPPER : UPPER + 3] >= row[UPPER : UPPER + 3]).all()
                assert parent[COS_E] <= row[COS_E]
                between = parent[AXIS : AXIS + 3] @ row[AXIS : AXIS + 3]
                if two and tree.two_sided[k]:
                    between = abs(between)
                angle = math.acos(np.clip(between, -1, 1)) + math.acos(np.clip(row[COS_O], -1, 1))
                assert min(angle, math.pi) <= math.acos(np.clip(parent[COS_O], -1, 1)) + 2e-3
        else:
            stack += [(c, [*above, node]) for c in tree.children[node - n]]
    assert (seen == 1).all()
    energy = tree.nodes[:, ENERGY].astype(float)
    assert np.isclose(energy[tree.root], energy[:n].sum())
    assert np.isclose(energy[tree.cut].sum(), energy[:n].sum())


def test_only_members_are_in_the_tree():
    bounds = random_bounds(30)
    members = np.array([3, 7, 8, 20, 29])
    tree = tb.light_tree(bounds, members)
    leaves = set(tree.children.ravel()) - set(range(30, len(tree.nodes)))
    assert leaves == set(members.tolist())
    assert tb.light_tree(bounds, np.array([4])).root == 4
    assert tb.light_tree(bounds, np.zeros(0, int)).root == -1


def test_descents_have_the_probability_they_say():
    n = 60
    tree = tb.light_tree(random_bounds(n, 5), np.arange(n))
    for p, normal in zip(*places(10, 2)):
        hits, q = np.zeros(n), np.zeros(n)
        ends = _descents(tree, p, normal, 100000, hits, q)  # clusters may promise light that no member has
        assert hits.sum() + ends == 100000
        assert np.abs(hits / 100000 - q).max() < 5e-3


def test_choices_are_unbiased():
    """The mean of [e = k] / probability is 1 for every emitter that can light the point, 0 for the others."""
    n = 60
    tree = tb.light_tree(random_bounds(n, 6), np.arange(n))
    count = 400000
    picks = np.random.default_rng(0).random(count, np.float32)
    for p, normal in zip(*places(6, 3)):
        total, found = np.zeros(n), np.zeros(len(tree.nodes))
        _choices(tree, p, normal, count, picks, total)
        _importances(tree, p, normal, found)
        light = found[:n] / found[:n].sum()
        assert not total[light == 0].any()
        often = light > 2e-3
        assert np.abs(total[often] - 1).max() < 0.1
        assert abs((total * light).sum() - 1) < 5e-3


def test_identical_emitters_make_a_tree_too():
    bounds = np.repeat(random_bounds(1), 33, axis=0)
    tree = tb.light_tree(bounds, np.arange(33))
    assert len(tree.children) == 32 and set(tree.children.ravel()) == set(range(33)) | set(range(34, 65))
