"""A region of the screen as a camera: the rays of a viewport, pixel by pixel."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d

from ..core.scene import Camera

if TYPE_CHECKING:
    from mathutils import Matrix


Part = tuple[float, float, float, float]  # left, bottom, right and top edge, of a region's or picture's width and height
WHOLE: Part = (0.0, 0.0, 1.0, 1.0)


def render_region(scene: bpy.types.Scene, space: bpy.types.SpaceView3D, view: bpy.types.RegionView3D, region: bpy.types.Region) -> Part:
    """The part of a viewport that its render region (Ctrl-B) leaves: the scene's, inside the camera's frame, or the viewport's own."""
    camera = space.camera if space.use_local_camera else scene.camera
    if view.view_perspective != "CAMERA" or camera is None or camera.type != "CAMERA":
        if not space.use_render_border:
            return WHOLE
        return space.render_border_min_x, space.render_border_min_y, space.render_border_max_x, space.render_border_max_y
    render = scene.render
    if not render.use_border:
        return WHOLE
    frame = [camera.matrix_world.normalized() @ corner for corner in camera.data.view_frame(scene=scene)]
    seen = np.array([location_3d_to_region_2d(region, view, corner) for corner in frame]) / (region.width, region.height)
    low, high = seen.min(0), seen.max(0)
    ends = low + (high - low) * ((render.border_min_x, render.border_min_y), (render.border_max_x, render.border_max_y))
    return tuple(float(edge) for edge in np.clip(ends, 0, 1).ravel())


def pixels_of(part: Part, width: int, height: int) -> tuple[int, int, int, int]:
    """The border (x0, y0, x1, y1; y down) of the pixels that a part touches, one at least."""
    left, bottom, right, top = part
    x0, y0 = min(int(left * width), width - 1), min(int((1 - top) * height), height - 1)
    return x0, y0, max(x0 + 1, math.ceil(right * width)), max(y0 + 1, math.ceil((1 - bottom) * height))


def part_of(border: tuple[int, int, int, int], width: int, height: int) -> Part:
    """Where a border's pixels lie."""
    x0, y0, x1, y1 = border
    return x0 / width, 1 - y1 / height, x1 / width, 1 - y0 / height


def region_camera(view: Matrix | np.ndarray, window: Matrix | np.ndarray, width: int, height: int, part: Part = WHOLE) -> Camera:
    """The camera of a region, in world space, from its view matrix (world to eye) and its OpenGL projection; part: what is rendered of it.

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
    border = pixels_of(part, width, height)
    return Camera(matrix, orthographic, (left, right, bottom, top), width, height, border, near, far, "the viewport")
