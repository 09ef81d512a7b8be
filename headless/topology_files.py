"""Topologies kept from run to run, found by the geometry's content; and skeletons as files for other programs."""

from __future__ import annotations

import contextlib
import os
import zipfile
from pathlib import Path

import numpy as np
import platformdirs

from ..core.errors import SceneError
from ..core.layers import write_whole
from ..core.topology import Gates, Topologies, Topology
from ..core.topology.store import from_arrays, to_arrays

KEPT = 12  # files; the ones used longest ago go first


def topology_folder() -> Path:
    """LUMIGATE_CACHE, else the user's cache folder."""
    asked = os.environ.get("LUMIGATE_CACHE")
    return (Path(asked) if asked else Path(platformdirs.user_cache_dir("lumigate"))) / "topology"


class StoredTopologies(Topologies):
    """Topologies in memory and in a folder; a folder that cannot be used costs time, never the render."""

    def __init__(self, folder: Path | None = None):
        super().__init__()
        self.folder = folder or topology_folder()

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.npz"

    def load(self, key: str) -> Topology | None:
        """The topology in the folder; None where there is none, or its file is damaged."""
        path = self._path(key)
        try:
            with np.load(path, allow_pickle=False) as arrays:
                found = from_arrays(arrays)
            path.touch()
        except (OSError, KeyError, ValueError, TypeError, zipfile.BadZipFile):
            return None
        return found

    def save(self, key: str, topology: Topology) -> None:
        """Keep it, and only so many."""

        def write(partial: Path) -> None:
            with partial.open("wb") as file:
                np.savez_compressed(file, **to_arrays(topology))

        with contextlib.suppress(OSError, SceneError):
            self.folder.mkdir(parents=True, exist_ok=True)
            write_whole(self._path(key), write)
            files = sorted(self.folder.glob("*.npz"), key=lambda path: path.stat().st_mtime)
            for old in files[:-KEPT]:
                old.unlink(missing_ok=True)


def write_obj(path: Path, topology: Topology, origin: np.ndarray) -> None:
    """The skeleton's arcs, the segmented edges and the gates as a Wavefront OBJ file; SceneError where it cannot be written.

    origin: (3,) of the scene, so that the file lies where the scene does.  Blender's importer takes z up and y forward.
    """
    grid, skeleton, segmented = topology.grid, topology.skeleton, topology.segmented
    lines = ["# Lumigate: skeleton of the empty space; z is up"]
    at = grid.position_of(skeleton.place) + origin
    lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in at]
    lines += ["o skeleton", *(f"l {a + 1} {b + 1}" for a, b in skeleton.arcs)]
    lines += ["o segments", *(f"l {a + 1} {b + 1}" for a, b in segmented.node[segmented.edges])]
    count = len(at)
    for name, gates in (("disks", topology.disks), ("polygons", topology.polygons)):
        lines.append(f"o {name}")
        for outline in _outlines(gates) + origin:
            lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in outline]
            lines.append("f " + " ".join(str(count + k + 1) for k in range(len(outline))))
            count += len(outline)
    text = "\n".join(lines) + "\n"
    write_whole(path, lambda partial: partial.write_text(text, encoding="ascii"))


def _outlines(gates: Gates) -> np.ndarray:
    return gates.outlines().astype(np.float64)


def summary(topology: Topology) -> dict:
    """Counts and sizes of a topology, as values of JSON; the largest visibility clusters by volume."""
    size = topology.grid.size
    inside = topology.node_of[topology.node_of >= 0]
    voxels = np.bincount(topology.cluster[inside], minlength=topology.clusters) if len(inside) else np.zeros(0, int)
    rooms = np.bincount(topology.room[inside], minlength=topology.rooms) if len(inside) else np.zeros(0, int)
    return {
        "voxels": list(topology.grid.shape),
        "voxel_m": float(size),
        "empty_m3": float(len(inside) * size**3),
        "rooms": topology.rooms,
        "room_m3": [float(v * size**3) for v in np.sort(rooms)[::-1][:10]],
        "visibility_clusters": topology.clusters,
        "cluster_m3": [float(v * size**3) for v in np.sort(voxels)[::-1][:10]],
        "skeleton": {
            "nodes": len(topology.skeleton.radius),
            "arcs": len(topology.skeleton.arcs),
            "segmented_nodes": len(topology.cluster),
            "segmented_edges": len(topology.segmented.edges),
            "opened_shells": topology.skeleton.opened,
        },
        "gates": {"disks": len(topology.disks.radius), "polygons": len(topology.polygons.radius)},
        "seconds": topology.seconds,
    }
