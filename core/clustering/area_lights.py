"""Virtual area lights (VALs): VPLs grouped by k-means into rectangles.

Dong et al. 2009, "Real-time Indirect Illumination with Clustered Visibility", Sections 5 and 6.  The distance of a VPL to a
cluster is w_x dx + w_a da, dx in units of the scene's extent, da the angle of the normals in radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..jit import kernel

WEIGHT_POSITION = 0.7  # Section 5.1
WEIGHT_ANGLE = 0.3
ITERATIONS = 32  # at most
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@dataclass(frozen=True)
class AreaLights:
    """M VALs, none empty, of N VPLs.

    centre: (M, 3) float32, the members' mean position (m).  frame: (M, 3, 3) float32, rows: the rectangle's two axes and its
    normal, the members' mean.  half: (M, 2) float32, half sides of the rectangle about the centre (m).
    depth: (M,) float32, how far a member lies off the rectangle's plane at most (m).  spread: (M,) float32, smallest cosine
    of a member's normal with the VAL's.  assignment: (N,) int32, the VAL of each VPL.  medoid: (M,) int64, the member that is
    nearest to the VAL as k-means measures it.
    """

    centre: np.ndarray
    frame: np.ndarray
    half: np.ndarray
    depth: np.ndarray
    spread: np.ndarray
    assignment: np.ndarray
    medoid: np.ndarray

    def __len__(self) -> int:
        return len(self.centre)


@kernel(fast=False)
def _assign(position, normal, centre, axis, weight_position, weight_angle, assignment, medoid, distance):
    """The nearest centre of each VPL (equal distances: the first) into assignment (N,), each centre's nearest member into medoid (M,).

    distance: (N,) float32, set to those to the centres.

    True if any assignment changed.
    """
    closest = np.full(len(centre), np.float32(np.inf))
    changed = False
    for i in range(len(position)):
        best, nearest = np.float32(np.inf), 0
        for k in range(len(centre)):
            dx, dy, dz = position[i, 0] - centre[k, 0], position[i, 1] - centre[k, 1], position[i, 2] - centre[k, 2]
            cosine = normal[i, 0] * axis[k, 0] + normal[i, 1] * axis[k, 1] + normal[i, 2] * axis[k, 2]
            angle = np.arccos(min(max(cosine, -_1), _1))
            d = weight_position * np.sqrt(dx * dx + dy * dy + dz * dz) + weight_angle * angle
            if d < best:
                best, nearest = d, k
        changed |= assignment[i] != nearest
        assignment[i], distance[i] = nearest, best
        if best < closest[nearest]:
            closest[nearest], medoid[nearest] = best, i
    return changed


def _means(values: np.ndarray, assignment: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """(M, C) float64 means of the members' values (N, C); clusters without members get zeros."""
    sums = np.stack([np.bincount(assignment, values[:, c], len(sizes)) for c in range(values.shape[1])], axis=1)
    return sums / np.maximum(sizes, 1)[:, None]


