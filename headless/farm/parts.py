"""A job in parts: command lines of `render` and `bake` that any machine may run, and how the results become one."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Generic, TypeVar

from ... import sample_scenes
from ...core.settings import SequenceSettings

# Stand for the scene's file and the output's folder on the machine that runs a part.
SCENE, OUTPUT = "{scene}", "{output}"
FEWEST = 8  # frames of a segment: its first one needs the history of those before it
RUN = 8  # frames of a part, about: what a lost worker loses, and what another one can take over
SCOUT = 0.4  # of a frame's time: its probes alone (`core.pipeline.scout`), as measured in the atrium

T = TypeVar("T")


@dataclass(frozen=True)
class Part:
    """One command line.

    key: its name in the job.  scene: a sample scene's name, or the file's; digest: SHA-256 of the file, None for a sample scene.
    weight: its share of the work, on any scale.  segment: parts of one number are best done in order by one worker (`Segments`); None:
    by any.
    """

    key: str
    argv: tuple[str, ...]
    scene: str
    digest: str | None
    weight: float = 1.0
    segment: int | None = None


def identify(scene: str) -> tuple[str, str | None, bytes | None]:
    """Name, digest and content of a scene; the last two None for a sample scene."""
    if scene in sample_scenes.NAMES:
        return scene, None, None
    content = Path(scene).read_bytes()
    return Path(scene).name, hashlib.sha256(content).hexdigest(), content


def handicap_of(shared: SequenceSettings) -> int:
    """Frames that take as long as the probes before a segment's history.

    The history itself takes no longer than the shot's own first frame, which computes as many turns at once.
    """
    return round(SCOUT * shared.history / shared.motion_blur)


def frame_parts(frames: Sequence[int], shot: range, workers: int, handicap: int = 0) -> list[list[tuple[int, ...]]]:
    """Those frames of a shot that are wanted: a segment for each worker, in runs without gaps that are rendered one after the other.

    handicap: frames by which a segment that begins within the shot is shorter than the one that begins it, so that both take as long.
    """
    if not frames:
        return []
    before = min(handicap, shot.index(frames[0]))
    count = max(1, min(workers, (len(frames) + before - handicap) // FEWEST))
    each = (len(frames) + before + (count - 1) * handicap) / count
    bounds = [0, *(round(k * (each - handicap) + handicap - before) for k in range(1, count)), len(frames)]
    return [_runs(frames[begin:end], shot.step) for begin, end in pairwise(bounds)]


def _runs(frames: Sequence[int], step: int) -> list[tuple[int, ...]]:
    size = -(-len(frames) // max(1, round(len(frames) / RUN)))
    runs: list[list[int]] = []
    for number in frames:
        if not runs or len(runs[-1]) == size or number != runs[-1][-1] + step:
            runs.append([])
        runs[-1].append(number)
    return [tuple(run) for run in runs]


class Segments(Generic[T]):
    """What is not handed out yet of rows of parts, each of which one worker does in order.

    A worker's Blender goes on from one part to the next, without the frames before it, only where it has just done those; so a worker
    keeps to its row.  One that has none left takes a row that is nobody's, or else the last half of the longest: the owner of that one
    goes on undisturbed.  Dask's own stealing would take any part, also the owner's next one, and both would then compute history anew.
    """

    def __init__(self, rows: Iterable[Sequence[T]]):
        self._rows = [deque(row) for row in rows]
        self._owned: dict[str, deque[T]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._rows))

    def keep(self, workers: Collection[str]) -> None:
        """The rows of all other workers are nobody's from now on."""
        self._owned = {worker: row for worker, row in self._owned.items() if worker in workers}

    def take(self, worker: str) -> T | None:
        """What this worker does next; None where the others are better left with what there is."""
        row = self._owned.get(worker)
        if not row:
            row = self._owned[worker] = self._another()
        return row.popleft() if row else None

    def _another(self) -> deque[T]:
        self._rows = [row for row in self._rows if row]
        owned = {id(row) for row in self._owned.values()}
        for row in self._rows:
            if id(row) not in owned:
                return row
        longest = max(self._rows, key=len, default=deque())
        taken = [longest.pop() for _ in range(len(longest) // 2)]  # of a single one nothing: its owner has it done as soon
        self._rows.append(deque(reversed(taken)))
        return self._rows[-1]
