"""Fuzzy clustering: a fast, smooth preview of what many VPLs give to many shading points.

Fuzzy clustering paper (2022), Section 3.  Shading points and VPLs are both clustered; shadow rays join clusters only,
and the visibility of a point is a blend over the clusters around it, while geometry terms are its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..clustering import (
    Clustering,
    FuzzyAssignment,
    PointBlocks,
    VplClusters,
    cluster_vpls,
    fuzzy_assign,
    kmeans,
    point_blocks,
    sum_by_cluster,
)
from ..particles import Vpls
from ..rays.order import morton_order
from ..scene import TRANSPARENT
from ..threads import Progress, run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints, pixel_maxima
from .cluster_shading import Lights, blend_values, light_tables, shade, trace_clusters
from .instant_radiosity import clamp_of, compensate
from .light_cache import LightCache, no_cache

SHADE_WITH = ("clusters", "vpls")

CLUSTERS_A_CHUNK = 256  # neighbours, so that a light's rays to their representatives are coherent
POINTS_A_CHUNK = 1024
VISIBILITY_BYTES = 1 << 26  # of visibility in memory at once
# The light that the clamp took is noisy: it is spread over this many clusters, and what exceeds OUTLIER times the mean
# of the COARSE clusters around over all of those.
SPREAD = 9
FEWEST_RAYS = 2048  # that find it, where clusters are few
COARSE = 64
OUTLIER = 2.0
BROAD_FUZZINESS = 6
_TRAINING = 4  # training points a cluster
_ITERATIONS = 3


@dataclass(frozen=True)
class ViewClusters:
    """C clusters of a view's N shading points.

    sizes: (C,) int32, members.  members: (N',) int64, the points that have a cluster, cluster by cluster.
    representatives: C shading points, in space-filling order, which is the clusters' own.
    at: (C,) int64, which points they are.  order: (N',) int32, all points in space-filling order.
    fuzzy: the clusters of each point and their weights.
    seen: (C, 2) float32, the light visible from each representative, and all light that faces it.
    """

    sizes: np.ndarray
    members: np.ndarray
    representatives: ShadingPoints
    at: np.ndarray
    order: np.ndarray
    fuzzy: FuzzyAssignment
    seen: np.ndarray

    def random_members(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """(C * count,) points: `count` members of each cluster, one at random from each of as many equal parts of it."""
        first = np.cumsum(self.sizes, dtype=np.int64) - self.sizes
        within = (np.arange(count) + rng.random((len(self.sizes), count))) / count
        return self.members[first[:, None] + (within * self.sizes[:, None]).astype(np.int64)].ravel()


class FuzzyClustering:
    """Visibility by clusters, geometry terms by points.

    vpl_clusters, point_clusters: about how many (Section 3.2.1).
    fuzziness, weighting: of `fuzzy_assign`; fuzziness 1 is hard clustering.
    shade_with: `clusters` shades with one representative of each VPL cluster, which has the cluster's flux (Eq. 6);
        `vpls` with every VPL, clusters giving only visibility.
    compensation: gather rays a point cluster that give back the light taken by the clamp (0: none).
    own_compensation: gather rays a point that do so instead, for whoever denoises what they find (`noisy`); 0 for clusters' rays.
    sharers: neighbouring point clusters that share one shadow ray to a light which gives them little; 1 for a ray each.  Only where `clusters` shade.
    cache: what is known of the light that surfaces send, where their paths may end.

    `prepare` does the work on the lights, `irradiance` that on the view: other views of the same VPLs cost no work on lights.
    """

    def __init__(
        self,
        *,
        vpl_clusters: int = 1000,
        point_clusters: int = 8000,
        fuzziness: int = 6,
        weighting: str = "smooth",
        shade_with: str = "clusters",
        compensation: int = 8,
        own_compensation: int = 0,
        sharers: int = 1,
        cache: LightCache | None = None,
        bounces: int = 4,
        seed: int = 0,
        threads: int = 0,
    ):
        if shade_with not in SHADE_WITH:
            raise ValueError(f"shade_with: expected one of {', '.join(SHADE_WITH)}, got {shade_with!r}")
        self.vpl_clusters = vpl_clusters
        self.point_clusters = point_clusters
        self.fuzziness = fuzziness
        self.weighting = weighting
        self.shade_with = shade_with
        self.compensation = compensation
        self.own_compensation = own_compensation
        self.sharers = sharers
        self.cache = no_cache() if cache is None else cache
        self.bounces = bounces
        self.seed = seed
        self.threads = threads
        self.rays = 0
        self.pairs = 0
        self.view: ViewClusters | None = None  # of the last call of `irradiance`
        self.noisy: np.ndarray | None = None  # (N, 3), the part of what that returned that has noise; None for none

    def prepare(self, scene: Transport, vpls: Vpls, points: ShadingPoints) -> None:
        """Takes the scene and clusters its VPLs; `points` only sets the scale of the clamp."""
        self.scene = scene
        self.lights = lights_of(vpls, cluster_vpls(vpls, self.vpl_clusters, seed=self.seed, threads=self.threads), self.shade_with)
        self.g_max = np.float32(clamp_of(self.lights.vpls, points))

    def irradiance(self, points: ShadingPoints, progress: Progress | None = None) -> np.ndarray:
        """Indirect irradiance at N points, (N, 3) float32, W/m^2; zero where a coordinate is not finite."""
        out, self.noisy = np.zeros((len(points.pixel), 3), np.float32), None
        blocks = point_blocks(points.position, points.ns)
        if len(self.lights.power) == 0 or len(blocks) == 0:
            return out
        self.view = self._cluster_view(points, blocks)
        self._light(points, out, progress)
        if np.isfinite(self.g_max):
            if self.own_compensation:
                self.noisy = self._given_back(points)
                out += self.noisy
            elif self.compensation:
                self._give_back(points, out)
        self.pairs += len(out) * len(self.lights.power)
        return out

    def _cluster_view(self, points: ShadingPoints, blocks: PointBlocks) -> ViewClusters:
        gamma = max(1.0, len(blocks) / (_TRAINING * self.point_clusters))
        clustering = kmeans(blocks, None, self.point_clusters, iterations=_ITERATIONS, gamma=gamma, seed=self.seed, threads=self.threads)
        # Neighbouring representatives are neighbours in memory: their rays are traced together.
        at = clustering.representatives
        order = morton_order(points.position[at], points.ns[at])
        at = at[order]
        representatives = points.take(at)
        fuzzy = self._blend_over(blocks, None, representatives, self.fuzziness, self.weighting)
        members = _by_cluster(clustering, order)
        return ViewClusters(clustering.sizes[order], members, representatives, at, blocks.order, fuzzy, np.zeros((len(at), 2), np.float32))

    def _blend_over(self, positions, normals, representatives: ShadingPoints, count: int, weighting: str) -> FuzzyAssignment:
        centres = representatives.position, representatives.ns
        return fuzzy_assign(positions, normals, *centres, count, weighting=weighting, threads=self.threads)

    def _light(self, points: ShadingPoints, out: np.ndarray, progress: Progress | None) -> None:
        """Adds the light of all VPLs, in tiles of as many as the memory for visibility allows."""
        lights, view = self.lights, self.view
        cutouts = bool((self.scene.materials.flags & TRANSPARENT).any())
        clusters = len(lights.first) - 1
        columns = max(1, VISIBILITY_BYTES // len(view.at))
        begin = 0
        while begin < clusters:
            first = int(lights.first[begin])
            end = max(begin + 1, int(np.searchsorted(lights.first, first + columns, side="right")) - 1)
            visible = np.empty((len(view.at), int(lights.first[end]) - first), np.uint8)

            def trace(b, e, begin=begin, end=end, visible=visible):
                return trace_clusters(
                    self.scene,
                    view.representatives,
                    b,
                    e,
                    lights,
                    begin,
                    end,
                    self.g_max,
                    cutouts,
                    self.sharers if self.shade_with == "clusters" else 1,
                    np.uint32(self.seed),
                    visible,
                    view.seen,
                )

            def light(b, e, first=first, visible=visible):
                shade(points, view.order, b, e, lights.table, first, visible, *view.fuzzy[:2], self.g_max, out)

            half = (end - begin) / (2 * clusters)
            self.rays += sum(run_chunks(trace, len(view.at), CLUSTERS_A_CHUNK, self.threads, _part(progress, begin / clusters, half)))
            run_chunks(light, len(view.order), POINTS_A_CHUNK, self.threads, _part(progress, begin / clusters + half, half))
            begin = end

    def _given_back(self, points: ShadingPoints) -> np.ndarray:
        """The light that the clamp took (N, 3), found by each point's own rays."""
        order = self.view.order
        found = np.zeros((len(points.pixel), 3), np.float32)
        found[order] = self._lost(_places(points, order), self.own_compensation)
        return found

    def _lost(self, at: ShadingPoints, samples: int) -> np.ndarray:
        """What the clamp took from N points, (N, 3), by `samples` gather rays each."""
        lost = np.zeros((len(at.position), 3), np.float32)

        def gather(begin, end):
            return compensate(self.scene, self.cache, at, begin, end, self.g_max, samples, self.bounces, np.uint32(self.seed + 1), lost)

        self.rays += sum(run_chunks(gather, len(lost), POINTS_A_CHUNK, self.threads))
        return lost

    def _give_back(self, points: ShadingPoints, out: np.ndarray) -> None:
        """Adds the light that the clamp took: a mean for each cluster, found at random members, blended like visibility."""
        view = self.view
        count = max(self.compensation, -(-FEWEST_RAYS // len(view.at)))
        at = _places(points, view.random_members(count, np.random.default_rng(self.seed)))
        means = self._lost(at, 1).reshape(-1, count, 3).mean(axis=1)
        self._add_blend(self._smoothed(means), out)

    def _smoothed(self, values: np.ndarray) -> np.ndarray:
        """Noisy values (C, 3) of the clusters, spread over their neighbours; what stands far out is spread further, so that it is not lost."""
        at, sizes = self.view.representatives, self.view.sizes[:, None]
        coarse = kmeans(at.position, at.ns, max(1, len(values) // COARSE), seed=self.seed, threads=self.threads)
        broad = self._blend_over(at.position, at.ns, at.take(coarse.representatives), BROAD_FUZZINESS, "smooth")
        near = self._blend_over(at.position, at.ns, at, SPREAD, "plain")

        def broadly(v):
            return _blended(sum_by_cluster(v * sizes, coarse) / sum_by_cluster(sizes, coarse), broad.indices, broad.weights)

        kept = values * np.minimum(1, OUTLIER * broadly(values).sum(axis=1) / np.maximum(values.sum(axis=1), 1e-30))[:, None]
        smooth = _blended(kept, near.indices, near.weights * sizes[near.indices, 0]) + broadly(values - kept)
        # Blends hold means up to a per cent or so: the sum over all points stays what it was.
        return smooth * ((values * sizes).sum(axis=0) / np.maximum((smooth * sizes).sum(axis=0), 1e-30))

    def _add_blend(self, values: np.ndarray, out: np.ndarray) -> None:
        """Adds the fuzzy blend of the clusters' values (C, D) to out (N, D)."""
        clusters, weights, _ = self.view.fuzzy
        run_chunks(lambda begin, end: blend_values(values, clusters, weights, begin, end, out), len(out), POINTS_A_CHUNK, self.threads)

    def debug_layers(self, points: ShadingPoints, shape: tuple[int, int]) -> dict[str, np.ndarray]:
        """Pictures (H, W, C) of the clusters that the last `irradiance(points)` made, by layer name.

        PointClusters: the number of each pixel's cluster, from 1 (0: no surface).  PointRepresentatives: that number where the
        representative is.  FuzzyWeights0, ...: the blend's weights, nearest cluster first, three a layer.
        VisibleShare: the share of the facing VPLs' light that is visible, a cluster each; VisibleShareBlended: as blended.
        """
        view, n = self.view, len(points.pixel)
        if view is None:
            return {}
        hard, weights = view.fuzzy.indices[:, 0], view.fuzzy.weights
        share = (view.seen[:, :1] / np.maximum(view.seen[:, 1:], np.float32(1e-30))).astype(np.float32)
        blended = np.zeros((n, 1), np.float32)
        self._add_blend(share, blended)
        representative = np.zeros((n, 1), np.float32)
        representative[view.at, 0] = np.arange(1, len(view.at) + 1)
        padded = np.pad(weights, ((0, 0), (0, -weights.shape[1] % 3)))
        pictures = {"PointClusters": hard[:, None] + 1.0, "PointRepresentatives": representative}
        pictures |= {f"FuzzyWeights{k}": padded[:, 3 * k : 3 * k + 3] for k in range(padded.shape[1] // 3)}
        pictures |= {"VisibleShare": share[hard], "VisibleShareBlended": blended}
        return {name: pixel_maxima(values, points.pixel, shape) for name, values in pictures.items()}


def _places(points: ShadingPoints, index: np.ndarray) -> ShadingPoints:
    """The points at `index`, of which gather rays read no more than these fields; the others, ten times as large, have no rows."""
    read = ("position", "ns", "ng", "error")
    return ShadingPoints(*(a[index] if name in read else a[:0] for name, a in zip(points._fields, points)))


def lights_of(vpls: Vpls, clusters: VplClusters, shade_with: str) -> Lights:
    """The lights that shade, in the order of `Lights`."""
    order = morton_order(clusters.lights.position, clusters.lights.normal)
    if shade_with == "clusters":
        lights, sizes = clusters.lights.take(order), np.ones(len(order), np.int64)
    else:
        lights, sizes = vpls.take(_by_cluster(clusters.clustering, order)), clusters.clustering.sizes[order]
    return light_tables(lights, np.concatenate([[0], np.cumsum(sizes)]))


def _by_cluster(clustering: Clustering, order: np.ndarray) -> np.ndarray:
    """The points that have a cluster, cluster by cluster, with the clusters in `order`."""
    rank = np.empty(len(order) + 1, np.int64)
    rank[order] = np.arange(len(order))
    rank[-1] = -1  # of the points without a cluster, whose assignment is -1 too
    place = rank[clustering.assignment]
    return np.argsort(place, kind="stable")[np.count_nonzero(place < 0) :]


def _blended(values: np.ndarray, indices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted means (N, D) of values (C, D) at indices (N, F)."""
    return np.einsum("nf,nfd->nd", weights, values[indices]) / weights.sum(axis=1)[:, None]


def _part(progress: Progress | None, begin: float, length: float) -> Progress | None:
    """The progress function of a part of the work."""
    return None if progress is None else lambda fraction: progress(begin + length * fraction)
