"""Where shadow rays leave smooth surfaces, against a slow oracle and a sphere."""

import numpy as np
import pytest

from lumigate.core.surfaces.terminator import LOW, lift


def slow_lift(corners, normals, weights, g, d, cutoff=0.1):
    """Cycles' offset, written with vectors."""
    p, n = weights @ corners, weights @ normals
    side = 1.0 if n @ g > 0 else -1.0
    across, along = g @ d, side * n @ d / np.linalg.norm(n)
    amount = np.clip(2 - (across + along) / cutoff if along < cutoff else 1 - across / cutoff, 0, 1)
    u, v, _ = weights
    a = (normals[2] - normals[0]) @ (corners[0] - corners[2])
    b = (normals[2] - normals[1]) @ (corners[1] - corners[2])
    c = (normals[1] - normals[0]) @ (corners[1] - corners[0])
    parabola = a * u * (u - 1) + (a + b + c) * u * v + b * v * (v - 1)
    planes = []
    for k in range(3):
        reach = max(side * normals[k] @ (corners[j] - corners[k]) for j in range(3))
        planes.append(max(max(reach, 0) + side * normals[k] @ (corners[k] - p), 0))
    height = max(min(planes), parabola / 2) if side > 0 else min(-min(planes), parabola / 2)
    return amount * height * n


def unit(x):
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def fast_lift(corners, normals, p, g, d):
    arrays = corners.astype(np.float32), np.array([[0, 1, 2]], np.int32), normals[None].astype(np.float32)
    return np.array(lift(*arrays, 0, *(np.float32(x) for x in (*p, *g, *d))))


@pytest.mark.parametrize("side", [1, -1])
def test_lift_is_the_oracles(side):
    random = np.random.default_rng(3)
    lifted = 0
    for _ in range(300):
        corners = random.normal(size=(3, 3)) + 5
        g = side * unit(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
        normals = unit(side * g + 0.5 * random.normal(size=(3, 3)))
        d, weights = unit(random.normal(size=3)), random.dirichlet(np.ones(3))
        expected = slow_lift(corners, normals, weights, g, d)
        assert np.allclose(fast_lift(corners, normals, weights @ corners, g, d), expected, atol=1e-4)
        lifted += np.abs(expected).max() > 1e-3
        if g @ d > LOW and side * weights @ normals @ d >= 0:  # what need not be asked
            assert not expected.any()
    assert lifted > 100


def test_flat_shading_and_steep_rays_are_not_lifted():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    g, p = np.array([0, 0, 1.0]), np.array([0.3, 0.3, 0])
    flat, round_ = np.tile(g, (3, 1)), unit(g + np.array([[-0.5, -0.5, 0], [0.5, 0, 0], [0, 0.5, 0]]))
    low, steep = unit(np.array([1, 0, -0.02])), unit(np.array([1, 0, 0.5]))
    assert np.abs(fast_lift(corners, flat, p, g, low)).max() < 1e-7
    assert not fast_lift(corners, round_, p, g, steep).any()
    assert fast_lift(corners, round_, p, g, low)[2] > 0.05


def test_points_of_a_sphere_rise_to_it():
    corners = unit(np.array([[1, 0.3, 0], [1, -0.15, 0.26], [1, -0.15, -0.26]]))
    middle = corners.mean(axis=0)
    g = unit(middle)
    d = unit(np.cross(g, [0, 0, 1.0]))
    rise = fast_lift(corners, corners, middle, g, d)
    missing = 1 - np.linalg.norm(middle)
    assert 0.5 * missing < rise @ g < 2 * missing
    down = fast_lift(corners, corners, middle, -g, d)  # from inside, where the facet lies above the sphere
    assert np.abs(down).max() < 0.5 * missing or down @ g <= 0


def test_degenerate_triangles_and_places_beside_give_finite_offsets():
    line = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], float)
    g, d = np.array([0, 0, 1.0]), np.array([1.0, 0, 0])
    assert not fast_lift(line, np.tile(g, (3, 1)), line[1], g, d).any()
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    normals = unit(g + np.array([[-0.5, -0.5, 0], [0.5, 0, 0], [0, 0.5, 0]]))
    assert np.isfinite(fast_lift(corners, normals, np.array([3.0, -2.0, 0]), g, d)).all()
