"""Fuzzy clustering against a slow oracle, and against instant radiosity where clusters are single points."""

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.clustering import kmeans
from lumigate.core.lamps import build_emitters, world_tables
from lumigate.core.methods import fuzzy_clustering
from lumigate.core.methods.cluster_shading import quantised
from lumigate.core.methods.fuzzy_clustering import FuzzyClustering
from lumigate.core.methods.instant_radiosity import InstantRadiosity
from lumigate.core.particles import Vpls, trace_particles
from lumigate.core.pipeline import render
from lumigate.core.rays import RayScene
from lumigate.core.settings import RenderSettings
from lumigate.core.stages import Run, prepared
from lumigate.core.surfaces.layout import TRANSPARENCY
from lumigate.core.transport import transport
from lumigate.core.view.points import ShadingPoints
from lumigate.core.view.primary import view

FLOOR = [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)]
SHELF = [(-0.5, -0.7, 1), (0.6, -0.7, 1), (0.6, 0.5, 1), (-0.5, 0.5, 1)]  # hides part of the ceiling from the floor
CEILING = [(-2, 2, 2), (2, 2, 2), (2, -2, 2), (-2, -2, 2)]


@pytest.fixture(scope="module")
def room(build):
    """Transport tables of a floor, a shelf and a ceiling."""
    geometry = build.geometry(*build.quads(FLOOR, SHELF, CEILING))
    scene = build.scene(geometry, build.materials((0.5, 0.0)))
    with RayScene(geometry.vertices, geometry.triangles) as rays:
        yield transport(scene.geometry, scene.materials.tables, rays.tables, build_emitters(scene))


def floor_points(n, seed=0):
    """Shading points on the floor, their normals as upright as its own."""
    points = ShadingPoints.allocate(n)
    for field in points:
        field[...] = 0
    points.position[:, :2] = np.random.default_rng(seed).uniform(-1.9, 1.9, (n, 2))
    points.ng[:, 2] = points.ns[:, 2] = points.wo[:, 2] = 1
    points.error[:] = 1e-6
    points.pixel[:] = np.arange(n)
    points.albedo[:] = 0.5
    return points


def ceiling_vpls(m, seed=1):
    """VPLs on the ceiling, of unlike flux."""
    rng = np.random.default_rng(seed)
    vpls = Vpls.allocate(m)
    vpls.position[:] = np.column_stack([rng.uniform(-1.9, 1.9, (m, 2)), np.full(m, 2.0)])
    vpls.normal[:] = vpls.surface_normal[:] = (0, 0, -1)
    vpls.flux[:] = rng.uniform(0.2, 2, (m, 3))
    vpls.error[:] = 1e-6
    vpls.emitter[:], vpls.bounce[:] = 0, 1
    return vpls


def sees(p, q):
    """Whether the segment from floor to ceiling misses the shelf, half-way between them."""
    x, y = (p[..., 0] + q[..., 0]) / 2, (p[..., 1] + q[..., 1]) / 2
    return ~((x > -0.5) & (x < 0.6) & (y > -0.7) & (y < 0.5))


def oracle(points, lights, representatives, fuzzy, g_max):
    """Irradiance by Eqs. 6 and 9 in float64: all pairs, exact visibility of the representatives."""
    p, q = points.position.astype(float)[:, None], lights.position.astype(float)[None]
    d = q - p
    r2 = (d * d).sum(-1)
    g = np.minimum(d[..., 2] * d[..., 2] / r2**2, g_max)
    visible = sees(representatives.position.astype(float)[:, None], q)
    blended = (fuzzy.weights[..., None] * visible[fuzzy.indices]).sum(axis=1)
    return (g * blended) @ lights.flux.astype(float) / np.pi


