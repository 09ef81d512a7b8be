"""A film shot on many machines, on paper and by simulation: what is sent, what is kept, where it stops scaling."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from .parts import Segments, frame_parts


@dataclass(frozen=True)
class Shot:
    """What is rendered, and on what; `measured` by `bench farm`, the rest by definition or assumption.

    frames, pixels, triangles: of the shot.  cores: of a worker.
    pixel_seconds: CPU seconds a pixel of a frame in a sequence (measured).  triangle_seconds: CPU seconds a triangle of extraction and
    hierarchies (measured), of which `parallel` part runs on all cores.  file_bytes: a triangle of the .blend file (measured).
    pixel_bytes: of a frame's EXR file (measured).  task_seconds: of the scheduler for a part (measured).  start_seconds: of Blender and
    the kernels' cache on a worker (measured).  link: bytes a second of the client's and the scheduler's network (assumed, 10 Gbit/s).
    warm_up: frames that take as long as what a worker computes before its first one, and wherever it does not go on (measured: history,
    and the probes before that).  spread: standard deviation of a frame's time (of its logarithm).
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
    warm_up: float = 9.0
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
    segments = frame_parts(range(shot.frames), range(shot.frames), workers)
    busy = len(segments)
    return {
        "frames": shot.frames * shot.frame_seconds / busy,
        "history": shot.warm_up * shot.frame_seconds,
        "scene": busy * shot.scene_seconds,
        "pictures": shot.frames * shot.picture_seconds,
        "scheduler": sum(map(len, segments)) * shot.task_seconds,
    }


def simulate(shot: Shot, workers: int, seed: int = 0) -> float:
    """Seconds of the whole job, whose parts are handed out as by `Segments`: scenes queue on the way out, pictures on the way back, parts
    at the scheduler.

    A worker that does not go on where it was, at the beginning of a segment and of what it takes from another one's, warms up.
    """
    rng = np.random.default_rng(seed)
    segments = Segments(frame_parts(range(shot.frames), range(shot.frames), workers))
    out = scheduler = 0.0  # when each is free
    free = [(0.0, worker, -1) for worker in range(workers)]  # when, who, and the frame that it would go on with; -1: it has no scene yet
    ends: list[tuple[float, int]] = []
    while free:
        at, worker, following = heapq.heappop(free)
        part = segments.take(str(worker))
        if part is None:
            continue
        scheduler = at = max(at, scheduler) + shot.task_seconds
        if following < 0:
            out = max(at, out) + shot.scene_seconds
            at = out + shot.start_seconds
        frames = (shot.frame_seconds * rng.lognormal(-0.5 * shot.spread**2, shot.spread, len(part))).sum()
        at += frames + (shot.warm_up * shot.frame_seconds if part[0] != following else 0.0)
        heapq.heappush(free, (at, worker, part[-1] + 1))
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
