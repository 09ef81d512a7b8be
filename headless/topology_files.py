"""Topologies kept from run to run, found by the geometry's content; and skeletons as files for other programs."""

from __future__ import annotations

import contextlib
import os
import zipfile
from pathlib import Path

import numpy as np
import platformdirs
import scipy

from ..core.errors import SceneError
from ..core.layers import write_whole
from ..core.topology import Topologies, Topology
from ..core.topology.store import from_arrays, to_arrays
from .debug_pictures import id_colours

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
    """Skeleton, segments, gates, and the balls of each visibility cluster as a Wavefront OBJ file; SceneError where it cannot be written.

    origin: (3,) of the scene, so that the file lies where the scene does.  Blender's importer takes z up and y forward.  Balls are objects of
    their own by cluster, in its colour.
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
        for outline in gates.outlines().astype(np.float64) + origin:
            lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in outline]
            lines.append("f " + " ".join(str(count + k + 1) for k in range(len(outline))))
            count += len(outline)
    colours = id_colours(np.arange(1, topology.clusters + 1)[None])[0]
    for cluster, colour in enumerate(colours):
        lines.append(f"o balls_of_cluster_{cluster}")
        shade = " ".join(f"{c:.3f}" for c in colour)
        for node in segmented.node[topology.cluster == cluster]:
            corners = at[node] + _BALL[0] * (grid.size * skeleton.radius[node])
            lines += [f"v {x:.5f} {y:.5f} {z:.5f} {shade}" for x, y, z in corners]
            lines += ["f " + " ".join(str(count + k + 1) for k in face) for face in _BALL[1]]
            count += len(corners)
    text = "\n".join(lines) + "\n"
    write_whole(path, lambda partial: partial.write_text(text, encoding="ascii"))


def _icosahedron() -> tuple[np.ndarray, np.ndarray]:
    """Corners (12, 3) at a distance of 1, and faces (20, 3): the stand-in of a ball."""
    golden = (1 + np.sqrt(5)) / 2
    corners = np.array([np.roll((0, a, b * golden), k) for k in range(3) for a in (-1, 1) for b in (-1, 1)])
    hull = scipy.spatial.ConvexHull(corners)
    outwards = np.einsum(
        "fc,fc->f", np.cross(*(corners[hull.simplices[:, k]] - corners[hull.simplices[:, 0]] for k in (1, 2))), hull.equations[:, :3]
    )
    faces = np.where(outwards[:, None] > 0, hull.simplices, hull.simplices[:, ::-1])
    return corners / np.linalg.norm(corners[0]), faces


_BALL = _icosahedron()


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
