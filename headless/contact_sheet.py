"""One picture with the frames of a sequence side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..core.layers import auto_exposure, read_exr, srgb, write_png

MOST = 48  # frames; of more, so many at even distances
WIDTH = 240  # pixels of a frame, about
GAP = 4


def shrunk(image: np.ndarray, width: int = WIDTH) -> np.ndarray:
    """(H, W, 3) by the mean over squares of whole pixels, about `width` wide; not enlarged."""
    by = max(1, round(image.shape[1] / width))
    rows, columns = (max(1, side // by) for side in image.shape[:2])
    image = image[: rows * by, : columns * by] if min(image.shape[:2]) >= by else image[:1, :1]
    return image.reshape(rows, image.shape[0] // rows, columns, image.shape[1] // columns, -1).mean(axis=(1, 3))


def write_contact_sheet(path: Path, files: Sequence[Path]) -> None:
    """Write `Combined` of these files, exposed alike, as one PNG; SceneError where one cannot be read."""
    chosen = [files[round(k)] for k in np.linspace(0, len(files) - 1, min(len(files), MOST))]
    pictures = [shrunk(read_exr(file)["Combined"]) for file in chosen]
    exposure = np.float32(2.0 ** auto_exposure(pictures))
    height, width = (max(picture.shape[axis] for picture in pictures) for axis in (0, 1))
    columns = math.ceil(math.sqrt(len(pictures) * height / width))
    columns = max(1, min(len(pictures), columns))
    rows = math.ceil(len(pictures) / columns)
    sheet = np.zeros((rows * (height + GAP) + GAP, columns * (width + GAP) + GAP, 3))
    for i, picture in enumerate(pictures):
        y, x = (GAP + place * (side + GAP) for place, side in zip(divmod(i, columns), (height, width)))
        sheet[y : y + picture.shape[0], x : x + picture.shape[1]] = srgb(picture * exposure)
    write_png(path, sheet)
