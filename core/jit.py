"""How this package compiles: one place for Numba's options, its cache and its compile time.

Kernels are serial and release the GIL; `core.threads` runs them over chunks.  `cache=True` raises at
decoration where no cache folder is writable, so the folder is chosen here, before any kernel is
defined, and caching is switched off when there is none.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import platformdirs

# Keeps NaN and infinity (no 'nnan', 'ninf'); without 'reassoc' sums do not vectorise.
FAST_MATH = {"reassoc", "contract", "nsz"}


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _cache_folder() -> str | None:
    asked = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(asked) if asked else Path(platformdirs.user_cache_dir("lumigate")) / "numba"
    return str(folder) if _writable(folder) else None


_CACHE = _cache_folder()
if _CACHE is not None:
    os.environ["NUMBA_CACHE_DIR"] = _CACHE

import numba  # noqa: E402  (reads NUMBA_CACHE_DIR when it is imported)
from numba.core import event  # noqa: E402

if _CACHE is not None and numba.config.CACHE_DIR != _CACHE:
    numba.config.CACHE_DIR = _CACHE  # Numba was imported before this module


def kernel(function=None, *, fast: bool = True, **options):
    """`numba.njit` as every kernel here uses it: no GIL, cached, NumPy's division, fast-math subset."""
    options = {
        "nogil": True,
        "error_model": "numpy",
        "cache": _CACHE is not None,
        "fastmath": FAST_MATH if fast else False,
    } | options
    decorate = numba.njit(**options)
    return decorate if function is None else decorate(function)


def inlined(function=None, **options):
    """A device function that is always inlined by LLVM into the kernel that calls it."""
    options = {"error_model": "numpy", "fastmath": FAST_MATH, "forceinline": True} | options
    decorate = numba.njit(**options)
    return decorate if function is None else decorate(function)


class CompileTimer:
    """Seconds that Numba spends compiling, for the statistics: `with CompileTimer() as t: ...; t.seconds`."""

    def __enter__(self) -> CompileTimer:
        self._listener = event.TimingListener()
        event.register("numba:compile", self._listener)
        return self

    def __exit__(self, *_):
        event.unregister("numba:compile", self._listener)

    @property
    def seconds(self) -> float:
        """Seconds so far (0.0 where nothing was compiled)."""
        return float(self._listener.duration) if self._listener.done else 0.0
