"""Embree 4 through ctypes: the library inside the `embreex` wheel, found at run time, and scenes built with it.

Kernels trace through its function pointers (see embree_traversal).

Reference: Embree 4 API, include/embree4/rtcore_*.h.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import sys
import weakref
from collections.abc import Collection
from ctypes import c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .embree_traversal import intersect1, intersect_packet, occluded1, occluded_packet
from .partition import Group, Partition
from .trace import register_backend

GEOMETRY_TRIANGLE, GEOMETRY_INSTANCE = 0, 121
BUFFER_INDEX, BUFFER_VERTEX = 0, 1
FORMAT_UINT3, FORMAT_FLOAT3 = 0x5003, 0x9003
SCENE_ROBUST = 1 << 2
BUILD_MEDIUM = 1
QUERY_COHERENT = 1 << 16
FEATURES_ALL = ALL_MASKS = 0xFFFFFFFF
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
    "rtcUpdateGeometryBuffer": (None, [_HANDLE, c_int, c_uint]),
    "rtcCommitGeometry": (None, [_HANDLE]),
    "rtcSetGeometryInstancedScene": (None, [_HANDLE, _HANDLE]),
    "rtcAttachGeometry": (c_uint, [_HANDLE, _HANDLE]),
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


class _Moving(NamedTuple):
    """A group of triangles in a scene of its own, and the geometry that shows it in the top scene."""

    object: int
    geometry: int
    scene: int
    instance: int
    top: int


class EmbreeBackend:
    """Two committed Embree scenes (opaque, cutout) over the valid triangles of a partition.

    Groups of object 0 make one hierarchy; each other one has its own, of which a top scene shows instances, so that it alone is
    built again by `move`.  Geometries are numbered through all scenes: a hit's number tells its triangle wherever it lies.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, partition: Partition, config: str = ""):
        lib, dev = library(), device(config)
        self._device = dev
        self._vertices = np.zeros(vertices.size + VERTEX_PADDING // 4, np.float32)
        self._vertices[: vertices.size] = vertices.ravel()
        self._indices = np.ascontiguousarray(triangles[partition.triangle], np.int32)
        self._releases = []
        self._moving: list[_Moving] = []
        # The moving groups first: the scene of one holds room for all numbers up to its own.
        groups = sorted((group for part in (partition.opaque, partition.cutout) for group in part), key=lambda group: group.object == 0)
        number = {group.begin: i for i, group in enumerate(groups)}
        scenes = [self._set(part, number, len(vertices)) for part in (partition.opaque, partition.cutout)]
        _check(dev)
        width = native_width(config)
        function = {name: ctypes.cast(getattr(lib, name), c_void_p).value for name in _TRACERS}
        self._first, self._triangle = np.array([group.begin for group in groups], np.int32), partition.triangle
        words = (
            *scenes,
            width,
            function[f"rtcOccluded{width}"],
            function[f"rtcIntersect{width}"],
            function["rtcOccluded1"],
            function["rtcIntersect1"],
            # Instances are written into the query's context, which threads must not share: without arguments each call has its own.
            0 if self._moving else ctypes.addressof(_coherent_arguments()[0]),
            self._first.ctypes.data,
            self._triangle.ctypes.data,
        )
        self.tables = EmbreeTables(*map(np.uintp, words))

    def _set(self, groups: list[Group], number: dict[int, int], vertices: int) -> int:
        """The scene of these groups, committed; 0 where there are none."""
        lib = library()
        if not groups:
            return 0
        still = [group for group in groups if group.object == 0]
        moving = [group for group in groups if group.object != 0]
        if not moving:
            return self._scene([self._geometry(group, vertices) for group in still], [number[group.begin] for group in still])
        top = self._scene([], [])
        if still:
            scene = self._scene([self._geometry(group, vertices) for group in still], [number[group.begin] for group in still])
            lib.rtcReleaseGeometry(self._instance(top, scene))
        for group in moving:
            geometry = self._geometry(group, vertices)
            scene = self._scene([geometry], [number[group.begin]])
            instance = self._instance(top, scene)
            self._moving.append(_Moving(group.object, geometry, scene, instance, top))
            lib.rtcReleaseGeometry(instance)  # the top scene holds it
        lib.rtcCommitScene(top)
        return top

    def _scene(self, geometries: list[int], numbers: list[int]) -> int:
        """A scene of these geometries, which are released to it, committed."""
        lib = library()
        scene = lib.rtcNewScene(self._device)
        _check(self._device)
        self._releases.append(weakref.finalize(self, lib.rtcReleaseScene, scene))
        lib.rtcSetSceneFlags(scene, SCENE_ROBUST)
        lib.rtcSetSceneBuildQuality(scene, BUILD_MEDIUM)
        for geometry, number in zip(geometries, numbers):
            lib.rtcAttachGeometryByID(scene, geometry, number)
            lib.rtcReleaseGeometry(geometry)
        lib.rtcCommitScene(scene)
        return scene

    def _geometry(self, group: Group, vertices: int) -> int:
        lib = library()
        geometry = lib.rtcNewGeometry(self._device, GEOMETRY_TRIANGLE)
        at = self._indices[group.begin :].ctypes.data
        lib.rtcSetSharedGeometryBuffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, at, 0, 12, group.end - group.begin)
        lib.rtcSetSharedGeometryBuffer(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, self._vertices.ctypes.data, 0, 12, vertices)
        lib.rtcSetGeometryMask(geometry, group.visibility)
        lib.rtcCommitGeometry(geometry)
        return geometry

    def _instance(self, top: int, scene: int) -> int:
        """A geometry of `top` that shows a scene where it is."""
        lib = library()
        instance = lib.rtcNewGeometry(self._device, GEOMETRY_INSTANCE)
        lib.rtcSetGeometryInstancedScene(instance, scene)
        lib.rtcSetGeometryMask(instance, ALL_MASKS)
        lib.rtcCommitGeometry(instance)
        lib.rtcAttachGeometry(top, instance)
        return instance

    def move(self, vertices: np.ndarray, objects: Collection[int]) -> None:
        """Take other places of the vertices (V, 3), which differ for these objects (none of them 0) only."""
        lib = library()
        self._vertices[: vertices.size] = vertices.ravel()
        moved = [part for part in self._moving if part.object in objects]
        for part in moved:
            lib.rtcUpdateGeometryBuffer(part.geometry, BUFFER_VERTEX, 0)
            lib.rtcCommitGeometry(part.geometry)
            lib.rtcCommitScene(part.scene)
            lib.rtcCommitGeometry(part.instance)
        for top in {part.top for part in moved}:
            lib.rtcCommitScene(top)
        _check(self._device)

    def close(self) -> None:
        """Release the scenes now (they are released with this object at the latest)."""
        for release in reversed(self._releases):
            release()


register_backend(EmbreeTables, occluded_packet, intersect_packet, occluded1, intersect1)
