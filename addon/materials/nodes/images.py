"""Image textures."""

from __future__ import annotations

import functools
import os
from typing import TYPE_CHECKING

from ....core.surfaces import outlined, textures
from ....core.surfaces import program as ops
from ..builder import Constant, Value, scalar
from ..images import ImageMissing, frame_file, image_key, load_pixels, lookup_flags, tile_files
from ..registry import value
from ..requests import NORMAL, UV
from ..tree import NodeInput

if TYPE_CHECKING:
    import bpy

_EXTENSIONS = {"REPEAT": textures.REPEAT, "EXTEND": textures.EXTEND, "CLIP": textures.CLIP, "MIRROR": textures.MIRROR}
_INTERPOLATIONS = {
    "Closest": textures.CLOSEST,
    "Linear": textures.LINEAR,
    "Cubic": textures.CUBIC,
    "Smart": textures.CUBIC,
}
_MISSING = Constant(*textures.MISSING)


@value("ShaderNodeTexImage")
def image_texture(node: NodeInput, output: str) -> Value:
    """Image Texture, in all projections, extensions and interpolations."""
    texel = _texel(node)
    return node.splat(texel, 3) if output == "Alpha" else texel


def _texel(node: NodeInput) -> Value:
    image = node.node.image
    if image is None:
        return _MISSING if node.node.outputs else scalar(0)
    try:
        index = _texture(node, image)
    except ImageMissing as missing:
        node.context.warn(f"image '{image.name}' cannot be read ({missing}); it shows as pink")
        return _MISSING
    at = node["Vector"] if node.linked("Vector") else node.program.attribute(UV)
    projection = node.node.projection
    if projection == "BOX":
        normal = node.program.attribute(NORMAL)
        return node.emit(ops.TEXTURE_BOX, at, normal, scalar(node.node.projection_blend), p=index)
    if projection != "FLAT":
        at = node.emit(outlined.PROJECT, at, p=0 if projection == "SPHERE" else 1)
    return node.emit(ops.TEXTURE, at, p=index)


def _texture(node: NodeInput, image: bpy.types.Image) -> int:
    """Index of the image as the node looks it up; ImageMissing where there is none."""
    pool, key = node.context.textures, image_key(image)
    alpha_used = any(link.is_valid for link in node.node.outputs["Alpha"].links)
    lookup = _EXTENSIONS[node.node.extension], _INTERPOLATIONS[node.node.interpolation], lookup_flags(image, alpha_used)
    if image.source == "TILED":
        files = tile_files(image)
        for place, file in list(files.items()):
            if isinstance(file, str) and not os.path.isfile(file):
                node.context.warn(f"image '{image.name}' lacks the tile '{file}'; it shows as pink")
                del files[place]
        if not files:
            raise ImageMissing("no tile of it is there")
        tiles = {place: functools.partial(load_pixels, image, file) for place, file in files.items()}
        return pool.add_tiles(key, tiles, *lookup)
    file = frame_file(image, node.node.image_user, node.context.shot.frame) if image.source == "SEQUENCE" else None
    return pool.add((*key, file), lambda: load_pixels(image, file), *lookup)
