"""Paraboloid depth maps and convolution soft shadow maps against closed forms."""

import numpy as np
import pytest

from lumigate.core.jit import kernel
from lumigate.core.lamps import build_emitters
from lumigate.core.rays import RayScene
from lumigate.core.shadowmaps.convolution import TERMS, soft_shadow_maps, soft_visibility
from lumigate.core.shadowmaps.paraboloid import EMPTY, direction_to_disk, disk_to_direction, paraboloid_maps
from lumigate.core.transport import transport

FLOOR = [(-8, -8, 0), (8, -8, 0), (8, 8, 0), (-8, 8, 0)]
PLATE = [(-0.5, -0.5, 1), (0.5, -0.5, 1), (0.5, 0.5, 1), (-0.5, 0.5, 1)]
ORIGIN = np.array([[0, 0, 2]], np.float32)
FRAME = np.array([[[1, 0, 0], [0, -1, 0], [0, 0, -1]]], np.float32)  # looks down


@kernel
def _roundtrip(s, t):
    x, y, z = disk_to_direction(np.float32(s), np.float32(t))
    a, b = direction_to_disk(x, y, z)
    return a, b, x, y, z


def test_disk_and_directions():
    for s, t in ((0.0, 0.0), (0.3, -0.4), (-0.9, 0.1)):
        a, b, *d = _roundtrip(s, t)
        assert (a, b) == pytest.approx((s, t), abs=1e-6)
        assert np.linalg.norm(d) == pytest.approx(1) and d[2] > 0


@pytest.fixture(scope="module")
def depth_maps(build):
    """(depth map, rays) above the bare floor, and above the floor with the plate."""
    found = []
    for corners in ((FLOOR,), (FLOOR, PLATE)):
        geometry = build.geometry(*build.quads(*corners))
        scene = build.scene(geometry, build.materials((0.5, 0.0)))
        with RayScene(geometry.vertices, geometry.triangles) as rays:
            tables = transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))
            found.append(paraboloid_maps(tables, ORIGIN, FRAME, 256, False))
    return found


def test_depths_of_a_floor(depth_maps):
    maps, rays = depth_maps[0]
    s, t = np.meshgrid(*[(np.arange(256) + 0.5) / 128 - 1] * 2)
    r2 = s**2 + t**2
    inside = r2 < 1
    assert rays == inside.sum()
    assert (maps[0][~inside] == EMPTY).all()
    cosine = (1 - r2) / (1 + r2)
    near = inside & (cosine > 0.3)
    assert np.allclose(maps[0][near], 2 / cosine[near], rtol=1e-4)


def visible_share(x, y, half):
    """Share of the square light of half side `half` at z = 2 that (x, y, 0) sees past the plate half-way up."""

    def covered(p):
        # The light's point q crosses the plate at (p + q) / 2.
        low, high = max(-1 - p, -half), min(1 - p, half)
        return max(high - low, 0) / (2 * half)

    return 1 - covered(x) * covered(y)


@pytest.mark.parametrize("terms", TERMS)
@pytest.mark.parametrize("half, bound", [(0.05, 0.12), (0.2, 0.12), (0.5, 0.15)])
def test_penumbra_of_a_plate(depth_maps, half, bound, terms):
    maps = soft_shadow_maps(depth_maps[1][0], ORIGIN, FRAME, np.array([[half, half]], np.float32), terms)
    sums = np.empty(maps.tables.shape[3], np.float32)
    x = np.linspace(-3, 3, 121)
    got = np.array([soft_visibility(maps, 0, np.float32(a), np.float32(0.1), np.float32(0), sums) for a in x])
    exact = np.array([visible_share(a, 0.1, half) for a in x])
    assert np.sqrt(np.mean((got - exact) ** 2)) < bound
    assert got[np.abs(x) < 0.5].max() < 0.2 or half > 0.4
    assert (got[np.abs(x) > 2] > 0.95).all()


def test_a_bare_floor_is_lit(depth_maps):
    maps = soft_shadow_maps(depth_maps[0][0], ORIGIN, FRAME, np.array([[0.3, 0.3]], np.float32))
    sums = np.empty(maps.tables.shape[3], np.float32)
    seen = [soft_visibility(maps, 0, np.float32(x), np.float32(0), np.float32(0), sums) for x in np.linspace(0, 6, 30)]
    assert np.mean(seen) > 0.98 and min(seen) > 0.9


def test_unknown_number_of_terms(depth_maps):
    with pytest.raises(ValueError, match="terms"):
        soft_shadow_maps(depth_maps[0][0], ORIGIN, FRAME, np.ones((1, 2), np.float32), 5)
