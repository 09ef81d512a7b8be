"""Bumps: steps and slopes against vectors, the bumped normal against Cycles' formula, shadowing against sampled light, pixels' sizes."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.jit import kernel
from lumigate.core.lamps import direct_light
from lumigate.core.methods.tails import tail_light
from lumigate.core.particles import trace_particles
from lumigate.core.stages import Run, prepared
from lumigate.core.surfaces import bumps, footprint, layout
from lumigate.core.surfaces import program as ops
from lumigate.headless.stress import rooms

from .test_glossy import Set, lamp, points_at

F = np.float32


@kernel
def _steps(e, f, step, facing):
    return bumps.steps(e[0], e[1], e[2], f[0], f[1], f[2], step, facing)


@kernel
def _gradient(e, f, rise_x, rise_y, step, facing):
    return bumps.gradient(e[0], e[1], e[2], f[0], f[1], f[2], rise_x, rise_y, step, facing)


@kernel
def _bumped(n, d, strength, m):
    return bumps.bumped_normal(n[0], n[1], n[2], d[0], d[1], d[2], strength, m[0], m[1], m[2])


@kernel
def _shadowing(tilt, cosine):
    return bumps.shadowing(tilt, cosine), bumps.mean_shadowing(tilt)


@kernel
def _pixel(row, p):
    return footprint.pixel_size(row[0], row[1], row[2], row[3], p[0], p[1], p[2])


def _unit(v):
    return v / np.linalg.norm(v)


def _cycles(n, dpdx, dpdy, rise_x, rise_y, distance, strength):
    """svm_node_set_bump, by its own sums."""
    rx, ry = np.cross(dpdy, n), np.cross(n, dpdx)
    det = dpdx @ rx
    bumped = _unit(abs(det) * n - distance * np.sign(det) * (rise_x * rx + rise_y * ry))
    return _unit(strength * bumped + (1 - strength) * n)


def test_steps_slopes_and_normals_are_those_of_cycles():
    rng = np.random.default_rng(8)
    for _ in range(50):
        e, f = rng.normal(size=(2, 3)).astype(F)
        step, facing = F(rng.uniform(1e-3, 0.1)), F(rng.choice((-1, 1)))
        u1, v1, u2, v2 = _steps(e, f, step, facing)
        dpdx, dpdy = u1 * e + v1 * f, u2 * e + v2 * f
        for d in (dpdx, dpdy):
            assert np.linalg.norm(d) == pytest.approx(step, rel=1e-3)
        assert abs(dpdx @ dpdy) < 1e-3 * step**2
        slope = rng.normal(size=3)
        found = np.array(_gradient(e, f, F(slope @ dpdx), F(slope @ dpdy), step, facing))
        m = _unit(np.cross(e, f))
        np.testing.assert_allclose(found, slope - (slope @ m) * m, atol=3e-3)
        n, distance, strength = _unit(m * rng.choice((-1, 1)) + 0.3 * rng.normal(size=3)), rng.uniform(-1, 1), rng.uniform(0, 2)
        bumped = _bumped(n.astype(F), (distance * found).astype(F), F(strength), (3 * m).astype(F))
        expected = _cycles(n, dpdx.astype(float), dpdy.astype(float), slope @ dpdx, slope @ dpdy, distance, strength)
        np.testing.assert_allclose(bumped, expected, atol=3e-3)


def test_a_triangle_without_area_has_no_bumps():
    e = np.array((1, 2, 3), F)
    assert _steps(e, 2 * e, F(0.1), F(1)) == (0, 0, 0, 0)
    assert _gradient(e, 2 * e, F(0.1), F(0.1), F(0.1), F(1)) == (0, 0, 0)
    n = np.array((0, 0, 1), F)
    assert _bumped(n, e, F(1), np.zeros(3, F)) == (0, 0, 1)


def test_mean_shadowing_is_that_of_even_light():
    rng = np.random.default_rng(2)
    z, turn = rng.random(200_000), 2 * math.pi * rng.random(200_000)
    x = np.sqrt(1 - z * z) * np.cos(turn)
    for degrees in (5, 25, 45, 65, 85):
        tilt = math.cos(math.radians(degrees))
        lit = np.maximum(math.sin(math.radians(degrees)) * x + tilt * z, 0)
        alpha2 = min(0.125 * math.tan(math.radians(degrees)) ** 2, 1)
        expected = 2 / (1 + np.sqrt(1 + alpha2 * (1 / (z * z) - 1)))
        np.testing.assert_allclose([_shadowing(F(tilt), F(c))[0] for c in z[:20]], expected[:20], rtol=1e-4)
        assert _shadowing(F(tilt), F(0.5))[1] == pytest.approx((lit * expected).sum() / lit.sum(), abs=4e-3)
    assert _shadowing(F(0), F(0.1)) == (1, 1)
    assert _shadowing(F(1), F(0.1)) == (1, 1)


def test_direct_light_is_shadowed_by_its_own_direction():
    """Cycles 4.5 and 5.2: a sun 80 degrees off the normal of a plane, whose shading normal is 30 degrees off, loses 20.94 %."""
    slant, turn = math.radians(80), math.radians(30)
    sun = Set(lamp(sc.SUN, math.pi, towards=(-math.sin(slant), 0, -math.cos(slant)), angle=0.0))
    points = points_at(4, 1.0)
    points.ns[:] = math.sin(turn), 0, math.cos(turn)
    plain = direct_light(sun.tables, points, 4, 1, lobes=False)[0].irradiance
    points.tilt[:] = math.cos(turn)
    bumped = direct_light(sun.tables, points, 4, 1, lobes=False)[0].irradiance * _shadowing(F(math.cos(turn)), F(1))[1]
    assert plain.min() > 0
    np.testing.assert_allclose(bumped / plain, 0.7906, atol=1e-3)


def _floor(normal):
    """A wide floor under a sun 50 degrees off its normal, of a material with this shading normal, or None for its own."""
    slant = math.radians(50)
    quad = [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)]
    made = Set(lamp(sc.SUN, math.pi, towards=(-math.sin(slant), 0, -math.cos(slant)), angle=0.0), quad=(quad,))
    if normal is not None:
        made.tables.materials.constant[0, layout.NORMAL : layout.NORMAL + 3] = normal
        made.tables.materials.constant[0, layout.TILT] = normal[2]
        made.tables.materials.flags[0] |= sc.NORMAL_MAPPED
    return made


def test_light_that_is_reflected_on_meets_the_bumped_normal():
    """Of particles, and of paths that look down at the floor: by the cosine with the bumped normal, and its shadowing."""
    turn, slant = math.radians(-25), math.radians(50)
    plain, bumped = _floor(None), _floor((math.sin(turn), 0, math.cos(turn)))
    lost = math.cos(slant - turn) / math.cos(slant) * _shadowing(F(math.cos(turn)), F(math.cos(slant)))[0]
    assert lost < 0.45
    points = points_at(64, 1.0, albedo=0.5, f0=0.0, f90=0.0, position=(0, 0, 1))
    points.ng[:] = points.ns[:] = points.wo[:] = 0, 0, -1
    for light in (
        lambda made: trace_particles(made.tables, 64, 1, seed=3, threads=1)[0].flux.sum(),
        lambda made: tail_light(made.tables, points, 2, 3, 1).sum(),
    ):
        assert light(plain) > 0
        assert light(bumped) == pytest.approx(lost * light(plain), rel=2e-3)


def _scene(camera, tables=None):
    vertices = np.array([(0, 0, 0), (3, 4, 0)], F)
    return SimpleNamespace(
        camera=camera, geometry=SimpleNamespace(vertices=vertices), origin=np.array((100.0, 0, 0)), materials=SimpleNamespace(tables=tables)
    )


def _camera(orthographic):
    matrix = np.eye(4)
    matrix[:3, 3] = 1, 2, 3
    return sc.Camera(matrix, orthographic, (-0.5, 0.5, -0.25, 0.25), 100, 50, (0, 0, 100, 50), 0.1, 100)


@pytest.mark.parametrize("directly", [False, True])
def test_a_pixel_is_as_large_as_the_camera_sees_it(directly):
    at = np.array((101, 2, -1), F)  # 4 m in front of the camera
    size = (_pixel(footprint.viewer_row(_scene(camera), directly=directly), at) for camera in (_camera(False), _camera(True), None))
    # Parallel rays do not spread; without a camera it is a ten-thousandth of the scene.
    assert list(size) == pytest.approx([0.04 if directly else 0.08, 0.01, 5e-4])
    assert _pixel(np.zeros(4, F), at) > 0


def test_light_comes_to_a_room_s_points_by_paths_twice_as_long_as_straight_lines():
    camera, by_way, at = np.random.default_rng(3).random((3, 100_000, 3)) * (4, 6, 3)
    straight, path = (np.linalg.norm(a - b, axis=1).mean() for a, b in ((camera, at), (camera, by_way)))
    path += np.linalg.norm(by_way - at, axis=1).mean()
    rows = [footprint.viewer_row(_scene(_camera(False)), directly=directly) for directly in (True, False)]
    assert rows[1][3] / rows[0][3] == pytest.approx(path / straight, rel=0.01)


def test_what_light_meets_that_is_reflected_on_has_larger_pixels_than_what_is_seen():
    scene = rooms.room(size=(4, 3))
    stuff = scene.materials.tables
    code = np.concatenate([stuff.code, np.array([[ops.FOOTPRINT, *[0] * 7], [ops.END, *[0] * 7]], np.int32)])
    scene = replace(scene, materials=replace(scene.materials, tables=stuff._replace(code=code)))
    with prepared(Run(None), scene, rooms.SETTINGS, 1) as tables:
        met = tables.materials.constants[0]
    np.testing.assert_allclose(met, ops.with_viewer(scene, directly=True).constants[0] * (1, 1, 1, 2), rtol=1e-6)


def test_tables_know_the_viewer_only_where_a_program_asks():
    plain = ops.empty_tables()._replace(constants=np.ones((2, 4), F))
    assert ops.with_viewer(_scene(_camera(False), plain), directly=True) is plain
    code = np.array([[ops.FOOTPRINT, *[0] * 7], [ops.END, *[0] * 7]], np.int32)
    asking = ops.with_viewer(_scene(_camera(False), plain._replace(code=code)), directly=True)
    np.testing.assert_allclose(asking.constants, [(101, 2, 3, 0.01), (1, 1, 1, 1)])
    assert (plain.constants == 1).all()
