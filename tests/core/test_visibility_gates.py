"""Light through gates: what the topology lets pass, what it stops, and what shadow rays decide."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.core import scene as sc
from lumigate.core.lamps import build_emitters
from lumigate.core.methods import gate_lists
from lumigate.core.methods.gate_shading import shade
from lumigate.core.methods.instant_radiosity import InstantRadiosity
from lumigate.core.methods.visibility_gates import VisibilityGates
from lumigate.core.particles import Vpls
from lumigate.core.pipeline import render
from lumigate.core.rays import RayScene
from lumigate.core.settings import RenderSettings
from lumigate.core.topology import Topologies, blocking_triangles, build_topology, reachable_emitters, reachable_vpls, rooms_seen
from lumigate.core.transport import transport
from lumigate.core.view.points import ShadingPoints

from .test_topology_clusters import boxes

DOOR = [((4, 0, 0), (4.2, 1.5, 3)), ((4, 2.5, 0), (4.2, 4, 3)), ((4, 1.5, 2.2), (4.2, 2.5, 3))]
WALL = [((4, 0, 0), (4.2, 4, 3))]


def _scene(build, walls):
    """Rooms of 4 x 4 x 3 m side by side, boxes between them, a camera that looks along the first one's -z."""
    scene = build.scene(build.geometry(*boxes(((0, 0, 0), (8.2, 4, 3)), *walls)), build.materials((0.6, 0.0)))
    scene.camera = build.camera((1.5, 2, 2.8), 24, 24, 1.6)
    return scene


def _point_lamp(position):
    f = np.float32
    return sc.Lamps(
        np.array([sc.POINT], np.int32), np.array([position], f), np.eye(3, dtype=f)[None], np.full((1, 3), 10, f), np.zeros(1, f),
        np.zeros(1, np.uint8), np.zeros(1, f), np.zeros(1, f), np.zeros((1, 2), f), np.zeros(1, np.int32),
        np.full(1, sc.ALL_RAYS, np.uint8), np.ones(1, np.uint8), ["lamp"], [""],
    )  # fmt: skip


def _walls_of_the_rooms(count, seed):
    """Points on floor and ceiling of both rooms, and VPLs likewise."""
    rng = np.random.default_rng(seed)
    at = rng.uniform([0.1, 0.1, 0], [8.1, 3.9, 0], (count, 3))
    at = at[np.abs(at[:, 0] - 4.1) > 0.3]
    up = rng.random(len(at)) < 0.5
    at[:, 2] = np.where(up, 0, 3)
    normal = np.where(up[:, None], [0, 0, 1.0], [0, 0, -1.0])
    return at.astype(np.float32), normal.astype(np.float32)


def _points(position, normal):
    points = ShadingPoints.allocate(len(position))
    points.position[:], points.ng[:], points.ns[:] = position, normal, normal
    points.error[:], points.pixel[:] = 1e-5, np.arange(len(position))
    points.albedo[:] = 1
    return points


def _lights(position, normal):
    vpls = Vpls.allocate(len(position))
    vpls.position[:], vpls.normal[:], vpls.surface_normal[:] = position, normal, normal
    vpls.error[:], vpls.flux[:], vpls.bounce[:], vpls.emitter[:] = 1e-5, 1.0, 1, 0
    return vpls


@pytest.fixture(scope="module")
def rooms(build):
    """Two rooms and a door: (tables, topology, points, vpls, what brute force finds)."""
    scene = _scene(build, DOOR)
    geometry = scene.geometry
    points, vpls = _points(*_walls_of_the_rooms(900, 1)), _lights(*_walls_of_the_rooms(150, 2))
    with RayScene(geometry.vertices, geometry.triangles) as rays:
        tables = transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))
        topology = build_topology(geometry.vertices, blocking_triangles(scene), 82)
        truth = InstantRadiosity(compensation=0)
        truth.prepare(tables, vpls, points)
        yield tables, topology, points, vpls, truth.irradiance(points)


