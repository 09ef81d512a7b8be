"""`lumigate bench peers`: time against error beside other renderers, all of which show the same neutral scene (see `neutral`).

The protocol is that of `curves_bench`.  Two layers are compared: `Indirect` with those that can tell it from direct light (Cycles; Mitsuba by the
difference of two renders of one seed), and `Light`, direct and indirect together, with all of them: LuxCore counts light that a path meets by
chance as indirect.  Pixels in which an emitter or the world is seen belong to neither: LuxCore's own layer of them is no mean over a pixel.

Rows of three suites: `peers` (what was measured), `peers-time` (seconds to an error, ours and the best of each renderer) and `peers-check`
(whether a renderer shows the reference's direct light; a peer that does not has no rows).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle, zip_longest
from pathlib import Path

import bpy
import numpy as np

from ...core.denoise import Denoiser
from ...core.errors import SceneError
from ...core.layers import Layers, auto_exposure, srgb, write_png, write_whole
from .. import contestants
from ..bench_steps import Step
from ..contestants import Timed
from ..curves_bench import (
    DENOISED_PEERS,
    METRICS,
    OPPOSITE,
    OURS,
    PEER_SAMPLES,
    PEER_SEED,
    PEERS,
    QUALITIES,
    REFERENCE_SAMPLES,
    REPEATS,
    SIZE,
    TARGET_SAMPLES,
    Point,
    Time,
    Truth,
    plain_seconds,
    render_cycles,
    scenes_to_plot,
    time_to_error,
    truth_of,
)
from ..reference import ReferenceSettings, denoise_layers
from ..sources import extract, open_source
from . import blender, luxcore, mitsuba
from .check import Check, same_light
from .neutral import neutral_scene
from .worker import Worker

SCENES = ("living-room-greywhite", "sponza-crytek", "atrium", "cornell")
LAYERS = ("Indirect", "Light")
TARGETS = (0.05, 0.02)
WAYS = ("", "+oidn", "+oidn, guides denoised")
CHECK_SAMPLES, CHECK_QUALITY = 32, 2.0
# In a report that is printed in grey a line is told by its mark.
_STYLES = (("o", "-"), ("s", "--"), ("D", ":"), ("^", "-."), ("v", "--"), ("P", ":"), ("X", "-."), ("<", "--"))


@dataclass(frozen=True)
class Peer:
    """A renderer in one way of rendering, in its process.

    arguments: the first ones of its function `render`.  layers: of `LAYERS`, those that it can be compared by.
    denoised: the layers that are denoised for them.
    """

    name: str
    worker: Worker
    arguments: tuple
    layers: tuple[str, ...]
    denoised: tuple[str, ...]

    def render(self, samples: int, seed: int) -> tuple[Timed, float]:
        """A picture and its seconds, and the seconds of guides for a denoiser."""
        layers, seconds, guides = self.worker.call("render", *self.arguments, samples, OURS.bounces, seed)
        return Timed(seconds, layers), guides


def peers_steps(
    folder: Path,
    scenes: Sequence[str] | None = None,
    size: tuple[int, int] = SIZE,
    spp: Sequence[int] = PEER_SAMPLES,
    reference_samples: int = REFERENCE_SAMPLES,
    repeats: int = REPEATS,
    qualities: Sequence[float] = QUALITIES,
) -> list[Step]:
    """A step for each scene; pictures go into `folder`.

    scenes: as `sources.find_scene` takes them; None is `SCENES`, as far as they are there.
    Raises SceneError where a scene is not there, or there is nothing to draw plots with.
    """
    samples = sorted({*spp, TARGET_SAMPLES})
    return [
        Step(f"peers {name}", partial(_scene_rows, folder, name, source, size, samples, reference_samples, repeats, qualities))
        for name, source in scenes_to_plot(scenes, SCENES).items()
    ]


def peers_summary(folder: Path, rows: list[dict]) -> None:
    """Plots of the rows, where there are any, into `folder`."""
    for layer in LAYERS:
        plot(folder / f"peers-{layer}.png", layer, rows)


def _scene_rows(folder: Path, name: str, source: str, size, spp, reference_samples: int, repeats: int, qualities) -> list[dict]:
    try:
        neutral = neutral_scene(extract(open_source(source), camera=None, size=size, frame=None))
    except SceneError as error:
        return [_said(f"{name}: refused: {error}")]
    scene = blender.build(neutral)
    rows = [_said(f"{name}: for everyone, {note}") for note in neutral.notes]
    with closing(Denoiser()) as denoiser, ExitStack() as stack:
        workers = [stack.enter_context(closing(Worker(module.NAME, neutral))) for module in (mitsuba, luxcore)]
        truth = with_light(truth_of(scene, name, neutral.identity(), size, reference_samples, denoiser))
        reference = tuple(half["Direct"] for half in truth.halves)
        shown = ~truth.mean["Emission"].any(2)
        ours = [contestants.ours(scene, size, replace(OURS, seed=seed).scaled(CHECK_QUALITY, 0)).layers["Direct"] for seed in (0, 1)]
        rows.append(_check_row(name, "lumigate", same_light(reference, ours, shown)))
        peers, checks = _peers(name, workers, neutral.has_gaps, reference, shown)
        rows += checks
        points, pictures, lost = _measure(scene, truth, size, spp, repeats, qualities, peers, denoiser)
        rows += [_said(f"{name}: {line}") for line in lost]
        plain = re.sub(r"[^\w.-]+", "-", name)
        _write_pictures(folder / f"beside-peers-{plain}.png", truth, pictures)
    rows += [_point_row(name, size, truth, layer, point) for layer in LAYERS for point in points if point.errors.get(layer)]
    return rows + [row for layer in LAYERS for row in time_rows(name, layer, points, truth.noise(layer))]


def _said(line: str, **more) -> dict:
    return {"suite": "peers-check", "case": line, "value": None, "unit": ""} | more


def with_light(truth: Truth) -> Truth:
    """A reference with the layer `Light`, in which nothing is where an emitter is seen."""
    shown = ~truth.mean["Emission"].any(2, keepdims=True)
    for layers in (*truth.halves, truth.mean, truth.clean):
        for name, whole in (("Light", "Combined"), ("Indirect", "Indirect")):
            layers[name] = np.where(shown, layers[whole], 0)
    return truth


def _peers(name: str, workers: Sequence[Worker], has_gaps: bool, reference, shown: np.ndarray) -> tuple[list[Peer], list[dict]]:
    """The renderers that are there and show the reference's direct light (two pictures), and rows that say so of all."""
    peers, rows = [], []
    for worker in workers:
        try:
            version = worker.call("version")
            for title, arguments, chosen in (_mitsuba if worker.module == mitsuba.NAME else _luxcore)(worker, has_gaps):
                pictures = tuple(worker.call("direct", *arguments, CHECK_SAMPLES, seed) for seed in (0, 1))
                check = same_light(reference, pictures, shown)
                rows.append(_check_row(name, f"{title} {version}", check))
                if check.holds:
                    peers += chosen
                    break
        except SceneError as error:
            rows.append(_said(f"{name}: {error}"))
    return peers, rows


