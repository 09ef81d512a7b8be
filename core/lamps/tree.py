"""Choosing among many emitters: bounds of their light on a point, and a tree of such bounds.

Conty Estevez & Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting", section 5: the
importance of a cluster.  It is zero only where no light can arrive, so that every emitter that matters is possible.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, leaf
from .tables import AGAINST, AXIS, COS_E, COS_O, ENERGY, LOWER, PLANE, UPPER

CUT = 32  # nodes of a point's cut through the tree
CANDIDATES = 3
_FINE = np.float32(64.0)  # nodes above this fraction of the total are opened
_ROUNDING = np.float32(1e-6)  # of a coordinate: on a plane, to so much of it, no light arrives that counts

_0 = np.float32(0.0)
_1 = np.float32(1.0)
_HALF = np.float32(0.5)


@inlined
def _cos_less(cos_a, cos_b):
    """cos(max(0, a - b)) of two angles in 0..pi."""
    if cos_a >= cos_b:
        return _1
    sines = np.float32(math.sqrt(max(_0, (_1 - cos_a * cos_a) * (_1 - cos_b * cos_b))))
    return cos_a * cos_b + sines


@inlined
def _sent(nodes, node, cosine, cos_u):
    """Bound of the cosine at which light leaves a node at `cosine` from its axis, seen within a cone of `cos_u`; 0 where none can."""
    cosine = _cos_less(_cos_less(cosine, nodes[node, COS_O]), cos_u)
    # A little slack: the cone's edge must not fall to rounding.
    return max(cosine, np.float32(1e-3)) if cosine >= nodes[node, COS_E] - np.float32(1e-4) else _0


@leaf
def importance(nodes, two_sided, node, px, py, pz, nx, ny, nz):
    """Estimate of the irradiance (mean of the channels) that a node can send to p with normal n; 0 if it cannot."""
    return importance_around(nodes, two_sided, node, px, py, pz, _0, nx, ny, nz)


@leaf
def importance_around(nodes, two_sided, node, px, py, pz, around, nx, ny, nz):
    """The same for a point that may lie up to `around` (m) beside p; 0 only if the node can send nothing to any of these."""
    # Beside a lamp that hangs from it the ceiling is within its bounding sphere, but wholly behind it.
    beyond = _ROUNDING * (abs(px) + abs(py) + abs(pz)) - around
    ax, ay, az = nodes[node, AXIS], nodes[node, AXIS + 1], nodes[node, AXIS + 2]
    behind = px * ax + py * ay + pz * az - nodes[node, PLANE] <= beyond
    against = nodes[node, AGAINST]
    if behind and not against > _0:
        return _0
    lx, ly, lz = nodes[node, LOWER], nodes[node, LOWER + 1], nodes[node, LOWER + 2]
    ux, uy, uz = nodes[node, UPPER], nodes[node, UPPER + 1], nodes[node, UPPER + 2]
    vx, vy, vz = _HALF * (lx + ux) - px, _HALF * (ly + uy) - py, _HALF * (lz + uz) - pz
    if vx * nx + vy * ny + vz * nz + _HALF * ((ux - lx) * abs(nx) + (uy - ly) * abs(ny) + (uz - lz) * abs(nz)) <= beyond:
        return _0
    r2 = np.float32(0.25) * ((ux - lx) ** 2 + (uy - ly) ** 2 + (uz - lz) ** 2)
    if around > _0:
        r2 = (np.float32(math.sqrt(r2)) + around) ** 2
    d2 = vx * vx + vy * vy + vz * vz
    if d2 <= r2 * np.float32(1.0001):  # within the bounding sphere anything is possible
        return (against if behind else _1) * nodes[node, ENERGY] / max(r2, np.float32(1e-12))
    inverse = _1 / np.float32(math.sqrt(d2))
    cos_u = np.float32(math.sqrt(_1 - r2 / d2))
    cos_i = _cos_less((vx * nx + vy * ny + vz * nz) * inverse, cos_u)
    if cos_i <= _0:
        return _0
    cosine = -(vx * ax + vy * ay + vz * az) * inverse
    if two_sided[node]:
        cosine = abs(cosine)
    sent = _0 if behind else _sent(nodes, node, cosine, cos_u)
    if against > _0:
        sent = max(sent, against * _sent(nodes, node, -cosine, cos_u))
    return nodes[node, ENERGY] * cos_i * sent / d2


@leaf
def cut_for(nodes, two_sided, children, root, px, py, pz, around, nx, ny, nz, members, cdf):
    """A cut through the tree for one point, and what lies up to `around` beside it, finer where more light comes from -> (number of nodes, sum).

    members: (CUT,) int32, cdf: (CUT,) float32 are filled with nodes and the running sums of their importances.
    Inner nodes know little of what comes from them; those of more than an average share are opened.
    """
    n = nodes.shape[0] - children.shape[0]
    members[0] = root
    cdf[0] = importance_around(nodes, two_sided, root, px, py, pz, around, nx, ny, nz)
    total = cdf[0]
    size = 1
    at = 0
    while at < size:
        node = members[at]
        if node >= n and cdf[at] > _0 and size < members.shape[0] and cdf[at] * _FINE > total:
            left, right = children[node - n, 0], children[node - n, 1]
            a = importance_around(nodes, two_sided, left, px, py, pz, around, nx, ny, nz)
            b = importance_around(nodes, two_sided, right, px, py, pz, around, nx, ny, nz)
            total += a + b - cdf[at]
            members[at], cdf[at] = left, a
            members[size], cdf[size] = right, b
            size += 1
        else:
            at += 1
    total = _0
    for k in range(size):
        total += cdf[k]
        cdf[k] = total
    return size, total


@leaf
def descend(nodes, two_sided, children, root, px, py, pz, nx, ny, nz, u):
    """An emitter below a node for p with normal n -> (emitter or -1, its probability); u in [0, 1)."""
    n = nodes.shape[0] - children.shape[0]
    node = root
    probability = _1
    while node >= n:
        left, right = children[node - n, 0], children[node - n, 1]
        a = importance(nodes, two_sided, left, px, py, pz, nx, ny, nz)
        b = importance(nodes, two_sided, right, px, py, pz, nx, ny, nz)
        if not a + b > _0:
            return -1, _1
        share = a / (a + b)
        if u < share:
            node = left
            u = u / share
            probability *= share
        else:
            node = right
            u = (u - share) / (_1 - share)
            probability *= _1 - share
        u = min(u, np.float32(0.99999994))
    return node, probability


@leaf
def choose(nodes, two_sided, children, px, py, pz, nx, ny, nz, members, cdf, size, u, pick):
    """An emitter of the tree for p with normal n -> (emitter or -1, 1 / probability).

    members, cdf, size: from `cut_for`.  u, pick: uniform in [0, 1).
    Of CANDIDATES drawn from the cut one is kept in proportion to its own importance (resampled importance sampling,
    Talbot et al. 2005): what inner nodes misjudge averages out before a ray is spent on it.
    """
    total = cdf[size - 1]
    kept, kept_importance, weight_sum = -1, _0, _0
    for j in range(CANDIDATES):
        v = u + np.float32(j) / np.float32(CANDIDATES)
        v = (v - _1 if v >= _1 else v) * total
        low, high = 0, size - 1
        while low < high:
            middle = (low + high) >> 1
            if cdf[middle] > v:
                high = middle
            else:
                low = middle + 1
        before = cdf[low - 1] if low > 0 else _0
        share = cdf[low] - before
        if not share > _0:
            continue
        rest = min(max((v - before) / share, _0), np.float32(0.99999994))
        e, probability = descend(nodes, two_sided, children, members[low], px, py, pz, nx, ny, nz, rest)
        own = importance(nodes, two_sided, e, px, py, pz, nx, ny, nz) if e >= 0 else _0
        if not own > _0:
            continue
        w = own * total / (share * probability)
        weight_sum += w
        chance = w / weight_sum
        if pick < chance:
            kept, kept_importance = e, own
            pick = pick / chance
        else:
            pick = (pick - chance) / (_1 - chance)
        pick = min(pick, np.float32(0.99999994))
    if kept < 0:
        return -1, _0
    return kept, weight_sum / (np.float32(CANDIDATES) * kept_importance)


@leaf
def cut_estimate(nodes, two_sided, cut, px, py, pz, nx, ny, nz):
    """Estimate of the irradiance that the whole tree can send, from a cut through it; 0 if it cannot."""
    total = _0
    for k in range(cut.shape[0]):
        total += importance(nodes, two_sided, cut[k], px, py, pz, nx, ny, nz)
    return total
