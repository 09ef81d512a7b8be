"""Topologies found again by what decides them: a moved lamp or camera builds none anew, a changed mesh does."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import fields

import numpy as np

from ..scene import Scene
from .build import Topology, blocking_triangles, build_topology
from .gates import Gates
from .segmentation import Segmented
from .skeleton import Skeleton
from .voxels import Grid

VERSION = 4  # of what is built from the same triangles
_PARTS = {"grid": Grid, "skeleton": Skeleton, "segmented": Segmented, "disks": Gates, "polygons": Gates}


class Topologies:
    """The topologies of the last few geometries, in memory; a subclass may keep them elsewhere, too.

    capacity: how many.
    """

    def __init__(self, capacity: int = 2):
        self.capacity = capacity
        self._held: OrderedDict[str, Topology] = OrderedDict()

    def of(
        self, scene: Scene, resolution: int, threads: int = 0, *, closed: bool = True, cutouts: bool = False, sheets: bool = True
    ) -> Topology:
        """The topology of `scene` at this resolution, built only where it is not known; arguments and errors as of `build_topology`.

        cutouts: whether what lets light through is a wall, too.
        """
        triangles = blocking_triangles(scene, cutouts)
        key = content_key(scene.geometry.vertices, triangles, resolution, closed, sheets)
        found = self._held.pop(key, None) or self.load(key)
        if found is None:
            found = build_topology(scene.geometry.vertices, triangles, resolution, closed=closed, sheets=sheets, threads=threads)
            self.save(key, found)
        self._held[key] = found
        while len(self._held) > self.capacity:
            self._held.popitem(last=False)
        return found

    def load(self, key: str) -> Topology | None:
        """A topology kept elsewhere; None where there is none."""
        return None

    def save(self, key: str, topology: Topology) -> None:
        """Keep a topology elsewhere."""


IN_MEMORY = Topologies()


def content_key(vertices: np.ndarray, triangles: np.ndarray, resolution: int, closed: bool = True, sheets: bool = True) -> str:
    """A hash of all that decides a topology."""
    digest = hashlib.blake2b(f"{VERSION} {resolution} {closed} {sheets} {vertices.shape} {triangles.shape}".encode(), digest_size=16)
    digest.update(np.ascontiguousarray(vertices))
    digest.update(np.ascontiguousarray(triangles))
    return digest.hexdigest()


def to_arrays(topology: Topology) -> dict[str, np.ndarray]:
    """All of a topology but its timings, by names with dots."""
    arrays = {}
    for name in (f.name for f in fields(topology) if f.name != "seconds"):
        value = getattr(topology, name)
        if name in _PARTS:
            arrays |= {f"{name}.{field}": np.asarray(getattr(value, field)) for field in _names(_PARTS[name])}
        else:
            arrays[name] = value
    return arrays


def from_arrays(arrays: dict[str, np.ndarray]) -> Topology:
    """The topology that `to_arrays` took apart; raises KeyError where a part is missing."""
    parts = {}
    for name, kind in _PARTS.items():
        values = {field: arrays[f"{name}.{field}"] for field in _names(kind)}
        parts[name] = kind(**{field: value.item() if value.ndim == 0 else value for field, value in values.items()})
    parts["grid"] = Grid(parts["grid"].low, parts["grid"].size, tuple(int(n) for n in parts["grid"].shape))
    return Topology(**parts, **{name: arrays[name] for name in ("node_of", "cluster", "room", "sight")})


def _names(kind) -> tuple[str, ...]:
    return kind._fields if hasattr(kind, "_fields") else tuple(field.name for field in fields(kind))