def _mitsuba(worker: Worker, has_gaps: bool) -> list[tuple[str, tuple, list[Peer]]]:
    """(title, arguments of `mitsuba.direct`, peers) of Mitsuba's integrators, the quicker one first."""
    names = {"path": mitsuba.NAME} | ({"volpath": f"{mitsuba.NAME} volpath"} if has_gaps else {})
    return [(name, (kind,), [Peer(name, worker, (kind,), LAYERS, ("Direct", "DiffuseIndirect"))]) for kind, name in names.items()]


def _luxcore(worker: Worker, has_gaps: bool) -> list[tuple[str, tuple, list[Peer]]]:
    """As `_mitsuba`: LuxCore has one kind of direct light, and two peers of it."""
    names = {False: luxcore.NAME, True: f"{luxcore.NAME} cache"}
    return [(luxcore.NAME, (), [Peer(name, worker, (cached,), ("Light",), ("Direct",)) for cached, name in names.items()])]


def _check_row(name: str, title: str, check: Check) -> dict:
    verdict = "the same" if check.holds else "not the same"
    blocks = f"worst block {100 * check.worst:.1f} %, {100 * check.allowed:.1f} % allowed"
    return _said(f"{name}: direct light of {title} over the reference's ({blocks}): {verdict}") | {
        "value": check.mean,
        "unit": "1",
        "holds": check.holds,
    }


