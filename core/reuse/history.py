"""Light of earlier frames, reprojected onto the present one and averaged before the denoiser.

A pixel of the present frame is looked for where its surface lay in each of the earlier frames.  What is found there counts only
where it is the same object, in the same plane, turned the same way.  Only estimates as they were computed are taken, never
averages of averages: a picture depends on the last few frames and on nothing before them, so that a sequence may be begun
anywhere (a farm's worker, a resumed job) with the same bits.

Where the light has changed, too, an earlier frame is worth as much as its error says: with the noise variance s2 of one frame and
the squared bias b2, estimated from the mean difference of a neighbourhood, its weight is s2 / (s2 + b2) of the present one's
(the weights of least squared error for independent estimates).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from ..jit import inlined, kernel
from ..picture import Picture
from ..scene import Scene
from ..threads import run_chunks
from ..view.camera import CameraTables, camera_tables

SAME_NORMAL = np.float32(0.5)  # cosine
SAME_PLANE = np.float32(2.0)  # pixel widths by which a point may leave the other's plane: mouldings smaller than a pixel do
SAME_REACH = np.float32(4.0)  # pixel widths by which it may lie apart: a surface seen at a slant spreads
LEAST_COVERAGE = np.float32(0.05)  # of the four pixels around, below which nothing is found
NEIGHBOURHOOD = 9  # pixels along a side
ROWS = 16  # a chunk
DIFFUSE, GLOSSY = slice(0, 3), slice(3, 6)  # channels of `Estimate.light`
_0 = np.float32(0.0)
_1 = np.float32(1.0)


class Guide(NamedTuple):
    """What tells pixels apart: camera, positions and normals (H, W, 3), depth (H, W), objects (H, W) int32, 0 where there is none."""

    camera: CameraTables
    position: np.ndarray
    normal: np.ndarray
    depth: np.ndarray
    surface: np.ndarray


@dataclass(frozen=True)
class Estimate:
    """What one frame found by itself.

    light: (H, W, 6) float32, indirect irradiance (W/m^2), and radiance by reflections.  lit: a number that changes with anything
    but the camera.  seen: one that changes with the camera, too.  vertices: (V, 3) of the scene at that time; origin: (3,) float64.
    """

    light: np.ndarray
    guide: Guide
    triangle: np.ndarray
    vertices: np.ndarray
    triangles: np.ndarray
    origin: np.ndarray
    lit: int
    seen: int

    @staticmethod
    def of(picture: Picture, scene: Scene, lit: int, seen: int) -> Estimate:
        """The estimate that a picture is, `picture.triangle` given."""
        geometry = scene.geometry
        names = np.array([zlib.crc32(name.encode()) & 0x7FFFFFFF | 1 for name in geometry.object_names] + [0], np.int64)
        surface = names[np.where(picture.triangle >= 0, geometry.object[picture.triangle], -1)].astype(np.int32)
        light = np.concatenate([picture.irradiance, picture.glossy_indirect], axis=2)
        guide = Guide(camera_tables(scene.camera), picture.position, picture.normal, picture.depth, surface)
        return Estimate(light, guide, picture.triangle, geometry.vertices, geometry.triangles, scene.origin, lit, seen)


@inlined
def _project(camera, x, y, z):
    """Image position in pixels of the full frame (x, y), and whether the place lies before the camera."""
    m = camera.matrix
    dx, dy, dz = x - m[0, 3], y - m[1, 3], z - m[2, 3]
    cx = dx * m[0, 0] + dy * m[1, 0] + dz * m[2, 0]
    cy = dx * m[0, 1] + dy * m[1, 1] + dz * m[2, 1]
    depth = -(dx * m[0, 2] + dy * m[1, 2] + dz * m[2, 2])
    if camera.panorama:
        away = np.float32(np.sqrt(cx * cx + cy * cy + depth * depth))
        if not away > camera.clip[0]:
            return _0, _0, False
        cx, cy = np.float32(np.arctan2(cx, depth)), np.float32(np.arcsin(min(_1, max(-_1, cy / away))))
    elif not camera.orthographic:
        if not depth > camera.clip[0]:
            return _0, _0, False
        cx, cy = cx / depth, cy / depth
    w = camera.window
    u = (cx - w[0]) / (w[1] - w[0]) * np.float32(camera.size[0])
    v = (cy - w[3]) / (w[2] - w[3]) * np.float32(camera.size[1])
    return u, v, True


@inlined
def _slant(camera, position, nx, ny, nz):
    """|cosine| of a surface's normal n with the depth that a camera counts there."""
    if not camera.panorama:
        return abs(nx * camera.matrix[0, 2] + ny * camera.matrix[1, 2] + nz * camera.matrix[2, 2])
    dx, dy, dz = position[0] - camera.matrix[0, 3], position[1] - camera.matrix[1, 3], position[2] - camera.matrix[2, 3]
    return abs(nx * dx + ny * dy + nz * dz) / max(np.float32(np.sqrt(dx * dx + dy * dy + dz * dz)), np.float32(1e-20))


