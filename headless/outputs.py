"""Output paths, refused before the work begins where nothing could be written."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..core.errors import SceneError


class OutputError(SceneError):
    """A path that cannot be written; the message says why and what to do."""


def check_file(path: Path) -> Path:
    """Return `path` if a file can be written there; OutputError if not."""
    try:
        is_folder = path.is_dir()
    except OSError as error:  # as of a name that is too long
        raise OutputError(f"cannot write {str(path)!r} ({error.strerror}); choose another name") from error
    if is_folder:
        raise OutputError(f"{str(path)!r} is a folder; name a file in it")
    folder = path.parent
    if not folder.is_dir():
        raise OutputError(f"there is no folder {str(folder)!r} to write {path.name!r} into; make it first")
    _check_writable(folder)
    return path


def check_folder(path: Path) -> Path:
    """Return `path` if it is a folder that can be written into, or can be made; OutputError if not."""
    try:
        nearest = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    except OSError as error:
        raise OutputError(f"cannot write into {str(path)!r} ({error.strerror}); choose another name") from error
    if not nearest.is_dir():
        raise OutputError(f"{str(nearest)!r} is a file, not a folder; choose another folder")
    _check_writable(nearest)
    return path


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A temporary folder in `path`, or beside it where it is still to be made, whose files appear in `path` together when the block ends
    well, and not at all otherwise.

    Raises:
        OutputError: they cannot be written or moved.
    """
    try:
        # Beside a folder that is there may be another disk, or nothing that may be written: it may be a mounted one.
        home = path if path.is_dir() else path.parent
        home.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name[:40]}.", suffix=".part", dir=home))
        try:
            yield temporary
            path.mkdir(exist_ok=True)
            for file in sorted(temporary.iterdir()):
                os.replace(file, path / file.name)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"cannot write into {str(path)!r} ({error.strerror or error}); choose another folder") from error


def _check_writable(folder: Path) -> None:
    # Only the attempt tells: root passes every permission check, and a mount may be read-only.
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(f"cannot write into {str(folder)!r} ({error.strerror}); choose another folder") from error
