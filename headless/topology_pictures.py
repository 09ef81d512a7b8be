"""The topology drawn: the skeleton over a picture, and the clusters beside it, like the paper's Figures 2 and 9."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.layers import Layers, auto_exposure, srgb, write_png
from ..core.pipeline import render
from ..core.scene import Camera, Scene
from ..core.settings import RenderSettings
from ..core.topology import Topologies, Topology
from .debug_pictures import id_colours

_ARC, _GATE = (1.0, 0.82, 0.1), (0.1, 0.8, 1.0)
_DARKEN = 0.55  # of the picture under the lines
_BEHIND = 0.05  # m, that a line may lie behind the surface that is seen


def draw(scene: Scene, path: Path, voxels: int, known: Topologies) -> None:
    """Write a PNG of two halves: the picture with the skeleton and the gates' outlines; the visibility clusters."""
    settings = RenderSettings(
        method="visibility-gates", gates="guided", voxels=voxels, vpls=1024, pixel_samples=4, debug_layers=True, denoise=True
    )
    layers = render(scene, settings, topologies=known).layers
    topology = known.of(scene, voxels)
    shown = srgb(layers["Combined"] * np.float32(2.0 ** auto_exposure([layers["Combined"]]))) * _DARKEN
    over_lines(shown, layers, scene, topology)
    clusters = id_colours(layers["VisibilityClusters"][..., 0])
    write_png(path, np.concatenate([shown, clusters * (0.35 + 0.65 * srgb(layers["Albedo"].mean(axis=2, keepdims=True)))], axis=1))


def over_lines(image: np.ndarray, layers: Layers, scene: Scene, topology: Topology) -> None:
    """Draw the skeleton's arcs and the disks' rims into `image` (H, W, 3), where no surface hides them."""
    place = topology.grid.position_of(topology.skeleton.place)
    eye = scene.camera.matrix[:3, 3]
    seen = np.linalg.norm(layers["Position"] - scene.origin - eye, axis=2)
    seen[layers["Depth"][..., 0] > 1e9] = np.inf
    _segments(image, seen, scene.camera, place[topology.skeleton.arcs], _ARC)
    rims = topology.disks.outlines().astype(np.float64)
    _segments(image, seen, scene.camera, np.stack([rims, np.roll(rims, -1, axis=1)], axis=2).reshape(-1, 2, 3), _GATE)


def _segments(image: np.ndarray, seen: np.ndarray, camera: Camera, ends: np.ndarray, colour) -> None:
    """Straight lines between ends (S, 2, 3), sampled densely enough for the picture's size."""
    steps = np.linspace(0, 1, 48)[:, None, None]
    points = (ends[:, 0] + steps * (ends[:, 1] - ends[:, 0])).reshape(-1, 3)
    column, row, away = project(camera, points)
    height, width = seen.shape
    inside = (away > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row, away = column[inside].astype(int), row[inside].astype(int), away[inside]
    open_ = away < seen[row, column] + _BEHIND
    image[row[open_], column[open_]] = colour


def project(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Column and row (pixels of the border) and distance (m) of points (N, 3) before a perspective camera; behind it, distance 0."""
    local = (points - camera.matrix[:3, 3]) @ camera.matrix[:3, :3]
    ahead = np.maximum(-local[:, 2], 1e-9)
    left, right, bottom, top = camera.window
    column = (local[:, 0] / ahead - left) / (right - left) * camera.width - camera.border[0]
    row = (top - local[:, 1] / ahead) / (top - bottom) * camera.height - camera.border[1]
    return column, row, np.where(local[:, 2] < 0, np.linalg.norm(local, axis=1), 0.0)


def plot_thinning(path: Path, rows: list[dict]) -> None:
    """The time of the thinning against resolution, from the rows of `bench topology`, beside n^3."""
    from matplotlib.figure import Figure

    found = [(int(row["case"].split()[2].rstrip(":")), row["value"]) for row in rows if row["case"].startswith("thinning at")]
    at, seconds = (np.array(column) for column in zip(*sorted(found)))
    figure = Figure(figsize=(5, 3.2), layout="constrained")
    axes = figure.add_subplot()
    axes.loglog(at, seconds, "o-", label="distance, opening and collapse")
    axes.loglog(at, seconds[-1] * (at / at[-1]) ** 3, ":", color="grey", label="in proportion to the voxels")
    axes.set_xlabel("voxels along the longest side")
    axes.set_ylabel("seconds")
    axes.set_xticks(at, [str(n) for n in at], minor=False)
    axes.minorticks_off()
    axes.legend()
    figure.savefig(path, dpi=110)
