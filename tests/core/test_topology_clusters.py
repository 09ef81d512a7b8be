"""Segmentation, visibility clusters, gates and the voxel map, on rooms whose answers are known."""

import numpy as np
import pytest

from lumigate.core.errors import SceneError
from lumigate.core.topology import SOLID, Topologies, build_topology
from lumigate.core.topology.bits import pack
from lumigate.core.topology.gates import DIRECTIONS, SIDES, polygon_gates
from lumigate.core.topology.lines import free_line
from lumigate.core.topology.merging import merged
from lumigate.core.topology.nearest import nodes_of_voxels
from lumigate.core.topology.segmentation import COVERAGE, CURVATURE, PLAIN, TOPOLOGY, segment
from lumigate.core.topology.skeleton import Skeleton
from lumigate.core.topology.store import from_arrays, to_arrays
from lumigate.core.topology.voxels import Grid

BOX = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # faces of corners numbered by bits


def boxes(*bounds):
    """Vertices and triangles of closed boxes, each (low, high)."""
    vertices, triangles = [], []
    for low, high in bounds:
        corners = np.array([[(low, high)[k >> a & 1][a] for a in range(3)] for k in range(8)])
        faces = np.array([[(a, b, c), (a, c, d)] for a, b, c, d in BOX]).reshape(-1, 3)
        triangles.append(faces + 8 * len(vertices))
        vertices.append(corners)
    return np.concatenate(vertices).astype(np.float32), np.concatenate(triangles).astype(np.int32)


@pytest.fixture(scope="module")
def two_rooms():
    """Rooms of 4 x 4 x 3 m with a door of 1 m between them, seen from above in x; the wall lies at x = 4."""
    walls = [((4, 0, 0), (4.2, 1.5, 3)), ((4, 2.5, 0), (4.2, 4, 3)), ((4, 1.5, 2.2), (4.2, 2.5, 3))]
    vertices, triangles = boxes(((0, 0, 0), (8.2, 4, 3)), *walls)
    return build_topology(vertices, triangles, 82)


def _line(place, radius):
    place, n = np.asarray(place, np.int32), len(place)
    arcs = np.stack([np.arange(n - 1), np.arange(1, n)], 1).astype(np.int32)
    return Skeleton(place, np.asarray(radius, np.float32), arcs, np.zeros(n, np.int32))


def test_a_straight_line_within_one_ball_keeps_its_ends():
    kept = segment(_line([(i, 0, 0) for i in range(9)], [8] * 9))
    assert np.array_equal(kept.node, [0, 8]) and (kept.kind == TOPOLOGY).all()
    assert np.array_equal(kept.edges, [[0, 1]])
    assert np.array_equal(kept.owner, [0] * 5 + [1] * 4)


def test_a_bend_is_a_curvature_node():
    place = [(i, 0, 0) for i in range(21)] + [(20, i, 0) for i in range(1, 21)]
    kept = segment(_line(place, [4] * 41))
    assert 20 in kept.node[kept.kind == CURVATURE]
    assert not (kept.kind == PLAIN).any()


def test_small_balls_make_coverage_nodes():
    kept = segment(_line([(i, 0, 0) for i in range(41)], [3] * 41))
    assert (kept.kind[1:-1] == COVERAGE).all() or set(kept.kind) == {TOPOLOGY, COVERAGE}
    # Every node lies in the ball of a kept one next to it.
    gaps = np.diff(np.sort(kept.node))
    assert gaps.max() <= 7


def test_a_ring_without_ends_is_cut_once():
    n = 40
    angle = 2 * np.pi * np.arange(n) / n
    place = np.stack([30 + 20 * np.cos(angle), 30 + 20 * np.sin(angle), 0 * angle], 1)
    ring = _line(place, [3] * n)
    ring = Skeleton(ring.place, ring.radius, np.append(ring.arcs, [[n - 1, 0]], axis=0).astype(np.int32), ring.component)
    kept = segment(ring)
    assert (kept.kind == TOPOLOGY).sum() == 1
    degree = np.bincount(kept.edges.ravel())
    assert (degree == 2).all() and len(kept.edges) == len(kept.node)


