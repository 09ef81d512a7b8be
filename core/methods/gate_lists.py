"""Which VPLs may light which points: clustered shading with visibility clusters and gates (visibility gates paper, Sections V.B, V.C).

Geometry clusters are runs of neighbouring shading points of one visibility cluster, blocks are runs of neighbouring VPLs of one;
both have a bounding sphere.  What leaves a block through a gate stays within a cone, and so does what leaves a single VPL: tests go from
groups of geometry clusters and whole blocks down to single ones, and find bits of VPLs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..particles import Vpls
from ..rays.order import morton_order
from ..topology import SOLID, Gates, Topology, gates_by_cluster
from ..topology.bits import pack
from ..topology.cones import ball_meets, cone_through
from ..view.points import ShadingPoints

POINTS = 64  # of a geometry cluster at most
LANES = 16  # VPLs of a block at most, bits of a mask
PLACES = 4  # points of a geometry cluster that stand for it
GROUP = 16  # geometry clusters that are tested together first
NO_GATE = -1  # VPL and points are in the same visibility cluster
LINES = -2  # no gate leads from one to the other's, but they see each other: only lines of voxels tell
LEAVING = 1 << 29  # on the number of a gate by which a line leaves the VPL's cluster, if it also enters the points' by one
ENTERING = 1 << 30  # on the number of such a gate of the points' cluster
NUMBER = LEAVING - 1  # the bits of the gate itself
_ALL = np.uint32((1 << LANES) - 1)
_0 = np.float32(0.0)
_1 = np.float32(1.0)


class Runs(NamedTuple):
    """R runs of neighbours of one visibility cluster.

    order: (N,) int64, given items run by run.  first: (R + 1,) int64.  cluster: (R,) int32.
    centre: (R, 3), radius: (R,) float32 (m), spheres round the runs.
    """

    order: np.ndarray
    first: np.ndarray
    cluster: np.ndarray
    centre: np.ndarray
    radius: np.ndarray


class Lights(NamedTuple):
    """B blocks of VPLs, each of LANES places; places left over shine black.

    table: (9, B * LANES) float32: position (m), normal, flux / pi (W).  blocks: `Runs` of the VPLs.
    """

    table: np.ndarray
    blocks: Runs


class GateTable(NamedTuple):
    """Gates of each visibility cluster.

    first: (clusters + 1,) int32; of: (2 G,) int32, the gates of a cluster.  gates: `Gates`.
    sight: (clusters, clusters) bool, between which a straight line may pass at all.
    polygons: whether they are polygons.  These are what the openings are, so that light that leaves by one must enter by another, too.
    """

    first: np.ndarray
    of: np.ndarray
    gates: Gates
    sight: np.ndarray
    polygons: bool


class Lines(NamedTuple):
    """Between which voxels lines tell whether light passes.

    empty: (Z, Y, W) uint64, bits of empty voxels (`topology.bits`); no words where lines are not asked.  lights: (B * LANES, 3) int32, the voxel (x, y, z) that each
    VPL looks at.  places: (R, PLACES, 3) int32, those of some points of each geometry cluster (`place_of`).  Below 0 where there is none.
    """

    empty: np.ndarray
    lights: np.ndarray
    places: np.ndarray


class Lists(NamedTuple):
    """What may light each of R geometry clusters, block by block.

    first: (R + 1,) int64.  block, gate: (I,) int32: NO_GATE where no gate lies between, LINES where none leads; gates that let light in alone; then sets of gates
    marked with LEAVING and with ENTERING, of one of which a line passes one of each.  mask: (I,) uint32, VPLs of the block.
    """

    first: np.ndarray
    block: np.ndarray
    gate: np.ndarray
    mask: np.ndarray


def runs_of(position: np.ndarray, normal: np.ndarray, cluster: np.ndarray, most: int) -> Runs:
    """Runs of at most `most` items each, neighbours in space and of normals in one octant."""
    order = morton_order(position, normal)
    order = order[np.argsort(cluster[order], kind="stable")]
    sorted_cluster = cluster[order]
    begins = np.flatnonzero(np.diff(sorted_cluster, prepend=sorted_cluster[:1] - 1))
    place = np.arange(len(order)) - np.repeat(begins, np.diff(begins, append=len(order)))
    first = np.append(np.flatnonzero(place % most == 0), len(order))
    at = position[order]
    low, high = np.minimum.reduceat(at, first[:-1]), np.maximum.reduceat(at, first[:-1])
    centre = ((low + high) / 2).astype(np.float32)
    away = np.linalg.norm(at - np.repeat(centre, np.diff(first), axis=0), axis=1)
    radius = np.maximum.reduceat(away, first[:-1]).astype(np.float32)
    return Runs(order, first, sorted_cluster[first[:-1]], centre, radius * np.float32(1 + 1e-6))


def lights_of(vpls: Vpls, cluster: np.ndarray) -> Lights:
    """The VPLs in blocks; cluster: (M,) int32, the visibility cluster of each."""
    blocks = runs_of(vpls.position, vpls.surface_normal, cluster, LANES)
    place = _columns(blocks)
    table = np.zeros((9, len(blocks.cluster) * LANES), np.float32)
    # Places left over stand where the block's first light does, so that they are as near to any gate.
    table[:3] = np.repeat(vpls.position[blocks.order[blocks.first[:-1]]], LANES, axis=0).T
    table[:, place] = np.concatenate([vpls.position, vpls.normal, vpls.flux / np.float32(np.pi)], axis=1)[blocks.order].T
    return Lights(table, blocks)


def _columns(blocks: Runs) -> np.ndarray:
    """(M,) int64 columns of `Lights.table` in which the VPLs of `blocks.order` are."""
    sizes = np.diff(blocks.first)
    return np.repeat(np.arange(len(sizes)) * LANES - blocks.first[:-1], sizes) + np.arange(len(blocks.order))


def place_of(q, n):
    """The place q of PLACES among n points in order, in the middle of its share."""
    return (2 * q + 1) * n // (2 * PLACES)


def lines_of(topology: Topology, vpls: Vpls, lights: Lights, points: ShadingPoints, runs: Runs) -> Lines:
    """The lines from the VPLs to the geometry clusters' places."""
    voxels = np.full((lights.table.shape[1], 3), SOLID, np.int32)
    voxels[_columns(lights.blocks)] = topology.voxels_at(vpls.position, vpls.surface_normal)[lights.blocks.order]
    at = runs.order[runs.first[:-1, None] + place_of(np.arange(PLACES), np.diff(runs.first)[:, None])]
    places = topology.voxels_at(points.position[at.ravel()], points.ng[at.ravel()])
    return Lines(pack(topology.node_of >= 0), voxels, places.reshape(*at.shape, 3))