def _solve(rooms, gates, **options):
    tables, topology, points, vpls, _ = rooms
    solver = VisibilityGates(topology, gates=gates, compensation=0, **options)
    solver.prepare(tables, vpls, points)
    return solver, solver.irradiance(points)


def _error(rooms, irradiance):
    truth = rooms[-1]
    return float(((irradiance - truth) ** 2).mean() / truth.mean() ** 2)


def test_gates_are_nearer_to_shadow_rays_than_no_shadows(rooms):
    tables, _, points, vpls, _ = rooms
    blind = InstantRadiosity(visibility="none", compensation=0)
    blind.prepare(tables, vpls, points)
    without = _error(rooms, blind.irradiance(points))
    off, disks, polygons = (_error(rooms, _solve(rooms, gates)[1]) for gates in ("off", "disks", "polygons"))
    assert max(polygons, disks) < off < without
    assert polygons < 0.2 * without


def test_lines_of_voxels_are_a_second_opinion(rooms, monkeypatch):
    both = _error(rooms, _solve(rooms, "polygons")[1])
    monkeypatch.setattr(gate_lists, "lines_of", lambda *_: gate_lists.no_lines())
    assert both < 0.9 * _error(rooms, _solve(rooms, "polygons")[1])


def test_gates_off_keep_light_in_its_cluster(rooms):
    _, topology, points, vpls, truth = rooms
    solver, light = _solve(rooms, "off")
    clusters = topology.clusters_at(vpls.position, vpls.surface_normal)
    own = topology.clusters_at(points.position, points.ng)
    assert not light[~np.isin(own, clusters)].any()
    assert light.sum() < truth.sum() and solver.rays == 0


def test_guided_rays_find_what_all_rays_find_with_fewer(rooms):
    solver, light = _solve(rooms, "guided")
    truth = rooms[-1]
    relmse = ((light - truth) ** 2 / (truth**2 + 0.01 * truth.mean() ** 2)).mean()
    assert relmse < 0.003
    assert light.mean() == pytest.approx(float(truth.mean()), rel=0.01)
    assert solver.saved > 0.3 * (solver.saved + solver.rays)


@pytest.mark.parametrize("sees", [True, False])
def test_guided_rays_need_not_believe_the_topology(rooms, sees):
    # Clusters that it takes for one another's, or for dark to each other: the mean of many seeds is that of all rays still.
    tables, topology, points, vpls, truth = rooms
    wrong = replace(topology, sight=np.zeros_like(topology.sight))
    if sees:
        wrong = replace(topology, cluster=np.zeros_like(topology.cluster))
    light = np.zeros_like(truth, np.float64)
    for seed in range(20):
        solver = VisibilityGates(wrong, gates="guided", compensation=0, seed=seed)
        solver.prepare(tables, vpls, points)
        light += solver.irradiance(points) / 20
    assert light.mean() == pytest.approx(float(truth.mean()), rel=0.002)
    runs = solver.runs
    of_clusters, true_of_clusters = (np.add.reduceat(each[runs.order], runs.first[:-1]) for each in (light, truth))
    np.testing.assert_allclose(of_clusters.sum(axis=1), true_of_clusters.sum(axis=1), rtol=0.01)
    # A point's own mean is drawn towards its cluster's a little.
    assert ((light - truth) ** 2 / (truth**2 + 0.01 * truth.mean() ** 2)).mean() < 0.0005


@pytest.mark.parametrize("gates", ["disks", "polygons", "guided"])
def test_the_same_bits_for_any_number_of_threads(rooms, gates):
    assert np.array_equal(_solve(rooms, gates, threads=1)[1], _solve(rooms, gates, threads=3)[1])


