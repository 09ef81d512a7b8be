"""The debug layers of a render as PNG files beside it, coloured so that they can be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.layers import CONTRACT, GROUP_LAYERS, Layers, auto_exposure, write_png, write_preview

IDS = ("PointClusters", "PointRepresentatives", "AreaLights", "VisibilityClusters", "GeometryClusters")  # numbers from 1; 0 is none
SHARES = ("VisibleShare", "VisibleShareBlended")  # 0 to 1
SHADOWS = "AreaLightShadow"  # the beginning of the names of more shares
WEIGHTS = "FuzzyWeights"  # the beginning of the names of layers of weights, 0 to 1
_OF_GROUPS = tuple(f"{kind}_" for kind in GROUP_LAYERS)
# From dark blue through green to yellow, of rising luminance.
_SHARE_COLOURS = np.array([[0.10, 0.05, 0.30], [0.16, 0.35, 0.55], [0.20, 0.62, 0.50], [0.60, 0.80, 0.25], [1.0, 0.95, 0.45]])


def write_debug_pictures(output: Path, layers: Layers) -> list[Path]:
    """Write OUT-<layer>.png beside `output` for each layer beyond the contract's and the light groups'; SceneError where one cannot be written."""
    written = []
    for name, array in layers.items():
        if name in CONTRACT or name.startswith(_OF_GROUPS):
            continue
        path = output.with_name(f"{output.stem}-{name}.png")
        if name in IDS:
            write_png(path, id_colours(array[..., 0]))
        elif name in SHARES or name.startswith(SHADOWS):
            write_png(path, share_colours(array[..., 0]))
        elif name.startswith(WEIGHTS):
            write_png(path, array)
        else:
            write_preview(path, array, auto_exposure([array]))
        written.append(path)
    return written


def id_colours(ids: np.ndarray) -> np.ndarray:
    """Display values (H, W, 3) that tell numbers (H, W) apart: neighbouring numbers get colours far from each other; 0 is black."""
    steps = np.array([0.6180339887, 0.7548776662, 0.5698402910])  # irrational: the colours fill the cube evenly
    colours = 0.25 + 0.75 * (ids.astype(np.float64)[..., None] * steps % 1.0)
    return np.where(ids[..., None] > 0, colours, 0.0)


def share_colours(shares: np.ndarray) -> np.ndarray:
    """Display values (H, W, 3) of shares (H, W) from 0, dark blue, to 1, yellow."""
    at = np.linspace(0, 1, len(_SHARE_COLOURS))
    return np.stack([np.interp(shares, at, _SHARE_COLOURS[:, c]) for c in range(3)], axis=-1)
