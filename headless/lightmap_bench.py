"""Lightmaps beside Cycles' bake with denoising, and a scene that is exported with its light baked in and rendered again.

The same objects, UV map and image for both; contestants take turns, seconds are medians.  Errors are relMSE of the irradiance on the
texels that show a surface, as all their neighbours do of the same chart, against two independent halves of a bake by Cycles, net of their noise.  Cycles' images are denoised as they
are, and as ours are (charts mirrored about their edges, with normals); the better of both is the peer.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.ndimage import binary_erosion, maximum_filter, minimum_filter

from ..addon.files import open_scene
from ..addon.lightmap_export import export_gltf
from ..addon.lightmaps import LightmapRequest, Prepared, bake_scene, choose_objects, prepare
from ..core import metrics
from ..core.denoise import Denoiser
from ..core.lightmaps.filling import denoised, surroundings
from ..core.lightmaps.seams import Seams, find_seams, seam_error
from ..core.pipeline import render
from ..core.scene import Geometry
from ..core.settings import BakeSettings, RenderSettings
from ..core.view.texels import LIT, Charts, cover
from .console import quiet
from .cycles_bake import bake_by_cycles
from .sources import extract, find_scene, open_source

# Name, source, and the objects, None for all: Cycles prepares the whole scene again for each of them.
SCENES = (
    ("Cornell box", "cornell", None),
    ("living room", "living-room-greywhite", ("Mesh019", "Mesh042", "Mesh057", "Mesh059")),
    ("two amphoras of the gallery", "gallery", ("Amphora", "Amphora.001")),  # round and smooth, with seams
)
SIZE = 256
SAMPLES, REFERENCE_SAMPLES = 64, 4096
REPEATS = 3
BLACK = 0.01  # of the mean
SHOWN = 4  # samples that tell which chart a texel shows
VIEW = (320, 180)  # pixels of the picture of the exported scene
_BACKGROUND = 1e9  # m: what lies farther away is none of the surfaces
DENSITY = 16.0  # texels a metre of its lightmaps


@dataclass
class Contest:
    """The runs of one contestant: seconds, and the last image."""

    seconds: list[float] = field(default_factory=list)
    image: np.ndarray | None = None

    def add(self, image: np.ndarray, seconds: float) -> None:
        """Note one run."""
        self.seconds.append(seconds)
        self.image = image

    @property
    def time(self) -> float:
        """Median seconds."""
        return statistics.median(self.seconds)


def lightmap_rows(
    scenes: Sequence[tuple[str, str, Sequence[str] | None]] = SCENES,
    size: int = SIZE,
    samples: int = SAMPLES,
    reference_samples: int = REFERENCE_SAMPLES,
    repeats: int = REPEATS,
    round_trip: str | None = "atrium",
) -> list[dict]:
    """Rows of all scenes that are there, and of the round trip through glTF of one."""
    rows = []
    for name, source, names in scenes:
        found = find_scene(source)
        if found is not None:
            rows += _scene_rows(name, found, names, size, samples, reference_samples, repeats)
    if round_trip is not None:
        rows.append(round_trip_row(round_trip))
    return rows


def _scene_rows(
    name: str, source: str, names: Sequence[str] | None, size: int, samples: int, reference_samples: int, repeats: int
) -> list[dict]:
    scene = open_source(source)
    objects = choose_objects(scene, names)
    settings = BakeSettings(RenderSettings())
    request = LightmapRequest(settings, size=size, atlas=True)
    prepared = prepare(scene, objects, request)

    def cycles(spp: int, seed: int) -> tuple[np.ndarray, float]:
        return bake_by_cycles(
            scene,
            objects,
            prepared.layer,
            prepared.targets[0].size,
            samples=spp,
            seed=seed,
            bounces=settings.render.bounces,
            margin=settings.margin,
        )

    ours, peers = Contest(), {"as it is": Contest(), "charts mirrored": Contest()}
    with closing(Denoiser()) as denoiser:
        for turn in range(-1, repeats):  # the first one warms up
            seeded = replace(request, bake=replace(settings, render=replace(settings.render, seed=turn + 1)))
            result = prepare(scene, objects, seeded).run().result
            lightmap = result.lightmaps[0]
            raw, seconds = cycles(samples, 100 + turn)
            for way, peer in peers.items():
                clean, spent = _denoised(raw, lightmap.state, denoiser, mirrored=way != "as it is")
                if turn >= 0:
                    peer.add(clean, seconds + spent)
            if turn >= 0:
                ours.add(lightmap.image, result.stats["seconds_total"])
    halves = [cycles(reference_samples // 2, seed)[0] for seed in (1, 2)]
    return _rows(name, prepared, lightmap.state, ours, peers, halves, samples)


def comparable(state: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """Texels (H, W) bool that hold the same by both: those whose neighbours all show a surface, too, of the same chart.

    At the edge of a chart, or of what hides it, ours hold the light of what can be seen in them.  Cycles' hold that of a whole square, or, where Blender
    leaves a texel between two charts to its margins, the mean of both charts: half of a sunlit wall's and half of a dark room's.

    chart: (H, W) int, as `chart_image` has it.
    """
    return binary_erosion(state == LIT, np.ones((3, 3))) & _alone(chart)


def _alone(chart: np.ndarray) -> np.ndarray:
    """Texels (H, W) bool beside which no other chart lies, nor the gap between charts."""
    return maximum_filter(chart, 3) == minimum_filter(chart, 3)


def chart_image(geometry: Geometry, charts: Charts, size: tuple[int, int]) -> np.ndarray:
    """Which chart each texel of an image of `size` (width, height) shows, (H, W) int, -1 for none.

    Triangles are of one that share corners in space, in the map and in their normals: not the sides of a box that is unfolded in one piece.
    """
    width, height = size
    fine = [
        np.rint(scale * values).astype(np.int64) for scale, values in ((1024, charts.uv), (64, geometry.corner_normals[charts.triangle]))
    ]
    corners = np.concatenate([geometry.triangles[charts.triangle][..., None], *fine], axis=2)
    key = np.unique(corners.reshape(-1, 6), axis=0, return_inverse=True)[1].reshape(-1)
    triangles = np.repeat(np.arange(len(charts.triangle)), 3)
    held = sparse.csr_matrix((np.ones(len(key)), (triangles, key)), shape=(len(charts.triangle), key.max() + 1))
    label = sparse.csgraph.connected_components(held @ held.T, directed=False)[1]
    found = np.empty((width * height, SHOWN), np.int32)
    cover(
        charts.uv, 0, height, width, SHOWN, np.uint32(0), found, np.empty((*found.shape, 2), np.float32), np.empty(len(found), np.float32)
    )
    triangle = found.max(axis=1)
    return np.where(triangle >= 0, label[triangle], -1).reshape(height, width)


def _denoised(raw: np.ndarray, state: np.ndarray, denoiser: Denoiser, *, mirrored: bool) -> tuple[np.ndarray, float]:
    """Cycles' image without noise, and the seconds of it."""
    begin = time.perf_counter()
    if mirrored:
        clean = denoised(raw, np.zeros_like(raw), np.zeros_like(raw), surroundings(state), denoiser, 0)
        clean = np.where((state == LIT)[..., None], clean, raw)
    else:
        clean = denoiser.denoise(raw)
    return clean, time.perf_counter() - begin


