"""Which light can matter to a view at all: none that lies in a room to which no path through the empty space leads."""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..lamps import Emitters
from ..lamps.emission import shares
from ..lamps.tables import CASTS_SHADOW, CORNERS, POSITION, RADIUS, SIZE, WORLD
from ..particles import Vpls
from ..sampling.discrete import cumulative
from ..scene import SHADOW, SUN
from ..view.points import ShadingPoints
from .build import Topology


def rooms_seen(topology: Topology, points: ShadingPoints) -> np.ndarray:
    """(rooms,) bool: which rooms the shading points look into."""
    seen = np.zeros(topology.rooms, bool)
    at = topology.rooms_at(points.position, points.ng)
    seen[at[at >= 0]] = True
    return seen


def reachable_vpls(topology: Topology, seen: np.ndarray, vpls: Vpls) -> np.ndarray:
    """(M,) bool: VPLs in the rooms `seen` (rooms,), or in none that is known."""
    room = topology.rooms_at(vpls.position, vpls.surface_normal)
    return (room < 0) | seen[room]


@kernel
def _touches(node_of, room, seen, low, high):
    """Whether a box of voxels, corners included, holds one of a room that is seen, or none of any room."""
    nz, ny, nx = node_of.shape
    if low[0] < 0 or low[1] < 0 or low[2] < 0 or high[0] >= nx or high[1] >= ny or high[2] >= nz:
        return True
    some = False
    for k in range(low[2], high[2] + 1):
        for j in range(low[1], high[1] + 1):
            for i in range(low[0], high[0] + 1):
                node = node_of[k, j, i]
                if node >= 0:
                    some = True
                    if seen[room[node]]:
                        return True
    return not some


@kernel
def _reach(node_of, room, seen, low, high, out):
    for e in range(len(out)):
        if not out[e]:
            out[e] = _touches(node_of, room, seen, low[e], high[e])


def reachable_emitters(topology: Topology, seen: np.ndarray, emitters: Emitters) -> np.ndarray:
    """(E,) bool: emitters whose light may get into the rooms `seen` (rooms,); those without shadows, or with those of some objects only, shine through walls."""
    corners = emitters.shapes[:, CORNERS : CORNERS + 9].reshape(-1, 3, 3)
    lamps = emitters.lamps
    around = np.maximum(lamps[:, RADIUS], np.hypot(lamps[:, SIZE], lamps[:, SIZE + 1]) / 2)[:, None]
    at = lamps[:, POSITION : POSITION + 3]
    away = np.zeros((emitters.first_triangle - len(lamps), 3), np.float32)  # the world
    low = topology.grid.cell_of(np.concatenate([at - around, away, corners.min(axis=1)])) - 1
    high = topology.grid.cell_of(np.concatenate([at + around, away, corners.max(axis=1)])) + 1
    # A surface that shines touches its own voxels and those on either side of them.
    distant = (emitters.kind == SUN) | (emitters.kind == WORLD) | ((emitters.flags & CASTS_SHADOW) == 0) | (emitters.shadow_kinds != SHADOW)
    _reach(topology.node_of, topology.room, seen, low, high, distant)
    return distant


def without_emitters(emitters: Emitters, kept: np.ndarray) -> Emitters:
    """Emitters of which only those `kept` (E,) emit particles; direct light leaves out the others that it samples one by one."""
    flux = emitters.flux * kept[:, None]
    groups = emitters.groups[(emitters.groups < 0) | kept[emitters.groups]]
    return emitters._replace(flux=flux, emission_cdf=cumulative(shares(flux, emitters.flags), np.float64), groups=groups)
