"""Glossy light: shadow rays and rays drawn from lobes give the same light, which is that of closed forms and quadrature."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.jit import kernel
from lumigate.core.lamps import build_emitters, direct_light, sharp_emitters
from lumigate.core.lamps.lookup import can_be_met, emitter_density, lamp_along
from lumigate.core.lamps.sample import sample_emitter
from lumigate.core.lamps.tables import WORLD
from lumigate.core.methods.glossy import has_lobes, reflect
from lumigate.core.methods.tails import tail_light
from lumigate.core.pipeline import render
from lumigate.core.rays import RayScene
from lumigate.core.settings import RenderSettings
from lumigate.core.surfaces import ggx
from lumigate.core.surfaces.layout import DIFFUSE, GLOSSY_F0, GLOSSY_F90, ROUGHNESS, SURFACE
from lumigate.core.surfaces.lobes import ALBEDO, LOBE, flattened_lobe, lobe_value, sample_lobe, set_lobe
from lumigate.core.surfaces.program import new_registers
from lumigate.core.transport import transport
from lumigate.core.view.points import ShadingPoints
from lumigate.headless.stress.arrays import camera, geometry, icosphere, materials, quads

F = np.float32
AWAY = [(90, 90, -50), (90.1, 90, -50), (90.1, 90.1, -50), (90, 90.1, -50)]  # where nothing stands in the way


def axes_towards(direction):
    z = -np.asarray(direction, float) / np.linalg.norm(direction)
    x = np.cross([0.3, 1, 0.2], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def lamp(kind, emission, position=(0, 0, 2), towards=(0, 0, -1), radius=0.0, soft=0, angle=math.pi, blend=0.0, size=(1, 1), shape=0, visibility=sc.ALL_RAYS):  # fmt: skip
    return dict(
        kind=kind, emission=np.broadcast_to(emission, 3), position=position, axes=axes_towards(towards), radius=radius, soft_falloff=soft,
        angle=angle, blend=blend, size=size, shape=shape, visibility=visibility, cast_shadow=1,
    )  # fmt: skip


def lamps_of(*rows):
    empty = sc.Lamps.empty()
    columns = {k: np.array([r[k] for r in rows], getattr(empty, k).dtype) for k in rows[0]} if rows else {}
    return sc.Lamps(**columns, names=[f"lamp {i}" for i in range(len(rows))], groups=[""] * len(rows)) if rows else empty


class Set:
    """A scene ready for light: lamps, quads of (albedo, emission) surfaces and a world (a grey, or an image)."""

    def __init__(self, *rows, quad=(AWAY,), surfaces=((0.5, 0.0),), world=0.0, mesh=None, mirrors=()):
        vertices, triangles = mesh or quads(*quad)
        material = np.zeros(len(triangles), np.int32) if mesh else np.repeat(np.arange(len(quad)), 2)
        g = geometry(vertices, triangles, material)
        stuff = materials(*surfaces)
        for m in mirrors:
            stuff.tables.constant[m, GLOSSY_F0 : GLOSSY_F0 + 3] = stuff.tables.constant[m, GLOSSY_F90 : GLOSSY_F90 + 3] = 1
        radiance = np.asarray(world, F)
        radiance = np.full((1, 1, 3), radiance, F) if radiance.ndim == 0 else radiance
        scene = sc.Scene(g, stuff, lamps_of(*rows), sc.World(radiance), camera())
        self.rays = RayScene(g.vertices, g.triangles, g.object_visibility[g.object])
        self.emitters = build_emitters(scene)
        self.tables = transport(g, stuff.tables, self.rays.tables, self.emitters)


def view_at(cosine, azimuth=math.pi + 0.54):
    """Direction to the viewer; its mirror image leans over the lamps below."""
    sine = math.sqrt(1 - cosine * cosine)
    return (sine * math.cos(azimuth), sine * math.sin(azimuth), cosine)


def points_at(n, roughness, cosine=0.7, f0=0.5, f90=1.0, albedo=0.0, position=(0, 0, 0)):
    """n equal points on a plane that faces up."""
    tile = lambda row: np.tile(np.asarray(row, F), (n, 1))  # noqa: E731
    up = tile((0, 0, 1))
    points = ShadingPoints.allocate(n)
    columns = {
        "position": tile(position), "error": np.full(n, 1e-6, F), "ng": up, "ns": up.copy(), "pixel": np.zeros(n, np.int32),
        "triangle": np.zeros(n, np.int32), "albedo": tile((albedo,) * 3), "wo": tile(view_at(cosine)), "f0": tile((f0,) * 3),
        "f90": tile((f90,) * 3), "roughness": np.full(n, roughness, F),
    }  # fmt: skip
    return points._replace(**columns)


def radiance(scene, points, samples=16, reflections=8, seed=1, threads=0):
    """Mean direct and indirect radiance of equal points, and the standard error of the direct one."""
    light, _ = direct_light(scene.tables, points, samples, seed, threads, reflections=reflections)
    shown, indirect, *_ = reflect(scene.tables, points, samples, reflections, 4, seed, threads)
    both = (light.glossy + shown)[:, 0]
    return *mean_and_error(both), indirect[:, 0].mean(dtype=float)


def mean_and_error(values):
    """Mean of independent values and its standard error."""
    return values.mean(dtype=float), values.std(dtype=float) / math.sqrt(len(values))


@kernel
def _integral(lobe, n):
    total = 0.0
    for a in range(n):
        z = np.float32((a + 0.5) / n)
        r = np.float32(np.sqrt(1 - z * z))
        for b in range(n):
            phi = np.float32(2 * np.pi * (b + 0.5) / n)
            total += lobe_value(lobe, r * np.float32(np.cos(phi)), r * np.float32(np.sin(phi)), z)[0]
    return total * 2 * np.pi / (n * n)


def lobe_of(roughness, cosine, f0, f90):
    row = np.zeros(LOBE, F)
    f0, f90 = F(f0), F(f90)
    set_lobe(row, F(0), F(0), F(1), F(0), F(0), F(1), *(F(c) for c in view_at(cosine)), F(roughness), f0, f0, f0, f90, f90, f90)
    return row


# -- the lobe ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cosine", [0.2, 0.5, 0.95])
@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_a_white_lobe_loses_nothing(roughness, cosine):
    assert _integral(lobe_of(roughness, cosine, 1, 1), 1200) == pytest.approx(1, abs=0.012)


@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0])
def test_no_lobe_reflects_more_than_arrives(roughness):
    for cosine in (0.05, 0.3, 1.0):
        for f0 in (0.02, 0.3, 0.9):
            assert _integral(lobe_of(roughness, cosine, f0, 1), 800) < 1.01


def test_reflection_dips_never_below_the_surface():
    """A normal far from the geometric one is bent until the mirror image of the view lies above the surface."""
    row = np.zeros(LOBE, F)
    wo = np.array([0.9, 0.1, 0.2]) / np.linalg.norm([0.9, 0.1, 0.2])
    ns = np.array([-0.6, 0.2, 0.7]) / np.linalg.norm([-0.6, 0.2, 0.7])
    one = F(1)
    set_lobe(row, *(F(c) for c in ns), F(0), F(0), F(1), *(F(c) for c in wo), F(0.1), one, one, one, one, one, one)
    n = row[0:3].astype(float)
    assert np.linalg.norm(n) == pytest.approx(1, abs=1e-5)
    assert (2 * (wo @ n) * n - wo)[2] == pytest.approx(0.01, abs=1e-3)


def lobe_at(slopes, roughness, view):
    """White lobes (N, LOBE) of normals at the slopes (N, 2)."""
    rows = np.zeros((len(slopes), LOBE), F)
    normals = np.column_stack([-slopes, np.ones(len(slopes))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    one = F(1)
    for row, n in zip(rows, normals.astype(F)):
        set_lobe(row, *n, F(0), F(0), one, *(F(c) for c in view), F(roughness), one, one, one, one, one, one)
    return rows


@pytest.mark.parametrize("widths", [(0.05, 0.02), (0.05, 0.0), (0.01, 0.01), (0.01, 0.0), (0.0, 0.0)])
def test_the_lobe_of_normals_that_fill_a_rectangle_is_their_mean(widths):
    roughness, view, n = 0.1, view_at(0.8), 161
    grid = (np.arange(n) + 0.5) / n * 2 - 1
    rows = lobe_at(np.stack(np.meshgrid(widths[0] * grid, widths[1] * grid), -1).reshape(-1, 2), roughness, view)
    along, across = np.array([widths[0], 0, 0], F), np.array([0, widths[1], 0], F)
    for x, y, tolerance in ((0, 0, 0.3), (0.4, -0.2, 0.3), (-0.5, 0, 0.3), (5, 9, 0.1), (-6, 0, 0.1)):
        h = np.array([x * widths[0], y * widths[1], 1.0]) / math.sqrt(1 + (x * widths[0]) ** 2 + (y * widths[1]) ** 2)
        d = (2 * (h @ view) * h - view).astype(F)
        mean = np.mean([lobe_value(row, *d)[0] for row in rows])
        assert flattened_lobe(lobe_at(np.zeros((1, 2)), roughness, view)[0], along, across, *d)[0] == pytest.approx(mean, rel=tolerance)


# -- emitters met by chance --------------------------------------------------------------------------------

SIZED = {
    "area": lamp(sc.AREA, 5, (0.3, 0.2, 1.5), size=(1.5, 0.7)),
    "near area": lamp(sc.AREA, 5, (0.1, 0.2, 0.12), size=(1.5, 0.7)),
    "spread": lamp(sc.AREA, 5, (0.3, 0.2, 1.5), size=(1.5, 0.7), angle=1.9),
    "ellipse": lamp(sc.AREA, 5, (0.3, 0.2, 0.4), size=(1.5, 0.7), shape=sc.ELLIPSE),
    "far ellipse": lamp(sc.AREA, 5, (0.3, 0.2, 4), size=(1.5, 0.7), shape=sc.ELLIPSE),
    "sun": lamp(sc.SUN, 3, towards=(-0.3, -0.2, -1), angle=0.2),
    "sphere": lamp(sc.POINT, 3, (0.5, 0.3, 1.5), radius=0.4),
    "inside": lamp(sc.POINT, 3, (0.5, 0.3, 1.5), radius=4.0),
    "soft": lamp(sc.POINT, 3, (0.5, 0.3, 1.5), radius=0.4, soft=1),
    "spot": lamp(sc.SPOT, 3, (0.5, 0.3, 1.5), towards=(-0.3, -0.1, -1), radius=0.4, angle=1.0, blend=0.5),
}


@kernel
def _compare(emitters, u, rows, surface, out):
    zero, one = np.float32(0), np.float32(1)
    x, y, z = np.float32(0.1), np.float32(-0.2), np.float32(0.05)
    for i in range(u.shape[0]):
        dx, dy, dz, t, r, _g, _b, _p, _q = sample_emitter(emitters, 0, x, y, z, zero, zero, one, u[i, 0], u[i, 1], rows, surface)
        met, share = np.float32(0), np.float32(1)
        if emitters.kind[0] < WORLD:
            met, share = lamp_along(emitters, 0, x, y, z, dx, dy, dz)
        out[i, 0], out[i, 1], out[i, 2] = r, t, met
        out[i, 3] = share * emitters.radiance[0, 0] / emitter_density(emitters, 0, x, y, z, zero, zero, one, dx, dy, dz)


def compared(scene, n=400):
    u = np.random.default_rng(3).random((n, 2), F)
    out = np.zeros((n, 4), F)
    _compare(scene.emitters, u, new_registers(scene.tables.materials), np.zeros(SURFACE, F), out)
    return out[out[:, 0] > 0]


@pytest.mark.parametrize("name", SIZED)
def test_lamps_are_met_where_they_are_aimed_at(name):
    scene = Set(SIZED[name])
    out = compared(scene)
    assert can_be_met(scene.emitters, 0)
    agree = np.isclose(out[:, 3], out[:, 0], rtol=2e-3)
    assert agree.mean() > 0.98  # a sample on the very edge may be missed
    assert len(out) > 200
    assert np.allclose(out[agree, 1], out[agree, 2], rtol=1e-3)


@pytest.mark.parametrize("height", [0.2, 3.0])
def test_density_of_triangles(height):
    quad = [(-1, -1, height), (1, -1, height), (1, 1, height), (-1, 1, height)]
    assert np.isclose(*compared(Set(quad=(quad,), surfaces=((0, 2.0),)))[:, [0, 3]].T, rtol=2e-3).all()


def gradient(height=16):
    """A sky with a bright patch."""
    image = np.fromfunction(lambda y, x, c: 0.5 + 0.3 * np.sin(x * 0.4 + c) + (y < height / 2), (height, 2 * height, 3))
    image[3:5, 20:24] = 12
    return image.astype(F)


def test_density_of_the_world():
    assert np.isclose(*compared(Set(world=0.7))[:, [0, 3]].T, rtol=2e-3).all()
    out = compared(Set(world=gradient()))
    # The radiance of the one pixel against the mean of all: compare densities by their ratio to it.
    ratio = out[:, 3] / out[:, 0]
    assert np.unique(np.round(ratio * 1e3)).size <= 16 * 32


# -- one light, two ways -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["area", "ellipse", "sun", "sphere", "inside", "soft", "spot", "mesh", "tree", "world"])
@pytest.mark.parametrize("roughness", [0.3, 0.6])
def test_a_highlight_is_the_same_by_shadow_rays_and_by_reflection(name, roughness):
    if name in SIZED:
        scene = Set(SIZED[name])
    elif name == "world":
        scene = Set(world=gradient())
    else:
        k = 6 if name == "tree" else 1
        quad = [
            [(a + 0.2, b, 1.5), (a + 0.2, b + 0.8, 1.5), (a + 0.7, b + 0.8, 1.6), (a + 0.7, b, 1.6)]
            for a, b in [(-0.6 * (i % 3), -0.9 * (i // 3)) for i in range(k)]
        ]
        scene = Set(quad=quad, surfaces=[(0.0, 1.0 + i) for i in range(k)])
    points = points_at(6000, roughness, cosine=0.95)
    by_light, light_error = radiance(scene, points, samples=16, reflections=0)[:2]
    by_lobe, lobe_error = mean_and_error(reflect(scene.tables, points, 0, 8, 4, 5)[0][:, 0])
    both, error, _ = radiance(scene, points, seed=7)
    assert by_light > 0 and max(light_error, lobe_error) < 0.04 * by_light
    assert abs(by_lobe - by_light) < 4 * math.hypot(light_error, lobe_error)
    assert abs(both - by_light) < 4 * math.hypot(light_error, error)
    assert error < 2 * min(light_error, lobe_error) and error < 0.002 * both


def test_sizeless_lamps_light_lobes():
    """A point lamp's highlight in closed form: intensity over squared distance times the lobe."""
    scene = Set(lamp(sc.POINT, 3, (0.5, 0.3, 1.5)))
    d = np.array([0.5, 0.3, 1.5])
    r = np.linalg.norm(d)
    value = lobe_value(lobe_of(0.4, 0.7, 0.5, 1), *(F(c) for c in d / r))[0]
    assert radiance(scene, points_at(64, 0.4))[0] == pytest.approx(3 * value / r**2, rel=1e-3)


