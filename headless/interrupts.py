"""Ctrl-C and a render farm's kill, heard whenever they come.

An exception alone is not enough: raised while Blender or a library's callback runs, it is printed and forgotten.  So it is also
written down, and whoever reports progress asks for it.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Whether the user has asked to stop; `with interrupts.listening(): ...` raises KeyboardInterrupt then."""

    def __init__(self) -> None:
        self.heard = False
        self._held = False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """SIGINT and SIGTERM are heard inside the block."""
        before = [(number, signal.signal(number, self._hear)) for number in _SIGNALS]
        try:
            yield
        finally:
            for number, handler in before:
                signal.signal(number, handler)

    @contextmanager
    def held(self) -> Iterator[None]:
        """What is begun inside the block is ended, however it is interrupted: the files of one frame appear together, and
        no library is left half imported."""
        self._held = True
        try:
            yield
        finally:
            self._held = False

    def check(self) -> None:
        """Raises KeyboardInterrupt where the user has asked to stop."""
        if self.heard:
            raise KeyboardInterrupt

    def _hear(self, number, frame) -> None:
        self.heard = True
        if not self._held:
            raise KeyboardInterrupt
