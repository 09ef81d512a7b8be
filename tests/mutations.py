"""Do the tests notice?  Breaks a copy of the core on purpose, one line at a time, and counts the tests that fail.

    python tests/mutations.py [NAME ...]

A mutation that fewer than `ENOUGH` test functions catch ends the script with status 1.  The tests are small ones, in plain
Python (`plain.py`): nothing has to be compiled.  A few minutes, and not part of CI.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from plain import COVERAGE_CORE

ROOT = Path(__file__).resolve().parents[1]
ENOUGH = 3  # test functions that must fail
SECONDS = 600  # that no test needs: one that is cut off counts as failed
SMALL = (
    "test_small_kernels.py",
    "test_small_pictures.py::test_the_light_is_the_path_tracers",
    "test_small_pictures.py::test_a_pane_of_nothing_changes_nothing",
    "test_small_pictures.py::test_glossy_walls_lose_no_light",
    "test_kernel_properties.py::test_geometry_terms_are_those_of_float64_to_some_ulps",
    "test_kernel_properties.py::test_geometry_terms_are_the_same_from_either_end",
)


@dataclass(frozen=True)
class Mutation:
    """`before` in a file of the core becomes `after`, as often as it is there; tests: files, or tests of them, that should notice."""

    file: str
    before: str
    after: str
    tests: tuple[str, ...]


MUTATIONS = {
    "a wrong cosine": Mutation(
        "core/methods/instant_radiosity.py",
        "at_light = max(_0, -(nx * dx + ny * dy + nz * dz))",
        "at_light = abs(nx * dx + ny * dy + nz * dz) + np.float32(0.2)",
        SMALL,
    ),
    "a dropped 1/pi": Mutation(
        "core/methods/instant_radiosity.py",
        "_INV_PI = np.float32(1.0 / np.pi)",
        "_INV_PI = np.float32(1.0)",
        SMALL,
    ),
    "an off-by-one in the last packet": Mutation(
        "core/rays/scene.py",
        "count = min(pk.WIDTH, n - begin)",
        "count = min(pk.WIDTH, n - begin - 1)",
        ("test_rays_scene.py", "test_rays_agree.py"),
    ),
}


def mutate(folder: Path, mutation: Mutation) -> Path:
    """A copy of the package in `folder`, with one mutation."""
    package = folder / "lumigate"
    shutil.copytree(ROOT, package, ignore=shutil.ignore_patterns(".git", "__pycache__", ".venv", "docs"))
    file = package / mutation.file
    text = file.read_text(encoding="utf-8")
    if mutation.before not in text:
        raise SystemExit(f"{mutation.file} does not hold {mutation.before!r} any more: bring {Path(__file__).name} up to date")
    file.write_text(text.replace(mutation.before, mutation.after), encoding="utf-8")
    return package


def failing(mutation: Mutation) -> list[str]:
    """Test functions that fail on the mutated core, each once; a test file that cannot be imported is none."""
    with tempfile.TemporaryDirectory() as folder:
        package = mutate(Path(folder), mutation)
        environment = os.environ | {"PYTHONPATH": folder, "NUMBA_DISABLE_JIT": "1", "COVERAGE_CORE": COVERAGE_CORE}
        limits = ["--seconds", str(SECONDS), "--data", str(Path(folder) / "coverage")]
        command = [sys.executable, "tests/plain.py", *limits, *(f"tests/core/{name}" for name in mutation.tests)]
        result = subprocess.run(command, cwd=package, env=environment, capture_output=True, text=True, check=False)
    return sorted(set(re.findall(r"^FAILED \S+?::(\w+)", result.stdout, re.MULTILINE)))


def main(names: list[str]) -> int:
    """Print each mutation with the tests that caught it."""
    missed = 0
    for name in names or MUTATIONS:
        caught = failing(MUTATIONS[name])
        missed += len(caught) < ENOUGH
        print(f"{name}: caught by {len(caught)} tests: {', '.join(caught) or 'none'}", flush=True)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