def test_what_glossy_rays_do_not_see_gives_no_highlight():
    row = lamp(sc.AREA, 5, (0.3, 0.2, 1.5), size=(1.5, 0.7), visibility=sc.ALL_RAYS & ~sc.GLOSSY)
    scene = Set(row)
    points = points_at(64, 0.4)
    light, _ = direct_light(scene.tables, points, 16, 1, reflections=8)
    assert light.irradiance.all() and not light.irradiance_by_glass.any()
    assert radiance(scene, points)[0] == 0


# -- furnaces ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("cosine", [0.3, 0.9])
def test_white_furnace(roughness, cosine):
    """Under a uniform world a lobe shows its albedo."""
    scene = Set(world=2.0)
    shown = radiance(scene, points_at(3000, roughness, cosine, f0=0.1))[0]
    n = 2400 if roughness < 0.2 else 800
    expected = 0.1 + 0.9 * (1 - cosine) ** 5 if roughness < 0.1 else _integral(lobe_of(roughness, cosine, 0.1, 1), n)
    assert shown == pytest.approx(2 * expected, rel=0.01)


def test_indirect_light_in_a_sphere():
    """Within a diffuse sphere that shines, radiance is emission (1 + rho + ... ) with one term a surface."""
    rho, emission = 0.6, 0.5
    scene = Set(mesh=icosphere(2), surfaces=((rho, emission),))
    direct, _, indirect = radiance(scene, points_at(2000, 0.4, f0=1.0))
    series = sum(rho**k for k in range(1, 6))  # 4 bounces and the surface that the lobe shows
    assert direct == pytest.approx(emission, rel=0.01)
    assert indirect == pytest.approx(emission * series, rel=0.02)


