"""`lumigate inspect`: what a scene holds, what will be skipped and why, and what will be wrong."""

from __future__ import annotations

from argparse import Namespace

from rich.markup import escape
from rich.table import Table

from ...core.inspection import contents, foresee
from ...core.lamps import build_emitters
from ...core.memory import estimate
from ...core.pipeline import glance
from ...core.scene import Scene
from ...core.settings import RenderSettings
from ...core.soundness import sound
from ...core.topology import Topology
from ..console import Terminal
from ..results import write_json
from ..sources import extract, open_source
from ..topology_files import StoredTopologies, summary, write_obj


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Print the report, and write it as JSON where asked."""
    source = open_source(arguments.scene)
    scene = extract(source, camera=arguments.camera, size=arguments.size, frame=arguments.frame)
    topology = None
    if arguments.topology or arguments.skeleton is not None:
        with terminal.waiting("topology"):
            space = {"closed": arguments.outside == "closed", "cutouts": arguments.cutouts, "sheets": arguments.sheets == "walls"}
            topology = StoredTopologies().of(scene, arguments.voxels, **space)
    report = inspect(scene, topology)
    if topology is not None:
        report["topology"] = summary(topology)
    if arguments.skeleton is not None:
        write_obj(arguments.skeleton, topology, scene.origin)
    _print(report, arguments.scene or source.name, terminal)
    if arguments.json is not None:
        write_json(arguments.json, report)


def inspect(scene: Scene, topology: Topology | None = None) -> dict:
    """`core.inspection.contents` of `scene`, what a render with all defaults takes and saves, and `skipped` and `warnings` as in `--stats`.

    topology: of the scene, where it is wanted: what it leaves out is then told, too.
    """
    request = RenderSettings().with_defaults()
    scene = sound(scene)
    emitters = build_emitters(scene)
    skipped, warnings = foresee(scene, emitters)
    return {
        **contents(scene, emitters),
        "memory_mib": estimate(scene, request) / 2**20,
        "savings": glance(scene, request, topology),
        "skipped": [vars(s) for s in (*scene.skipped, *skipped)],
        "warnings": [*scene.warnings, *warnings],
    }


def _print(report: dict, title: str, terminal: Terminal) -> None:
    materials, textures, world, camera = (report[name] for name in ("materials", "textures", "world", "camera"))
    lamps = ", ".join(f"{count} {kind}" for kind, count in report["lamps"].items() if count) or "none"
    image = "x".join(map(str, world["image"])) + " pixels" if world["image"] != [1, 1] else "one colour"
    rows = {
        "triangles": f"{report['triangles']:,} in {report['instances']:,} instances of {report['objects']:,} objects, {report['geometry_mib']:.0f} MiB",
        "extent": " x ".join(f"{side:.3g}" for side in report["extent_m"]) + " m",
        "materials": f"{materials['count']} ({materials['textured']} textured, {materials['emissive']} emissive, {materials['transparent']} transparent)",
        "textures": f"{textures['count']}, {textures['mib']:.0f} MiB",
        "lamps": f"{lamps}; {report['emissive_triangles']:,} emissive triangles",
        "world": f"{image}, mean radiance " + " ".join(f"{value:.3g}" for value in world["mean_radiance"]),
        "light": " ".join(f"{value:.3g}" for value in report["flux_w"]) + " W into the scene (red, green, blue)",
        "memory": f"about {report['memory_mib'] / 1024:.2g} GiB for a render with the defaults",
        "camera": f"{camera['name']}, {camera['kind']}, {camera['size'][0]}x{camera['size'][1]} pixels",
    }
    if "topology" in report:
        rows |= _topology_rows(report["topology"])
    table = Table(title=escape(title), show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column()
    for name, text in rows.items():
        table.add_row(name, escape(text))
    terminal.out.print(table)
    for heading, lines in (
        ("will be skipped", [f"{s['stage']}: {s['reason']}" for s in report["skipped"]]),
        ("will be saved", [f"{s['stage']}: {s['what']} ({100 * s['share']:.0f} % of the stage)" for s in report["savings"]]),
        ("will be wrong", report["warnings"]),
    ):
        terminal.out.print(f"{heading}:" if lines else f"{heading}: nothing", style="bold")
        for line in lines:
            terminal.out.print(f"  {line}", markup=False, soft_wrap=True)


def _topology_rows(topology: dict) -> dict[str, str]:
    """Lines of the report for `core.topology`."""
    skeleton, gates = topology["skeleton"], topology["gates"]
    largest = ", ".join(f"{volume:.3g}" for volume in topology["room_m3"][:5])
    return {
        "voxels": f"{'x'.join(map(str, topology['voxels']))} of {topology['voxel_m']:.3g} m; {topology['empty_m3']:.3g} m3 are empty",
        "rooms": f"{topology['rooms']:,} pieces of empty space that nothing joins; the largest: {largest} m3",
        "skeleton": f"{skeleton['nodes']:,} nodes, {skeleton['segmented_nodes']:,} of them segmented, with {skeleton['segmented_edges']:,} edges",
        "visibility clusters": f"{topology['visibility_clusters']:,}",
        "visibility gates": f"{gates['disks']:,} disks on edges of the skeleton; {gates['polygons']:,} polygons round openings",
    }
