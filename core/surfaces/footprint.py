"""How much of a surface one pixel shows: what bumps measure their slopes over, as Cycles' ray differentials say.

Cycles takes the length of the whole path from the camera.  Light that is reflected on has come by way of one surface at least: where that is as
far from its end as from the camera, as in the mean over a room's points, its path is twice as long as the straight line from the camera.  Lights know
no more of it, so that is what all of them take.  A bump as steep as a brick's edge is another one by every step: straight lines gave a cellar
of bricks 12 % too much indirect light in small pictures.  (Texels, which no path from a camera meets, take the same.)
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
# Length of a path that has met another surface, in straight lines from the camera.
_ROUNDABOUT = 2.0


@inlined
def pixel_size(vx, vy, vz, size, x, y, z):
    """Size of a pixel at (x, y, z), m; (v, size): what `viewer_row` holds, or zeros."""
    if size <= F(0):
        return -size if size < F(0) else _PLAIN
    x, y, z = x - vx, y - vy, z - vz
    return size * F(math.sqrt(x * x + y * y + z * z))


def viewer_row(scene: Scene, *, directly: bool) -> np.ndarray:
    """(4,) float32: the camera's place in the true world (m) and its pixel's size at 1 m; or in w, below 0, minus its size anywhere.

    directly: whether it is for what the camera sees itself; else for what light meets that is reflected on.
    """
    camera = scene.camera
    if camera is None:
        low, high = bounds(scene.geometry.vertices) if len(scene.geometry.vertices) else (np.zeros(3), np.ones(3))
        return np.array([0, 0, 0, -_SHARE * max(float(np.linalg.norm(high - low)), 1e-6)], F)
    left, right, bottom, top = camera.window
    size = 0.5 * ((right - left) / camera.width + (top - bottom) / camera.height)
    at_1_m = size if directly else _ROUNDABOUT * size
    return np.array([*(camera.matrix[:3, 3] + scene.origin), -size if camera.orthographic else at_1_m], F)