# -- mirrors -----------------------------------------------------------------------------------------------


def mirror_room(mirrors=()):
    """A mirror image of the view (.3, 0, -1) meets a small quad at x about -.6."""
    quad = [(-0.9, -0.5, 2), (-0.3, -0.5, 2), (-0.3, 0.5, 2), (-0.9, 0.5, 2)]
    lamp_below = [(-5, -5, -2), (5, -5, -2), (5, 5, -2), (-5, 5, -2)]
    return Set(quad=(quad, lamp_below), surfaces=((0.0, 0.0 if mirrors else 4.0), (0.0, 7.0 if mirrors else 0.0)), mirrors=mirrors)


def seen_in_mirror(scene, slope):
    points = points_at(16, 0.0, f0=1.0)
    wo = np.array([slope, 0, 1]) / math.hypot(slope, 1)
    points.wo[:] = wo
    return radiance(scene, points)


def test_a_mirror_shows_the_lamp_where_it_is():
    scene = mirror_room()
    assert seen_in_mirror(scene, 0.3)[0] == pytest.approx(4, rel=1e-4)
    assert seen_in_mirror(scene, 0.46)[0] == 0
    assert seen_in_mirror(scene, 0.14)[0] == 0
    assert seen_in_mirror(scene, 0.44)[0] == pytest.approx(4, rel=1e-4)