def test_lists_hold_all_that_single_lines_find(rooms):
    # Every line from a VPL through a disk to a point must be in the lists: cones only ever hold more.
    _, topology, points, vpls, _ = rooms
    gates = topology.disks
    lights = gate_lists.lights_of(vpls, topology.clusters_at(vpls.position, vpls.surface_normal))
    table = gate_lists.gate_table(gates, np.ones_like(topology.sight), polygons=False)
    runs = gate_lists.runs_of(points.position, points.ng, topology.clusters_at(points.position, points.ng), gate_lists.POINTS)
    lists = gate_lists.joined([gate_lists.assign(runs, 0, len(runs.cluster), lights, table, gate_lists.cones_of(lights, table))])
    found = 0
    for r in range(len(runs.cluster)):
        items = slice(lists.first[r], lists.first[r + 1])
        listed = {(b, g): m for b, g, m in zip(lists.block[items], lists.gate[items], lists.mask[items])}
        p = points.position[runs.order[runs.first[r]]].astype(float)
        for j, v in enumerate(lights.table[:3].T.astype(float)):
            block, lane = divmod(j, gate_lists.LANES)
            c = lights.blocks.cluster[block]
            if lane >= np.diff(lights.blocks.first)[block] or c == runs.cluster[r] or (p - v) @ lights.table[3:6, j] <= 0:
                continue
            for g in table.of[table.first[c] : table.first[c + 1]]:
                n = gates.frame[g, 2].astype(float)
                before, after = (v - gates.centre[g]) @ n, (p - gates.centre[g]) @ n
                if before * after < 0:
                    q = v + before / (before - after) * (p - v)
                    if np.linalg.norm(q - gates.centre[g]) < 0.999 * gates.radius[g]:
                        assert listed.get((block, g), 0) >> lane & 1
                        found += 1
    assert found > 50


def test_rooms_without_a_way_to_the_view_are_left_out(build):
    closed, opened = _scene(build, WALL), _scene(build, DOOR)
    for scene, reached in ((closed, False), (opened, True)):
        scene.lamps = _point_lamp((6.2, 2, 1.5))
        topology = Topologies().of(scene, 82)
        seen = rooms_seen(topology, _points(*(a[:50] for a in _first_room())))
        assert reachable_emitters(topology, seen, build_emitters(scene))[0] == reached
        far = _lights(np.array([[6.2, 2, 0]], np.float32), np.array([[0, 0, 1]], np.float32))
        assert reachable_vpls(topology, seen, far)[0] == reached
    settings = RenderSettings(method="visibility-gates", vpls=64, pixel_samples=1, voxels=82)
    result = render(closed, settings)
    assert result.stats["rays"]["light"] == 0 and not result.layers["Indirect"].any()
    assert any(s["stage"] == "lamps" for s in result.stats["skipped"])
    assert render(opened, settings).stats["rays"]["light"] > 0


def _first_room():
    at, normal = _walls_of_the_rooms(400, 5)
    return at[at[:, 0] < 3.8], normal[at[:, 0] < 3.8]


def test_lamps_without_shadows_shine_through_walls(build):
    scene = _scene(build, WALL)
    scene.lamps = _point_lamp((6.2, 2, 1.5))
    scene.lamps.cast_shadow[:] = 0
    topology = Topologies().of(scene, 82)
    assert reachable_emitters(topology, rooms_seen(topology, _points(*_first_room())), build_emitters(scene)).all()


def test_cut_outs_are_no_walls(build):
    scene = _scene(build, WALL)
    assert Topologies().of(scene, 82).rooms == 2
    stuff = build.materials((0.6, 0.0), (0.6, 0.0))
    stuff.tables.flags[1] |= sc.TRANSPARENT
    scene.materials = stuff
    scene.geometry.material[12:] = 1
    assert Topologies().of(scene, 82).rooms == 1
    assert Topologies().of(scene, 82, cutouts=True).rooms == 2


