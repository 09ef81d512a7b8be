"""Pixels of Blender's images in the form that the texture pool stores."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.surfaces import textures

if TYPE_CHECKING:
    import bpy

# Colour spaces whose numbers are scene-linear already (Blender's default working space) or not colours at all.
_LINEAR = frozenset({"Non-Color", "Linear Rec.709", "Linear", "Raw", "scene_linear", "Linear BT.709"})


class ImageMissing(Exception):
    """The image's pixels cannot be had; the message says why."""


def image_key(image: bpy.types.Image) -> tuple:
    """What tells one stored image from another."""
    return image.name_full, image.colorspace_settings.name, image.alpha_mode


def _keeps_alpha_apart(image: bpy.types.Image) -> bool:
    """Whether colour is stored without its alpha multiplied in, by the user's choice or because it is data."""
    return image.colorspace_settings.name in ("Non-Color", "Raw") or image.alpha_mode in ("CHANNEL_PACKED", "NONE")


def lookup_flags(image: bpy.types.Image, alpha_used: bool) -> int:
    """Flags of the texture: Cycles divides by alpha only where the alpha output is linked."""
    flags = 0
    if not image.is_float and image.colorspace_settings.name == "sRGB":
        flags |= textures.SRGB
    if alpha_used and not _keeps_alpha_apart(image):
        flags |= textures.UNASSOCIATE
    return flags


def load_pixels(image: bpy.types.Image) -> np.ndarray:
    """(H, W, C) uint8 in the file's encoding, or float32 scene-linear; C is 1, 3 or 4, alpha multiplied in.

    Raises:
        ImageMissing: there is no such file, or it holds no pixels.
    """
    width, height = image.size
    if not image.has_data:
        # Reading the pixels makes Blender load the file.
        _ = len(image.pixels)
        width, height = image.size
    if width == 0 or height == 0 or len(image.pixels) == 0:
        raise ImageMissing(f"no pixels in '{image.filepath}'" if image.filepath else "no pixels")
    channels = image.channels
    pixels = np.empty(width * height * channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, channels)
    if channels == 2:
        pixels = pixels[..., [0, 0, 0, 1]]
    if channels == 4 and (image.alpha_mode == "NONE" or (pixels[..., 3] == 1).all()):
        pixels = pixels[..., :3]
    has_alpha = pixels.shape[2] == 4
    if image.is_float:
        if has_alpha and image.alpha_mode == "STRAIGHT" and not _keeps_alpha_apart(image):
            pixels = pixels.copy()
            pixels[..., :3] *= pixels[..., 3:]
        return pixels
    if image.colorspace_settings.name != "sRGB" and image.colorspace_settings.name not in _LINEAR:
        return _to_linear(image, pixels)
    if has_alpha and not _keeps_alpha_apart(image):
        pixels = np.concatenate([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], 2)
    return (pixels * 255 + 0.5).astype(np.uint8)


def _to_linear(image: bpy.types.Image, pixels: np.ndarray) -> np.ndarray:
    """Pixels of an unusual colour space as scene-linear floats, by Blender's own configuration."""
    import bpy
    import OpenImageIO as oiio

    config = f"{bpy.utils.system_resource('DATAFILES')}/colormanagement/config.ocio"
    buffer = oiio.ImageBuf(np.ascontiguousarray(pixels))
    converted = oiio.ImageBufAlgo.colorconvert(buffer, image.colorspace_settings.name, "scene_linear", colorconfig=config)
    if converted.has_error:
        raise ImageMissing(f"colour space '{image.colorspace_settings.name}' is unknown")
    result = converted.get_pixels(oiio.FLOAT).reshape(pixels.shape)
    if pixels.shape[2] == 4 and not _keeps_alpha_apart(image):
        result[..., :3] *= result[..., 3:]
    return np.ascontiguousarray(result, np.float32)