@pytest.mark.parametrize("fuzziness, weighting", [(1, "plain"), (2, "distance"), (6, "smooth"), (10, "plain")])
def test_equals_the_oracle(room, fuzziness, weighting):
    points, vpls = floor_points(3000), ceiling_vpls(300)
    solver = FuzzyClustering(
        vpl_clusters=40, point_clusters=100, fuzziness=fuzziness, weighting=weighting, shade_with="clusters", compensation=0
    )
    solver.prepare(room, vpls, points)
    got = solver.irradiance(points)
    expected = oracle(points, solver.lights.vpls, solver.view.representatives, solver.view.fuzzy, float(solver.g_max))
    # Weights in 255ths: half of one, of ever other clusters, at most.
    assert np.abs(got - expected).max() < 0.01 * expected.mean()
    assert np.abs(got - expected).mean() < 0.001 * expected.mean()
    assert 0.5 < (solver.view.seen[:, 0] / solver.view.seen[:, 1]).mean() < 0.95  # the shelf matters
    assert solver.rays == len(solver.view.at) * len(solver.lights.power)
    assert solver.pairs == len(points.pixel) * len(solver.lights.power)


@pytest.mark.parametrize("shade_with", ["vpls", "clusters"])
def test_single_points_and_vpls_are_instant_radiosity(room, shade_with):
    points, vpls = floor_points(700), ceiling_vpls(90)
    brute = InstantRadiosity(compensation=0)
    brute.prepare(room, vpls, points)
    solver = FuzzyClustering(vpl_clusters=10_000, point_clusters=10_000, fuzziness=1, shade_with=shade_with, compensation=0)
    solver.prepare(room, vpls, points)
    assert solver.g_max == pytest.approx(brute.g_max, rel=0.2)  # from other pairs where the order of the VPLs is another
    brute.g_max = solver.g_max
    assert np.allclose(solver.irradiance(points), brute.irradiance(points), rtol=2e-4)
    assert len(solver.view.at) == 700 and len(solver.lights.first) == 91


def test_every_vpl_shades_with_the_visibility_of_its_cluster(room):
    points, vpls = floor_points(2000), ceiling_vpls(2000)
    brute = InstantRadiosity(compensation=0)
    brute.prepare(room, vpls, points)
    exact = brute.irradiance(points)
    errors = {}
    for shade_with in ("vpls", "clusters"):
        solver = FuzzyClustering(vpl_clusters=60, point_clusters=300, shade_with=shade_with, compensation=0)
        solver.prepare(room, vpls, points)
        got = solver.irradiance(points)
        assert got.mean() == pytest.approx(exact.mean(), rel=0.02)
        errors[shade_with] = np.sqrt(np.mean((got - exact) ** 2)) / exact.mean()
    assert errors["vpls"] < 0.06 and errors["clusters"] < 0.12


def test_neighbours_share_the_rays_to_faint_lights(room):
    points, vpls = floor_points(3000), ceiling_vpls(300)
    vpls.flux[40:] *= 0.02  # faint beside the others
    results = []
    for sharers in (1, 8):
        solver = FuzzyClustering(vpl_clusters=10_000, point_clusters=800, compensation=0, sharers=sharers)
        solver.prepare(room, vpls, points)
        results.append((solver.irradiance(points), solver.view.seen.copy(), solver.rays))
    (each, each_seen, most), (shared, shared_seen, rays) = results
    assert rays < 0.4 * most
    assert np.abs(shared - each).max() < 0.1 * each.mean() and np.abs(shared - each).mean() < 0.01 * each.mean()
    assert shared.mean() == pytest.approx(each.mean(), rel=0.002)
    assert np.allclose(shared_seen[:, 1], each_seen[:, 1], rtol=1e-4)  # the light of all lights that face a cluster
    assert shared_seen[:, 0].sum() == pytest.approx(each_seen[:, 0].sum(), rel=0.002)


