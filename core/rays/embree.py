"""Embree 4 through ctypes (building) and through function pointers inside Numba kernels (tracing).

The library is the one inside the `embreex` wheel, found at run time.  Kernels receive its functions as
integers in `EmbreeTables`, so the compiled code holds no address and can be cached on disk.

Reference: Embree 4 API, include/embree4/rtcore_*.h.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import sys
import weakref
from ctypes import c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ..jit import inlined, kernel
from . import packet as pk
from .memory import copy4, copy8, read_float, read_int, write_float, write_int
from .partition import Partition
from .trace import COHERENT, CUTOUT, OPAQUE, register_backend

GEOMETRY_TRIANGLE = 0
BUFFER_INDEX, BUFFER_VERTEX = 0, 1
FORMAT_UINT3, FORMAT_FLOAT3 = 0x5003, 0x9003
SCENE_ROBUST = 1 << 2
BUILD_MEDIUM = 1
QUERY_COHERENT = 1 << 16
FEATURES_ALL = 0xFFFFFFFF
PROPERTY_VERSION, PROPERTY_RAY8, PROPERTY_RAY16, PROPERTY_RAY_MASK = 0, 33, 34, 64
VERTEX_PADDING = 16  # bytes that Embree may read past the last vertex

_HANDLE = c_void_p
_SIGNATURES = {
    "rtcNewDevice": (_HANDLE, [c_char_p]),
    "rtcReleaseDevice": (None, [_HANDLE]),
    "rtcGetDeviceProperty": (c_ssize_t, [_HANDLE, c_int]),
    "rtcGetDeviceError": (c_int, [_HANDLE]),
    "rtcGetDeviceLastErrorMessage": (c_char_p, [_HANDLE]),
    "rtcNewScene": (_HANDLE, [_HANDLE]),
    "rtcSetSceneFlags": (None, [_HANDLE, c_int]),
    "rtcSetSceneBuildQuality": (None, [_HANDLE, c_int]),
    "rtcCommitScene": (None, [_HANDLE]),
    "rtcReleaseScene": (None, [_HANDLE]),
    "rtcNewGeometry": (_HANDLE, [_HANDLE, c_int]),
    "rtcSetSharedGeometryBuffer": (None, [_HANDLE, c_int, c_uint, c_int, c_void_p, c_size_t, c_size_t, c_size_t]),
    "rtcSetGeometryMask": (None, [_HANDLE, c_uint]),
    "rtcCommitGeometry": (None, [_HANDLE]),
    "rtcAttachGeometryByID": (None, [_HANDLE, _HANDLE, c_uint]),
    "rtcReleaseGeometry": (None, [_HANDLE]),
}
_TRACERS = [f"rtc{kind}{width}" for kind in ("Occluded", "Intersect") for width in (1, 4, 8, 16)]


class EmbreeError(RuntimeError):
    """Embree is absent or refused a call."""


@functools.cache
def library() -> ctypes.CDLL:
    """The Embree library of the `embreex` wheel, with its signatures declared."""
    spec = importlib.util.find_spec("embreex")
    if spec is None or not spec.submodule_search_locations:
        raise EmbreeError("the embreex wheel is not installed")
    package = Path(next(iter(spec.submodule_search_locations)))
    folders = (package.with_name("embreex.libs"), package / ".dylibs", package)
    found = [file for folder in folders for pattern in ("libembree4*", "embree4*.dll") for file in sorted(folder.glob(pattern))]
    if not found:
        raise EmbreeError(f"no Embree library beside {package}")
    try:
        if sys.platform == "win32":
            for dependency in found[0].parent.glob("tbb*.dll"):
                ctypes.CDLL(str(dependency))
        lib = ctypes.CDLL(str(found[0]))
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(lib, name)
            function.restype, function.argtypes = result, arguments
        for name in _TRACERS:
            getattr(lib, name)
    except (OSError, AttributeError) as error:
        raise EmbreeError(f"cannot use {found[0].name}: {error}") from error
    return lib


def _check(device) -> None:
    lib = library()
    code = lib.rtcGetDeviceError(device)
    if code:
        text = (lib.rtcGetDeviceLastErrorMessage(device) or b"").decode(errors="replace")
        raise EmbreeError(f"Embree error {code}: {text or 'no message'}")


@functools.cache
def device(config: str = "") -> int:
    """The process's Embree device for a configuration string; it lives as long as the process."""
    lib = library()
    handle = lib.rtcNewDevice(config.encode())
    _check(handle)
    if not lib.rtcGetDeviceProperty(handle, PROPERTY_RAY_MASK):
        raise EmbreeError("this Embree was built without ray masks")
    return handle


