"""The kernels by themselves: shadow rays per second and core beside Embree's own Python binding.

Rows of `lumigate bench kernels`.  Rates of one thread use that thread's CPU time, so that a busy machine
does not bend them; contestants take turns, and the median counts.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from ..core.jit import kernel
from ..core.rays import (
    ALL,
    WIDTH,
    RayScene,
    hit_point,
    is_occluded,
    morton_order,
    new_packet,
    occluded1,
    occluded_packet,
    set_ray,
    shadow_segment,
)
from ..core.scene import SHADOW
from ..core.threads import run_chunks

POINTS, LIGHTS = 8192, 64
REPEATS = 5
SCALING_CHUNKS = 32


def hall(columns: int = 8, sphere_rings: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """(vertices, triangles) of a room of 20 x 12 x 6 m with two colonnades and spheres between (about 75k triangles)."""
    parts: list[tuple[np.ndarray, np.ndarray]] = []

    def add_grid(points: np.ndarray) -> None:
        rows, cols = points.shape[:2]
        i, j = np.meshgrid(np.arange(rows - 1), np.arange(cols - 1), indexing="ij")
        a = (i * cols + j).ravel()
        parts.append(
            (points.reshape(-1, 3), np.concatenate([np.stack([a, a + cols, a + 1], 1), np.stack([a + 1, a + cols, a + cols + 1], 1)]))
        )

    s, t = np.meshgrid(np.linspace(0, 1, 33), np.linspace(0, 1, 33), indexing="ij")
    size = np.array([20.0, 12.0, 6.0])
    for axis in range(3):
        for side in range(2):
            points = np.empty((33, 33, 3))
            points[..., axis], points[..., (axis + 1) % 3], points[..., (axis + 2) % 3] = side, s, t
            add_grid(points * size)
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 33), np.linspace(0, 1, 25), indexing="ij")
    polar, turn = np.meshgrid(np.linspace(0, np.pi, sphere_rings + 1), np.linspace(0, 2 * np.pi, 2 * sphere_rings + 1), indexing="ij")
    ball = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], -1)
    for k in range(columns):
        x = 20.0 * (k + 0.5) / columns
        for y in (3.0, 9.0):
            radius = 0.35 + 0.05 * np.cos(9 * angle)
            add_grid(np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), 6.0 * height], -1))
            add_grid(ball * 0.5 + [x + 0.8, y, 0.5])
            add_grid(ball * 0.2 + [x, 6.0, 1.0 + 0.4 * (k % 3)])
    vertices = np.concatenate([v for v, _ in parts]).astype(np.float32)
    starts = np.cumsum([0] + [len(v) for v, _ in parts[:-1]])
    return vertices, np.concatenate([t + b for b, (_, t) in zip(starts, parts)]).astype(np.int32)


@kernel
def _surface_samples(vertices, triangles, picks, uv, out):
    """Points, normals and error radii on the picked triangles: out (N, 7)."""
    for k in range(len(picks)):
        u, v = uv[k, 0], uv[k, 1]
        if u + v > 1:
            u, v = 1 - u, 1 - v
        out[k] = hit_point(vertices, triangles, picks[k], u, v)


def surface_samples(vertices, triangles, n: int, seed: int) -> np.ndarray:
    """(n, 7) float32 x, y, z, nx, ny, nz, error, uniform by area."""
    rng = np.random.default_rng(seed)
    corner = vertices[triangles].astype(np.float64)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    picks = rng.choice(len(triangles), n, p=area / area.sum())
    out = np.empty((n, 7), np.float32)
    _surface_samples(vertices, triangles, picks, rng.random((n, 2)), out)
    return out


@kernel
def _segments(points, lights, lights_outside, rays):
    """Shadow rays (N M, 6), the loop over lights outside or inside."""
    n, m = len(points), len(lights)
    for k in range(n * m):
        p, q = (points[k % n], lights[k // n]) if lights_outside else (points[k // m], lights[k % m])
        rays[k] = shadow_segment(p[0], p[1], p[2], p[3], p[4], p[5], p[6], q[0], q[1], q[2], q[3], q[4], q[5], q[6])


@kernel
def trace_segments(tables, points, lights, lights_outside, begin, end, blocked):
    """Shadow rays begin..end-1 of the product points x lights, made and traced in packets: what renderers do."""
    n, m = len(points), len(lights)
    packet = new_packet()
    for first in range(begin, end, WIDTH):
        count = min(WIDTH, end - first)
        for lane in range(count):
            k = first + lane
            p, q = (points[k % n], lights[k // n]) if lights_outside else (points[k // m], lights[k % m])
            ox, oy, oz, dx, dy, dz = shadow_segment(p[0], p[1], p[2], p[3], p[4], p[5], p[6], q[0], q[1], q[2], q[3], q[4], q[5], q[6])
            set_ray(packet, lane, ox, oy, oz, dx, dy, dz, np.float32(0.0), np.float32(1.0), SHADOW)
        occluded_packet(tables, ALL, packet, count)
        for lane in range(count):
            blocked[first + lane] = is_occluded(packet, lane)


@kernel
def trace_segments_singly(tables, points, lights, lights_outside, begin, end, blocked):
    """The same rays one at a time."""
    n, m = len(points), len(lights)
    packet = new_packet()
    for k in range(begin, end):
        p, q = (points[k % n], lights[k // n]) if lights_outside else (points[k // m], lights[k % m])
        ox, oy, oz, dx, dy, dz = shadow_segment(p[0], p[1], p[2], p[3], p[4], p[5], p[6], q[0], q[1], q[2], q[3], q[4], q[5], q[6])
        blocked[k] = occluded1(tables, ALL, packet, ox, oy, oz, dx, dy, dz, np.float32(0.0), np.float32(1.0), SHADOW)


def _medians(clock: Callable[[], float], contestants: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Median seconds of each contestant, taking turns, after one round that compiles."""
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for turn in range(repeats + 1):
        for name, work in contestants.items():
            start = clock()
            work()
            if turn:
                seconds[name].append(clock() - start)
    return {name: statistics.median(values) for name, values in seconds.items()}


