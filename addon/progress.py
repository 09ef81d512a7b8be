"""How far a render is, and how long it will still take."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

# Share of each stage of a pass in its time, in the order in which they run.
_SHARES = {
    "rays": 0.04,
    "emitters": 0.02,
    "view": 0.12,
    "direct": 0.12,
    "cache": 0.14,
    "glossy": 0.12,
    "vpls": 0.12,
    "indirect": 0.24,
    "denoise": 0.05,
    "groups": 0.03,
}
_TILE = re.compile(r"tile (\d+) of (\d+): (.*)")  # of a picture that does not fit into memory: `core.tiled`
_MOST = 0.99  # what is shown before the end
_ENOUGH = 0.1  # of the work must be done before the time left is worth showing
_LABELS = {
    "loading": "loading its code",
    "rays": "building the ray tracer",
    "emitters": "gathering the lamps",
    "view": "tracing the view",
    "direct": "direct light",
    "cache": "filling the cache of light",
    "glossy": "reflections",
    "vpls": "placing virtual point lights",
    "indirect": "indirect light",
    "denoise": "denoising",
    "groups": "telling light groups apart",
    "enlarging": "enlarging the light",
}


class Progress:
    """What a render has reached; one thread tells, others read.

    time_budget: seconds, None where the picture ends by itself.  open_end: nobody knows how many passes there will be.
    fraction: of the whole work, never falling.
    """

    def __init__(self, time_budget: float | None = None, *, open_end: bool = False):
        self.fraction = 0.0
        self._label = "starting"
        self._compiling: Callable[[], bool] = lambda: False
        self._budget = time_budget
        self._open_end = open_end
        self._begin = time.perf_counter()

    def watch(self, compiling: Callable[[], bool]) -> None:
        """Ask this whether code is being compiled: that happens once on a machine, and takes longer than most renders."""
        self._compiling = compiling

    def advance(self, stage: str, fraction: float) -> None:
        """The work is at `fraction` (0..1) of `stage`."""
        tile = _TILE.match(stage)
        done, count, stage = (int(tile[1]) - 1, int(tile[2]), tile[3]) if tile else (0, 1, stage)
        self._label = (f"tile {tile[1]} of {tile[2]}, " if tile else "") + _LABELS.get(stage, stage)
        if self._budget is not None:
            reached = (time.perf_counter() - self._begin) / self._budget
        elif self._open_end:
            reached = 0.0
        else:
            stages = list(_SHARES)
            before = stages.index(stage) if stage in _SHARES else 0
            reached = (done + sum(_SHARES[name] for name in stages[:before]) + _SHARES.get(stage, 0.0) * fraction) / count
        self.fraction = max(self.fraction, min(reached, _MOST))

    @property
    def seconds_left(self) -> float | None:
        """Seconds to the end, None where that cannot be told yet."""
        elapsed = time.perf_counter() - self._begin
        if self._budget is not None:
            return max(0.0, self._budget - elapsed)
        return elapsed * (1 / self.fraction - 1) if self.fraction > _ENOUGH else None

    def __str__(self) -> str:
        """One line for a status bar."""
        if self._compiling():
            return f"{self._label}: compiling, this once"
        left = self.seconds_left
        return self._label if left is None else f"{self._label}, {_clock(left)} left"


def _clock(seconds: float) -> str:
    """Minutes and seconds, as Blender writes them."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes:02d}:{rest:02d}"