def test_only_single_lights_are_shared(room):
    points, vpls = floor_points(500), ceiling_vpls(200)
    results = []
    for sharers in (1, 8):
        solver = FuzzyClustering(vpl_clusters=40, point_clusters=100, shade_with="vpls", compensation=0, sharers=sharers)
        solver.prepare(room, vpls, points)
        results.append(solver.irradiance(points))
    assert np.array_equal(*results)


def test_fuzziness_softens_the_borders_of_clusters(room):
    x = np.linspace(-1.9, 1.9, 4000)
    points = floor_points(4000)
    points.position[:] = np.column_stack([x, np.full_like(x, 0.1), np.zeros_like(x)])
    jumps = {}
    for fuzziness in (1, 6):
        solver = FuzzyClustering(vpl_clusters=100, point_clusters=60, fuzziness=fuzziness, compensation=0)
        solver.prepare(room, ceiling_vpls(100), points)
        jumps[fuzziness] = (np.diff(solver.irradiance(points)[:, 0]) ** 2).sum()
    assert jumps[6] < jumps[1] / 10


@pytest.mark.parametrize("count", [1, 2, 6, 11])
def test_quantised_weights_add_up(count):
    rng = np.random.default_rng(count)
    for weights in rng.dirichlet(np.full(count, 0.5), 200).astype(np.float32):
        out = np.empty(count, np.uint8)
        quantised(weights, out)
        assert out.sum(dtype=int) == 255
        assert np.abs(out / 255 - weights).max() <= 1.01 / 255
    quantised(np.zeros(count, np.float32), out)
    assert not out.any()


def test_a_second_view_does_no_work_on_the_lights(room, monkeypatch):
    calls = []
    monkeypatch.setattr(
        fuzzy_clustering, "cluster_vpls", lambda *a, real=fuzzy_clustering.cluster_vpls, **k: calls.append(1) or real(*a, **k)
    )
    first, second, vpls = floor_points(500), floor_points(600, seed=9), ceiling_vpls(200)
    solver = FuzzyClustering(vpl_clusters=20, point_clusters=50, compensation=0)
    solver.prepare(room, vpls, first)
    a = solver.irradiance(first)
    b = solver.irradiance(second)
    assert len(calls) == 1
    fresh = FuzzyClustering(vpl_clusters=20, point_clusters=50, compensation=0)
    fresh.prepare(room, vpls, first)
    assert np.array_equal(fresh.irradiance(second), b)
    assert np.array_equal(solver.irradiance(first), a)


def test_tiles_of_visibility_change_rounding_only(room, monkeypatch):
    points, vpls = floor_points(500), ceiling_vpls(300)
    results = []
    for room_for in (1 << 26, 50 * 40):
        monkeypatch.setattr(fuzzy_clustering, "VISIBILITY_BYTES", room_for)
        solver = FuzzyClustering(vpl_clusters=60, point_clusters=50, compensation=0)
        solver.prepare(room, vpls, points)
        results.append(solver.irradiance(points))
    assert np.allclose(*results, rtol=1e-5)


def test_points_that_are_not_finite_are_dark(room):
    points = floor_points(100)
    points.position[17] = np.nan
    solver = FuzzyClustering(vpl_clusters=5, point_clusters=10, compensation=0)
    solver.prepare(room, ceiling_vpls(20), floor_points(100))
    got = solver.irradiance(points)
    assert not got[17].any() and np.isfinite(got).all() and (got.mean(axis=1) > 0).sum() > 90
    nothing = floor_points(0)
    assert solver.irradiance(nothing).shape == (0, 3)
    solver.prepare(room, Vpls.allocate(0), points)
    assert not solver.irradiance(points).any()


def test_random_members_belong_to_their_clusters(room):
    points = floor_points(400)
    solver = FuzzyClustering(vpl_clusters=5, point_clusters=30, fuzziness=1, compensation=0)
    solver.prepare(room, ceiling_vpls(20), points)
    solver.irradiance(points)
    view = solver.view
    picks = view.random_members(4, np.random.default_rng(3)).reshape(-1, 4)
    cluster_of = np.empty(400, int)
    cluster_of[view.members] = np.repeat(np.arange(len(view.at)), view.sizes)
    assert (cluster_of[picks] == np.arange(len(view.at))[:, None]).all()
    assert (cluster_of[view.at] == np.arange(len(view.at))).all()


