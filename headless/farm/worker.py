"""What runs on a farm's machines: a Dask worker that does our work only, and the Blender process beside it."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import dask
from distributed import Nanny, Worker, get_worker

from ... import __version__, sample_scenes
from ...core.layers import write_whole
from .parts import OUTPUT, SCENE, Part

PACKAGES = ("bpy", "numpy", "numba", "embreex", "OpenImageIO")
COMMANDS = ("render", "bake")
NAMES = ("--objects", "--camera", "--uv-map")  # options whose values are no paths, whatever stands in them
PING = ("ping",)  # a part that does nothing: what a task costs by itself
POLL = 0.5  # s, after which a task that waits for Blender looks whether it is still wanted


class FarmError(RuntimeError):
    """A part that cannot be done here; one line for the user, which is the same wherever it is tried."""


@functools.cache
def versions() -> dict[str, str]:
    """What the bits of a result depend on: this package's own code as this process found it, and what it stands on."""
    code = hashlib.sha256()
    root = Path(__file__).parents[2]
    for folder in ("core", "addon", "headless", "sample_scenes"):
        for file in sorted((root / folder).rglob("*.py")):
            code.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes())
    found = {name: version(name) for name in PACKAGES}
    return {"lumigate": f"{__version__} ({code.hexdigest()[:12]})", **found}


class FarmWorker(Worker):
    """A worker that runs `do_part`, and nothing else that a client may send.

    What is sent is unpickled before it can be looked at: let only those reach the scheduler whom you trust (docs/farm.md).
    """

    def __init__(self, *args, **options):
        super().__init__(*args, **(options | {"nthreads": 1}))
        for name in ("run", "run_coroutine"):
            self.handlers[name] = _refuse
        self.blender: Blender | None = None

    async def execute(self, key, *, stimulus_id):
        """Run a task if it is ours."""
        task = self.state.tasks.get(key)
        if task is not None and task.run_spec is not None and getattr(task.run_spec, "func", None) is not do_part:
            task.run_spec = type(task.run_spec)(key, _refused)
        return await super().execute(key, stimulus_id=stimulus_id)

    async def close(self, *args, **options):
        """Leave, and Blender with it."""
        if self.blender is not None:
            self.blender.close()
        return await super().close(*args, **options)


class FarmNanny(Nanny):
    """A process that keeps a `FarmWorker` alive."""

    def __init__(self, *args, **options):
        super().__init__(*args, **(options | {"worker_class": FarmWorker}))


def _refuse(*_, **__):
    raise FarmError("this worker runs parts of Lumigate's jobs only")


def _refused():
    _refuse()


def own_environment(variables: Mapping[str, str]) -> dict[str, str]:
    """These variables without those that a nanny gives its worker, for the sake of many small tasks.

    Above all that memory goes back to the system at once: it makes a frame take 10 to 20 % longer.
    """
    given = dask.config.get("distributed.nanny.pre-spawn-environ")
    return {name: value for name, value in variables.items() if value != str(given.get(name))}


class Blender:
    """A child process with Blender in it (see `child`), started when it is first needed."""

    def __init__(self, folder: str):
        """folder: where the process leaves what it needs for the moment; to be deleted by its owner."""
        package = __package__.rsplit(".", 1)[0]
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"{package}.farm.child"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, encoding="utf-8", bufsize=1,
            env=own_environment(os.environ) | {"TMPDIR": folder},
        )  # fmt: skip

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._process.poll() is None

    def ask(self, argv: list[str], folder: str, wanted) -> dict:
        """The answer to a command line, run in a folder; ConnectionError where Blender has ended, or `wanted()` is no longer true."""
        try:
            self._process.stdin.write(json.dumps({"argv": argv, "folder": folder}) + "\n")
            while not select.select([self._process.stdout], [], [], POLL)[0]:
                if not wanted():
                    self.close()
                    raise ConnectionError("the part is no longer wanted here")  # where it is after all, another try may do
            line = self._process.stdout.readline()
        except OSError:
            line = ""
        if not line:
            self.close()
            raise ConnectionError("Blender has ended")  # another try may do
        return json.loads(line)

    def close(self) -> None:
        """End the process now."""
        self._process.kill()
        self._process.wait()


