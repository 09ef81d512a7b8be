"""Which lamps of the tree the points of a chunk see: a few shadow rays tell, before all of the others are dealt.

Where walls hide most lamps, the tree's bounds send most rays into these walls.  What the rays of a pilot find scales the energies by which
lamps are chosen, never down to nothing, so that the light of each lamp is right in the mean, however wrong the pilot is.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import leaf
from .tables import ENERGY

LEAST = np.float32(1 / 64)  # share of its light that a lamp is taken to show at least
_PRIOR = np.float32(1.0)  # rays that what is known of all lamps beside a lamp counts for
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@leaf
def learn(tree, tried, seen, share, nodes):
    """Scales the energies of `nodes` by what M rays to its lamps have found.

    tree: LightTree.  nodes: (K, NODE) float32, a copy of its nodes.
    tried, seen: (K,) float32, rays to each emitter and how many of them got there; rows of inner nodes are written.

    A point for which lamp e may send c_e, and does with probability v_e, has the least variance where e is chosen in proportion to
    c_e sqrt(v_e).  v of a node is that of the rays to what is below it, and of the node above, as if one more ray had found that.
    """
    n = nodes.shape[0] - tree.children.shape[0]
    for k in range(tree.children.shape[0] - 1, -1, -1):  # children come after their parents
        left, right = tree.children[k, 0], tree.children[k, 1]
        tried[n + k], seen[n + k] = tried[left] + tried[right], seen[left] + seen[right]
    share[tree.root] = (seen[tree.root] + _PRIOR) / (tried[tree.root] + _PRIOR)
    for k in range(tree.children.shape[0]):
        for side in range(2):
            node = tree.children[k, side]
            share[node] = (seen[node] + _PRIOR * share[n + k]) / (tried[node] + _PRIOR)
            if node < n:
                nodes[node, ENERGY] *= np.float32(math.sqrt(max(LEAST, share[node])))
    for k in range(tree.children.shape[0] - 1, -1, -1):
        nodes[n + k, ENERGY] = nodes[tree.children[k, 0], ENERGY] + nodes[tree.children[k, 1], ENERGY]