@pytest.fixture(scope="module")
def sphere(build):
    """A closed sphere, radiance 1 W/m^2/sr, albedo 0.5, seen from its middle."""
    return build.scene(build.geometry(*build.icosphere(4)), build.materials((0.5, 1.0)), camera=build.camera(width=24, height=24))


@pytest.mark.parametrize("denoise", [True, False])  # by points' own gather rays and by clusters'
@pytest.mark.parametrize("shade_with", ["vpls", "clusters"])
def test_energy_in_a_closed_sphere(sphere, shade_with, denoise):
    settings = RenderSettings(
        method="fuzzy-clustering", vpls=512, bounces=2, pixel_samples=1, seed=3, vpl_clusters=128, point_clusters=200, shade_with=shade_with,
        denoise=denoise,
    )  # fmt: skip
    result = render(sphere, settings)
    assert result.stats["method"] == "fuzzy-clustering"
    assert result.layers["Irradiance"].mean() == pytest.approx(np.pi * 0.75, rel=0.015)


def test_points_own_gather_rays_find_what_clusters_rays_find(build):
    # A floor and a wall that meet, lit by a lamp: the clamp takes most of the light near the corner.
    walls = build.quads([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)])
    corner = build.scene(
        build.geometry(*walls),
        build.materials((0.8, 0.0)),
        lamps=build.lamp(sc.POINT, (50.0, 50.0, 50.0), position=(0.6, 0.5, 0.6)),
        camera=build.camera(position=(0.5, 0.5, 1.5), width=48, height=48, angle=0.7),
    )
    with prepared(Run(None), corner, RenderSettings(method="instant-radiosity").with_defaults(), 1) as tables:
        seen = view(corner, tables.rays, world_tables(corner.world), 4, 0)
        vpls, _ = trace_particles(tables, 256, 2, seed=1)
        common = {"vpl_clusters": 64, "point_clusters": 100, "bounces": 2}
        found = {}
        for rays in (0, 16):
            solver = FuzzyClustering(compensation=32, own_compensation=rays, **common)
            solver.prepare(tables, vpls, seen.points)
            solver.g_max = np.float32(0.5 * solver.g_max)
            found[rays] = solver.irradiance(seen.points)
        without = FuzzyClustering(compensation=0, **common)
        without.prepare(tables, vpls, seen.points)
        without.g_max = solver.g_max
        smooth = without.irradiance(seen.points)
    np.testing.assert_allclose(found[16] - solver.noisy, smooth, atol=1e-5 * smooth.max())
    assert solver.noisy.min() >= 0 and solver.noisy.mean() > 0.05 * smooth.mean()
    assert without.noisy is None
    assert float(solver.noisy.mean()) == pytest.approx(float((found[0] - smooth).mean()), rel=0.1)


@pytest.mark.parametrize("compensation", [True, False])
def test_a_cache_is_built_only_where_something_reads_it(sphere, compensation):
    settings = RenderSettings(
        method="fuzzy-clustering", vpls=64, pixel_samples=1, vpl_clusters=16, point_clusters=50, compensation=compensation
    )
    assert ("cache" in render(sphere, settings).stats["seconds"]) == compensation  # nothing in there is glossy


def test_same_bits_for_any_number_of_threads(sphere):
    settings = [
        RenderSettings(method="fuzzy-clustering", vpls=128, pixel_samples=4, threads=t, seed=7, vpl_clusters=40, point_clusters=300)
        for t in (1, 3)
    ]
    a, b = (render(sphere, s) for s in settings)
    assert all(np.array_equal(a.layers[name], b.layers[name]) for name in a.layers)
    for counted in ("rays", "vpls", "pairs_shaded", "skipped", "savings", "warnings"):
        assert a.stats[counted] == b.stats[counted]