def _rows(
    name: str, prepared: Prepared, state: np.ndarray, ours: Contest, peers: dict[str, Contest], halves: list[np.ndarray], samples: int
) -> list[dict]:
    """Time, error, seams and black texels of one scene."""
    target, geometry = prepared.targets[0], prepared.arrays.geometry
    charts = Charts.of(target.triangles, target.uv, target.size)
    chart = chart_image(geometry, charts, target.size)
    lit, shown = comparable(state, chart), state == LIT
    seams = find_seams(geometry, charts)
    mean = (halves[0] + halves[1]) / 2

    def error(image: np.ndarray) -> float:
        return metrics.net_relmse(*(picture[lit][None] for picture in (image, *halves)))

    peer = min(peers.values(), key=lambda contest: error(contest.image))
    bias = metrics.bias(ours.image[lit][None], mean[lit][None])
    scale = BLACK * mean[lit].mean()
    # Light that one half knows only is a firefly of the reference.
    known = np.min([half.max(axis=2) for half in halves], axis=0) > 2 * scale
    black = [int(((image.max(axis=2) < scale) & known & shown & _alone(chart)).sum()) for image in (ours.image, peer.image)]
    title = f"{name}, {target.size[0]}x{target.size[1]}, {int(shown.sum()):,} texels"
    rows = [
        _row(f"{title}: seconds, and of Cycles at {samples} samples + OIDN", ours.time, "s", peer.time),
        _row(f"{title}: relMSE, ours and theirs", error(ours.image), "1", error(peer.image)),
        _row(f"{title}: bias, ours and theirs", bias, "1", metrics.bias(peer.image[lit][None], mean[lit][None])),
        _row(f"{title}: texels black that the reference lights, ours and theirs", black[0], "texels", black[1]),
    ]
    if len(seams.a):
        rows.append(_seam_row(title, ours.image, peer.image, shown, seams))
    return rows


