"""Visibility gates: where light passes from one visibility cluster into the next (paper, Section IV.C).

A disk on every edge of the segmented skeleton between two clusters, as in the paper; or a polygon fitted to each opening, which is
the set of voxel faces where two clusters meet.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from .segmentation import Segmented
from .skeleton import Skeleton
from .voxels import Grid

CELLS = 16  # of an opening's raster, along either side
SIDES = 12  # of a polygon: half-planes in fixed directions about its centre
DIRECTIONS = np.stack([np.cos(2 * np.pi * np.arange(SIDES) / SIDES), np.sin(2 * np.pi * np.arange(SIDES) / SIDES)], 1).astype(np.float32)

_BULGE, _BULGE_SHARE = 8.0, 0.7  # voxels, and of its own reach, that a flat piece of an opening may leave its plane
_FEWEST = 128  # faces of a piece that is cut


class Gates(NamedTuple):
    """G gates, each in a plane.

    clusters: (G, 2) int32, on the side the normal comes from and on the side it points to.  centre: (G, 3) float32 (m).
    frame: (G, 3, 3) float32, unit vectors u, v, normal.  radius: (G,) float32 (m), of the disk, or of the circle round the polygon.
    extent: (G, SIDES) float32 (m), how far a polygon reaches along DIRECTIONS in (u, v); all radii of a disk.
    raster: (G, CELLS) uint16, which cells of the polygon's bounding rectangle the opening covers: bit i of row j is the cell i along u
        and j along v; all of a disk's.
    """

    clusters: np.ndarray
    centre: np.ndarray
    frame: np.ndarray
    radius: np.ndarray
    extent: np.ndarray
    raster: np.ndarray

    def scaled(self, factor: float) -> Gates:
        """Gates of `factor` times the size, about their centres."""
        factor = np.float32(factor)
        return self._replace(radius=self.radius * factor, extent=self.extent * factor)

    def outlines(self) -> np.ndarray:
        """(G, SIDES, 3) corners of the polygons (m): where neighbouring half-planes meet."""
        following = np.roll(self.extent, -1, axis=1)
        c, s = np.cos(2 * np.pi / SIDES), np.sin(2 * np.pi / SIDES)
        along = (following - c * self.extent) / s
        u = self.extent[..., None] * DIRECTIONS + along[..., None] * np.stack([-DIRECTIONS[:, 1], DIRECTIONS[:, 0]], 1)
        return self.centre[:, None] + u[..., :1] * self.frame[:, None, 0] + u[..., 1:] * self.frame[:, None, 1]


def frames_about(normal: np.ndarray) -> np.ndarray:
    """(G, 3, 3) float32 right-handed unit vectors u, v, n about unit normals (G, 3)."""
    least = np.abs(normal).argmin(axis=1)
    u = np.cross(normal, np.eye(3)[least])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return np.stack([u, np.cross(normal, u), normal], axis=1).astype(np.float32)


def disk_gates(grid: Grid, skeleton: Skeleton, segmented: Segmented, cluster: np.ndarray) -> Gates:
    """A disk in the middle of each edge between two clusters, across it, of the smaller ball's radius."""
    edges = segmented.edges[cluster[segmented.edges[:, 0]] != cluster[segmented.edges[:, 1]]]
    a, b = (grid.position_of(skeleton.place[segmented.node[edges[:, k]]]) for k in (0, 1))
    along = b - a
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    radius = (grid.size * skeleton.radius[segmented.node[edges]].min(axis=1)).astype(np.float32)
    extent = np.repeat(radius[:, None], SIDES, axis=1)
    return Gates(
        cluster[edges].astype(np.int32), ((a + b) / 2).astype(np.float32), frames_about(along), radius, extent, _all_open(len(radius))
    )