def _row(case: str, value: float, unit: str, peer: float | None = None) -> dict:
    row = {"suite": "kernels", "case": case, "value": value, "unit": unit}
    return row if peer is None else row | {"peer_value": peer, "ratio": value / peer}


def ray_rows(vertices=None, triangles=None, points: int = POINTS, lights: int = LIGHTS, repeats: int = REPEATS) -> list[dict]:
    """Shadow rays of `points` x `lights` samples on a scene's surfaces (default: `hall()`).

    Peers: embreex's `run()` on the same rays, precomputed; for the BVH, our Embree; for 2 threads, 1.
    """
    if vertices is None:
        vertices, triangles = hall()
    p, q = surface_samples(vertices, triangles, points, 1), surface_samples(vertices, triangles, lights, 2)
    sorted_p = p[morton_order(p[:, :3])]
    n = points * lights
    rows = []
    with RayScene(vertices, triangles, backend="embree") as fast, RayScene(vertices, triangles, backend="bvh") as fallback:
        peer = _embreex_scene(vertices, triangles)
        for order, those, outside in (("per point", p, False), ("VPL-major, Morton order", sorted_p, True)):
            rays = np.empty((n, 6), np.float32)
            _segments(those, q, outside, rays)
            origins, directions, t_far = np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:]), np.ones(n, np.float32)
            blocked = {name: np.empty(n, np.uint8) for name in ("embree", "bvh", "embree singly", "bvh singly")}
            seconds = _medians(
                time.thread_time,
                {
                    "embree": lambda: trace_segments(fast.tables, those, q, outside, 0, n, blocked["embree"]),
                    "bvh": lambda: trace_segments(fallback.tables, those, q, outside, 0, n, blocked["bvh"]),
                    "embree singly": lambda: trace_segments_singly(fast.tables, those, q, outside, 0, n, blocked["embree singly"]),
                    "bvh singly": lambda: trace_segments_singly(fallback.tables, those, q, outside, 0, n, blocked["bvh singly"]),
                    "embreex": lambda: peer.run(origins, directions, t_far, query="OCCLUDED"),
                },
                repeats,
            )
            expected = np.asarray(peer.run(origins, directions, t_far, query="OCCLUDED")) == 0
            rate = {name: n / s / 1e6 for name, s in seconds.items()}
            rows += [
                _row(f"shadow rays, {order}: packets against embreex run()", rate["embree"], "Mrays/s/core", rate["embreex"]),
                _row(f"shadow rays, {order}: single rays against embreex run()", rate["embree singly"], "Mrays/s/core", rate["embreex"]),
                _row(f"shadow rays, {order}: BVH packets against Embree packets", rate["bvh"], "Mrays/s/core", rate["embree"]),
                _row(f"shadow rays, {order}: BVH single rays against Embree packets", rate["bvh singly"], "Mrays/s/core", rate["embree"]),
                _row(f"shadow rays, {order}: share that differs from embreex", float(np.mean(blocked["embree"] != expected)), "1"),
            ]

            def over(threads: int, those=those, outside=outside, out=blocked["embree"]) -> None:
                run_chunks(lambda b, e: trace_segments(fast.tables, those, q, outside, b, e, out), n, -(-n // SCALING_CHUNKS), threads)

            wall = _medians(time.perf_counter, {"1": lambda: over(1), "2": lambda: over(2)}, repeats)
            rows.append(_row(f"shadow rays, {order}: 2 threads against 1", n / wall["2"] / 1e6, "Mrays/s", n / wall["1"] / 1e6))
    return rows


def _embreex_scene(vertices: np.ndarray, triangles: np.ndarray):
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, vertices, triangles)
    return scene
