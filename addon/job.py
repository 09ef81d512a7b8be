"""Work in a thread of its own, so that Blender's window stays alive: it can be watched, cancelled and left behind.

A job reads the core's arrays only, never Blender's data: it may go on for a moment after its owner, a file or this
extension has gone.  Whoever cancels does not wait for it.
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from .progress import Progress

if TYPE_CHECKING:
    from ..core.pipeline import RenderResult
    from ..core.scene import Scene
    from ..core.settings import RenderSettings

_running: set[Job] = set()
_loading: Job | None = None
_PATIENCE = 30.0  # seconds that `end_all` waits for a thread, at most


class Job:
    """One call of `work(progress)` in a thread.

    progress: what the thread has reached.  result: what `work` returned;  error: what it raised; both None before that.
    """

    def __init__(self, work: Callable[[Callable[[str, float], bool]], Any], progress: Progress | None = None):
        self.progress = progress or Progress()
        self.result: Any = None
        self.error: BaseException | None = None
        self.cancelled = False
        self._work = work
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name="lumigate")
        _running.add(self)
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether there is a result, or an error."""
        return self._done.is_set()

    def wait(self, seconds: float) -> bool:
        """Wait for the end for so long at most; whether it has come."""
        return self._done.wait(seconds)

    def cancel(self) -> None:
        """Ask the thread to end, and return at once: there will be no result."""
        self.cancelled = True

    def _advance(self, stage: str, fraction: float) -> bool:
        self.progress.advance(stage, fraction)
        return not self.cancelled

    def _run(self) -> None:
        from ..core.threads import Cancelled

        try:
            self.result = self._work(self._advance)
        except Cancelled:
            self.cancelled = True
        except BaseException as error:  # the owner raises it in its own thread
            self.error = error
        finally:
            _running.discard(self)
            self._done.set()


def failed(error: BaseException) -> Job:
    """A job that has ended with this error before it began."""

    def work(_advance: Callable[[str, float], bool]) -> None:
        raise error

    job = Job(work)
    job.wait(_PATIENCE)
    return job


def nothing() -> Job:
    """A job that was given up before it began."""
    job = Job(lambda _advance: None)
    job.cancel()
    return job


def loading() -> Job:
    """The job, one a session, that imports what reads and renders scenes: Numba and its compiled code take seconds."""
    global _loading
    if _loading is None or _loading.cancelled:
        _loading = Job(_load)
    return _loading


def _load(advance: Callable[[str, float], bool]) -> None:
    advance("loading", 0.0)
    importlib.import_module("..core.tiled", __package__)
    importlib.import_module(".extract", __package__)
    builder = importlib.import_module(".materials.builder", __package__)
    builder.warm_up()


def render_job(
    scene: Scene,
    settings: RenderSettings,
    *,
    extraction_seconds: float = 0.0,
    exposure: float = 1.0,
    afterwards: Callable[[RenderResult], Any] = lambda result: result,
) -> Job:
    """The core's render of `scene` as a job, in tiles where it does not fit into memory.

    exposure: what the layers of light are multiplied by.
    afterwards: called in the thread, too, with the `core.pipeline.RenderResult`; what it returns is the job's result.
    """

    def work(advance: Callable[[str, float], bool]) -> Any:
        # Not before `loading`, or Blender's start would wait for Numba.
        from ..core.layers import exposed
        from ..core.tiled import render_fitting

        result = render_fitting(scene, settings, advance, extraction_seconds=extraction_seconds)
        return afterwards(replace(result, layers=exposed(result.layers, exposure)))

    return computing(work, Progress(settings.time_budget, open_end=settings.with_defaults().target_error is not None))


def computing(work: Callable[[Callable[[str, float], bool]], Any], progress: Progress | None = None) -> Job:
    """A call into the core as a job, whose progress says when code is being compiled."""
    progress = progress or Progress()

    def watched(advance: Callable[[str, float], bool]) -> Any:
        from ..core.jit import CompileWatch

        with CompileWatch() as watch:
            progress.watch(lambda: watch.compiling)
            return work(advance)

    return Job(watched, progress)


def cancel_all() -> None:
    """Cancel every job, without waiting."""
    for job in list(_running):
        job.cancel()


def end_all() -> None:
    """Cancel every job and wait until its thread is gone: the code that it runs is about to be unloaded."""
    cancel_all()
    for job in list(_running):
        job.wait(_PATIENCE)
    if not _running:
        from ..core.threads import end_threads

        end_threads()
