"""Embree's trace functions, called from jitted code through addresses known at run time only.

The addresses come in `EmbreeTables`, so the compiled code holds none and can be cached on disk.
"""

from __future__ import annotations

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ..jit import inlined, kernel, leaf
from . import packet as pk
from .memory import copy4, copy8, read_float, read_int, write_float, write_int
from .trace import COHERENT, CUTOUT, OPAQUE


@intrinsic
def _call_packet(typingctx, function, valid, scene, rays, arguments):
    """function(const int *valid, RTCScene, RTCRay*N *, args) for an address known at run time only."""

    def codegen(context, builder, signature, args):
        word = cgutils.voidptr_t
        kind = cgutils.ir.FunctionType(cgutils.ir.VoidType(), [word] * 4)
        function, *rest = (builder.inttoptr(a, word) for a in args)
        builder.call(builder.bitcast(function, kind.as_pointer()), rest)
        return context.get_dummy_value()

    return types.void(*[types.uintp] * 5), codegen


@intrinsic
def _call_single(typingctx, function, scene, ray):
    """function(RTCScene, RTCRay *, NULL) for an address known at run time only."""

    def codegen(context, builder, signature, args):
        word = cgutils.voidptr_t
        kind = cgutils.ir.FunctionType(cgutils.ir.VoidType(), [word] * 3)
        function, scene, ray = (builder.inttoptr(a, word) for a in args)
        builder.call(builder.bitcast(function, kind.as_pointer()), [scene, ray, cgutils.get_null_value(word)])
        return context.get_dummy_value()

    return types.void(*[types.uintp] * 3), codegen


def _in_parts(width, copy):
    @kernel
    def trace_parts(function, scene, packet, arguments, last_row):
        """Trace the 16 lanes as 16 / width native packets in the scratch rows; rows T_FAR..last_row come back."""
        part = packet + np.uintp(4 * pk.SCRATCH)
        for begin in range(0, pk.WIDTH, width):
            for row in range(pk.ROWS):
                copy(part, row * width, packet, row * pk.WIDTH + begin)
            _call_packet(function, part + np.uintp(4 * pk.VALID * width), scene, part, arguments)
            for row in range(pk.T_FAR, last_row + 1):
                copy(packet, row * pk.WIDTH + begin, part, row * width)

    return trace_parts


_trace_in_eights, _trace_in_fours = _in_parts(8, copy8), _in_parts(4, copy4)


# The functions below take addresses only: arrays in their arguments would cost atomic reference counts per call.
@leaf
def _trace(function, width, scene, packet, arguments, last_row):
    if scene == 0:
        return
    if width == pk.WIDTH:
        _call_packet(function, packet + np.uintp(4 * pk.VALID * pk.WIDTH), scene, packet, arguments)
    elif width == 8:
        _trace_in_eights(function, scene, packet, arguments, last_row)
    else:
        _trace_in_fours(function, scene, packet, arguments, last_row)


@leaf
def _occluded_at(function, width, opaque, cutout, packet, arguments, count):
    for lane in range(pk.WIDTH):
        write_int(packet, pk.VALID * pk.WIDTH + lane, -1 if lane < count else 0)
    _trace(function, width, opaque, packet, arguments, pk.T_FAR)
    # Lanes occluded by now have tfar = -inf, which switches them off.
    _trace(function, width, cutout, packet, arguments, pk.T_FAR)


@leaf
def _intersect_at(function, width, opaque, cutout, packet, arguments, count, first, triangle):
    for lane in range(pk.WIDTH):
        write_int(packet, pk.VALID * pk.WIDTH + lane, -1 if lane < count else 0)
        write_int(packet, pk.GEOMETRY * pk.WIDTH + lane, -1)
    _trace(function, width, opaque, packet, arguments, pk.GEOMETRY)
    # tfar is the opaque hit by now: only nearer ones replace it.
    _trace(function, width, cutout, packet, arguments, pk.GEOMETRY)
    for lane in range(count):
        geometry = read_int(packet, pk.GEOMETRY * pk.WIDTH + lane)
        found = np.int32(-1)
        if geometry >= 0:
            found = read_int(triangle, read_int(first, geometry) + read_int(packet, pk.PRIMITIVE * pk.WIDTH + lane))
        write_int(packet, pk.PRIMITIVE * pk.WIDTH + lane, found)


@inlined
def _scenes(tables, which):
    """Addresses of the sets asked for; 0 is none."""
    return tables.opaque if which & OPAQUE else np.uintp(0), tables.cutout if which & CUTOUT else np.uintp(0)


@inlined
def occluded_packet(tables, which, packet, count):
    """See `trace.occluded_packet`."""
    opaque, cutout = _scenes(tables, which)
    arguments = tables.coherent if which & COHERENT else np.uintp(0)
    _occluded_at(tables.occluded, tables.width, opaque, cutout, packet.address, arguments, count)


@inlined
def intersect_packet(tables, which, packet, count):
    """See `trace.intersect_packet`."""
    opaque, cutout = _scenes(tables, which)
    arguments = tables.coherent if which & COHERENT else np.uintp(0)
    _intersect_at(tables.intersect, tables.width, opaque, cutout, packet.address, arguments, count, tables.first, tables.triangle)


@leaf
def _single(function, opaque, cutout, ray, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """Write an RTCRayHit of one ray at address `ray` and trace it."""
    write_float(ray, 0, ox)
    write_float(ray, 1, oy)
    write_float(ray, 2, oz)
    write_float(ray, 3, tnear)
    write_float(ray, 4, dx)
    write_float(ray, 5, dy)
    write_float(ray, 6, dz)
    write_float(ray, pk.TIME, 0.0)
    write_float(ray, pk.T_FAR, tfar)
    write_int(ray, pk.MASK, mask)
    write_int(ray, pk.RAY_ID, 0)
    write_int(ray, pk.RAY_FLAGS, 0)
    write_int(ray, pk.GEOMETRY, -1)
    write_int(ray, pk.INSTANCE, -1)
    write_int(ray, pk.INSTANCE_PRIMITIVE, -1)
    if opaque != 0:
        _call_single(function, opaque, ray)
    if cutout != 0:
        _call_single(function, cutout, ray)


@inlined
def occluded1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """See `trace.occluded1`."""
    opaque, cutout = _scenes(tables, which)
    ray = packet.address + np.uintp(4 * pk.SCRATCH)
    _single(tables.occluded_single, opaque, cutout, ray, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)
    return read_float(ray, pk.T_FAR) == pk.OCCLUDED


@leaf
def _single_triangle(ray, first, triangle):
    geometry = read_int(ray, pk.GEOMETRY)
    return np.int32(-1) if geometry < 0 else read_int(triangle, read_int(first, geometry) + read_int(ray, pk.PRIMITIVE))


@inlined
def intersect1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """See `trace.intersect1`."""
    opaque, cutout = _scenes(tables, which)
    ray = packet.address + np.uintp(4 * pk.SCRATCH)
    _single(tables.intersect_single, opaque, cutout, ray, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)
    triangle = _single_triangle(ray, tables.first, tables.triangle)
    return triangle, read_float(ray, pk.T_FAR), read_float(ray, pk.HIT_U), read_float(ray, pk.HIT_V)
