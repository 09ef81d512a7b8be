"""Between which visibility clusters light may pass: paths of gates that lie in line, and then lines between their surfaces.

Airey et al. 1990, "Towards Image Realism with Interactive Update Rates in Complex Building Environments": cells and portals.  Gates and
clusters are replaced by balls round them, which errs towards sight; of the pairs that are left, those are believed of which some lines are free.
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from .cones import ball_meets, cone_through
from .gates import Gates, gates_by_cluster
from .lines import free_shares, samples_of
from .voxels import Grid

_SEEN = 0.05  # of the lines between two clusters that are free, where they are in sight
_PAD = 2.0  # voxels, that the surfaces of a cluster lie beyond its voxels


@kernel
def _bounds(cluster, low, high):
    """The boxes of voxels (clusters, 3) of all clusters (Z, Y, X)."""
    nz, ny, nx = cluster.shape
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                c = cluster[k, j, i]
                if c >= 0:
                    low[c, 0], low[c, 1], low[c, 2] = min(low[c, 0], i), min(low[c, 1], j), min(low[c, 2], k)
                    high[c, 0], high[c, 1], high[c, 2] = max(high[c, 0], i + 1), max(high[c, 1], j + 1), max(high[c, 2], k + 1)


@kernel
def _in_line(ball, one, other, third):
    """Whether some line meets three balls (x, y, z, r), rows of `ball`, in this order."""
    ax, ay, az, ux, uy, uz, cosine, sine = cone_through(
        ball[one, 0], ball[one, 1], ball[one, 2], ball[one, 3], ball[other, 0], ball[other, 1], ball[other, 2], ball[other, 3]
    )
    return ball_meets(ax, ay, az, ux, uy, uz, cosine, sine, ball[third, 0], ball[third, 1], ball[third, 2], ball[third, 3])


@kernel
def _walk(first, of, joins, ball, sight):
    """Follow the gates from every cluster.  ball: (clusters + G, 4) float32, of the clusters, then of the gates."""
    clusters, gates = len(sight), len(joins)
    visited = np.full(gates, -1)
    before, at, into = np.empty(gates + 1, np.int64), np.empty(gates + 1, np.int64), np.empty(gates + 1, np.int64)
    walks = 0
    for a in range(clusters):
        sight[a, a] = True
        for start in of[first[a] : first[a + 1]]:
            walks += 1
            before[0], at[0], into[0] = a, clusters + start, joins[start, 0] + joins[start, 1] - a
            visited[start] = walks
            sight[a, into[0]] = True
            depth = 1
            while depth > 0:
                depth -= 1
                previous, here, room = before[depth], at[depth], into[depth]
                for gate in of[first[room] : first[room + 1]]:
                    if visited[gate] == walks or not _in_line(ball, a, clusters + start, clusters + gate):
                        continue
                    if not _in_line(ball, previous, here, clusters + gate):
                        continue
                    visited[gate] = walks
                    beyond = joins[gate, 0] + joins[gate, 1] - room
                    sight[a, beyond] = True
                    before[depth], at[depth], into[depth] = here, clusters + gate, beyond
                    depth += 1


def sight_of(grid: Grid, cluster: np.ndarray, clusters: int, gates: Gates) -> np.ndarray:
    """(clusters, clusters) bool, symmetric: which clusters see each other, or are neighbours.

    cluster: (Z, Y, X) int32 of each voxel, negative in solid ones.  gates: all openings.
    """
    low, high = np.full((clusters, 3), max(cluster.shape)), np.zeros((clusters, 3), np.int64)
    _bounds(cluster, low, high)
    ball = np.empty((clusters + len(gates.radius), 4), np.float32)
    ball[:clusters, :3] = grid.position_of((low + high) / 2)
    ball[:clusters, 3] = grid.size * (np.linalg.norm(np.maximum(high - low, 0), axis=1) / 2 + _PAD)
    ball[clusters:, :3], ball[clusters:, 3] = gates.centre, gates.radius
    sight = np.zeros((clusters, clusters), bool)
    _walk(*gates_by_cluster(gates, clusters), gates.clusters, ball, sight)
    near = np.eye(clusters, dtype=bool)
    near[gates.clusters[:, 0], gates.clusters[:, 1]] = True
    pairs = np.argwhere(np.triu(sight & sight.T & ~near & ~near.T))
    pairs = pairs[free_shares(cluster, samples_of(cluster, clusters), pairs) >= _SEEN]
    near[pairs[:, 0], pairs[:, 1]] = True
    return near | near.T
