"""The topology of a scene: rooms, visibility clusters and gates, from its triangles alone."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from ..scene import DIFFUSE, TRANSPARENT, Scene
from .blending import Shares, shares_around
from .clusters import ALPHA, visibility_clusters
from .gates import Gates, disk_gates, polygon_gates
from .merging import SHARE, merged
from .nearest import SOLID, look_up, nodes_of_voxels, voxels_at
from .segmentation import Segmented, segment
from .sheets import thin_sheets
from .sight import sight_of
from .skeleton import Skeleton, skeleton_of
from .voxels import Grid, empty_voxels, voxelise

RESOLUTION = 128  # voxels along the longest side, where none is asked for


@dataclass(frozen=True)
class Topology:
    """What the empty space is like, for N skeleton nodes and K segmented ones.

    node_of: (Z, Y, X) int32, the segmented node of each voxel; SOLID where a surface is.
    cluster: (K,) int32, its visibility cluster.  room: (K,) int32, its connected piece of the empty space.
    disks, polygons: the gates.  sight: (clusters, clusters) bool, between which light may pass.  seconds: what each step took.
    """

    grid: Grid
    skeleton: Skeleton
    segmented: Segmented
    node_of: np.ndarray
    cluster: np.ndarray
    room: np.ndarray
    disks: Gates
    polygons: Gates
    sight: np.ndarray
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def clusters(self) -> int:
        """How many visibility clusters there are."""
        return int(self.cluster.max(initial=-1)) + 1

    @property
    def rooms(self) -> int:
        """How many pieces of empty space there are that nothing joins."""
        return self.skeleton.components

    def nodes_at(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(N,) int32 segmented nodes that surface points look at; SOLID where there is none near.

        points, normals: (N, 3), metres and unit vectors on the side of the empty space.
        """
        out = np.empty(len(points), np.int32)
        look_up(self.node_of, self.grid.low, 1.0 / self.grid.size, points, normals, out)
        return out

    def voxels_at(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(N, 3) int32 empty voxels (x, y, z) that surface points look at; -1 where there is none near."""
        out = np.empty((len(points), 3), np.int32)
        voxels_at(self.node_of, self.grid.low, 1.0 / self.grid.size, points, normals, out)
        return out

    def clusters_at(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(N,) int32 visibility clusters that surface points look at; SOLID where there is none near."""
        return _at(self.cluster, self.nodes_at(points, normals))

    def shares_around(self, points: np.ndarray, normals: np.ndarray, radius: float) -> Shares:
        """The visibility clusters within `radius` voxels of surface points, on the surface, and their shares."""
        return shares_around(self.node_of, self.cluster, self.grid.low, 1.0 / self.grid.size, points, normals, radius)

    def rooms_at(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(N,) int32 rooms that surface points look at; SOLID where there is none near."""
        return _at(self.room, self.nodes_at(points, normals))


def _at(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """values[index], and SOLID where the index is."""
    return np.where(index >= 0, np.append(values, SOLID)[index], SOLID).astype(np.int32)


def blocking_triangles(scene: Scene, cutouts: bool = False) -> np.ndarray:
    """(T', 3) int32: the triangles that stop diffuse light; what lets some of it through is a wall only with `cutouts`."""
    geometry = scene.geometry
    through = (scene.materials.tables.flags[geometry.material] & TRANSPARENT) != 0
    met = (geometry.object_visibility[geometry.object] & DIFFUSE) != 0
    return geometry.triangles[met if cutouts else met & ~through]


def build_topology(
    vertices: np.ndarray,
    triangles: np.ndarray,
    resolution: int = RESOLUTION,
    *,
    closed: bool = True,
    sheets: bool = True,
    alpha: float = ALPHA,
    share: float = SHARE,
    threads: int = 0,
) -> Topology:
    """The topology of what triangles (T, 3) of vertices (V, 3) leave empty in their bounding box.

    resolution: voxels along the longest side.  closed: the bounding box is solid outside; else open space goes on.
    sheets: whether thin sheets (`sheets.thin_sheets`) are walls.
    alpha: of the paper's clusters; share: of free lines, above which neighbours among these are joined, more than 1 for none.

    Raises:
        SceneError: the resolution is out of bounds, or the triangles have no extent.
    """
    clock = _Clock()
    used = vertices[np.unique(triangles)]
    used = used[np.isfinite(used).all(axis=1)]
    grid = Grid.around(used.min(axis=0, initial=np.inf), used.max(axis=0, initial=-np.inf), resolution)
    empty = empty_voxels(voxelise(vertices, triangles, grid), grid)
    clock.lap("voxels")
    if not sheets:
        walls = triangles[~thin_sheets(vertices, triangles, empty, grid)]
        empty = empty_voxels(voxelise(vertices, walls, grid), grid)
        clock.lap("sheets")
    skeleton = skeleton_of(empty, closed=closed, threads=threads)
    clock.lap("thinning")
    segmented = segment(skeleton)
    cluster = visibility_clusters(skeleton, segmented, empty, alpha)
    clock.lap("clusters")
    node_of = nodes_of_voxels(empty, skeleton.place, segmented.owner)
    clock.lap("voxel map")
    cluster = merged(_at(cluster, node_of), int(cluster.max(initial=-1)) + 1, share)[cluster]
    clock.lap("joined clusters")
    room = skeleton.component[segmented.node]
    disks = disk_gates(grid, skeleton, segmented, cluster)
    cluster_of = _at(cluster, node_of)
    polygons = polygon_gates(grid, cluster_of)
    clock.lap("gates")
    sight = sight_of(grid, cluster_of, int(cluster.max(initial=-1)) + 1, polygons)
    clock.lap("sight")
    return Topology(grid, skeleton, segmented, node_of, cluster, room, disks, polygons, sight, clock.seconds)


class _Clock:
    """Seconds between laps."""

    def __init__(self):
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self._last = now