def _seam_row(title: str, ours: np.ndarray, theirs: np.ndarray, filled: np.ndarray, seams: Seams) -> dict:
    """Mean difference across the seams, of the mean light; both by the same places, whose texels hold light in both."""
    known = filled | ((ours.max(axis=2) > 0) & (theirs.max(axis=2) > 0))
    values = [seam_error(image, known, seams) for image in (ours, theirs)]
    return _row(f"{title}: difference across {len(seams.a):,} seam edges, ours and theirs", values[0], "1", values[1])


def round_trip_row(
    source: str, size: tuple[int, int] = VIEW, density: float = DENSITY, settings: RenderSettings | None = None, detail: str = "full"
) -> dict:
    """The mean difference between a scene as it is computed, and as it looks after baking, export to glTF and import.

    What is compared is what surfaces show without reflections of other surfaces: a lightmap has no view, and so no highlights.
    """
    settings = settings or RenderSettings()
    scene = open_source(find_scene(source) or source, detail=detail)
    arrays = extract(scene, camera=None, size=size, frame=None)
    computed = render(arrays, settings).layers
    with quiet(), tempfile.TemporaryDirectory() as folder:
        request = LightmapRequest(BakeSettings(settings, "full"), density=density, atlas=True)
        exported = export_gltf(scene, bake_scene(scene, choose_objects(scene), request), Path(folder) / "scene.glb")
        again = extract(open_scene(exported), camera=None, size=size, frame=None)
    # glTF cameras have no lens shift: the same eye looks at both.
    matrix = arrays.camera.matrix.copy()
    matrix[:3, 3] += arrays.origin - again.origin
    again.camera = replace(arrays.camera, matrix=matrix)
    shown = render(again, replace(settings, bounces=0, layers=("Emission",))).layers["Emission"]
    surface = computed["Depth"][..., 0] < _BACKGROUND
    expected = computed["Combined"] - computed["GlossyIndirect"]
    difference = float(shown[surface].mean() / expected[surface].mean() - 1)
    return {
        "suite": "lightmaps",
        "case": f"{source}: mean of the exported scene against the computed one",
        "value": difference,
        "unit": "1",
    }


def _row(case: str, value: float, unit: str, peer: float) -> dict:
    ratio = {"ratio": value / peer} if peer else {}
    return {"suite": "lightmaps", "case": case, "value": value, "unit": unit, "peer_value": peer, **ratio}
