"""What one frame after the other renews a part of, while the light stands still: the probes of the cache of light, and the particles.

Each frame computes the part of its own turn, and takes those of the other turns from the frames before it.  After `turns` frames
nothing older is left, so that a frame depends on the last `turns` ones and on nothing before them.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..methods.exchange import Probes
from ..methods.probes import trace_probes
from ..threads import Progress
from ..transport import Transport
from ..view.points import ShadingPoints


@dataclass(frozen=True)
class _Part:
    number: int  # of the frame that traced it
    probes: Probes


class ProbeWindow:
    """Probes of the last frames, an equal part of each one's own view; to be cleared where the light changes.

    turns: frames until all are renewed.
    """

    def __init__(self, turns: int):
        self.turns = turns
        self.traced = 0  # parts in all
        self._parts: dict[tuple[int, int], _Part] = {}

    def clear(self) -> None:
        """Forget what was found in another light."""
        self._parts.clear()

    def trace(
        self, number: int, scene: Transport, points: ShadingPoints, paths: int, seed: int, threads: int, progress: Progress | None
    ) -> tuple[Probes, int]:
        """What `trace_probes` gives: probes along about `paths` paths, of which frame `number` traces those that no other one did."""
        rays = 0
        for turn in range(self.turns):
            part = self._parts.get((seed, turn))
            mine = turn == number % self.turns and (part is None or part.number != number)
            if mine or part is None or number - part.number >= self.turns:
                probes, more = trace_probes(scene, points, -(-paths // self.turns), seed + 15487469 * turn, threads, progress)
                self._parts[seed, turn] = _Part(number, probes)
                self.traced += 1
                rays += more
        return Probes.concatenate([self._parts[seed, turn].probes for turn in range(self.turns)]), rays
