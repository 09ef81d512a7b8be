"""A benchmark in steps, each of which is kept when it is done: a run that was broken off goes on where it was."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .results import write_json

FOLDER = "steps"  # under the benchmark's own


@dataclass(frozen=True)
class Step:
    """One part of a suite: its name, unique in it, and what measures its rows."""

    name: str
    work: Callable[[], list[dict]]


def run_steps(
    steps: Sequence[Step], folder: Path, identity: dict, progress: Callable[[str, float], bool] | None = None, note: Callable = print
) -> list[dict]:
    """The rows of all steps, in order; those of a step that an earlier run in `folder` has finished are read from there.

    identity: what the rows depend on, as values of JSON: a step of another machine, version or request is measured again.
    progress: called with a step's name and the done fraction of all.  note: told of each step that was found.
    """
    rows = []
    for k, step in enumerate(steps):
        if progress is not None:
            progress(f"{step.name} ({k + 1} of {len(steps)})", k / len(steps))
        path = folder / FOLDER / f"{_plain(step.name)}.json"
        found = _kept(path, identity)
        if found is None:
            found = step.work()
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json(path, {"identity": identity, "step": step.name, "rows": found})
        else:
            note(f"{step.name}: kept from an earlier run ({path})")
        rows += found
    return rows


def _kept(path: Path, identity: dict) -> list[dict] | None:
    """Rows of a file of the same identity; None where there is none, or it cannot be read."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["identity"] == json.loads(json.dumps(identity)):
            return content["rows"]
    return None


def _plain(name: str) -> str:
    """A file's name: readable, and another one for each step."""
    return f"{re.sub(r'[^A-Za-z0-9.]+', '-', name).strip('-')}-{hashlib.sha256(name.encode()).hexdigest()[:6]}"
