"""Shading points where a test wants them."""

from __future__ import annotations

import numpy as np

from lumigate.core.view.points import ShadingPoints


def points_at(position, normal, error: float = 0.0) -> ShadingPoints:
    """Grey points on given positions (N, 3) and normals (N, 3 or 3), a pixel each; error: of the positions (m)."""
    points = ShadingPoints.allocate(len(position))
    for field in points:
        field[...] = 0
    points.position[:] = position
    points.ng[:] = points.ns[:] = points.wo[:] = normal
    points.error[:] = error
    points.pixel[:] = np.arange(len(position))
    points.albedo[:] = 0.5
    return points
