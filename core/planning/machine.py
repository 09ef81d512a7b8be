"""How fast this machine is: measured once, again where that proves too slow, and kept in the user's cache folder."""

from __future__ import annotations

import contextlib
import json
import os
import platform
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np
import platformdirs

from ..denoise import Denoiser
from ..layers import write_whole
from ..rays import RayScene, intersect
from ..scene import ALL_RAYS
from ..threads import thread_count

VERSION = 2  # of what is measured, and of the file
LOOKS = 3  # how often it is measured at most
TRIANGLES, RAYS = 20_000, 100_000
SIDES = 128, 384  # pixels of the pictures that are denoised
REPEATS = 3


@dataclass(frozen=True)
class Machine:
    """Seconds of this machine's parts.

    ray: of one ray into a cloud of small triangles, on one thread.  denoiser: of any picture; denoiser_pixel: of each of its pixels,
    on `threads` threads.  looks: how often it was measured; of each part the least counts, for other work only ever slows.
    """

    ray: float
    denoiser: float
    denoiser_pixel: float
    threads: int
    looks: int = 1

    def denoising(self, pixels: int, images: int) -> float:
        """Seconds that `images` pictures of `pixels` pixels take to denoise."""
        return images * (self.denoiser + self.denoiser_pixel * pixels)


def cached_machine(threads: int, folder: Path | None = None) -> Machine:
    """This machine by the file in `folder` (None: LUMIGATE_CACHE, else the user's cache folder), measured where there is none.

    A file of another version or machine, or one that cannot be read, is replaced; one that cannot be written costs the time again.
    """
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        kept = json.loads(_file(threads, folder).read_text(encoding="utf-8"))
        if kept.pop("key") == _key():
            return Machine(**kept)
    machine = measure(threads)
    _keep(machine, folder)
    return machine


def look_again(machine: Machine, folder: Path | None = None) -> Machine:
    """The machine measured once more, where it has not been `LOOKS` times, and kept as `cached_machine` keeps it.

    For those whose file proves too slow, as one that was made beside other work does.
    """
    if machine.looks >= LOOKS:
        return machine
    now = measure(machine.threads)
    least = {name: min(getattr(machine, name), getattr(now, name)) for name in ("ray", "denoiser", "denoiser_pixel")}
    again = replace(machine, **least, looks=machine.looks + 1)
    _keep(again, folder)
    return again


def _file(threads: int, folder: Path | None) -> Path:
    asked = os.environ.get("LUMIGATE_CACHE")
    return (folder or Path(asked or platformdirs.user_cache_dir("lumigate"))) / f"machine-{threads}.json"


def _key() -> dict:
    """Whose file it is."""
    return {"version": VERSION, "machine": f"{platform.node()} {platform.machine()}", "cores": thread_count()}


def _keep(machine: Machine, folder: Path | None) -> None:
    path = _file(machine.threads, folder)
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"key": _key(), **asdict(machine)}, indent=2) + "\n"
        write_whole(path, lambda partial: partial.write_text(text, encoding="utf-8"))


def measure(threads: int) -> Machine:
    """Time rays and the denoiser, each the best of a few runs, so that neither compilation nor another process counts."""
    rng = np.random.default_rng(1)
    corners = rng.random((TRIANGLES, 1, 3)) + rng.normal(0, 0.01, (TRIANGLES, 3, 3))
    triangles = np.arange(3 * TRIANGLES, dtype=np.int32).reshape(-1, 3)
    visible = np.full(TRIANGLES, ALL_RAYS, np.uint8)
    origins = rng.random((RAYS, 3)).astype(np.float32)
    directions = rng.normal(size=(RAYS, 3)).astype(np.float32)
    with RayScene(corners.reshape(-1, 3).astype(np.float32), triangles, visible, np.zeros(TRIANGLES, bool)) as scene:
        ray = _best(lambda: intersect(scene, origins, directions, threads=1)) / RAYS
    denoiser = Denoiser()
    try:
        small, large = (_denoising(denoiser, side, threads) for side in SIDES)
    finally:
        denoiser.close()
    pixel = max(0.0, large - small) / (SIDES[1] ** 2 - SIDES[0] ** 2)
    return Machine(ray, max(0.0, small - pixel * SIDES[0] ** 2), pixel, threads)


def _denoising(denoiser: Denoiser, side: int, threads: int) -> float:
    """Seconds of a noisy square, with guides."""
    picture = np.random.default_rng(2).random((side, side, 3), np.float32)
    return _best(lambda: denoiser.denoise(picture, picture, picture, position=picture, threads=threads))


def _best(work) -> float:
    """Least seconds of a few calls, after one that warms up."""
    work()
    seconds = []
    for _ in range(REPEATS):
        begin = perf_counter()
        work()
        seconds.append(perf_counter() - begin)
    return min(seconds)