def _measure(scene: bpy.types.Scene, truth: Truth, size, spp, repeats: int, qualities, peers: list[Peer], denoiser: Denoiser):
    """Points of all contestants at all settings, which take turns, ours first; the last pictures of `Light` by method and amount; lines on peers
    that ended on the way.
    """
    ours = [Point(OURS.method, f"quality {quality:g}", quality, errors={}) for quality in qualities]
    theirs: list[dict[str, Point]] = []
    for samples in spp:
        methods = [*PEERS, *(f"{peer.name}{way}" for peer in peers for way in WAYS)]
        theirs.append({method: Point(method, f"{samples} spp", samples, errors={}) for method in methods})
    shown = ~truth.mean["Emission"].any(2, keepdims=True)
    pictures, lost = {}, {}

    def add(point: Point, run: Timed, layers: Sequence[str]) -> None:
        point.seconds.append(run.seconds)
        for layer in layers:
            picture = Layers({layer: np.where(shown, run.layers["Combined" if layer == "Light" else layer], 0)})
            point.errors.setdefault(layer, []).append(truth.errors(picture, layer))
            if layer == "Light":
                pictures[point.method, point.amount] = picture[layer]

    render_cycles(scene, size, 1, 0, denoiser)
    contestants.ours(scene, size, OURS.scaled(min(qualities), 0))
    for seed in range(-1, repeats):  # the first turn loads the peers' kernels, one for each number of samples
        for point, others in zip_longest(ours, theirs):
            if point and seed >= 0:
                add(point, contestants.ours(scene, size, replace(OURS, seed=seed).scaled(point.amount, 0)), LAYERS)
            if not others:
                continue
            samples = next(iter(others.values())).amount
            if seed >= 0:
                for method, run in render_cycles(scene, size, samples, seed, denoiser).items():
                    add(others[method], run, LAYERS)
            for peer in peers if seed >= 0 else [p for p in peers if p.name.startswith(mitsuba.NAME)]:
                if peer.name in lost:
                    continue
                try:
                    raw, guides = peer.render(samples, PEER_SEED + seed)
                except SceneError as error:
                    lost[peer.name] = f"{peer.name} with {samples} samples: {error}"
                    continue
                if seed >= 0:
                    for way, run in _denoised(peer, raw, guides, denoiser).items():
                        add(others[f"{peer.name}{way}"], run, peer.layers)
    return [*ours, *(point for others in theirs for point in others.values())], pictures, list(lost.values())


def _write_pictures(path: Path, truth: Truth, pictures: dict[tuple[str, float], np.ndarray]) -> None:
    """Light of the reference, ours at quality 1, and the peers' at `TARGET_SAMPLES`, as they are and denoised: a row for each renderer."""
    last = [truth.clean["Light"], *(picture for (method, amount), picture in pictures.items() if (method, amount) == (OURS.method, 1.0))]
    rows = [last]
    for method, amount in pictures:
        if amount == TARGET_SAMPLES and f"{method}{WAYS[1]}" in {name for name, _ in pictures}:
            rows.append([pictures[method, amount], pictures[f"{method}{WAYS[1]}", amount]])
    rows = [row + [np.zeros_like(row[0])] * (2 - len(row)) for row in rows]
    stops = auto_exposure([truth.clean["Light"]])
    write_png(path, srgb(np.block([[[picture] for picture in row] for row in rows]) * np.float32(2.0**stops)))


def _denoised(peer: Peer, raw: Timed, guides: float, denoiser: Denoiser) -> dict[str, Timed]:
    """A picture as it is, and denoised as Cycles' are, with guides as they are and denoised first."""
    runs = {"": raw}
    for way, prefilter in zip(WAYS[1:], (False, True)):
        layers = replace(raw.layers, arrays=dict(raw.layers))
        request = ReferenceSettings(denoise=True, prefilter=prefilter, denoised=peer.denoised)
        seconds = denoise_layers(layers, request, denoiser)["denoise"]
        runs[way] = Timed(raw.seconds + guides + seconds, layers)
    return runs


def best_time(points: Sequence[Point], layer: str, target: float) -> tuple[str, Time]:
    """The method that reaches an error first, and when; where none is seen to, the one that comes nearest, which takes more than its last time."""
    times, nearest = {}, {}
    for method in dict.fromkeys(point.method for point in points):
        own = [point for point in points if point.method == method]
        times[method] = time_to_error([point.time for point in own], [point.error(layer) for point in own], target)
        nearest[method] = min(point.error(layer) for point in own)
    reached = [method for method, time in times.items() if time.bound != "more than"]
    best = min(reached, key=lambda method: times[method].seconds) if reached else min(nearest, key=nearest.__getitem__)
    return best, times[best]


def _family(method: str) -> str:
    """The renderer of a method."""
    return next(name for name in ("cycles", mitsuba.NAME, luxcore.NAME) if name in method)


