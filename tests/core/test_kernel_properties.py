"""What must hold of the kernels whatever goes in: reciprocity, conservation, invariance, monotonicity, and float64 within units in the last place."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumigate.core import scene as sc
from lumigate.core.jit import kernel
from lumigate.core.lamps import build_emitters, direct_irradiance
from lumigate.core.lamps.solid_angle import rectangle_angle, sample_rectangle, triangle_angle
from lumigate.core.methods.instant_radiosity import InstantRadiosity, geometry_terms
from lumigate.core.metrics import bias, net_relmse
from lumigate.core.particles import Vpls, trace_by_power, trace_particles
from lumigate.core.rays import RayScene
from lumigate.core.sampling.maps import cosine_hemisphere
from lumigate.core.surfaces.microfacet import reflection, sample_reflection
from lumigate.core.transport import transport

from .grey_points import points_at

ULP = 2.0**-23
SEEDS = st.integers(0, 2**32 - 1)
EXAMPLES = settings(max_examples=40, deadline=None, derandomize=True)


def unit(rng, n):
    """(n, 3) float32 unit vectors."""
    v = rng.normal(size=(n, 3))
    return (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


def rotation(rng):
    """(3, 3) a random rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[::-1]


def vpls_at(position, normal, flux):
    """VPLs without error radius; flux: (M,)."""
    vpls = Vpls.allocate(len(position))
    for field in vpls:
        field[...] = 0
    vpls.position[:], vpls.normal[:], vpls.surface_normal[:] = position, normal, normal
    vpls.flux[:] = np.asarray(flux)[:, None]
    return vpls


@pytest.fixture(scope="module")
def empty(build):
    """Tables of a scene with one triangle that is out of everyone's way."""
    geometry = build.geometry([(900, 900, 900), (901, 900, 900), (900, 901, 900)], [(0, 1, 2)])
    with RayScene(geometry.vertices, geometry.triangles) as rays:
        scene = build.scene(geometry, build.materials((0.5, 0.0)))
        yield transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))


def lit_by(tables, vpls, points, visibility="none"):
    """Irradiance (N,) float64 of the VPLs on the points, without a clamp."""
    solver = InstantRadiosity(visibility=visibility, compensation=0, threads=1)
    solver.prepare(tables, vpls, points)
    solver.g_max = np.float32(np.inf)
    return solver.irradiance(points)[:, 0].astype(np.float64)


def exact_terms(x, nx, y, ny):
    """The geometry terms (N, M) in float64, and what its factors would be without cancellation."""
    d = y[None].astype(np.float64) - x[:, None].astype(np.float64)
    here, there = (d * nx[:, None].astype(np.float64)).sum(-1), -(d * ny[None].astype(np.float64)).sum(-1)
    r4 = (d * d).sum(-1) ** 2
    sums = (np.abs(d * nx[:, None]).sum(-1), np.abs(d * ny[None]).sum(-1))
    with np.errstate(divide="ignore", invalid="ignore"):
        worst = (sums[0] * np.maximum(there, 0) + sums[1] * np.maximum(here, 0) + ULP * sums[0] * sums[1]) / r4
        return np.maximum(here, 0) * np.maximum(there, 0) / r4, worst


@EXAMPLES
@given(SEEDS, st.floats(-18, 18))
def test_geometry_terms_are_those_of_float64_to_some_ulps(seed, exponent):
    rng, scale = np.random.default_rng(seed), np.float32(2.0**exponent)
    x, nx, y, ny = (
        rng.uniform(-1, 1, (64, 3)).astype(np.float32) * scale,
        unit(rng, 64),
        rng.uniform(-1, 1, 3).astype(np.float32) * scale,
        unit(rng, 1),
    )
    g = np.empty(64, np.float32)
    geometry_terms(x, nx, nx, 0, 64, *y, *ny[0], g)
    true, worst = exact_terms(x, nx, y[None], ny)
    # Coordinates are exact; of each difference half an ulp is lost, of the sums and the quotient a few.
    assert np.all(np.abs(g - true[:, 0]) <= 8 * ULP * (true[:, 0] + worst[:, 0]))


