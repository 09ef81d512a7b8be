"""The kernels by themselves: shadow rays per second and core beside Embree's own Python binding.

Rows of `lumigate bench kernels`.  Rates of one thread use that thread's CPU time, so that a busy machine
does not bend them; contestants take turns, and the median counts.  Two threads against one can only be
clocked from the wall: there the best run counts.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from ..core.jit import inlined, kernel
from ..core.rays import (
    ALL,
    COHERENT,
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

POINTS, LIGHTS = 131072, 256
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


# Orders of the pairs (point, light): all lights of a point; all points of a light; all lights of 16 points.
PER_POINT, LIGHT_MAJOR, TILES = 0, 1, 2


@inlined
def _pair(k, n_points, n_lights, order):
    if order == PER_POINT:
        return k // n_lights, k % n_lights
    if order == LIGHT_MAJOR:
        return k % n_points, k // n_points
    tile, within = k // (WIDTH * n_lights), k % (WIDTH * n_lights)
    return tile * WIDTH + within % WIDTH, within // WIDTH


@inlined
def _segment(points, lights, order, k):
    a, b = _pair(k, len(points), len(lights), order)
    return shadow_segment(
        points[a, 0], points[a, 1], points[a, 2], points[a, 3], points[a, 4], points[a, 5], points[a, 6],
        lights[b, 0], lights[b, 1], lights[b, 2], lights[b, 3], lights[b, 4], lights[b, 5], lights[b, 6],
    )  # fmt: skip


@kernel
def _segments(points, lights, order, rays):
    """Shadow rays (N M, 6): origins and directions."""
    for k in range(len(rays)):
        rays[k] = _segment(points, lights, order, k)


@kernel
def trace_segments(tables, which, points, lights, order, begin, end, blocked):
    """Shadow rays begin..end-1 of the product points x lights, made and traced in packets: what renderers do."""
    packet = new_packet()
    for first in range(begin, end, WIDTH):
        count = min(WIDTH, end - first)
        for lane in range(count):
            ox, oy, oz, dx, dy, dz = _segment(points, lights, order, first + lane)
            set_ray(packet, lane, ox, oy, oz, dx, dy, dz, np.float32(0.0), np.float32(1.0), SHADOW)
        occluded_packet(tables, which, packet, count)
        for lane in range(count):
            blocked[first + lane] = is_occluded(packet, lane)


@kernel
def trace_segments_singly(tables, points, lights, order, begin, end, blocked):
    """The same rays one at a time."""
    packet = new_packet()
    for k in range(begin, end):
        ox, oy, oz, dx, dy, dz = _segment(points, lights, order, k)
        blocked[k] = occluded1(tables, ALL, packet, ox, oy, oz, dx, dy, dz, np.float32(0.0), np.float32(1.0), SHADOW)


def _take_turns(clock: Callable[[], float], contestants: dict[str, Callable[[], object]], repeats: int, summary=statistics.median):
    """{name: seconds} of the contestants, taking turns, after one round that compiles."""
    seconds: dict[str, list[float]] = {name: [] for name in contestants}
    for turn in range(repeats + 1):
        for name, work in contestants.items():
            start = clock()
            work()
            if turn:
                seconds[name].append(clock() - start)
    return {name: summary(values) for name, values in seconds.items()}


def _row(case: str, value: float, unit: str, peer: float | None = None) -> dict:
    row = {"suite": "kernels", "case": case, "value": value, "unit": unit}
    return row if peer is None else row | {"peer_value": peer, "ratio": value / peer}


def ray_rows(vertices=None, triangles=None, points: int = POINTS, lights: int = LIGHTS, repeats: int = REPEATS) -> list[dict]:
    """Shadow rays between samples of a scene's surfaces (default: `hall()`), `points` x `lights` / 32 of them an order.

    Peers: embreex's `run()` on the same rays, precomputed; for the BVH, our Embree; for 2 threads, 1.
    """
    if vertices is None:
        vertices, triangles = hall()
    p, q = surface_samples(vertices, triangles, points, 1), surface_samples(vertices, triangles, lights, 2)
    p, q = p[morton_order(p[:, :3])], q[morton_order(q[:, :3])]
    few_p, few_q = p[: len(p) // 512 * 512].reshape(-1, 512, 7)[:, :WIDTH].reshape(-1, 7), q[::32]  # whole tiles of neighbours
    cases = (
        ("per point", few_p, q, PER_POINT, ALL),
        ("VPL-major, Morton order", p, few_q, LIGHT_MAJOR, ALL | COHERENT),
        ("16-point tiles", few_p, q, TILES, ALL | COHERENT),
    )
    rows = []
    with RayScene(vertices, triangles, backend="embree") as fast, RayScene(vertices, triangles, backend="bvh") as fallback:
        peer = _embreex_scene(vertices, triangles)
        for name, a, b, order, which in cases:
            rows += _rows_of_order(name, fast.tables, fallback.tables, peer, a, b, order, which, repeats)
    by_case = {row["case"]: row for row in rows}
    tiles, peer_rate = (
        by_case["shadow rays, 16-point tiles: packets against embreex"]["value"],
        by_case["shadow rays, per point: packets against embreex"]["peer_value"],
    )
    return [*rows, _row("shadow rays, 16-point tiles against embreex per point: the same rays", tiles, "Mrays/s/core", peer_rate)]


def _rows_of_order(name, tables, bvh_tables, peer, points, lights, order, which, repeats) -> list[dict]:
    n = len(points) * len(lights)
    rays = np.empty((n, 6), np.float32)
    _segments(points, lights, order, rays)
    origins, directions, t_far = np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:]), np.ones(n, np.float32)
    blocked, other = np.empty(n, np.uint8), np.empty(n, np.uint8)
    seconds = _take_turns(
        time.thread_time,
        {
            "packets": lambda: trace_segments(tables, which, points, lights, order, 0, n, blocked),
            "single rays": lambda: trace_segments_singly(tables, points, lights, order, 0, n, other),
            "BVH packets": lambda: trace_segments(bvh_tables, which, points, lights, order, 0, n, other),
            "embreex": lambda: peer.run(origins, directions, t_far, query="OCCLUDED"),
        },
        repeats,
    )
    rate = {contestant: n / s / 1e6 for contestant, s in seconds.items()}
    differs = np.mean((np.asarray(peer.run(origins, directions, t_far, query="OCCLUDED")) == 0) != blocked)

    def over(threads: int) -> None:
        chunk = -(-n // SCALING_CHUNKS // WIDTH) * WIDTH
        run_chunks(lambda begin, end: trace_segments(tables, which, points, lights, order, begin, end, blocked), n, chunk, threads)

    wall = _take_turns(time.perf_counter, {"1": lambda: over(1), "2": lambda: over(2)}, 2 * repeats, min)
    unit = "Mrays/s/core"
    return [
        _row(f"shadow rays, {name}: packets against embreex", rate["packets"], unit, rate["embreex"]),
        _row(f"shadow rays, {name}: single rays against embreex", rate["single rays"], unit, rate["embreex"]),
        _row(f"shadow rays, {name}: BVH packets against Embree packets", rate["BVH packets"], unit, rate["packets"]),
        _row(f"shadow rays, {name}: share that differs from embreex", float(differs), "1"),
        _row(f"shadow rays, {name}: 2 threads against 1", n / wall["2"] / 1e6, "Mrays/s", n / wall["1"] / 1e6),
    ]


def _embreex_scene(vertices: np.ndarray, triangles: np.ndarray):
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, vertices, triangles)
    return scene