def time_rows(scene: str, layer: str, points: list[Point], noise: float) -> list[dict]:
    """Our seconds to each error beside those of each renderer, in its best way: at `TARGETS`, and at those of the best Cycles.

    noise: of the reference, as relMSE; a row's case says so where it is above a tenth of the error (design.md, section 6).
    """
    there = [point for point in points if layer in point.errors]
    ours = [point for point in there if point.method == OURS.method]
    peers = [point for point in there if point.method != OURS.method]
    targets = {f"{target:g}": target for target in TARGETS}
    for samples in sorted({point.amount for point in peers if point.amount >= TARGET_SAMPLES}):
        best = min(point.error(layer) for point in peers if point.amount == samples and point.method in DENOISED_PEERS)
        if best > 0:
            targets[f"{best:.2e}, Cycles' at {samples}"] = best
    rows = []
    for title, target in targets.items():
        title += f" (noise of the reference: {noise:.1e})" if noise > target / 10 else ""
        mine = best_time(ours, layer, target)[1]
        for family in dict.fromkeys(_family(point.method) for point in peers):
            method, theirs = best_time([point for point in peers if _family(point.method) == family], layer, target)
            rows.append(_time_row(scene, layer, title, target, mine, family, method, theirs))
    return rows


def _time_row(scene: str, layer: str, title: str, target: float, mine: Time, family: str, method: str, theirs: Time) -> dict:
    bounds = {bound for bound in (theirs.bound, OPPOSITE.get(mine.bound)) if bound}
    bound = None if not bounds else bounds.pop() if len(bounds) == 1 else "uncertain"
    row = {
        "suite": "peers-time",
        "case": f"{scene}: seconds to the relMSE {title} of {layer}; peer: {method}",
        "value": mine.seconds,
        "unit": "s",
        "peer_value": theirs.seconds,
        "ratio": theirs.seconds / mine.seconds,
        "scene": scene,
        "layer": layer,
        "relmse": target,
        "renderer": family,
        "method": method,
    }
    return row | {key: value for key, value in (("bound", mine.bound), ("peer_bound", theirs.bound), ("ratio_bound", bound)) if value}


def _point_row(scene: str, size, truth: Truth, layer: str, point: Point) -> dict:
    return {
        "suite": "peers",
        "scene": scene,
        "layer": layer,
        "size": list(size),
        "method": point.method,
        "setting": point.setting,
        "peer": point.method != OURS.method,
        "seconds": point.time,
        **{metric: point.error(layer, metric) for metric in METRICS},
        "invalid": max(errors["invalid"] for errors in point.errors[layer]),
        "reference_noise": truth.noise(layer),
        "runs": len(point.seconds),
    }


def plot(path: Path, layer: str, rows: list[dict]) -> None:
    """Seconds against relMSE of `layer`, both logarithmic: a panel a scene, a line for ours and each way of rendering, denoised as does best."""
    from matplotlib.figure import Figure

    rows = [row for row in rows if row["suite"] == "peers" and row["layer"] == layer]
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    if not scenes:
        return
    renderers = list(dict.fromkeys(_undenoised(row["method"]) for row in rows))
    columns = min(2, len(scenes))
    lines = math.ceil(len(scenes) / columns)
    figure = Figure(figsize=(5 * columns, 4 * lines), layout="constrained")
    for scene, axes in zip(scenes, figure.subplots(lines, columns, squeeze=False).flat):
        for number, (renderer, (marker, line)) in enumerate(zip(renderers, cycle(_STYLES))):
            own = [row for row in rows if row["scene"] == scene and _undenoised(row["method"]) == renderer]
            if not own:
                continue
            best = min(own, key=lambda row: row["relmse"])["method"]
            curve = [(row["seconds"], row["relmse"]) for row in own if row["method"] == best and row["relmse"] > 0]
            style = {"color": f"C{number}", "marker": marker, "linestyle": line}  # the same in every panel, whoever is missing
            axes.plot(*zip(*curve) if curve else ((), ()), **style, markersize=5, linewidth=1.2, label=renderer)
        axes.set(title=scene, xscale="log", yscale="log", xlabel="seconds", ylabel="relMSE, net of the reference's noise")
        plain_seconds(axes)
        axes.grid(True, which="major", linewidth=0.4, color="0.8")
    handles = {label: handle for axes in figure.axes for handle, label in zip(*axes.get_legend_handles_labels())}
    figure.legend(handles.values(), handles, fontsize="small", loc="outside lower center", ncols=3)
    for axes in figure.axes[len(scenes) :]:
        axes.set_axis_off()
    figure.suptitle(f"{layer}, each renderer denoised as does best")
    write_whole(path, lambda partial: figure.savefig(partial, dpi=120))


def _undenoised(method: str) -> str:
    return method.split("+", 1)[0]
