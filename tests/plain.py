"""Tests of the core with jitting off: kernels are plain Python, so that coverage sees their lines, and NumPy's scalars do their sums.

    python tests/plain.py [--seconds S] [--jobs N] [TEST FILE ...]

A kernel is a thousand times slower in Python: a test that takes more than S CPU seconds is cut off, and counts for the lines that it
has reached.  What kernels do beyond Python (Embree's calls, words of memory, functions by address) is done by ctypes here.
Not part of CI: it takes an hour or more.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = (
    "core/test_*.py",
    "addon/test_materials_*.py",
    "addon/extract/test_extract_film.py",
)  # materials have their oracle on Blender's side: Cycles
COVERAGE_CORE = "sysmon" if sys.version_info >= (3, 12) else "ctrace"  # the former is the faster
WORD = ctypes.c_void_p


class CutOff(BaseException):
    """A test has had its seconds."""


def _memory(definition):
    """Stand-ins for the words of memory of `core.rays.memory`, by what their factories closed over."""
    import numpy as np
    from numba import types

    inside = dict(zip(definition.__code__.co_freevars, (cell.cell_contents for cell in definition.__closure__)))
    if "words" in inside:
        size = 4 * inside["words"]
        return lambda target, i, source, j: ctypes.memmove(int(target) + 4 * int(i), int(source) + 4 * int(j), size)
    kind, number = (ctypes.c_int32, np.int32) if inside["kind"] is types.int32 else (ctypes.c_float, np.float32)
    if definition.__name__ == "read":
        return lambda address, i: number(kind.from_address(int(address) + 4 * int(i)).value)

    def write(address, i, value):
        kind.from_address(int(address) + 4 * int(i)).value = value

    return write


def _call_packet(function, *arguments):
    ctypes.CFUNCTYPE(None, WORD, WORD, WORD, WORD)(int(function))(*map(int, arguments))


def _call_single(function, scene, ray):
    ctypes.CFUNCTYPE(None, WORD, WORD, WORD)(int(function))(int(scene), int(ray), None)


_ROW = ctypes.POINTER(ctypes.c_float)
_OPERATION = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64, _ROW, _ROW, _ROW, _ROW)


def _call(address, op, p, *rows):
    _OPERATION(int(address))(int(op), int(p), *(ctypes.cast(int(row), _ROW) for row in rows))


def _intrinsic(definition):
    named = {"_call_packet": _call_packet, "_call_single": _call_single, "_call": _call}
    return named.get(definition.__name__) or _memory(definition)


def _overload(stub, **_):
    """`trace.register_backend` without types: the stub itself calls the backend of its tables' class."""
    table = stub.__globals__.setdefault("_plain", {})

    def register(choose):
        inside = dict(zip(choose.__code__.co_freevars, (cell.cell_contents for cell in choose.__closure__)))
        table[stub.__name__, inside["matches"].__closure__[0].cell_contents] = inside["jitted"]
        names = ", ".join(stub.__code__.co_varnames[: stub.__code__.co_argcount])
        scope: dict = {}
        exec(f"def {stub.__name__}({names}): return _plain[{stub.__name__!r}, type(tables)]({names})", scope)
        stub.__code__ = scope[stub.__name__].__code__
        return choose

    return register


class _Compiled:
    """A C function of a Python one."""

    def __init__(self, function):
        self._callback = _OPERATION(function)
        self.address = ctypes.cast(self._callback, WORD).value


def patch() -> None:
    """Everything that only jitted code can do, done by Python; before the core is imported."""
    import numba.extending

    numba.extending.intrinsic, numba.extending.overload = _intrinsic, _overload
    from lumigate.core import jit, threads

    jit.c_function = lambda signature: _Compiled
    threads.thread_count = lambda _=0: 1  # a test that is cut off must leave nobody behind who traces rays in what it frees
    warnings.simplefilter("ignore", RuntimeWarning)  # hashes wrap around, and NumPy says so for each scalar


class Limit:
    """A pytest plugin: each test gets so many seconds of the processor, whoever shares it."""

    def __init__(self, seconds: int):
        self.seconds = seconds

    def _stop(self, *_):
        raise CutOff

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item):
        """Rings until it is heard: what is raised inside a callback of C is lost."""
        signal.signal(signal.SIGPROF, self._stop)
        signal.setitimer(signal.ITIMER_PROF, self.seconds, 1.0)
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)


def run_here(seconds: int, files: list[str], data: str) -> int:
    """The tests of some files in this process, their coverage into `data`."""
    import coverage

    covered = coverage.Coverage(data_file=data, source_pkgs=["lumigate.core"], messages=False)
    covered.start()
    patch()
    status = pytest.main(["-q", "--tb=line", "-p", "no:cacheprovider", "-W", "ignore::RuntimeWarning", *files], plugins=[Limit(seconds)])
    covered.stop()
    covered.save()
    return int(status)


def main() -> int:
    """Deals the files to processes and prints the share of lines."""
    parser = argparse.ArgumentParser()
    parser.add_argument("files", nargs="*", default=None)
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--data", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    files = arguments.files or sorted(str(path) for pattern in FILES for path in (ROOT / "tests").glob(pattern))
    if arguments.data:
        return run_here(arguments.seconds, files, arguments.data)
    import coverage

    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "COVERAGE_CORE": COVERAGE_CORE}
    with tempfile.TemporaryDirectory() as folder:

        def run(job: tuple[int, str]) -> None:
            command = [sys.executable, __file__, "--seconds", str(arguments.seconds), "--data", f"{folder}/part{job[0]}", job[1]]
            subprocess.run(command, env=environment, cwd=ROOT, check=False)

        with ThreadPoolExecutor(arguments.jobs) as pool:
            list(pool.map(run, enumerate(files)))
        whole = coverage.Coverage(data_file=f"{folder}/whole", source_pkgs=["lumigate.core"], config_file=str(ROOT / "pyproject.toml"))
        whole.combine([str(path) for path in Path(folder).glob("part*")])
        share = whole.report(show_missing=True, skip_covered=True)
    print(f"{share:.1f} % of the lines of core/")
    return 0


if __name__ == "__main__":
    sys.exit(main())
