"""Ctrl-C and a render farm's kill, heard whenever they come.

An exception alone is not enough: raised while Blender or a library's callback runs, it is printed and forgotten.  So it is also
written down, whoever reports progress asks for it, and one that Python could not raise comes again a moment later.
Cycles' renders and bakes hear nothing until they are over, and swallow what is raised then: the process ends amid them (`ending_amid`).
"""

from __future__ import annotations

import _thread
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_MOMENT = 0.05  # s, in which a callback is likely to be over


_listener: Interrupts | None = None  # whose block this is


class Interrupts:
    """Whether the user has asked to stop; `with interrupts.listening(): ...` raises KeyboardInterrupt then."""

    def __init__(self) -> None:
        self.heard = False
        self._held = False
        self._listening = False
        self._hook = sys.unraisablehook  # as it was before
        self.end: Callable[[], None] | None = None  # what ends the process at once, None where nothing may

    @contextmanager
    def listening(self) -> Iterator[None]:
        """SIGINT and SIGTERM are heard inside the block."""
        global _listener
        before = [(number, signal.signal(number, self._hear)) for number in _SIGNALS]
        self._hook, sys.unraisablehook = sys.unraisablehook, self._not_raised
        self._listening = True
        outer, _listener = _listener, self
        try:
            yield
        finally:
            _listener = outer
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


@contextmanager
def ending_amid() -> Iterator[None]:
    """Inside the block, which writes no file of the user's, Ctrl-C and a kill end the process at once, by the `end` of who listens; without one nothing is different.

    For calls that do not come back to Python until they are over: a thread waits for the signals' numbers, which Python's C code writes to a socket (Windows has no pipes for this).
    """
    end = _listener.end if _listener is not None else None
    if end is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    reading, writing = socket.socketpair()
    writing.setblocking(False)

    def watch() -> None:
        while number := reading.recv(1):
            if number[0] in _SIGNALS:
                end()
                return

    watcher = threading.Thread(target=watch, name="interrupts", daemon=True)
    before = signal.set_wakeup_fd(writing.fileno())
    watcher.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        writing.close()  # ends the thread
        watcher.join()
        reading.close()
