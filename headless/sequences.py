"""The frames of a sequence in one process, each with what the frames before it left (core.reuse)."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter

import bpy

from ..core.jit import CompileTimer
from ..core.pipeline import remember, render, scout
from ..core.reuse import Sequence as Reuse
from ..core.scene import Scene
from ..core.settings import RenderSettings, SequenceSettings
from .console import Terminal
from .frames import TOPOLOGIES, Frame, View
from .motion import exposures, moving_objects, only_cameras_and_lamps_move


@dataclass(frozen=True)
class Shot:
    """All frames of a sequence.

    frames: their numbers, in order.
    """

    frames: range
    view: View = field(default_factory=View)
    settings: RenderSettings = field(default_factory=RenderSettings)
    sequence: SequenceSettings = field(default_factory=SequenceSettings)


class ShotRenderer:
    """Renders frames of a shot, in any order, with the same bits as all of them in order.

    A frame needs what the `history` exposures before it found; those that were not computed just before are computed now, without a
    picture.  Their caches of light in turn need the probes of as many before them, which cost little.  Frames in order therefore
    cost the least.

    terminal: who is shown how far it is; may be another one for later frames.
    """

    def __init__(self, scene: bpy.types.Scene, shot: Shot, terminal: Terminal):
        self.scene, self.shot, self.terminal = scene, shot, terminal
        self._settings = shot.sequence.frame(shot.settings)
        self._moving = moving_objects(scene)
        self._still = only_cameras_and_lamps_move(scene)
        self._last: Scene | None = None  # arrays, where they are good for other frames
        self._reuse: Reuse | None = None
        self._next = 0  # exposure that would follow without a gap

    def __enter__(self) -> ShotRenderer:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """Release what is kept."""
        if self._reuse is not None:
            self._reuse.close()
        self._reuse = self._last = None

    def frame(self, number: int) -> Frame:
        """The frame of this number; raises what `pipeline.render` does."""
        count = self.shot.sequence.motion_blur
        begin = self.shot.frames.index(number) * count
        first = max(0, begin - self.shot.sequence.history)
        if self._reuse is None or not first <= self._next <= begin:
            self.close()
            self._reuse = Reuse(self.shot.sequence, moving=self._moving)
            for exposure in range(max(0, first - self.shot.sequence.history), first):
                self._scout(exposure)
            self._next = first
        for exposure in range(self._next, begin + count - 1):
            self._remember(exposure, exposed=exposure >= begin)
        return self._rendered(number, begin + count - 1)

    def _arrays(self, exposure: int) -> tuple[Scene, float]:
        """The scene at an exposure, begun, and the seconds that it took."""
        count = self.shot.sequence.motion_blur
        time = exposures(self.scene, self.shot.frames[exposure // count], count)[exposure % count]
        with CompileTimer() as compiling:
            begin = perf_counter()
            arrays = self.shot.view.extract(self.scene, time, self._last)
            self._last = arrays if self._still else None
            arrays = self._reuse.begin(arrays, exposure)
            seconds = perf_counter() - begin
        self._next = exposure + 1
        return arrays, seconds - compiling.seconds

    def _scout(self, exposure: int) -> None:
        arrays, _ = self._arrays(exposure)
        with self.terminal.progress() as progress:
            scout(arrays, self._settings, self._reuse, progress, topologies=TOPOLOGIES)

    def _remember(self, exposure: int, *, exposed: bool) -> None:
        arrays, _ = self._arrays(exposure)
        with self.terminal.progress() as progress:
            remember(arrays, self._settings, self._reuse, progress, exposed=exposed, topologies=TOPOLOGIES)

    def _rendered(self, number: int, exposure: int) -> Frame:
        arrays, seconds = self._arrays(exposure)
        with self.terminal.progress() as progress:
            result = render(arrays, self._settings, progress, extraction_seconds=seconds, topologies=TOPOLOGIES, sequence=self._reuse)
        result.stats["frame"] = number
        return Frame(arrays, result.layers, result.stats)
