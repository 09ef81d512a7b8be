"""VPL clusters: flux kept, representatives on surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core.clustering import cluster_vpls, sum_by_cluster
from lumigate.core.particles import Vpls
from lumigate.core.surfaces.lobes import LOBE

from .clustering_points import awkward, room


def lights(n, seed=0, make=room):
    """VPLs whose flux spans six decades, some black."""
    points, normals = make(n, seed)
    rng = np.random.default_rng(seed)
    flux = (10 ** rng.uniform(-5, 1, (n, 1)) * rng.random((n, 3)) * (rng.random((n, 1)) > 0.1)).astype(np.float32)
    return Vpls(
        points,
        np.zeros(n, np.float32),
        normals,
        normals,
        flux,
        np.zeros(n, np.int32),
        np.ones(n, np.int32),
        np.zeros(n, np.int32),
        np.zeros(n, np.uint8),
        np.zeros(n, np.float32),
        np.full((n, LOBE), -1, np.float32),
        np.ones(n, np.float32),
    )


@settings(max_examples=30, deadline=None)
@given(
    n=st.integers(1, 500), k=st.integers(1, 200), seed=st.integers(0, 10**6), make=st.sampled_from([room, awkward]),
    representative=st.sampled_from(["nearest", "power"]),
)  # fmt: skip
def test_the_total_flux_is_kept_and_representatives_are_members(n, k, seed, make, representative):
    vpls = lights(n, seed, make)
    clusters = cluster_vpls(vpls, k, representative=representative, seed=seed, threads=1)
    total = vpls.flux.sum(axis=0, dtype=float)
    np.testing.assert_allclose(clusters.lights.flux.sum(axis=0, dtype=float), total, rtol=1e-6, atol=1e-12)
    assignment = clusters.clustering.assignment
    np.testing.assert_array_equal(assignment[clusters.representatives], np.arange(len(clusters)))
    np.testing.assert_array_equal(clusters.lights.position, vpls.position[clusters.representatives])
    np.testing.assert_array_equal(clusters.lights.normal, vpls.normal[clusters.representatives])
    for c in range(len(clusters)):
        own = vpls.flux[assignment == c].sum(axis=0, dtype=float)
        np.testing.assert_allclose(clusters.lights.flux[c], own, rtol=1e-6, atol=1e-12)


def test_as_many_clusters_as_vpls_changes_nothing():
    vpls = lights(60)
    clusters = cluster_vpls(vpls, 60)
    order = clusters.clustering.assignment
    np.testing.assert_array_equal(clusters.lights.flux[order], vpls.flux)
    np.testing.assert_array_equal(clusters.lights.position[order], vpls.position)


def test_power_draws_members_by_their_share():
    n = 4
    vpls = lights(n)._replace(position=np.zeros((n, 3), np.float32), normal=np.tile(np.float32([0, 0, 1]), (n, 1)))
    vpls = vpls._replace(flux=np.repeat(np.float32([[1], [0], [3], [6]]), 3, axis=1))
    drawn = np.bincount([cluster_vpls(vpls, 1, representative="power", seed=seed).representatives[0] for seed in range(1000)], minlength=n)
    assert drawn[1] == 0
    np.testing.assert_allclose(drawn / 1000, [0.1, 0, 0.3, 0.6], atol=0.06)  # 4 standard deviations


def test_the_nearest_representative_lies_by_the_bright_members():
    points = np.zeros((11, 3), np.float32)
    points[:, 0] = np.arange(11)
    vpls = lights(11)._replace(position=points, normal=np.tile(np.float32([0, 0, 1]), (11, 1)))
    vpls = vpls._replace(flux=np.where(np.arange(11)[:, None] == 8, np.float32(100), np.float32(1)) * np.ones((1, 3), np.float32))
    assert list(cluster_vpls(vpls, 1).representatives) == [8]


def test_members_may_shade_for_themselves():
    vpls = lights(300)
    clusters = cluster_vpls(vpls, 20)
    shared = sum_by_cluster(vpls.flux.astype(float), clusters.clustering)
    np.testing.assert_allclose(shared, clusters.lights.flux, rtol=1e-6)


def test_no_vpls():
    assert len(cluster_vpls(Vpls.allocate(0), 5)) == 0


@pytest.mark.parametrize("field, value", [("flux", np.nan), ("flux", -1), ("position", np.inf)])
def test_bad_vpls_are_named(field, value):
    vpls = lights(10)
    getattr(vpls, field)[7] = value
    with pytest.raises(ValueError, match="VPL 7"):
        cluster_vpls(vpls, 3)


def test_unknown_representative_is_named():
    with pytest.raises(ValueError, match="representative"):
        cluster_vpls(lights(10), 3, representative="brightest")
