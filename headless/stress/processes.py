"""What a system does to a process: signals, kills, full disks, shared and unwritable caches, forks; outputs are whole or as before."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ...core.layers import read_exr
from ...core.threads import thread_count
from .outcome import Outcome

MOMENTS = 50  # of a render at which it is interrupted
KILLS = 10  # and killed
SECONDS = 300  # after which a process counts as hung, on a machine that others use, too
TOGETHER = 4  # processes on one cache
OLD = b"what was there before"
# The interpreter's own start is not ours: the clock runs from when the command line is there to hear.
START = "from lumigate.headless.cli import program; print('ready', flush=True); program()"
RENDER = ("render", "cornell", "-o", "out.exr", "--size", "96x54", "--vpls", "256", "--pixel-samples", "2")
GATES = ("--method", "visibility-gates", "--voxels", "32")
# A kernel compiled as by a fresh process, and the hash of what it gives.
COMPILE = """
import zlib
from lumigate.core import jit
from lumigate.core.sampling.sequences import r2_points
print('ready', flush=True)
print(zlib.crc32(jit.kernel(r2_points.py_func)(0, 64, 3).tobytes()))
"""
# A process that renders, and children of it that do so with 1, 2 and 16 threads.
CHILDREN = """
import multiprocessing, sys
from lumigate.headless.stress.processes import picture_hash
if __name__ == '__main__':
    print('ready', flush=True)
    print(picture_hash(2))
    with multiprocessing.get_context(sys.argv[1]).Pool(2) as pool:
        print(*pool.map(picture_hash, (1, 2, 16)))
"""


@dataclass(frozen=True)
class Ending:
    """How a process ended: its status (minus the signal that killed it), what it said, and the seconds since it was ready."""

    status: int
    out: str
    err: str
    seconds: float


def run(
    code: str,
    *arguments: str,
    folder: Path,
    stop: tuple[int, float] | None = None,
    limit: Callable[[], None] | None = None,
    **environment: str,
) -> Ending:
    """A Python process in `folder` that runs `code`, which prints `ready` first.

    stop: a signal and the seconds after `ready` at which it is sent.  limit: called in the process before anything else.
    """
    command = [sys.executable, "-c", code, *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder, env=os.environ | environment, preexec_fn=limit
    ) as process:
        process.stdout.readline()
        begin = time.monotonic()
        try:
            if stop is not None:
                time.sleep(stop[1])
                process.send_signal(stop[0])
            out, err = process.communicate(timeout=SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            out, err = process.communicate()
            err += f"no end after {SECONDS} s"
    return Ending(process.returncode, out, err, time.monotonic() - begin)


def interruption(folder: Path, moment: float) -> str:
    """What is wrong after SIGINT `moment` seconds into a render whose output exists already; '' where nothing is."""
    output = folder / "out.exr"
    output.write_bytes(OLD)
    ending = run(START, *RENDER, folder=folder, stop=(signal.SIGINT, moment))
    names = sorted(path.name for path in folder.iterdir())
    if names != ["out.exr"]:
        return f"left {', '.join(names)}"
    if ending.status == 0 and output.read_bytes() != OLD:
        return ""
    if ending.status != 130 or ending.err.splitlines()[-1:] != ["lumigate: cancelled"] or "Traceback" in ending.err:
        return f"status {ending.status}: {' / '.join(ending.err.split(chr(10))[-4:])[:300]}"
    return "" if output.read_bytes() == OLD else "the old output is gone"


def killing(folder: Path, moment: float) -> str:
    """What is wrong with the output after SIGKILL: it is the old one or a whole new one."""
    output = folder / "out.exr"
    output.write_bytes(OLD)
    run(START, *RENDER, folder=folder, stop=(signal.SIGKILL, moment))
    if output.read_bytes() == OLD:
        return ""
    try:
        return "" if len(read_exr(output)) else "an empty picture"
    except Exception as error:  # a torn file is the finding
        return f"torn: {error}"


def _many(case: Callable[[Path, float], str], moments: list[float]) -> list[str]:
    """Faults of a case at each of the moments, in folders of their own."""

    def one(moment: float) -> str:
        with tempfile.TemporaryDirectory() as name:
            fault = case(Path(name), moment)
        return fault and f"after {moment:.2f} s: {fault}"

    with ThreadPoolExecutor(thread_count()) as pool:
        return [fault for fault in pool.map(one, moments) if fault]


def _counted(case: str, faults: list[str]) -> Outcome:
    return Outcome(case + (f" ({faults[0]})" if faults else ""), "all", "0", len(faults), not faults)


def signals(moments: int = MOMENTS, kills: int = KILLS) -> Iterator[Outcome]:
    """Interrupts and kills, spread evenly but at random over a render."""
    rng = random.Random(1)
    with tempfile.TemporaryDirectory() as name:
        whole = run(START, *RENDER, folder=Path(name))
    yield _counted("a render that nothing stops: faults", [] if whole.status == 0 else [whole.err[-300:]])
    for case, count, label in (
        (interruption, moments, "interrupted (SIGINT): not one line, or outputs touched"),
        (killing, kills, "killed (SIGKILL): half an output"),
    ):
        times = [(k + rng.random()) / count * whole.seconds for k in range(count)]
        yield _counted(f"a render {label}, {count} random moments", _many(case, times))


def compilers(together: int = TOGETHER, kills: int = KILLS) -> Iterator[Outcome]:
    """Processes that compile one kernel: without a cache, all at once into an empty one, and after some that were killed."""
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(together) as pool:
        folder = Path(name)
        own = {"folder": folder, "NUMBA_CACHE_DIR": str(folder / "numba")}
        whole = run(COMPILE, folder=folder, NUMBA_CACHE_DIR="/dev/null/none")
        yield _counted("a kernel without a writable cache: faults", [] if whole.status == 0 and whole.out else [whole.err[-200:]])
        endings = list(pool.map(lambda _: run(COMPILE, **own), range(together)))
        yield _counted(f"{together} processes on one empty cache: other results", [e.err[-200:] for e in endings if e.out != whole.out])
        for k in range(kills):
            for file in (folder / "numba").rglob("*.nb?"):
                file.unlink()
            run(COMPILE, stop=(signal.SIGKILL, whole.seconds * k / kills), **own)
        ending = run(COMPILE, **own)
        sound = ending.out == whole.out
        yield _counted(f"after {kills} processes killed while they compiled: other results", [] if sound else [ending.err[-200:]])


def _pixels(picture: Path) -> int:
    """A hash of all layers; the file's own bytes hold the second in which it was written."""
    return zlib.crc32(b"".join(array.tobytes() for array in read_exr(picture).values()))


