"""What the camera sees: the surface points that stand for a pixel, and the lamps in front of them."""

import pytest

from lumigate.core.lamps import world_tables
from lumigate.core.rays import RayScene
from lumigate.core.view.primary import view

from .conftest import camera, geometry, materials, quads, scene


def seen(s, samples=16, seed=1):
    """The view of a scene without transparency."""
    g = s.geometry
    with RayScene(g.vertices, g.triangles, g.object_visibility[g.object]) as rays:
        return view(s, rays.tables, world_tables(s.world), samples, seed)


def test_a_surface_is_lit_wherever_its_pixel_shows_it():
    # Light that is steep within a pixel, such as a lamp's nearest spot, is right in the mean only if the points lie in
    # the pixel as its surface does: a point near the middle would always see the same light.
    floor = quads([(-9, -9, -1), (9, -9, -1), (9, 9, -1), (-9, 9, -1)])
    points = seen(scene(geometry(*floor), materials((0.5, 0.0)), camera=camera(width=48, height=48))).points
    assert len(points.pixel) == 48 * 48
    within = (points.position[:, 0] + 1) * 24 % 1  # across the pixel: one is 1/24 m wide
    assert within.mean() == pytest.approx(1 / 2, abs=0.02)
    assert within.var() == pytest.approx(1 / 12, rel=0.06)
