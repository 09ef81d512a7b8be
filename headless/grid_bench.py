"""`auto` against the best single setting of any method that a search over a grid finds: seconds to an error of `Indirect`.

For a scene and a target relMSE, `auto --target-error` takes turns with the settings of `GRID`, and the medians of several seeds count.  A setting
reaches a target where its true error, net of the reference's noise, is no larger; the best is the quickest of these, as it was measured: nothing is
interpolated.  `auto` is held against it where it ends within `WITHIN` times its target.

The grid is a ladder a method, from the least numbers up.  What is left out cannot win, and a row says why (`climb`): all further rungs take
longer, and the last one was too slow already, or reaches all targets; or is so far from the largest target that no more samples reach it.
After the first turn only those settings take part that may still be the best of a target (`may_win`).

Rows of four suites: `grid` (what was measured), `grid-skipped`, `auto-to-best` (a scene and a target each; `unseen` where the tuning of `auto` never
saw the scene) and `grid-verdict` (median and worst of their ratios).
"""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import zip_longest
from pathlib import Path

from .. import sample_scenes
from ..core.denoise import Denoiser
from ..core.errors import SceneError
from ..core.settings import RenderSettings
from . import contestants
from .bench_steps import Step
from .curves_bench import METRICS, OURS, QUALITIES, REFERENCE_SAMPLES, REPEATS, SCENES, SHARED, SIZE, reference_truth
from .sources import find_scene, open_source

LAYER = "Indirect"
TARGETS = (0.05, 0.02, 0.01)
WITHIN = 1.5  # times its target, within which auto's own word is taken to have been kept
NEAR = 1.25  # times a target: a setting whose one run ends there may reach it in the median
SLACK = 1.5  # times the best's seconds: a setting whose one run took longer is not the quickest in the median
# Most by which relMSE falls from a rung to the next: the ladders' numbers grow by 4, squared errors of quasi-random samples with the power of 1.5.
STEEPEST = 8.0
MOST_MEDIAN, MOST_WORST = 1.3, 2.0  # of auto's seconds by the best's: what is aimed at
KERNELS = (64, 36)  # pixels of the renders that load each method's kernels
# How the two shares of a report are called.
SEEN = {True: "unseen", False: "seen"}


@dataclass(frozen=True)
class Setting:
    """One rung of a method's ladder."""

    method: str
    name: str
    settings: RenderSettings


def _rung(method: str, name: str, view: Sequence[int], **numbers) -> Setting:
    """view: pixel samples, shadow rays for direct light, rays of lobes."""
    view = dict(zip(("pixel_samples", "direct_samples", "reflections"), view))
    return Setting(method, name, RenderSettings(method=method, denoise=True, **view, **numbers).with_defaults())


LITTLE, USUAL, MUCH = (9, 2, 1), (16, 8, 4), (16, 16, 8)
GRID = (
    tuple(Setting(OURS.method, f"quality {quality:g}", OURS.scaled(quality, 0)) for quality in QUALITIES),
    (
        _rung("fuzzy-clustering", "1024 VPLs, 250 x 2000 clusters", LITTLE, vpls=1024, vpl_clusters=250, point_clusters=2000),
        _rung("fuzzy-clustering", "4096 VPLs, 1000 x 8000 clusters", USUAL, vpls=4096, vpl_clusters=1000, point_clusters=8000),
        _rung("fuzzy-clustering", "16384 VPLs, 4000 x 32000 clusters", MUCH, vpls=16384, vpl_clusters=4000, point_clusters=32000),
    ),
    (
        _rung("virtual-area-lights", "1024 VPLs, 8 x 8 pixels share them", LITTLE, vpls=1024, interleave=8),
        _rung("virtual-area-lights", "4096 VPLs, 8 x 8 pixels share them", USUAL, vpls=4096, interleave=8),
        _rung("virtual-area-lights", "4096 VPLs, 4 x 4 pixels share them", MUCH, vpls=4096, interleave=4),
    ),
    (
        _rung("visibility-gates", "1024 VPLs, 64 voxels", LITTLE, vpls=1024, voxels=64),
        _rung("visibility-gates", "4096 VPLs, 128 voxels", USUAL, vpls=4096, voxels=128),
        _rung("visibility-gates", "16384 VPLs, 256 voxels", MUCH, vpls=16384, voxels=256),
    ),
    (
        _rung("instant-radiosity", "256 VPLs", LITTLE, vpls=256),
        _rung("instant-radiosity", "1024 VPLs", USUAL, vpls=1024),
        _rung("instant-radiosity", "4096 VPLs", MUCH, vpls=4096),
    ),
)


