"""A job in parts: command lines of `render` and `bake` that any machine may run, and how the results become one."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ... import sample_scenes
from ...core.layers import Layers

# Stand for the scene's file and the output's folder on the machine that runs a part.
SCENE, OUTPUT = "{scene}", "{output}"
HALO = 32  # pixels around a tile that are rendered for the denoiser, and thrown away
FEWEST, MOST = 8, 64  # frames of a part: the first needs the history of those before it


@dataclass(frozen=True)
class Part:
    """One command line.

    key: its name in the job.  scene: a sample scene's name, or the file's; digest: SHA-256 of the file, None for a sample scene.
    weight: its share of the work, on any scale.
    """

    key: str
    argv: tuple[str, ...]
    scene: str
    digest: str | None
    weight: float = 1.0


def identify(scene: str) -> tuple[str, str | None, bytes | None]:
    """Name, digest and content of a scene; the last two None for a sample scene."""
    if scene in sample_scenes.NAMES:
        return scene, None, None
    content = Path(scene).read_bytes()
    return Path(scene).name, hashlib.sha256(content).hexdigest(), content


def frame_parts(frames: Sequence[int], workers: int, step: int = 1) -> list[tuple[int, ...]]:
    """The frames, in runs that a worker renders in order: two for each worker, where these are neither too short nor too long."""
    size = min(MOST, max(FEWEST, -(-len(frames) // (2 * max(workers, 1)))))
    runs: list[list[int]] = []
    for number in frames:
        if not runs or len(runs[-1]) == size or number != runs[-1][-1] + step:
            runs.append([])
        runs[-1].append(number)
    return [tuple(run) for run in runs]


def tiles(width: int, height: int, side: int) -> Iterator[tuple[int, int, int, int]]:
    """(x0, y0, x1, y1) in pixels of tiles `side` wide, row by row."""
    for y in range(0, height, side):
        for x in range(0, width, side):
            yield x, y, min(x + side, width), min(y + side, height)


def with_halo(tile: tuple[int, int, int, int], width: int, height: int) -> tuple[int, int, int, int]:
    """The tile and the pixels around it, as far as the picture goes."""
    x0, y0, x1, y1 = tile
    return max(0, x0 - HALO), max(0, y0 - HALO), min(width, x1 + HALO), min(height, y1 + HALO)


def joined(parts: dict[tuple[int, int, int, int], Layers], width: int, height: int) -> Layers:
    """One picture of tiles, each with its halo."""
    first = next(iter(parts.values()))
    whole = replace(first, arrays={}, offset=(0, 0), full_size=(width, height))
    for name, array in first.items():
        whole[name] = np.empty((height, width, array.shape[2]), np.float32)
    for (x0, y0, x1, y1), layers in parts.items():
        left, top = layers.offset
        for name in whole:
            whole[name][y0:y1, x0:x1] = layers[name][y0 - top : y1 - top, x0 - left : x1 - left]
    return whole
