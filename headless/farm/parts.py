"""A job in parts: command lines of `render` and `bake` that any machine may run, and how the results become one."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ... import sample_scenes

# Stand for the scene's file and the output's folder on the machine that runs a part.
SCENE, OUTPUT = "{scene}", "{output}"
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
