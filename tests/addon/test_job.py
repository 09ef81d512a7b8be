"""Jobs: what their owner sees of the thread, and how it gets rid of it; progress."""

import threading

import pytest

from lumigate.addon import job as room
from lumigate.addon.job import Job, end_all
from lumigate.addon.progress import Progress

PATIENCE = 20.0


def looping(started: threading.Event):
    """Work that goes on until it is told to stop."""
    from lumigate.core.threads import Cancelled

    def work(advance):
        started.set()
        while advance("view", 0.5):
            pass
        raise Cancelled

    return work


def test_a_job_ends_with_what_its_work_returns():
    job = Job(lambda advance: advance("view", 1.0) and 7)
    assert job.wait(PATIENCE)
    assert (job.result, job.error, job.cancelled) == (7, None, False)


def test_an_error_waits_for_the_owner():
    def work(_advance):
        raise ValueError("no")

    job = Job(work)
    assert job.wait(PATIENCE)
    with pytest.raises(ValueError, match="no"):
        raise job.error


def test_a_cancelled_job_stops_and_has_no_result():
    started = threading.Event()
    job = Job(looping(started))
    assert started.wait(PATIENCE)
    assert not job.done
    job.cancel()
    assert job.wait(PATIENCE)
    assert job.cancelled and job.result is None and job.error is None


def test_a_result_after_the_cancel_does_not_count():
    may_end = threading.Event()
    job = Job(lambda _advance: may_end.wait(PATIENCE))
    job.cancel()
    may_end.set()
    assert job.wait(PATIENCE)
    assert job.cancelled


def test_end_all_leaves_no_thread():
    started = threading.Event()
    job = Job(looping(started))
    assert started.wait(PATIENCE)
    end_all()
    assert job.done and not room._running


def test_progress_never_falls_and_stays_below_one():
    progress = Progress()
    seen = []
    for stage in ("rays", "view", "direct", "indirect", "denoise", "view"):
        progress.advance(stage, 1.0)
        seen.append(progress.fraction)
    assert seen == sorted(seen) and 0 < seen[0] < seen[-1] < 1


def test_progress_of_tiles():
    progress = Progress()
    progress.advance("tile 2 of 4: view", 0.0)
    assert 0.25 < progress.fraction < 0.5
    assert str(progress).startswith("tile 2 of 4, tracing the view")


def test_progress_of_a_budget_goes_by_the_clock():
    progress = Progress(time_budget=1e6)
    progress.advance("denoise", 1.0)
    assert progress.fraction < 0.01
    assert progress.seconds_left == pytest.approx(1e6, rel=0.01)


def test_progress_says_when_it_compiles():
    progress = Progress()
    progress.advance("view", 0.5)
    assert "compiling" not in str(progress)
    progress.watch(lambda: True)
    assert "compiling" in str(progress)
