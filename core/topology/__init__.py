"""Topology of the empty space: voxels, thinning, skeleton, visibility clusters, gates (visibility gates paper, 2014)."""

from .build import RESOLUTION, Topology, blocking_triangles, build_topology
from .gates import Gates
from .nearest import SOLID
from .skeleton import Skeleton, skeleton_of
from .voxels import Grid, voxelise

__all__ = ["RESOLUTION", "SOLID", "Gates", "Grid", "Skeleton", "Topology", "blocking_triangles", "build_topology", "skeleton_of", "voxelise"]