@dataclass
class Candidate:
    """A setting, seconds of its runs, and their errors of `LAYER`."""

    setting: Setting
    seconds: list[float] = field(default_factory=list)
    errors: list[dict] = field(default_factory=list)

    @property
    def time(self) -> float:
        """Median seconds."""
        return statistics.median(self.seconds)

    @property
    def error(self) -> float:
        """Median relMSE, net of the reference's noise."""
        return self.figure("relmse")

    @property
    def title(self) -> str:
        """Method and setting."""
        return f"{self.setting.method}, {self.setting.name}"

    def figure(self, metric: str) -> float | None:
        """Median of a metric; None where a run has none (FLIP without its package)."""
        values = [errors[metric] for errors in self.errors]
        return None if None in values else statistics.median(values)


@dataclass(frozen=True)
class Noise:
    """Of the reference, as relMSE, and the standard deviation that it leaves in errors net of it: the same for all settings of a scene."""

    whole: float
    doubt: float

    def row(self) -> dict:
        """The fields of a row."""
        return {"reference_noise": self.whole, "reference_doubt": self.doubt}


Measure = Callable[[Candidate], None]  # one more run


def best(candidates: Sequence[Candidate], target: float) -> Candidate | None:
    """The quickest of those that reach a target; None where none does."""
    return min((c for c in candidates if c.error <= target), key=lambda c: c.time, default=None)


def best_seconds(candidates: Sequence[Candidate], target: float) -> float:
    """Seconds of the best, infinity where there is none."""
    found = best(candidates, target)
    return float("inf") if found is None else found.time


def may_win(candidate: Candidate, candidates: Sequence[Candidate], target: float) -> bool:
    """Whether more runs may show a setting to be the best of a target: it is near it, and about as quick as the best so far."""
    return candidate.error <= NEAR * target and candidate.time <= SLACK * best_seconds(candidates, target)


def none_above(last: Candidate, rungs: int, candidates: Sequence[Candidate], targets: Sequence[float]) -> str | None:
    """Why none of the `rungs` above the last one measured, which all take longer, can be the best of any target; None where one may.

    candidates: all that were measured so far, of other methods, too.
    """
    # Of one run each: only those count that will reach the target in the median, too.
    slowest = max(best_seconds(candidates, target / NEAR) for target in targets)
    if last.error <= min(targets) / NEAR:
        return f"reaches relMSE {min(targets):g} already ({last.error:.2g})"
    if last.time > SLACK * slowest:
        return f"takes {last.time:.2g} s, each target is reached in {slowest:.2g} s"
    if last.error > max(targets) * STEEPEST**rungs:
        return f"ends at relMSE {last.error:.2g}, too far from {max(targets):g}"
    return None


def climb(ladder: Sequence[Setting], candidates: list[Candidate], targets: Sequence[float], measure: Measure) -> str | None:
    """Measure one run of each rung that may be the best of a target, from the least up, and add them to `candidates`.

    Returns why the rest was left out, None where nothing was.
    """
    for k, setting in enumerate(ladder):
        candidate = Candidate(setting)
        measure(candidate)
        candidates.append(candidate)
        left = len(ladder) - k - 1
        reason = none_above(candidate, left, candidates, targets) if left else None
        if reason is not None:
            return f"{candidate.title} {reason}; left out: {', '.join(rung.name for rung in ladder[k + 1 :])}"
    return None


