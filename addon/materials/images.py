"""Pixels of Blender's images in the form that the texture pool stores."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path

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


def frame_file(image: bpy.types.Image, user: bpy.types.ImageUser, frame: int) -> str:
    """The file of an image sequence that shows at a frame of the scene (BKE_image_user_frame_get and BKE_image_user_file_path of Blender)."""
    count = frame - user.frame_start + 1
    if user.use_cyclic and user.frame_duration:
        count = (count - 1) % user.frame_duration + 1
    number = min(max(count, 0), user.frame_duration) + user.frame_offset
    path = Path(_absolute(image, image.filepath_raw))
    digits = list(re.finditer(r"\d+", path.stem))
    if not digits:
        return str(path)
    start, end = digits[-1].span()
    return str(path.with_name(f"{path.stem[:start]}{number:0{end - start}d}{path.stem[end:]}{path.suffix}"))


def tile_files(image: bpy.types.Image) -> dict[tuple[int, int], str | bytes]:
    """The files of a tiled image (UDIM) by their column and row, or what they held when they were packed."""
    packed = {os.path.basename(file.filepath): file.packed_file.data for file in image.packed_files}
    found = {}
    for tile in image.tiles:
        column, row = (tile.number - 1001) % 10, (tile.number - 1001) // 10
        path = image.filepath_raw.replace("<UDIM>", str(tile.number)).replace("<UVTILE>", f"u{column + 1}_v{row + 1}")
        found[column, row] = packed.get(os.path.basename(path)) or _absolute(image, path)
    return found


def _absolute(image: bpy.types.Image, path: str) -> str:
    return bpy.path.abspath(path, library=image.library)


def _of_file(file: str | bytes) -> tuple[np.ndarray, bool]:
    """(H, W, C) float32 in a file's own encoding, rows from the bottom, and whether it has more than 8 bits; as Blender's buffers, floats are associated."""
    if isinstance(file, bytes):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "packed"
            path.write_bytes(file)
            return _of_file(str(path))
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(file, config)
    if source is None:
        oiio.geterror()
        raise ImageMissing(f"no pixels in '{file}'")
    spec = source.spec()
    pixels = source.read_image(0, 0, 0, min(spec.nchannels, 4), oiio.FLOAT)
    source.close()
    if pixels is None:
        raise ImageMissing(f"no pixels in '{file}'")
    pixels = np.asarray(pixels, np.float32).reshape(spec.height, spec.width, -1)[::-1]
    is_float = spec.format.basetype != oiio.UINT8
    if is_float and pixels.shape[2] == 4 and spec.get_int_attribute("oiio:UnassociatedAlpha"):
        pixels = np.concatenate([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], 2)
    return pixels, is_float


def _of_image(image: bpy.types.Image) -> tuple[np.ndarray, bool]:
    """(H, W, C) float32 of Blender's buffer, and whether it holds floats, which are scene-linear."""
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
    return pixels.reshape(height, width, channels), image.is_float


def load_pixels(image: bpy.types.Image, file: str | bytes | None = None) -> np.ndarray:
    """(H, W, C) uint8 in the file's encoding, or float32 scene-linear; C is 1, 3 or 4, alpha multiplied in.

    file: of the image's frame or tile, None for all of an image that has none.

    Raises:
        ImageMissing: there is no such file, or it holds no pixels.
    """
    pixels, is_float = _of_image(image) if file is None else _of_file(file)
    if pixels.shape[2] == 2:
        pixels = pixels[..., [0, 0, 0, 1]]
    if pixels.shape[2] == 4 and (image.alpha_mode == "NONE" or (pixels[..., 3] == 1).all()):
        pixels = pixels[..., :3]
    space = image.colorspace_settings.name
    is_plain = space == "sRGB" or space in _LINEAR
    if not is_plain and not (is_float and file is None):
        pixels = _to_linear(image, pixels)
    elif is_float and file is None and lookup_flags(image, False) & textures.SRGB:
        pixels = _encoded(pixels, premultiplied=not _keeps_alpha_apart(image))
    if pixels.shape[2] == 4 and not _keeps_alpha_apart(image):
        pixels = _associated(image, pixels, is_float)
    return np.ascontiguousarray(pixels) if is_float or not is_plain else textures.quantised(pixels)


def _encoded(pixels: np.ndarray, premultiplied: bool) -> np.ndarray:
    """Scene-linear floats as the sRGB numbers of the file; alpha, where multiplied in, stays so."""
    alpha = np.maximum(pixels[..., 3:], 1e-6) if premultiplied and pixels.shape[2] == 4 else 1.0
    linear = pixels[..., :3] / alpha
    encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)
    return np.concatenate([encoded * alpha, pixels[..., 3:]], 2).astype(np.float32)


def _alpha_power(image: bpy.types.Image, is_float: bool) -> int:
    """Power of alpha by which Cycles' colours differ from those in Blender's buffer (straight bytes, multiplied floats).

    Cycles 5 multiplies where the mode says straight.  Cycles 4 multiplies what it finds in a file whatever
    the mode says, unless the format always holds multiplied colours.
    """
    own = _read_by_cycles(image)
    straight = image.alpha_mode == "STRAIGHT"
    if bpy.app.version >= (5, 0):
        if is_float:
            return int(straight and not own)
        return int(straight or own)
    if not is_float:
        return 2 if own and not straight else 1
    if not own:
        return 0
    return (0 if straight else 1) - (image.file_format in _ALWAYS_ASSOCIATED)


def _associated(image: bpy.types.Image, pixels: np.ndarray, is_float: bool) -> np.ndarray:
    """Colours with alpha multiplied in as Cycles has them."""
    power = _alpha_power(image, is_float)
    if power == 0:
        return pixels
    alpha = pixels[..., 3:]
    factor = alpha if power == 1 else alpha**power if power > 0 else 1 / np.maximum(alpha, 1e-6)
    return np.concatenate([pixels[..., :3] * factor, alpha], 2)


def _to_linear(image: bpy.types.Image, pixels: np.ndarray) -> np.ndarray:
    """Pixels of an unusual colour space as scene-linear floats, by Blender's own configuration."""
    config = f"{bpy.utils.system_resource('DATAFILES')}/colormanagement/config.ocio"
    buffer = oiio.ImageBuf(np.ascontiguousarray(pixels))
    converted = oiio.ImageBufAlgo.colorconvert(buffer, image.colorspace_settings.name, "scene_linear", colorconfig=config)
    if converted.has_error:
        raise ImageMissing(f"colour space '{image.colorspace_settings.name}' is unknown")
    return np.ascontiguousarray(converted.get_pixels(oiio.FLOAT).reshape(pixels.shape), np.float32)
