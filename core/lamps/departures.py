"""Where the shadow rays of a shading point leave: from places all over the surface that its pixel shows, by what the surface is like at each.

One place would make a hard edge of a shadow's, and one normal and one albedo lose what they have in common with the light: what a
pixel shows of a lit surface is turned to the lamp, and often the brighter part of a pattern.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined
from ..sampling.hashing import hash_combine

TURNS, FACES, REFLECTS, VARIED = 0, 3, 6, 7  # columns of `ShadingPoints.varied`
SAME_FACET = np.float32(0.97)  # cosine of facets' normals that are lit alike, at least
_PLACES = np.uint32(0x9E4D)
_0 = np.float32(0.0)


@inlined
def on_one_facet(points, i, place):
    """Whether light that reaches one of the places of point i leaves the point's own facet as well: beyond a hard edge it may be behind it."""
    if points.varied.shape[1] == 0:
        return True
    gx, gy, gz = points.ng[i, 0], points.ng[i, 1], points.ng[i, 2]
    faces = points.varied[i, place, FACES:]
    return gx * (gx + faces[0]) + gy * (gy + faces[1]) + gz * (gz + faces[2]) > SAME_FACET


@inlined
def place_of(points, i, index, scramble):
    """Number of one of the places of point i, by the sample's number."""
    places = points.spread.shape[1] + 1
    if places == 1:
        return np.int64(0)
    # All of them in turn, in a new order each time: later coordinates of the sequence would take as long as the rest of the sample.
    # Under a key of its own: by the sequence's scramble itself each place would see another half of every lamp.
    turn = hash_combine(hash_combine(scramble, _PLACES), np.uint32(index) // np.uint32(places))
    return np.int64((np.uint32(index) + turn) % np.uint32(places))


@inlined
def place_for_world(points, i, index, scramble):
    """The same where the point's own facet is lit: of the world all is as gather rays see it, which know but one."""
    place = place_of(points, i, index, scramble)
    return place if on_one_facet(points, i, place) else np.int64(0)


@inlined
def position_at(points, i, place):
    """Position of one of the places of point i."""
    px, py, pz = points.position[i, 0], points.position[i, 1], points.position[i, 2]
    if place > 0:
        px += points.spread[i, place - 1, 0]
        py += points.spread[i, place - 1, 1]
        pz += points.spread[i, place - 1, 2]
    return px, py, pz


@inlined
def differs(points, i, place):
    """Whether the shading normal of one of the places of point i is not the point's own."""
    own = points.varied[i, place]
    return own[TURNS] != _0 or own[TURNS + 1] != _0 or own[TURNS + 2] != _0


@inlined
def surface_at(points, i, place):
    """Shading normal, geometric normal and triangle at one of the places of point i."""
    nx, ny, nz, gx, gy, gz = points.ns[i, 0], points.ns[i, 1], points.ns[i, 2], points.ng[i, 0], points.ng[i, 1], points.ng[i, 2]
    triangle = points.triangle[i]
    if place > 0:
        own = points.varied[i, place]
        nx, ny, nz = nx + own[TURNS], ny + own[TURNS + 1], nz + own[TURNS + 2]
        gx, gy, gz = gx + own[FACES], gy + own[FACES + 1], gz + own[FACES + 2]
        triangle = points.facet[i, place - 1]
    return nx, ny, nz, gx, gy, gz, triangle


@inlined
def is_patterned(points, i):
    """Whether the albedo of point i differs from place to place."""
    for j in range(points.varied.shape[1]):
        if points.varied[i, j, REFLECTS] != _0:
            return True
    return False
