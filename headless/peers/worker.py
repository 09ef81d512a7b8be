"""A renderer in a process of its own: two of them in one take each other's libraries for their own, and some errors of theirs end a process."""

from __future__ import annotations

import importlib
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

from ...core.errors import SceneError
from ..console import quiet
from .neutral import Neutral

_neutral: Neutral | None = None  # of the worker's process


class Worker:
    """Calls functions of the module `module` of this package, whose first argument is the neutral scene; times are those in its process."""

    def __init__(self, module: str, neutral: Neutral):
        self.module = module
        self._pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_begin, initargs=(neutral,))

    def call(self, function: str, *arguments) -> Any:
        """What the function returns; raises what it does, and SceneError where the process has ended."""
        try:
            with quiet():
                return self._pool.submit(_call, self.module, function, arguments).result()
        except BrokenProcessPool as error:
            hint = importlib.import_module(f".{self.module}", __package__).HINT
            raise SceneError(f"{self.module} cannot run: its process has ended{hint}") from error

    def close(self) -> None:
        """End the process."""
        self._pool.shutdown()


def _begin(neutral: Neutral) -> None:
    global _neutral
    _neutral = neutral


def _call(module: str, function: str, arguments: tuple) -> Any:
    return getattr(importlib.import_module(f".{module}", __package__), function)(_neutral, *arguments)