def test_the_door_lies_between_clusters(two_rooms):
    left, right = two_rooms.clusters_at(
        np.array([[1.0, 0, 1.5], [7.0, 4, 1.5]], np.float32), np.array([[0.0, 1, 0], [0, -1, 0]], np.float32)
    )
    assert left != right and min(left, right) >= 0
    assert two_rooms.rooms_at(np.array([[1.0, 0, 1.5]], np.float32), np.array([[0.0, 1, 0]], np.float32))[0] == 0
    for gates in (two_rooms.disks, two_rooms.polygons):
        assert (gates.clusters[:, 0] != gates.clusters[:, 1]).all()
        assert np.allclose(np.linalg.norm(gates.frame, axis=2), 1, atol=1e-5)
        # Every way from one room to the other passes the door: some gate lies in it.
        at_door = np.abs(gates.centre - [4.1, 2, 1.1]).max(axis=1) < 0.7
        assert at_door.any()


def _met(solid, a, b, grown):
    """Whether a line between the middles of voxels a and b (x, y, z) meets a solid one that is `grown` larger on each side."""
    way = a + 0.5 + np.linspace(0, 1, 100 * np.abs(b - a).max() + 2)[:, None] * (b - a)
    found = np.ones(len(way), bool) if grown < 0 else np.zeros(len(way), bool)
    for corner in np.ndindex(2, 2, 2):
        at = np.floor(way + abs(grown) * (2 * np.array(corner) - 1)).astype(int)
        found = (np.logical_and if grown < 0 else np.logical_or)(found, solid[at[:, 2], at[:, 1], at[:, 0]])
    return found.any()


def test_free_lines_meet_no_solid_voxel():
    rng = np.random.default_rng(3)
    solid = rng.random((12, 13, 14)) < 0.06
    label = np.where(solid, SOLID, 0).astype(np.int32)
    ends = np.argwhere(~solid)[:, ::-1]
    free = 0
    for a, b in ends[rng.integers(0, len(ends), (400, 2))]:
        found = free_line(pack(label >= 0), *a, *b)
        # Lines through an edge or a corner may go either way.
        assert not _met(solid, a, b, -0.02) if found else _met(solid, a, b, 0.02)
        free += found
    assert 50 < free < 350


def test_what_sees_each_other_is_in_sight(two_rooms):
    assert np.array_equal(two_rooms.sight, two_rooms.sight.T) and two_rooms.sight.diagonal().all()
    joins = two_rooms.polygons.clusters
    assert two_rooms.sight[joins[:, 0], joins[:, 1]].all()
    solid, at = two_rooms.node_of < 0, np.argwhere(two_rooms.node_of >= 0)[:, ::-1]
    rng = np.random.default_rng(0)
    count = two_rooms.clusters
    tried, free = np.zeros((count, count)), np.zeros((count, count))
    for a, b in at[rng.integers(0, len(at), (1500, 2))]:
        one, other = (two_rooms.cluster[two_rooms.node_of[tuple(v[::-1])]] for v in (a, b))
        tried[one, other] += 1
        free[one, other] += not _met(solid, a, b, 0)
    often = (tried > 20) & (free > 0.3 * tried)
    assert often.sum() > 1 and two_rooms.sight[often].all()


def test_neighbours_that_see_each_other_are_joined(two_rooms):
    walls = [((4, 0, 0), (4.2, 1.5, 3)), ((4, 2.5, 0), (4.2, 4, 3)), ((4, 1.5, 2.2), (4.2, 2.5, 3))]
    alone = build_topology(*boxes(((0, 0, 0), (8.2, 4, 3)), *walls), 82, share=1.1)
    assert two_rooms.clusters < alone.clusters
    # Each room is nearly one cluster, and no cluster is in both.
    inside = two_rooms.node_of >= 0
    cluster = two_rooms.cluster[two_rooms.node_of]
    left, right = (np.bincount(cluster[:, :, part][inside[:, :, part]]) for part in (slice(1, 39), slice(43, 81)))
    assert left.max() > 0.9 * left.sum() and right.max() > 0.9 * right.sum() and left.argmax() != right.argmax()


