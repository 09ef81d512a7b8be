"""The cache of compiled code survives what other versions and full disks leave in it."""

import errno
import pickle

import numpy as np
import pytest
from numba import types
from numba.core import caching, event

from lumigate.core import jit
from lumigate.core.sampling.sequences import r2_points, sobol_u32


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr(jit, "_CACHE", tmp_path)
    return tmp_path


def compiled():
    """The kernel as a new process would get it, called once, and its result."""
    dispatcher = jit.kernel(r2_points.py_func)
    return dispatcher, dispatcher(0, 8, 3)


def hits(dispatcher) -> int:
    return sum(dispatcher.stats.cache_hits.values())


def test_second_start_compiles_nothing(folder):
    first, expected = compiled()
    with jit.CompileTimer() as timer:
        second, values = compiled()
    assert (hits(first), hits(second)) == (0, 1)
    assert timer.seconds == 0
    np.testing.assert_array_equal(values, expected)


def test_an_index_that_cannot_be_unpickled_is_replaced(folder):
    _, expected = compiled()
    (index,) = folder.rglob("*.nbi")
    with index.open("rb") as file:
        version = pickle.load(file)
    index.write_bytes(pickle.dumps(version) + b"clumigate.core.gone\nGone\n.")  # a class of a module that is no more
    broken, values = compiled()
    again, _ = compiled()
    assert (hits(broken), hits(again)) == (0, 1)
    np.testing.assert_array_equal(values, expected)


def test_a_full_disk_leaves_the_kernel_running(folder, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "_save_data", full)
    dispatcher, values = compiled()
    assert hits(dispatcher) == 0
    assert np.isfinite(values).all()


def test_no_folder_no_cache(monkeypatch):
    monkeypatch.setattr(jit, "_CACHE", None)
    dispatcher, values = compiled()
    assert isinstance(dispatcher._cache, caching.NullCache)
    assert np.isfinite(values).all()


@jit.leaf
def _sum_to(n):
    return n if n < 2 else n + _sum_to(n - 1)


def calls_with(function):
    """A kernel that calls `function` with integers of several kinds."""

    @jit.kernel
    def caller(n):
        return function(n) + function(np.int32(n)) + function(3)

    return caller


def nested_compilations(work) -> int:
    """How often the functions of this file are compiled while `work()` runs."""

    class Count(event.Listener):
        found = 0

        def on_start(self, ev):
            self.found += ev.data["dispatcher"].py_func.__module__ == __name__

        def on_end(self, ev):
            pass

    counting = Count()
    with event.install_listener("numba:compile", counting):
        work()
    return counting.found


def test_a_kernel_that_kernels_call_is_compiled_once_for_all_integers():
    square = jit.leaf(lambda n: n * n)
    assert nested_compilations(lambda: calls_with(square)(5)) == 2  # the caller and what it calls
    assert calls_with(square)(5) == 59
    assert calls_with(square)(-5) == 59
    assert not square.overloads


def test_a_kernel_that_kernels_call_can_be_called_from_python_and_by_itself():
    assert _sum_to(100) == 5050
    assert nested_compilations(lambda: calls_with(_sum_to)(4)) == 2  # not what was compiled for Python: the order must not matter
    assert calls_with(_sum_to)(4) == 26
    assert _sum_to(10) == 55


def test_what_kernels_call_is_read_from_the_cache(folder):
    def caller():
        inner = jit.leaf(sobol_u32.py_func)
        outer = jit.kernel(lambda index: inner(index, 2))
        return inner, outer

    first, outer = caller()
    expected = outer(77)
    again, other = caller()
    with jit.CompileTimer() as timer:
        again._for_kernels((types.int64, types.int64))
    assert timer.seconds == 0 and len(list(folder.rglob("*.nested*.nbc"))) >= 1
    assert other(77) == expected == sobol_u32(77, 2)
    assert not first.overloads and not again.overloads