def no_lines() -> Lines:
    """Lines that are not asked."""
    return Lines(np.empty((0, 0, 0), np.uint64), np.empty((0, 3), np.int32), np.empty((0, PLACES, 3), np.int32))


def gate_table(gates: Gates, sight: np.ndarray, polygons: bool) -> GateTable:
    """The gates listed for each of the clusters that they join; fields as in `GateTable`."""
    first, of = gates_by_cluster(gates, len(sight))
    return GateTable(first, of, gates, sight, polygons)


@kernel
def cones_of(lights, table):
    """(B, most gates, 8) cones of the blocks through their clusters' gates."""
    blocks, gates = lights.blocks, table.gates
    most = 0
    for c in range(len(table.first) - 1):
        most = max(most, table.first[c + 1] - table.first[c])
    cones = np.empty((len(blocks.cluster), most, 8), np.float32)
    for b in range(len(blocks.cluster)):
        c = blocks.cluster[b]
        if c == SOLID:
            continue
        for k in range(table.first[c], table.first[c + 1]):
            g = table.of[k]
            cones[b, k - table.first[c]] = cone_through(
                blocks.centre[b, 0], blocks.centre[b, 1], blocks.centre[b, 2], blocks.radius[b],
                gates.centre[g, 0], gates.centre[g, 1], gates.centre[g, 2], gates.radius[g],
            )  # fmt: skip
    return cones


@kernel
def _lanes_through(lights, block, gates, g, sx, sy, sz, radius):
    """Bits of the VPLs of a block whose cone through a gate meets a ball."""
    mask = np.uint32(0)
    first = lights.blocks.first[block]
    for lane in range(lights.blocks.first[block + 1] - first):
        j = block * LANES + lane
        x, y, z = lights.table[0, j], lights.table[1, j], lights.table[2, j]
        nx, ny, nz = lights.table[3, j], lights.table[4, j], lights.table[5, j]
        if nx * (sx - x) + ny * (sy - y) + nz * (sz - z) < -radius:
            continue  # behind the light
        ax, ay, az, ux, uy, uz, cosine, sine = cone_through(
            x, y, z, _0, gates.centre[g, 0], gates.centre[g, 1], gates.centre[g, 2], gates.radius[g]
        )
        if ball_meets(ax, ay, az, ux, uy, uz, cosine, sine, sx, sy, sz, radius):
            mask |= np.uint32(1) << np.uint32(lane)
    return mask


