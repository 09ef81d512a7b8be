"""Named tuples by reference: kernels read from them what they read from the tuples themselves."""

from typing import NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError

from lumigate.core.jit import kernel, leaf
from lumigate.core.references import Reference


class Inner(NamedTuple):
    values: np.ndarray
    number: int
    flag: bool


class Outer(NamedTuple):
    inner: Inner
    table: np.ndarray
    weight: np.float32


def outer(n=6):
    rng = np.random.default_rng(n)
    return Outer(Inner(rng.random((n, 3)), 7, True), rng.integers(0, 9, (2, n), np.int32), np.float32(0.5))


@leaf
def _at(thing, i):
    return thing.inner.values[i, 2] * thing.table[1, i] * thing.weight + thing.inner.number + thing.inner.flag


@kernel
def _all(thing, out):
    for i in range(thing.table.shape[1]):
        out[i] = _at(thing, i)
        thing.inner.values[i, 0] = -out[i]
    return len(out)


@kernel
def _wrong(thing):
    return thing.nothing


def test_kernels_read_and_write_the_arrays_of_the_tuple():
    given, twin = outer(), outer()
    found, expected = np.zeros(6), np.zeros(6)
    assert _all(Reference(given), found) == _all(twin, expected) == 6
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    np.testing.assert_allclose(given.inner.values, twin.inner.values, rtol=1e-13)


def test_python_sees_the_tuple():
    given = Reference(outer())
    assert given.inner.number == 7 and given.table.shape == (2, 6)
    other = given._replace(weight=np.float32(2))
    out = np.zeros((2, 6))
    for row, thing in zip(out, (given, other), strict=True):
        _all(thing, row)
    np.testing.assert_allclose(out[1] - 8, 4 * (out[0] - 8))
    with pytest.raises(AttributeError, match="nothing"):
        given.nothing  # noqa: B018


def test_the_arrays_live_as_long_as_the_reference():
    references = [Reference(outer(n)) for n in range(1, 200)]
    for n, reference in enumerate(references, 1):
        found, expected = np.zeros(n), np.zeros(n)
        _all(reference, found)
        _all(outer(n), expected)
        np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_what_is_not_there_is_not_compiled():
    with pytest.raises(TypingError, match="nothing"):
        _wrong(Reference(outer()))
