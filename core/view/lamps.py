"""Lamps that the camera sees, as Cycles shows them: they add their light to a pixel and hide nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..jit import kernel, leaf
from ..lamps.build import lamp_tables
from ..lamps.groups import LightGroups
from ..lamps.links import in_set
from ..lamps.lookup import lamp_along
from ..lamps.tables import AXIS_Z, ONE_MINUS_COS, POSITION, RADIUS, SIZE, TEXTURED, LampTables
from ..lamps.textured import shown_from
from ..scene import AREA, CAMERA, GLOSSY, SUN, TRANSMISSION, Scene
from .camera import camera_ray, camera_tables

FILTER = 10  # pixels that the widest filter of a film reaches beyond the picture
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)


def visible_lamps(scene: Scene, groups: LightGroups | None = None) -> LampTables:
    """The lamps with a size that camera rays may meet, before glass, behind it or in mirrors; groups: the light groups to tell apart, None for none."""
    groups = LightGroups.one(scene) if groups is None else groups
    lamps = scene.lamps
    sized = np.where(lamps.kind == SUN, lamps.angle, np.where(lamps.kind == AREA, 1, lamps.radius)) > 0
    finite = np.isfinite(lamps.emission.reshape(-1, 3)).all(1)
    kept = sized & finite
    return lamp_tables(replace(scene, lamps=lamps.take(kept)), CAMERA | GLOSSY | TRANSMISSION, groups.lamps[kept])


def lamps_in_view(scene: Scene) -> LampTables:
    """Those of `visible_lamps` that the camera's rays may meet, if a few others, too."""
    lamps, border = visible_lamps(scene), scene.camera.border
    near = np.empty(len(lamps.kind), np.int32)
    x0, y0, x1, y1 = border[0] - FILTER, border[1] - FILTER, border[2] + FILTER, border[3] + FILTER
    found = lamps_in_tile(lamps, camera_tables(scene.camera), x0, y0, x1, y1, near)
    return LampTables(*(column[near[:found]] for column in lamps))


@leaf
def _reach(lamps, i):
    """Radius (m) of the sphere about its position that holds lamp i, which is no sun."""
    if lamps.kind[i] == AREA:
        return _HALF * np.float32(math.sqrt(lamps.lamps[i, SIZE] ** 2 + lamps.lamps[i, SIZE + 1] ** 2))
    return lamps.lamps[i, RADIUS]


@leaf
def _sun_in_cone(lamps, i, dx, dy, dz, cosine):
    """Whether sun i may be met by rays from the cone of that cosine about the unit direction d."""
    x, y, z = lamps.lamps[i, AXIS_Z], lamps.lamps[i, AXIS_Z + 1], lamps.lamps[i, AXIS_Z + 2]
    between = math.acos(min(max(x * dx + y * dy + z * dz, -_1), _1))
    half = math.acos(_1 - lamps.lamps[i, ONE_MINUS_COS])
    return between <= math.acos(min(cosine, _1)) + half + np.float32(1e-3)


@kernel
def lamps_in_tile(lamps, camera, x0, y0, x1, y1, near):
    """Number of lamps that rays through the pixels x0 <= x < x1, y0 <= y < y1 may meet, and their indices in `near` (A,)."""
    if len(lamps.kind) == 0:
        return 0
    if camera.panorama:  # which may look to all sides
        for i in range(len(lamps.kind)):
            near[i] = i
        return len(lamps.kind)
    # All rays lie in a cone about the middle one, whose apex is widened to hold where they begin.
    ox, oy, oz, dx, dy, dz, _ = camera_ray(camera, np.float32(x0 + x1) * _HALF, np.float32(y0 + y1) * _HALF)
    wide, cosine = _0, _1
    for corner in range(4):
        qx, qy, qz, ex, ey, ez, _ = camera_ray(camera, np.float32(x1 if corner & 1 else x0), np.float32(y1 if corner & 2 else y0))
        wide = max(wide, np.float32(math.sqrt((qx - ox) ** 2 + (qy - oy) ** 2 + (qz - oz) ** 2)))
        cosine = min(cosine, dx * ex + dy * ey + dz * ez)
    sine = np.float32(math.sqrt(max(_0, _1 - cosine * cosine)))
    n = 0
    for i in range(len(lamps.kind)):
        if lamps.kind[i] == SUN:
            if _sun_in_cone(lamps, i, dx, dy, dz, cosine):
                near[n] = i
                n += 1
            continue
        vx, vy, vz = lamps.lamps[i, POSITION] - ox, lamps.lamps[i, POSITION + 1] - oy, lamps.lamps[i, POSITION + 2] - oz
        along = vx * dx + vy * dy + vz * dz
        aside = np.float32(math.sqrt(max(_0, vx * vx + vy * vy + vz * vz - along * along)))
        # Distance from the cone, less what rounding may have added.
        if aside * cosine - along * sine <= _reach(lamps, i) + wide + np.float32(1e-3) * (aside + abs(along)):
            near[n] = i
            n += 1
    return n


@kernel
def lamps_between(lamps, near, n, seen_by, ox, oy, oz, dx, dy, dz, start, end, on, geometry, weight, materials, rows, surface, out):
    """Adds the radiance of the lamps near[0..n-1] whose distance along the unit direction d from o lies in start..end to `out` (G, 3).

    seen_by: SEEN_BY_CAMERA, SEEN_THROUGH_GLASS or SEEN_BY_GLOSSY.  weight: (3,) float32.
    on: triangle of the mirror or the glass before, -1 for none, of which the lamps are seen that light it.  geometry: as of `view`.
    materials, rows, surface: as for `evaluate`, for lamps with programs.
    """
    for k in range(n):
        i = near[k]
        if not lamps.flags[i] & seen_by or not in_set(geometry.receiver_sets, lamps.receivers[i], geometry.object, on):
            continue
        t, share = lamp_along(lamps, i, ox, oy, oz, dx, dy, dz)
        if share > _0 and start <= t and t <= end:
            r, g, b = (
                weight[0] * share * lamps.radiance[i, 0],
                weight[1] * share * lamps.radiance[i, 1],
                weight[2] * share * lamps.radiance[i, 2],
            )
            if lamps.flags[i] & TEXTURED:
                sr, sg, sb = shown_from(
                    materials, geometry.attributes, lamps.kind[i], lamps.flags[i], lamps.lamps, i, ox, oy, oz, dx, dy, dz, t, rows, surface
                )
                r, g, b = r * sr, g * sg, b * sb
            out[lamps.light_group[i], 0] += r
            out[lamps.light_group[i], 1] += g
            out[lamps.light_group[i], 2] += b