@inlined
def _pixel_width(camera, depth):
    width = abs(camera.window[1] - camera.window[0]) / np.float32(camera.size[0])
    return width if camera.orthographic else width * depth


@kernel
def _reproject_rows(now, before, light, was, moved, begin, end, out, coverage):
    """Light (H, W, C) of an earlier frame at the pixels of rows begin..end-1, and how much of the four taps around was theirs.

    The light is that of the nearest such tap, not of the mean of all: noise that neighbouring pixels share stays through a denoiser.

    was: (H, W, 3), where the pixels' surfaces lay at that time, relative to its origin.  moved: (H, W), where that is elsewhere.
    """
    height, width, channels = light.shape
    x0, y0 = now.camera.border[0], now.camera.border[1]
    for y in range(begin, end):
        for x in range(width):
            coverage[y, x] = _0
            out[y, x, :] = _0
            if now.surface[y, x] == 0:
                continue
            px, py, pz = was[y, x, 0], was[y, x, 1], was[y, x, 2]
            u, v, ahead = _project(now.camera, now.position[y, x, 0], now.position[y, x, 1], now.position[y, x, 2])
            s, t, there = _project(before.camera, px, py, pz)
            if not (ahead and there):
                continue
            # The way of the pixel's middle: with a camera at rest it is found again exactly, wherever in it the surface was met.
            fx, fy = np.float32(x) + (s - u), np.float32(y) + (t - v)
            fx += np.float32(x0 - before.camera.border[0])
            fy += np.float32(y0 - before.camera.border[1])
            if not (fx > -_1 and fy > -_1 and fx < np.float32(width) and fy < np.float32(height)):
                continue
            ix, iy = int(np.floor(fx)), int(np.floor(fy))
            fx, fy = fx - np.float32(ix), fy - np.float32(iy)
            nx, ny, nz = now.normal[y, x, 0], now.normal[y, x, 1], now.normal[y, x, 2]
            total, most, best_x, best_y = _0, _0, 0, 0
            for k in range(4):
                tx, ty = ix + (k & 1), iy + (k >> 1)
                weight = (fx if k & 1 else _1 - fx) * (fy if k >> 1 else _1 - fy)
                if not weight > _0 or tx < 0 or ty < 0 or tx >= width or ty >= height:
                    continue
                if before.surface[ty, tx] != now.surface[y, x]:
                    continue
                mx, my, mz = before.normal[ty, tx, 0], before.normal[ty, tx, 1], before.normal[ty, tx, 2]
                if not moved[y, x] and nx * mx + ny * my + nz * mz < SAME_NORMAL:
                    continue
                dx, dy, dz = before.position[ty, tx, 0] - px, before.position[ty, tx, 1] - py, before.position[ty, tx, 2] - pz
                pixel = _pixel_width(before.camera, before.depth[ty, tx]) + _pixel_width(now.camera, now.depth[y, x])
                if abs(dx * mx + dy * my + dz * mz) > SAME_PLANE * pixel:
                    continue
                reach = SAME_REACH * pixel
                slant = _slant(before.camera, before.position[ty, tx], mx, my, mz)
                if (dx * dx + dy * dy + dz * dz) * max(slant, np.float32(0.1)) > reach * reach:
                    continue
                total += weight
                if weight > most:
                    most, best_x, best_y = weight, tx, ty
            if total > LEAST_COVERAGE:
                coverage[y, x] = total
                for c in range(channels):
                    out[y, x, c] = light[best_y, best_x, c]


