"""Virtual area lights against the same VPLs with shadow rays."""

import itertools

import numpy as np
import pytest

from lumigate.core.lamps import build_emitters
from lumigate.core.methods.instant_radiosity import InstantRadiosity
from lumigate.core.methods.virtual_area_lights import VirtualAreaLights, map_origins, wanted_area_lights
from lumigate.core.metrics import relmse
from lumigate.core.particles import Vpls
from lumigate.core.rays import RayScene
from lumigate.core.transport import transport
from lumigate.core.view.points import ShadingPoints

FLOOR = [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)]
SHELF = [(-0.5, -0.7, 1), (0.6, -0.7, 1), (0.6, 0.5, 1), (-0.5, 0.5, 1)]
CEILING = [(-2, 2, 2), (2, 2, 2), (2, -2, 2), (-2, -2, 2)]
WIDTH = 40


@pytest.fixture(scope="module")
def room(build):
    """Transport tables of a floor, a shelf that shades it, and a ceiling."""
    geometry = build.geometry(*build.quads(FLOOR, SHELF, CEILING))
    scene = build.scene(geometry, build.materials((0.5, 0.0)))
    with RayScene(geometry.vertices, geometry.triangles) as rays:
        yield transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))


@pytest.fixture(scope="module")
def points():
    """The floor seen from above, a point a pixel."""
    found = ShadingPoints.allocate(WIDTH * WIDTH)
    for field in found:
        field[...] = 0
    found.pixel[:] = np.arange(WIDTH * WIDTH)
    found.position[:, 0] = (found.pixel % WIDTH + 0.5) / WIDTH * 3.6 - 1.8
    found.position[:, 1] = (found.pixel // WIDTH + 0.5) / WIDTH * 3.6 - 1.8
    found.ng[:, 2] = found.ns[:, 2] = 1
    found.error[:], found.albedo[:] = 1e-6, 0.5
    return found


@pytest.fixture(scope="module")
def vpls():
    """512 VPLs on the ceiling."""
    rng = np.random.default_rng(3)
    lights = Vpls.allocate(512)
    for field in lights:
        field[...] = 0
    lights.position[:] = np.column_stack([rng.uniform(-1.9, 1.9, (512, 2)), np.full(512, 2.0)])
    lights.normal[:, 2], lights.flux[:], lights.error[:], lights.bounce[:] = -1, 1, 1e-6, 1
    lights.surface_normal[:] = lights.normal
    return lights


@pytest.fixture(scope="module")
def exact(room, points, vpls):
    """Irradiance of these VPLs by shadow rays."""
    solver = InstantRadiosity(compensation=0)
    solver.prepare(room, vpls, points)
    return solver.irradiance(points)


def error(got, exact):
    return relmse(got.reshape(WIDTH, WIDTH, 3), exact.reshape(WIDTH, WIDTH, 3))


def solve(room, points, vpls, **options):
    solver = VirtualAreaLights(compensation=0, **options)
    solver.prepare(room, vpls, points)
    return solver, solver.irradiance(points)


def test_error_falls_with_the_number_of_area_lights(room, points, vpls, exact):
    errors = [error(solve(room, points, vpls, vals=m)[1], exact) for m in (2, 10, 30, 100)]
    assert all(b < 1.05 * a for a, b in itertools.pairwise(errors))
    assert errors[2] < 0.005 and errors[3] < 0.002


@pytest.mark.parametrize("terms", [4, 8, 16])
def test_energy(room, points, vpls, exact, terms):
    _, got = solve(room, points, vpls, vals=30, terms=terms)
    assert got.mean() == pytest.approx(exact.mean(), rel=0.03)


def test_interleaving_changes_little(room, points, vpls, exact):
    _, whole = solve(room, points, vpls, vals=30, width=WIDTH, interleave=1)
    solver, parts = solve(room, points, vpls, vals=30, width=WIDTH, interleave=4)
    assert solver.interleave == 4
    assert error(parts, whole) < 2e-3  # a blur over 4 of 40 pixels
    assert error(parts, exact) < 0.01


def test_same_bits_for_any_number_of_threads(room, points, vpls):
    a, b = (solve(room, points, vpls, vals=12, width=WIDTH, threads=threads)[1] for threads in (1, 3))
    assert np.array_equal(a, b)


@pytest.mark.parametrize("count", [1, 31, 33, 500])
def test_any_number_of_vpls(room, points, vpls, count):
    # Tables are padded: what is behind the last light must not shine, whatever was in that memory.
    some = vpls.take(slice(0, count))
    exact = InstantRadiosity(compensation=0)
    exact.prepare(room, some, points)
    wanted = exact.irradiance(points)
    for _ in range(3):
        dirt = [np.full(4096, np.nan, np.float32) for _ in range(64)]
        del dirt
        _, got = solve(room, points, some, vals=30, width=WIDTH)
        assert np.isfinite(got).all()
        assert got.mean() == pytest.approx(wanted.mean(), rel=0.05)


def test_rays_set_right_what_maps_have_wrong(room, points, vpls, exact, monkeypatch):
    # Maps that see everything: all shadows come from the rays.
    def blind(self, lights):
        make_maps(self, lights)
        self.maps.tables[...] = 0

    make_maps = VirtualAreaLights.make_maps
    monkeypatch.setattr(VirtualAreaLights, "make_maps", blind)
    _, got = solve(room, points, vpls, vals=30, width=WIDTH)
    assert error(got, exact) < 0.02
    assert got.mean() == pytest.approx(exact.mean(), rel=0.02)


def test_light_of_several_seeds_has_no_bias(room, points, vpls, exact):
    found = np.mean([solve(room, points, vpls, vals=30, width=WIDTH, seed=8 * s)[1] for s in range(8)], axis=0)
    assert found.mean() == pytest.approx(exact.mean(), rel=0.005)


def test_a_centre_inside_geometry_is_left(build):
    # VPLs on the ground on both sides of a block: their mean is inside of it.
    block = [
        [(-0.5, -3, 0), (-0.5, -3, 1), (-0.5, 3, 1), (-0.5, 3, 0)], [(0.5, -3, 0), (0.5, 3, 0), (0.5, 3, 1), (0.5, -3, 1)],
        [(-0.5, -3, 1), (0.5, -3, 1), (0.5, 3, 1), (-0.5, 3, 1)],
    ]  # fmt: skip
    geometry = build.geometry(*build.quads([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], *block))
    scene = build.scene(geometry, build.materials((0.5, 0.0)))
    rng = np.random.default_rng(5)
    lights = Vpls.allocate(64)
    for field in lights:
        field[...] = 0
    side = np.where(np.arange(64) % 2, 1, -1)
    lights.position[:] = np.column_stack([side * rng.uniform(0.6, 1, 64), rng.uniform(-1, 1, 64), np.zeros(64)])
    lights.normal[:, 2], lights.flux[:], lights.bounce[:], lights.error[:] = 1, 1, 1, 1e-6
    lights.surface_normal[:] = lights.normal
    with RayScene(geometry.vertices, geometry.triangles) as rays:
        tables = transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))
        solver = VirtualAreaLights(vals=1, compensation=0)
        at = ShadingPoints.allocate(2)
        for field in at:
            field[...] = 0
        at.position[:, 0], at.position[:, 2], at.ns[:, 0], at.ng[:, 0] = (-5, 5), 3, (1, -1), (1, -1)
        solver.prepare(tables, lights, at)
        origin = map_origins(tables, lights, solver.area_lights, np.float32(1e-3))
    assert abs(solver.area_lights.centre[0, 0]) < 0.2  # in the block
    assert abs(origin[0, 0]) > 0.59  # at a member
    assert solver.depth[0].max() > 3  # and it sees out


def test_more_lights_for_more_complex_lighting(vpls):
    spot = vpls.take(np.linalg.norm(vpls.position[:, :2], axis=1) < 0.4)
    few, many = (wanted_area_lights(lights, 4.0) for lights in (spot, vpls))
    assert 8 <= few < many <= 128 and many == 2 ** round(np.log2(many))


def test_interleave_is_checked():
    with pytest.raises(ValueError, match="interleave"):
        VirtualAreaLights(interleave=9)
