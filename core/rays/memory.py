"""Words of memory behind an address, for jitted code that must not carry arrays through calls."""

from __future__ import annotations

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def _pointer(context, builder, address, index, kind):
    base = builder.inttoptr(address, context.get_value_type(kind).as_pointer())
    return cgutils.gep_inbounds(builder, base, index)


def _reader(kind):
    @intrinsic
    def read(typingctx, address, index):
        def codegen(context, builder, signature, args):
            return builder.load(_pointer(context, builder, *args, kind))

        return kind(types.uintp, types.intp), codegen

    return read


def _writer(kind):
    @intrinsic
    def write(typingctx, address, index, value):
        def codegen(context, builder, signature, args):
            builder.store(args[2], _pointer(context, builder, *args[:2], kind))
            return context.get_dummy_value()

        return types.void(types.uintp, types.intp, kind), codegen

    return write


read_int, write_int = _reader(types.int32), _writer(types.int32)
read_float, write_float = _reader(types.float32), _writer(types.float32)