def test_light_from_mirror_to_mirror_is_indirect():
    direct, _, indirect = seen_in_mirror(mirror_room(mirrors=(0,)), 0.3)
    assert direct == 0
    assert indirect == pytest.approx(7, rel=1e-4)


def test_the_denoiser_s_guide_in_a_mirror_is_without_noise():
    """What is half a mirror itself is followed one way or the other at random; its albedo is told as it is."""
    scene = mirror_room(mirrors=(0,))
    constant = scene.tables.materials.constant
    constant[0, GLOSSY_F0 : GLOSSY_F90 + 3] = 0.3
    constant[0, DIFFUSE : DIFFUSE + 3] = 0.6
    constant[1, DIFFUSE : DIFFUSE + 3] = 0.25
    points = points_at(64, 0.0, f0=1.0)
    points.wo[:] = np.array([0.3, 0, 1]) / math.hypot(0.3, 1)
    guide = reflect(scene.tables, points, 16, 8, 4, 1).albedo
    np.testing.assert_allclose(guide, guide[0, 0], rtol=1e-4)
    assert 0.3 < guide[0, 0] <= 0.6
    constant[0, GLOSSY_F0 : GLOSSY_F90 + 3] = 1.0  # a mirror through and through shows what lies beyond
    constant[0, DIFFUSE : DIFFUSE + 3] = 0.0
    np.testing.assert_allclose(reflect(scene.tables, points, 16, 8, 4, 1).albedo, 0.25, rtol=1e-3)


