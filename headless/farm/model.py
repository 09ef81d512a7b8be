"""A film shot on many machines, on paper and by simulation: what is sent, what is kept, where it stops scaling."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from .parts import frame_parts


@dataclass(frozen=True)
class Shot:
    """What is rendered, and on what; `measured` by `bench farm`, the rest by definition or assumption.

    frames, pixels, triangles: of the shot.  cores: of a worker.
    pixel_seconds: CPU seconds a pixel of a frame in a sequence (measured).  triangle_seconds: CPU seconds a triangle of extraction and
    hierarchies (measured), of which `parallel` part runs on all cores.  file_bytes: a triangle of the .blend file (measured).
    pixel_bytes: of a frame's EXR file (measured).  task_seconds: of the scheduler for a part (measured).  start_seconds: of Blender and
    the kernels' cache on a worker (measured).  link: bytes a second of the client's and the scheduler's network (assumed, 10 Gbit/s).
    history: exposures before a part's first frame;  spread: standard deviation of a frame's time (of its logarithm).
    """

    frames: int = 2000
    pixels: float = 3840 * 2160
    triangles: float = 50e6
    cores: int = 32
    pixel_seconds: float = 1.5e-4
    triangle_seconds: float = 1.2e-6
    file_bytes: float = 60.0
    pixel_bytes: float = 70.0
    task_seconds: float = 0.005
    start_seconds: float = 10.0
    link: float = 1.25e9
    history: int = 7
    spread: float = 0.2

    @property
    def frame_seconds(self) -> float:
        """Of one frame on one worker; extraction runs on one core."""
        return self.pixels * self.pixel_seconds / self.cores + self.triangles * self.triangle_seconds

    @property
    def scene_seconds(self) -> float:
        """Of the scene's file through the client's link, to one worker."""
        return self.triangles * self.file_bytes / self.link

    @property
    def picture_seconds(self) -> float:
        """Of a frame's file through the same link."""
        return self.pixels * self.pixel_bytes / self.link


def on_paper(shot: Shot, workers: int) -> dict[str, float]:
    """Seconds of a job by its parts: what is shared among workers, and what goes through one link or one scheduler."""
    parts = frame_parts(range(shot.frames), workers)
    exposures = shot.frames + sum(min(shot.history, part[0]) for part in parts)
    busy = min(workers, len(parts))
    return {
        "frames": shot.frames * shot.frame_seconds / busy,
        "history": (exposures - shot.frames) * shot.frame_seconds / busy,
        "scene": busy * shot.scene_seconds,
        "pictures": shot.frames * shot.picture_seconds,
        "scheduler": len(parts) * shot.task_seconds,
    }


def simulate(shot: Shot, workers: int, seed: int = 0) -> float:
    """Seconds of the whole job: workers take part after part; scenes queue on the way out, pictures on the way back, parts at the scheduler."""
    rng = np.random.default_rng(seed)
    parts = frame_parts(range(shot.frames), workers)
    out = scheduler = 0.0  # when each is free
    free = [(0.0, False)] * min(workers, len(parts))  # of a worker: when, and whether it has the scene
    heapq.heapify(free)
    ends: list[tuple[float, int]] = []
    for part in parts:
        at, warm = heapq.heappop(free)
        scheduler = at = max(at, scheduler) + shot.task_seconds
        if not warm:
            out = max(at, out) + shot.scene_seconds
            at = out + shot.start_seconds
        exposures = len(part) + min(shot.history, part[0])
        at += (shot.frame_seconds * rng.lognormal(-0.5 * shot.spread**2, shot.spread, exposures)).sum()
        heapq.heappush(free, (at, True))
        ends.append((at, len(part)))
    back = 0.0
    for end, pictures in sorted(ends):
        back = max(back, end) + pictures * shot.picture_seconds
    return back


def scaling(shot: Shot, counts=(1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)) -> list[dict]:
    """Time, speedup and efficiency on so many workers."""
    alone = simulate(shot, 1)
    found = []
    for workers in counts:
        seconds = float(np.median([simulate(shot, workers, seed) for seed in range(3)]))
        found.append({"workers": workers, "seconds": seconds, "speedup": alone / seconds, "efficiency": alone / seconds / workers})
    return found
