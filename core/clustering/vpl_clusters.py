"""Clusters of VPLs: one representative on a surface each, with the flux of all its members.

Fuzzy clustering paper, Section 3.1, Step 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .kmeans import NORMAL_THRESHOLD, Clustering, kmeans

if TYPE_CHECKING:
    from ..particles import Vpls

REPRESENTATIVES = ("nearest", "power")


@dataclass(frozen=True)
class VplClusters:
    """K clusters of M VPLs, none empty.

    lights: K VPLs to shade with in place of the M: each a member, so that it lies on a surface, with its cluster's flux.
    representatives: (K,) int32, which member it is.
    clustering: by power-weighted k-means; `clustering.assignment` is the cluster of each VPL, for
        callers that share visibility within a cluster but shade with every VPL.
    """

    lights: Vpls
    representatives: np.ndarray
    clustering: Clustering

    def __len__(self) -> int:
        return len(self.representatives)


def cluster_vpls(
    vpls: Vpls,
    k: int,
    *,
    representative: str = "nearest",
    iterations: int = 8,
    normal_threshold: float | None = NORMAL_THRESHOLD,
    normal_scale: float = 0.0,
    search: str = "shells",
    seed: int = 0,
    threads: int = 0,
    initial: np.ndarray | Clustering | None = None,
) -> VplClusters:
    """Cluster M VPLs into about k, every channel of their total flux kept to float32 rounding.

    representative: `nearest` is the member nearest to the power-weighted mean;  `power` is a member drawn with the
        probability of its share of the cluster's power, which has the right mean over seeds.
    The other arguments are those of `kmeans`.

    Raises:
        ValueError: a VPL whose position or flux is not finite or whose flux is negative, unknown
            representative, and what `kmeans` raises.
    """
    if representative not in REPRESENTATIVES:
        raise ValueError(f"representative: expected one of {', '.join(REPRESENTATIVES)}, got {representative!r}")
    flux = np.asarray(vpls.flux, np.float64)
    bad = ~(np.isfinite(vpls.position) & np.isfinite(flux) & (flux >= 0)).all(axis=1)
    if bad.any():
        raise ValueError(f"VPL {np.flatnonzero(bad)[0]}: position or flux is not finite, or the flux is negative")
    power = flux.sum(axis=1)
    clustering = kmeans(
        vpls.position,
        vpls.normal,
        k,
        weights=power,
        iterations=iterations,
        normal_threshold=normal_threshold,
        normal_scale=normal_scale,
        search=search,
        seed=seed,
        threads=threads,
        initial=initial,
    )
    total = sum_by_cluster(flux, clustering)
    chosen = clustering.representatives if representative == "nearest" else _by_power(power, clustering, np.random.default_rng(seed))
    return VplClusters(vpls.take(chosen)._replace(flux=total.astype(np.float32)), chosen, clustering)


def sum_by_cluster(values: np.ndarray, clustering: Clustering) -> np.ndarray:
    """(K, C) float64 sums of the members' (M, C) values; points without a cluster are left out."""
    member = clustering.assignment >= 0
    cluster = clustering.assignment[member]
    return np.stack([np.bincount(cluster, values[member, c], len(clustering)) for c in range(values.shape[1])], axis=1)


def _by_power(power: np.ndarray, clustering: Clustering, rng: np.random.Generator) -> np.ndarray:
    """(K,) int32: a member of each cluster, with the probability of its share of the power."""
    order = np.argsort(clustering.assignment, kind="stable")
    end = np.cumsum(clustering.sizes)
    begin = end - clustering.sizes
    edges = np.concatenate([[0.0], np.cumsum(power[order])])
    target = edges[begin] + rng.random(len(clustering)) * (edges[end] - edges[begin])
    place = np.searchsorted(edges, target, side="right") - 1
    return order[np.clip(place, begin, end - 1)].astype(np.int32)