@EXAMPLES
@given(SEEDS)
def test_geometry_terms_are_the_same_from_either_end(seed):
    rng = np.random.default_rng(seed)
    x, nx, y, ny = (
        rng.uniform(-1, 1, (32, 3)).astype(np.float32),
        unit(rng, 32),
        rng.uniform(-1, 1, (32, 3)).astype(np.float32),
        unit(rng, 32),
    )
    one = np.empty(1, np.float32)
    there, back = [], []
    for k in range(32):
        geometry_terms(x[k : k + 1], nx[k : k + 1], nx[k : k + 1], 0, 1, *y[k], *ny[k], one)
        there.append(one[0])
        geometry_terms(y[k : k + 1], ny[k : k + 1], ny[k : k + 1], 0, 1, *x[k], *nx[k], one)
        back.append(one[0])
    np.testing.assert_allclose(there, back, rtol=4 * ULP)


@EXAMPLES
@given(SEEDS)
def test_light_does_not_depend_on_rotation_or_on_the_order_of_lights(empty, seed):
    rng = np.random.default_rng(seed)
    x, nx, y, ny = rng.uniform(-1, 1, (16, 3)), unit(rng, 16), rng.uniform(-1, 1, (300, 3)), unit(rng, 300)
    flux = 10.0 ** rng.uniform(-3, 3, 300)
    true, worst = exact_terms(x, nx, y, ny)
    bound = (true + worst) @ flux / np.pi
    whole = lit_by(empty, vpls_at(y, ny, flux), points_at(x, nx))
    q, order = rotation(rng), rng.permutation(300)
    turned = lit_by(empty, vpls_at(y @ q.T, ny @ q.T, flux), points_at(x @ q.T, nx @ q.T))
    assert np.all(np.abs(turned - whole) <= 64 * ULP * bound)
    other = lit_by(empty, vpls_at(y[order], ny[order], flux[order]), points_at(x, nx))
    assert np.all(np.abs(other - whole) <= 64 * ULP * bound)
    # Monotone and linear: brighter lights, and more of them, never darken.
    assert np.all(lit_by(empty, vpls_at(y[:200], ny[:200], flux[:200]), points_at(x, nx)) <= whole * (1 + 64 * ULP))
    np.testing.assert_array_equal(lit_by(empty, vpls_at(y, ny, 2 * flux), points_at(x, nx)), 2 * whole)


def test_a_million_lights_are_added_up_to_a_hundred_ulps(empty):
    # Flux over eight decades, the large ones first: a plain float32 sum loses a thousand times as much.
    rng = np.random.default_rng(1)
    n = 1_000_000
    y, ny = rng.uniform(-1, 1, (n, 3)), np.tile(np.float32([0, 0, -1]), (n, 1))
    y[:, 2] = 1.5
    flux = np.sort(10.0 ** rng.uniform(-6, 2, n).astype(np.float32))[::-1]
    x, nx = rng.uniform(-1, 1, (4, 3)) * (1, 1, 0), np.tile(np.float32([0, 0, 1]), (4, 1))
    points, vpls = points_at(x, nx), vpls_at(y, ny, flux)
    true = np.zeros(4)
    for k in range(0, n, 100_000):
        part = slice(k, k + 100_000)
        g, _ = exact_terms(points.position, nx, vpls.position[part], ny[part])
        true += g @ flux[part].astype(np.float64) / np.pi
    got = lit_by(empty, vpls, points)
    assert np.all(np.abs(got - true) <= 100 * ULP * true)


@pytest.mark.parametrize("albedo", [0.2, 0.8, 1.0])
def test_particles_carry_the_power_of_the_lamp_from_bounce_to_bounce(build, albedo):
    lamps = build.lamps(build.lamp(sc.POINT, 3.0, (0.3, 0.1, -0.2)))
    scene = build.scene(build.geometry(*build.icosphere(2)), build.materials((albedo, 0.0)), lamps=lamps)
    with RayScene(scene.geometry.vertices, scene.geometry.triangles) as rays:
        tables = transport(scene.geometry, scene.materials.tables, rays.tables, build_emitters(scene))
        vpls, _ = trace_particles(tables, 4096, 4, seed=1, threads=1)
    carried = [vpls.flux[vpls.bounce == k].sum(dtype=np.float64) / 3 for k in range(1, 5)]
    assert carried[0] == pytest.approx(albedo * 4 * np.pi * 3.0, rel=1e-4)  # 3 W/sr in all directions
    # Survivors are a whole number, their weights its inverse share: nothing is lost or won.
    np.testing.assert_allclose(carried[1:], np.multiply(carried[:-1], albedo), rtol=1e-4)


