"""Named tuples by reference: kernels read from them what they read from the tuples themselves."""

from typing import NamedTuple

import numpy as np
import pytest
from numba import types
from numba.core.errors import TypingError
from numba.extending import intrinsic

from lumigate.core.jit import kernel, leaf
from lumigate.core.references import Reference
from lumigate.core.view.points import ShadingPoints


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


class Odd(NamedTuple):
    nothing: None
    small: np.uint8
    flags: np.ndarray
    pair: tuple
    inner: Inner
    least: np.int16
    large: int
    none: np.ndarray


@intrinsic
def _put(typing_context, value, address):
    def generate(context, builder, signature, arguments):
        place = builder.inttoptr(arguments[1], context.get_data_type(value).as_pointer())
        builder.store(context.data_model_manager[value].as_data(builder, arguments[0]), place)
        return context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(value)))

    return types.intp(value, types.uintp), generate


@kernel
def _write(value, address):
    """As Numba itself has it; its size in bytes."""
    return _put(value, np.uintp(address))


def _fields(record):
    """All numbers of a structured record but whose arrays they are, which a reference does not say."""
    if record.dtype.names is None:
        return [record.tolist()]
    return [x for name in record.dtype.names if name not in ("meminfo", "parent") for x in _fields(record[name])]


@kernel
def _wrong(thing):
    return thing.nothing


def test_kernels_read_and_write_the_arrays_of_the_tuple():
    given, twin = outer(), outer()
    found, expected = np.zeros(6), np.zeros(6)
    assert _all(Reference(given), found) == _all(twin, expected) == 6
    np.testing.assert_allclose(found, expected, rtol=1e-13)
    np.testing.assert_allclose(given.inner.values, twin.inner.values, rtol=1e-13)


def odd():
    flags = np.arange(30).reshape(5, 6)[::2, ::3] > 3
    return Odd(None, np.uint8(200), flags, (np.float32(0.1), 3, -2.5), outer().inner, np.int16(-3), 2**63 + 5, np.array(2.5))


@pytest.mark.parametrize("value", [outer(), odd(), ShadingPoints.allocate(3)], ids=["nested", "odd", "points"])
def test_it_lies_in_memory_as_numba_would_write_it(value):
    reference = Reference(value)
    layout = reference._layout
    memory = np.zeros(layout.itemsize, np.uint8)
    assert _write(value, memory.ctypes.data) == layout.itemsize
    begin = reference.address - reference._memory.ctypes.data
    own = reference._memory[begin : begin + layout.itemsize]
    assert _fields(own.view(layout)[0]) == _fields(memory.view(layout)[0])


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
