"""How this package compiles: one place for Numba's options, its cache and its compile time.

Kernels are serial and release the GIL; `core.threads` runs them over chunks.  Compiled code is kept in a
user folder (`NUMBA_CACHE_DIR` where that is set), or not at all where none is writable.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import tempfile
from pathlib import Path

import numba
import platformdirs
from numba.core import caching, event, sigutils
from numba.core.ccallback import CFunc

from .nested import EntryImpl, Kernel, NestedCache

# Keeps NaN and infinity (no 'nnan', 'ninf'); without 'reassoc' sums do not vectorise.
FAST_MATH = {"reassoc", "contract", "nsz"}

_ROOM = Path(__file__).resolve().parents[1]
_RELATIVE_IMPORT = re.compile(r"^from (\.+)([\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)


def _cache_folder() -> Path | None:
    asked = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(asked) if asked else Path(platformdirs.user_cache_dir("lumigate")) / "numba"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return None


@functools.cache
def _source(path: Path) -> bytes:
    return path.read_bytes()


@functools.cache
def _imports(path: Path) -> frozenset[Path]:
    """Files of this package that a module imports directly."""
    found = set()
    for dots, module, names in _RELATIVE_IMPORT.findall(_source(path).decode()):
        base = path.parents[len(dots) - 1].joinpath(*module.split(".")) if module else path.parents[len(dots) - 1]
        candidates = [base.with_suffix(".py"), base / "__init__.py"]
        candidates += [(base / name).with_suffix(".py") for name in re.findall(r"\w+", names)]
        found.update(c for c in candidates if c.is_file())
    return frozenset(found)


@functools.cache
def _stamp(path: Path) -> str:
    """Hash of a module and of everything in this package that it imports, however indirectly."""
    seen, waiting = {path}, [path]
    while waiting:
        new = _imports(waiting.pop()) - seen
        seen |= new
        waiting.extend(new)
    digest = hashlib.sha256()
    for file in sorted(seen):
        digest.update(_source(file))
    return digest.hexdigest()


class _CacheLocator(caching.UserProvidedCacheLocator):
    """Compiled code is stale when ANY module that it was compiled from has changed.

    Numba's own locators look at the kernel's file alone, while device functions from other files are compiled
    into it: after an update an old kernel would run with the old functions in it.
    """

    def __init__(self, py_func, py_file):
        super().__init__(py_func, py_file)
        self._cache_path = str(_CACHE / self.get_suitable_cache_subpath(py_file))

    def get_source_stamp(self):
        return _stamp(Path(self._py_file).resolve())

    @classmethod
    def from_function(cls, py_func, py_file):
        if _CACHE is None or _ROOM not in Path(py_file).resolve().parents:
            return None
        return super(caching.UserProvidedCacheLocator, cls).from_function(py_func, py_file)


class _Cache(caching.FunctionCache):
    """A cache that never stops a render: what cannot be read is compiled anew, what cannot be written is not kept."""

    _impl_class = EntryImpl

    def _load_overload(self, sig, target_context):
        try:
            return super()._load_overload(sig, target_context)
        except Exception:  # pickled by another version, whose classes are not here; unpickling raises anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def _save_overload(self, sig, data):
        with contextlib.suppress(OSError):  # a full disk: the kernel is compiled already, and runs
            super()._save_overload(sig, data)


class _NestedCache(_Cache, NestedCache):
    """The same for what kernels alone call."""

    _impl_class = NestedCache._impl_class


_CACHE = _cache_folder()
if _CacheLocator.__qualname__ not in {c.__qualname__ for c in caching.CacheImpl._locator_classes}:
    caching.CacheImpl._locator_classes.insert(0, _CacheLocator)


def kernel(function=None, *, fast: bool = True, **options):
    """`numba.njit` as every kernel here uses it: no GIL, cached, NumPy's division, fast-math subset."""
    options = {
        "nogil": True,
        "error_model": "numpy",
        "cache": _CACHE is not None,
        "fastmath": FAST_MATH if fast else False,
    } | options

    def decorate(function):
        # Only this package's own kernels have a locator (a test's may lie anywhere).
        inside = _ROOM in Path(function.__code__.co_filename).resolve().parents
        cached = options["cache"] and inside
        if numba.config.DISABLE_JIT:
            return function
        targetoptions = {k: v for k, v in options.items() if k != "cache"} | {"nopython": True}
        return Kernel(function, locals={}, targetoptions=targetoptions, caches=(_Cache, _NestedCache) if cached else None)

    return decorate if function is None else decorate(function)


def inlined(function=None, **options):
    """A `leaf` that LLVM always inlines into the kernel that calls it."""
    return kernel(function, **({"forceinline": True, "_nrt": False, "cache": False} | options))


def leaf(function=None, **options):
    """A kernel that makes and keeps no array: it counts no references.

    Counting them on every call would have all threads write to the same cache lines.
    """
    return kernel(function, _nrt=False, **options)


def c_function(signature):
    """A kernel compiled now, for one signature, as a C function: `.address` is what other kernels may call."""

    def decorate(function):
        options = {"nopython": True, "error_model": "numpy", "fastmath": FAST_MATH}
        arguments, result = sigutils.normalize_signature(signature)
        compiled = CFunc(function, (arguments, result), locals={}, options=options)
        if _CACHE is not None:
            compiled._cache = _Cache(function)
        compiled.compile()
        return compiled

    return decorate


class CompileWatch(event.Listener):
    """Whether Numba is compiling just now, for a progress display: `with CompileWatch() as watch: ...; watch.compiling`."""

    def __init__(self) -> None:
        self._depth = 0

    def __enter__(self) -> CompileWatch:
        event.register("numba:compile", self)
        return self

    def __exit__(self, *_):
        event.unregister("numba:compile", self)

    @property
    def compiling(self) -> bool:
        """True between the beginning and the end of a compilation."""
        return self._depth > 0

    def on_start(self, _event) -> None:
        """Called by Numba; compilations lie within each other."""
        self._depth += 1

    def on_end(self, _event) -> None:
        """Called by Numba."""
        self._depth -= 1


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
