"""A brute-force path tracer in float64: the oracle of the random scenes, which shares no code with the core.

Every ray is tested against every triangle; paths follow diffuse bounces by the cosine, lamps are sampled one by one, the
world and shining triangles are found by hitting them.  Surfaces are Lambertian and shine on both sides.
"""

from __future__ import annotations

import math

import numpy as np

from ...core.jit import kernel
from ...core.scene import AREA, SPOT, SUN, Scene
from ...core.surfaces.layout import DIFFUSE, EMISSION


@kernel(fast=False)
def _hit(corners, o, d, nearest, farthest, skip):
    """First triangle along the ray -> (index or -1, t) [Moeller & Trumbore 1997]; `skip` is where the ray starts."""
    found = -1
    for i in range(len(corners)):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        ex, ey, ez, fx, fy, fz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
        px, py, pz = d[1] * fz - d[2] * fy, d[2] * fx - d[0] * fz, d[0] * fy - d[1] * fx
        det = ex * px + ey * py + ez * pz
        sx, sy, sz = o[0] - a[0], o[1] - a[1], o[2] - a[2]
        qx, qy, qz = sy * ez - sz * ey, sz * ex - sx * ez, sx * ey - sy * ex
        u = (sx * px + sy * py + sz * pz) / det
        v = (d[0] * qx + d[1] * qy + d[2] * qz) / det
        t = (fx * qx + fy * qy + fz * qz) / det
        if i != skip and u >= 0.0 and v >= 0.0 and u + v <= 1.0 and nearest < t < farthest:
            found, farthest = i, t
    return found, farthest


@kernel(fast=False)
def _lamp_light(corners, lamp, x, n, skip, nearest, rng):
    """Irradiance at x with normal n by one shadow ray to a random point of one lamp (a row of `_lamp_rows`)."""
    kind, position, axis = int(lamp[0]), lamp[1:4], lamp[4:7]
    strength = 1.0
    if kind == SUN:
        d, far = -axis, np.inf
    else:
        target = position + (rng.random() - 0.5) * lamp[7:10] + (rng.random() - 0.5) * lamp[10:13]
        d = target - x
        far = math.sqrt(np.dot(d, d))
        d = d / far
        strength /= far * far
        aside = -np.dot(d, axis)  # cosine off the lamp's axis
        if kind == AREA:
            strength *= max(0.0, aside) * lamp[13]
        elif kind == SPOT:
            s = min(1.0, max(0.0, (aside - lamp[14]) / max(lamp[15] - lamp[14], 1e-300)))
            strength *= s * s * (3.0 - 2.0 * s) if lamp[15] > lamp[14] else (1.0 if aside >= lamp[14] else 0.0)
    cosine = np.dot(n, d)
    if cosine <= 0.0 or strength <= 0.0 or _hit(corners, x, d, nearest, far * (1.0 - 1e-9), skip)[0] >= 0:
        return 0.0
    return strength * cosine


@kernel(fast=False)
def _trace(corners, albedo, emission, lamps, power, world, matrix, window, orthographic, clip, nearest, bounces, paths, rng, out):
    """out (paths, 2): mean of the channels of Direct and Indirect radiance, of paths through random points of the film."""
    for path in range(paths):
        wx = window[0] + (window[1] - window[0]) * rng.random()
        wy = window[2] + (window[3] - window[2]) * rng.random()
        o, d = matrix[:, 3].copy(), -matrix[:, 2].copy()
        if orthographic:
            o += wx * matrix[:, 0] + wy * matrix[:, 1]
        else:
            d += wx * matrix[:, 0] + wy * matrix[:, 1]
        slant = math.sqrt(np.dot(d, d))
        d /= slant
        at, t = _hit(corners, o, d, clip[0] * slant, clip[1] * slant, -1)
        through = np.ones(3)
        for scattered in range(bounces + 1):
            if at < 0:
                break
            o = o + t * d
            n = np.cross(corners[at, 1] - corners[at, 0], corners[at, 2] - corners[at, 0])
            n /= math.sqrt(np.dot(n, n))
            if np.dot(n, d) > 0.0:
                n = -n
            through *= albedo[at]
            layer = min(scattered, 1)
            for k in range(len(lamps)):
                out[path, layer] += _lamp_light(corners, lamps[k], o, n, at, nearest, rng) / math.pi * np.dot(through, power[k]) / 3.0
            radius, phi = math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
            helper = np.array([1.0, 0.0, 0.0]) if abs(n[0]) < 0.5 else np.array([0.0, 1.0, 0.0])
            tangent = np.cross(helper, n)
            tangent /= math.sqrt(np.dot(tangent, tangent))
            along = radius * (math.cos(phi) * tangent + math.sin(phi) * np.cross(n, tangent))
            d = along + math.sqrt(1.0 - radius * radius) * n
            at, t = _hit(corners, o, d, nearest, np.inf, at)
            out[path, layer] += np.dot(through, world if at < 0 else emission[at]) / 3.0


def _lamp_rows(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(L, 16) kind, position, axis, two edges, area, cosines of a spot's outer and inner cone; (L, 3) emission."""
    lamps = scene.lamps
    rows = np.zeros((len(lamps), 16))
    for row, k in zip(rows, range(len(lamps))):
        row[0], row[1:4], row[4:7] = lamps.kind[k], lamps.position[k], -lamps.axes[k, 2].astype(np.float64)
        if lamps.kind[k] == AREA:
            row[7:10], row[10:13] = lamps.axes[k, 0] * lamps.size[k, 0], lamps.axes[k, 1] * lamps.size[k, 1]
            row[13] = np.prod(lamps.size[k], dtype=np.float64)
        elif lamps.kind[k] == SPOT:
            row[14] = math.cos(lamps.angle[k] / 2)
            row[15] = row[14] + (1 - row[14]) * lamps.blend[k]
    return rows, lamps.emission.astype(np.float64)


def path_traced(scene: Scene, bounces: int, paths: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean Direct and Indirect radiance of a picture (mean of the channels) and their variances, (2,) each.

    scene: constant diffuse materials, lamps without radius, one world colour; triangles of no area are left out.
    """
    g, tables = scene.geometry, scene.materials.tables
    corners = g.vertices.astype(np.float64)[g.triangles]
    solid = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 0
    surface = tables.constant[g.material[solid]].astype(np.float64)
    lamps, power = _lamp_rows(scene)
    camera = scene.camera
    out = np.zeros((paths, 2))
    _trace(
        np.ascontiguousarray(corners[solid]), surface[:, DIFFUSE : DIFFUSE + 3].copy(), surface[:, EMISSION : EMISSION + 3].copy(),
        lamps, power, scene.world.radiance[0, 0].astype(np.float64), np.ascontiguousarray(camera.matrix[:3]),
        np.array(camera.window, float), camera.orthographic, np.array([camera.near, camera.far]),
        1e-7 * float(np.ptp(corners[solid], axis=(0, 1)).max()), bounces, paths, np.random.default_rng(seed), out,
    )  # fmt: skip
    return out.mean(axis=0), out.var(axis=0) / paths
