"""The command line: the console script `lumigate`, and the script of `blender -b FILE --python headless/cli.py -- ARGS`.

Exit status: 0 done; 2 bad usage or a scene that cannot be rendered; 130 cancelled.
"""

import contextlib
import importlib
import importlib.util
import os
import shutil
import signal
import sys
import traceback
from functools import partial
from pathlib import Path
from typing import NoReturn

CANCELLED = "lumigate: cancelled"


def _load_package() -> None:
    """Make the folder above this script importable as `lumigate`, whatever the folder is called."""
    root = Path(__file__).resolve().parents[1]
    spec = importlib.util.spec_from_file_location("lumigate", root / "__init__.py", submodule_search_locations=[str(root)])
    package = importlib.util.module_from_spec(spec)
    sys.modules["lumigate"] = package
    spec.loader.exec_module(package)


def program() -> NoReturn:
    """The console script."""
    try:
        keep_bytecode()
        status = main()
    except KeyboardInterrupt:  # before anything of ours listens
        print(CANCELLED, file=sys.stderr)
        status = 130
    leave(status)


def keep_bytecode() -> None:
    """Python's compiled modules go into the user's cache folder where Python is told to write none beside the sources.

    Containers often tell it so, and then each start compiles a thousand modules of Numba's and Blender's: 3 s.
    """
    if sys.dont_write_bytecode and not sys.pycache_prefix:
        import platformdirs

        sys.pycache_prefix = str(Path(os.environ.get("LUMIGATE_CACHE") or platformdirs.user_cache_dir("lumigate"), "bytecode").absolute())
        sys.dont_write_bytecode = False


def leave(status: int) -> NoReturn:
    """End the process without the static destructors of bpy 4, which wait for ever on its sound thread where anything still refers to bpy."""
    # All is said and done: what comes now must not turn a whole picture into a killed process.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    bpy = sys.modules.get("bpy")
    if bpy is None or bpy.app.version >= (5, 0):
        sys.exit(status)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # nobody reads it any more
            stream.flush()
    remove_temporary_folder()
    os._exit(status)


def end_at_once(terminal) -> NoReturn:
    """End the process, cancelled, amid what cannot be told to stop; terminal: a `Terminal`."""
    terminal.say(CANCELLED)
    if terminal.err.is_terminal:
        terminal.err.show_cursor()
    remove_temporary_folder()
    os._exit(130)


def remove_temporary_folder() -> None:
    """Delete what Blender would delete at its end: a folder of this process alone, which is called so."""
    bpy = sys.modules.get("bpy")
    folder = Path(bpy.app.tempdir) if bpy is not None else Path()
    if folder.name.startswith("blender_"):  # else a folder for all processes
        shutil.rmtree(folder, ignore_errors=True)


def main(argv: list[str] | None = None, *, in_blender: bool = False) -> int:
    """Run one command and return its exit status.

    argv: the arguments (default: the process's own).  in_blender: Blender runs this as its script, so that its own
    arguments come first, up to `--`, and its open file is the scene where none is named.
    """
    from .interrupts import Interrupts

    interrupts = Interrupts()
    with interrupts.listening():
        try:
            return _main(argv, in_blender, interrupts)
        except KeyboardInterrupt:  # before or after there is a terminal to say so
            print(CANCELLED, file=sys.stderr)
            return 130
        except Exception:
            if not interrupts.heard:
                raise
            # NumPy, interrupted while its library loads, calls it a broken installation.
            print(CANCELLED, file=sys.stderr)
            return 130


def _main(argv: list[str] | None, in_blender: bool, interrupts) -> int:
    """`main` where Ctrl-C is heard; interrupts: an `Interrupts`."""
    from .arguments import parse

    try:
        arguments = parse(argv, in_blender=in_blender)
    except SystemExit as stop:  # argparse has printed its line
        return int(stop.code or 0)
    try:
        return _run(arguments, interrupts)
    except ModuleNotFoundError as error:  # a Blender's own Python has only what the extension brought
        interrupts.check()
        package = (error.name or "lumigate").partition(".")[0]
        if package == "lumigate":
            raise
        print(f"lumigate: error: Python has no package {package!r}; install Lumigate with pip, or its extension's zip", file=sys.stderr)
        return 2


def _run(arguments, interrupts) -> int:
    from .limits import shortage

    if (reason := shortage()) is not None:
        print(f"lumigate: error: {reason}", file=sys.stderr)
        return 2
    with interrupts.held():
        from ..core.errors import SceneError
        from ..core.threads import Cancelled
        from .console import open_terminal

    with open_terminal(interrupts) as terminal:
        interrupts.end = partial(end_at_once, terminal)
        try:
            with interrupts.held():
                command = importlib.import_module(f".commands.{arguments.command}", __package__)
            interrupts.check()
            command.run(arguments, terminal)
        except (Cancelled, KeyboardInterrupt):
            terminal.say(CANCELLED)
            return 130
        except SceneError as error:
            if interrupts.heard:  # what was read when it came could not be read to its end
                terminal.say(CANCELLED)
                return 130
            terminal.say(f"lumigate: error: {error}")
            return 2
    return 0


if __name__ == "__main__":
    if not __package__:
        _load_package()
    from lumigate.headless.cli import main as package_main

    inside = "bpy" in sys.modules
    try:
        status = package_main(in_blender=inside)
    except Exception:  # a fault of ours: Blender would print it, too, but end with status 0
        traceback.print_exc()
        status = 1
    if not inside:
        leave(status)
    sys.exit(status)
