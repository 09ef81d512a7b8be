"""Lightmaps as files: linear OpenEXR, or PNG with a stated encoding."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..core.layers import srgb, write_picture, write_png
from ..core.lightmaps import Lightmap
from ..core.settings import CONTENTS

FORMATS = ("exr", "png")


def write_lightmap(folder: Path, lightmap: Lightmap, content: str, kind: str) -> dict:
    """Write one lightmap into `folder`; its file, size and encoding, as `lightmaps.json` lists them.

    A value is `scale` times what the file holds, decoded: an EXR is linear with scale 1; a PNG has 8 bits with the sRGB curve, and
    the brightest texel is its white.
    """
    path = free_path(folder, lightmap.name, kind)
    height, width = lightmap.image.shape[:2]
    listed = {"name": lightmap.name, "file": path.name, "size": [width, height]}
    if kind == "exr":
        write_picture(path, lightmap.image, {"content": content, "unit": CONTENTS[content]})
        return listed | {"encoding": "linear", "scale": 1.0}
    scale = png_scale(lightmap.image)
    write_png(path, srgb(lightmap.image / np.float32(scale)))
    return listed | {"encoding": "sRGB", "scale": scale}


def png_scale(image: np.ndarray) -> float:
    """The value that a PNG shows as white."""
    return float(image.max()) or 1.0


def free_path(folder: Path, name: str, kind: str) -> Path:
    """A path in `folder` that no file has yet, by a name that every system can hold."""
    stem = re.sub(r"[^\w.\- ]", "_", name).strip(" .")[:100] or "lightmap"
    path, number = folder / f"{stem}.{kind}", 1
    while path.exists():
        number += 1
        path = folder / f"{stem}-{number}.{kind}"
    return path
