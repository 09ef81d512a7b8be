"""The tables of emitters that kernels read.

An emitter is an analytic lamp, the world, or one emissive triangle.  They are numbered in this order: lamps,
then the world if it shines, then triangles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..scene import MaterialTables

# `Emitters.kind` goes on where the kinds of `scene.Lamps` end (POINT, SPOT, SUN, AREA = 0..3).
WORLD, TRIANGLE = 4, 5

# Bits of `Emitters.flags`: casts shadows; a disk that faces the point it lights instead of a sphere; an ellipse
# instead of a rectangle; a triangle or a lamp whose radiance varies; visible to glossy rays, to the camera (lamps only), and to it
# through glass (lamps only); so small, and one of so few, that it has `highlights` of its own; a
# lamp with a falloff of its own; lights some objects only; shines on what is glossy alone, for diffuse rays do not see it; a
# triangle whose front, or whose back, is the outside of a closed body (see `closed`).
CASTS_SHADOW, SOFT, ELLIPTIC, TEXTURED, SEEN_BY_GLOSSY, SEEN_BY_CAMERA, SEEN_THROUGH_GLASS, SHARP, FADING = 1, 2, 4, 8, 16, 32, 64, 128, 256
LINKED, GLOSSY_ONLY, FRONT_OUT, BACK_OUT = 512, 1024, 2048, 4096
INWARDS = np.float32(1 / 32)  # share of the samples that the inside of a closed body gets, of what its outside gets

# Columns of `Emitters.lamps`: xyz of position (m) and of the unit axes, shining along -z; radius (m); cosines where a
# spot's smooth edge begins and where it is full; 1 - cos of a sun's half angle; full widths (m), half spread (rad) and
# its tangent (inf for none) of an area lamp; about which share of the chords of a sphere meets a surface, 0 for none within;
# exponent and smoothing (m^2) of a lamp's own falloff, and that falloff at the scene's own distances, by which its flux counts;
# of a lamp that is TEXTURED its program (a material's number), 1 over the mean of what that makes of its light, and its
# row in `EmissionMaps` (-1: none).
POSITION, AXIS_X, AXIS_Y, AXIS_Z, RADIUS, COS_OUTER, COS_INNER, ONE_MINUS_COS, SIZE, HALF_SPREAD, TAN_HALF_SPREAD, WITHIN, EXPONENT, SMOOTHING, NOMINAL = (
    0, 3, 6, 9, 12, 13, 14, 15, 16, 18, 19, 20, 21, 22, 23,
)  # fmt: skip
PROGRAM, PER_MEAN, MAP, LAMP = 24, 25, 26, 27

# Columns of `Emitters.shapes`: xyz of a triangle's corners (m) and unit normal, area (m^2).
CORNERS, NORMAL, AREA_M2, SHAPE = 0, 9, 12, 13

# Columns of `LightTree.nodes`: box, unit axis and cosine of the cone of the directions in which the emitters face,
# cosine of how far from these they shine, radiant intensity along the axis (mean of the channels), and where all are flat and face
# the same way how far along the axis (m) the first of them lies, behind which nothing is lit: -inf else; what counts of light that
# leaves against the axis, as of the insides of closed bodies.
LOWER, UPPER, AXIS, COS_O, COS_E, ENERGY, PLANE, AGAINST, NODE = 0, 3, 6, 9, 10, 11, 12, 13, 14


class WorldTable(NamedTuple):
    """The equirectangular world, constant within each pixel, and three densities over its pixels.

    radiance: (H, W, 3).  rows, columns: (H + 1,), (H, W + 1) CDFs for direct light, of what exceeds the mean
        (see `world`).  emission_rows, emission_columns: CDFs of the light that enters the scene's box.
    portals: (P, LAMP) float32, windows that the world shines in by, with the place, axes and size of an area lamp.  aimed: share of the rays that go through them.
    varies: whether the first pair of CDFs is used at all.  estimate: (4,) irradiance of a surface with normal n
        is about estimate[0] + estimate[1:] . n (mean of the channels).  sought: as of `World`.
    """

    radiance: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    emission_rows: np.ndarray
    emission_columns: np.ndarray
    varies: bool
    estimate: np.ndarray
    sought: np.float32
    aimed: np.float32
    portals: np.ndarray


class LightTree(NamedTuple):
    """Bounds of emitters, and a binary tree over many of them (Conty Estevez & Kulla 2018).

    Node i < E is emitter i alone; interior nodes follow.  nodes: (K, NODE) float32.  two_sided: (K,) uint8, the axis
    stands for both directions.  children: (K - E, 2) int32 of node E + j.  cut: a few nodes that hold the whole tree
    between them.  root: int, -1 for no tree.
    """

    nodes: np.ndarray
    two_sided: np.ndarray
    children: np.ndarray
    cut: np.ndarray
    root: int


class LampTables(NamedTuple):
    """Analytic lamps alone; the fields are those of `Emitters`."""

    kind: np.ndarray
    flags: np.ndarray
    radiance: np.ndarray
    lamps: np.ndarray
    light_group: np.ndarray
    receivers: np.ndarray


class EmissionMaps(NamedTuple):
    """Where the light of K textured lamps leaves, as distributions over cells (see `textured`).

    Of point and spot lamps they are over directions in the lamp's own axes: rows by the cosine of the angle with its z axis, from 1 to -1,
    columns by azimuth, so that all cells are of the same solid angle.  Of area lamps they are over the rectangle: rows by y, columns by x.
    rows: (K, H + 1), columns: (K, H, W + 1) float32, running sums.
    """

    rows: np.ndarray
    columns: np.ndarray


class Emitters(NamedTuple):
    """All E emitters of a scene (for one kind of receiving ray), ready for kernels.

    Few arrays with columns: kernels hand them on from function to function, and each array costs.

    kind, flags: (E,) int32.  source: (A,) int32, index in `Scene.lamps` of the first A emitters.
    radiance: (E, 3), W/m^2/sr: of a lamp's surface (on the axis of a spot or area lamp), of a sun's disk, mean of a
        triangle or the world; of a point of no size the radiant intensity, W/sr, and of a sun of no size the
        irradiance, W/m^2.
    flux: (E, 3) float64, W leaving, or entering the scene's box for sun and world.
    lamps: (A, LAMP) float32.  maps: of those that are textured.
    first_triangle: E - M, the emitter that is triangle 0 of M.  shapes: (M, SHAPE) float32.
    triangle, material: (M,) int32 into the scene's tables.
    groups: (G,) int32, emitters that direct light samples one by one; -1 is the tree.
    emission_cdf: (E + 1,) float64, by flux.  box: (2, 3), corners of the scene's bounding box.
    focus: (K, 2, 3), corners of boxes within it where particles of sun and world count more; none: everywhere alike.  drawn: (K + 1,) float32, shares
        of these particles that are drawn to the box of the scene and to each of them.  around: how many of the first of them lie around what is lit; the
        others are openings.
    aims: (K, 4), centres and radii of spheres to which emitters far off send more of their particles, each larger than the one before.
    cutouts: whether anything in the scene lets light through.  told: whether rays to the sky are to be told apart by their kind: where what
        lets light through may be TELLING, or `parted`: where objects are met by shadow rays alone, or by diffuse rays alone.
    light_group: (E,) int32, object_light_group: (O,) int32: the light group of each emitter, and of each object's triangles.
    receivers: (E,) int32, the set of objects that an emitter which is LINKED lights, receiver_sets: (K, O) uint8, 1 for those of each set.
    shadow_kinds: (E,) int64, the kind of its shadow rays, which meet what hides it.
    light_groups: their number G, 1 where light is not told apart.  What adds light up has three columns for each of them.
    vertices, triangles, attributes, materials: of the scene, for triangles.
    """

    kind: np.ndarray
    flags: np.ndarray
    source: np.ndarray
    radiance: np.ndarray
    flux: np.ndarray
    lamps: np.ndarray
    maps: EmissionMaps
    first_triangle: int
    shapes: np.ndarray
    triangle: np.ndarray
    material: np.ndarray
    world: WorldTable
    tree: LightTree
    groups: np.ndarray
    emission_cdf: np.ndarray
    box: np.ndarray
    focus: np.ndarray
    drawn: np.ndarray
    around: int
    aims: np.ndarray
    cutouts: bool
    told: bool
    parted: bool
    light_group: np.ndarray
    object_light_group: np.ndarray
    light_groups: int
    receivers: np.ndarray
    receiver_sets: np.ndarray
    shadow_kinds: np.ndarray
    vertices: np.ndarray
    triangles: np.ndarray
    attributes: np.ndarray
    materials: MaterialTables

    def no_light(self, n: int) -> np.ndarray:
        """Zeros (n, 3 G) float32, to which the light at n points is added."""
        return np.zeros((n, 3 * self.light_groups), np.float32)
