"""What a denoiser blurs where a pixel shows several surfaces: told by the light of its shading points, and given back.

A denoiser sees the mean of a pixel.  In foliage, mouldings and far detail it takes what differs from surface to surface for noise.  The
shading points know better: points nearby with about the same normal, in about the same plane, get about the same light.  The residual of a
point is its light less what the denoised picture says of it, the denoised ratio of the pixel to what is foreseen times what is foreseen of
the point (`methods.foreseen`).  Residuals are averaged over alike points, as far as the mean stands out from its own noise (James and
Stein's estimator; what would darken also from the noise of points around), and added: an order-two "twicing" (Tukey 1977) of the
denoiser, of points instead of pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from .jit import kernel, leaf
from .references import Reference
from .scene import Camera
from .threads import run_chunks
from .view.points import ShadingPoints, shares

REACH = 4  # pixels to each side, within which points are alike
SPREAD = np.float32(2.0)  # how fast they are less so
LEAST_COSINE = np.float32(0.3)  # of normals that are alike at all
OFF_PLANE, AWAY = np.float32(1.5), np.float32(20.0)  # widths of a pixel off the plane, or away, that count as a step of unlikeness
RATIOS = np.float32(4.0)  # weight of the squared relative difference of the denoised ratios: a shadow's edge is none of the noise
# What is left over in a pixel of a much larger ratio is as much larger, and tells nothing of this one: beside a keyhole, walls would be black.
MUCH_BRIGHTER = np.float32(4.0)
# Part of a residual that is given back: the denoiser has kept some of the noise, which is missing in the residual.
PART = np.float32(0.6)
# Times the variance of a mean of independent points: nearby points share lights, and what their rays hit.  Of few rays, few strong ones are
# most of it: with the lesser factor, quick pictures of the cathedral had dirty ribs.
NOISE, NOISE_OF_FEW = np.float32(2.0), np.float32(4.0)
WHOLE = np.float32(2.0)  # as rays are dealt: points that are half of what their pixel shows, or more, have all rays
MOST_POINTS = 2_000_000  # that are kept of further passes
# Side in pixels of the tiles that tell, with those around them, how noisy points are: where most light comes by few rays, those of a reach are alike
# and too dark until one has found it.  That is no sign of a dark surface: seams of a wall were black smudges.
TILE = 16
LINES = 8  # of pixels a chunk
LEAST_NUMBER = np.float32(1.5)  # of points that tell more than their noise
# Columns of what is known of a point.
NORMAL, POSITION, RESIDUAL, FORESEEN, RAYS, WIDTH, ROW = 0, 3, 6, 9, 10, 11, 12
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_2 = np.float32(2.0)


class PointLight(NamedTuple):
    """The light of N shading points of one pass.

    pixel: (N,) int32.  position (m), normal, albedo, irradiance (W/m^2): (N, 3) float32;  albedo is 0 where the pixel shows all light of the
    point as transmitted light.  foreseen: (N,) float32, W/m^2.  width: (N,) float32, of a pixel there (m).  weight: of the pass.
    """

    pixel: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    irradiance: np.ndarray
    foreseen: np.ndarray
    width: np.ndarray
    weight: float

    @staticmethod
    def of(points: ShadingPoints, irradiance: np.ndarray, foreseen: np.ndarray, camera: Camera, weight: float) -> PointLight:
        """The light (N, 3 G) that a pass has found at its points."""
        across = np.float32(abs(camera.window[1] - camera.window[0]) / camera.width)
        depth = np.float32(1)
        eye, axis = (np.asarray(camera.matrix[:3, k], np.float32) for k in (3, 2))
        if camera.panorama:
            depth = np.linalg.norm(points.position - eye, axis=1)
        elif not camera.orthographic:
            depth = np.abs((points.position - eye) @ axis)
        whole = irradiance if irradiance.shape[1] == 3 else irradiance.reshape(len(irradiance), -1, 3).sum(axis=1)
        albedo = points.albedo * (points.behind_glass == 0)[:, None]
        width = np.broadcast_to(across * depth, foreseen.shape).astype(np.float32)
        return PointLight(points.pixel, points.position, points.ns, albedo, whole, foreseen, width, weight)


def joined(mine: tuple[PointLight, ...], its: tuple[PointLight, ...]) -> tuple[PointLight, ...]:
    """The light of the points of two pictures, of the second one as far as there is room."""
    room = MOST_POINTS - sum(len(light.pixel) for light in mine)
    for light in its:
        if len(light.pixel) <= room:
            mine, room = (*mine, light), room - len(light.pixel)
    return mine


@kernel
def _sort(light, share, ratio, begin, order, rows):
    """The points with a share of their pixels by pixels: pixel k has rows[begin[k]:begin[k + 1]], of the points `order` there.

    ratio: (H W, 3), the denoised ratio of pixels to what is foreseen.  rows: (N, ROW) float32.
    """
    begin[:] = 0
    for i in range(len(share)):
        if share[i] > _0:
            begin[light.pixel[i] + 1] += 1
    for k in range(1, len(begin)):
        begin[k] += begin[k - 1]
    at = begin[:-1].copy()
    for i in range(len(share)):
        if not share[i] > _0:
            continue
        k = light.pixel[i]
        row = rows[at[k]]
        order[at[k]] = i
        at[k] += 1
        for c in range(3):
            row[NORMAL + c], row[POSITION + c] = light.normal[i, c], light.position[i, c]
            row[RESIDUAL + c] = light.irradiance[i, c] - light.foreseen[i] * ratio[k, c]
        row[FORESEEN], row[RAYS], row[WIDTH] = light.foreseen[i], min(WHOLE * share[i], _1), light.width[i]


def _usual_noise(light: PointLight, order: np.ndarray, rows: np.ndarray, ratio: np.ndarray, height: int, width: int) -> np.ndarray:
    """Relative variance of a point's light about what the denoised picture says, for each tile with those around it: (H / TILE, W / TILE) float32."""
    shape = -(-height // TILE), -(-width // TILE)
    pixel = light.pixel[order]
    tile = pixel // width // TILE * shape[1] + pixel % width // TILE
    residual, expected = rows[:, RESIDUAL : RESIDUAL + 3].sum(axis=1), rows[:, FORESEEN] * ratio[pixel].sum(axis=1)
    squares = [np.bincount(tile, rows[:, RAYS] * some * some, shape[0] * shape[1]).reshape(shape) for some in (residual, expected)]
    found, whole = (uniform_filter(some, 3, mode="constant") for some in squares)
    return np.divide(found, whole, out=np.zeros(shape), where=whole > 0).astype(np.float32)


@leaf
def _several(begin, width, height, x, y):
    """Whether the pixel, or one next to it, shows several surfaces."""
    for row in range(max(y - 1, 0), min(y + 2, height)):
        for column in range(max(x - 1, 0), min(x + 2, width)):
            k = row * width + column
            if begin[k + 1] - begin[k] > 1:
                return True
    return False


@leaf
def _mean_residual(begin, rows, ratio, usual, width, height, x, y, p, noisier):
    """The mean residual (r, g, b) of the points alike row p, in the pixel (x, y), by what is foreseen of them, shrunk by `noisier` times its noise.

    usual: of `_usual_noise`, the least noise of a negative mean.
    """
    k = y * width + x
    g = ratio[k, 0] + ratio[k, 1] + ratio[k, 2]
    nx, ny, nz = rows[p, NORMAL], rows[p, NORMAL + 1], rows[p, NORMAL + 2]
    px, py, pz = rows[p, POSITION], rows[p, POSITION + 1], rows[p, POSITION + 2]
    plane, place = _1 / (OFF_PLANE * rows[p, WIDTH]) ** 2, _1 / (AWAY * rows[p, WIDTH]) ** 2
    r0 = r1 = r2 = whole = squares = crossed = foreseen2 = _0
    for row in range(max(y - REACH, 0), min(y + REACH + 1, height)):
        for column in range(max(x - REACH, 0), min(x + REACH + 1, width)):
            k = row * width + column
            if begin[k] == begin[k + 1]:
                continue
            h = ratio[k, 0] + ratio[k, 1] + ratio[k, 2]
            unlike = (h - g) / (h + g + np.float32(1e-20))
            far = SPREAD * np.float32((row - y) * (row - y) + (column - x) * (column - x)) / np.float32(REACH * REACH)
            far += RATIOS * unlike * unlike
            bound = _1 if h <= MUCH_BRIGHTER * g else MUCH_BRIGHTER * g / h
            for q in range(begin[k], begin[k + 1]):
                cosine = nx * rows[q, NORMAL] + ny * rows[q, NORMAL + 1] + nz * rows[q, NORMAL + 2]
                if cosine <= LEAST_COSINE:
                    continue
                ex, ey, ez = rows[q, POSITION] - px, rows[q, POSITION + 1] - py, rows[q, POSITION + 2] - pz
                off = nx * ex + ny * ey + nz * ez
                u = _1 + np.float32(0.5) * (far + plane * off * off + place * (ex * ex + ey * ey + ez * ez))
                cosine *= cosine
                w = bound * bound * cosine * cosine * rows[q, RAYS] / (u * u * u)
                f = w * rows[q, FORESEEN]
                a, b, c = w * rows[q, RESIDUAL], w * rows[q, RESIDUAL + 1], w * rows[q, RESIDUAL + 2]
                r0, r1, r2, whole = r0 + a, r1 + b, r2 + c, whole + f
                r = a + b + c
                squares, crossed, foreseen2 = squares + r * r, crossed + r * f, foreseen2 + f * f
    if not foreseen2 > _0:
        return _0, _0, _0
    number = whole * whole / foreseen2  # Kish's effective number of points
    mean = (r0 + r1 + r2) / whole
    if not number > LEAST_NUMBER or mean == _0:
        return _0, _0, _0
    noise = (squares - _2 * mean * crossed + mean * mean * foreseen2) / (whole * whole) * number / (number - _1)
    noise *= noisier
    if mean < _0:
        noise = max(noise, usual[y // TILE, x // TILE] * g * g / number)
    part = PART * max(_0, _1 - noise / (mean * mean)) / whole
    return part * r0, part * r1, part * r2


@kernel
def _correct(light, begin, order, rows, ratio, usual, width, height, top, bottom, scale, noisier, out):
    """Adds what is given back to the rows top..bottom-1 of the picture `out` (H W, 3)."""
    for y in range(top, bottom):
        for x in range(width):
            k = y * width + x
            if not _several(begin, width, height, x, y):
                continue
            for p in range(begin[k], begin[k + 1]):
                found = _mean_residual(begin, rows, ratio, usual, width, height, x, y, p, noisier)
                for c in range(3):
                    given = max(found[c], -ratio[k, c])  # no light is below none
                    out[k, c] += scale * light.albedo[order[p], c] * rows[p, FORESEEN] * given


def give_back(clean: np.ndarray, foreseen: np.ndarray, lights: tuple[PointLight, ...], threads: int = 0, few: bool = False) -> np.ndarray:
    """The denoised diffuse light with what the denoiser has blurred within pixels.

    Args:
        clean: (H, W, 3) float32, denoised diffuse light, W/m^2/sr.
        foreseen: (H, W, 3) float32, sum of albedo * foreseen irradiance over the points of each pixel, W/m^2.
        lights: of the passes that the picture is the mean of, or of some of them.
        few: rays have found the light.

    Returns:
        (H, W, 3) float32, not negative where `clean` is not.
    """
    height, width = clean.shape[:2]
    pi = np.float32(np.pi)
    known = foreseen > np.float32(1e-6) * foreseen.mean()
    ratio = np.divide(pi * clean, foreseen, out=np.zeros_like(clean), where=known).reshape(-1, 3)
    out = clean.reshape(-1, 3).copy()
    whole, noisier = sum(light.weight for light in lights), NOISE_OF_FEW if few else NOISE
    for light in lights:
        share = shares(light)
        begin, order = np.empty(len(out) + 1, np.int64), np.empty(len(share), np.int32)
        rows, table = np.empty((len(share), ROW), np.float32), Reference(light)
        _sort(table, share, ratio, begin, order, rows)
        scale = np.float32(light.weight / whole) / pi
        usual = _usual_noise(light, order[: begin[-1]], rows[: begin[-1]], ratio, height, width)

        def work(top, bottom, table=table, begin=begin, order=order, rows=rows, usual=usual, scale=scale):
            _correct(table, begin, order, rows, ratio, usual, width, height, top, bottom, scale, noisier, out)

        run_chunks(work, height, LINES, threads)
    return np.maximum(out, 0).reshape(clean.shape)
