"""Sends Lumigate's indirect light of a range of frames to OpenCue (https://www.opencue.io).

    python opencue_lumigate.py SHOT.blend -o /shared/light.####.exr --frames 1-250 [--chunk 32] [-- --samples 16 --size 1920x1080]

Needs OpenCue's `pyoutline` where it is run, and the same `lumigate` on the PATH of every host; scene and output lie on shared storage.
A chunk renders a run of frames of the whole sequence (`--part`), which gives the same bits wherever it runs; a chunk that is
retried goes on where it was (`--skip-existing`).
"""

from __future__ import annotations

import argparse
import re


def commands(scene: str, output: str, frames: str, chunk: int, extra: list[str]) -> list[list[str]]:
    """The command line of each chunk; ValueError where `frames` is not FIRST-LAST."""
    ends = re.fullmatch(r"(-?\d+)-(-?\d+)", frames)
    if not ends:
        raise ValueError(f"frames: {frames!r} is not FIRST-LAST, as in 1-250")
    first, last = map(int, ends.groups())
    runs = [f"{begin}-{min(last, begin + chunk - 1)}" for begin in range(first, last + 1, chunk)]
    return [["lumigate", "render", scene, "-o", output, "--frames", frames, "--part", run, "--skip-existing", *extra] for run in runs]


def main() -> None:
    """Launch one layer a chunk."""
    import outline
    import outline.cuerun
    import outline.modules.shell

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--frames", required=True)
    parser.add_argument("--chunk", type=int, default=32)
    parser.add_argument("--job", default="lumigate")
    parser.add_argument("extra", nargs="*", help="options of `lumigate render`, after --")
    given = parser.parse_args()
    job = outline.Outline(given.job, frame_range="1")
    for command in commands(given.scene, given.output, given.frames, given.chunk, given.extra):
        job.add_layer(outline.modules.shell.Shell(f"frames_{command[command.index('--part') + 1]}", command=command, range="1"))
    outline.cuerun.launch(job, use_pycuerun=False)


if __name__ == "__main__":
    main()
