"""The options of `lumigate bake` that say what is baked, on which UV maps, into which images."""

from __future__ import annotations

import argparse

from ..core.settings import CONTENTS, BakeSettings
from .argument_types import count, names, positive, size_or_none, texel_samples


def add_bake_settings(parser: argparse.ArgumentParser) -> None:
    """What is baked, on which UV maps, into which images."""
    add = parser.add_argument
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--objects", type=names, metavar="A,B", help="bake these objects (default: every mesh that a render shows)")
    chosen.add_argument("--selected", action="store_true", help="bake the objects that are selected in the file")
    side = parser.add_mutually_exclusive_group()
    side.add_argument("--size", type=count, default=512, metavar="N", help="texels along a side of each image (default: %(default)s)")
    side.add_argument("--texel-density", type=positive, metavar="D", help="texels a metre: images as large as that needs")
    add("--atlas", action="store_true", help="one image for all objects (default: one each)")
    add(
        "--margin",
        type=size_or_none,
        default=BakeSettings.margin,
        metavar="PX",
        help="texels around each chart that are filled, too (default: %(default)s)",
    )
    add("--content", choices=tuple(CONTENTS), default=BakeSettings.content, help="what the texels hold (default: %(default)s)")
    add(
        "--format",
        choices=("exr", "png"),
        default="exr",
        help="linear floats, or 8 bits with the sRGB curve and a scale (default: %(default)s)",
    )
    add(
        "--texel-samples",
        type=texel_samples,
        default=BakeSettings.texel_samples,
        metavar="P",
        help="shading points of a texel, each with rays of its own, 1 to 16 (default: %(default)s)",
    )
    add("--no-stitch", dest="stitch", action="store_false", help="leave UV seams as they are")
    add("--uv-map", default="Lightmap", metavar="NAME", help="the UV map to bake on, made where it is missing (default: %(default)s)")
    add("--unwrap", choices=("smart", "pack"), default="smart", help="Blender's Smart UV Project or Lightmap Pack (default: %(default)s)")
    add(
        "--attributes",
        action="store_true",
        help="no images: the light at the corners of faces as colour attributes of the meshes, in scene.blend",
    )
    add("--gltf", action="store_true", help="also write scene.glb, whose materials shine with their lightmaps (needs --content full)")


def check_attributes(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """What colour attributes have no use for is an error beside them."""
    given = {
        "--texel-density": arguments.texel_density is not None,
        "--atlas": arguments.atlas,
        "--gltf": arguments.gltf,
        "--stats": arguments.stats is not None,
    }
    flag = next((flag for flag, is_given in given.items() if is_given), None)
    if arguments.attributes and flag:
        parser.error(f"{flag} belongs to lightmaps, not to --attributes")
