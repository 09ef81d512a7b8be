"""Whether a UV map can hold a lightmap: every point of the surface needs a texel of its own, inside the image."""

from __future__ import annotations

import numpy as np

from ..errors import SceneError
from ..jit import kernel

MOST_GRID = 2048  # points along a side, between which overlaps go unseen
OUTSIDE = 1e-4  # of the image's side: rounding, no fault
OVERLAP = 1e-3  # of the covered points: what meets along a rounded edge is none
_INSIDE = 0.02  # grid cells from a triangle's edges


@kernel
def _overlaps(uv, side, owner, twice):
    """Marks the triangles (T, 3, 2) that share grid points with others in `twice` (T,); shared and covered points."""
    shared = covered = 0
    for k in range(len(uv)):
        ax, ay = np.float64(uv[k, 0, 0]) * side, np.float64(uv[k, 0, 1]) * side
        ex, ey = uv[k, 1, 0] * np.float64(side) - ax, uv[k, 1, 1] * np.float64(side) - ay
        fx, fy = uv[k, 2, 0] * np.float64(side) - ax, uv[k, 2, 1] * np.float64(side) - ay
        area = ex * fy - fx * ey
        if area == 0.0:
            continue
        # Weights below which a point lies nearer than _INSIDE to the edge across from a corner.
        least_u = _INSIDE * np.sqrt(fx * fx + fy * fy) / abs(area)
        least_v = _INSIDE * np.sqrt(ex * ex + ey * ey) / abs(area)
        least_w = _INSIDE * np.sqrt((fx - ex) ** 2 + (fy - ey) ** 2) / abs(area)
        for y in range(max(0, int(np.floor(ay + min(0.0, ey, fy)))), min(side, int(np.floor(ay + max(0.0, ey, fy))) + 1)):
            for x in range(max(0, int(np.floor(ax + min(0.0, ex, fx)))), min(side, int(np.floor(ax + max(0.0, ex, fx))) + 1)):
                px, py = x + 0.5 - ax, y + 0.5 - ay
                u, v = (px * fy - fx * py) / area, (ex * py - px * ey) / area
                if u <= least_u or v <= least_v or 1.0 - u - v <= least_w:
                    continue
                other = owner[y, x]
                if other < 0:
                    owner[y, x] = k
                    covered += 1
                else:
                    twice[k] = twice[other] = 1
                    shared += 1
    return shared, covered


def check_charts(uv: np.ndarray, owner: np.ndarray, names: list[str], layer: str, side: int = MOST_GRID) -> None:
    """Raise unless a UV map can hold a lightmap.

    Args:
        uv: (T, 3, 2) float32, all triangles of one image.  owner: (T,) int, the object of each, into `names`.
        layer: what the UV map is called.  side: of the image, in texels.

    Raises:
        SceneError: coordinates outside of 0..1 or not finite, faces without area in the map, faces that overlap; it names the
            objects and the way out.
    """
    remedy = "unwrap it again, or choose to have the map made"
    finite = np.isfinite(uv).all(axis=(1, 2))
    if not finite.all():
        raise SceneError(f"{_some(names, owner[~finite])}: UV map '{layer}' has invalid coordinates; {remedy}")
    outside = ((uv < -OUTSIDE) | (uv > 1 + OUTSIDE)).any(axis=(1, 2))
    if outside.any():
        raise SceneError(
            f"{_some(names, owner[outside])}: {outside.sum()} triangles lie outside of 0..1 in UV map '{layer}'; scale it to fit, {remedy}"
        )
    e, f = uv[:, 1].astype(np.float64) - uv[:, 0], uv[:, 2].astype(np.float64) - uv[:, 0]
    areas = np.bincount(owner, np.abs(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]), len(names))
    flat = (areas <= 1e-12) & (np.bincount(owner, minlength=len(names)) > 0)
    if flat.any():
        raise SceneError(f"{_some(names, np.flatnonzero(flat))}: UV map '{layer}' has no area; {remedy}")
    twice = np.zeros(len(uv), np.uint8)
    grid = min(MOST_GRID, 2 * side)
    shared, covered = _overlaps(uv, grid, np.full((grid, grid), -1, np.int32), twice)
    if shared > OVERLAP * covered:
        raise SceneError(
            f"{_some(names, owner[twice > 0])}: faces overlap in UV map '{layer}' ({100 * shared / covered:.1f} % of it); {remedy}, "
            "or apply the modifiers that repeat it (Array, Mirror)"
        )


def texels_a_metre(corners: np.ndarray, uv: np.ndarray) -> float:
    """Side of the image in texels at which triangles (T, 3, 3) m, laid out as uv (T, 3, 2), have one texel a metre on average."""
    edges = (corners[:, 1:] - corners[:, :1]).astype(np.float64)
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
    e = (uv[:, 1:] - uv[:, :1]).astype(np.float64)
    mapped = np.abs(e[:, 0, 0] * e[:, 1, 1] - e[:, 0, 1] * e[:, 1, 0]).sum()
    return float(np.sqrt(area / mapped)) if mapped > 0 else 0.0


def _some(names: list[str], owner: np.ndarray, most: int = 3) -> str:
    """The objects' names, the first few of many."""
    found = [f"'{names[i]}'" for i in np.unique(owner)]
    return ", ".join(found[:most]) + (f" and {len(found) - most} more" if len(found) > most else "")