def native_width(config: str = "") -> int:
    """Rays in Embree's widest native packet on this machine: 16 (AVX-512), 8 (AVX) or 4."""
    lib = library()
    for width, wanted in ((16, PROPERTY_RAY16), (8, PROPERTY_RAY8)):
        if lib.rtcGetDeviceProperty(device(config), wanted):
            return width
    return 4


class EmbreeTables(NamedTuple):
    """What kernels need to trace, all of it addresses and numbers (np.uintp), so that passing it costs nothing.

    opaque, cutout: RTCScene, 0 for an empty set.  width: rays of a native packet.
    occluded, intersect: the packet functions of that width;  occluded_single, intersect_single: of one ray.
    coherent: query arguments for packets that stay together.
    first: (G,) int32 of each geometry into `triangle`;  triangle: (P,) int32, the caller's indices.
    """

    opaque: int
    cutout: int
    width: int
    occluded: int
    intersect: int
    occluded_single: int
    intersect_single: int
    coherent: int
    first: int
    triangle: int


class _QueryContext(ctypes.Structure):
    """RTCRayQueryContext, with room for every instance level an Embree may be built with."""

    _fields_ = (("instance", c_uint * 32),)


class _QueryArguments(ctypes.Structure):
    """RTCOccludedArguments and RTCIntersectArguments."""

    _fields_ = (
        ("flags", c_int),
        ("features", c_uint),
        ("context", c_void_p),
        ("filter", c_void_p),
        ("user", c_void_p),
        ("min_width_distance_factor", ctypes.c_float),
    )


@functools.cache
def _coherent_arguments() -> tuple[_QueryArguments, _QueryContext]:
    context = _QueryContext()
    ctypes.memset(ctypes.addressof(context), 0xFF, ctypes.sizeof(context))  # RTC_INVALID_GEOMETRY_ID
    return _QueryArguments(QUERY_COHERENT, FEATURES_ALL, ctypes.addressof(context), None, None, 0.0), context


