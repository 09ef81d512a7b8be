"""The process beside a farm's worker that holds Blender: it runs one command line after the other.

Requests are lines of JSON on its standard input, {"argv": arguments, "folder": where they are run, so that no relative path leads
elsewhere}; answers are lines of JSON on its standard output: {"status": exit status, "said": what the command wrote for the user}.
Blender wants a process, and its main thread, to itself; a crash of it does not take the worker along.  The last shot stays open, so
that the next part of it goes on where the last one ended.
"""

from __future__ import annotations

import io
import json
import os
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout


def serve() -> None:
    """Answer until the input ends."""
    answers = open(os.dup(1), "w", encoding="utf-8", buffering=1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # Blender prints there
    from ..cli import main
    from ..keeping import KEPT

    KEPT.on = True
    for line in sys.stdin:
        request, said = json.loads(line), io.StringIO()
        with chdir(request["folder"]), redirect_stderr(said), redirect_stdout(io.StringIO()):
            status = main(request["argv"])
            if status != 0:
                KEPT.drop()
        print(json.dumps({"status": status, "said": said.getvalue()}), file=answers)


if __name__ == "__main__":
    from ..cli import remove_temporary_folder

    serve()
    sys.stdout.flush()
    remove_temporary_folder()
    os._exit(0)  # without Blender's static destructors, which may wait for ever (see tests/conftest.py)
