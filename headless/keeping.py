"""What a process that runs one command line after the other keeps open between them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol, TypeVar


class Closable(Protocol):
    """Anything that ends with `close`."""

    def close(self) -> None: ...


T = TypeVar("T", bound=Closable)


class Keeper:
    """Holds on to one shot: the command line that goes on with it finds its scene open and its earlier frames computed.

    on: whether anything is kept, which a process of one command line has no use for.
    """

    def __init__(self) -> None:
        self.on = False
        self._key: object = None
        self._shot: Closable | None = None

    @contextmanager
    def shot(self, key: object, opened: Callable[[], T]) -> Iterator[T]:
        """What is kept under this key, or else what `opened()` gives; to be kept again, but closed where the block fails."""
        if key != self._key:
            self.drop()
        # Whatever happens in the block, nothing is kept that it may have left half done.
        shot, self._shot, self._key = self._shot, None, None
        with ExitStack() as stack:
            if shot is None:
                shot = opened()
            stack.callback(shot.close)
            yield shot
            if self.on:
                stack.pop_all()
                self._shot, self._key = shot, key

    def drop(self) -> None:
        """Close what is kept; to be called before Blender opens another scene, which ends all that refers to this one."""
        shot, self._shot, self._key = self._shot, None, None
        if shot is not None:
            shot.close()


KEPT = Keeper()  # one, as Blender has one open scene