def caches() -> Iterator[Outcome]:
    """Two renders that build one topology at once, and one whose cache cannot be written."""
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(2) as pool:
        folders = [Path(name) / f"render{k}" for k in range(2)]
        for place in folders:
            place.mkdir()
        endings = list(pool.map(lambda place: run(START, *RENDER, *GATES, folder=place, LUMIGATE_CACHE=f"{name}/cache"), folders))
        pictures = {_pixels(place / "out.exr") for place in folders if (place / "out.exr").exists()}
        faults = [ending.err[-200:] for ending in endings if ending.status] + ["pictures differ"] * (len(pictures) != 1)
        yield _counted("two renders that build one topology: faults, other pictures", faults)
        ending = run(START, *RENDER, *GATES, folder=Path(name), LUMIGATE_CACHE="/dev/null/none")
        yield _counted("a render without a writable cache: faults", [] if ending.status == 0 else [ending.err[-200:]])


def picture_hash(threads: int) -> int:
    """Of the indirect light of the stress room, denoised."""
    from .rooms import light, room

    return zlib.crc32(light(room(), "importance-sampling", threads=threads, denoise=True)["Indirect"].tobytes())


def children() -> Iterator[Outcome]:
    """Forked and spawned children of a process that has rendered already: the same bits."""
    for way in ("fork", "spawn"):
        with tempfile.TemporaryDirectory() as name:
            ending = run(CHILDREN, way, folder=Path(name))
        hashes = set(ending.out.split())
        sound = ending.status == 0 and len(hashes) == 1
        yield _counted(
            f"renders in a process and in children by {way}: other bits, faults", [] if sound else [f"{hashes} {ending.err[-200:]}"]
        )


def limits() -> Iterator[Outcome]:
    """A full disk and too little memory end in one line each, and leave no file."""
    import resource

    def full_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    def little_memory() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))

    for what, limit, more in (("full disk", full_disk, ()), ("6 GiB for 32768x32768 pixels", little_memory, ("--size", "32768x32768"))):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            ending = run(START, *RENDER, *more, folder=folder, limit=limit)
            lines = [line for line in ending.err.splitlines() if "warning" not in line]
            sound = ending.status == 2 and len(lines) == 1 and lines[0].startswith("lumigate: error: ") and not any(folder.iterdir())
            yield _counted(f"{what}: not one line, or a file left", [] if sound else [f"status {ending.status}: {ending.err[-300:]}"])