def test_thin_sheets_are_walls_or_none(build):
    # A curtain across most of a room, a sheet that parts it from the next one, and a box on the floor.
    curtain = _sheet(3.0, (0.5, 3.5), (0.3, 3.0))
    parting = _sheet(5.0, (0.0, 4.0), (0.0, 3.0))
    room = boxes(((0, 0, 0), (8, 4, 3)), ((1, 1, 0), (2, 2, 1)))
    vertices = np.concatenate([room[0], curtain, parting]).astype(np.float32)
    first = len(room[0])
    quads = [[k, k + 1, k + 2] for k in (first, first + 4)] + [[k, k + 2, k + 3] for k in (first, first + 4)]
    triangles = np.concatenate([room[1], quads]).astype(np.int32)
    scene = build.scene(build.geometry(vertices, triangles), build.materials((0.6, 0.0)))
    walls, none = (Topologies().of(scene, 80, sheets=sheets) for sheets in (True, False))
    assert walls.rooms == none.rooms == 3  # the box's inside, and the two that the last sheet parts
    curtains, partings, corner = np.float32([[3.0, 2, 1.5]]), np.float32([[5.0, 2, 1.5]]), np.float32([[1.0, 1.5, 0.5]])
    solid = [
        [topology.node_of[tuple(topology.grid.cell_of(at)[0, ::-1])] < 0 for at in (curtains, partings, corner)]
        for topology in (walls, none)
    ]
    assert solid == [[True, True, True], [False, True, True]]


def _sheet(x, y, z):
    """(4, 3) corners of a rectangle across x."""
    return [(x, y[0], z[0]), (x, y[1], z[0]), (x, y[1], z[1]), (x, y[0], z[1])]


def test_an_open_outside_joins_what_leads_out(build):
    # A sheet on the floor of its own box: closed, the space above and below it are apart; open, both lead out.
    vertices = np.float32([[0, 0, 0], [4, 0, 0], [0, 4, 0], [4, 4, 0], [0, 0, 2], [0, 0, -2]])
    scene = build.scene(build.geometry(vertices, np.int32([[0, 1, 2], [1, 3, 2], [4, 4, 4], [5, 5, 5]])), build.materials((0.6, 0.0)))
    known = Topologies()
    closed, open_ = known.of(scene, 16), known.of(scene, 16, closed=False)
    assert closed.rooms == 2 and open_ is not closed
    points = _points(np.float32([[2, 2, 0]]), np.float32([[0, 0, 1]]))
    assert rooms_seen(open_, points).any()


def test_the_debug_layers_number_the_clusters(build):
    scene = _scene(build, DOOR)
    scene.lamps = _point_lamp((2, 2, 1.5))
    settings = RenderSettings(method="visibility-gates", vpls=64, pixel_samples=1, voxels=41, debug_layers=True)
    layers = render(scene, settings).layers
    for name in ("VisibilityClusters", "GeometryClusters"):
        assert layers[name].shape == (24, 24, 1) and layers[name].min() >= 1
    assert len(np.unique(layers["GeometryClusters"])) >= len(np.unique(layers["VisibilityClusters"]))


def test_oversized_disks_let_more_light_in(rooms):
    assert _solve(rooms, "disks", oversize=1.5)[1].sum() > 1.02 * _solve(rooms, "disks")[1].sum()


def test_the_filter_has_no_effect_far_from_borders(rooms):
    _, topology, points, _, _ = rooms
    sharp, soft = (_solve(rooms, "disks", blend=blend)[1] for blend in (0, 4))
    shares = topology.shares_around(points.position, points.ng, 4)
    alone = np.bincount(shares.item, minlength=len(sharp)) == 1
    assert 0 < alone.sum() < len(alone)
    assert np.allclose(sharp[alone], soft[alone], rtol=1e-5)


def test_a_blend_is_the_mean_of_what_its_clusters_get(rooms):
    # A slow look at one point: its light in each of its clusters, put together by hand.
    _, topology, points, _, _ = rooms
    solver, soft = _solve(rooms, "disks", blend=4)
    shares = topology.shares_around(points.position, points.ng, 4)
    p = np.bincount(shares.item, minlength=len(soft)).argmax()
    of = shares.item == p
    light = 0
    for cluster, share in zip(shares.cluster[of], shares.share[of]):
        one = points.take([p])
        runs = gate_lists.runs_of(one.position, one.ng, np.array([cluster], np.int32), gate_lists.POINTS)
        lists = gate_lists.joined(
            [gate_lists.assign(runs, 0, 1, solver.lights, solver.table, gate_lists.cones_of(solver.lights, solver.table))]
        )
        out = np.zeros((1, 3), np.float32)
        shade(one, runs, 0, 1, solver.lights, lists, solver.table, gate_lists.no_lines(), solver.g_max, out)
        light = light + share * out[0]
    assert of.sum() > 1
    assert np.allclose(soft[p], light, rtol=1e-4)


