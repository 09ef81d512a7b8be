"""Blender's camera as kernels read it, and its rays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined
from ..sampling.hashing import hash_combine
from ..sampling.sequences import sobol
from ..scene import Camera


class CameraTables(NamedTuple):
    """A camera in float32 arrays.

    matrix: (3, 4) float32, camera to scene.  window: (4,) float32, left, right, bottom, top.
    clip: (2,) float32, near and far.  size: (2,) int32, full frame.  border: (4,) int32, x0, y0, x1, y1.
    orthographic, panorama: bool.
    """

    matrix: np.ndarray
    window: np.ndarray
    clip: np.ndarray
    size: np.ndarray
    border: np.ndarray
    orthographic: bool
    panorama: bool


def camera_tables(camera: Camera) -> CameraTables:
    """The camera in float32 arrays."""
    return CameraTables(
        np.ascontiguousarray(camera.matrix[:3], np.float32),
        np.asarray(camera.window, np.float32),
        np.asarray([camera.near, camera.far], np.float32),
        np.asarray([camera.width, camera.height], np.int32),
        np.asarray(camera.border, np.int32),
        bool(camera.orthographic),
        bool(camera.panorama),
    )


@inlined
def camera_ray(camera, x, y):
    """The ray through the image position (x, y) in pixels of the full frame, y down.

    Returns origin (on the near plane, a sphere of a panorama), unit direction, and the way along the ray for one metre of depth.
    """
    m = camera.matrix
    wx = camera.window[0] + (camera.window[1] - camera.window[0]) * (x / np.float32(camera.size[0]))
    wy = camera.window[3] + (camera.window[2] - camera.window[3]) * (y / np.float32(camera.size[1]))
    near = camera.clip[0]
    if camera.orthographic:
        dx, dy, dz = -m[0, 2], -m[1, 2], -m[2, 2]
        ox = m[0, 3] + wx * m[0, 0] + wy * m[0, 1] + near * dx
        oy = m[1, 3] + wx * m[1, 0] + wy * m[1, 1] + near * dy
        oz = m[2, 3] + wx * m[2, 0] + wy * m[2, 1] + near * dz
        return ox, oy, oz, dx, dy, dz, np.float32(1.0)
    ahead = np.float32(1.0)
    if camera.panorama:
        across = np.cos(wy)
        wx, wy, ahead = across * np.sin(wx), np.sin(wy), across * np.cos(wx)
    lx = wx * m[0, 0] + wy * m[0, 1] - ahead * m[0, 2]
    ly = wx * m[1, 0] + wy * m[1, 1] - ahead * m[1, 2]
    lz = wx * m[2, 0] + wy * m[2, 1] - ahead * m[2, 2]
    slant = np.sqrt(lx * lx + ly * ly + lz * lz)
    return m[0, 3] + near * lx, m[1, 3] + near * ly, m[2, 3] + near * lz, lx / slant, ly / slant, lz / slant, slant


@inlined
def depth_along(camera, dx, dy, dz):
    """Depth (m) that one metre along the unit direction d adds: along the view axis, but for panoramas, which count the way itself."""
    return np.float32(1.0) if camera.panorama else -(dx * camera.matrix[0, 2] + dy * camera.matrix[1, 2] + dz * camera.matrix[2, 2])


@inlined
def pixel_sample(sample, seed, pixel):
    """Position of a sample in the pixel's square: Sobol points under a scramble of the pixel's own.

    Sixteen of them lie in sixteen different columns and rows, so that edges of any slope are covered evenly.
    """
    scramble = hash_combine(seed, pixel)
    return sobol(sample, 0, scramble), sobol(sample, 1, scramble)
