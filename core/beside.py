"""Two parts of a render at once, so that what either does between its kernels, on one thread, leaves no core idle."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from typing import TypeVar

from .jit import CompileTimer
from .stages import Run
from .threads import PROGRESS_SECONDS, Cancelled

Here, Aside = TypeVar("Here"), TypeVar("Aside")


def side_by_side(run: Run, threads: int, here: Callable[[Run], Here], aside: Callable[[Run], Aside]) -> tuple[Here, Aside]:
    """`here(run)` and `aside(another run)`, on a thread of its own, whose counts are added to those of `run`.

    Neither may read what the other writes: results are then those of one after the other, which is what one thread gives.
    Stages that run at once share the cores; their seconds add up to more than the time that passes.

    Raises:
        Cancelled: the progress function of `run` returned False; `aside` hears of it as it would of its own.
    """
    if threads < 2:
        return here(run), aside(run)
    stopped, latest = False, ("", 0.0)

    def listen(stage: str, done: float) -> bool:
        nonlocal latest
        latest = stage, done
        return not stopped

    other = replace(
        run, progress=listen, seconds={}, rays=dict.fromkeys(run.rays, 0), pairs=0, vpls=0, skipped=[], warnings=[], left_out={}, debug={}
    )
    before = run.seconds.get("jit", 0.0)
    with ThreadPoolExecutor(1, thread_name_prefix="lumigate-beside") as thread, CompileTimer() as compiling:
        pending = thread.submit(aside, other)
        try:
            found = here(run)
            while wait([pending], timeout=PROGRESS_SECONDS).not_done:  # the timeout lets Ctrl-C and a cancel button through
                if run.progress is not None and latest[0] and not run.progress(*latest):
                    raise Cancelled
        finally:
            stopped = True  # nobody may go on once the caller has closed the scene: leaving the block waits
        result = pending.result()
    run.add(other)
    run.seconds["jit"] = before + compiling.seconds  # each of the two has counted what either compiled
    return found, result