@kernel
def _group_sphere(runs, begin, end):
    x = y = z = _0
    for r in range(begin, end):
        x, y, z = x + runs.centre[r, 0], y + runs.centre[r, 1], z + runs.centre[r, 2]
    share = _1 / np.float32(end - begin)
    x, y, z = x * share, y * share, z * share
    radius = _0
    for r in range(begin, end):
        dx, dy, dz = runs.centre[r, 0] - x, runs.centre[r, 1] - y, runs.centre[r, 2] - z
        radius = max(radius, np.sqrt(dx * dx + dy * dy + dz * dz) + runs.radius[r])
    return x, y, z, radius


@inlined
def _beyond(table, cluster, gate):
    """The other cluster that a gate of `cluster` joins."""
    return table.gates.clusters[gate, 0] + table.gates.clusters[gate, 1] - cluster


@kernel
def _candidates(lights, table, cones, cluster, sx, sy, sz, radius, block, gate):
    """Pairs of a block and a gate that may light a ball of points of one cluster; their number."""
    n = 0
    for b in range(len(lights.blocks.cluster)):
        c = lights.blocks.cluster[b]
        if c == cluster or c == SOLID or cluster == SOLID:
            block[n], gate[n] = b, NO_GATE
            n += 1
            continue
        if not table.sight[c, cluster]:
            continue
        before = n
        for k in range(table.first[c], table.first[c + 1]):
            if not table.sight[_beyond(table, c, table.of[k]), cluster]:
                continue
            cone = cones[b, k - table.first[c]]
            if ball_meets(cone[0], cone[1], cone[2], cone[3], cone[4], cone[5], cone[6], cone[7], sx, sy, sz, radius):
                block[n], gate[n] = b, table.of[k]
                n += 1
        if n == before and table.polygons:
            block[n], gate[n] = b, LINES
            n += 1
    return n


@kernel
def _entrances(runs, r, table, cones):
    """Cones from the ball of a geometry cluster through its own gates into `cones` (most gates, 8); their number."""
    c = runs.cluster[r]
    if c == SOLID:
        return 0
    for k in range(table.first[c], table.first[c + 1]):
        g = table.of[k]
        cones[k - table.first[c]] = cone_through(
            runs.centre[r, 0], runs.centre[r, 1], runs.centre[r, 2], runs.radius[r],
            table.gates.centre[g, 0], table.gates.centre[g, 1], table.gates.centre[g, 2], table.gates.radius[g],
        )  # fmt: skip
    return table.first[c + 1] - table.first[c]


@kernel
def _list_block(runs, r, lights, table, block, gates, entrances, found_gate, found_mask):
    """What joins a block to a geometry cluster: gates and masks into `found_gate`, `found_mask`; their number, 0 if nothing does.

    As `_list_gates`; polygons leave it to lines where no gate leads.
    """
    found = 1
    found_gate[0], found_mask[0] = gates[0], _ALL
    if gates[0] >= 0:
        found = _list_gates(runs, r, lights, table, block, gates, entrances, found_gate, found_mask)
        if found == 0 and table.polygons:
            found = 1
            found_gate[0], found_mask[0] = LINES, _ALL
    return found