def _unit(vectors: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Unit vectors of (M, 3); `otherwise` where they cancel out."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 1e-6, vectors / np.maximum(length, 1e-30), otherwise).astype(np.float32)


def cluster_area_lights(
    position: np.ndarray,
    normal: np.ndarray,
    first_guess: np.ndarray,
    extent: float,
    *,
    weight_position: float = WEIGHT_POSITION,
    weight_angle: float = WEIGHT_ANGLE,
    iterations: int = ITERATIONS,
) -> AreaLights:
    """Group N VPLs by k-means that starts at the VPLs `first_guess` (M,).

    position, normal: (N, 3) float32 (m; unit).  extent: of the scene (m).

    The same first guess gives similar clusters for similar VPLs: restarted at each frame, they are coherent in time and
    none is lost (Section 5.2).  There are fewer than M where fewer VPLs differ.

    Raises:
        ValueError: no VPL to start from, or an extent that is not above 0.
    """
    if len(first_guess) == 0 or not extent > 0:
        raise ValueError(f"expected at least one VPL to start from and an extent above 0, got {len(first_guess)} and {extent}")
    centre, axis = position[first_guess].astype(np.float32), normal[first_guess].astype(np.float32)
    assignment = np.full(len(position), -1, np.int32)
    medoid, distance = np.zeros(len(centre), np.int64), np.empty(len(position), np.float32)
    weights = np.float32(weight_position / extent), np.float32(weight_angle)
    for _ in range(iterations):
        if not _assign(position, normal, centre, axis, *weights, assignment, medoid, distance):
            break
        sizes = np.bincount(assignment, minlength=len(centre))
        filled = (sizes > 0)[:, None]
        centre = np.where(filled, _means(position, assignment, sizes), centre).astype(np.float32)
        axis = np.where(filled, _unit(_means(normal, assignment, sizes), axis), axis).astype(np.float32)
        # A cluster that lost its members starts anew where the others are farthest away.
        empty = np.flatnonzero(sizes == 0)
        lonely = np.argsort(-distance, kind="stable")[: len(empty)]
        centre[empty], axis[empty] = position[lonely], normal[lonely]
    filled = np.bincount(assignment, minlength=len(centre)) > 0
    label = np.cumsum(filled, dtype=np.int32) - np.int32(1)
    return _rectangles(position, normal, centre[filled], axis[filled], label[assignment], medoid[filled])


def nearest_area_light(lights: AreaLights, position: np.ndarray, normal: np.ndarray, extent: float) -> np.ndarray:
    """(N,) int32: the VAL that each surface point would belong to, with the weights of the paper."""
    found = np.full(len(position), -1, np.int32)
    weights = np.float32(WEIGHT_POSITION / extent), np.float32(WEIGHT_ANGLE)
    _assign(
        position,
        normal,
        lights.centre,
        lights.frame[:, 2],
        *weights,
        found,
        np.zeros(len(lights), np.int64),
        np.empty(len(position), np.float32),
    )
    return found


def chained(lights: AreaLights, extent: float) -> AreaLights:
    """The same VALs in a chain from each to the nearest that is not in it yet, as k-means measures it: neighbours light much the same."""
    order = np.zeros(len(lights), np.int64)
    free = np.ones(len(lights), bool)
    for n in range(len(lights)):
        at = order[n]
        free[at] = False
        angle = np.arccos(np.clip(lights.frame[:, 2] @ lights.frame[at, 2], -1, 1))
        away = WEIGHT_POSITION / extent * np.linalg.norm(lights.centre - lights.centre[at], axis=1) + WEIGHT_ANGLE * angle
        if n + 1 < len(lights):
            order[n + 1] = np.where(free, away, np.inf).argmin()
    place = np.empty(len(lights), np.int32)
    place[order] = np.arange(len(lights))
    return AreaLights(
        lights.centre[order],
        lights.frame[order],
        lights.half[order],
        lights.depth[order],
        lights.spread[order],
        place[lights.assignment],
        lights.medoid[order],
    )


def _rectangles(position, normal, centre, axis, assignment, medoid) -> AreaLights:
    """VALs of clusters: bounding rectangles along the members' principal axes in the planes of the mean normals."""
    sizes = np.bincount(assignment, minlength=len(centre))
    offset = position.astype(np.float64) - centre[assignment]
    normals = axis.astype(np.float64)
    height = np.einsum("nc,nc->n", offset, normals[assignment])
    flat = offset - height[:, None] * normals[assignment]
    moments = _means(np.einsum("na,nb->nab", flat, flat).reshape(-1, 9), assignment, sizes).reshape(-1, 3, 3)
    # The normal is the direction of the smallest, because negative, moment.
    _, vectors = np.linalg.eigh(
        moments - (np.trace(moments, axis1=1, axis2=2)[:, None, None] + 1) * np.einsum("ma,mb->mab", normals, normals)
    )
    first = vectors[:, :, 2]
    frame = np.stack([first, np.cross(normals, first), normals], axis=1)
    along = np.einsum("nc,nac->na", flat, frame[assignment][:, :2])
    low, high = np.zeros((2, len(centre), 2))
    np.minimum.at(low, assignment, along)
    np.maximum.at(high, assignment, along)
    depth, spread = np.zeros(len(centre)), np.ones(len(centre))
    np.maximum.at(depth, assignment, np.abs(height))
    np.minimum.at(spread, assignment, np.einsum("nc,nc->n", normal.astype(np.float64), normals[assignment]))
    f = np.float32
    return AreaLights(centre, frame.astype(f), ((high - low) / 2).astype(f), depth.astype(f), spread.astype(f), assignment, medoid)