def test_a_wide_lobe_shows_the_lamp_in_a_mirror():
    """To the cache of light a mirror is as dim as a wall: a polished floor has the lamp's highlight by way of it all the same."""
    floor = [(-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0)]
    mirror = [(2, -2, 0.2), (2, 2, 0.2), (2, 2, 3), (2, -2, 3)]
    stuff = materials((0.0, 0.0), (0.0, 0.0))
    stuff.tables.constant[:, GLOSSY_F0 : GLOSSY_F90 + 3] = np.array([[0.5], [0.95]])
    stuff.tables.constant[0, ROUGHNESS] = 0.6
    stuff.tables.flags[:] |= sc.GLOSSY_LOBE
    lamps = lamps_of(lamp(sc.POINT, 5.0, position=(1, 0, 1.8), radius=0.2))
    eye = camera(position=(0, 0, 2), width=32, height=24)
    whole = sc.Scene(geometry(*quads(floor, mirror), np.repeat([0, 1], 2)), stuff, lamps, sc.World(np.zeros((1, 1, 3), F)), eye)
    found = {}
    for method in ("importance-sampling", "instant-radiosity"):
        request = RenderSettings(method=method, denoise=False, reflections=16, direct_samples=16, layers=("GlossyIndirect",))
        found[method] = np.mean([render(whole, replace(request, seed=seed)).layers["GlossyIndirect"].mean() for seed in range(4)])
    assert found["importance-sampling"] == pytest.approx(found["instant-radiosity"], rel=0.06)
    assert found["instant-radiosity"] > 1e-3


