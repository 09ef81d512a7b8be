"""Clustering into virtual area lights: the paper's distance, rectangles, and the case of its Fig. 8."""

import itertools

import numpy as np
import pytest

from lumigate.core.clustering.area_lights import chained, cluster_area_lights
from lumigate.core.sampling.sequences import halton_points

M = 30


def spot_vpls(turn, n=1024):
    """Places (N, 3) and normals where a spot in the middle of a unit room lights it: 0 the wall at x = 1, 1 the ceiling at z = 1."""
    u, v = halton_points(0, n, 2, 1).T.astype(np.float64)
    radius, phi = 0.45 * np.sqrt(u), 2 * np.pi * v
    angle = turn * np.pi / 2
    forward, up = np.array([np.cos(angle), 0, np.sin(angle)]), np.array([-np.sin(angle), 0, np.cos(angle)])
    d = forward + radius[:, None] * (np.cos(phi)[:, None] * up + np.sin(phi)[:, None] * np.array([0, 1, 0]))
    d /= np.abs(d).max(axis=1, keepdims=True)
    face = np.abs(d).argmax(axis=1)
    normal = np.zeros_like(d)
    normal[np.arange(n), face] = -np.sign(d[np.arange(n), face])
    return d.astype(np.float32), normal.astype(np.float32)


def guess(n=1024):
    return np.arange(M) * n // M


def test_every_vpl_is_with_the_nearest_light():
    position, normal = spot_vpls(0.5)
    lights = cluster_area_lights(position, normal, guess(), 2.0)
    dx = np.linalg.norm(position[:, None].astype(float) - lights.centre, axis=2) / 2.0
    da = np.arccos(np.clip(normal.astype(float) @ lights.frame[:, 2].T.astype(float), -1, 1))
    distance = 0.7 * dx + 0.3 * da
    own = distance[np.arange(len(position)), lights.assignment]
    assert (own <= distance.min(axis=1) + 1e-5).all()
    assert (np.bincount(lights.assignment) > 0).all()
    for k in range(len(lights)):
        members = lights.assignment == k
        assert np.allclose(position[members].mean(axis=0), lights.centre[k], atol=1e-5)
        assert lights.medoid[k] == np.flatnonzero(members)[distance[members, k].argmin()]


def test_no_light_is_lost_while_a_spot_walks_from_wall_to_ceiling():
    used, centres = [], []
    for frame in range(41):
        lights = cluster_area_lights(*spot_vpls(frame / 40), guess(), 2.0)
        used.append(len(lights))
        centres.append(lights.centre)
    assert set(used) == {M}
    # They float: from frame to frame the median light moves about as far as the spot's axis does on the wall.
    steps = [np.median(np.linalg.norm(b - a, axis=1)) for a, b in itertools.pairwise(centres)]
    assert max(steps) < 0.15
    # Random starts scatter them.
    rng = np.random.default_rng(0)
    again = [cluster_area_lights(*spot_vpls(0.1), rng.integers(0, 1024, M), 2.0).centre for _ in range(2)]
    assert np.median(np.linalg.norm(again[1][:8] - again[0][:8], axis=1)) > 2 * np.median(steps)


def test_rectangle_bounds_its_members():
    rng = np.random.default_rng(1)
    along, across, normal = np.array([0.6, 0.8, 0]), np.array([-0.8, 0.6, 0]), np.array([0, 0, 1.0])
    st = rng.uniform(-1, 1, (500, 2)) * (3.0, 0.5)
    position = (st[:, :1] * along + st[:, 1:] * across + (4, 5, 6)).astype(np.float32)
    lights = cluster_area_lights(position, np.tile(normal, (500, 1)).astype(np.float32), np.array([7]), 6.0)
    assert lights.half[0] == pytest.approx((3.0, 0.5), rel=0.05)
    assert abs(lights.frame[0, 0] @ along) > 0.999 and lights.frame[0, 2] == pytest.approx(normal)
    assert np.allclose(lights.frame[0] @ lights.frame[0].T, np.eye(3), atol=1e-5)
    assert np.linalg.det(lights.frame[0]) == pytest.approx(1)
    assert lights.depth[0] < 1e-5 and lights.spread[0] == pytest.approx(1)


def test_lights_without_members_start_anew_or_are_dropped():
    position, normal = spot_vpls(0.0, 64)
    assert len(cluster_area_lights(position, normal, np.array([3, 3, 3]), 2.0)) == 3
    position[:], normal[:] = position[0], normal[0]
    assert len(cluster_area_lights(position, normal, np.array([3, 4, 5]), 2.0)) == 1
    with pytest.raises(ValueError, match="start from"):
        cluster_area_lights(position, normal, np.zeros(0, int), 2.0)


def test_a_chain_keeps_the_lights_and_goes_to_the_nearest():
    position, normal = spot_vpls(0.5)
    lights = cluster_area_lights(position, normal, guess(), 2.0)
    chain = chained(lights, 2.0)
    for field in ("centre", "frame", "half", "depth", "spread", "medoid"):
        assert np.array_equal(getattr(chain, field)[chain.assignment], getattr(lights, field)[lights.assignment])

    def steps(found):
        dx = np.linalg.norm(np.diff(found.centre, axis=0), axis=1) / 2.0
        cosine = np.einsum("mc,mc->m", found.frame[1:, 2], found.frame[:-1, 2])
        return 0.7 * dx + 0.3 * np.arccos(np.clip(cosine, -1, 1))

    assert steps(chain).sum() < 0.6 * steps(lights).sum()