def test_debug_layers_show_the_clusters(sphere):
    settings = RenderSettings(
        method="fuzzy-clustering", vpls=64, pixel_samples=1, vpl_clusters=16, point_clusters=50, fuzziness=4, debug_layers=True
    )
    layers = render(sphere, settings).layers
    ids = np.unique(layers["PointClusters"])
    assert 30 <= len(ids) <= 70 and ids[0] == 1
    shown = layers["PointRepresentatives"][layers["PointRepresentatives"] > 0]
    assert np.array_equal(np.sort(shown), np.unique(shown)) and len(shown) == ids[-1]
    weights = np.concatenate([layers["FuzzyWeights0"], layers["FuzzyWeights1"]], axis=2)
    assert np.allclose(weights.sum(axis=2), 1, atol=1e-5)
    assert (layers["VisibleShare"] > 0.99).all()  # convex: all is seen


def test_cut_outs_let_their_share_through(build):
    # A half-transparent shelf over everything: half of the light passes, cluster by cluster.
    big = [(-9, -9, 1), (9, -9, 1), (9, 9, 1), (-9, 9, 1)]
    geometry = build.geometry(*build.quads(FLOOR, big, CEILING), material=[0, 0, 1, 1, 0, 0])
    materials = build.materials((0.5, 0.0), (0.5, 0.0))
    materials.tables.constant[1, TRANSPARENCY : TRANSPARENCY + 3] = 0.5
    materials.tables.flags[1] |= sc.TRANSPARENT
    scene = build.scene(geometry, materials)
    points, vpls = floor_points(2000), ceiling_vpls(400)
    transparent = (materials.tables.flags[geometry.material] & sc.TRANSPARENT) != 0
    with RayScene(geometry.vertices, geometry.triangles, transparent=transparent) as rays:
        tables = transport(scene.geometry, scene.materials.tables, rays.tables, build_emitters(scene))
        solver = FuzzyClustering(vpl_clusters=400, point_clusters=200, compensation=0)
        solver.prepare(tables, vpls, points)
        brute = InstantRadiosity(compensation=0)
        brute.prepare(tables, vpls, points)
        got, exact = solver.irradiance(points), brute.irradiance(points)
    assert got.mean() == pytest.approx(exact.mean(), rel=0.02)
    assert np.abs(solver.view.seen[:, 0] / solver.view.seen[:, 1] - 0.5).max() < 1e-3


def test_unknown_ways_to_shade_are_named():
    with pytest.raises(ValueError, match="shade_with: expected one of clusters, vpls"):
        FuzzyClustering(shade_with="all")


def test_kmeans_gives_every_point_its_own_cluster():
    # What the equality with instant radiosity stands on.
    points = floor_points(300)
    clustering = kmeans(points.position, points.ns, 1000)
    assert np.array_equal(np.sort(clustering.representatives), np.arange(300))


def test_smoothing_keeps_the_light_and_spreads_what_stands_out(room):
    points = floor_points(3000)
    solver = FuzzyClustering(vpl_clusters=20, point_clusters=400, compensation=0)
    solver.prepare(room, ceiling_vpls(50), points)
    solver.irradiance(points)
    sizes = solver.view.sizes[:, None]
    values = np.random.default_rng(0).exponential(1, (len(sizes), 3))
    values[100] = 300
    smooth = solver._smoothed(values)
    assert (smooth * sizes).sum(axis=0) == pytest.approx((values * sizes).sum(axis=0))
    assert smooth.max() < 30 and smooth.min() >= 0
    assert np.allclose(solver._smoothed(np.full_like(values, 2.5)), 2.5)
    assert not solver._smoothed(np.zeros_like(values)).any()
