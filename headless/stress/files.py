"""Damaged scene files and pictures: the command line ends with a line, whatever is in them, and no code of theirs runs."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import bpy
import numpy as np

from ... import sample_scenes
from ...core.layers import Layers, write_exr
from ...core.threads import thread_count
from ..console import quiet
from .outcome import Outcome

MUTANTS = 10  # of each kind of file
SECONDS = 120  # after which a command counts as hung
CLI = Path(__file__).resolve().parents[1] / "cli.py"


def write_originals(folder: Path) -> list[Path]:
    """One sound file of each kind that the command line reads."""
    with quiet():
        sample_scenes.build("cornell", detail="low")
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"), compress=False)
        bpy.ops.export_scene.gltf(filepath=str(folder / "scene.glb"))
        bpy.ops.wm.obj_export(filepath=str(folder / "scene.obj"))
    picture = write_exr(folder / "picture.exr", Layers({"Indirect": np.random.default_rng(1).random((32, 32, 3), np.float32)}))
    return [folder / "scene.blend", folder / "scene.glb", folder / "scene.obj", picture]


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes changed at random, a piece cut out, doubled or zeroed, or the end missing."""
    damaged = np.frombuffer(data, np.uint8).copy()
    begin = int(rng.integers(0, len(damaged)))
    end = min(len(damaged), begin + int(rng.integers(1, 4096)))
    way = int(rng.integers(5))
    if way == 0:
        where = rng.integers(0, len(damaged), int(rng.integers(1, 200)))
        damaged[where] = rng.integers(0, 256, len(where))
    elif way == 1:
        damaged = np.delete(damaged, np.s_[begin:end])
    elif way == 2:
        damaged = np.concatenate([damaged[:end], damaged[begin:end], damaged[end:]])
    elif way == 3:
        damaged[begin:end] = 0
    else:
        damaged = damaged[:begin]
    return damaged.tobytes()


def ends_with_a_line(file: Path) -> str:
    """What is wrong with how the command line takes a file: '' where it reads it (0), or refuses it with one line (2)."""
    command = ["compare", file, file] if file.suffix == ".exr" else ["inspect", file]
    try:
        done = subprocess.run(
            [sys.executable, str(CLI), *map(str, command)], capture_output=True, text=True, timeout=SECONDS, cwd=file.parent, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no end after {SECONDS} s"
    if done.returncode == 0 or (done.returncode == 2 and "lumigate: error: " in done.stderr):
        return ""
    return f"status {done.returncode}: {(done.stderr.strip().splitlines() or ['no line'])[-1][:120]}"


def damaged_files(mutants: int = MUTANTS) -> list[Outcome]:
    """Each kind of file with `mutants` kinds of damage, read by a process of its own in a folder that must stay as it is."""
    lines = []
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(thread_count()) as pool:
        folder = Path(name)
        for original in write_originals(folder):
            files = []
            for seed in range(mutants):
                own = folder / f"{original.suffix[1:]}{seed}"
                own.mkdir()
                for beside in folder.glob("scene.mtl"):
                    shutil.copy(beside, own)
                files.append(own / original.name)
                files[-1].write_bytes(mutate(original.read_bytes(), np.random.default_rng(seed)))
            before = _names(folder)
            faults = [f"damage {seed}: {fault}" for seed, fault in enumerate(pool.map(ends_with_a_line, files)) if fault]
            case = f"{mutants} damaged {original.suffix} files: without a line"
            lines.append(Outcome(case + (f" ({faults[0]})" if faults else ""), "all", "0", len(faults), not faults))
            written = len(_names(folder) - before)
            lines.append(Outcome(f"{mutants} damaged {original.suffix} files: files written", "all", "0", written, written == 0))
    return lines


def _names(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))
