"""Visibility gates: what sees what, told by the topology of the empty space instead of by rays.

Visibility gates paper (2014), Section V.  Inside a visibility cluster all is taken to be visible; between two clusters, what passes a gate
of the VPL's cluster.  The stages are the paper's: GP is the view, IUGC the geometry clusters, LA the lists, IL the shading.
"""

from __future__ import annotations

import time

import numpy as np

from ..particles import Vpls
from ..scene import TRANSPARENT
from ..threads import Progress, run_chunks
from ..topology import Gates, Shares, Topology, whole
from ..transport import Transport
from ..view.points import ShadingPoints, pixel_maxima
from . import gate_lists
from .gate_guided import shade_guided
from .gate_lists import POINTS, Lists, Runs
from .gate_shading import shade
from .instant_radiosity import clamp_of, compensate
from .light_cache import no_cache

GATES = ("disks", "polygons", "off", "guided")
_CLUSTERS_A_CHUNK = 64
_GATHER_CHUNK = 256  # points


class VisibilityGates:
    """Light of the VPLs of a point's own visibility cluster, and of others through gates.

    topology: of the scene.  gates: `disks` as in the paper, `polygons` fitted to the openings, with lines of voxels as
        a second opinion, or `off`: light stays in its cluster; `guided`:
        shadow rays wherever the polygons leave it open whether a line is free.
    oversize: factor on the gates' radii.  More than 1 lets in what disks are too small for, and more that is hidden.
    blend: voxels around a point over whose visibility clusters its light is blended, so that borders show no edge; 0 for its own alone.  Guided
        rays have no use for it.
    compensation: gather rays a point that give back the light taken by the clamp (0: none).
    seconds: of the stages of the last call of `irradiance`, by the paper's names.
    """

    def __init__(
        self,
        topology: Topology,
        *,
        gates: str = "disks",
        oversize: float = 1.0,
        blend: float = 0.0,
        compensation: int = 8,
        bounces: int = 4,
        seed: int = 0,
        threads: int = 0,
    ):
        if gates not in GATES:
            raise ValueError(f"gates: expected one of {', '.join(GATES)}, got {gates!r}")
        self.topology = topology
        self.gates = gates
        self.oversize = oversize
        self.blend = 0.0 if gates == "guided" else blend
        self.compensation = compensation
        self.bounces = bounces
        self.seed = seed
        self.threads = threads
        self.rays = 0
        self.pairs = 0
        self.saved = 0  # shadow rays that the topology spared, net of those that probed it
        self.seconds: dict[str, float] = {}
        self.runs: Runs | None = None

    def prepare(self, scene: Transport, vpls: Vpls, points: ShadingPoints) -> None:
        """Takes the scene and finds the clusters of its VPLs; `points` only sets the scale of the clamp."""
        self.scene = scene
        self.vpls = vpls
        self.g_max = np.float32(clamp_of(vpls, points))
        self.lights = gate_lists.lights_of(vpls, self.topology.clusters_at(vpls.position, vpls.surface_normal))
        polygons = self.gates == "polygons"
        # The paper's disks light whatever lies in their cones; openings allow a stricter answer.
        sight = self.topology.sight if polygons else np.ones_like(self.topology.sight)
        self.table = gate_lists.gate_table(self._gates().scaled(self.oversize), sight, polygons)

    def _shares(self, points: ShadingPoints) -> Shares:
        """In which visibility clusters the points are lit, and their shares."""
        if self.blend:
            return self.topology.shares_around(points.position, points.ng, self.blend)
        return whole(self.topology.clusters_at(points.position, points.ng))

    def _gates(self) -> Gates:
        if self.gates == "off":
            return Gates(*(array[:0] for array in self.topology.disks))
        return self.topology.polygons if self.gates == "polygons" else self.topology.disks

    def irradiance(self, points: ShadingPoints, progress: Progress | None = None) -> np.ndarray:
        """Indirect irradiance at N points, (N, 3) float32, W/m^2."""
        out = np.zeros((len(points.pixel), 3), np.float32)
        if not len(out) or not len(self.vpls.bounce):
            return out
        begin = time.perf_counter()
        shares = self._shares(points)
        self.runs = gate_lists.runs_of(points.position[shares.item], points.ng[shares.item], shares.cluster, POINTS)
        share = shares.share[self.runs.order, None]
        self.runs = self.runs._replace(order=shares.item[self.runs.order])
        assigned = time.perf_counter()
        lists = None if self.gates == "guided" else self._assign()
        listed = time.perf_counter()
        light = np.empty((len(self.runs.order), 3), np.float32)
        self._shade(points, lists, light, progress)
        light *= share
        for c in range(3):
            out[:, c] = np.bincount(self.runs.order, light[:, c], len(out))
        self.seconds = {"IUGC": assigned - begin, "LA": listed - assigned, "IL": time.perf_counter() - listed}
        if self.compensation and np.isfinite(self.g_max):
            self._give_back(points, out)
        return out

    def _assign(self) -> Lists:
        cones = gate_lists.cones_of(self.lights, self.table)

        def work(begin, end):
            return gate_lists.assign(self.runs, begin, end, self.lights, self.table, cones)

        return gate_lists.joined(run_chunks(work, len(self.runs.cluster), _CLUSTERS_A_CHUNK * gate_lists.GROUP, self.threads))

    def _shade(self, points: ShadingPoints, lists: Lists | None, light: np.ndarray, progress: Progress | None) -> None:
        cutouts = bool((self.scene.materials.flags & TRANSPARENT).any())
        seed, sight = np.uint32(self.seed), self.topology.sight

        lines = gate_lists.no_lines()
        if self.gates == "polygons":
            lines = gate_lists.lines_of(self.topology, self.vpls, self.lights, points, self.runs)

        def listed(begin, end):
            return 0, 0, shade(points, self.runs, begin, end, self.lights, lists, self.table, lines, self.g_max, light)

        def guided(begin, end):
            return shade_guided(self.scene, self.vpls, points, self.runs, begin, end, self.lights, sight, cutouts, self.g_max, seed, light)

        work = guided if lists is None else listed
        counts = run_chunks(work, len(self.runs.cluster), _CLUSTERS_A_CHUNK, self.threads, progress)
        traced, facing, pairs = (sum(column) for column in zip(*counts))
        self.pairs += pairs
        self.rays += traced
        self.saved += facing - traced

    def _give_back(self, points: ShadingPoints, out: np.ndarray) -> None:
        """Adds the light that the clamp took, by gather rays."""

        def work(begin, end):
            seed = np.uint32(self.seed + 1)
            return compensate(self.scene, no_cache(), points, begin, end, self.g_max, self.compensation, self.bounces, seed, out)

        self.rays += sum(run_chunks(work, len(out), _GATHER_CHUNK, self.threads))

    def debug_layers(self, points: ShadingPoints, shape: tuple[int, int]) -> dict[str, np.ndarray]:
        """Pictures (H, W, 1) of the clusters that the last `irradiance(points)` found, numbered from 1; 0 where there is none.

        VisibilityClusters: of each pixel's point, in the topology.  GeometryClusters: of this view.
        """
        if self.runs is None:
            return {}
        sizes = np.diff(self.runs.first)
        numbers = np.zeros((len(points.pixel), 2), np.float32)
        numbers[:, 0] = self.topology.clusters_at(points.position, points.ng) + 1
        numbers[self.runs.order, 1] = np.repeat(np.arange(1, len(sizes) + 1), sizes)
        pictures = pixel_maxima(numbers, points.pixel, shape)
        return {"VisibilityClusters": pictures[..., :1], "GeometryClusters": pictures[..., 1:]}
