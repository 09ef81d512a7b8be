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
from ..core.significance import Significance, compare_errors
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
    half: str | os.PathLike | None = None,
    against: str | os.PathLike | None = None,
    console: Console | None = None,
) -> dict:
    """Compare a layer of two multilayer EXR files, where both hold pixels of the full frame.

    half: a second reference, independent of the first: the reference is the mean of both, and relMSE net of its noise.
    against: another picture: is it better or worse than `test`, beyond chance?

    json: file for the figures.  error_map: PNG; blue is too dark, red too bright, green invalid.
    console: where the table goes, standard output by default.

    Returns:
        What `core.metrics.compare` returns, with test, reference and layer; with `half`, reference_noise; with `against`,
        significance: the fields of `core.significance.Significance` and its verdict.

    Raises:
        SceneError: a file cannot be read, has no such layer, or the pictures are of different size.
    """
    paths = {"test": test, "reference": reference, "half": half, "against": against}
    paths = {role: path for role, path in paths.items() if path is not None}
    pictures = {role: read_exr(path) for role, path in paths.items()}
    layers = [_layer(pictures[role], path, layer) for role, path in paths.items()]
    common = dict(zip(paths, _common(layers, list(pictures.values()))))
    x, r = common["test"], common["reference"]
    if half is not None:
        r = (r + common["half"]) / 2
    result = {**{role: str(path) for role, path in paths.items()}, "layer": layer, **metrics.compare(x, r)}
    if half is not None and result["relmse"] is not None:
        result["relmse"] = metrics.net_relmse(x, common["reference"], common["half"])
        result["reference_noise"] = metrics.reference_noise(common["reference"], common["half"])
    if against is not None:
        found = compare_errors(x, common["against"], common["reference"], common.get("half"))
        result["significance"] = {**vars(found), "verdict": found.verdict}
    console = console or Console()
    _print(result, console)
    if against is not None:
        console.print(_sentence(found, Path(test).name, Path(against).name), markup=False, soft_wrap=True)
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
    if len(set(frames)) > 1:
        sizes = " and ".join(f"{width}x{height}" for width, height in dict.fromkeys(frames))
        raise SceneError(f"the pictures are of different size, {sizes} pixels; render both at one size")
    x0, y0 = (max(picture.offset[axis] for picture in pictures) for axis in (0, 1))
    x1, y1 = (min(picture.offset[axis] + picture.size[axis] for picture in pictures) for axis in (0, 1))
    if x1 <= x0 or y1 <= y0:
        raise SceneError("the pictures show different parts of the frame; render both with one region")
    return [a[y0 - p.offset[1] : y1 - p.offset[1], x0 - p.offset[0] : x1 - p.offset[0]] for a, p in zip(arrays, pictures)]


def _sentence(found: Significance, test: str, other: str) -> str:
    """The verdict in words."""
    verdict = {
        "test": f"{test} is better than {other}",
        "other": f"{other} is better than {test}",
        "neither": f"{test} and {other} cannot be told apart",
    }[found.verdict]
    limits = f"{found.difference:+.3g} (95 % between {found.low:+.3g} and {found.high:+.3g})"
    noise = "" if found.reference_noise is None else f", the reference's noise {found.reference_noise:.2g} of it"
    return f"{verdict}: relMSE of {other} less that of {test} is {limits}, p = {found.p:.2g}{noise}"


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