def gates_by_cluster(gates: Gates, clusters: int) -> tuple[np.ndarray, np.ndarray]:
    """The gates of each cluster: first (clusters + 1,) int32, and (2 G,) int32 gates, cluster by cluster."""
    owner = gates.clusters.ravel()
    order = np.argsort(owner, kind="stable")
    first = np.zeros(clusters + 1, np.int32)
    np.cumsum(np.bincount(owner, minlength=clusters), out=first[1:])
    return first, (order // 2).astype(np.int32)


def _all_open(count: int) -> np.ndarray:
    return np.full((count, CELLS), 0xFFFF, np.uint16)


def _rasters(extent: np.ndarray, which: np.ndarray, uv: np.ndarray, half: np.ndarray) -> np.ndarray:
    """(G, CELLS) uint16 rasters of voxel faces (F, 2) in the planes of the gates `which` (F,).

    half: (F, 2) half the size of each face's shadow in its plane; it marks the cells under 5 x 5 places of it, as many as it can cover.
    """
    low = -extent[:, [SIDES // 2, 3 * SIDES // 4]].astype(np.float64)
    size = extent[:, [0, SIDES // 4]] - low
    out = np.zeros((len(extent), CELLS), np.uint16)
    steps = np.linspace(-1, 1, 5)
    for step in ((a, b) for a in steps for b in steps):
        cell = ((uv + half * step - low[which]) / size[which] * CELLS).astype(int).clip(0, CELLS - 1)
        np.bitwise_or.at(out, (which, cell[:, 1]), np.uint16(1) << cell[:, 0].astype(np.uint16))
    return out


def _openings(cluster: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Voxel faces between clusters (Z, Y, X) int32: their pairs (F, 2), lower cluster first; places (F, 3) of their middles in
    half voxels; and axes with sign (F,), +-1 to +-3, from the lower cluster to the other."""
    pairs, places, signs = [], [], []
    for axis in range(3):
        low = np.moveaxis(cluster, 2 - axis, 0)[:-1]
        high = np.moveaxis(cluster, 2 - axis, 0)[1:]
        at = np.argwhere((low != high) & (low >= 0) & (high >= 0))
        a, b = low[tuple(at.T)], high[tuple(at.T)]
        order = [k for k in range(3) if k != 2 - axis]
        zyx = np.empty_like(at)
        zyx[:, 2 - axis] = at[:, 0] + 1
        zyx[:, order[0]], zyx[:, order[1]] = at[:, 1], at[:, 2]
        half = 2 * zyx[:, ::-1] + 1
        half[:, axis] -= 1
        pairs.append(np.stack([np.minimum(a, b), np.maximum(a, b)], 1))
        places.append(half)
        signs.append(np.where(a < b, axis + 1, -axis - 1))
    return np.concatenate(pairs), np.concatenate(places), np.concatenate(signs)


def _connected(pairs: np.ndarray, places: np.ndarray, signs: np.ndarray, shape) -> np.ndarray:
    """(F,) the opening of each face: faces of one pair that share an edge are one."""
    count = len(pairs)
    span = 2 * np.array(shape) + 2
    axis = np.abs(signs) - 1
    keys, owners = [], []
    for step in (1, 2):
        for side in (-1, 1):
            middle = places.copy()
            middle[np.arange(count), (axis + step) % 3] += side
            keys.append((middle[:, 2] * span[1] + middle[:, 1]) * span[0] + middle[:, 0])
            owners.append(np.arange(count))
    key, owner = np.concatenate(keys), np.concatenate(owners)
    order = np.lexsort((pairs[owner, 1], pairs[owner, 0], key))
    key, owner = key[order], owner[order]
    same = (key[1:] == key[:-1]) & (pairs[owner[1:]] == pairs[owner[:-1]]).all(axis=1)
    links = scipy.sparse.coo_array((np.ones(same.sum(), np.int8), (owner[:-1][same], owner[1:][same])), (count, count))
    return scipy.sparse.csgraph.connected_components(links, directed=False)[1]


def _flat(opening: np.ndarray, places: np.ndarray, signs: np.ndarray) -> np.ndarray:
    """(F,) the flat piece of an opening that each face belongs to: those that bulge are cut in two across their longest way, again and again.

    A line that crosses a bulging opening need not cross the plane through its middle.
    """
    at = places / 2
    axes = np.sign(signs)[:, None] * np.eye(3)[np.abs(signs) - 1]
    piece = np.unique(opening, return_inverse=True)[1].ravel()
    open_ = np.ones(piece.max(initial=-1) + 1, bool)
    while open_.any():
        count = len(open_)
        size = np.bincount(piece, minlength=count)
        mean = _sums(piece, at, count) / size[:, None]
        normal = _sums(piece, axes, count)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        away = at - mean[piece]
        bulge, reach = np.zeros(count), np.zeros(count)
        np.maximum.at(bulge, piece, np.abs((away * normal[piece]).sum(axis=1)))
        np.maximum.at(reach, piece, np.linalg.norm(away, axis=1))
        # Where normals cancel each other out there is no plane at all.
        turned = np.linalg.norm(_sums(piece, axes, count), axis=1) < 0.5 * size
        open_ &= (size >= _FEWEST) & (turned | (bulge > np.maximum(_BULGE, _BULGE_SHARE * reach)))
        covariance = _sums(piece, (away[:, :, None] * away[:, None]).reshape(-1, 9), count).reshape(-1, 3, 3)
        longest = np.linalg.eigh(covariance)[1][:, :, 2]
        beyond = open_[piece] & ((away * longest[piece]).sum(axis=1) > 0)
        fresh = np.cumsum(open_) - 1 + count
        piece = np.where(beyond, fresh[piece], piece)
        open_ = np.concatenate([open_, np.ones(int(open_.sum()), bool)])
    return piece


def _sums(group: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count, C) sums of values (F, C) by group (F,)."""
    return np.stack([np.bincount(group, column, count) for column in values.T], axis=1)


def polygon_gates(grid: Grid, cluster: np.ndarray) -> Gates:
    """A convex polygon round each opening between two clusters, in the plane through its middle across its mean normal.

    cluster: (Z, Y, X) int32 of each voxel, negative in solid ones.
    """
    pairs, places, signs = _openings(cluster)
    if not len(pairs):
        e = np.empty
        return Gates(e((0, 2), np.int32), *(e((0, *s), np.float32) for s in ((3,), (3, 3), (), (SIDES,))), _all_open(0))
    opening = _flat(_connected(pairs, places, signs, grid.shape), places, signs)
    order = np.argsort(opening, kind="stable")
    pairs, places, signs, opening = pairs[order], places[order], signs[order], opening[order]
    start = np.flatnonzero(np.diff(opening, prepend=-1))
    size = np.diff(start, append=len(opening))
    metres = grid.position_of(places / 2)
    centre = np.add.reduceat(metres, start) / size[:, None]
    axes = np.sign(signs)[:, None] * np.eye(3)[np.abs(signs) - 1]
    normal = np.add.reduceat(axes, start)
    # A closed surface has no mean normal: any plane through its middle is as good as another.
    normal[~normal.any(axis=1)] = (0, 0, 1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    frame = frames_about(normal)
    which = np.repeat(np.arange(len(start)), size)
    away = metres - centre[which]
    u = np.einsum("fc,fdc->fd", away, frame[which, :2])
    reach = u @ DIRECTIONS.T.astype(np.float64) + 0.5 * grid.size
    extent = np.maximum.reduceat(reach, start)
    # Cells are a quarter of a voxel at least: the raster, not the polygon, shows what is smaller.
    extent = np.maximum(extent, CELLS / 8 * grid.size).astype(np.float32)
    # What a face's square casts on u and v: its sides lie along the other two axes.
    sides = 1 - np.eye(3)[np.abs(signs) - 1]
    half = 0.45 * grid.size * np.einsum("fc,fdc->fd", sides, np.abs(frame[which, :2]))
    raster = _rasters(extent, which, u, half)
    gates = Gates(pairs[start].astype(np.int32), centre.astype(np.float32), frame, np.zeros(len(start), np.float32), extent, raster)
    radius = np.linalg.norm(gates.outlines() - gates.centre[:, None], axis=2).max(axis=1)
    return gates._replace(radius=radius.astype(np.float32))