def do_part(part: Part, expected: dict[str, str], scene: bytes | None = None) -> dict:
    """Do one part on the worker that this runs on: {"files": {name: bytes}, "said": lines for the user, "seconds": that it took}.

    scene: the file's content, where it is no sample scene; kept in the worker's folder under its hash.

    Raises FarmError where the part cannot be done.
    """
    worker = get_worker()
    own = versions()
    wrong = [f"{name} {own.get(name)} instead of {wanted}" for name, wanted in expected.items() if own.get(name) != wanted]
    if wrong:
        raise FarmError(f"worker {worker.address} has {', '.join(wrong)}; install the same there")
    if part.argv == PING:
        return {"files": {}, "said": "", "seconds": 0.0}
    begin = perf_counter()
    root = Path(worker.local_directory)
    with tempfile.TemporaryDirectory(prefix="part-", dir=root) as folder:
        file = _scene_file(root, part, scene)
        argv = command_line(part, file, Path(folder))
        key = worker.get_current_task()  # not the part's: another try of it has another one
        answer = _blender(worker).ask(argv, folder, lambda: _wanted(worker, key))
        said = answer["said"].strip().replace(file, part.scene).replace(Path(file).name, part.scene)  # the user knows no other name
        if answer["status"] != 0:
            raise FarmError(said.removeprefix("lumigate: error: ") or f"the command ended with status {answer['status']}")
        files = {file.relative_to(folder).as_posix(): file.read_bytes() for file in sorted(Path(folder).rglob("*")) if file.is_file()}
    return {"files": files, "said": said, "seconds": perf_counter() - begin}


def command_line(part: Part, scene: str, folder: Path) -> list[str]:
    """The arguments of a part, its scene and its output put in; FarmError where it wants anything but that."""
    first, *rest = part.argv
    if first not in COMMANDS:
        raise FarmError(f"{first!r} is not among a worker's commands: {', '.join(COMMANDS)}")
    paths = [text for option, text in zip((first, *rest), rest) if option not in NAMES or text.startswith("-")]
    outside = [text for text in paths if text not in (SCENE,) and not text.startswith(OUTPUT) and (os.sep in text or ".." in text)]
    outside += [text for text in rest if text.startswith(OUTPUT) and ".." in text]
    if outside:
        raise FarmError(f"{outside[0]!r} is no path under the worker's folder")
    return [first, *(scene if text == SCENE else text.replace(OUTPUT, str(folder), 1) for text in rest)]


def _scene_file(root: Path, part: Part, content: bytes | None) -> str:
    """A sample scene's name, or the scene's file in the worker's folder; FarmError where it is neither."""
    if part.digest is None:
        if part.scene not in sample_scenes.NAMES:
            raise FarmError(f"{part.scene!r} is no sample scene, and its file was not sent")
        return part.scene
    path = root / "scenes" / f"{part.digest}{Path(part.scene).suffix}"
    if not path.is_file():
        if content is None or hashlib.sha256(content).hexdigest() != part.digest:
            raise FarmError(f"scene {part.scene!r} has not come whole; try again")
        shutil.rmtree(path.parent, ignore_errors=True)  # that of the last job
        write_whole(path, lambda temporary: temporary.write_bytes(content))
    return str(path)


def _blender(worker: Worker) -> Blender:
    if getattr(worker, "blender", None) is None or not worker.blender.alive:
        worker.blender = Blender(worker.local_directory)
    return worker.blender


def _wanted(worker: Worker, key: str) -> bool:
    task = worker.state.tasks.get(key)
    return task is not None and task.state not in ("cancelled", "released", "forgotten")
