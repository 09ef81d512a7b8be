"""How much of a surface one pixel shows: what bumps measure their slopes over, as Cycles' ray differentials say.

Where no pixel is known (light that is reflected on, texels) it is that of a camera's pixel, seen directly.  Cycles
takes the length of the whole path from the camera, which is longer, and of the same order.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined
from ..scene import Scene, bounds

F = np.float32

# Of a scene without a camera, in its diagonals: half a millimetre in a room of 5 m.
_SHARE = 1e-4
# Without a scene (m).
_PLAIN = F(0.005)


@inlined
def pixel_size(vx, vy, vz, size, x, y, z):
    """Size of a pixel at (x, y, z), m; (v, size): what `viewer_row` holds, or zeros."""
    if size <= F(0):
        return -size if size < F(0) else _PLAIN
    x, y, z = x - vx, y - vy, z - vz
    return size * F(math.sqrt(x * x + y * y + z * z))


def viewer_row(scene: Scene) -> np.ndarray:
    """(4,) float32: the camera's place in the true world (m) and its pixel's size at 1 m; or in w, below 0, minus its size anywhere."""
    camera = scene.camera
    if camera is None:
        low, high = bounds(scene.geometry.vertices) if len(scene.geometry.vertices) else (np.zeros(3), np.ones(3))
        return np.array([0, 0, 0, -_SHARE * max(float(np.linalg.norm(high - low)), 1e-6)], F)
    left, right, bottom, top = camera.window
    size = 0.5 * ((right - left) / camera.width + (top - bottom) / camera.height)
    return np.array([*(camera.matrix[:3, 3] + scene.origin), -size if camera.orthographic else size], F)