def positions_at(estimate: Estimate, now: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Where the surfaces of the pixels of `now` lay in an earlier frame, (H, W, 3) relative to its origin; which were elsewhere (H, W).

    Moving and deforming meshes are followed by their triangles, as long as these have the same corners.
    """
    shift = (now.origin - estimate.origin).astype(np.float32)
    position, moved = now.guide.position + shift, np.zeros(now.triangle.shape, bool)
    same_mesh = now.triangles is estimate.triangles or np.array_equal(now.triangles, estimate.triangles)
    if now.vertices is estimate.vertices or not same_mesh or now.vertices.shape != estimate.vertices.shape:
        return position, moved
    rows, columns = np.nonzero(now.triangle >= 0)
    corners = now.triangles[now.triangle[rows, columns]]
    then, here = estimate.vertices[corners].astype(np.float64), now.vertices[corners].astype(np.float64) + shift
    elsewhere = (np.abs(then - here) > 1e-6 * (1 + np.abs(here))).any(axis=(1, 2))
    rows, columns, then, here = (a[elsewhere] for a in (rows, columns, then, here))
    u, v = _barycentric(here, position[rows, columns])
    position[rows, columns] = then[:, 0] + u[:, None] * (then[:, 1] - then[:, 0]) + v[:, None] * (then[:, 2] - then[:, 0])
    moved[rows, columns] = True
    return position, moved


def _barycentric(corners: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of corners 1 and 2 of the triangles (N, 3, 3) at positions (N, 3) in their planes."""
    e, f, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], position - corners[:, 0]
    ee, ef, ff, pe, pf = ((a * b).sum(axis=1) for a, b in ((e, e), (e, f), (f, f), (p, e), (p, f)))
    area = np.maximum(ee * ff - ef * ef, 1e-30)
    return (ff * pe - ef * pf) / area, (ee * pf - ef * pe) / area


def reproject(before: Estimate, now: Estimate, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """Light (H, W, 6) of an earlier frame at the pixels of `now`, and its coverage (H, W), 0 where the surface was not seen."""
    was, moved = positions_at(before, now)
    out, coverage = np.empty_like(now.light), np.empty(now.triangle.shape, np.float32)

    def work(begin: int, end: int) -> None:
        _reproject_rows(now.guide, before.guide, before.light, was.astype(np.float32), moved, begin, end, out, coverage)

    run_chunks(work, len(out), ROWS, threads)
    return out, coverage


def trust(now: np.ndarray, earlier: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """Weight (H, W) of an earlier frame's light (H, W, 3) beside the present one's, where the light itself may have changed."""
    known = (coverage > 0).astype(np.float64)
    difference = known * (now.astype(np.float64) - earlier).mean(axis=2)
    count, mean, square = (scipy.ndimage.uniform_filter(a, NEIGHBOURHOOD, mode="constant") for a in (known, difference, difference**2))
    count = np.maximum(count, 1e-9)
    mean, square = mean / count, square / count
    variance = np.maximum(square - mean**2, 0)
    bias = np.maximum(mean**2 - variance / np.maximum(count * NEIGHBOURHOOD**2, 1), 0)
    noise = 0.5 * variance
    return np.divide(noise, noise + bias, out=np.zeros_like(noise), where=noise + bias > 0).astype(np.float32)


def averaged(now: Estimate, earlier: list[Estimate], threads: int) -> np.ndarray:
    """Light (H, W, 6) of the present frame and of the earlier ones, by what these are worth; in the order in which they are given."""
    total, weight = now.light.copy(), np.ones((*now.triangle.shape, 2), np.float32)
    for estimate in earlier:
        if estimate.light.shape != now.light.shape:
            continue
        light, coverage = reproject(estimate, now, threads)
        for k, (channels, changed) in enumerate(((DIFFUSE, estimate.lit != now.lit), (GLOSSY, estimate.seen != now.seen))):
            part = coverage * trust(now.light[..., channels], light[..., channels], coverage) if changed else coverage
            total[..., channels] += part[..., None] * light[..., channels]
            weight[..., k] += part
    total[..., DIFFUSE] /= weight[..., :1]
    total[..., GLOSSY] /= weight[..., 1:]
    return total


def with_light(picture: Picture, light: np.ndarray) -> Picture:
    """The picture with other indirect light (H, W, 6): irradiance, and radiance by reflections."""
    diffuse = light[..., DIFFUSE] * picture.albedo * np.float32(1 / np.pi)
    smooth = None if picture.smooth is None else diffuse
    return replace(picture, diffuse_indirect=diffuse, glossy_indirect=np.ascontiguousarray(light[..., GLOSSY]), smooth=smooth)
