"""The layers of a render as one multilayer image of the open file."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import bpy
import numpy as np

from ..core.layers import Layers, write_exr

IMAGE_NAME = "Lumigate Layers"


def write_layers(folder: Path, layers: Layers) -> Path:
    """Write `layers` at the size of the full frame to a temporary file, in any thread; whoever loads it removes it."""
    handle, path = tempfile.mkstemp(suffix=".exr", prefix="lumigate-", dir=folder)
    os.close(handle)
    return write_exr(path, full_frame(layers))


def full_frame(layers: Layers) -> Layers:
    """The same layers, black where the render border has cut off: an image has no border."""
    if layers.full_size is None or layers.full_size == layers.size:
        return layers
    (left, top), (width, height) = layers.offset, layers.full_size
    right, bottom = width - left - layers.size[0], height - top - layers.size[1]
    padded = {name: np.pad(array, ((top, bottom), (left, right), (0, 0))) for name, array in layers.items()}
    return Layers(padded, view_layer=layers.view_layer, metadata=layers.metadata)


def load_layers(path: Path) -> bpy.types.Image:
    """The multilayer image `IMAGE_NAME` of this file from the file at `path`, which it packs and removes.

    An image of that name is replaced wherever it is used.
    """
    try:
        image = bpy.data.images.load(str(path))
        image.pack()
        len(image.pixels)  # reads the file: only then Blender knows that it is multilayer
    finally:
        path.unlink(missing_ok=True)
    before = bpy.data.images.get(IMAGE_NAME)
    if before is not None:
        before.user_remap(image)
        bpy.data.images.remove(before)
    image.name = IMAGE_NAME
    image.use_view_as_render = True  # as bright as the render that it belongs to
    return image
