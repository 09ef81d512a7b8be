"""The GGX lobe: the density of its samples is the lobe itself."""

import numpy as np
import pytest

from lumigate.core.jit import kernel
from lumigate.core.surfaces import ggx, microfacet


@kernel
def _by_sampling(cosine, alpha, u, bins):
    sine = np.float32(np.sqrt(1 - cosine * cosine))
    total = 0.0
    for k in range(u.shape[0]):
        _, _, z, w = microfacet.sample_reflection(sine, np.float32(0), cosine, alpha, u[k, 0], u[k, 1])
        if w > 0:
            total += w
            bins[min(int(z * bins.shape[0]), bins.shape[0] - 1)] += w
    return total / u.shape[0]


@kernel
def _by_quadrature(cosine, alpha, n, bins):
    sine = np.float32(np.sqrt(1 - cosine * cosine))
    total = 0.0
    for a in range(n):
        z = np.float32((a + 0.5) / n)
        r = np.float32(np.sqrt(1 - z * z))
        for b in range(n):
            phi = 2 * np.pi * (b + 0.5) / n
            f = microfacet.reflection(sine, np.float32(0), cosine, r * np.float32(np.cos(phi)), r * np.float32(np.sin(phi)), z, alpha)
            total += f * 2 * np.pi / (n * n)
            bins[min(int(z * bins.shape[0]), bins.shape[0] - 1)] += f * 2 * np.pi / (n * n)
    return total


@pytest.mark.parametrize("cosine", [0.2, 0.6, 0.95])
@pytest.mark.parametrize("roughness", [0.4, 0.7, 1.0])
def test_samples_follow_the_lobe(cosine, roughness):
    alpha = np.float32(roughness**2)
    u = np.random.default_rng(1).random((200_000, 2), np.float32)
    sampled, integrated = np.zeros(8), np.zeros(8)
    a = _by_sampling(np.float32(cosine), alpha, u, sampled)
    b = _by_quadrature(np.float32(cosine), alpha, 1200, integrated)
    assert a == pytest.approx(b, rel=0.01)
    assert sampled / len(u) == pytest.approx(integrated, abs=0.006)


@pytest.mark.parametrize("cosine", [0.3, 0.8])
def test_its_albedo_is_the_tabulated_one(cosine):
    u = np.random.default_rng(2).random((200_000, 2), np.float32)
    for roughness in (0.3, 0.6, 1.0):
        albedo = _by_sampling(np.float32(cosine), np.float32(roughness**2), u, np.zeros(8))
        assert albedo == pytest.approx(ggx.single_scattering(np.float32(cosine), np.float32(roughness)), abs=0.01)
