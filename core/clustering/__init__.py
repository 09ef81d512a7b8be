"""Clusters of shading points and of VPLs: k-means with normals, fuzzy assignment, representatives."""

from .blocks import PointBlocks, point_blocks
from .kmeans import NORMAL_THRESHOLD, Clustering, kmeans

__all__ = ["NORMAL_THRESHOLD", "Clustering", "PointBlocks", "kmeans", "point_blocks"]
