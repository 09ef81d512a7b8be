"""Time against error: the default method beside Cycles, raw and with Open Image Denoise.

Contestants take turns in one run, each turn with seeds of its own; a row has the medians.  Errors are those of a layer against
two independent halves of a reference by Cycles, relMSE net of their noise (`core.metrics.net_relmse`).  Cycles renders without path guiding
and with it, and is denoised with its guides as they are and with guides denoised first; the best of the four at `TARGET_SAMPLES` is the peer of
a scene, at equal time the best one of that time.

Rows of three suites: `curves` (what was measured), `time-to-error` (seconds to the peer's error, interpolated) and `equal-time`
(errors of the pictures, which lie beside the plots).  A row with a `bound` holds one of what lies outside what was measured:
`value` is "more than" or "less than" the figure, or "uncertain" where bounds of both kinds went into it.
"""

from __future__ import annotations

import importlib.util
import math
import re
import statistics
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise, zip_longest
from pathlib import Path

import bpy
import numpy as np

from ..core import metrics
from ..core.denoise import Denoiser
from ..core.errors import SceneError
from ..core.layers import Layers, auto_exposure, srgb, write_png, write_whole
from ..core.settings import RenderSettings
from . import contestants
from .bench_steps import Step
from .cache import cached_halves, scene_identity
from .reference import ReferenceSettings, denoise_layers
from .sources import find_scene, open_source

