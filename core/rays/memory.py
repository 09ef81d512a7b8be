"""Words of memory behind an address, for jitted code that must not carry arrays through calls."""

from __future__ import annotations

from llvmlite import ir
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


def _copier(words):
    @intrinsic
    def copy(typingctx, target, target_index, source, source_index):
        def codegen(context, builder, signature, args):
            vector = ir.VectorType(ir.IntType(32), words).as_pointer()
            to, at = (_pointer(context, builder, a, i, types.int32) for a, i in (args[:2], args[2:]))
            block = builder.load(builder.bitcast(at, vector), align=4)
            builder.store(block, builder.bitcast(to, vector), align=4)
            return context.get_dummy_value()

        return types.void(types.uintp, types.intp, types.uintp, types.intp), codegen

    return copy


# Blocks of words in one vector move: loops over words cost seconds of compile time.
copy4, copy8 = _copier(4), _copier(8)
