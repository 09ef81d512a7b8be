"""Rough diffuse surfaces against the sums that their closed forms stand for."""

import numpy as np
import pytest

from lumigate.core.surfaces.rough_diffuse import kept, kept_average, shape

CELLS = 200


def directions():
    """Directions over the hemisphere about z, of equal parts of cosine-weighted solid angle: (N, 3)."""
    u, v = np.meshgrid((np.arange(CELLS) + 0.5) / CELLS, 2 * np.pi * (np.arange(CELLS) + 0.5) / CELLS)
    z = np.sqrt(u)
    sine = np.sqrt(1 - u)
    return np.stack([sine * np.cos(v), sine * np.sin(v), z], axis=-1).reshape(-1, 3)


def single(roughness, light, view):
    """pi times the reflectance, by light that is scattered once, of a white surface."""
    t = light @ view - light[:, 2] * view[2]
    t = np.where(t > 0, t / np.maximum(light[:, 2], view[2]), t)
    return np.pi * (1 + roughness * t) / (np.pi + roughness * (np.pi / 2 - 2 / 3))


@pytest.mark.parametrize("roughness", [0.2, 0.6, 1.0])
@pytest.mark.parametrize("cosine", [0.15, 0.5, 0.95])
def test_a_black_surface_keeps_what_is_scattered_once(roughness, cosine):
    view = np.array([np.sqrt(1 - cosine * cosine), 0, cosine])
    expected = single(roughness, directions(), view).mean()
    assert kept(np.float32(roughness), np.float32(cosine), *np.zeros(3, np.float32))[0] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("roughness", [0.2, 0.6, 1.0])
def test_white_keeps_all_and_the_mean_is_that_over_all_views(roughness):
    f = np.float32
    cosines = np.sqrt((np.arange(100) + 0.5) / 100)
    for color in (0.0, 0.3, 0.8):
        over_views = np.mean([kept(f(roughness), f(c), f(color), f(color), f(color))[0] for c in cosines])
        # Cycles' fit of the mean is off by a few thousandths.
        assert kept_average(f(roughness), f(color), f(0), f(1))[0] == pytest.approx(over_views, abs=4e-3)
    np.testing.assert_allclose(kept(f(roughness), f(0.4), f(1), f(1), f(1)), 1, rtol=1e-5)


@pytest.mark.parametrize("roughness", [0.3, 1.0])
@pytest.mark.parametrize("cosine", [0.2, 0.8])
def test_shape_takes_nothing_from_even_light_and_shines_back(roughness, cosine):
    view = np.array([np.sqrt(1 - cosine * cosine), 0, cosine], np.float32)
    light = directions().astype(np.float32)
    found = np.array([shape(np.float32(roughness), d[2], view[2], d @ view) for d in light])
    assert found.mean() == pytest.approx(1, abs=5e-3)
    low = light[:, 2] < 0.5
    assert found[low & (light[:, 0] > 0.5)].mean() > 1.05 * found[low & (light[:, 0] < -0.5)].mean()