def test_parts_that_do_not_see_each_other_stay_apart():
    # Two halves of a bar, and one round its corner: the first see each other wholly.
    label = np.full((3, 24, 24), SOLID, np.int32)
    label[1, 1:3, 1:12], label[1, 1:3, 12:23], label[1, 3:23, 21:23] = 0, 1, 2
    assert len(np.unique(merged(label, 3, 0.9))) == 2
    assert merged(label, 3, 0.9)[0] == merged(label, 3, 0.9)[1]
    assert len(np.unique(merged(label, 3, 1.1))) == 3


def test_shares_around_borders(two_rooms):
    rng = np.random.default_rng(4)
    at = np.stack([rng.uniform(0.2, 8, 300), rng.uniform(0.2, 3.8, 300), np.zeros(300)], 1).astype(np.float32)
    at = at[np.abs(at[:, 0] - 4.1) > 0.2]
    up = np.tile(np.float32([0, 0, 1]), (len(at), 1))
    shares = two_rooms.shares_around(at, up, 5)
    assert np.allclose(np.bincount(shares.item, shares.share), 1, atol=1e-5)
    own = two_rooms.clusters_at(at, up)
    largest = np.zeros(len(at))
    np.maximum.at(largest, shares.item, np.where(shares.cluster == own[shares.item], shares.share, 0))
    assert (largest > 0.05).all()
    # No wall is crossed: beside it, far from the door, all clusters are those of voxels that a free line reaches.
    beside = np.flatnonzero((np.abs(at[:, 0] - 4.1) < 0.6) & (np.abs(at[:, 1] - 2) > 1.2))
    assert len(beside) > 3
    for item in beside:
        for cluster in shares.cluster[shares.item == item]:
            x = np.argwhere(two_rooms.cluster[two_rooms.node_of] == cluster)[:, 2]
            assert ((x < 41) == (at[item, 0] < 4.1)).any()
    assert np.array_equal(two_rooms.shares_around(at, up, 0.01).cluster, own)


def test_bulging_openings_are_cut_into_flat_pieces():
    # A cube in the middle of another cluster: one opening, six sides.
    cluster = np.zeros((40, 40, 40), np.int32)
    cluster[10:30, 10:30, 10:30] = 1
    gates = polygon_gates(Grid(np.zeros(3), 1.0, (40, 40, 40)), cluster)
    assert len(gates.radius) >= 6
    # Most lines from its middle outwards pass some piece; one plane alone has half of them behind it or in it.
    rng = np.random.default_rng(1)
    to = rng.normal(size=(200, 3))
    to = 20 + 60 * to / np.linalg.norm(to, axis=1, keepdims=True)
    passed = 0
    for end in to:
        some = False
        for g in range(len(gates.radius)):
            n = gates.frame[g, 2].astype(float)
            before, after = (np.full(3, 20.0) - gates.centre[g]) @ n, (end - gates.centre[g]) @ n
            if before * after < 0:
                q = 20 + before / (before - after) * (end - 20) - gates.centre[g]
                some |= bool((np.array([q @ gates.frame[g, 0], q @ gates.frame[g, 1]]) @ DIRECTIONS.T <= gates.extent[g]).all())
        passed += some
    assert passed > 0.6 * len(to)


def test_clusters_are_connected_and_complete(two_rooms):
    assert (two_rooms.cluster >= 0).all()
    assert np.array_equal(np.unique(two_rooms.cluster), np.arange(two_rooms.clusters))
    edges = two_rooms.segmented.edges
    inner = edges[two_rooms.cluster[edges[:, 0]] == two_rooms.cluster[edges[:, 1]]]
    label = np.arange(len(two_rooms.cluster))
    for _ in range(len(label)):
        before = label.copy()
        np.minimum.at(label, inner[:, 0], label[inner[:, 1]])
        np.minimum.at(label, inner[:, 1], label[inner[:, 0]])
        if np.array_equal(before, label):
            break
    assert len(np.unique(label)) == two_rooms.clusters


