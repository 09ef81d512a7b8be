"""Image textures."""

from __future__ import annotations

from ....core.surfaces import outlined, textures
from ....core.surfaces import program as ops
from ..builder import Constant, Value, scalar
from ..images import ImageMissing, image_key, load_pixels, lookup_flags
from ..registry import Unsupported, value
from ..requests import NORMAL, UV
from ..tree import NodeInput

_EXTENSIONS = {"REPEAT": textures.REPEAT, "EXTEND": textures.EXTEND, "CLIP": textures.CLIP, "MIRROR": textures.MIRROR}
_INTERPOLATIONS = {
    "Closest": textures.CLOSEST,
    "Linear": textures.LINEAR,
    "Cubic": textures.CUBIC,
    "Smart": textures.CUBIC,
}
_MISSING = Constant(1.0, 0.0, 1.0, 1.0)  # Cycles' pink


@value("ShaderNodeTexImage")
def image_texture(node: NodeInput, output: str) -> Value:
    """Image Texture, in all projections, extensions and interpolations."""
    texel = _texel(node)
    return node.splat(texel, 3) if output == "Alpha" else texel


def _texel(node: NodeInput) -> Value:
    image = node.node.image
    if image is None:
        return _MISSING if node.node.outputs else scalar(0)
    if image.source == "TILED":
        raise Unsupported(f"image '{image.name}' is tiled (UDIM)")
    alpha_used = any(link.is_valid for link in node.node.outputs["Alpha"].links)
    try:
        index = node.context.textures.add(
            image_key(image),
            lambda: load_pixels(image),
            _EXTENSIONS[node.node.extension],
            _INTERPOLATIONS[node.node.interpolation],
            lookup_flags(image, alpha_used),
        )
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
