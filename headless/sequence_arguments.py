"""The options of a sequence of frames: which ones, what they share, and what is left beside them."""

from __future__ import annotations

import argparse
import re
from dataclasses import fields

from ..core.settings import SequenceSettings
from .argument_types import count, size_or_none

LAST_FRAME = 1_048_574  # Blender's MAXFRAME


def frame(text: str) -> int:
    """A frame number that Blender can hold."""
    if not re.fullmatch(r"-?\d+", text) or abs(int(text)) > LAST_FRAME:
        raise argparse.ArgumentTypeError(f"{text!r} is not a frame number from {-LAST_FRAME} to {LAST_FRAME}")
    return int(text)


def frame_range(text: str) -> range:
    """FIRST-LAST, both rendered, or FIRST-LAST:STEP, every so-manyth of them."""
    match = re.fullmatch(r"(-?\d+)-(-?\d+)(?::(\d+))?", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is not FIRST-LAST or FIRST-LAST:STEP, as in 1-24 or 1-24:2")
    first, last = (frame(part) for part in match.groups()[:2])
    if last < first:
        raise argparse.ArgumentTypeError(f"{text!r} ends before it begins; write {last}-{first}")
    step = int(match[3] or 1)
    if not 1 <= step <= LAST_FRAME:
        raise argparse.ArgumentTypeError(f"{text!r} has a step of {step}; frames go on by 1 or more")
    return range(first, last + 1, step)


def add_sequence(parser: argparse.ArgumentParser, file) -> None:
    """Options that need `--frames`; file: the type of an argument that names a file to be written."""
    keep = {"default": argparse.SUPPRESS}
    usual = SequenceSettings()
    group = parser.add_argument_group("--frames")
    add = group.add_argument
    add(
        "--history", type=size_or_none, metavar="N", **keep,
        help=f"earlier frames whose light is averaged into a frame, 0 for independent frames (default: {usual.history})",
    )  # fmt: skip
    add(
        "--motion-blur", type=count, metavar="N", **keep,
        help="sub-frames a frame, while the scene's shutter is open (default: 1, no motion blur)",
    )  # fmt: skip
    add("--part", type=frame_range, metavar="A-B", help="of the frames, only these, as they are in the whole sequence")
    add("--skip-existing", action="store_true", help="render the frames only whose files are not there yet: a killed job goes on")
    add("--summary", type=file(".json"), metavar="FILE.json", help="one file with the statistics of all frames")
    add("--contact-sheet", type=file(".png"), metavar="FILE.png", help="one picture with up to 48 of the frames")


def sequence_settings(parser, arguments: argparse.Namespace) -> SequenceSettings:
    """What the options make; one of them without `--frames` is an error."""
    given = vars(arguments)
    chosen = {f.name: given[f.name] for f in fields(SequenceSettings) if f.name in given}
    flags = [*chosen, *(name for name in ("part", "skip_existing", "summary", "contact_sheet") if given[name])]
    if given["frames"] is None and flags:
        parser.error(f"--{flags[0].replace('_', '-')} belongs to --frames A-B")
    if arguments.part is not None and not set(arguments.part) <= set(arguments.frames):
        parser.error("--part names frames that are not among --frames")
    return SequenceSettings(**chosen)
