"""Which part of the cached light virtual lights carry to a point, and what is left to gather rays."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..jit import kernel
from ..threads import thread_count

# What half of the paths tells of a cell beyond so many times what the other half knows of it, and beyond the view's mean light, is
# a rare path: it is spread over the cells of the next coarser one.  In one cell it would be a spark.
RARE = np.float32(2.0)
# A virtual light is too strong that would give so many times the view's mean light at a tenth of its size: it stands for a place that few
# particles reach, and would be a spark on what little of the view it sees.
STRONG = 20.0
NEAREST = 64  # lights that tell how strong those of a cell are: where sun and sky are focused, one in fifty may have most of the power
ALIKE = 3.0  # squared distance of a cell from the middle of its lights, by their squared deviation, up to which they tell of it as they are
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_THIRD = np.float32(1 / 3)


def divided(
    halves: np.ndarray, shine: np.ndarray, first: np.ndarray, beneath: np.ndarray, through: np.ndarray,
    counts: np.ndarray, bright: np.ndarray, number: np.ndarray, tau: np.float32, parent: np.ndarray, later: np.float32, relied: np.float32,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """`sent` (C, 3 G) and `lit` (C, 3 G) of a light cache, `shine` and `reflected` (C, 3 G) of its links, and `share` (C,).

    halves: (2, C, 3 G) W/m^2, the light that gather rays look up, as half of the paths tells it.  shine: (2, C, 3 G), the part of that
    which virtual lights carry in any case.  first: (2, C, 3 G), the part of it that has left no other surface before; of the rest, lights carry
    `later` times what they else would.  beneath: (2, C, 3 G), the part of `first` that they have none of.  through: (2, C, 3 G), the part
    of the rest that they have none of.  counts: (2, C), how much of each cell either half knows, 1 in all.  bright: (2, C), how
    bright each cell is as the *other* half tells it.  number: (C,), the weight of each cell's probes.  parent: (C,), the next coarser
    cell, -1 for none.  relied: the part of all other light that lights carry, too.
    """
    sent, lit, thrown, reflected, share = *(np.zeros_like(halves[0]) for _ in range(4)), np.zeros(len(parent), np.float32)
    rare = np.zeros((len(parent), 4 * sent.shape[1]), np.float32)
    _divide(halves, shine, first, beneath, through, counts, bright, parent, tau, np.float32(later), np.float32(relied), sent, lit, thrown, reflected, share, rare)  # fmt: skip
    if rare.any():
        _spread(rare, number, parent, np.zeros_like(rare))
        for k, out in enumerate((sent, lit, thrown, reflected)):
            out += rare[:, k * out.shape[1] : (k + 1) * out.shape[1]]
    return sent, lit, thrown, reflected, share


@kernel
def _divide(
    halves, shine, first, beneath, through, counts, bright, parent, tau, later, relied, sent, lit, thrown, reflected, share, rare,
):  # fmt: skip
    """Fills sent, lit, thrown, reflected (C, 3 G) and share (C,); rare (C, 12 G): what of each is to be spread over the cells beside."""
    width = halves.shape[2]
    for h in range(2):
        for c in range(len(parent)):
            part, own, known = bright[h, c] / (bright[h, c] + tau), _0, counts[h, c]
            part += relied * (_1 - part)
            for k in range(width):
                own += halves[h, c, k]
            own *= _THIRD
            bound = RARE * bright[h, c] + tau
            beyond = _0
            if own > bound and parent[c] >= 0:
                beyond = _1 - bound / own
            share[c] += known * part
            for k in range(width):
                light, straight, glossy = known * halves[h, c, k], known * first[h, c, k], known * shine[h, c, k]
                mirrored = known * through[h, c, k]
                direct = straight - known * beneath[h, c, k]
                lights = part * (direct + later * (light - straight - mirrored)) + (_1 - part) * glossy
                sent[c, k] += (_1 - beyond) * light
                lit[c, k] += (_1 - beyond) * lights
                thrown[c, k] += (_1 - beyond) * glossy
                reflected[c, k] += (_1 - beyond) * mirrored
                if beyond > _0:
                    rare[c, k] += beyond * light
                    rare[c, width + k] += beyond * lights
                    rare[c, 2 * width + k] += beyond * glossy
                    rare[c, 3 * width + k] += beyond * mirrored


def strengths(flux: np.ndarray, tau: float, places: np.ndarray) -> np.ndarray:
    """How strong lights of a flux (M, 3) W are for a view, (M,) float32, whose mean light is tau and light comes from places (N, 3): `STRONG` is 1."""
    low, high = np.quantile(places, (0.1, 0.9), axis=0)
    strong = np.float32(STRONG * np.pi * tau * (0.1 * float(np.sort(high - low)[1])) ** 2)
    power = np.einsum("mc->m", flux) * np.float32(1 / 3)
    return power / strong if strong > 1e-30 else np.zeros_like(power)  # of a single place nothing is known


def trusted(
    strength: np.ndarray, position: np.ndarray, normal: np.ndarray, side: np.ndarray, root: np.ndarray, centre: np.ndarray,
    side_of: np.ndarray, size: float, threads: int = 0,
) -> np.ndarray:  # fmt: skip
    """How much of what lights could carry is left to them in each cell, (C,) float32: little where they are strong.

    strength, side (M,), position, normal (M, 3): of lights that left one surface, M > 0.  root: (C,), the coarsest cell around each, which
    all share its trust.  centre: (C, 6), side_of: (C,), middles, normals and sides of the cells.  size: of the coarsest (m).
    """
    cells, of = np.unique(root, return_inverse=True)
    middle = centre[cells].astype(np.float64)
    # A light of another normal counts as one that lies a good way off, one of another surface as one that lies farther than any.
    extent = np.ptp(np.vstack([position, middle[:, :3]]), axis=0).max()
    scale = extent * np.array([0.1, 0.1, 0.1, 10.0])
    kinds = np.unique(side)
    kind = [np.searchsorted(kinds, which) for which in (side, side_of[cells])]
    tree = cKDTree(np.column_stack([position, scale * np.column_stack([normal, kind[0]])]))
    _, near = tree.query(
        np.column_stack([middle[:, :3], scale * np.column_stack([middle[:, 3:], kind[1]])]),
        k=min(NEAREST, len(strength)),
        workers=thread_count(threads),
    )
    strong = strength.astype(np.float64)[near.reshape(len(cells), -1)]
    # Strong lights are few where weak ones are many: each counts by the surface for which it stands.
    strong = (strong * strong).sum(axis=1) / np.maximum(strong.sum(axis=1), 1e-30)
    # Lights that lie all on one side, far from the cell by how wide they lie, tell nothing of what lights there are in it, as round a corner.
    around = position.astype(np.float64)[near.reshape(len(cells), -1)]
    centroid = around.mean(axis=1)
    away = np.maximum(0, np.sqrt(((centroid - middle[:, :3]) ** 2).sum(axis=-1)) - size)
    wide = size * size + ((around - centroid[:, None]) ** 2).sum(axis=-1).mean(axis=1)
    strong *= np.minimum(1, ALIKE * wide / np.maximum(away * away, 1e-30))
    return (1 / (1 + strong**2)).astype(np.float32)[of]


@kernel
def _spread(light, number, parent, sums):
    """The mean of the light (C, K), weighed by `number` (C,), over the cells that have the same parent, into all of these; sums: (C, K) zeros."""
    weights = np.zeros(len(parent), np.float32)
    for i in range(len(parent)):
        up = parent[i]
        if up >= 0:
            weights[up] += number[i]
            for k in range(light.shape[1]):
                sums[up, k] += number[i] * light[i, k]
    for i in range(len(parent)):
        up = parent[i]
        if up >= 0:
            for k in range(light.shape[1]):
                light[i, k] = sums[up, k] / max(weights[up], np.float32(1e-20))
