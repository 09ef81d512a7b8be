"""All stress cases in one table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ...core.pipeline import AVAILABLE
from . import broken, numbers, scales
from .files import damaged_files
from .fuzz import SCENES, random_scenes
from .offsets import offsets
from .outcome import Outcome

# Generators of lines for one method, in the order of the table.
CASES: tuple[Callable[[str], Iterator[Outcome]], ...] = (
    scales.scales,
    scales.powers,
    scales.albedos,
    scales.spikes,
    scales.colours,
    broken.added,
    broken.meshes,
    broken.walls,
    broken.places,
    numbers.invalid_numbers,
    numbers.counts,
    numbers.few,
    numbers.threads,
    numbers.million,
)


def stress_rows(scenes: int = SCENES) -> list[dict]:
    """Rows of `bench stress`: every case by every method, then `scenes` random scenes; one that raises is a line that fails."""
    lines = [line for case in CASES for method in AVAILABLE for line in attempt(case, method)]
    lines += attempt(lambda _: offsets(), "all")
    lines += attempt(lambda _: damaged_files(), "all")
    lines += random_scenes(scenes)
    return [line.row() for line in lines]


def attempt(case: Callable[[str], Iterator[Outcome]], method: str) -> list[Outcome]:
    """The lines of one generator; a fault ends them with a line that names it."""
    lines = []
    try:
        lines.extend(case(method))
    except Exception as error:  # any fault is a finding
        name = getattr(case, "__name__", "case")
        lines.append(Outcome(f"{name}: {type(error).__name__}: {error}", method, "no fault", float("nan"), False))
    return lines
