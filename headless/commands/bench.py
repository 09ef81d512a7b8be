"""`lumigate bench`: speed of the parts, measured on this machine."""

from __future__ import annotations

import platform
from argparse import Namespace
from importlib.metadata import version

from rich.markup import escape
from rich.table import Table

from ... import __version__
from ...core.threads import thread_count
from ..clustering_bench import clustering_rows
from ..console import Terminal
from ..fuzzy_bench import fuzzy_rows
from ..kernel_bench import ray_rows
from ..preview_bench import preview_rows
from ..results import write_json

# Keys as in `arguments.SUITES`.
ROWS = {"kernels": ray_rows, "clustering": clustering_rows, "fuzzy": fuzzy_rows, "previews": preview_rows}
PACKAGES = ("bpy", "numpy", "numba", "llvmlite", "scipy", "embreex", "OpenImageIO")


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Run one suite, print its rows and write DIR/results.json."""
    with terminal.waiting(f"bench {arguments.suite}"):
        rows = ROWS[arguments.suite]()
    arguments.output.mkdir(parents=True, exist_ok=True)
    write_json(arguments.output / "results.json", {"machine": machine(), "versions": versions(), "rows": rows})
    table = Table(title=arguments.suite, title_justify="left")
    for heading, justify in (("case", "left"), ("value", "right"), ("unit", "left"), ("peer", "right"), ("ratio", "right")):
        table.add_column(heading, justify=justify)
    for row in rows:
        peer = [f"{row[name]:.4g}" if name in row else "" for name in ("peer_value", "ratio")]
        table.add_row(escape(row["case"]), f"{row['value']:.4g}", row["unit"], *peer)
    terminal.out.print(table)


def machine() -> dict:
    """What the figures depend on."""
    return {"system": platform.platform(), "processor": _processor(), "threads": thread_count()}


def versions() -> dict:
    """Versions of this package, Python and what the kernels stand on."""
    return {"lumigate": __version__, "python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
