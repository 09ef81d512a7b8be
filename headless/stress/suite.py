"""All stress cases in one table."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from ...core.stages import AVAILABLE
from ..bench_steps import Step
from . import broken, numbers, processes, scales
from .files import damaged_files
from .fuzz import SCENES, random_scenes
from .instances import instances
from .offsets import offsets
from .outcome import Outcome

# Generators of lines for one method, in the order of the table.
CASES: tuple[Callable[[str], Iterable[Outcome]], ...] = (
    scales.scales,
    scales.powers,
    scales.albedos,
    scales.spikes,
    scales.colours,
    broken.added,
    broken.meshes,
    broken.walls,
    broken.cracks,
    broken.places,
    numbers.invalid_numbers,
    numbers.counts,
    numbers.few,
    numbers.threads,
    numbers.million,
)


# Generators of lines about no method or all of them.
TOGETHER: tuple[Callable[[], Iterable[Outcome]], ...] = (
    offsets,
    instances,
    damaged_files,
    processes.signals,
    processes.compilers,
    processes.caches,
    processes.children,
    processes.limits,
)


def stress_steps(folder: Path, scenes: int = SCENES) -> list[Step]:
    """`bench stress`: a step for each kind of case by all methods, one for `scenes` random scenes; nothing is left in `folder`."""
    steps = [Step(case.__name__, partial(_rows, case, AVAILABLE)) for case in CASES]
    steps += [Step(case.__name__, partial(_rows, lambda _, case=case: case(), ("all",))) for case in TOGETHER]
    return [*steps, Step(f"{scenes} random scenes", partial(_rows, lambda _: random_scenes(scenes), ("all",)))]


def _rows(case: Callable[[str], Iterable[Outcome]], methods: Iterable[str]) -> list[dict]:
    return [line.row() for method in methods for line in attempt(case, method)]


def attempt(case: Callable[[str], Iterable[Outcome]], method: str) -> list[Outcome]:
    """The lines of one generator; a fault ends them with a line that names it."""
    lines = []
    try:
        lines.extend(case(method))
    except Exception as error:  # any fault is a finding
        name = getattr(case, "__name__", "case")
        lines.append(Outcome(f"{name}: {type(error).__name__}: {error}", method, "no fault", float("nan"), False))
    return lines
