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

from ..jit import kernel
from . import packet as pk
from .partition import Partition
from .trace import CUTOUT, OPAQUE, register_backend

GEOMETRY_TRIANGLE = 0
BUFFER_INDEX, BUFFER_VERTEX = 0, 1
FORMAT_UINT3, FORMAT_FLOAT3 = 0x5003, 0x9003
SCENE_ROBUST = 1 << 2
BUILD_MEDIUM = 1
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
    """What kernels need to trace: addresses as integers (0: an empty set) and the way back to triangles.

    opaque, cutout: RTCScene.  occluded, intersect: the packet functions of `width`.
    first: (G,) int32 of each geometry into `triangle`;  triangle: (P,) int32, the caller's indices.
    """

    opaque: int
    cutout: int
    width: int
    occluded: int
    intersect: int
    occluded_single: int
    intersect_single: int
    first: np.ndarray
    triangle: np.ndarray


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
        address = {name: ctypes.cast(getattr(lib, name), c_void_p).value for name in _TRACERS}
        self.tables = EmbreeTables(
            scenes[0],
            scenes[1],
            width,
            address[f"rtcOccluded{width}"],
            address[f"rtcIntersect{width}"],
            address["rtcOccluded1"],
            address["rtcIntersect1"],
            np.array(first, np.int32),
            partition.triangle,
        )

    def close(self) -> None:
        """Release the scenes now (they are released with this object at the latest)."""
        for release in self._releases:
            release()


@intrinsic
def _call_packet(typingctx, function, valid, scene, rays):
    """function(const int *valid, RTCScene, RTCRay*N *, NULL) for an address known at run time only."""

    def codegen(context, builder, signature, args):
        word = cgutils.voidptr_t
        kind = cgutils.ir.FunctionType(cgutils.ir.VoidType(), [word] * 4)
        function, valid, scene, rays = (builder.inttoptr(a, word) for a in args)
        builder.call(builder.bitcast(function, kind.as_pointer()), [valid, scene, rays, cgutils.get_null_value(word)])
        return context.get_dummy_value()

    return types.void(types.uintp, types.uintp, types.uintp, types.uintp), codegen


@intrinsic
def _call_single(typingctx, function, scene, ray):
    """function(RTCScene, RTCRay *, NULL) for an address known at run time only."""

    def codegen(context, builder, signature, args):
        word = cgutils.voidptr_t
        kind = cgutils.ir.FunctionType(cgutils.ir.VoidType(), [word] * 3)
        function, scene, ray = (builder.inttoptr(a, word) for a in args)
        builder.call(builder.bitcast(function, kind.as_pointer()), [scene, ray, cgutils.get_null_value(word)])
        return context.get_dummy_value()

    return types.void(types.uintp, types.uintp, types.uintp), codegen


@kernel
def _call_parts(function, width, scene, packet, rows_back):
    """Trace the 16 lanes as 16 / width native packets; `rows_back` rows of the results are copied back."""
    f, w = packet.f, pk.WIDTH
    base = np.uintp(f.ctypes.data)
    part = base + np.uintp(4 * pk.SCRATCH)
    for begin in range(0, w, width):
        for row in range(pk.ROWS):
            for lane in range(width):
                f[pk.SCRATCH + row * width + lane] = f[row * w + begin + lane]
        _call_packet(function, part + np.uintp(4 * pk.VALID * width), scene, part)
        for row in range(rows_back[0], rows_back[1]):
            for lane in range(width):
                f[row * w + begin + lane] = f[pk.SCRATCH + row * width + lane]


@kernel
def _trace(function, width, scene, packet, rows_back):
    if width == pk.WIDTH:
        base = np.uintp(packet.f.ctypes.data)
        _call_packet(function, base + np.uintp(4 * pk.VALID * pk.WIDTH), scene, base)
    else:
        _call_parts(function, width, scene, packet, rows_back)


@kernel
def _occluded_packet(tables, which, packet, count):
    for lane in range(pk.WIDTH):
        packet.i[pk.VALID * pk.WIDTH + lane] = -1 if lane < count else 0
    if which & OPAQUE and tables.opaque:
        _trace(tables.occluded, tables.width, tables.opaque, packet, (pk.T_FAR, pk.T_FAR + 1))
    if which & CUTOUT and tables.cutout:
        # Lanes occluded by now have tfar = -inf, which switches them off.
        _trace(tables.occluded, tables.width, tables.cutout, packet, (pk.T_FAR, pk.T_FAR + 1))


@kernel
def _intersect_packet(tables, which, packet, count):
    i, w = packet.i, pk.WIDTH
    for lane in range(w):
        i[pk.VALID * w + lane] = -1 if lane < count else 0
        i[pk.GEOMETRY * w + lane] = -1
    if which & OPAQUE and tables.opaque:
        _trace(tables.intersect, tables.width, tables.opaque, packet, (pk.T_FAR, pk.INSTANCE))
    if which & CUTOUT and tables.cutout:
        # tfar is the opaque hit by now: only nearer ones replace it.
        _trace(tables.intersect, tables.width, tables.cutout, packet, (pk.T_FAR, pk.INSTANCE))
    for lane in range(count):
        geometry = i[pk.GEOMETRY * w + lane]
        i[pk.PRIMITIVE * w + lane] = -1 if geometry < 0 else tables.triangle[tables.first[geometry] + i[pk.PRIMITIVE * w + lane]]


@kernel
def _set_single(packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    """Write an RTCRayHit (one ray) into the scratch half of the packet."""
    f, i, at = packet.f, packet.i, pk.SCRATCH
    f[at], f[at + 1], f[at + 2], f[at + 3] = ox, oy, oz, tnear
    f[at + 4], f[at + 5], f[at + 6], f[at + 7] = dx, dy, dz, np.float32(0.0)
    f[at + 8] = tfar
    i[at + 9], i[at + 10], i[at + 11] = mask, 0, 0
    i[at + pk.GEOMETRY] = -1
    i[at + pk.INSTANCE] = -1
    i[at + pk.INSTANCE_PRIMITIVE] = -1
    return np.uintp(f.ctypes.data) + np.uintp(4 * at)


@kernel
def _occluded1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    ray = _set_single(packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)
    if which & OPAQUE and tables.opaque:
        _call_single(tables.occluded_single, tables.opaque, ray)
    if which & CUTOUT and tables.cutout:
        _call_single(tables.occluded_single, tables.cutout, ray)
    return packet.f[pk.SCRATCH + pk.T_FAR] == pk.OCCLUDED


@kernel
def _intersect1(tables, which, packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask):
    ray = _set_single(packet, ox, oy, oz, dx, dy, dz, tnear, tfar, mask)
    if which & OPAQUE and tables.opaque:
        _call_single(tables.intersect_single, tables.opaque, ray)
    if which & CUTOUT and tables.cutout:
        _call_single(tables.intersect_single, tables.cutout, ray)
    f, i, at = packet.f, packet.i, pk.SCRATCH
    geometry = i[at + pk.GEOMETRY]
    triangle = np.int32(-1) if geometry < 0 else tables.triangle[tables.first[geometry] + i[at + pk.PRIMITIVE]]
    return triangle, f[at + pk.T_FAR], f[at + pk.HIT_U], f[at + pk.HIT_V]


register_backend(EmbreeTables, _occluded_packet, _intersect_packet, _occluded1, _intersect1)
