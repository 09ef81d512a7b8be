"""Chunks of work over threads: order, errors, cancellation."""

import threading
from threading import Event

import pytest

from lumigate.core.threads import Cancelled, end_threads, run_chunks


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_chunk_order(threads):
    assert run_chunks(lambda begin, end: (begin, end), 10, 3, threads) == [(0, 3), (3, 6), (6, 9), (9, 10)]
    assert run_chunks(lambda begin, end: 1 / 0, 0, 3, threads) == []


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_an_error_ends_all_threads(threads):
    begun = []

    def work(begin, end):
        begun.append(begin)
        if begin == 1:
            raise MemoryError("chunk 1")

    with pytest.raises(MemoryError, match="chunk 1"):
        run_chunks(work, 100_000, 1, threads)
    assert len(begun) < 100_000


def test_chunks_not_begun_are_dropped_on_cancellation():
    stopped, begun = Event(), []

    def work(begin, end):
        begun.append(begin)
        assert stopped.wait(timeout=60)

    def stop(done):
        assert done == 0
        stopped.set()
        return False

    with pytest.raises(Cancelled):
        run_chunks(work, 100_000, 1, 2, stop)
    assert len(begun) < 100_000


def test_progress_ends_at_one():
    told = []
    run_chunks(lambda begin, end: None, 7, 2, 2, lambda done: told.append(done) or True)
    assert told[-1] == 1 and told == sorted(told)


def test_threads_are_used_again_until_they_are_ended():
    barrier = threading.Barrier(2)

    def name(begin, end):
        barrier.wait(timeout=60)
        return threading.current_thread().name

    end_threads()
    used = set().union(*(run_chunks(name, 2, 1, 2) for _ in range(50)))
    assert 2 <= len(used) < 10  # one that has just ended its work may not be idle yet
    end_threads()
    assert not any(thread.name in used for thread in threading.enumerate())
    assert len(run_chunks(name, 2, 1, 2)) == 2
    end_threads()


def test_chunks_within_chunks_do_not_wait_for_each_other():
    def inner(begin, end):
        return sum(run_chunks(lambda b, e: b, 5, 1, 2))

    assert run_chunks(inner, 40, 1, 8) == [10] * 40
