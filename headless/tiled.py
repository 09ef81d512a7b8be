"""Pictures that do not fit into memory, tile by tile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..core.layers import Layers
from ..core.memory import SHARE, available, check_memory, estimate
from ..core.pipeline import RenderResult, render
from ..core.scene import Scene
from ..core.settings import RenderSettings
from ..core.stages import StageProgress
from ..core.topology import Topologies
from .farm.parts import joined, tiles, with_halo

SIDES = (4096, 2048, 1024, 512, 256, 128, 64)  # of tiles that are tried
HELD = 250  # bytes of a pixel in all layers, and on their way into the file

Tile = tuple[int, int, int, int]


def fitting_tiles(scene: Scene, settings: RenderSettings) -> list[Tile]:
    """The largest tiles of the picture that a render fits into memory with; none where the whole does.

    Raises:
        SceneError: not even the smallest do, or only a part of the picture is wanted.
    """
    free, camera = available(), scene.camera
    if free is None or estimate(scene, settings) <= SHARE * free:
        return []
    width, height = camera.width, camera.height
    if tuple(camera.border) == (0, 0, width, height):
        for side in SIDES:
            cut = list(tiles(width, height, side))
            largest = max((with_halo(tile, width, height) for tile in cut), key=lambda b: (b[2] - b[0]) * (b[3] - b[1]))
            if HELD * width * height + estimate(_seen_through(scene, largest), settings) <= SHARE * free:
                return cut
    check_memory(scene, settings)
    return []  # other programs have given memory back


def _seen_through(scene: Scene, border: Tile) -> Scene:
    return replace(scene, camera=replace(scene.camera, border=border))


def render_fitting(
    scene: Scene, settings: RenderSettings, progress: StageProgress, *, extraction_seconds: float, topologies: Topologies
) -> RenderResult:
    """`core.pipeline.render`, in tiles where the picture does not fit into memory; a time budget is shared by them."""
    cut = fitting_tiles(scene, settings)
    if not cut:
        return render(scene, settings, progress, extraction_seconds=extraction_seconds, topologies=topologies)
    width, height = scene.camera.width, scene.camera.height
    if settings.time_budget is not None:
        settings = replace(settings, time_budget=settings.time_budget / len(cut))
    parts: dict[Tile, Layers] = {}
    stats: list[dict] = []
    for k, tile in enumerate(cut):
        part = render(
            _seen_through(scene, with_halo(tile, width, height)), settings, _of_tile(progress, k, len(cut)), topologies=topologies,
            extraction_seconds=0.0 if k else extraction_seconds,
        )  # fmt: skip
        parts[tile] = _cropped(part.layers, tile)
        stats.append(part.stats)
    note = f"the picture does not fit into memory: it was rendered in {len(cut)} tiles, whose borders may show in noise-free light"
    whole = _together(stats) | {"size": [width, height], "tiles": len(cut)}
    whole["warnings"] = [*whole["warnings"], note]
    return RenderResult(joined(parts, width, height), whole)


def _of_tile(progress: StageProgress, k: int, count: int) -> Callable[[str, float], bool]:
    return lambda stage, fraction: progress(f"tile {k + 1} of {count}: {stage}", fraction)


def _cropped(layers: Layers, tile: Tile) -> Layers:
    """Without its halo, in memory of its own."""
    (left, top), (x0, y0, x1, y1) = layers.offset, tile
    arrays = {name: array[y0 - top : y1 - top, x0 - left : x1 - left].copy() for name, array in layers.items()}
    return replace(layers, arrays=arrays, offset=(x0, y0))


def _together(stats: list[dict]) -> dict:
    """The statistics of all tiles as those of one render: what was done adds up, what was said is said once."""
    whole = dict(stats[0])
    for name in ("seconds", "rays"):
        keys = dict.fromkeys(key for one in stats for key in one[name])
        whole[name] = {key: sum(one[name].get(key, 0) for one in stats) for key in keys}
    for name in ("seconds_total", "vpls", "pairs_shaded", "passes"):
        whole[name] = sum(one[name] for one in stats)
    for name in ("skipped", "warnings"):
        whole[name] = []
        for line in (line for one in stats for line in one[name]):
            if line not in whole[name]:
                whole[name].append(line)
    return whole
