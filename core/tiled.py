"""Pictures that do not fit into memory, tile by tile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from .memory import SHARE, available, check_memory, estimate
from .pipeline import RenderResult, render
from .scene import Scene
from .settings import RenderSettings
from .stages import StageProgress
from .tiles import Mosaic, Tile, tiles, with_halo
from .topology import IN_MEMORY, Topologies

SIDES = (4096, 2048, 1024, 512, 256, 128, 64)  # of tiles that are tried
HELD = 250  # bytes of a pixel in all layers, and on their way into the file


def fitting_tiles(scene: Scene, settings: RenderSettings) -> list[Tile]:
    """The largest tiles of the picture that a render fits into memory with; none where the whole does.

    Raises:
        SceneError: not even the smallest do.
    """
    free, border = available(), scene.camera.border
    if free is None or estimate(scene, settings) <= SHARE * free:
        return []
    whole = HELD * _pixels(border)
    for side in SIDES:
        cut = list(tiles(border, side))
        largest = max((with_halo(tile, border) for tile in cut), key=_pixels)
        if whole + estimate(_seen_through(scene, largest), settings) <= SHARE * free:
            return cut
    check_memory(scene, settings)
    return []  # other programs have given memory back


def _pixels(tile: Tile) -> int:
    return (tile[2] - tile[0]) * (tile[3] - tile[1])


def _seen_through(scene: Scene, border: Tile) -> Scene:
    return replace(scene, camera=replace(scene.camera, border=border))


def render_fitting(
    scene: Scene,
    settings: RenderSettings,
    progress: StageProgress | None = None,
    *,
    extraction_seconds: float = 0.0,
    topologies: Topologies = IN_MEMORY,
    side: int | None = None,
) -> RenderResult:
    """`core.pipeline.render`, in tiles where the picture does not fit into memory; a time budget is shared by them.

    side: pixels along a side of tiles that are wanted, whatever the memory.
    """
    cut = fitting_tiles(scene, settings) if side is None else list(tiles(scene.camera.border, side))
    if not cut:
        return render(scene, settings, progress, extraction_seconds=extraction_seconds, topologies=topologies)
    if settings.time_budget is not None:
        settings = replace(settings, time_budget=settings.time_budget / len(cut))
    border = scene.camera.border
    mosaic, stats = Mosaic(cut, border), []
    for k, tile in enumerate(cut):
        part = render(
            _seen_through(scene, with_halo(tile, border)), settings, _of_tile(progress, k, len(cut)), topologies=topologies,
            extraction_seconds=0.0 if k else extraction_seconds,
        )  # fmt: skip
        mosaic.add(tile, part.layers)
        stats.append(part.stats)
    note = f"the picture does not fit into memory: it was rendered in {len(cut)} tiles, each with light samples of its own"
    whole = _together(stats) | {"size": [border[2] - border[0], border[3] - border[1]], "tiles": len(cut)}
    if side is None:
        whole["warnings"] = [*whole["warnings"], note]
    return RenderResult(mosaic.picture(), whole)


def _of_tile(progress: StageProgress | None, k: int, count: int) -> Callable[[str, float], bool] | None:
    return progress and (lambda stage, fraction: progress(f"tile {k + 1} of {count}: {stage}", fraction))


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
    whole["savings"] = _savings([line for one in stats for line in one["savings"]])
    return whole


def _savings(lines: list[dict]) -> list[dict]:
    """What all tiles have saved; what tiles have counted adds up."""
    found: dict[tuple, dict] = {}
    for line in lines:
        known = found.get((line["stage"], line["what"]), line)
        if known is not line and "of" in line:
            left, of = known["left"] + line["left"], known["of"] + line["of"]
            line = line | {"left": left, "of": of, "share": left / of}
        found[line["stage"], line["what"]] = line
    return list(found.values())
