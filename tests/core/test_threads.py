"""Chunks of work over threads: order, errors, cancellation."""

from threading import Event

import pytest

from lumigate.core.threads import Cancelled, run_chunks


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
