"""What the user reads: results on stdout, progress on stderr, and none of Blender's own chatter.

Blender prints from C to file descriptor 1 ("Read blend", "Fra:1 Mem..."), past `sys.stdout`.  So the
real stdout is kept aside on a descriptor of its own while descriptor 1 leads nowhere.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from .interrupts import Interrupts

_PIPE_WIDTH = 200  # columns of a table where no terminal says how many there are


@contextmanager
def _private(stream: TextIO, descriptor: int) -> Iterator[TextIO]:
    """`stream`'s real target on a descriptor that Blender does not know; a replaced stream (a test's, a GUI's) is itself."""
    stream.flush()
    try:
        leads_there = stream.fileno() == descriptor
    except (OSError, ValueError, AttributeError):
        leads_there = False
    if not leads_there:
        yield stream
        return
    with open(os.dup(descriptor), "w", encoding=stream.encoding or "utf-8", errors="replace", buffering=1) as private:
        yield private


@contextmanager
def _leading_nowhere(descriptor: int) -> Iterator[None]:
    """Output of C code on `descriptor` is dropped inside the block."""
    kept = os.dup(descriptor)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, descriptor)
        yield
    finally:
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nowhere)


class Terminal:
    """The user's two streams: `out` for results, `err` for progress and messages; both are rich consoles."""

    def __init__(self, out: TextIO, err: TextIO, interrupts: Interrupts | None = None):
        self.interrupts = interrupts or Interrupts()
        self.out, self.err = (
            Console(file=stream, highlight=False, width=None if stream.isatty() else _PIPE_WIDTH) for stream in (out, err)
        )

    @staticmethod
    def silent() -> Terminal:
        """One that nobody reads."""
        return Terminal(io.StringIO(), io.StringIO())

    def warn(self, message: str) -> None:
        """One line on stderr about something that will look wrong."""
        self.say(f"lumigate: warning: {message}")

    def say(self, message: str) -> None:
        """One line on stderr, however long."""
        self.err.print(one_line(message), markup=False, soft_wrap=True)

    @contextmanager
    def progress(self) -> Iterator[ProgressBar]:
        """A bar with stage and time left, on a terminal only; hand it to the pipeline."""
        columns = (
            TextColumn("{task.description:<24}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=self.err, transient=True, disable=not self.err.is_terminal) as bars:
            yield ProgressBar(bars, self.interrupts)

    @contextmanager
    def waiting(self, stage: str) -> Iterator[None]:
        """A spinner, on a terminal only, for work that cannot say how far it is."""
        with Progress(
            SpinnerColumn(), TextColumn(stage), TimeElapsedColumn(), console=self.err, transient=True, disable=not self.err.is_terminal
        ) as bars:
            bars.add_task(stage, total=None)
            yield


class ProgressBar:
    """Shows one stage at a time; called by the pipeline as progress(stage, fraction)."""

    def __init__(self, bars: Progress, interrupts: Interrupts):
        self._bars = bars
        self._interrupts = interrupts
        self._task = bars.add_task("", total=1.0)
        self._stage = ""

    def __call__(self, stage: str, fraction: float) -> bool:
        """Show `fraction` (0..1) of `stage`; False where Ctrl-C was heard."""
        if stage != self._stage:
            self._stage = stage
            self._bars.reset(self._task, total=1.0, description=stage)
        self._bars.update(self._task, completed=fraction)
        return not self._interrupts.heard


@contextmanager
def open_terminal(interrupts: Interrupts) -> Iterator[Terminal]:
    """The user's terminal, with Blender's stdout silenced while it is open; its progress asks `interrupts`."""
    with _private(sys.stdout, 1) as out, _private(sys.stderr, 2) as err, _leading_nowhere(1):
        yield Terminal(out, err, interrupts)


@contextmanager
def quiet() -> Iterator[None]:
    """Nothing of what Blender and its importers print inside the block is seen; errors still arrive as exceptions."""
    with open(os.devnull, "w") as nowhere, _leading_nowhere(2), redirect_stdout(nowhere), redirect_stderr(nowhere):
        yield


def one_line(message: object) -> str:
    """`message` without line breaks."""
    return " ".join(str(message).split())