def test_the_voxel_map_does_not_leak_through_walls():
    empty = np.ones((8, 20, 21), bool)
    empty[:, :, 10] = False
    empty[:, 0, 10] = True  # a way round, at one end
    place = np.array([[5, 18, 4], [16, 1, 4]], np.int32)
    label = nodes_of_voxels(empty, place, np.array([7, 9], np.int32))
    assert (label[~empty] == SOLID).all() and (label[empty] >= 0).all()
    # Behind the wall, two voxels from the first node, the second one is nearer by the way through the empty space.
    assert label[4, 18, 8] == 7
    assert label[4, 5, 12] == 9
    assert label[4, 18, 12] == 9


def test_polygons_fit_the_opening():
    cluster = np.zeros((10, 12, 20), np.int32)
    cluster[:, :, 10:] = 1
    cluster[:, :4, 9:11] = SOLID
    cluster[:, 8:, 9:11] = SOLID
    gates = polygon_gates(Grid(np.zeros(3), 0.5, (20, 12, 10)), cluster)
    assert len(gates.radius) == 1
    assert np.allclose(gates.centre[0], [5.0, 3.0, 2.5], atol=1e-5)
    assert np.allclose(np.abs(gates.frame[0, 2]), [1, 0, 0], atol=1e-5)
    outline = gates.outlines()[0]
    assert outline.shape == (SIDES, 3)
    # A rectangle of 2 x 5 m, its corners cut by no more than the fixed directions allow.
    assert np.abs(outline[:, 1] - 3).max() == pytest.approx(1.0, abs=0.08)
    assert np.abs(outline[:, 2] - 2.5).max() == pytest.approx(2.5, abs=0.2)
    assert (gates.raster[0] == 0xFFFF).all()


def test_the_raster_keeps_what_a_polygon_covers_too_much_of():
    # An opening like an L: its polygon covers the corner that is a wall, its raster does not.
    cluster = np.zeros((16, 16, 20), np.int32)
    cluster[:, :, 10:] = 1
    cluster[8:, 8:, 9:11] = SOLID
    gates = polygon_gates(Grid(np.zeros(3), 0.5, (20, 16, 16)), cluster)
    assert len(gates.radius) == 1
    open_cells = np.array([[row >> i & 1 for i in range(16)] for row in gates.raster[0]])
    assert open_cells.mean() == pytest.approx(0.75, abs=0.08)


def test_two_windows_are_two_gates():
    cluster = np.zeros((10, 12, 20), np.int32)
    cluster[:, :, 10:] = 1
    cluster[:, 5:7, 9:11] = SOLID
    assert len(polygon_gates(Grid(np.zeros(3), 0.5, (20, 12, 10)), cluster).radius) == 2


def test_a_room_of_one_piece_has_one_cluster_and_no_gates():
    topology = build_topology(*boxes(((0, 0, 0), (1, 1, 1))), 32)
    assert (topology.rooms, topology.clusters) == (1, 1)
    assert len(topology.disks.radius) == len(topology.polygons.radius) == 0


def test_nothing_to_build_from_is_said():
    with pytest.raises(SceneError):
        build_topology(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))


def test_arrays_make_the_same_topology(two_rooms):
    again = from_arrays(to_arrays(two_rooms))
    for name, array in to_arrays(again).items():
        assert np.array_equal(array, to_arrays(two_rooms)[name])
    assert again.grid.shape == two_rooms.grid.shape and again.grid.size == two_rooms.grid.size


def test_moved_lamps_and_cameras_build_nothing_moved_walls_do(build):
    scene = build.scene(build.geometry(*boxes(((0, 0, 0), (2, 1, 1)))), build.materials((0.5, 1.0)))
    known = Topologies(capacity=1)
    first = known.of(scene, 24)
    scene.camera.matrix[:3, 3] += 0.3
    scene.world.radiance = scene.world.radiance + 1
    assert known.of(scene, 24) is first
    assert known.of(scene, 16) is not first
    again = known.of(scene, 24)
    assert again is not first  # only one is held
    scene.geometry.vertices[0] -= 0.5
    assert known.of(scene, 24) is not again
