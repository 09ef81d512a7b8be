"""Chunks of work over threads, with progress and cancellation between chunks.

Chunk borders depend on the work only, never on the number of threads, and every chunk writes its own
part of the output: the same seed gives the same bits for any number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from threading import Lock

PROGRESS_SECONDS = 0.05  # between calls of a progress function
MOST_THREADS = 1024  # of all renders of this process at once; idle ones are used again before another is begun

_pool: ThreadPoolExecutor | None = None
_opening = Lock()


class Cancelled(Exception):
    """The caller's progress function asked to stop."""


# Called with the done fraction of the present stage (0..1); returns True to go on, False to cancel.
Progress = Callable[[float], bool]


def part(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """The progress of a piece of a stage, which goes from `begin` to `end` of it."""
    return None if progress is None else lambda done: progress(begin + done * (end - begin))


def thread_count(threads: int = 0) -> int:
    """`threads`, or the number of cores this process may use where it is 0."""
    return threads if threads > 0 else len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _workers() -> ThreadPoolExecutor:
    """The threads that all chunks run on: to begin and end two of them for each of a quick picture's 60 loops took 3 % of its time."""
    global _pool
    with _opening:
        if _pool is None:
            _pool = ThreadPoolExecutor(MOST_THREADS, thread_name_prefix="lumigate-chunks")
        return _pool


def end_threads() -> None:
    """End the idle threads that earlier chunks have left waiting for others; the next chunks begin new ones."""
    global _pool
    with _opening:
        pool, _pool = _pool, None
    if pool is not None:
        pool.shutdown(wait=True)


def _forget_threads() -> None:
    """In a forked process: no thread of the parent's lives there."""
    global _pool, _opening
    _pool, _opening = None, Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_threads)


def run_chunks(work: Callable[[int, int], object], n: int, chunk: int, threads: int = 0, progress: Progress | None = None) -> list:
    """Call `work(begin, end)` for consecutive chunks of range(n); results in chunk order.

    Raises:
        Cancelled: `progress` returned False; chunks not yet begun are dropped.
    """
    bounds = [(b, min(b + chunk, n)) for b in range(0, n, max(1, chunk))]
    results: list = [None] * len(bounds)
    threads = min(thread_count(threads), max(1, len(bounds)))
    if threads == 1:
        for i, (b, e) in enumerate(bounds):
            results[i] = work(b, e)
            if progress is not None and not progress((i + 1) / len(bounds)):
                raise Cancelled
        return results
    # Threads fetch their chunks themselves: to wait until another thread hands over the next took 10 to 20 % of a quick picture's time.
    tickets = iter(range(len(bounds)))
    taking = Lock()
    done = [0] * threads
    stopped = False

    def fetch(thread: int) -> None:
        nonlocal stopped
        try:
            while not stopped:
                with taking:
                    i = next(tickets, None)
                if i is None:
                    return
                results[i] = work(*bounds[i])
                done[thread] += 1
        except BaseException:
            stopped = True
            raise

    pending = [_workers().submit(fetch, thread) for thread in range(threads)]
    try:
        while pending:
            # The timeout lets Ctrl-C and a cancel button through.
            finished, pending = wait(pending, timeout=PROGRESS_SECONDS, return_when=FIRST_EXCEPTION)
            for future in finished:
                future.result()
            if progress is not None and not progress(sum(done) / len(bounds)):
                raise Cancelled
    finally:
        stopped = True
        wait(pending)  # what they write into may be gone after this
    return results
