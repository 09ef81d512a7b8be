"""Sheen: energy and shape of its lobes, and what direct light makes of them."""

import numpy as np
import pytest

from lumigate.core.surfaces import sheen

F = np.float32
COSINES = [0.15, 0.4, 0.8]


def hemisphere(n=200):
    """Midpoints (N, 3) of even steps in the cosine and the angle about z, each of which stands for 2 pi / N."""
    z, turn = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) * 2 * np.pi / n)
    z, turn = z.ravel(), turn.ravel()
    sine = np.sqrt(1 - z * z)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), z], 1)


def shapes(roughness, cosine, lights):
    view = np.array([np.sqrt(1 - cosine * cosine), 0, cosine])
    return np.array([sheen.shape(F(roughness), F(d[2]), F(cosine), F(d @ view)) for d in lights])


@pytest.mark.parametrize("cosine", COSINES)
@pytest.mark.parametrize("roughness", [0.3, 0.5, 1.0, -0.5, -1.0])
def test_even_light_makes_the_lobe_as_bright_as_its_albedo_says(roughness, cosine):
    lights = hemisphere()
    mean = 2 * (shapes(roughness, cosine, lights) * lights[:, 2]).mean()
    assert mean == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0, -0.5, -1.0])
def test_the_mean_albedo_is_that_over_all_views(roughness):
    z = (np.arange(400) + 0.5) / 400
    mean = 2 * np.mean([c * sheen.albedo(F(c), F(roughness)) for c in z])
    assert sheen.albedo_average(F(roughness)) == pytest.approx(mean, rel=0.02, abs=1e-4)


def velvet(light, view, spread):
    """Ashikhmin's velvet, times the cosine of the light (1/sr)."""
    h = (light + view) / np.linalg.norm(light + view)
    sine2 = 1 - h[2] ** 2
    normals = np.exp(-(h[2] ** 2) / sine2 / spread**2) / spread**2 / (np.pi * sine2**2)
    ratio = 2 * h[2] / (h @ view)
    return 0.25 * normals * min(1, ratio * view[2], ratio * light[2]) / view[2]


@pytest.mark.parametrize("spread", [0.3, 0.7, 1.0])
def test_velvets_shine_by_the_distribution_of_their_normals(spread):
    rng = np.random.default_rng(1)
    for _ in range(50):
        light, view = (
            v / np.linalg.norm(v) for v in np.abs(rng.normal(size=(2, 3))) * (1, 1, 1) * rng.choice([-1, 1], (2, 3)) ** (1, 1, 2)
        )
        found = sheen.albedo(F(view[2]), F(-spread)) * sheen.shape(F(-spread), F(light[2]), F(view[2]), F(light @ view)) * light[2] / np.pi
        assert found == pytest.approx(velvet(light, view, spread), rel=0.01, abs=1e-5)


def test_fibres_shine_back_and_at_the_rim():
    back, straight, beyond = shapes(0.5, 0.3, np.array([[0.9, 0, 0.43589], [0, 0, 1.0], [-0.9, 0, 0.43589]]))
    assert back > beyond > straight


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_a_bump_seen_from_behind_shines_along_its_pile(roughness):
    """As of Cycles, which takes the lobe of a view along the surface then; evenly lit it was half too bright on cloth with deep bumps."""
    lights, turned = hemisphere(), -0.4
    found = shapes(roughness, turned, lights)
    assert 2 * (found * lights[:, 2]).mean() == pytest.approx(1, abs=0.05)
    np.testing.assert_allclose(found, shapes(roughness, 0.0, lights), rtol=1e-3, atol=1e-4)
    assert found[lights[:, 2] > 0.9].max() < 0.8 < 1 < found[lights[:, 2] < 0.2].max()


def test_a_velvet_seen_from_behind_is_dark():
    assert not shapes(-0.5, -0.4, hemisphere(20)).any()


def test_factors_tell_channels_apart():
    row = np.array([0.5, 0.0, 1.0, 0.5], F)
    up, light = F([0, 0, 1]), F([0.8, 0, 0.6])
    r, g, b = sheen.factors(row, *up, *light, *light)
    k = sheen.shape(F(0.5), F(0.6), F(0.6), F(1.0))
    assert (r, g, b) == pytest.approx((1 + 0.5 * (k - 1), 1, k), rel=1e-5)