def repeat(autos: Sequence[Candidate], candidates: Sequence[Candidate], targets: Sequence[float], repeats: int, measure: Measure) -> None:
    """Turns of all that may still win, and of `auto` where there may be a ratio to tell, until each of them has `repeats` runs.

    autos: one for each target.  A long render towards a target that neither reaches tells nothing more when it is made again.
    """
    while True:
        close = [c for c in candidates if any(may_win(c, candidates, target) for target in targets)]
        few = [
            auto
            for auto, target in zip(autos, targets)
            if len(auto.seconds) < repeats and auto.error <= NEAR * WITHIN * target and any(may_win(c, candidates, target) for c in close)
        ]
        close = [c for c in close if len(c.seconds) < repeats]
        if not few and not close:
            return
        for pair in zip_longest(few, close):
            for candidate in pair:
                if candidate is not None:
                    measure(candidate)


def grid_steps(
    scenes: Sequence[str] | None = None,
    size: tuple[int, int] = SIZE,
    targets: Sequence[float] = TARGETS,
    reference_samples: int = REFERENCE_SAMPLES,
    repeats: int = REPEATS,
    grid: Sequence[Sequence[Setting]] = GRID,
) -> list[Step]:
    """A step for each scene.

    scenes: as `sources.find_scene` takes them, each with a size of its own where `@WxH` follows; None is the sample scenes and those shared ones
        that are there.
    Raises SceneError where a scene that is asked for is not there.
    """
    steps = []
    for text in scenes or (*SCENES, *SHARED):
        name, own = sized(text, size)
        source = find_scene(name)
        if source is not None:
            steps.append(Step(f"grid {text}", partial(_scene_rows, name, source, own, targets, reference_samples, repeats, grid)))
        elif scenes:
            raise SceneError(f"there is no scene {name!r}; name a file, a sample scene or a scene in the folder LUMIGATE_SCENES")
    return steps


def sized(text: str, size: tuple[int, int]) -> tuple[str, tuple[int, int]]:
    """A scene and its size of SCENE or SCENE@WxH."""
    match = re.fullmatch(r"(.+)@([1-9]\d*)x([1-9]\d*)", text)
    return (match[1], (int(match[2]), int(match[3]))) if match else (text, size)


def is_unseen(source: str) -> bool:
    """Whether a scene is none of those by which `auto` was tuned: the sample scenes and the shared ones.  source: as of `find_scene`."""
    shared = {Path(found).resolve() for name in SHARED if (found := find_scene(name)) is not None}
    return source not in sample_scenes.NAMES and Path(source).resolve() not in shared


def _label(name: str) -> str:
    """A scene's name in a table: of a file that without folder and suffix."""
    path = Path(name)
    return name if not path.suffix else path.parent.name if path.stem == "scene" else path.stem


def _scene_rows(
    name: str, source: str, size, targets, reference_samples: int, repeats: int, grid: Sequence[Sequence[Setting]]
) -> list[dict]:
    scene = open_source(source)
    with closing(Denoiser()) as denoiser:
        truth = reference_truth(scene, source, size, reference_samples, denoiser)
    # Loads the kernels.
    for ladder in grid:
        contestants.ours(scene, KERNELS, ladder[0].settings)
    contestants.ours(scene, size, RenderSettings(target_error=max(targets)))

    def measure(candidate: Candidate) -> None:
        run = contestants.ours(scene, size, replace(candidate.setting.settings, seed=len(candidate.seconds)))
        candidate.seconds.append(run.seconds)
        candidate.errors.append(truth.errors(run.layers, LAYER))

    autos = [Candidate(Setting("auto", f"target {target:g}", RenderSettings(target_error=target))) for target in targets]
    candidates: list[Candidate] = []
    skipped = []
    # The first turn: auto's targets among the ladders.
    for ladder, auto in zip_longest(grid, autos):
        if auto is not None:
            measure(auto)
        if ladder is not None:
            skipped.append(climb(ladder, candidates, targets, measure))
    repeat(autos, candidates, targets, repeats, measure)
    label, noise = _label(name), Noise(truth.noise(LAYER), truth.doubt(LAYER))
    rows = [_point_row(label, size, candidate, noise) for candidate in (*autos, *candidates)]
    rows += [
        {"suite": "grid-skipped", "case": f"{label}: {reason}", "value": None, "unit": "", "scene": label} for reason in skipped if reason
    ]
    least = [ladder[0] for ladder in grid]
    return rows + [ratio_row(label, is_unseen(source), *goal, candidates, least, noise) for goal in zip(targets, autos)]


