"""Instant radiosity against closed forms: the energy must be right before anything is tuned."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.lamps import build_emitters
from lumigate.core.methods.instant_radiosity import InstantRadiosity, clamp_of
from lumigate.core.particles import Vpls, trace_particles
from lumigate.core.rays import RayScene
from lumigate.core.transport import transport
from lumigate.core.view.points import ShadingPoints

from .grey_points import points_at


def tables_of(scene):
    """The transport tables of an array scene, and the ray scene that must outlive them."""
    rays = RayScene(scene.geometry.vertices, scene.geometry.triangles)
    return transport(scene.geometry, scene.materials.tables, rays.tables, build_emitters(scene)), rays


def sun(direction, irradiance):
    """Parallel light that falls along `direction`."""
    z = -np.asarray(direction, float) / np.linalg.norm(direction)
    x = np.cross((0.3, 1, 0.2), z)
    x /= np.linalg.norm(x)
    f = np.float32
    return sc.Lamps(
        np.array([sc.SUN], np.int32), np.zeros((1, 3), f), np.stack([x, np.cross(z, x), z])[None].astype(f), np.full((1, 3), irradiance, f),
        np.zeros(1, f), np.zeros(1, np.uint8), np.zeros(1, f), np.zeros(1, f), np.zeros((1, 2), f),
        np.zeros(1, np.int32), np.full(1, sc.ALL_RAYS, np.uint8), np.ones(1, np.uint8), ["Sun"], [""],
    )  # fmt: skip


def test_a_glossy_floor_sends_light_onwards(build):
    # A mirror floor of reflectance .8 in slanting sunlight: all of it goes the mirrored way, and none is lost.
    floor = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    slant = np.array([np.sin(1.0), 0, -np.cos(1.0)])
    scene = build.scene(
        build.geometry(*build.quads(floor)), build.glossy_materials((0.0, 0.0), albedo=0.8, roughness=0.0), lamps=sun(slant, 2.0)
    )
    tables, rays = tables_of(scene)
    with rays:
        vpls, _ = trace_particles(tables, 4096, 2, seed=1)
        # Irradiance that the lights give to a large dome over the floor.
        u = (np.arange(400) + 0.5) / 400
        up, turn = np.meshgrid(u, 2 * np.pi * u[::4], indexing="ij")
        out = np.stack([np.sqrt(1 - up**2) * np.cos(turn), np.sqrt(1 - up**2) * np.sin(turn), up], -1).reshape(-1, 3)
        points = points_at(1000 * out, -out, 1e-6)
        solver = InstantRadiosity(compensation=0)
        solver.prepare(tables, vpls.take(np.arange(64)), points)
        lit = solver.irradiance(points)[:, 0]
    np.testing.assert_allclose(np.median(vpls.normal, axis=0), slant * (1, 1, -1), atol=1e-3)
    expected = 0.8 * 2.0 * 4 * np.cos(1.0)
    leaving = (vpls.flux[:, 0] * (1 + vpls.normal[:, 2]) / 2).sum(dtype=float)
    assert leaving == pytest.approx(expected, rel=0.01)
    share = vpls.flux[:64, 0].sum(dtype=float) / vpls.flux[:, 0].sum(dtype=float)
    assert lit.mean() * 2 * np.pi * 1000**2 == pytest.approx(share * expected, rel=0.01)
    centre = (out * lit[:, None]).sum(0) / lit.sum()
    assert centre[0] > 0.4  # with a diffuse floor, 0


def parallel_squares_form_factor(side, distance):
    """Form factor of two aligned parallel squares (Howell, Catalog of Radiation Heat Transfer, C-11)."""
    x = side / distance
    s = np.sqrt(1 + x * x)
    return 2 / (np.pi * x * x) * (np.log(np.sqrt((1 + x * x) ** 2 / (1 + 2 * x * x))) + 2 * x * s * np.arctan(x / s) - 2 * x * np.arctan(x))


@pytest.mark.parametrize("distance", [0.5, 2.0])
def test_two_parallel_patches(build, distance):
    # The lower patch shines (and is black), the upper one returns rho of what it receives: one bounce.
    lower = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    upper = [(0, 1, distance), (1, 1, distance), (1, 0, distance), (0, 0, distance)]
    scene = build.scene(build.geometry(*build.quads(lower, upper), material=[0, 0, 1, 1]), build.materials((0.0, 1.0), (0.8, 0.0)))
    tables, rays = tables_of(scene)
    with rays:
        vpls, _ = trace_particles(tables, 1 << 16, 1, seed=1)
        u = (np.stack(np.meshgrid(np.arange(16), np.arange(16)), -1).reshape(-1, 2) + 0.5) / 16
        points = points_at(np.column_stack([u, np.zeros(len(u))]), (0, 0, 1), 1e-6)
        solver = InstantRadiosity(bounces=1, compensation=64, seed=5)
        solver.prepare(tables, vpls, points)
        got = solver.irradiance(points)[:, 0].mean()
    m = 96
    w = (np.arange(m) + 0.5) / m
    gx, gy = np.meshgrid(w, w, indexing="ij")
    down = np.array([patch_irradiance(x, y, distance) for x, y in zip(gx.ravel()[::37], gy.ravel()[::37])])
    assert down.mean() == pytest.approx(np.pi * parallel_squares_form_factor(1, distance), rel=0.01)
    # Mean over the lower patch: the integral over the upper one of rho E(y) F(y -> lower), with F = E(y) / pi.
    every = np.array([patch_irradiance(x, y, distance) for x, y in zip(gx.ravel(), gy.ravel())])
    assert got == pytest.approx(0.8 * (every * every / np.pi).mean(), rel=0.005)


def patch_irradiance(x, y, h):
    """Irradiance at (x, y, h) facing down, from a unit square at z = 0 of radiance 1 (sum of four corner squares)."""

    def corner(a, b):
        a, b = abs(a) / h, abs(b) / h
        p, q = np.sqrt(1 + a * a), np.sqrt(1 + b * b)
        return (a / p * np.arctan(b / p) + b / q * np.arctan(a / q)) / 2

    return sum(np.sign(a) * np.sign(b) * corner(a, b) for a in (x, 1 - x) for b in (y, 1 - y))


def test_compensation_gives_back_what_the_clamp_takes(build):
    # A corner: floor and wall meet; without compensation the clamp darkens it, with it the sum is the unclamped one.
    floor = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    wall = [(0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)]
    lamps = sc.Lamps.empty()
    lamps = sc.Lamps(
        np.array([sc.POINT], np.int32), np.array([[0.8, 0.5, 0.8]], np.float32), np.eye(3, dtype=np.float32)[None], np.ones((1, 3), np.float32),
        np.zeros(1, np.float32), np.zeros(1, np.uint8), np.zeros(1, np.float32), np.zeros(1, np.float32), np.zeros((1, 2), np.float32),
        np.zeros(1, np.int32), np.full(1, sc.ALL_RAYS, np.uint8), np.ones(1, np.uint8), ["Lamp"], [""],
    )  # fmt: skip
    scene = build.scene(build.geometry(*build.quads(floor, wall)), build.materials((0.7, 0.0)), lamps=lamps)
    tables, rays = tables_of(scene)
    x = np.geomspace(0.003, 0.9, 64)
    points = points_at(np.column_stack([x, np.full(64, 0.5), np.zeros(64)]), (0, 0, 1), 1e-6)
    with rays:
        vpls, _ = trace_particles(tables, 1 << 11, 1, seed=2)
        both, clamped = (InstantRadiosity(bounces=1, compensation=samples, seed=1) for samples in (512, 0))
        for solver in (both, clamped):
            solver.prepare(tables, vpls, points)
        a, b = (solver.irradiance(points)[:, 0] for solver in (both, clamped))
    exact = np.array([corner_irradiance(at) for at in x])
    near = x < 0.05
    assert (b / exact)[near].mean() < 0.9
    assert (a / exact)[near].mean() == pytest.approx(1, abs=0.03)
    assert (a / exact)[~near].mean() == pytest.approx(1, abs=0.02)


def corner_irradiance(x):
    """Irradiance of the floor at (x, 0.5, 0) by the wall's one bounce, by quadrature on a grid that is fine near the corner."""
    z, y = np.concatenate([[0], np.geomspace(1e-5, 1, 1500)]), np.concatenate([[0], np.geomspace(1e-5, 0.5, 800)])
    area = 2 * np.diff(z)[:, None] * np.diff(y)[None]
    z, y = np.meshgrid((z[1:] + z[:-1]) / 2, (y[1:] + y[:-1]) / 2, indexing="ij")
    on_wall = 0.8 / (0.8**2 + y**2 + (z - 0.8) ** 2) ** 1.5
    return (0.7 * on_wall / np.pi * z * x / (x * x + y * y + z * z) ** 2 * area).sum()


def test_clamp_without_light_is_no_clamp():
    assert clamp_of(Vpls.allocate(0), points_at(np.zeros((1, 3)), (0, 0, 1), 1e-6)) == np.inf


def test_clamp_does_not_hang_on_points_that_see_no_light():
    # Six of ten points on the floor, whose patch of sun lights only the others.
    x = np.linspace(-1, 1, 60)
    floor, ceiling = np.column_stack([x, 0 * x, 0 * x]), np.column_stack([x[:40], 0 * x[:40], 0 * x[:40] + 2])
    n = 64
    vpls = Vpls.allocate(n)
    for column in vpls:
        column[:] = 0
    vpls.position[:, 0], vpls.normal[:, 2], vpls.flux[:] = np.linspace(-0.1, 0.1, n), 1, 1.0
    alone = clamp_of(vpls, points_at(ceiling, (0, 0, -1), 1e-6))
    both = ShadingPoints.concatenate([points_at(floor, (0, 0, 1), 1e-6), points_at(ceiling, (0, 0, -1), 1e-6)])
    assert 0.2 * alone < clamp_of(vpls, both) < alone
