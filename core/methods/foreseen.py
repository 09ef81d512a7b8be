"""What the light of a view will be about, without noise: what a denoiser need not find.

The lights of one subset give every point what they would give it without shadows, by blocks of lights that lie close together; how much
of a block's light arrives is told by the shadow rays that were traced anyway, of all points of a tile of pixels to lights of that block in
all subsets.  Light of the gather rays is the tile's mean.  The estimate has the edges of `irradiance` by normals, distances and the
larger shadows; a denoiser that is given the ratio to it need not tell these from noise (after Heitz, Hill & McGuire 2018, Combining
Analytic Direct Illumination and Stochastic Shadows).
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel, leaf
from ..threads import run_chunks
from ..view.points import ShadingPoints

BLOCK = 16  # lights of a subset that are summed together
TILE = 16  # pixels along a side
HIDDEN, VISIBLE = np.uint8(1), np.uint8(2)  # what a shadow ray found; 0: there was none
PRIOR = 2.0  # rays that the whole tile, or the whole view, counts as
EVEN = 0.3  # times the mean that is added everywhere: what is foreseen as dark need not be
CHUNK = 1024  # points a chunk
LARGE = np.float32(1e4)
_0 = np.float32(0.0)


@leaf
def light_up(lights, chosen, px, py, pz, nx, ny, nz, gx, gy, gz, g_max, by_chance, f, blocks):
    """What each light of a subset gives a point unshadowed into f (K,), its sums by blocks; the sum of all.

    lights: (S, 10, K), as `light_table` has them.  by_chance: whether each is weighed by the last row.
    """
    for k in range(len(f)):
        dx, dy, dz = lights[chosen, 0, k] - px, lights[chosen, 1, k] - py, lights[chosen, 2, k] - pz
        r2 = dx * dx + dy * dy + dz * dz + np.float32(1e-30)
        # A shading normal may look at what the surface turns its back on.
        at_point = min(nx * dx + ny * dy + nz * dz, LARGE * (gx * dx + gy * dy + gz * dz))
        at_light = -(lights[chosen, 3, k] * dx + lights[chosen, 4, k] * dy + lights[chosen, 5, k] * dz)
        spread = r2 + lights[chosen, 7, k] * (r2 - at_light * at_light)
        light = min(g_max * lights[chosen, 8, k], lights[chosen, 6, k] * max(_0, at_point) * max(_0, at_light) / (spread * spread))
        f[k] = light * lights[chosen, 9, k] if by_chance else light
    total = _0
    for block in range(len(blocks)):
        part = _0
        for k in range(BLOCK):
            part += f[block * BLOCK + k]
        blocks[block] = part
        total += part
    return total


@kernel
def _expected(points, lights, visible, ambient, width, begin, end, g_max, out):
    """`out` (N,) of the points begin..end-1 by `visible` (Y, X, B) and `ambient` (Y, X) of tiles, bilinear between their centres."""
    f, blocks = np.empty(lights.shape[2], np.float32), np.empty(lights.shape[2] // BLOCK, np.float32)
    rows, columns = ambient.shape
    one = np.float32(1)
    for k in range(begin, end):
        light_up(
            lights, 0, points.position[k, 0], points.position[k, 1], points.position[k, 2],
            points.ns[k, 0], points.ns[k, 1], points.ns[k, 2], points.ng[k, 0], points.ng[k, 1], points.ng[k, 2], g_max, False, f, blocks,
        )  # fmt: skip
        y, x = points.pixel[k] // width, points.pixel[k] % width
        fy = min(max((np.float32(y) + np.float32(0.5)) / np.float32(TILE) - np.float32(0.5), _0), np.float32(rows - 1))
        fx = min(max((np.float32(x) + np.float32(0.5)) / np.float32(TILE) - np.float32(0.5), _0), np.float32(columns - 1))
        y0, x0 = int(fy), int(fx)
        y1, x1 = min(y0 + 1, rows - 1), min(x0 + 1, columns - 1)
        fy, fx = fy - np.float32(y0), fx - np.float32(x0)
        w00, w01, w10, w11 = (one - fy) * (one - fx), (one - fy) * fx, fy * (one - fx), fy * fx
        total = w00 * ambient[y0, x0] + w01 * ambient[y0, x1] + w10 * ambient[y1, x0] + w11 * ambient[y1, x1]
        for b in range(len(blocks)):
            total += blocks[b] * (w00 * visible[y0, x0, b] + w01 * visible[y0, x1, b] + w10 * visible[y1, x0, b] + w11 * visible[y1, x1, b])
        out[k] = total


def foreseen(
    points: ShadingPoints, shape: tuple[int, int], lights: np.ndarray, g_max: np.float32, sights: np.ndarray, blocks: np.ndarray,
    gathered: np.ndarray, threads: int = 0, *, wanted: ShadingPoints | None = None,
) -> np.ndarray:  # fmt: skip
    """Irradiance (W,) float32, W/m^2, grey, of W points of a picture of `shape` (height, width), without noise to speak of.

    points: N, whose rays tell it.  lights: (S, 10, K), of which the first subset is summed.  sights: (N, R) uint8, what each point's shadow rays
    found; blocks: (N, R) uint8, the lights' blocks.  gathered: (N,), what the gather rays found.  wanted: the W points, None for the same.
    """
    wanted = points if wanted is None else wanted
    if not len(points.pixel):
        return np.zeros(len(wanted.pixel), np.float32)
    height, width = shape
    rows, columns = -(-height // TILE), -(-width // TILE)
    tile = points.pixel // width // TILE * columns + points.pixel % width // TILE
    n = rows * columns
    count = np.bincount(tile, minlength=n)
    ambient = (np.bincount(tile, gathered, n) + PRIOR * gathered.mean()) / (count + PRIOR)
    parts = lights.shape[2] // BLOCK
    visible = np.zeros((n, parts))
    if parts:
        traced = sights > 0
        place = (tile[:, None] * parts + blocks)[traced]
        found = np.bincount(place, sights[traced] == VISIBLE, n * parts).reshape(n, parts)
        rays = np.bincount(place, minlength=n * parts).reshape(n, parts)
        whole = found.sum() / max(rays.sum(), 1)
        tiles = (found.sum(axis=1) + PRIOR * whole) / (rays.sum(axis=1) + PRIOR)
        visible = (found + PRIOR * tiles[:, None]) / (rays + PRIOR) * len(lights)
    out = np.empty(len(wanted.pixel), np.float32)
    ambient, visible = ambient.astype(np.float32).reshape(rows, columns), visible.astype(np.float32).reshape(rows, columns, parts)
    lights = lights if parts else np.zeros((1, 10, 0), np.float32)
    near = np.float32(g_max / len(lights))  # a light stands for many: where it is close it must not give as much as all of them
    run_chunks(lambda begin, end: _expected(wanted, lights, visible, ambient, width, begin, end, near, out), len(out), CHUNK, threads)
    return out + np.float32(EVEN * out.mean())
