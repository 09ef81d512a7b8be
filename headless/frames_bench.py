"""Flicker and cost of sequences: ours with history, our independent frames, and Cycles with Open Image Denoise at equal time a frame.

Temporal error of a sequence x against a reference r: the variance over time of x - r at a pixel, averaged over pixels and channels,
relative to the squared mean of r.  What an eye takes for flicker is in it; what is wrong all the time alike is not, and is told
apart as `error` (relMSE).  The reference is Cycles with many samples, each frame with a seed of its own; half of its noise variance,
from two halves, is taken off.

Rows: `frames`, cases MOVE/CONTESTANT/MEASURE, each with the contestant's figure and ours as the peer's, and the cost of a frame.
Row `Cycles + OIDN at our error`: the time a frame of Cycles with as many samples as give the sequence's relMSE, between those measured
on a few frames, evenly spread (`EQUAL_FRAMES`, `EQUAL_SAMPLES`), on logarithmic axes; beyond the last of them a bound.
Move `object` is another scene, and only its cost is measured (`moved_bench`).
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from time import process_time

import bpy
import numpy as np

from .. import sample_scenes
from ..core.denoise import Denoiser
from ..core.layers import Layers, auto_exposure, read_exr, srgb
from ..core.metrics import FLOOR
from ..core.settings import RenderSettings, SequenceSettings
from . import contestants
from .cache import cached_reference, scene_identity
from .console import Terminal
from .frames import View
from .moved_bench import moved_rows
from .reference import ReferenceSettings, render_layers
from .sequences import Shot, ShotRenderer

SIZE, FRAMES, REFERENCE_SAMPLES = (320, 180), 60, 512
LAYERS = ("Indirect", "Combined")
MOVES = ("camera", "lamp", "object")
MOST_SAMPLES = 512
EQUAL_FRAMES, EQUAL_SAMPLES = 6, (1, 4, 16, 64, 256)  # of relMSE, and of Cycles' curve of time against it
CLOSER = 10  # times as many samples has the reference of these frames: in noise, weights by its square overrate what is darker by chance


@dataclass
class Contestant:
    """Frames of one way to make a sequence, and what they cost."""

    name: str
    layers: list[dict[str, np.ndarray]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)

    def add(self, layers: Layers, seconds: float, cpu: float) -> None:
        """Note one frame."""
        self.layers.append({name: layers[name] for name in LAYERS})
        self.seconds.append(seconds)
        self.cpu.append(cpu)

    def stack(self, layer: str) -> np.ndarray:
        """(F, H, W, 3) float64."""
        return np.stack([frame[layer] for frame in self.layers]).astype(np.float64)


def animate(scene: bpy.types.Scene, move: str, frames: int) -> None:
    """Keys for a slow move of the camera, or of the sun, over so many frames."""
    moved = scene.camera if move == "camera" else next(ob for ob in scene.objects if ob.type == "LIGHT")
    path = "location" if move == "camera" else "rotation_euler"
    moved.keyframe_insert(path, frame=1)
    if move == "camera":
        moved.location.x += 0.03 * frames
    else:
        moved.rotation_euler.z += 0.01 * frames
    moved.keyframe_insert(path, frame=max(frames, 2))


def temporal_error(test: np.ndarray, halves: tuple[np.ndarray, np.ndarray]) -> float:
    """Variance over time of the difference to a reference, (F, H, W, 3) each, relative to its squared mean."""
    reference = 0.5 * (halves[0] + halves[1])
    own = 0.25 * np.var(halves[0] - halves[1], axis=0).mean()
    return float((np.var(test - reference, axis=0).mean() - own) / reference.mean() ** 2)


def error(test: np.ndarray, halves: tuple[np.ndarray, np.ndarray]) -> float:
    """relMSE over all frames, net of the reference's noise; what it is relative to is denoised, or dark pixels of it would rule."""
    reference = 0.5 * (halves[0] + halves[1])
    product = (test - halves[0]) * (test - halves[1])
    with closing(Denoiser()) as denoiser:
        clean = np.stack([denoiser.denoise(frame.astype(np.float32)) for frame in reference])
    return float((product / (clean**2 + FLOOR * reference.mean() ** 2)).mean())