def _point_row(scene: str, size, candidate: Candidate, noise: Noise) -> dict:
    return {
        "suite": "grid",
        "scene": scene,
        "layer": LAYER,
        "size": list(size),
        "method": candidate.setting.method,
        "setting": candidate.setting.name,
        "peer": False,
        "seconds": candidate.time,
        **{metric: candidate.figure(metric) for metric in METRICS},
        "invalid": max(errors["invalid"] for errors in candidate.errors),
        "runs": len(candidate.seconds),
        **noise.row(),
    }


def ratio_row(
    scene: str, unseen: bool, target: float, auto: Candidate, candidates: Sequence[Candidate], least: Sequence[Setting], noise: Noise
) -> dict:
    """Seconds of `auto` by those of the best setting of a target, if there is one, and `auto` ends near enough to it.

    least: first rungs of the ladders: where one of them is the best, less might have done.  noise: said where its doubt is above a tenth of the
    target.
    """
    found, kept = best(candidates, target), auto.error <= WITHIN * target
    notes = [f"auto ends at {auto.error:.2g}" + ("" if kept else f", more than {WITHIN:g} times that")]
    row = {"suite": "auto-to-best", "case": "", "value": auto.time, "unit": "s", "scene": scene, "unseen": SEEN[unseen], "target": target}
    row |= {"relmse": auto.error, "kept": kept, **noise.row()}
    if found is None:
        closest = min(candidates, key=lambda candidate: candidate.error)
        notes.append(f"no setting reaches it ({closest.title}: {closest.error:.2g} in {closest.time:.2g} s)")
    else:
        notes.append(f"best: {found.title}, {found.error:.2g}" + (", the least of its numbers" if found.setting in least else ""))
        row |= {"peer_value": found.time, "setting": found.title, "setting_relmse": found.error, "least": found.setting in least}
        row |= {"ratio": auto.time / found.time} if kept else {}
    if noise.doubt > target / 10:
        notes.append(f"all errors here +- {noise.doubt:.1g} by the noise of the reference")
    return row | {"case": f"{scene} ({SEEN[unseen]}), relMSE {target:g}: {'; '.join(notes)}"}


def grid_summary(rows: Sequence[dict]) -> list[dict]:
    """Median and worst of auto's seconds by the best's, and how often it is too far from its target, of all scenes and of either share."""
    rows = [row for row in rows if row["suite"] == "auto-to-best"]
    found = []
    for name in ("all", *SEEN.values()):
        own = [row for row in rows if name in ("all", row["unseen"])]
        ratios = [row["ratio"] for row in own if "ratio" in row]
        held = [row for row in own if "peer_value" in row]
        if not held:
            continue
        count = f"{name}: {len({row['scene'] for row in own})} scenes"
        if ratios:
            found.append(_verdict(f"{count}, median of {len(ratios)} ratios", statistics.median(ratios), MOST_MEDIAN))
            found.append(_verdict(f"{count}, worst of {len(ratios)} ratios", max(ratios), MOST_WORST))
        lost = sum(not row["kept"] for row in held)
        found.append(_verdict(f"{count}, targets that a setting reaches and auto misses by {WITHIN:g}, of {len(held)}", lost, 0))
    return found


def _verdict(case: str, value: float, most: float) -> dict:
    return {"suite": "grid-verdict", "case": case, "method": "auto", "must": f"at most {most:g}", "value": value, "pass": value <= most}