def test_polygons_let_light_in_by_gates_of_one_way_only(rooms):
    # Every pair that polygons join passes an opening between both clusters, or one out of the VPL's and one into the point's.
    topology = rooms[1]
    solver, _ = _solve(rooms, "polygons")
    lists = solver._assign()
    joins = topology.polygons.clusters
    for r in range(len(solver.runs.cluster)):
        items = slice(lists.first[r], lists.first[r + 1])
        for b in np.unique(lists.block[items]):
            own, cluster = solver.lights.blocks.cluster[b], solver.runs.cluster[r]
            marks = lists.gate[items][lists.block[items] == b]
            if marks[0] == gate_lists.NO_GATE:
                assert own == cluster
                continue
            assert topology.sight[own, cluster]
            if marks[0] == gate_lists.LINES:
                continue
            gates, leaving = marks & gate_lists.NUMBER, (marks & gate_lists.LEAVING) > 0
            entering = (marks & gate_lists.ENTERING) > 0
            alone = ~leaving & ~entering
            assert all(set(joins[g]) == {own, cluster} for g in gates[alone])
            assert all(own in joins[g] for g in gates[leaving]) and all(cluster in joins[g] for g in gates[entering])
            assert leaving.any() == entering.any()


@pytest.mark.parametrize("factor", [2.0**-60, 2.0**60])
def test_guided_rays_are_the_same_however_dim_the_light(rooms, factor):
    tables, topology, points, vpls, _ = rooms
    scaled = VisibilityGates(topology, gates="guided", compensation=0)
    scaled.prepare(tables, vpls._replace(flux=vpls.flux * np.float32(factor)), points)
    solver, light = _solve(rooms, "guided")
    np.testing.assert_allclose(scaled.irradiance(points) / np.float32(factor), light, rtol=1e-5)
    assert scaled.rays == solver.rays


def test_guided_rays_leave_points_in_cracks_dark(build):
    # A sheet 2 mm over the floor hides a strip of it from all lights above, unlike all points around.
    sheet = ((2.0, 0.5, 0.002), (2.05, 3.5, 0.004))
    scene = build.scene(build.geometry(*boxes(((0, 0, 0), (4, 4, 3)), sheet)), build.materials((0.6, 0.0)))
    geometry = scene.geometry
    rng = np.random.default_rng(8)
    at = np.append(rng.uniform([0.5, 1, 0], [3.5, 3, 0], (630, 3)), [[2.02, y, 0] for y in np.linspace(1.1, 2.9, 10)], axis=0)
    points = _points(at.astype(np.float32), np.tile(np.float32([0, 0, 1]), (len(at), 1)))
    above = rng.uniform([0.5, 0.5, 3], [3.5, 3.5, 3], (200, 3)).astype(np.float32)
    vpls = _lights(above, np.tile(np.float32([0, 0, -1]), (200, 1)))
    with RayScene(geometry.vertices, geometry.triangles) as rays:
        tables = transport(geometry, scene.materials.tables, rays.tables, build_emitters(scene))
        topology = build_topology(geometry.vertices, blocking_triangles(scene), 40)
        truth = InstantRadiosity(compensation=0)
        solver = VisibilityGates(topology, gates="guided", compensation=0)
        light = []
        for method in (truth, solver):
            method.prepare(tables, vpls, points)
            light.append(method.irradiance(points))
    assert not light[0][-10:].any()
    assert light[1][-10:].max() < 0.1 * light[1].mean() and light[1][-10:].mean() < 0.02 * light[1].mean()
    assert solver.saved > 0.5 * (solver.saved + solver.rays)


def test_unknown_gates_are_refused(rooms):
    with pytest.raises(ValueError, match="gates"):
        VisibilityGates(rooms[1], gates="doors")