def frames_rows(
    folder: Path,
    size: tuple[int, int] = SIZE,
    frames: int = FRAMES,
    reference_samples: int = REFERENCE_SAMPLES,
    moves: Sequence[str] = MOVES,
    scene: str = "atrium",
) -> list[dict]:
    """Rows of all moves; an animated picture of each (ours beside independent frames and Cycles) goes into `folder`."""
    rows = moved_rows(size) if "object" in moves else []
    for move in (move for move in moves if move != "object"):
        built = sample_scenes.build(scene)
        animate(built, move, frames)
        with closing(Denoiser()) as denoiser:
            identity = scene_identity(scene) | {"move": move, "frames": frames}
            halves = _halves(built, identity, size, range(1, frames + 1), reference_samples, frames)
            close = _halves(built, identity, size, _picked(frames), CLOSER * reference_samples, frames)
            alone = _ours(built, size, frames, SequenceSettings(history=0), "independent")
            ours = _ours(built, size, frames, SequenceSettings(), "sequence")
            peers = [_equal_time(built, size, frames, ours, denoiser, animated) for animated in (False, True)]
            curve = _curve(built, size, frames, close, denoiser)
        rows += _rows(move, ours, [alone, *peers], halves, close)
        rows += _equal_error(move, ours, close, curve)
        write_animation(folder / f"frames-{move}.webp", [peers[0], alone, ours])
    return rows


def _ours(scene: bpy.types.Scene, size, frames: int, shared: SequenceSettings, name: str) -> Contestant:
    found = Contestant(name)
    shot = Shot(range(1, frames + 1), View(size=size), RenderSettings(), shared)
    with ShotRenderer(scene, shot, Terminal.silent()) as renderer:
        for number in shot.frames:
            if not shared.history:
                renderer.close()  # nothing is kept
            begin = process_time()
            frame = renderer.frame(number)
            found.add(frame.layers, frame.stats["seconds_total"], process_time() - begin)
    return found


def _cycles(scene, size, frames: int | Sequence[int], samples: int, seed: Callable[[int], int], denoiser: Denoiser) -> Contestant:
    found = Contestant("cycles+oidn")
    scene.render.use_persistent_data = True  # the faster way to a sequence, and to the same pictures
    request = ReferenceSettings(spp=samples, size=size, denoise=True)
    for number in range(1, frames + 1) if isinstance(frames, int) else frames:
        begin = process_time()
        layers, stats = render_layers(scene, replace(request, frame=number, seed=seed(number)), denoiser=denoiser)
        found.add(layers, stats["seconds_total"], process_time() - begin)
    return found


def _halves(scene, identity: dict, size, frames: Sequence[int], samples: int, apart: int) -> list[Contestant]:
    """The reference of these frames, twice, each frame with a seed of its own; those that are in the cache are not rendered again."""
    scene.render.use_persistent_data = True
    halves = []
    for k in range(2):
        halves.append(Contestant("reference"))
        for frame in frames:
            file = cached_reference(scene, identity, spp=samples, size=size, frame=frame, seed=7919 * (frame + apart * k))
            halves[-1].add(read_exr(file), 0.0, 0.0)
    return halves


def _equal_time(scene, size, frames: int, ours: Contestant, denoiser: Denoiser, animated: bool) -> Contestant:
    """Cycles with as many samples as fit in our time a frame, its seed the same for all frames or not."""
    wanted = statistics.median(ours.seconds)
    few, many = (contestants.cycles(scene, ReferenceSettings(spp=n, size=size, denoise=True), denoiser).seconds for n in (4, 36))
    a_sample = max((many - few) / 32, 1e-6)
    samples = int(np.clip(round(4 + (wanted - few) / a_sample), 1, MOST_SAMPLES))
    found = _cycles(scene, size, frames, samples, (lambda f: 104729 * f) if animated else (lambda f: 1), denoiser)
    found.name += f", {samples} spp, {'a seed a frame' if animated else 'one seed'}"
    return found


def _picked(frames: int) -> list[int]:
    """Numbers of the frames that Cycles' curve is measured on."""
    return sorted({round(k) for k in np.linspace(1, frames, min(frames, EQUAL_FRAMES))})


def _of_picked(one: Contestant, layer: str = "Indirect") -> np.ndarray:
    """One of its layers in those frames."""
    return one.stack(layer)[np.array(_picked(len(one.layers))) - 1]


