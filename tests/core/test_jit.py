"""The cache of compiled code survives what other versions and full disks leave in it."""

import errno
import pickle

import numpy as np
import pytest
from numba.core import caching

from lumigate.core import jit
from lumigate.core.sampling.sequences import r2_points


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