def test_particles_by_power_carry_as_much_in_lights_more_alike(build):
    # A lamp in a white sphere, and three in a dark one, where most particles land: by number few go on.
    x, y = np.eye(3)[:2]
    room, yard = build.icosphere(2), build.icosphere(2)
    vertices = np.concatenate([room[0], yard[0] * 5 + 20 * x])
    triangles = np.concatenate([room[1], yard[1] + len(room[0])])
    material = np.repeat([0, 1], [len(room[1]), len(yard[1])])
    places = [0.1 * y, *(20 * x + k * y for k in (-1, 0, 1))]
    lamps = build.lamps(*(build.lamp(sc.POINT, 3.0, tuple(at)) for at in places))
    scene = build.scene(build.geometry(vertices, triangles, material=material), build.materials((0.8, 0.0), (0.02, 0.0)), lamps=lamps)
    carried, spread, alike = {}, {}, {}
    with RayScene(scene.geometry.vertices, scene.geometry.triangles) as rays:
        tables = transport(scene.geometry, scene.materials.tables, rays.tables, build_emitters(scene))
        for tracer in (trace_particles, trace_by_power):
            runs = [tracer(tables, 2048, 4, seed=seed, threads=1)[0] for seed in range(24)]
            light = np.array([[v.flux[v.bounce == k].sum(dtype=np.float64) / 3 for k in range(1, 5)] for v in runs])
            later = [v.flux[v.bounce > 1, 0].astype(np.float64) for v in runs]
            alike[tracer] = np.mean([flux.sum() ** 2 / (flux**2).sum() for flux in later])
            carried[tracer], spread[tracer] = light.mean(axis=0), light.std(axis=0) / len(runs) ** 0.5
    power = 4 * np.pi * 3.0
    expected = [power * (0.8**k + 3 * 0.02**k) for k in range(1, 5)]
    for tracer in (trace_particles, trace_by_power):
        assert (np.abs(carried[tracer] - expected) < 4 * spread[tracer] + 1e-3 * np.array(expected)).all()
    assert alike[trace_by_power] > 2 * alike[trace_particles]  # so many lights of one power would be as good


@EXAMPLES
@given(SEEDS)
def test_blockers_only_take_light_away(build, seed):
    rng = np.random.default_rng(seed)
    soup = rng.uniform(-0.5, 0.5, (6, 3, 3))
    x, y = rng.uniform((-1, -1, -3), (1, 1, -1), (16, 3)), rng.uniform((-1, -1, 1), (1, 1, 3), (8, 3))
    nx, ny = np.tile(np.float32([0, 0, 1]), (16, 1)), np.tile(np.float32([0, 0, -1]), (8, 1))
    light = []
    for count in (1, 3, 6):
        geometry = build.geometry(soup[:count].reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
        scene = build.scene(geometry, build.materials((0.5, 0.0)), lamps=build.lamps(*(build.lamp(sc.POINT, 1.0, place) for place in y)))
        turned = rng.permutation(count)
        with RayScene(geometry.vertices, geometry.triangles[turned]) as rays:
            tables = transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))
            points = points_at(x, nx)
            direct, _ = direct_irradiance(tables, points, 64, 1, 1)
            light.append((lit_by(tables, vpls_at(y, ny, np.ones(8)), points, "rays"), direct[:, 0].astype(np.float64)))
    for few, many in itertools.pairwise(light):
        assert all(np.all(more <= less * (1 + 8 * ULP)) for less, more in zip(few, many))


@kernel
def _lobe(o, i, alpha, u):
    """Value times the cosine at the viewer, both ways round, and the weight of one sample."""
    there = reflection(o[0], o[1], o[2], i[0], i[1], i[2], alpha) * o[2]
    back = reflection(i[0], i[1], i[2], o[0], o[1], o[2], alpha) * i[2]
    return there, back, sample_reflection(o[0], o[1], o[2], alpha, u[0], u[1])[3]


@EXAMPLES
@given(SEEDS, st.floats(0.02, 1.0))
def test_the_lobe_is_reciprocal_and_its_samples_win_no_energy(seed, roughness):
    rng = np.random.default_rng(seed)
    for o, i in zip(unit(rng, 20), unit(rng, 20)):
        o[2], i[2] = abs(o[2]) + 0.01, abs(i[2]) + 0.01
        there, back, weight = _lobe(o, i, np.float32(roughness**2), rng.random(2, np.float32))
        assert there == pytest.approx(back, rel=1e-5)
        assert 0 <= weight <= 1 + ULP


