"""Named tuples of arrays that kernels take by reference.

Numba hands a tuple over field by field and an array as seven numbers or more, so that every call within a kernel that passes the tables of a
scene on copies some 500 words to the stack: a fifth of a picture's time.  A `Reference` is one address; what a kernel reads of it, it reads
from there, by the same attributes.
"""

from __future__ import annotations

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import NativeValue, infer_getattr, lower_getattr_generic, models, register_model, unbox
from numba.np import numpy_support


class ReferenceType(types.Type):
    """Type of a named tuple that lies in memory, as Numba sees it."""

    def __init__(self, value: types.BaseNamedTuple) -> None:
        self.value = value
        super().__init__(f"Reference({value.name})")

    def field(self, name: str) -> int:
        """Where the tuple has it."""
        return self.value.fields.index(name)


@register_model(ReferenceType)
class _ReferenceModel(models.PrimitiveModel):
    """An address of the tuple as data."""

    def __init__(self, manager, reference) -> None:
        super().__init__(manager, reference, manager.lookup(reference.value).get_data_type().as_pointer())


@infer_getattr
class _Fields(AttributeTemplate):
    key = ReferenceType

    def generic_resolve(self, reference, name):
        if name not in reference.value.fields:
            return None
        found = reference.value[reference.field(name)]
        return ReferenceType(found) if isinstance(found, types.BaseNamedTuple) else found


@lower_getattr_generic(ReferenceType)
def _field(context, builder, reference, address, name):
    index = reference.field(name)
    found = reference.value[index]
    place = cgutils.gep_inbounds(builder, address, 0, index)
    if isinstance(found, types.BaseNamedTuple):
        return place
    model = context.data_model_manager[found]
    if not isinstance(found, types.Array):
        return model.from_data(builder, _constant(builder, place))
    # Field by field, so that LLVM sees which of them nobody needs.
    value = ir.Constant(model.get_value_type(), ir.Undefined)
    for k, part in enumerate(model._fields):
        kind = model.get_value_type().elements[k]
        if part in ("meminfo", "parent"):  # whose array it is, the reference's owner knows
            value = builder.insert_value(value, ir.Constant(kind, None), k)
        elif isinstance(kind, ir.ArrayType):
            for axis in range(found.ndim):
                one = _constant(builder, cgutils.gep_inbounds(builder, place, 0, k, axis))
                value = builder.insert_value(value, one, (k, axis))
        else:
            value = builder.insert_value(value, _constant(builder, cgutils.gep_inbounds(builder, place, 0, k)), k)
    return value


def _constant(builder, place):
    """What lies there, which no kernel ever changes: LLVM may read it once for a whole loop."""
    loaded = builder.load(place)
    loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
    return loaded


@unbox(ReferenceType)
def _unbox(reference, thing, c):
    number = c.pyapi.object_getattr_string(thing, "address")
    address = c.builder.bitcast(c.pyapi.long_as_voidptr(number), c.context.get_value_type(reference))
    c.pyapi.decref(number)
    return NativeValue(address, is_error=c.pyapi.c_api_error())


_TYPES: dict = {}  # by `_kind` of the tuples: Numba takes .1 ms to tell the type of a large one


def _kind(value):
    """Tells tuples apart whose types, to Numba, differ; finer than need be."""
    if isinstance(value, np.ndarray):
        flags = value.flags
        return value.dtype, value.ndim, flags.c_contiguous, flags.f_contiguous, flags.aligned, flags.writeable
    if isinstance(value, tuple):
        return type(value), *map(_kind, value)
    if type(value) is int:
        return int, value.bit_length() > 63  # which is another type
    return getattr(value, "_numba_type_", type(value))


def _type_of(value) -> tuple[ReferenceType, np.dtype]:
    """The type, and how the tuple lies in memory."""
    kind = _kind(value)
    found = _TYPES.get(kind)
    if found is None:
        reference = ReferenceType(numba.typeof(value))
        found = _TYPES[kind] = reference, _layout(reference.value)
    return found


def _layout(kind: types.Type) -> np.dtype:
    """How Numba's data models have a value in memory: what a kernel would write, which takes a second to compile for each type of tuple."""
    if isinstance(kind, types.BaseTuple):
        return np.dtype([(f"f{k}", _layout(part)) for k, part in enumerate(kind)], align=True)
    if isinstance(kind, types.Array):
        numbers = [(name, np.intp) for name in ("meminfo", "parent", "nitems", "itemsize", "data")]
        return np.dtype([*numbers, *((name, np.intp, (kind.ndim,)) for name in ("shape", "strides"))], align=True)
    if isinstance(kind, types.NoneType):
        return np.dtype(np.intp)
    return numpy_support.as_dtype(kind)


def _record(value):
    """The value as NumPy takes it for its `_layout`."""
    if isinstance(value, np.ndarray):
        return 0, 0, value.size, value.itemsize, value.__array_interface__["data"][0], value.shape, value.strides
    if isinstance(value, tuple):
        return tuple(map(_record, value))
    return 0 if value is None else value


class Reference:
    """A named tuple of arrays, numbers and further ones, to be passed to kernels as one address.

    To Python it looks like the tuple: the same attributes, and `_replace` gives another reference.  Its arrays are those of the tuple; the
    tuple itself lives as long as its reference.
    """

    __slots__ = ("_layout", "_memory", "_numba_type_", "address", "value")

    def __init__(self, value) -> None:
        self.value = value
        self._numba_type_, self._layout = _type_of(value)
        self._memory = np.zeros(self._layout.itemsize + 64, np.uint8)
        begin = -self._memory.ctypes.data % 64
        self.address = self._memory.ctypes.data + begin
        self._memory[begin : begin + self._layout.itemsize].view(self._layout)[0] = _record(value)

    def __getattr__(self, name: str):
        return getattr(self.value, name)

    def _replace(self, **fields) -> Reference:
        return Reference(self.value._replace(**fields))
