"""Blender's camera as a window in space and a pixel grid: the rays of Cycles, pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ...core.errors import SceneError
from ...core.scene import Camera


def find_camera(scene: bpy.types.Scene, name: str | None = None) -> bpy.types.Object:
    """The camera object to render from: the one of that name, else the scene's own.

    Raises:
        SceneError: there is none, or it cannot be rendered from.
    """
    if name is not None:
        camera = scene.objects.get(name)
        if camera is None:
            raise SceneError(f"no camera '{name}' in scene '{scene.name}'; it has: {_cameras(scene)}")
    else:
        camera = scene.camera
        if camera is None:
            raise SceneError(f"scene '{scene.name}' has no active camera: set one, or name one of: {_cameras(scene)}")
    if camera.type != "CAMERA":
        raise SceneError(f"'{camera.name}' is no camera but of type {camera.type.lower()}; choose one of: {_cameras(scene)}")
    kind = _kind(camera.data)
    if kind not in ("PERSP", "ORTHO", "EQUIRECTANGULAR"):
        raise SceneError(
            f"camera '{camera.name}' is of type {kind.lower()}: only perspective, orthographic and equirectangular panoramic cameras "
            "can be rendered; change Type in its data properties"
        )
    return camera


def _panorama(data: bpy.types.Camera):
    """Whatever holds the settings of a panoramic camera."""
    return data if hasattr(data, "panorama_type") else data.cycles


def _kind(data: bpy.types.Camera) -> str:
    """The type of a camera, of a panoramic one the type of its panorama."""
    return _panorama(data).panorama_type if data.type == "PANO" else data.type


@dataclass(frozen=True)
class Frame:
    """The pixel grid: size of the full frame, the border to render (x0, y0, x1, y1; y down), width to height of a pixel."""

    width: int
    height: int
    border: tuple[int, int, int, int]
    pixel_aspect: float


def image_frame(scene: bpy.types.Scene, size: tuple[int, int] | None = None) -> Frame:
    """The pixels of `size`, else of the scene's resolution times its percentage.

    Raises:
        SceneError: the image or its render border has no pixels.
    """
    render = scene.render
    width, height = size or tuple(r * render.resolution_percentage // 100 for r in (render.resolution_x, render.resolution_y))
    if width < 1 or height < 1:
        raise SceneError(f"scene '{scene.name}' would be rendered at {width}x{height} pixels: set a larger resolution")
    border = (0, 0, width, height)
    if render.use_border:  # cut off to whole pixels, as Blender does
        x0, x1 = int(render.border_min_x * width), int(render.border_max_x * width)
        y0, y1 = int(render.border_min_y * height), int(render.border_max_y * height)
        if x1 <= x0 or y1 <= y0:
            raise SceneError(f"the render region of scene '{scene.name}' holds no pixel: enlarge it or clear it (Ctrl-Alt-B)")
        border = (x0, height - y1, x1, height - y0)
    return Frame(int(width), int(height), border, render.pixel_aspect_x / render.pixel_aspect_y)


def extract_camera(camera: bpy.types.Object, frame: Frame, *, matrix: Matrix | None = None, shift_x: float | None = None) -> Camera:
    """An evaluated camera object; its position is still in world space.

    matrix, shift_x: those of one of two eyes, else the camera's own.

    Raises:
        SceneError: its scale is zero.
    """
    data = camera.data
    placed = np.array(camera.matrix_world if matrix is None else matrix, np.float64)
    length = np.linalg.norm(placed[:3, :3], axis=0)
    if not np.isfinite(placed).all() or (length == 0).any():
        raise SceneError(f"camera '{camera.name}' has a scale of zero or an invalid position: reset its transform")
    placed[:3, :3] /= length
    return Camera(
        matrix=placed,
        orthographic=data.type == "ORTHO",
        panorama=data.type == "PANO",
        window=_window(data, frame, data.shift_x if shift_x is None else shift_x),
        width=frame.width,
        height=frame.height,
        border=frame.border,
        near=data.clip_start,
        far=data.clip_end,
        name=camera.name,
    )


def camera_warnings(camera: bpy.types.Object, scene: bpy.types.Scene, *, views: bool = False) -> list[str]:
    """What of the camera and its shutter is not rendered; views: all views of stereoscopy are."""
    warnings = []
    if camera.data.dof.use_dof:
        warnings.append(f"depth of field of camera '{camera.name}' is ignored: everything is in focus")
    if scene.render.use_motion_blur:
        warnings.append(f"motion blur of scene '{scene.name}' is ignored: frame {scene.frame_current} is rendered as it stands")
    if scene.render.use_multiview and not views:
        warnings.append(f"stereoscopy of scene '{scene.name}' is ignored: one view is rendered (F12 with Lumigate renders them all)")
    return warnings


def _cameras(scene: bpy.types.Scene) -> str:
    return ", ".join(sorted(ob.name for ob in scene.objects if ob.type == "CAMERA")) or "none (add one)"


def _window(data: bpy.types.Camera, frame: Frame, shift_x: float) -> tuple[float, float, float, float]:
    """Left, right, bottom and top edge of the image at distance 1, or in metres if orthographic, in radians if panoramic.

    The larger side (or the one that the sensor fit names) spans the sensor or the orthographic scale;
    shift counts in units of that side (`blender_camera_viewplane` of Cycles' blender/camera.cpp).
    """
    if data.type == "PANO":
        view = _panorama(data)
        return view.longitude_min, view.longitude_max, view.latitude_min, view.latitude_max
    wide, high = frame.width * frame.pixel_aspect, frame.height
    horizontal = data.sensor_fit == "HORIZONTAL" or (data.sensor_fit == "AUTO" and wide > high)
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    span = data.ortho_scale if data.type == "ORTHO" else sensor / data.lens
    half_x, half_y = (0.5 * span, 0.5 * span * high / wide) if horizontal else (0.5 * span * wide / high, 0.5 * span)
    x, y = shift_x * span, data.shift_y * span
    return x - half_x, x + half_x, y - half_y, y + half_y
