"""One image for many objects: a square of it for each, as large as its surface deserves."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ..core.errors import SceneError
from ..core.lightmaps import texels_a_metre
from .lightmap_uv import set_uv

ATLAS_LAYER = "Lightmap Atlas"
_SHRINK = 0.97  # of all squares, until they fit
_SMALLEST = 2  # texels along a square's side


def lay_out(objects: Sequence[bpy.types.Object], layer: str, size: int, density: float | None, margin: int) -> int:
    """Give each object a square of an atlas and the UV map `ATLAS_LAYER` in it, scaled from its map `layer`; the atlas's side.

    size: texels along the atlas's side; density: texels a metre, which then decides the size.  margin: texels between squares.
    Objects that share a mesh get one each, for they lie in different places.

    Raises:
        SceneError: more objects than the image has room for.
    """
    meshes = [_own_mesh(ob) for ob in objects]
    sides = np.array([_metres(ob, layer) for ob in objects])
    gap = max(1, margin)
    if density is None:
        scale = 1.3 * size / max(np.sqrt((sides**2).sum()), 1e-9)
        squares = placed(sides, scale, size, gap)
        while squares is None:
            scale *= _SHRINK
            if (sides * scale).max() < _SMALLEST:
                raise SceneError(f"{len(objects)} objects do not fit into one image of {size} texels a side: choose a larger one")
            squares = placed(sides, scale, size, gap)
    else:
        size = 4 * int(np.ceil(density * np.sqrt((sides**2).sum()) / 4))
        squares = placed(sides, density, size, gap)
        while squares is None:
            size = 4 * int(np.ceil(size * 1.03 / 4))
            squares = placed(sides, density, size, gap)
    for mesh, (x, y, side) in zip(meshes, squares):
        uv = np.empty((len(mesh.loops), 2), np.float32)
        mesh.uv_layers[layer].data.foreach_get("uv", uv.ravel())
        set_uv(mesh, ATLAS_LAYER, (uv * side + (x, y)) / size)
    return size


def placed(sides: np.ndarray, scale: float, size: int, gap: int) -> np.ndarray | None:
    """(N, 3) lower left corner and side, in texels, of squares of `sides` (N,) times `scale` on shelves; None where they do not fit."""
    texels = np.maximum(np.ceil(sides * scale), _SMALLEST)
    out = np.empty((len(sides), 3))
    x = y = gap
    shelf = 0
    for i in np.argsort(-texels, kind="stable"):
        if x + texels[i] + gap > size:
            x, y, shelf = gap, y + shelf + gap, 0
        if x + texels[i] + gap > size or y + texels[i] + gap > size:
            return None
        out[i] = x, y, texels[i]
        x += texels[i] + gap
        shelf = max(shelf, texels[i])
    return out


def _own_mesh(ob: bpy.types.Object) -> bpy.types.Mesh:
    if ob.data.users > 1:
        ob.data = ob.data.copy()
    return ob.data


def _metres(ob: bpy.types.Object, layer: str) -> float:
    """The side of a square (m) in which the object's UV map has the object's own scale."""
    mesh = ob.data
    mesh.calc_loop_triangles()
    loops, vertices = (np.empty((len(mesh.loop_triangles), 3), np.int32) for _ in range(2))
    mesh.loop_triangles.foreach_get("loops", loops.ravel())
    mesh.loop_triangles.foreach_get("vertices", vertices.ravel())
    places, uv = np.empty((len(mesh.vertices), 3), np.float32), np.empty((len(mesh.loops), 2), np.float32)
    mesh.vertices.foreach_get("co", places.ravel())
    mesh.uv_layers[layer].data.foreach_get("uv", uv.ravel())
    linear = np.array(ob.matrix_world.to_3x3())
    return texels_a_metre((places @ linear.T)[vertices], uv[loops])