SCENES = ("atrium", "corridor", "cathedral", "cornell")
SHARED = ("cornell-box/Original", "cornell-box/Sphere", "cornell-box/Glossy", "living-room-greywhite", "sponza-crytek")
LAYERS = ("DiffuseIndirect", "Indirect")
SIZE = (480, 270)
QUALITIES = (0.03125, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
PEER_SAMPLES, TARGET_SAMPLES, REFERENCE_SAMPLES = (4, 16, 64), 16, 256
BUDGETS = (1.0, 2.0, 5.0)  # seconds of the pictures at equal time
REPEATS = 3
OURS = RenderSettings().with_defaults()
_WAYS = {"": {}, "+oidn": {"denoise": True}, "+oidn, guides denoised": {"denoise": True, "prefilter": True}}
# Of Cycles, as fields of `ReferenceSettings`; what is not denoised is no peer for the time to an error.
PEERS = {
    **{f"cycles{name}": way for name, way in _WAYS.items()},
    **{f"guided cycles{name}": way | {"guiding": True} for name, way in _WAYS.items()},
}
DENOISED_PEERS = tuple(method for method, way in PEERS.items() if way.get("denoise"))
PEER_SEED = 1000  # far from the reference's seeds: a picture must not share its noise
MOST_SAMPLES = 4096
LATEST = 1.2  # of a budget: what takes longer has not kept it
METRICS = ("relmse", "rmse", "bias", "flip")
OPPOSITE = {"more than": "less than", "less than": "more than"}


@dataclass(frozen=True)
class Truth:
    """Two independent halves of a reference, their mean, and that denoised."""

    halves: tuple[Layers, Layers]
    mean: Layers
    clean: Layers

    def errors(self, layers: Layers, name: str) -> dict:
        """What `core.metrics.compare` says of a layer, relMSE net of the reference's noise."""
        net = metrics.net_relmse(layers[name], *(half[name] for half in self.halves), self.clean[name])
        return metrics.compare(layers[name], self.mean[name]) | {"relmse": net}

    def noise(self, name: str) -> float:
        """What the noise of the reference would add to a relMSE."""
        return metrics.reference_noise(*(half[name] for half in self.halves), self.clean[name])

    def doubt(self, name: str) -> float:
        """The standard deviation that this noise leaves in a net relMSE."""
        return metrics.reference_doubt(*(half[name] for half in self.halves), self.clean[name])


@dataclass
class Point:
    """A contestant at one setting (`amount`: quality, or samples a pixel): seconds of its runs, and their errors by layer."""

    method: str
    setting: str
    amount: float
    seconds: list[float] = field(default_factory=list)
    errors: dict[str, list[dict]] = field(default_factory=lambda: {name: [] for name in LAYERS})

    def add(self, run: contestants.Timed, truth: Truth) -> None:
        """Note one run."""
        self.seconds.append(run.seconds)
        for name in LAYERS:
            self.errors[name].append(truth.errors(run.layers, name))

    @property
    def time(self) -> float:
        """Median seconds."""
        return statistics.median(self.seconds)

    def error(self, layer: str, metric: str = "relmse") -> float | None:
        """Median error; None where a run has none (FLIP without its package)."""
        values = [errors[metric] for errors in self.errors[layer]]
        return None if None in values else statistics.median(values)


@dataclass(frozen=True)
class Time:
    """Seconds, or what they are more or less than."""

    seconds: float
    bound: str | None = None


def curves_rows(folder: Path, **request) -> list[dict]:
    """Rows of all scenes at once; arguments as `curves_steps`."""
    rows = [row for step in curves_steps(folder, **request) for row in step.work()]
    return rows + curves_summary(folder, rows)


def curves_steps(
    folder: Path,
    scenes: Sequence[str] | None = None,
    size: tuple[int, int] = SIZE,
    spp: Sequence[int] = PEER_SAMPLES,
    reference_samples: int = REFERENCE_SAMPLES,
    repeats: int = REPEATS,
    qualities: Sequence[float] = QUALITIES,
    budgets: Sequence[float] = BUDGETS,
) -> list[Step]:
    """A step for each scene; pictures go into `folder`.

    scenes: as `sources.find_scene` takes them; None is the sample scenes and those shared ones that are there.
    Raises SceneError where a scene is not there, or there is nothing to draw plots with.
    """
    samples = sorted({*spp, TARGET_SAMPLES})
    return [
        Step(f"curves {name}", partial(_scene_rows, folder, name, source, size, samples, reference_samples, repeats, qualities, budgets))
        for name, source in scenes_to_plot(scenes, (*SCENES, *SHARED)).items()
    ]


def scenes_to_plot(scenes: Sequence[str] | None, usual: Sequence[str]) -> dict[str, str]:
    """Where the scenes of a suite with plots are, by name: those asked for, or of the usual ones those that are there.

    Raises:
        SceneError: one that is asked for is not there, or there is nothing to draw plots with.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise SceneError("the plots need the package matplotlib, which is not installed; install it with pip")
    found = {name: find_scene(name) for name in scenes or usual}
    missing = [name for name, source in found.items() if source is None]
    if scenes and missing:
        raise SceneError(f"there is no scene {missing[0]!r}; name a file, a sample scene or a scene in the folder LUMIGATE_SCENES")
    return {name: source for name, source in found.items() if source is not None}


def curves_summary(folder: Path, rows: list[dict]) -> list[dict]:
    """Rows of all scenes together, where there are any; the plots go into `folder`."""
    if not any(row["suite"] == "curves" for row in rows):
        return []
    for layer in LAYERS:
        plot(folder / f"curves-{layer}.png", layer, rows)
    return geometric_means(rows)


def _scene_rows(folder, name: str, source: str, size, spp, reference_samples: int, repeats: int, qualities, budgets) -> list[dict]:
    scene = open_source(source)
    with closing(Denoiser()) as denoiser:
        truth = reference_truth(scene, source, size, reference_samples, denoiser)
        points = _measure(scene, truth, size, spp, repeats, qualities, denoiser)
        rows = [_point_row(name, size, truth, layer, point) for layer in LAYERS for point in points]
        rows += [row for layer in LAYERS for row in time_rows(name, layer, points, truth.noise(layer))]
        for budget in budgets:
            rows += _equal_time(folder, name, scene, truth, size, budget, points, denoiser)
    return rows


def reference_truth(scene: bpy.types.Scene, source: str, size, samples: int, denoiser: Denoiser) -> Truth:
    """Of the open scene, rendered by Cycles where it is not in the cache; SceneError where it has no indirect light."""
    return truth_of(scene, source, scene_identity(source), size, samples, denoiser)


def truth_of(scene: bpy.types.Scene, name: str, identity: dict, size, samples: int, denoiser: Denoiser) -> Truth:
    """`reference_truth` of a scene called `name` that `identity` tells from any other."""
    halves = cached_halves(scene, identity, spp=samples, size=size, bounces=OURS.bounces)
    mean = Layers({layer: (halves[0][layer] + halves[1][layer]) / 2 for layer in halves[0]})
    for layer in LAYERS:
        if not mean[layer].any():
            raise SceneError(f"{name} has no light in the layer {layer}, so that no error can be told; leave this scene out")
    clean = replace(mean, arrays=dict(mean))
    denoise_layers(clean, ReferenceSettings(denoise=True, prefilter=True), denoiser)
    return Truth(halves, mean, clean)


def _measure(scene: bpy.types.Scene, truth: Truth, size, spp, repeats: int, qualities, denoiser: Denoiser) -> list[Point]:
    """All contestants at all settings, ours first in each turn."""
    ours = [Point(OURS.method, f"quality {quality:g}", quality) for quality in qualities]
    theirs = [[Point(method, f"{samples} spp", samples) for method in PEERS] for samples in spp]
    render_cycles(scene, size, 1, 0, denoiser)
    contestants.ours(scene, size, OURS.scaled(min(qualities), 0))
    for seed in range(repeats):
        for point, peers in zip_longest(ours, theirs):
            if point:
                point.add(contestants.ours(scene, size, replace(OURS, seed=seed).scaled(point.amount, 0)), truth)
            if peers:
                runs = render_cycles(scene, size, peers[0].amount, seed, denoiser)
                for peer in peers:
                    peer.add(runs[peer.method], truth)
    return [*ours, *(peer for peers in theirs for peer in peers)]


def render_cycles(
    scene: bpy.types.Scene, size, samples: int, seed: int, denoiser: Denoiser, methods: Sequence[str] = tuple(PEERS)
) -> dict[str, contestants.Timed]:
    """Pictures of Cycles by the methods of `PEERS`: one render without path guiding and one with it, each as it is and denoised in each way."""
    runs, raw = {}, {}
    for method in methods:
        guiding = PEERS[method].get("guiding", False)
        request = ReferenceSettings(spp=samples, size=size, bounces=OURS.bounces, seed=PEER_SEED + seed, guiding=guiding)
        if guiding not in raw:
            raw[guiding] = contestants.cycles(scene, request, denoiser)
        denoise = PEERS[method].get("denoise")
        runs[method] = contestants.denoised(raw[guiding], replace(request, **PEERS[method]), denoiser) if denoise else raw[guiding]
    return runs


def time_to_error(seconds: Sequence[float], errors: Sequence[float], target: float) -> Time:
    """When a curve first reaches the error `target` > 0, linear in the logarithms between two points; never beyond them.

    An error of 0 or less (net of the reference's noise, by chance) has no logarithm: the point's time is then an upper bound.
    """
    points = sorted(zip(seconds, errors))
    first, last = points[0], points[-1]
    if first[1] <= target:
        return Time(first[0], None if first[1] == target else "less than")
    for (t0, e0), (t1, e1) in pairwise(points):
        if e1 <= target:
            if e1 <= 0:
                return Time(t1, "less than")
            return Time(t0 * (t1 / t0) ** (math.log(e0 / target) / math.log(e0 / e1)))
    return Time(last[0], "more than")


def best_peer(points: list[Point], layer: str) -> str:
    """The denoised Cycles with the least error of `layer` at `TARGET_SAMPLES`."""
    denoised = (p for p in points if p.method in DENOISED_PEERS and p.amount == TARGET_SAMPLES)
    return min(denoised, key=lambda point: point.error(layer)).method


def time_rows(scene: str, layer: str, points: list[Point], noise: float) -> list[dict]:
    """Our seconds to the peer's error at `TARGET_SAMPLES` beside the peer's own; none where the reference cannot tell that error from 0.

    noise: of the reference, as relMSE; the row's case says so where it is above a tenth of the error (design.md, section 6).
    """
    method = best_peer(points, layer)
    peer = next(p for p in points if p.method == method and p.amount == TARGET_SAMPLES)
    target, ours = peer.error(layer), [p for p in points if p.method == OURS.method]
    if target <= 0:
        return []
    time = time_to_error([p.time for p in ours], [p.error(layer) for p in ours], target)
    doubt = f" (noise of the reference: {noise:.1e})" if noise > target / 10 else ""
    row = {
        "suite": "time-to-error",
        "case": f"{scene}: seconds to the relMSE {target:.2e} of {layer}, of {method} at {TARGET_SAMPLES} samples{doubt}",
        "value": time.seconds,
        "unit": "s",
        "peer_value": peer.time,
        "ratio": peer.time / time.seconds,
        "scene": scene,
        "layer": layer,
        "relmse": target,
        "reference_noise": noise,
    }
    return [row | ({"bound": time.bound} if time.bound else {})]


def geometric_means(rows: list[dict]) -> list[dict]:
    """Of the ratios of `time-to-error`, one row a layer, which says how many scenes it is of."""
    means = []
    for layer in LAYERS:
        ratios = [row for row in rows if row["suite"] == "time-to-error" and row["layer"] == layer]
        if not ratios:
            continue
        scenes = {row["scene"] for row in rows if row["suite"] == "curves"}
        bounds = {OPPOSITE[row["bound"]] for row in ratios if "bound" in row}
        mean = {
            "suite": "time-to-error",
            "case": f"{layer}: geometric mean of the ratios of {len(ratios)} of {len(scenes)} scenes",
            "value": statistics.geometric_mean(row["ratio"] for row in ratios),
            "unit": "times as fast",
        }
        means.append(mean | ({"bound": bounds.pop() if len(bounds) == 1 else "uncertain"} if bounds else {}))
    return means


def fitting_samples(points: list[Point], budget: float) -> int:
    """Samples a pixel that Cycles takes in `budget` seconds, from those that its measured points took: a start and so much a sample."""
    samples, seconds = np.array([(p.amount, p.time) for p in points]).T
    if len(points) == 1:
        each, start = seconds[0] / samples[0], 0.0
    else:
        each, start = np.polyfit(samples, seconds, 1, w=1 / seconds)
    if each <= 0:  # a picture so small that the start is all
        return int(samples.max())
    return int(np.clip((budget - start) / each, 1, MOST_SAMPLES))


def fitting_peer(errors: dict[str, float], seconds: dict[str, float], budget: float) -> str:
    """The method with the least error of those that kept the budget about; the quickest where none did."""
    kept = [method for method, spent in seconds.items() if spent <= LATEST * budget]
    return min(kept, key=errors.__getitem__) if kept else min(seconds, key=seconds.__getitem__)


def _equal_time(folder, name: str, scene: bpy.types.Scene, truth: Truth, size, budget: float, points: list[Point], denoiser) -> list[dict]:
    """Rows of our picture and Cycles' at one time, and the picture of both beside the reference: a row of panels for each layer."""
    ours = contestants.ours(scene, size, replace(OURS, time_budget=budget))
    fitting = {method: fitting_samples([p for p in points if p.method == method], budget) for method in DENOISED_PEERS}
    runs = {method: render_cycles(scene, size, samples, 0, denoiser, (method,))[method] for method, samples in fitting.items()}
    errors = {method: truth.errors(run.layers, "Indirect")["relmse"] for method, run in runs.items()}
    method = fitting_peer(errors, {method: run.seconds for method, run in runs.items()}, budget)
    samples, cycles = fitting[method], runs[method]
    plain = re.sub(r"[^\w.-]+", "-", name)
    picture = folder / f"equal-time-{plain}-{budget:g}s.png"
    shown = [[layers[layer] for layers in (ours.layers, cycles.layers, truth.clean)] for layer in LAYERS]
    stops = auto_exposure([panels[-1] for panels in shown])
    write_png(picture, srgb(np.block([[[panel] for panel in panels] for panels in shown]) * np.float32(2.0**stops)))
    # Either may take longer than it should: the least picture of a scene has its time.
    spent = f"ours in {ours.seconds:.2g} s, {method} with {samples} samples in {cycles.seconds:.2g} s"
    rows = []
    for layer in LAYERS:
        value, peer = (truth.errors(run.layers, layer)["relmse"] for run in (ours, cycles))
        row = {
            "suite": "equal-time",
            "case": f"{name}: relMSE of {layer} at {budget:g} s ({spent})",
            "value": value,
            "unit": "1",
            "peer_value": peer,
            "scene": name,
            "layer": layer,
            "seconds": ours.seconds,
            "peer": method,
            "peer_seconds": cycles.seconds,
            "peer_samples": samples,
            "picture": picture.name,
        }
        rows.append(row | ({"ratio": peer / value} if min(peer, value) > 0 else {}))
    return rows


def _point_row(scene: str, size, truth: Truth, layer: str, point: Point) -> dict:
    return {
        "suite": "curves",
        "scene": scene,
        "layer": layer,
        "size": list(size),
        "method": point.method,
        "setting": point.setting,
        "peer": point.method in PEERS,
        "seconds": point.time,
        **{metric: point.error(layer, metric) for metric in METRICS},
        "invalid": max(errors["invalid"] for errors in point.errors[layer]),
        "reference_noise": truth.noise(layer),
        "runs": len(point.seconds),
    }


def _style(method: str) -> dict:
    """Of a line, told apart in grey too: Cycles dashed, with path guiding dotted, a mark for each way of denoising."""
    if method not in PEERS:
        return {"marker": "o", "linestyle": "-"}
    return {"marker": "sD^"[list(PEERS).index(method) % len(_WAYS)], "linestyle": ":" if PEERS[method].get("guiding") else "--"}


def plain_seconds(axes) -> None:
    """Figures like .5, 1, 2 at a logarithmic axis of seconds."""
    from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def plot(path: Path, layer: str, rows: list[dict]) -> None:
    """Seconds against relMSE of `layer`, both logarithmic: a panel a scene, a line a method; errors of 0 or less are left out."""
    from matplotlib.figure import Figure

    rows = [row for row in rows if row["suite"] == "curves" and row["layer"] == layer]
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    if not scenes:
        return
    columns = min(3, len(scenes))
    lines = math.ceil(len(scenes) / columns)
    figure = Figure(figsize=(4.5 * columns, 3.6 * lines), layout="constrained")
    for scene, axes in zip(scenes, figure.subplots(lines, columns, squeeze=False).flat):
        for method in dict.fromkeys(row["method"] for row in rows):
            curve = [(r["seconds"], r["relmse"]) for r in rows if (r["scene"], r["method"]) == (scene, method) and r["relmse"] > 0]
            axes.plot(*zip(*curve) if curve else ((), ()), label=method, **_style(method))
        axes.set(title=scene, xscale="log", yscale="log", xlabel="seconds", ylabel="relMSE, net of the reference's noise")
        plain_seconds(axes)
        axes.grid(alpha=0.3)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, fontsize="small", loc="outside lower center", ncols=min(len(labels), 2 * columns)
    )  # over no curve, whatever the scene
    for axes in figure.axes[len(scenes) :]:
        axes.set_axis_off()
    figure.suptitle(layer)
    write_whole(path, lambda partial: figure.savefig(partial, dpi=120))
