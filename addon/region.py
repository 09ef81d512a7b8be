"""A region of the screen as a camera: the rays of a viewport, pixel by pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..core.scene import Camera

if TYPE_CHECKING:
    from mathutils import Matrix


def region_camera(view: Matrix | np.ndarray, window: Matrix | np.ndarray, width: int, height: int) -> Camera:
    """The camera of a region, in world space, from its view matrix (world to eye) and its OpenGL projection.

    The eye stands on the near plane of an orthographic view, which Blender puts behind the viewer.
    """
    view, window = np.array(view, np.float64), np.array(window, np.float64)
    matrix = np.linalg.inv(view)
    matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
    orthographic = window[3, 3] == 1
    # Where x, y = -1 and 1 of the projection lie in the plane at distance 1, or in any plane of an orthographic view.
    shift = -window[:2, 3] if orthographic else window[:2, 2]
    (left, bottom), (right, top) = ((sign + shift) / (window[0, 0], window[1, 1]) for sign in (-1, 1))
    a, b = window[2, 2], window[2, 3]
    near, far = ((b + 1) / a, (b - 1) / a) if orthographic else (b / (a - 1), b / (a + 1))
    if orthographic:
        matrix[:3, 3] -= near * matrix[:3, 2]
        near, far = 0.0, far - near
    return Camera(matrix, orthographic, (left, right, bottom, top), width, height, (0, 0, width, height), near, far, "the viewport")
