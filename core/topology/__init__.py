"""Topology of the empty space: voxels, thinning, skeleton, visibility clusters, gates (visibility gates paper, 2014)."""

from .blending import Shares, whole
from .build import RESOLUTION, Topology, blocking_triangles, build_topology
from .gates import Gates, gates_by_cluster
from .nearest import SOLID
from .rooms import reachable_emitters, reachable_vpls, rooms_seen, without_emitters
from .skeleton import Skeleton, skeleton_of
from .store import IN_MEMORY, Topologies
from .voxels import Grid, voxelise

__all__ = [
    "IN_MEMORY",
    "RESOLUTION",
    "SOLID",
    "Gates",
    "Grid",
    "Shares",
    "Skeleton",
    "Topologies",
    "Topology",
    "blocking_triangles",
    "build_topology",
    "gates_by_cluster",
    "reachable_emitters",
    "reachable_vpls",
    "rooms_seen",
    "skeleton_of",
    "voxelise",
    "whole",
    "without_emitters",
]
