"""Rays that leave surfaces: none meets its own triangle, none leaks, from 1 mm models to 10 km terrains."""

import numpy as np
import pytest

from lumigate.core import rays
from lumigate.core.jit import kernel
from lumigate.core.rays.offsets import UNIT_ROUNDOFF

BACKENDS = ("embree", "bvh")
FREE, LEAK, SELF = 0, 1, 2


@kernel
def _points(vertices, triangles, triangle, u, v, out):
    for k in range(len(triangle)):
        out[k] = rays.hit_point(vertices, triangles, triangle[k], u[k], v[k])


@kernel
def _leave(tables, points, triangle, directions, answer):
    """Trace a ray off every point: what does it meet?"""
    packet = rays.new_packet()
    for k in range(len(points)):
        p, d = points[k], directions[k]
        ox, oy, oz = rays.offset_origin(p[0], p[1], p[2], p[3], p[4], p[5], p[6], d[0], d[1], d[2])
        zero, infinity = np.float32(0.0), np.float32(np.inf)
        hit, _, _, _ = rays.intersect1(tables, rays.ALL, packet, ox, oy, oz, d[0], d[1], d[2], zero, infinity, 31)
        answer[k] = LEAK if hit < 0 else (SELF if hit == triangle[k] else FREE)


@kernel
def _connect(tables, p, q, answer):
    """Whether anything lies between the points of each pair."""
    packet = rays.new_packet()
    for k in range(len(p)):
        a, b = p[k], q[k]
        ox, oy, oz, dx, dy, dz = rays.shadow_segment(a[0], a[1], a[2], a[3], a[4], a[5], a[6], b[0], b[1], b[2], b[3], b[4], b[5], b[6])
        answer[k] = rays.occluded1(tables, rays.ALL, packet, ox, oy, oz, dx, dy, dz, np.float32(0.0), np.float32(1.0), 31)


def _samples(vertices, triangles, n, rng):
    """(triangle, u, v, points (n, 7)): a third of the weights hug an edge or a corner."""
    triangle = rng.integers(0, len(triangles), n)
    u, v = rng.random((2, n)).astype(np.float32)
    u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])
    for w in (u, v):
        near = rng.random(n) < 0.2
        w[near] *= 10.0 ** rng.uniform(-8, 0, near.sum())
    points = np.empty((n, 7), np.float32)
    _points(vertices, triangles, triangle, u, v, points)
    return triangle, u, v, points


def _directions(normal, rng):
    """Directions on the side of the normals, some grazing."""
    d = rng.normal(size=normal.shape)
    cosine = (d * normal).sum(1, keepdims=True)
    d += normal * (np.abs(cosine) - cosine)
    grazing = rng.random((len(d), 1)) < 0.3
    d -= np.where(grazing, 0.999, 0) * normal * np.abs(cosine)
    return d.astype(np.float32)


def _room(scale, offset, steps, rng):
    """A closed, turned box of scale x 0.7 scale x 0.4 scale, normals inwards, its walls of steps x steps quads."""
    s = np.linspace(-0.5, 0.5, steps + 1)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(steps), np.arange(steps), indexing="ij"))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    vertices, triangles = [], []
    index = {}
    for axis in range(3):
        for side in (-0.5, 0.5):
            corners = []
            for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)):
                p = np.empty((len(i), 3))
                p[:, axis], p[:, (axis + 1) % 3], p[:, (axis + 2) % 3] = side, s[i + di], s[j + dj]
                corners.append([index.setdefault(tuple(x), len(index)) for x in p.tolist()])
            a, b, c, d = np.array(corners if side < 0 else corners[::-1])
            triangles += [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    vertices = np.array(list(index)) * [scale, 0.7 * scale, 0.4 * scale] @ turn.T + offset
    return vertices.astype(np.float32), np.concatenate(triangles).astype(np.int32)


ROOMS = [(1e-3, 0.0, 1), (1e-3, 100.0, 3), (1.0, 0.0, 5), (10.0, 1.0, 2), (10.0, 100.0, 1), (1e4, 1.0, 4), (1e4, 100.0, 2), (1.0, 1e4, 1)]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("scale", "away", "steps"), ROOMS)
def test_closed_room_keeps_its_rays(backend, scale, away, steps):
    rng = np.random.default_rng(11)
    offset = rng.normal(size=3)
    offset *= away * scale / np.linalg.norm(offset)
    vertices, triangles = _room(scale, offset, steps, rng)
    n = 30000
    with rays.RayScene(vertices, triangles, backend=backend) as scene:
        triangle, _, _, points = _samples(vertices, triangles, n, rng)
        answer = np.empty(n, np.int32)
        _leave(scene.tables, points, triangle, _directions(points[:, 3:6].astype(np.float64), rng), answer)
        assert np.all(answer == FREE), np.bincount(answer, minlength=3)

        other = rng.permutation(n)
        q = points[other]
        blocked = np.empty(n, np.uint8)
        _connect(scene.tables, points, q, blocked)
    # A room is convex: points see each other where both are in front of the other's wall by more than rounding.
    d = q[:, :3].astype(np.float64) - points[:, :3]
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-30)
    facing = ((d * points[:, 3:6]).sum(1) > 1e-2) & ((d * q[:, 3:6]).sum(1) < -1e-2)
    assert facing.mean() > 0.5
    assert not np.any(blocked[facing])


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("scale", "away"), [(1e-3, 0.0), (10.0, 0.5), (1e4, 0.5), (10.0, 10.0)])
def test_no_leak_through_a_wall_of_a_ten_thousandth(backend, scale, away):
    """Between two parallel walls 1e-4 of the room apart, rays from the outer side never see the inner room."""
    rng = np.random.default_rng(12)
    offset = rng.normal(size=3) * away * scale
    inner, triangles = _room(scale, offset, 2, rng)
    middle = inner.astype(np.float64).mean(axis=0)
    outer = ((inner - middle) * (1 + 1e-4 * 5) + middle).astype(np.float32)  # the closest walls are .4 / 2 away
    vertices = np.concatenate([inner, outer])
    both = np.concatenate([triangles, triangles + len(inner)]).astype(np.int32)
    n = 20000
    with rays.RayScene(vertices, both, backend=backend) as scene:
        triangle, _, _, points = _samples(vertices, both, n, rng)
        on_outer = triangle >= len(triangles)
        # Inner surface: rays to the inside never meet the outer shell.
        answer = np.empty(n, np.int32)
        normal = points[:, 3:6].astype(np.float64)
        directions = _directions(normal, rng)
        _leave(scene.tables, points, triangle, directions, answer)
        assert np.all(answer == FREE)
        ox = points[:, :3] + points[:, 6:7] * points[:, 3:6]
        hits = rays.intersect(scene, ox[~on_outer], directions[~on_outer])
        assert np.all(hits.triangle < len(triangles))
        # Outer surface, looking in: the inner shell is in the way of every ray to the room's middle.
        to_middle = (middle - ox[on_outer]).astype(np.float32)
        assert np.all(rays.occluded(scene, ox[on_outer], to_middle) == 1)


