"""Clusters of shading points and of VPLs: k-means with normals, fuzzy assignment, representatives."""

from .blocks import PointBlocks, point_blocks
from .fuzzy import FuzzyAssignment, fuzzy_assign, median_spacing, nearest_plane_aware
from .kmeans import NORMAL_THRESHOLD, Clustering, kmeans
from .vpl_clusters import VplClusters, cluster_vpls, sum_by_cluster

__all__ = [
    "NORMAL_THRESHOLD",
    "Clustering",
    "FuzzyAssignment",
    "PointBlocks",
    "VplClusters",
    "cluster_vpls",
    "fuzzy_assign",
    "kmeans",
    "median_spacing",
    "nearest_plane_aware",
    "point_blocks",
    "sum_by_cluster",
]
