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


class LampTable(NamedTuple):
    """A analytic lamps (the world has no row here).

    source: (A,) int32, index in `Scene.lamps`.  position: (A, 3).  axes: (A, 3, 3), rows x, y, z; shining along -z.
    radius: (A,) m.  soft: (A,) uint8, a disk that faces the point it lights instead of a sphere.
    cos_outer, cos_inner: (A,) where a spot's smooth edge begins and where it is full.
    one_minus_cos: (A,) of a sun's half angle.  size: (A, 2) full widths.  ellipse: (A,) uint8.
    half_spread: (A,) rad;  tan_half_spread: (A,), inf for none.
    """

    source: np.ndarray
    position: np.ndarray
    axes: np.ndarray
    radius: np.ndarray
    soft: np.ndarray
    cos_outer: np.ndarray
    cos_inner: np.ndarray
    one_minus_cos: np.ndarray
    size: np.ndarray
    ellipse: np.ndarray
    half_spread: np.ndarray
    tan_half_spread: np.ndarray


class MeshTable(NamedTuple):
    """M emissive triangles, which shine from both sides.

    triangle: (M,) int32 into `Geometry.triangles`.  corners: (M, 3, 3).  normal: (M, 3) unit.  area: (M,) m^2.
    material: (M,) int32.  textured: (M,) uint8, radiance varies and is evaluated at each sample.
    """

    triangle: np.ndarray
    corners: np.ndarray
    normal: np.ndarray
    area: np.ndarray
    material: np.ndarray
    textured: np.ndarray


class WorldTable(NamedTuple):
    """The equirectangular world, constant within each pixel, and three densities over its pixels.

    radiance: (H, W, 3).  rows, columns: (H + 1,), (H, W + 1) CDFs for direct light, of what exceeds the mean
        (see `world`).  emission_rows, emission_columns: CDFs of the light that enters the scene's box.
    varies: whether the first pair of CDFs is used at all.  estimate: (4,) irradiance of a surface with normal n
        is about estimate[0] + estimate[1:] . n (mean of the channels).
    """

    radiance: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    emission_rows: np.ndarray
    emission_columns: np.ndarray
    varies: bool
    estimate: np.ndarray


class LightTree(NamedTuple):
    """Bounds of emitters, and a binary tree over many of them (Conty Estevez & Kulla 2018).

    Node i < E is emitter i alone; interior nodes follow.  lower, upper: (K, 3) box.  axis: (K, 3), cos_o: (K,), cone
    of the directions in which the emitters face;  cos_e: (K,) how far from these they shine.  energy: (K,) radiant
    intensity along the axis, mean of the channels.  two_sided: (K,) uint8, the axis stands for both directions.
    left, right: (K - E,) int32 children of node E + j.  cut: a few nodes that hold the whole tree between them.
    root: int, -1 for no tree.
    """

    lower: np.ndarray
    upper: np.ndarray
    axis: np.ndarray
    cos_o: np.ndarray
    cos_e: np.ndarray
    energy: np.ndarray
    two_sided: np.ndarray
    left: np.ndarray
    right: np.ndarray
    cut: np.ndarray
    root: int


class Emitters(NamedTuple):
    """All E emitters of a scene (for one kind of receiving ray), ready for kernels.

    kind: (E,) int32.  radiance: (E, 3), W/m^2/sr: of a lamp's surface (on the axis of a spot or area lamp), of a
        sun's disk, mean of a triangle or the world; of a point of no size the radiant intensity, W/sr, and of a sun
        of no size the irradiance, W/m^2.
    flux: (E, 3) float64, W leaving, or entering the scene's box for sun and world.
    cast_shadow: (E,) uint8.  groups: (G,) int32, emitters that direct light samples one by one; -1 is the tree.
    emission_cdf: (E + 1,) float64, by flux.  box: (2, 3), corners of the scene's bounding box.
    vertices, triangles: the scene's geometry.  attributes, materials: what textured triangles are evaluated with.
    """

    kind: np.ndarray
    radiance: np.ndarray
    flux: np.ndarray
    cast_shadow: np.ndarray
    lamps: LampTable
    world: WorldTable
    mesh: MeshTable
    tree: LightTree
    groups: np.ndarray
    emission_cdf: np.ndarray
    box: np.ndarray
    vertices: np.ndarray
    triangles: np.ndarray
    attributes: np.ndarray
    materials: MaterialTables