@kernel
def _list_gates(runs, r, lights, table, block, gates, entrances, found_gate, found_mask):
    """The gates and masks by which light of a block may reach a geometry cluster into `found_gate`, `found_mask`; their number.

    gates: of the block's cluster, candidates.  entrances: cones through the gates of the points' cluster.
    Polygons are listed by the shortest ways: a single gate, then pairs by one cluster between, and only where there is none longer ones.
    """
    blocks, own, cluster = lights.blocks, lights.blocks.cluster[block], runs.cluster[r]
    leaving = np.empty(len(gates), np.int64)
    masks = np.empty(len(gates), np.uint32)
    alone = ways = 0
    for g in gates:
        mask = _lanes_through(lights, block, table.gates, g, runs.centre[r, 0], runs.centre[r, 1], runs.centre[r, 2], runs.radius[r])
        if not mask:
            continue
        if not table.polygons or _beyond(table, own, g) == cluster:
            found_gate[alone], found_mask[alone] = g, mask
            alone += 1
        else:
            leaving[ways], masks[ways] = g, mask
            ways += 1
    if ways == 0:
        return alone
    entering, entries = np.empty(len(entrances), np.int64), 0
    for k in range(len(entrances)):
        g, cone = table.of[table.first[cluster] + k], entrances[k]
        before = _beyond(table, cluster, g)
        if before != own and table.sight[own, before] and ball_meets(
            cone[0], cone[1], cone[2], cone[3], cone[4], cone[5], cone[6], cone[7],
            blocks.centre[block, 0], blocks.centre[block, 1], blocks.centre[block, 2], blocks.radius[block],
        ):  # fmt: skip
            entering[entries] = g
            entries += 1
    n = alone
    for i in range(ways):
        between = _beyond(table, own, leaving[i])
        known = False
        for j in range(i):
            known |= _beyond(table, own, leaving[j]) == between
        if known:
            continue
        through = 0
        for e in range(entries):
            through += _beyond(table, cluster, entering[e]) == between
        if through == 0:
            continue
        for j in range(i, ways):
            if _beyond(table, own, leaving[j]) == between:
                found_gate[n], found_mask[n] = leaving[j] | LEAVING, masks[j]
                n += 1
        for e in range(entries):
            if _beyond(table, cluster, entering[e]) == between:
                found_gate[n], found_mask[n] = entering[e] | ENTERING, _ALL
                n += 1
    if n > 0:
        return n
    for i in range(ways):
        for e in range(entries):
            if table.sight[_beyond(table, own, leaving[i]), _beyond(table, cluster, entering[e])]:
                found_gate[n], found_mask[n] = leaving[i] | LEAVING, masks[i]
                n += 1
                break
    left = n
    for e in range(entries):
        for i in range(left):
            if table.sight[_beyond(table, own, found_gate[i] & NUMBER), _beyond(table, cluster, entering[e])]:
                found_gate[n], found_mask[n] = entering[e] | ENTERING, _ALL
                n += 1
                break
    return n if n > left else 0


@kernel
def assign(runs, begin, end, lights, table, cones):
    """The lists of the geometry clusters begin..end-1: (first, block, gate, mask), `first` counted from 0."""
    most = max(1, cones.shape[1])
    room = len(lights.blocks.cluster) * most
    near_block, near_gate = np.empty(room, np.int32), np.empty(room, np.int32)
    entrances = np.empty((most, 8), np.float32)
    found_gate, found_mask = np.empty(2 * most, np.int32), np.empty(2 * most, np.uint32)
    first = np.zeros(end - begin + 1, np.int64)
    block, gate, mask = np.empty(1024, np.int32), np.empty(1024, np.int32), np.empty(1024, np.uint32)
    n = 0
    group = begin
    while group < end:
        cluster = runs.cluster[group]
        last = group + 1
        while last < min(end, group + GROUP) and runs.cluster[last] == cluster:
            last += 1
        sx, sy, sz, radius = _group_sphere(runs, group, last)
        near = _candidates(lights, table, cones, cluster, sx, sy, sz, radius, near_block, near_gate)
        for r in range(group, last):
            own = entrances[: _entrances(runs, r, table, entrances)]
            at = 0
            while at < near:
                upto = at + 1
                while upto < near and near_block[upto] == near_block[at]:
                    upto += 1
                found = _list_block(runs, r, lights, table, near_block[at], near_gate[at:upto], own, found_gate, found_mask)
                if n + found > len(block):
                    grown = 2 * len(block) + found
                    block, gate, mask = _grown(block, grown), _grown(gate, grown), _grown(mask, grown)
                for k in range(found):
                    block[n], gate[n], mask[n] = near_block[at], found_gate[k], found_mask[k]
                    n += 1
                at = upto
            first[r + 1 - begin] = n
        group = last
    return first, block[:n].copy(), gate[:n].copy(), mask[:n].copy()


@kernel
def _grown(array, room):
    """A copy with more room."""
    out = np.empty(room, array.dtype)
    out[: len(array)] = array
    return out


def joined(parts: list) -> Lists:
    """The lists of consecutive chunks as one."""
    counts = [0, *np.cumsum([len(part[1]) for part in parts])]
    first = [part[0][:-1] + before for part, before in zip(parts, counts)]
    return Lists(np.concatenate([*first, counts[-1:]]), *(np.concatenate([part[k] for part in parts]) for k in (1, 2, 3)))