def test_the_sun_in_a_mirror_is_no_spark_in_a_rough_floor():
    """One ray in hundreds met it where it mirrors the sun, and found thousands of times the light of the others: that point alone lit a third of a picture."""
    mirror = [(2, -2, 0.2), (2, 2, 0.2), (2, 2, 3), (2, -2, 3)]
    points = points_at(4096, 0.45, f0=0.5, f90=0.5, position=(0.4, 0.1, 0))
    points.wo[:] = np.array([-1, 0.1, 0.7]) / np.linalg.norm([-1, 0.1, 0.7])
    room = Set(lamp(sc.SUN, 10.0, towards=(1, 0.2, -0.9), angle=0.02), quad=(mirror,), surfaces=((0.0, 0.0),), mirrors=(0,))
    room.tables.materials.constant[0, ROUGHNESS] = 0.1
    found = reflect(room.tables, points, 16, 4, 4, 1).indirect[:, 0]
    mean, error = mean_and_error(found)
    behind = Set(lamp(sc.SUN, 10.0, towards=(-1, 0.2, -0.9), angle=0.02))  # the mirror's image of it
    expected = direct_light(behind.tables, points, 16, 1, 0, reflections=4)[0].glossy[:, 0].mean()
    assert mean == pytest.approx(float(expected), abs=0.15 * float(expected) + 3 * error)
    assert found.max() < 100 * mean and error < 0.1 * mean


# -- work --------------------------------------------------------------------------------------------------


def test_same_bits_for_any_number_of_threads():
    scene = Set(SIZED["area"], quad=([(-1, -1, 3), (-1, 1, 3), (1, 1, 3), (1, -1, 3)],), world=0.3)
    points = points_at(1000, 0.4)
    one, many = (reflect(scene.tables, points, 16, 8, 4, 5, threads) for threads in (1, 3))
    assert all(np.array_equal(a, b) for a, b in zip(one[:2], many[:2]))
    assert one[1].any()


def test_faint_lobes_cost_nothing():
    scene = Set(world=1.0)
    dull = points_at(10, 0.5, f0=1e-6, f90=5e-5, albedo=0.5)
    assert not has_lobes(dull)
    assert reflect(scene.tables, dull, 16, 8, 4, 1)[2] == 0
    assert has_lobes(points_at(10, 0.5))
    few = reflect(scene.tables, points_at(10, 0.5, f0=0.04, albedo=0.8), 16, 8, 4, 1)[2]
    assert 10 <= few < 80


def test_lobes_leave_the_irradiance_as_it_is():
    scene = Set(SIZED["area"], SIZED["sun"])
    lit, rays = direct_light(scene.tables, points_at(100, 0.5), 16, 3, reflections=8)
    dull, same = direct_light(scene.tables, points_at(100, 0.5, f0=0, f90=0), 16, 3, reflections=8)
    assert np.array_equal(lit.irradiance, dull.irradiance)
    assert rays == same
    assert not dull.glossy.any()


def test_material_columns_are_those_of_the_layout():
    """The mirror of these tests is smooth because its roughness is not set."""
    assert mirror_room(mirrors=(0,)).tables.materials.constant[0, ROUGHNESS] == 0


@pytest.mark.parametrize("others", [{}, {"world": 0.7}])
def test_light_with_sharp_shadows_is_told_apart(others):
    sun = lamp(sc.SUN, 2.0, angle=math.radians(0.5), towards=(0, 0.6, -0.8))
    broad = lamp(sc.AREA, 3.0, size=(2, 2))
    scene, alone = Set(sun, broad, **others), Set(sun)
    points = points_at(500, 0.5, albedo=0.5)
    light, rays = direct_light(scene.tables, points, 16, 1, apart=True)
    whole, same = direct_light(scene.tables, points, 16, 1)
    np.testing.assert_allclose(light.sharp, direct_light(alone.tables, points, 16, 1)[0].irradiance, rtol=2e-3)
    assert rays == same and light.sharp.mean() == pytest.approx(1.6, rel=1e-3)
    np.testing.assert_allclose(light.unshadowed, light.sharp, rtol=2e-3)  # nothing is in the way
    assert light.sharp_rays.min() >= 1 and light.sharp_rays.max() < 16
    for found, expected in zip(light[:4], whole[:4], strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)


