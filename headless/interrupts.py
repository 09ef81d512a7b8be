"""Ctrl-C and a render farm's kill, heard whenever they come.

An exception alone is not enough: raised while Blender or a library's callback runs, it is printed and forgotten.  So it is also
written down, whoever reports progress asks for it, and one that Python could not raise comes again a moment later.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_MOMENT = 0.05  # s, in which a callback is likely to be over


class Interrupts:
    """Whether the user has asked to stop; `with interrupts.listening(): ...` raises KeyboardInterrupt then."""

    def __init__(self) -> None:
        self.heard = False
        self._held = False
        self._listening = False
        self._hook = sys.unraisablehook  # as it was before

    @contextmanager
    def listening(self) -> Iterator[None]:
        """SIGINT and SIGTERM are heard inside the block."""
        before = [(number, signal.signal(number, self._hear)) for number in _SIGNALS]
        self._hook, sys.unraisablehook = sys.unraisablehook, self._not_raised
        self._listening = True
        try:
            yield
        finally:
            self._listening, sys.unraisablehook = False, self._hook
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

    def _not_raised(self, unraisable: sys.UnraisableHookArgs) -> None:
        """Python's hook for what was raised where nobody can catch it, as inside a compiler's callback."""
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._hook(unraisable)
            return
        again = threading.Timer(_MOMENT, self._repeat)
        again.daemon = True
        again.start()

    def _repeat(self) -> None:
        if not self._listening:
            return
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)  # which ends a wait, too
        else:
            _thread.interrupt_main()
