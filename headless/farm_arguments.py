"""The options of `lumigate farm`, and what it hands on to `render` and `bake` on the workers."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from .argument_types import count, names
from .sequence_arguments import frame_range

# Options of `render` and `bake` that name files of the machine where they run, or belong to the farm itself.
_NOT_HANDED_ON = ("--stats", "--json", "--part", "--border", "--frame", "--objects", "--selected", "--atlas", "--attributes", "--gltf")


def border(text: str) -> tuple[int, int, int, int]:
    """X0,Y0,X1,Y1 in pixels, y down from the top."""
    try:
        x0, y0, x1, y1 = map(int, text.split(","))
    except ValueError:
        x0 = y0 = x1 = y1 = 0
    if not (0 <= x0 < x1 and 0 <= y0 < y1):
        raise argparse.ArgumentTypeError(f"{text!r} is not X0,Y0,X1,Y1 in pixels from the top left, as in 0,0,640,360")
    return x0, y0, x1, y1


def add_farm(parser: argparse.ArgumentParser, file: Callable, folder: Callable, resolution: Callable) -> None:
    """What is done, and where; all other options are those of `render` and `bake`."""
    add = parser.add_argument
    add("-o", "--output", required=True, metavar="OUT", help="OUT.exr of frames or a still, a folder of lightmaps")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--frames", type=frame_range, metavar="A-B[:STEP]", help="these frames")
    what.add_argument("--tiles", type=count, metavar="N", help="one still (with --size) in tiles of N pixels along a side")
    what.add_argument("--bake", type=names, metavar="A,B+C", help="lightmaps of these objects, each on a worker; B+C: one atlas for both")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="HOST:PORT", help="a Dask scheduler; tls://HOST:PORT with Dask's own TLS settings")
    where.add_argument("--workers", type=count, metavar="N", help="workers on this machine (default: 1)")
    add("--skip-existing", action="store_true", help="render the frames only whose files are not there yet")
    add("--size", type=resolution, metavar="WxH", help="pixels of the full frame; of each lightmap the first number")
    add("--summary", type=file(".json"), metavar="FILE.json", help="one file with the statistics of all frames")
    add("--contact-sheet", type=file(".png"), metavar="FILE.png", help="one picture with up to 48 of the frames")
    parser.set_defaults(output_types=(file(".exr"), folder))


def finish_farm(parser, arguments: argparse.Namespace, rest: list[str], parse: Callable) -> None:
    """Check what is handed on by the grammar of the command that will read it, and set `kind` and `rest`; as `bake` and `render` would
    have them, `baking` and `sequence`.
    """
    arguments.kind = "frames" if arguments.frames is not None else "tiles" if arguments.tiles is not None else "bake"
    is_file, is_folder = arguments.output_types
    try:
        arguments.output = (is_folder if arguments.kind == "bake" else is_file)(arguments.output)
    except argparse.ArgumentTypeError as error:
        parser.error(f"argument -o/--output: {error}")
    foreign = next((text for text in rest if text.split("=")[0] in _NOT_HANDED_ON), None)
    if foreign:
        parser.error(f"{foreign} cannot be given to a farm")
    if arguments.kind == "tiles" and arguments.size is None:
        parser.error("--tiles needs --size WxH")
    if arguments.kind != "frames" and (arguments.skip_existing or arguments.summary or arguments.contact_sheet):
        parser.error("--skip-existing, --summary and --contact-sheet belong to --frames A-B")
    if arguments.size is not None and arguments.kind != "tiles":
        width, height = arguments.size
        rest += ["--size", f"{width}x{height}" if arguments.kind == "frames" else str(width)]
    if arguments.kind == "bake":
        arguments.baking = parse(["bake", arguments.scene, "-o", str(arguments.output), *rest])
    else:
        shown = ["--frames", "1-1"] if arguments.kind == "frames" else []
        arguments.sequence = parse(["render", arguments.scene, "-o", str(arguments.output), *shown, *rest]).sequence
    arguments.rest = rest
