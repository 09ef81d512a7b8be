"""Light through cut-outs: what share of it passes the transparent surfaces between two points."""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..rays.trace import CUTOUT, intersect1
from .layout import TRANSPARENCY
from .program import MEAN_VIEW, evaluate

MAX_PASSED = 128  # transparent surfaces on one segment; what lies behind more counts as dark
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@kernel
def transmittance1(rays, materials, material, attributes, packet, rows, surface, ox, oy, oz, dx, dy, dz, t_near, t_far, kinds):
    """Transmittance (r, g, b) of the transparent triangles along one segment.

    For segments that the OPAQUE set does not block.  packet, rows, surface: scratch (`new_packet`,
    `new_registers`, (SURFACE,) float32); the packet's lanes stay as they are.
    """
    r = g = b = _1
    start = t_near
    for _ in range(MAX_PASSED):
        triangle, t, u, v = intersect1(rays, CUTOUT, packet, ox, oy, oz, dx, dy, dz, start, t_far, kinds)
        if triangle < 0:
            return r, g, b
        evaluate(materials, material[triangle], attributes, triangle, u, v, np.float32(MEAN_VIEW), rows, surface)
        r *= surface[TRANSPARENCY]
        g *= surface[TRANSPARENCY + 1]
        b *= surface[TRANSPARENCY + 2]
        if not max(r, g, b) > np.float32(1e-4):
            break
        start = t + np.float32(1e-5) * abs(t)
    return _0, _0, _0
