"""Pixels of Blender's images in the form that the texture pool stores."""

from __future__ import annotations

import bpy
import numpy as np
import OpenImageIO as oiio

from ...core.surfaces import textures

# Colour spaces whose numbers are scene-linear already (Blender's default working space) or not colours at all.
_LINEAR = frozenset({"Non-Color", "Linear Rec.709", "Linear", "Raw", "scene_linear", "Linear BT.709"})
# Formats whose colours always have alpha multiplied in.
_ALWAYS_ASSOCIATED = frozenset({"OPEN_EXR", "OPEN_EXR_MULTILAYER", "HDR"})


class ImageMissing(Exception):
    """The image's pixels cannot be had; the message says why."""


def image_key(image: bpy.types.Image) -> tuple:
    """What tells one stored image from another."""
    return image.name_full, image.colorspace_settings.name, image.alpha_mode


def _keeps_alpha_apart(image: bpy.types.Image) -> bool:
    """Whether colour is stored without its alpha multiplied in, by the user's choice or because it is data."""
    return image.colorspace_settings.name in ("Non-Color", "Raw") or image.alpha_mode in ("CHANNEL_PACKED", "NONE")


def _read_by_cycles(image: bpy.types.Image) -> bool:
    """Whether Cycles reads the file itself, and not Blender's buffer, where floats are scene-linear already."""
    return image.source not in ("GENERATED", "MOVIE", "VIEWER") and image.packed_file is None


def lookup_flags(image: bpy.types.Image, alpha_used: bool) -> int:
    """Flags of the texture: Cycles divides by alpha only where the alpha output is linked."""
    flags = 0
    if image.colorspace_settings.name == "sRGB" and (not image.is_float or _read_by_cycles(image)):
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
    space = image.colorspace_settings.name
    if not image.is_float and space != "sRGB" and space not in _LINEAR:
        pixels = _to_linear(image, pixels)
    elif image.is_float and lookup_flags(image, False) & textures.SRGB:
        pixels = _encoded(pixels, premultiplied=not _keeps_alpha_apart(image))
    if pixels.shape[2] == 4 and not _keeps_alpha_apart(image):
        pixels = _associated(image, pixels)
    as_bytes = not image.is_float and (space == "sRGB" or space in _LINEAR)
    return (pixels * 255 + 0.5).astype(np.uint8) if as_bytes else np.ascontiguousarray(pixels)


def _encoded(pixels: np.ndarray, premultiplied: bool) -> np.ndarray:
    """Scene-linear floats as the sRGB numbers of the file; alpha, where multiplied in, stays so."""
    alpha = np.maximum(pixels[..., 3:], 1e-6) if premultiplied and pixels.shape[2] == 4 else 1.0
    linear = pixels[..., :3] / alpha
    encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)
    return np.concatenate([encoded * alpha, pixels[..., 3:]], 2).astype(np.float32)


def _alpha_power(image: bpy.types.Image) -> int:
    """Power of alpha by which Cycles' colours differ from those in Blender's buffer (straight bytes, multiplied floats).

    Cycles 5 multiplies where the mode says straight.  Cycles 4 multiplies what it finds in a file whatever
    the mode says, unless the format always holds multiplied colours.
    """
    own = _read_by_cycles(image)
    straight = image.alpha_mode == "STRAIGHT"
    if bpy.app.version >= (5, 0):
        if image.is_float:
            return int(straight and not own)
        return int(straight or own)
    if not image.is_float:
        return 2 if own and not straight else 1
    if not own:
        return 0
    return (0 if straight else 1) - (image.file_format in _ALWAYS_ASSOCIATED)


def _associated(image: bpy.types.Image, pixels: np.ndarray) -> np.ndarray:
    """Colours with alpha multiplied in as Cycles has them."""
    power = _alpha_power(image)
    if power == 0:
        return pixels
    alpha = pixels[..., 3:]
    factor = alpha**power if power > 0 else 1 / np.maximum(alpha, 1e-6)
    return np.concatenate([pixels[..., :3] * factor, alpha], 2)


def _to_linear(image: bpy.types.Image, pixels: np.ndarray) -> np.ndarray:
    """Pixels of an unusual colour space as scene-linear floats, by Blender's own configuration."""
    config = f"{bpy.utils.system_resource('DATAFILES')}/colormanagement/config.ocio"
    buffer = oiio.ImageBuf(np.ascontiguousarray(pixels))
    converted = oiio.ImageBufAlgo.colorconvert(buffer, image.colorspace_settings.name, "scene_linear", colorconfig=config)
    if converted.has_error:
        raise ImageMissing(f"colour space '{image.colorspace_settings.name}' is unknown")
    return np.ascontiguousarray(converted.get_pixels(oiio.FLOAT).reshape(pixels.shape), np.float32)
