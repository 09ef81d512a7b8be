"""Cube shadow maps: right where nothing is near a shadow's edge, and the method that stands on them."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.jit import kernel
from lumigate.core.pipeline import render
from lumigate.core.rays import RayScene
from lumigate.core.settings import RenderSettings
from lumigate.core.shadowmaps.cube import cube_maps, face_direction, face_texel, lit_share


@kernel
def _roundtrip(resolution):
    wrong = 0
    for face in range(6):
        for row in range(resolution):
            for column in range(resolution):
                a = np.float32((column + 0.5) * 2 / resolution - 1)
                b = np.float32((row + 0.5) * 2 / resolution - 1)
                dx, dy, dz = face_direction(face, a, b)
                f, r, c = face_texel(dx * np.float32(3), dy * np.float32(3), dz * np.float32(3), resolution)
                wrong += f != face or r != row or c != column
    return wrong


@pytest.mark.parametrize("resolution", [1, 7, 32])
def test_texel_of_its_own_direction(resolution):
    assert _roundtrip(resolution) == 0


@pytest.fixture(scope="module")
def maps(build):
    # A unit plate one metre above the middle of a big floor; the light two metres above the floor.
    floor = [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)]
    plate = [(-0.5, -0.5, 1), (0.5, -0.5, 1), (0.5, 0.5, 1), (-0.5, 0.5, 1)]
    vertices, triangles = build.quads(floor, plate)
    with RayScene(vertices.astype(np.float32), triangles.astype(np.int32)) as rays:
        light = np.array([[0, 0, 2]], np.float32)
        found, count = cube_maps(rays.tables, light, np.zeros(1, np.float32), np.zeros((1, 3), np.float32), 256, sc.ALL_RAYS)
    assert count == 6 * 256 * 256
    return found


def share(maps, x, samples=1):
    """Lit share of the floor's point (x, 0.01, 0)."""
    d = np.array([x, 0.01, -2], np.float32)
    return lit_share(maps, 0, *d, np.float32(2 / np.linalg.norm(d)), samples, np.uint32(1), np.uint32(5))


def test_shadow_of_a_plate(maps):
    # The plate's shadow on the floor is two metres wide.
    assert [share(maps, x) for x in (0.0, 0.5, 0.9)] == [0, 0, 0]
    assert [share(maps, x) for x in (1.1, 1.5, 4.0, 8.0)] == [1, 1, 1, 1]


def test_filtering_blurs_only_the_edge(maps):
    assert share(maps, 0.5, 64) == 0
    assert share(maps, 1.6, 64) == 1
    assert 0.1 < share(maps, 1.0, 64) < 0.9


@pytest.fixture(scope="module")
def room(build):
    """A room with a block, lit by a point lamp."""

    def box(low, high, inward):
        (x0, y0, z0), (x1, y1, z1) = low, high
        faces = [
            [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)], [(x0, y0, z1), (x0, y1, z1), (x1, y1, z1), (x1, y0, z1)],
            [(x0, y0, z0), (x0, y0, z1), (x1, y0, z1), (x1, y0, z0)], [(x0, y1, z0), (x1, y1, z0), (x1, y1, z1), (x0, y1, z1)],
            [(x0, y0, z0), (x0, y1, z0), (x0, y1, z1), (x0, y0, z1)], [(x1, y0, z0), (x1, y0, z1), (x1, y1, z1), (x1, y1, z0)],
        ]  # fmt: skip
        return faces if inward else [face[::-1] for face in faces]

    faces = box((-2, -2, -4), (2, 2, 0.5), True) + box((-0.6, -0.6, -3.5), (0.6, 0.6, -2.5), False)
    lamps = sc.Lamps(
        np.array([sc.POINT], np.int32), np.array([[1.2, 1.2, -1.0]], np.float32), np.eye(3, dtype=np.float32)[None], np.full((1, 3), 5, np.float32),
        np.zeros(1, np.float32), np.zeros(1, np.uint8), np.zeros(1, np.float32), np.zeros(1, np.float32), np.zeros((1, 2), np.float32),
        np.zeros(1, np.int32), np.full(1, sc.ALL_RAYS, np.uint8), np.ones(1, np.uint8), ["Lamp"], [""],
    )  # fmt: skip
    return build.scene(
        build.geometry(*build.quads(*faces)), build.materials((0.6, 0.0)), lamps=lamps, camera=build.camera(width=24, height=24)
    )


def test_method_agrees_with_rays(room):
    common = {"method": "instant-radiosity", "vpls": 256, "pixel_samples": 4, "compensation": False, "bounces": 2, "seed": 2}
    rays = render(room, RenderSettings(visibility="rays", **common)).layers
    mapped = render(room, RenderSettings(visibility="shadow-maps", **common)).layers
    none = render(room, RenderSettings(visibility="none", **common)).layers
    for name in ("Direct", "DiffuseIndirect"):
        exact = rays[name].astype(np.float64)
        assert mapped[name].mean() == pytest.approx(exact.mean(), rel=0.03)
        error = np.sqrt(((mapped[name] - exact) ** 2).mean()) / exact.mean()
        assert error < 0.25
    # Without any visibility there is clearly more light.
    assert none["DiffuseIndirect"].mean() > 1.05 * rays["DiffuseIndirect"].mean()
