"""The command line's grammar: every command, its options, and what can be said of them before anything is loaded.

Nothing heavy is imported here, so that `--help` and a wrong argument answer at once.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

from .. import __version__, sample_scenes
from ..core.settings import QUALITY_ERRORS, RenderSettings
from .argument_types import count, positive, size_or_none
from .bake_arguments import add_bake_settings, check_attributes
from .farm_arguments import add_farm, border, finish_farm
from .outputs import OutputError, check_file, check_folder
from .sequence_arguments import add_sequence, frame, frame_range, sequence_settings

SCENE_SUFFIXES = (".blend", ".glb", ".gltf", ".obj")
SUITES = (  # of `bench`
    *("kernels", "clustering", "fuzzy", "vals", "topology", "previews", "radiosity", "curves", "peers", "lightmaps", "frames", "farm"),
    *("auto", "grid", "scaling", "stress", "skipping", "papers", "quick", "full"),
)
LARGEST_SIDE = 65_536  # pixels, Blender's own limit


@dataclass(frozen=True)
class OwnOption:
    """An option of one method, or of one suite of `bench`: its flag, the field or parameter that it sets, argparse's own keywords."""

    flag: str
    field: str
    keywords: dict


def resolution(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT in pixels."""
    match = re.fullmatch(r"(\d+)[xX](\d+)", text)
    sides = tuple(int(side) for side in match.groups()) if match else (0,)
    if not all(1 <= side <= LARGEST_SIDE for side in sides):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT with sides of 1 to {LARGEST_SIDE} pixels, as in 1280x720")
    return sides


def scene_source(text: str) -> str:
    """A scene file that exists, or the name of a sample scene."""
    if text in sample_scenes.NAMES:
        return text
    path = Path(text)
    if path.suffix.lower() not in SCENE_SUFFIXES:
        kinds = ", ".join(SCENE_SUFFIXES)
        raise argparse.ArgumentTypeError(
            f"{text!r} is neither a scene file ({kinds}) nor a sample scene ({', '.join(sample_scenes.NAMES)})"
        )
    if not os.path.isfile(text):
        raise argparse.ArgumentTypeError(f"there is no file {text!r}; check the path")
    return text


def image_file(text: str) -> Path:
    """A multilayer EXR file that exists."""
    if not os.path.isfile(text):
        raise argparse.ArgumentTypeError(f"there is no file {text!r}; check the path")
    return Path(text)


def output_file(*suffixes: str):
    """The type of an argument that names a file to be written, of one of `suffixes`."""

    def parse(text: str) -> Path:
        if Path(text).suffix.lower() not in suffixes:
            raise argparse.ArgumentTypeError(f"{text!r} does not end in {' or '.join(suffixes)}")
        return _checked(check_file, text)

    return parse


def output_folder(text: str) -> Path:
    """A folder to be written into, made where it is missing."""
    return _checked(check_folder, text)


def _checked(check, text: str) -> Path:
    try:
        return check(Path(text))
    except OutputError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


# The methods that exist, with the options that only they read.
METHOD_OPTIONS: dict[str, tuple[OwnOption, ...]] = {
    "instant-radiosity": (
        OwnOption(
            "--visibility",
            "visibility",
            {"choices": ("rays", "shadow-maps", "none"), "help": "how a VPL is tested for sight of a point (default: rays)"},
        ),
        OwnOption(
            "--no-compensation",
            "compensation",
            {"action": "store_const", "const": False, "help": "do not give back the light that the clamped geometry term loses"},
        ),
    ),
    "fuzzy-clustering": (
        OwnOption("--vpl-clusters", "vpl_clusters", {"type": count, "metavar": "K", "help": "clusters of VPLs (default: 1000)"}),
        OwnOption(
            "--point-clusters", "point_clusters", {"type": count, "metavar": "K", "help": "clusters of shading points (default: 8000)"}
        ),
        OwnOption(
            "--fuzziness",
            "fuzziness",
            {"type": count, "metavar": "F", "help": "clusters whose visibility a point blends, 1 for its own alone (default: 6)"},
        ),
        OwnOption(
            "--weighting",
            "weighting",
            {"choices": ("smooth", "distance", "plain"), "help": "of the blended clusters: by distance or all alike (default: smooth)"},
        ),
        OwnOption(
            "--shade-with",
            "shade_with",
            {
                "choices": ("clusters", "vpls"),
                "help": "one light a cluster, or every VPL with its cluster's visibility (default: clusters)",
            },
        ),
    ),
    "virtual-area-lights": (
        OwnOption("--vals", "vals", {"type": count, "metavar": "M", "help": "area lights (default: as many as the lighting needs)"}),
        OwnOption(
            "--interleave",
            "interleave",
            {
                "type": int,
                "choices": range(1, 9),
                "metavar": "I",
                "help": "I x I pixels share the VPLs, 1 to 8; 1 for all of them in every pixel (default: 8)",
            },
        ),
        OwnOption(
            "--soft-shadows",
            "soft_shadows",
            {"action": "store_const", "const": True, "help": "direct shadows of area lamps by soft shadow maps, too: no noise, less exact"},
        ),
    ),
    "visibility-gates": (
        OwnOption("--voxels", "voxels", {"type": count, "metavar": "R", "help": "voxels along the scene's longest side (default: 128)"}),
        OwnOption(
            "--outside",
            "outside",
            {"choices": ("closed", "open"), "help": "of the scene's bounding box, to the topology: solid or empty (default: closed)"},
        ),
        OwnOption(
            "--cutouts",
            "cutouts",
            {"action": "store_const", "const": True, "help": "cut-outs and glass are walls to the topology, too"},
        ),
        OwnOption(
            "--sheets",
            "sheets",
            {"choices": ("walls", "open"), "help": "thin ones that part no two rooms, as curtains, to the topology (default: walls)"},
        ),
        OwnOption(
            "--gates",
            "gates",
            {
                "choices": ("disks", "polygons", "off", "guided"),
                "help": "between visibility clusters; guided: shadow rays where topology and probes leave doubt (default: guided)",
            },
        ),
        OwnOption("--gate-size", "gate_size", {"type": positive, "metavar": "F", "help": "factor on the size of the gates (default: 1)"}),
        OwnOption(
            "--gate-filter",
            "gate_filter",
            {"type": size_or_none, "metavar": "V", "help": "voxels to blend over where visibility clusters meet, 0 for none (default: 4)"},
        ),
    ),
    "importance-sampling": (
        OwnOption("--samples", "samples", {"type": count, "metavar": "N", "help": "shadow rays a shading point (default: 8)"}),
        OwnOption("--gather", "gather", {"type": count, "metavar": "N", "help": "gather rays a shading point (default: 8)"}),
        OwnOption(
            "--no-light-groups",
            "light_groups",
            {"action": "store_const", "const": False, "help": "no layers of their own for the view layer's light groups"},
        ),
    ),
}

# What lightmaps have no use for: their texels are no pixels of a grid, and hold the light of all groups.
_OF_PICTURES = {"interleave", "light_groups"}

# Of more than one suite.
SIZE = OwnOption("--size", "size", {"type": resolution, "metavar": "WxH", "help": "pixels of the pictures"})
REFERENCE_SAMPLES = OwnOption("--reference-samples", "reference_samples", {"type": count, "metavar": "N", "help": "of each half"})

FRAMES = OwnOption("--frames", "frames", {"type": count, "metavar": "N", "help": "of a sequence"})

SAMPLES = OwnOption(
    "--spp",
    "spp",
    {
        "type": count,
        "nargs": "+",
        "metavar": "N",
        "help": "samples a pixel of Cycles and other peers (default: 4 16 64); 16 is always among them",
    },
)
REPEATS = OwnOption(
    "--repeats", "repeats", {"type": count, "metavar": "N", "help": "runs of each setting, each with its seed (default: 3)"}
)


def _scenes(default: str) -> OwnOption:
    return OwnOption("--scenes", "scenes", {"nargs": "+", "metavar": "SCENE", "help": f"(default: {default} that are there)"})


# The suites of `bench` that have options.
SUITE_OPTIONS: dict[str, tuple[OwnOption, ...]] = {
    "stress": (OwnOption("--random-scenes", "scenes", {"type": count, "metavar": "N", "help": "against a path tracer (default: 10000)"}),),
    "curves": (_scenes("atrium, corridor, cathedral, cornell, and the shared scenes"), SIZE, SAMPLES, REFERENCE_SAMPLES, REPEATS),
    "peers": (
        _scenes("atrium, cornell, and living-room-greywhite and sponza-crytek of the shared scenes"),
        SIZE,
        SAMPLES,
        REFERENCE_SAMPLES,
        REPEATS,
    ),
    "farm": (SIZE, FRAMES),
    "grid": (
        _scenes("as of curves, each with a size of its own where @WxH follows it; those"),
        SIZE,
        OwnOption("--targets", "targets", {"type": positive, "nargs": "+", "metavar": "E", "help": "relMSE (default: 0.05 0.02 0.01)"}),
        REFERENCE_SAMPLES,
        REPEATS,
    ),
    "frames": (
        SIZE,
        REFERENCE_SAMPLES,
        FRAMES,
        OwnOption("--moves", "moves", {"nargs": "+", "choices": ("camera", "lamp", "object"), "help": "(default: all)"}),
    ),
}


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line that ends in the way out."""

    def error(self, message: str):
        """Print `lumigate: error: ...` and exit with status 2."""
        self.exit(2, f"lumigate: error: {message} (see {self.prog} --help)\n")


def build_parser(*, scene_is_open: bool = False) -> Parser:
    """The parser of all commands; with `scene_is_open`, SCENE may be left out and means Blender's open file."""
    parser = Parser(prog="lumigate", description="Indirect light of Blender scenes by virtual point lights, written into image layers.")
    parser.add_argument("--version", action="version", version=f"lumigate {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    demo = commands.add_parser("demo", help="the built-in atrium: layers, pictures and figures")
    demo.add_argument("-o", "--output", type=output_folder, default="demo", metavar="DIR", help="where the files go (default: %(default)s)")
    demo.add_argument("--size", type=resolution, metavar="WxH", help="pixels of the pictures (default: 640x360)")

    render = commands.add_parser("render", help="a scene's indirect light into a multilayer EXR file")
    _add_scene(render, scene_is_open)
    _add_output(render, "OUT.exr")
    _add_view(render)
    _add_render_settings(render)
    render.add_argument(
        "--film",
        dest="scene_film",
        action="store_true",
        help="with the scene's pixel filter and transparency, instead of a box of one pixel",
    )
    add_sequence(render, output_file)
    render.add_argument("--stats", type=output_file(".json"), metavar="FILE.json", help="write times, ray counts and warnings")
    render.add_argument("--border", type=border, metavar="X0,Y0,X1,Y1", help="this part of the picture only, in pixels from the top left")
    render.add_argument("--tiles", type=count, metavar="N", help="in tiles of N pixels along a side: with the bits of a farm's")

    farm = commands.add_parser("farm", help="frames, tiles or lightmaps on many machines; takes the options of render and bake, too")
    _add_scene(farm, False)
    add_farm(farm, output_file, output_folder, resolution)

    reference = commands.add_parser("reference", help="the same layers by Cycles, to compare with")
    _add_scene(reference, scene_is_open)
    _add_output(reference, "REF.exr")
    _add_view(reference)
    reference.add_argument("--spp", type=count, default=1024, metavar="N", help="samples a pixel (default: %(default)s)")
    reference.add_argument(
        "--bounces", type=size_or_none, default=RenderSettings.bounces, metavar="B", help="diffuse bounces (default: %(default)s)"
    )
    reference.add_argument("--seed", type=size_or_none, default=0, metavar="S", help="random seed (default: %(default)s)")
    reference.add_argument("--denoise", action="store_true", help="denoise the layers with OpenImageDenoise")

    bake = commands.add_parser("bake", help="lightmaps of a scene's objects, on UV maps that are made where they are missing")
    _add_scene(bake, scene_is_open)
    bake.add_argument("-o", "--output", type=output_folder, required=True, metavar="DIR", help="where the lightmaps go")
    add_bake_settings(bake)
    _add_light_settings(bake, without=_OF_PICTURES)
    bake.add_argument("--stats", type=output_file(".json"), metavar="FILE.json", help="write times, ray counts and warnings")

    compare = commands.add_parser("compare", help="error of one picture against another")
    compare.add_argument("test", type=image_file, metavar="TEST.exr", help="the picture to judge")
    compare.add_argument("reference", type=image_file, metavar="REF.exr", help="the picture held to be true")
    compare.add_argument("--layer", default="Indirect", help="the layer to compare (default: %(default)s)")
    compare.add_argument(
        "--half", type=image_file, metavar="REF2.exr", help="an independent second reference (another --seed): errors net of their noise"
    )
    compare.add_argument(
        "--against", type=image_file, metavar="OTHER.exr", help="another picture: is it better or worse than TEST.exr, beyond chance?"
    )
    compare.add_argument("--json", type=output_file(".json"), metavar="FILE", help="write the figures")
    compare.add_argument("--error-map", type=output_file(".png"), metavar="PNG", help="write where the error is")

    inspect = commands.add_parser("inspect", help="what a scene holds, what will be skipped and why, before it is rendered")
    _add_scene(inspect, scene_is_open)
    _add_view(inspect)
    inspect.add_argument("--json", type=output_file(".json"), metavar="FILE", help="write the same as JSON")
    inspect.add_argument("--topology", action="store_true", help="also rooms, visibility clusters and gates of the empty space")
    inspect.add_argument(
        "--voxels",
        type=count,
        default=RenderSettings.voxels,
        metavar="R",
        help="of the topology, along the longest side (default: %(default)s)",
    )
    inspect.add_argument(
        "--outside", choices=("closed", "open"), default=RenderSettings.outside, help="as of render (default: %(default)s)"
    )
    inspect.add_argument("--cutouts", action="store_true", help="as of render")
    inspect.add_argument("--sheets", choices=("walls", "open"), default=RenderSettings.sheets, help="as of render (default: %(default)s)")
    inspect.add_argument(
        "--skeleton", type=output_file(".obj"), metavar="FILE.obj", help="write skeleton, balls of the clusters, and gates to look at"
    )

    bench = commands.add_parser("bench", help="speed and errors, measured on this machine; a run that was broken off goes on")
    bench.add_argument("suite", nargs="?", default=SUITES[0], choices=SUITES, metavar="SUITE", help="%(choices)s (default: %(default)s)")
    bench.add_argument("-o", "--output", type=output_folder, required=True, metavar="DIR", help="where results.json goes")
    for suite, options in SUITE_OPTIONS.items():
        _add_own(bench, suite, tuple(option for option in options if option.flag not in bench._option_string_actions))
    return parser


def _add_scene(parser: Parser, scene_is_open: bool) -> None:
    parser.add_argument(
        "scene",
        type=scene_source,
        metavar="SCENE",
        nargs="?" if scene_is_open else None,
        help=f"a {', '.join(SCENE_SUFFIXES)} file, or a sample scene: {', '.join(sample_scenes.NAMES)}",
    )


def _add_output(parser: Parser, name: str) -> None:
    parser.add_argument("-o", "--output", type=output_file(".exr"), required=True, metavar=name, help="the multilayer EXR file to write")


def _add_view(parser: Parser) -> None:
    parser.add_argument("--size", type=resolution, metavar="WxH", help="pixels of the full frame (default: the scene's)")
    parser.add_argument("--camera", metavar="NAME", help="the camera's object (default: the scene's)")
    frames = parser.add_mutually_exclusive_group()
    frames.add_argument("--frame", type=frame, metavar="F", help="the frame (default: the scene's current one)")
    if parser.prog.endswith("render"):
        frames.add_argument("--frames", type=frame_range, metavar="A-B[:STEP]", help="these frames; OUT.exr becomes OUT0001.exr and so on")


def _add_render_settings(parser: Parser) -> None:
    """The fields of `RenderSettings`; what the user does not give stays out of the namespace, and its default with the class."""
    add = parser.add_argument
    default = RenderSettings()
    keep = {"default": argparse.SUPPRESS}
    _add_light_settings(parser)
    add(
        "--pixel-samples",
        type=count,
        metavar="P",
        **keep,
        help=f"primary samples a pixel, half as many where all is even, up to twice as many elsewhere (default: {default.pixel_samples})",
    )
    add(
        "--downsampling",
        type=count,
        metavar="N",
        **keep,
        help="light a picture N times smaller along each side and spread its light by what every pixel sees, for previews without a time "
        f"or an error to reach (default: {default.downsampling}, every pixel is lit)",
    )
    budget = parser.add_mutually_exclusive_group()
    budget.add_argument("--time-budget", type=positive, metavar="SECONDS", **keep, help="use as many samples as fit in this time")
    budget.add_argument("--target-error", type=positive, metavar="E", **keep, help="stop at this relMSE")
    names = ", ".join(f"{name} {error:g}" for name, error in QUALITY_ERRORS.items())
    budget.add_argument("--quality", choices=tuple(QUALITY_ERRORS), **keep, help=f"of --method auto: the target error by name ({names})")
    add("--debug-layers", action="store_true", **keep, help="also write clusters, gates and the light of single VPLs")


def _add_light_settings(parser: Parser, without: Collection[str] = ()) -> None:
    """The fields of `RenderSettings` that say how light is found, whatever is lit; without: those that are left out."""
    add = parser.add_argument
    default = RenderSettings()
    keep = {"default": argparse.SUPPRESS}
    add("--method", choices=("auto", *METHOD_OPTIONS), **keep, help=f"how the light is gathered (default: {default.method})")
    add("--vpls", type=count, metavar="N", **keep, help=f"virtual point lights (default: {default.vpls})")
    add("--bounces", type=size_or_none, metavar="B", **keep, help=f"diffuse bounces of the indirect light (default: {default.bounces})")
    add("--seed", type=size_or_none, metavar="S", **keep, help=f"random seed (default: {default.seed})")
    add("--threads", type=size_or_none, metavar="T", **keep, help="threads (default: all cores)")
    add("--denoise", action=argparse.BooleanOptionalAction, **keep, help="denoise the light (default: as the method needs)")
    for method, options in METHOD_OPTIONS.items():
        _add_own(parser, f"--method {method}", tuple(option for option in options if option.field not in without))


def _add_own(parser: Parser, owner: str, options: tuple[OwnOption, ...]) -> None:
    """A group of options that stay out of the namespace where they are not given."""
    group = parser.add_argument_group(owner)
    for option in options:
        group.add_argument(option.flag, dest=option.field, default=argparse.SUPPRESS, **option.keywords)


def _render_settings(parser: Parser, given: dict) -> RenderSettings:
    """The request that the parsed options make.

    An option that only one method reads chooses that method; beside the name of another one it is an error.
    """
    settings = RenderSettings(**{name: given[name] for name in RenderSettings.__dataclass_fields__ if name in given})
    for method, options in METHOD_OPTIONS.items():
        for option in options:
            if option.field not in given:
                continue
            if settings.method == "auto":
                settings = replace(settings, method=method)
            elif settings.method != method:
                parser.error(f"{option.flag} belongs to --method {method}, not to {settings.method}")
    if settings.quality is not None and settings.method != "auto":
        parser.error(f"--quality belongs to --method auto, not to {settings.method}; give it a --target-error")
    return settings


def _check_topology(parser: Parser, arguments: argparse.Namespace) -> None:
    """Options of the topology need it to be asked for."""
    changed = {
        "--voxels": arguments.voxels != RenderSettings.voxels,
        "--outside": arguments.outside != RenderSettings.outside,
        "--cutouts": arguments.cutouts,
        "--sheets": arguments.sheets != RenderSettings.sheets,
    }
    flag = next((flag for flag, given in changed.items() if given), None)
    if flag and not arguments.topology and arguments.skeleton is None:
        parser.error(f"{flag} belongs to --topology or --skeleton FILE.obj")


def _suite_options(parser: Parser, given: dict) -> dict:
    """What the user gave of the suite's own options; one of another suite is an error."""
    own = {option.field for option in SUITE_OPTIONS.get(given["suite"], ())}
    for suite, options in SUITE_OPTIONS.items():
        for option in options:
            if option.field in given and option.field not in own:
                parser.error(f"{option.flag} belongs to bench {suite}, not to bench {given['suite']}")
    return {field: given[field] for field in own if field in given}


def parse(argv: list[str] | None = None, *, in_blender: bool = False) -> argparse.Namespace:
    """Parse the command line into `command`, that command's arguments and, for `render`, its `settings`, for `bench` the suite's `options`.

    argv: None takes the process's own.  in_blender: Blender runs this, so that its own arguments come first, up to `--`,
    and SCENE may be left out.  Raises SystemExit, with the line printed, where the arguments are wrong.
    """
    if argv is None:
        own = sys.argv.index("--") if in_blender and "--" in sys.argv else 0
        argv = sys.argv[own + 1 :]
    parser = build_parser(scene_is_open=in_blender)
    arguments, rest = parser.parse_known_args(argv)
    if rest and arguments.command != "farm":
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    if arguments.command == "bake" and arguments.gltf and arguments.content != "full":
        parser.error("--gltf needs --content full: glTF knows no lightmaps, so that their light shines from the materials")
    if arguments.command == "bake":
        check_attributes(parser, arguments)
    if arguments.command == "inspect":
        _check_topology(parser, arguments)
    if arguments.command in ("render", "bake"):
        arguments.settings = _render_settings(parser, vars(arguments))
    if arguments.command == "render":
        arguments.sequence = sequence_settings(parser, arguments)
        if arguments.tiles is not None and arguments.frames is not None:
            parser.error("--tiles is for one still, not for --frames")
    if arguments.command == "farm":
        finish_farm(parser, arguments, rest, parse)
    if arguments.command == "bench":
        arguments.options = _suite_options(parser, vars(arguments))
    return arguments