def test_only_small_lamps_that_every_point_asks_have_sharp_shadows():
    def sharp(*lamps, samples=16, **others):
        found = sharp_emitters(Set(*lamps, **others).emitters, samples)
        return None if found is None else found.tolist()

    small, large = lamp(sc.POINT, 1.0, radius=0.001), lamp(sc.POINT, 1.0, radius=5.0, position=(0, 0, 9))
    assert sharp(small, large) == [True, False]
    assert sharp(small, world=1.0) == [True, False]
    assert sharp(small) == [True]
    assert sharp(large, lamp(sc.AREA, 1.0), lamp(sc.SUN, 1.0, angle=math.radians(20))) is None
    assert sharp(*[small] * 3, samples=2) is None
    assert sharp(*[small] * 300) is None


@pytest.mark.parametrize("cosine", [0.2, 0.9])
def test_lobes_know_what_their_albedos_leave_out(cosine):
    """The albedos hold a mean over the views, of which `layout.GLOSS` tells the reflectance and whether light is lost."""
    roughness, color = 0.9, 0.4
    e, mean = ggx.single_scattering(F(cosine), F(roughness)), ggx.single_scattering_mean(F(roughness))
    again = color * mean / (1 - color * (1 - mean))
    for top, expected, held in ((color, color * (e + again * (1 - e)), mean + again * (1 - mean)), (-color, color * e, mean)):
        row = lobe_of(roughness, cosine, 1, 1)
        g = F(0.5 * color * held)  # of half a pixel
        view = (F(c) for c in view_at(cosine))
        set_lobe(row, F(0), F(0), F(1), F(0), F(0), F(1), *view, F(roughness), g, g, g, g, g, g, F(top), F(0), F(0), F(0))
        assert row[ALBEDO] == pytest.approx(0.5 * expected, rel=2e-3)


def test_a_black_tint_takes_all_light_at_82_degrees():
    row, cosine = np.zeros(LOBE, F), 1 / 7
    one, f0 = F(1), F(0.6)
    set_lobe(
        row, F(0), F(0), one, F(0), F(0), one, *(F(c) for c in view_at(cosine)), F(0), f0, f0, f0, one, one, one, one, one, F(0.5), F(0)
    )
    *_, r, g, b, _ = sample_lobe(row, F(0.3), F(0.3))
    schlick = 0.6 + 0.4 * (6 / 7) ** 5
    assert (r, g, b) == pytest.approx((0, 0.5 * schlick, schlick), abs=2e-3)


@pytest.mark.parametrize(("roughness", "cosine"), [(0.3, 0.03), (0.3, 0.2), (0.1, 0.1), (0.6, 0.1), (0.3, 0.9)])
def test_paths_find_all_of_an_even_sky_in_lobes_along_the_surface(roughness, cosine):
    """What a polished wall throws on the floor at its foot: up to a half of it was lost to the bound of what shadow rays find."""
    points = points_at(20000, roughness, cosine, f0=0.04)
    light = tail_light(Set(world=1.0).tables, points, 1, 3)[:, 0]
    mean, error = mean_and_error(light)
    assert mean == pytest.approx(math.pi * float(lobe_of(roughness, cosine, 0.04, 1)[ALBEDO]), rel=0.1, abs=4 * error)
    assert light.max() < 40 * mean


@pytest.mark.parametrize("cosine", [0.15, 0.9])
def test_cloth_in_a_reflection_shines_as_its_view_sees_it(cosine):
    """A path from a hit sends what direct light of a shading point there would be: sheen shone evenly, from above as bright as along the pile."""
    scene, points = Set(lamp(sc.POINT, 3, (0.5, 0.3, 1.5))), points_at(64, 0.5, cosine, f0=0.0, f90=0.0, albedo=0.6)
    points.sheen[:] = (0.9, 0.5, 0.0, 0.3)
    sent = tail_light(scene.tables, points, 1, 3)[0]
    light, _ = direct_light(scene.tables, points, 16, 1)
    assert sent == pytest.approx(light.irradiance[0] * points.albedo[0], rel=1e-3)
    assert abs(sent[0] / sent[2] - 1) > 0.2
