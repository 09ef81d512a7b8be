"""The curvilinear skeleton of the empty space: nodes with the radii of their maximal balls, and arcs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from .cells import EDGES, POINT, Complex, closure
from .distance import distance_map, opening_map
from .opening import open_shells
from .thinning import CURVES, Keep, Thinning


@dataclass(frozen=True)
class Skeleton:
    """N nodes and M arcs.

    place: (N, 3) int32, corners (x, y, z) of the voxel lattice, in the order of its memory.  radius: (N,) float32, of the maximal
    ball (voxels).  arcs: (M, 2) int32 nodes.  component: (N,) int32, which piece of the empty space a node lies in.
    iterations: of the thinning.  opened: closed surfaces that were opened (core/topology/opening.py).
    """

    place: np.ndarray
    radius: np.ndarray
    arcs: np.ndarray
    component: np.ndarray
    iterations: int = 0
    opened: int = 0

    @property
    def components(self) -> int:
        """How many pieces the empty space has."""
        return int(self.component.max(initial=-1)) + 1


def neighbours(count: int, arcs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each of `count` nodes' neighbours over undirected arcs (M, 2): first (count + 1,) int32, to (2 M,) int32, node by node."""
    both = np.concatenate([arcs, arcs[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    first = np.zeros(count + 1, np.int32)
    np.cumsum(np.bincount(both[:, 0], minlength=count), out=first[1:])
    return first, np.ascontiguousarray(both[:, 1], np.int32)


def skeleton_of(empty: np.ndarray, *, closed: bool = True, keep: Keep = CURVES, threads: int = 0) -> Skeleton:
    """The skeleton of the empty voxels (Z, Y, X) bool; `closed`: what lies outside the volume is solid."""
    distance = distance_map(empty, closed=closed)
    thinning = Thinning(closure(empty), distance, opening_map(distance, threads))
    thinning.collapse(keep)
    opened = open_shells(thinning)
    return graph_of(thinning.complex, distance, thinning.iterations, opened)


def graph_of(curves: Complex, distance: np.ndarray, iterations: int = 0, opened: int = 0) -> Skeleton:
    """The points and edges of a complex as a graph; `distance`: (Z, Y, X) uint8 of its voxels."""
    _, ny, nx = curves.shape
    at = np.argwhere(curves.of_type(POINT))
    strides = np.array([(ny + 1) * (nx + 1), nx + 1, 1])
    code = at @ strides
    arcs = []
    for axis, kind in enumerate(EDGES):
        low = np.argwhere(curves.of_type(kind)) @ strides
        arcs.append(np.stack([np.searchsorted(code, low), np.searchsorted(code, low + strides[2 - axis])], 1))
    arcs = np.concatenate(arcs).astype(np.int32)
    padded = np.pad(distance, 1)
    around = [padded[tuple((at + np.array([k, j, i])).T)] for k in (0, 1) for j in (0, 1) for i in (0, 1)]
    radius = np.maximum.reduce(around).astype(np.float32)
    graph = scipy.sparse.coo_array((np.ones(len(arcs), np.int8), (arcs[:, 0], arcs[:, 1])), (len(at), len(at)))
    component = scipy.sparse.csgraph.connected_components(graph, directed=False)[1] if len(at) else np.zeros(0)
    return Skeleton(np.ascontiguousarray(at[:, ::-1], np.int32), radius, arcs, component.astype(np.int32), iterations, opened)