class EmbreeBackend:
    """Two committed Embree scenes (opaque, cutout) over the valid triangles of a partition."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, partition: Partition, config: str = ""):
        lib, dev = library(), device(config)
        self._vertices = np.zeros(vertices.size + VERTEX_PADDING // 4, np.float32)
        self._vertices[: vertices.size] = vertices.ravel()
        self._indices = np.ascontiguousarray(triangles[partition.triangle], np.int32)
        self._releases = []
        scenes = [0, 0]
        geometry_id = 0
        first = []
        for s, groups in enumerate((partition.opaque, partition.cutout)):
            if not groups:
                continue
            scenes[s] = lib.rtcNewScene(dev)
            _check(dev)
            self._releases.append(weakref.finalize(self, lib.rtcReleaseScene, scenes[s]))
            lib.rtcSetSceneFlags(scenes[s], SCENE_ROBUST)
            lib.rtcSetSceneBuildQuality(scenes[s], BUILD_MEDIUM)
            for group in groups:
                geometry = lib.rtcNewGeometry(dev, GEOMETRY_TRIANGLE)
                at = self._indices[group.begin :].ctypes.data
                count = group.end - group.begin
                lib.rtcSetSharedGeometryBuffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, at, 0, 12, count)
                lib.rtcSetSharedGeometryBuffer(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, self._vertices.ctypes.data, 0, 12, len(vertices))
                lib.rtcSetGeometryMask(geometry, group.visibility)
                lib.rtcCommitGeometry(geometry)
                lib.rtcAttachGeometryByID(scenes[s], geometry, geometry_id)
                lib.rtcReleaseGeometry(geometry)
                first.append(group.begin)
                geometry_id += 1
            lib.rtcCommitScene(scenes[s])
            _check(dev)
        width = native_width(config)
        function = {name: ctypes.cast(getattr(lib, name), c_void_p).value for name in _TRACERS}
        self._first, self._triangle = np.array(first, np.int32), partition.triangle
        words = (
            *scenes,
            width,
            function[f"rtcOccluded{width}"],
            function[f"rtcIntersect{width}"],
            function["rtcOccluded1"],
            function["rtcIntersect1"],
            ctypes.addressof(_coherent_arguments()[0]),
            self._first.ctypes.data,
            self._triangle.ctypes.data,
        )
        self.tables = EmbreeTables(*map(np.uintp, words))

    def close(self) -> None:
        """Release the scenes now (they are released with this object at the latest)."""
        for release in self._releases:
            release()


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
@kernel
def _trace(function, width, scene, packet, arguments, last_row):
    if scene == 0:
        return
    if width == pk.WIDTH:
        _call_packet(function, packet + np.uintp(4 * pk.VALID * pk.WIDTH), scene, packet, arguments)
    elif width == 8:
        _trace_in_eights(function, scene, packet, arguments, last_row)
    else:
        _trace_in_fours(function, scene, packet, arguments, last_row)


@kernel
def _occluded_at(function, width, opaque, cutout, packet, arguments, count):
    for lane in range(pk.WIDTH):
        write_int(packet, pk.VALID * pk.WIDTH + lane, -1 if lane < count else 0)
    _trace(function, width, opaque, packet, arguments, pk.T_FAR)
    # Lanes occluded by now have tfar = -inf, which switches them off.
    _trace(function, width, cutout, packet, arguments, pk.T_FAR)


@kernel
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
def _occluded_packet(tables, which, packet, count):
    opaque, cutout = _scenes(tables, which)
    arguments = tables.coherent if which & COHERENT else np.uintp(0)
    _occluded_at(tables.occluded, tables.width, opaque, cutout, packet.address, arguments, count)


@inlined
def _intersect_packet(tables, which, packet, count):
    opaque, cutout = _scenes(tables, which)
    arguments = tables.coherent if which & COHERENT else np.uintp(0)
    _intersect_at(tables.intersect, tables.width, opaque, cutout, packet.address, arguments, count, tables.first, tables.triangle)


@kernel
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
def _occluded1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    opaque, cutout = _scenes(tables, which)
    ray = packet.address + np.uintp(4 * pk.SCRATCH)
    _single(tables.occluded_single, opaque, cutout, ray, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)
    return read_float(ray, pk.T_FAR) == pk.OCCLUDED


@kernel
def _single_triangle(ray, first, triangle):
    geometry = read_int(ray, pk.GEOMETRY)
    return np.int32(-1) if geometry < 0 else read_int(triangle, read_int(first, geometry) + read_int(ray, pk.PRIMITIVE))


@inlined
def _intersect1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    opaque, cutout = _scenes(tables, which)
    ray = packet.address + np.uintp(4 * pk.SCRATCH)
    _single(tables.intersect_single, opaque, cutout, ray, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)
    triangle = _single_triangle(ray, tables.first, tables.triangle)
    return triangle, read_float(ray, pk.T_FAR), read_float(ray, pk.HIT_U), read_float(ray, pk.HIT_V)


register_backend(EmbreeTables, _occluded_packet, _intersect_packet, _occluded1, _intersect1)
