"""One layer of one file against the same layer of another: figures, a table, an error map."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..core import metrics
from ..core.errors import SceneError
from ..core.layers import Layers, read_exr, write_png
from .results import write_json

_MEANINGS = {
    "relmse": "mean of (x - r)² / (r² + e)",
    "rmse": "root mean square error / mean",
    "bias": "mean error / mean, signed",
    "flip": "HDR-FLIP, mean",
    "invalid": "pixels NaN or infinite",
}


def compare_files(
    test: str | os.PathLike,
    reference: str | os.PathLike,
    layer: str = "Indirect",
    json: str | os.PathLike | None = None,
    error_map: str | os.PathLike | None = None,
    *,
    console: Console | None = None,
) -> dict:
    """Compare a layer of two multilayer EXR files, where both hold pixels of the full frame.

    json: file for the figures.  error_map: PNG; blue is too dark, red too bright, green invalid.
    console: where the table goes, standard output by default.

    Returns:
        What `core.metrics.compare` returns, with test, reference and layer.

    Raises:
        SceneError: a file cannot be read, has no such layer, or the pictures are of different size.
    """
    pictures = [read_exr(path) for path in (test, reference)]
    x, r = _common([_layer(picture, path, layer) for picture, path in zip(pictures, (test, reference))], pictures)
    result = {"test": str(test), "reference": str(reference), "layer": layer, **metrics.compare(x, r)}
    _print(result, console or Console())
    if json is not None:
        write_json(Path(json), result)
    if error_map is not None:
        write_png(error_map, metrics.error_map(x, r))
    return result


def _layer(picture: Layers, path: str | os.PathLike, name: str) -> np.ndarray:
    if name not in picture:
        raise SceneError(f"{path} has no layer {name!r}; name one of {', '.join(picture)}")
    return picture[name]


def _common(arrays: list[np.ndarray], pictures: list[Layers]) -> list[np.ndarray]:
    """The pixels that both data windows hold, where they are windows of one frame."""
    frames = [picture.full_size or picture.size for picture in pictures]
    if frames[0] != frames[1]:
        sizes = " and ".join(f"{width}x{height}" for width, height in frames)
        raise SceneError(f"the pictures are of different size, {sizes} pixels; render both at one size")
    x0, y0 = (max(picture.offset[axis] for picture in pictures) for axis in (0, 1))
    x1, y1 = (min(picture.offset[axis] + picture.size[axis] for picture in pictures) for axis in (0, 1))
    if x1 <= x0 or y1 <= y0:
        raise SceneError("the pictures show different parts of the frame; render both with one region")
    return [a[y0 - p.offset[1] : y1 - p.offset[1], x0 - p.offset[0] : x1 - p.offset[0]] for a, p in zip(arrays, pictures)]


def _print(result: dict, console: Console) -> None:
    table = Table(title=escape(f"{result['layer']}: {Path(result['test']).name} against {Path(result['reference']).name}"))
    for heading, justify in (("metric", "left"), ("value", "right"), ("meaning", "left")):
        table.add_column(heading, justify=justify)
    for name, meaning in _MEANINGS.items():
        value = result[name]
        text = "undefined" if value is None else str(value) if name == "invalid" else f"{value:+.4f}" if name == "bias" else f"{value:.4g}"
        table.add_row(name, text, meaning)
    console.print(table)
    for line in result["warnings"]:
        console.print(f"warning: {line}", markup=False)