@kernel
def _directions(u, out):
    for k in range(len(u)):
        out[k, 0], out[k, 1], out[k, 2] = cosine_hemisphere(u[k, 0], u[k, 1])


@EXAMPLES
@given(SEEDS)
def test_directions_are_those_of_float64(seed):
    u = np.random.default_rng(seed).random((100, 2), np.float32)
    got = np.empty((100, 3), np.float32)
    _directions(u, got)
    a, b = 2 * u.astype(np.float64).T - 1
    far = np.where(np.abs(a) > np.abs(b), a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        phi = np.where(np.abs(a) > np.abs(b), np.pi / 4 * b / a, np.pi / 2 - np.pi / 4 * a / b)
    true = np.column_stack([far * np.cos(phi), far * np.sin(phi), np.sqrt(np.maximum(1 - far * far, 0))])
    np.testing.assert_allclose(got[:, :2], true[:, :2], atol=8 * ULP)
    np.testing.assert_allclose(got[:, 2] ** 2, true[:, 2] ** 2, atol=8 * ULP)
    np.testing.assert_allclose(np.linalg.norm(got.astype(np.float64), axis=1), 1, atol=4 * ULP)


@EXAMPLES
@given(SEEDS, st.floats(1e-4, 100))
def test_solid_angles_add_up(seed, height):
    rng = np.random.default_rng(seed)
    (x0, x1, x2), (y0, y1) = np.sort(rng.uniform(-3, 3, 3)), np.sort(rng.uniform(-3, 3, 2))
    whole = rectangle_angle(x0, x2, y0, y1, height)
    assert whole == pytest.approx(rectangle_angle(x0, x1, y0, y1, height) + rectangle_angle(x1, x2, y0, y1, height), rel=1e-9, abs=1e-12)
    corners = [np.array([x, y, height]) / np.linalg.norm([x, y, height]) for x, y in ((x0, y0), (x2, y0), (x2, y1), (x0, y1))]
    halves = triangle_angle(*corners[0], *corners[1], *corners[2]) + triangle_angle(*corners[0], *corners[2], *corners[3])
    assert whole == pytest.approx(halves, rel=1e-6, abs=1e-9)
    assert 0 <= whole <= 2 * np.pi


@pytest.mark.parametrize(
    ("x", "y", "height", "size"), [(5, 3, 0.02, 0.5), (10, 10, 10, 0.2), (100, 0, 5, 1.0), (0, 0, 30, 0.1), (0.1, 0.2, 1e-3, 1.0)]
)
def test_rectangles_seen_at_a_slant_or_from_afar_are_as_exact_by_short_numbers(x, y, height, size):
    # A hundredth of the angle was lost where it is the difference of far larger ones.
    edges = np.float32([x - size / 2, x + size / 2, y - size / 2, y + size / 2, height])
    exact = rectangle_angle(*edges.astype(float))
    assert rectangle_angle(*edges) == pytest.approx(exact, rel=1e-6)
    for u1, u2 in ((0.1, 0.2), (0.5, 0.7), (0.93, 0.4)):
        u1, u2 = np.float32(u1), np.float32(u2)
        qx, qy, angle = sample_rectangle(*edges, u1, u2)
        assert angle == pytest.approx(exact, rel=1e-5)
        assert (qx, qy) == pytest.approx(sample_rectangle(*edges.astype(float), float(u1), float(u2))[:2], abs=1e-5 * size)


def test_metrics_are_unbiased():
    # Noise of a known variance in picture and reference: what is measured is what was put in, without the reference's own.
    rng = np.random.default_rng(5)
    true = rng.uniform(0.5, 1.5, (64, 64, 3))
    biases, errors = [], []
    for _ in range(40):
        halves = [true + rng.normal(0, 0.05, true.shape) for _ in range(2)]
        test = 1.02 * true + rng.normal(0, 0.1, true.shape)
        biases.append(bias(test, (halves[0] + halves[1]) / 2))
        errors.append(net_relmse(test, *halves, denoised_reference=true))
    expected = ((0.02 * true) ** 2 + 0.1**2) / (true**2 + 0.01 * true.mean() ** 2)
    assert np.mean(biases) == pytest.approx(0.02, abs=4 * np.std(biases) / 40**0.5)
    assert np.mean(errors) == pytest.approx(expected.mean(), abs=4 * np.std(errors) / 40**0.5)