@pytest.mark.parametrize("backend", BACKENDS)
def test_slender_triangles_do_not_shadow_themselves(backend):
    """Aspects up to 1:1000, whose planes intersectors know less well."""
    rng = np.random.default_rng(13)
    n = 300
    along, across = rng.normal(size=(2, n, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across -= along * (along * across).sum(1, keepdims=True)
    across /= np.linalg.norm(across, axis=1, keepdims=True) * 10.0 ** rng.uniform(0, 3, (n, 1))
    base = 10 * rng.random((n, 3))
    corners = np.stack([base, base + along, base + rng.random((n, 1)) * along + across], 1)
    vertices = corners.reshape(-1, 3).astype(np.float32)
    triangles = np.arange(3 * n, dtype=np.int32).reshape(-1, 3)
    with rays.RayScene(vertices, triangles, backend=backend) as scene:
        triangle, _, _, points = _samples(vertices, triangles, 60000, rng)
        for side in (1, -1):
            answer = np.empty(len(points), np.int32)
            _leave(scene.tables, points, triangle, _directions(side * points[:, 3:6].astype(np.float64), rng), answer)
            assert not np.any(answer == SELF)


def test_hit_point_stays_within_its_error():
    rng = np.random.default_rng(14)
    vertices = (100 * rng.normal(size=(300, 3)) + 3 * rng.normal(size=(300, 3))).astype(np.float32)
    triangles = rng.permutation(300).reshape(-1, 3).astype(np.int32)
    triangle, u, v, points = _samples(vertices, triangles, 20000, rng)
    a, b, c = (vertices[triangles[triangle, k]].astype(np.float64) for k in range(3))
    exact_normal = np.cross(b - a, c - a)
    exact_normal /= np.linalg.norm(exact_normal, axis=1, keepdims=True)
    assert np.allclose(points[:, 3:6], exact_normal, atol=2e-7)
    error = points[:, 6].astype(np.float64)
    distance = np.abs(((points[:, :3] - a) * exact_normal).sum(1))
    assert np.all(distance < error)
    # And the radius is no pessimist: a few roundings of the largest coordinates, more only in slender triangles.
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    edge = np.sqrt(np.maximum(np.maximum(((b - a) ** 2).sum(1), ((c - a) ** 2).sum(1)), ((c - b) ** 2).sum(1)))
    size = np.abs(vertices).max() + edge * edge**2 / area
    assert np.all(error < 12 * UNIT_ROUNDOFF * size * np.sqrt(3))
    # Away from the edges the point is where the weights say, to an ulp.
    inside = np.minimum(np.minimum(u, v), 1 - u.astype(np.float64) - v) > 0.05
    exact = a + u[:, None].astype(np.float64) * (b - a) + v[:, None].astype(np.float64) * (c - a)
    assert np.allclose(points[inside, :3], exact[inside], rtol=1e-7, atol=1e-6)


def test_hit_point_without_area_has_no_normal():
    vertices = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2]], np.float32)
    points = np.empty((1, 7), np.float32)
    half = np.array([0.5], np.float32)
    _points(vertices, np.array([[0, 1, 2]], np.int32), np.zeros(1, np.int64), half, np.zeros(1, np.float32), points)
    assert np.all(np.isfinite(points)) and np.all(points[0, 3:6] == 0)
    assert np.allclose(points[0, :3], 0.5)
