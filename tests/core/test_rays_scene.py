"""RayScene at its borders: empty scenes, bad input, absent or failing Embree; the BVH's own invariants."""

import gc

import numpy as np
import pytest

from lumigate.core import rays
from lumigate.core.rays import bvh_build, embree
from lumigate.core.rays.bvh import BvhBackend
from lumigate.core.rays.partition import partition

ONE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
DOWN = np.array([[0.2, 0.2, 1]]), np.array([[0, 0, -1]])


@pytest.mark.parametrize("backend", ["embree", "bvh"])
@pytest.mark.parametrize("case", ["nothing", "degenerate", "invisible"])
def test_scenes_without_a_hit(backend, case):
    vertices, triangles = {"nothing": (np.zeros((0, 3)), np.zeros((0, 3)))}.get(case, (ONE, [[0, 1, 2]]))
    if case == "degenerate":
        triangles = [[0, 1, 1]]
    visibility = np.zeros(len(triangles)) if case == "invisible" else None
    with rays.RayScene(vertices, triangles, visibility, backend=backend) as scene:
        for which in (rays.OPAQUE, rays.CUTOUT, rays.ALL):
            hits = rays.intersect(scene, *DOWN, which=which)
            assert hits.triangle[0] == -1 and np.isinf(hits.t[0]) and hits.u[0] == hits.v[0] == 0
            assert rays.occluded(scene, *DOWN, t_max=10, which=which)[0] == 0


@pytest.mark.parametrize("backend", ["embree", "bvh"])
def test_no_rays(backend):
    with rays.RayScene(ONE, [[0, 1, 2]], backend=backend) as scene:
        assert len(rays.intersect(scene, np.zeros((0, 3)), np.zeros((0, 3))).triangle) == 0


@pytest.mark.parametrize("backend", ["embree", "bvh"])
def test_rays_that_are_none_meet_nothing(backend):
    vertices, triangles = _soup(200, np.random.default_rng(3))
    origins = np.full((40, 3), 0.5)
    directions = np.ones((40, 3))
    origins[:10, 1] = np.nan
    directions[10:20, 2] = np.nan
    directions[20:30] = 0
    t_max = np.where(np.arange(40) < 30, np.inf, -1)
    with rays.RayScene(vertices, triangles, backend=backend) as scene:
        assert np.all(rays.intersect(scene, origins, directions, t_max).triangle == -1)
        assert np.all(rays.occluded(scene, origins, directions, t_max) == 0)


@pytest.mark.parametrize("backend", ["embree", "bvh"])
@pytest.mark.parametrize("transparent", [False, True])
def test_weights_belong_to_corners_1_and_2(backend, transparent):
    with rays.RayScene(ONE, [[0, 1, 2]], transparent=[transparent], backend=backend) as scene:
        hits = rays.intersect(scene, [[0.5, 0.25, 2]], [[0, 0, -4]])
    assert hits.triangle[0] == 0
    assert np.allclose([hits.t[0], hits.u[0], hits.v[0]], [0.5, 0.5, 0.25])


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="vertices that do not exist"):
        rays.RayScene(ONE, [[0, 1, 3]])
    with pytest.raises(ValueError, match="backend 'cuda'"):
        rays.RayScene(ONE, [[0, 1, 2]], backend="cuda")


def test_auto_falls_back_without_embree(monkeypatch):
    def absent():
        raise embree.EmbreeError("the embreex wheel is not installed")

    monkeypatch.setattr(embree, "library", absent)
    with rays.RayScene(ONE, [[0, 1, 2]]) as scene:
        assert scene.backend == "bvh"
        assert rays.intersect(scene, *DOWN).triangle[0] == 0
    with pytest.raises(embree.EmbreeError, match="not installed"):
        rays.RayScene(ONE, [[0, 1, 2]], backend="embree")


def test_absent_wheel_is_named(monkeypatch):
    embree.library.cache_clear()
    monkeypatch.setattr(embree.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(embree.EmbreeError, match="embreex wheel is not installed"):
        embree.library()


def test_embree_errors_are_raised():
    lib = embree.library()
    device = embree.device()
    lib.rtcNewGeometry(device, 99)
    with pytest.raises(embree.EmbreeError, match="Embree error 1: invalid geometry type"):
        embree._check(device)
    embree._check(device)  # reading clears it


def test_arrays_may_go_away():
    """The scene keeps what Embree points at."""
    scenes = [rays.RayScene(ONE.copy(), np.array([[0, 1, 2]]), backend="embree") for _ in range(50)]
    gc.collect()
    assert all(rays.intersect(s, *DOWN).triangle[0] == 0 for s in scenes)
    for s in scenes:
        s.close()


def _soup(n, rng):
    vertices = (rng.random((n, 1, 3)) + 0.05 * rng.normal(size=(n, 3, 3))).reshape(-1, 3).astype(np.float32)
    return vertices, np.arange(3 * n, dtype=np.int32).reshape(-1, 3)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 17, 700])
@pytest.mark.parametrize("alike", [False, True])
def test_bvh_holds_each_triangle_once_inside_its_boxes(n, alike):
    rng = np.random.default_rng(n)
    vertices, triangles = _soup(n, rng)
    if alike:
        triangles[:] = triangles[0]
    parts = partition(vertices, triangles, np.full(n, 31, np.uint8), rng.random(n) < 0.3)
    tables = BvhBackend(vertices, triangles, parts).tables
    found = []
    for root in tables.roots[tables.roots >= 0]:
        stack = [(root, np.full(3, -np.inf), np.full(3, np.inf), 0)]
        while stack:
            node, low, high, depth = stack.pop()
            assert depth < bvh_build.MAX_DEPTH
            for side, at in ((0, bvh_build.LEFT_LOW), (1, bvh_build.RIGHT_LOW)):
                box_low, box_high = tables.nodes[node, at : at + 3], tables.nodes[node, at + 3 : at + 6]
                assert np.all(box_low >= low) and np.all(box_high <= high)
                child, count = tables.words[node, bvh_build.CHILD + side], tables.words[node, bvh_build.COUNT + side]
                if count == 0:
                    stack.append((child, box_low, box_high, depth + 1))
                    continue
                corners = tables.corners[child : child + count].reshape(-1, 3)
                assert np.all(corners >= box_low) and np.all(corners <= box_high)
                found += list(range(child, child + count))
    # A set of a single triangle has it on both sides of its root.
    assert sorted(set(found)) == list(range(n))
    assert sorted(tables.triangle) == list(range(n))
    assert len(found) == n + sum(len(groups) == 1 and groups[0].end - groups[0].begin == 1 for groups in (parts.opaque, parts.cutout))
    assert np.array_equal(tables.corners.reshape(n, 3, 3), vertices[triangles[tables.triangle]])