def _pair(halves: list[Contestant], layer: str = "Indirect") -> tuple[np.ndarray, np.ndarray]:
    return tuple(half.stack(layer) for half in halves)


def _curve(scene, size, frames: int, close: list[Contestant], denoiser: Denoiser) -> list[tuple[float, float]]:
    """Seconds a frame and relMSE of the indirect light of Cycles + OIDN, by growing samples."""
    picked, pair = _picked(frames), _pair(close)
    found = [_cycles(scene, size, picked, samples, lambda f: 104729 * f, denoiser) for samples in EQUAL_SAMPLES]
    return [(statistics.median(one.seconds), error(one.stack("Indirect"), pair)) for one in found]


def seconds_at(curve: list[tuple[float, float]], wanted: float) -> tuple[float, str]:
    """Seconds at which a curve of (seconds, error) reaches an error, and '<' or '>' where it lies beyond its ends."""
    for (before, worse), (after, better) in pairwise(curve):
        if worse > wanted >= better:
            share = np.log(worse / wanted) / np.log(worse / max(better, 1e-12))
            return float(before * (after / before) ** share), ""
    return (curve[0][0], "<") if wanted >= curve[0][1] else (curve[-1][0], ">")


def _equal_error(move: str, ours: Contestant, close: list[Contestant], curve: list[tuple[float, float]]) -> list[dict]:
    """What a frame costs in Cycles at the sequence's error, and the points of its curve."""
    mine = statistics.median(ours.seconds[1:] or ours.seconds)
    wanted = error(_of_picked(ours), _pair(close))
    seconds, bound = seconds_at(curve, wanted)
    row = {"case": f"{move}, Cycles + OIDN at our error: time a frame", "value": seconds, "unit": "s", "peer_value": mine}
    rows = [row | {"ratio": mine / seconds, "bound": bound}]
    for samples, (time, found) in zip(EQUAL_SAMPLES, curve):
        case = f"{move}, Cycles + OIDN, {samples} spp, {time:.3g} s a frame: relMSE of Indirect"
        rows.append({"case": case, "value": found, "unit": "", "peer_value": wanted, "ratio": wanted / found})
    return [{"suite": "frames", **row} for row in rows]


def _rows(move: str, ours: Contestant, others: list[Contestant], halves: list[Contestant], close: list[Contestant]) -> list[dict]:
    rows = []
    for contestant in (ours, *others):
        for name, seconds in (("time", contestant.seconds), ("CPU time", contestant.cpu)):
            mine = statistics.median((ours.seconds if name == "time" else ours.cpu)[1:] or [0.0])
            value = statistics.median(seconds[1:] or seconds)
            case = f"{move}, {contestant.name}: {name} a frame"
            rows.append({"suite": "frames", "case": case, "value": value, "unit": "s", "peer_value": mine, "ratio": mine / value})
        for layer in LAYERS:
            whole, few = _pair(halves, layer), _pair(close, layer)
            for name, measure in (
                ("temporal error", lambda one, layer=layer, whole=whole: temporal_error(one.stack(layer), whole)),
                ("relMSE", lambda one, layer=layer, few=few: error(_of_picked(one, layer), few)),
            ):
                value, mine = measure(contestant), measure(ours)
                case = f"{move}, {contestant.name}: {name} of {layer}"
                rows.append({"suite": "frames", "case": case, "value": value, "unit": "", "peer_value": mine, "ratio": mine / value})
    return rows


def write_animation(path: Path, shown: list[Contestant], most: int = 24, width: int = 200) -> None:
    """The contestants' indirect light side by side, as an animated WebP of every so-manyth frame; nothing without Pillow."""
    try:
        from PIL import Image
    except ImportError:
        return
    every = max(1, len(shown[0].layers) // most)
    exposure = np.float32(2.0 ** auto_exposure([shown[-1].layers[0]["Indirect"]]))
    pictures = []
    for k in range(0, len(shown[0].layers), every):
        row = np.concatenate([srgb(one.layers[k]["Indirect"] * exposure) for one in shown], axis=1)
        image = Image.fromarray(np.round(255 * row).astype(np.uint8))
        scale = min(1.0, width * len(shown) / image.width)
        pictures.append(image.resize((round(image.width * scale), round(image.height * scale))))
    path.parent.mkdir(parents=True, exist_ok=True)
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=83, loop=0, quality=70)
