"""`lumigate bench`: speed of the parts, and time against error, measured on this machine."""

from __future__ import annotations

import platform
from argparse import Namespace
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

from rich.markup import escape
from rich.table import Table

from ... import __version__
from ...core.threads import thread_count
from ..bench_report import write_report
from ..bench_steps import run_steps
from ..bench_suites import STEPS
from ..console import Terminal
from ..curves_bench import METRICS, OPPOSITE, curves_summary
from ..grid_bench import grid_summary
from ..peers.suite import peers_summary
from ..results import write_json

PACKAGES = ("bpy", "numpy", "numba", "llvmlite", "scipy", "embreex", "OpenImageIO")
PEER_PACKAGES = ("mitsuba", "pyluxcore")  # noted where they are


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Run one suite, print its rows and write DIR/results.json, rows.csv and report.md; steps that DIR holds already are kept."""
    folder = arguments.output
    steps = STEPS[arguments.suite](folder, **arguments.options)
    identity = {"machine": machine(), "versions": versions(), "suite": arguments.suite, "options": arguments.options}
    with terminal.progress() as progress:
        rows = run_steps(steps, folder, identity, progress, terminal.say)
    rows += curves_summary(folder, rows) + grid_summary(rows)
    peers_summary(folder, rows)
    results = {"machine": identity["machine"], "versions": identity["versions"], "rows": rows}
    write_json(folder / "results.json", results)
    write_report(folder, arguments.suite, results)
    for suite in dict.fromkeys(row["suite"] for row in rows):
        terminal.out.print(_table(suite, [row for row in rows if row["suite"] == suite]))


def _table(suite: str, rows: list[dict]) -> Table:
    """Rows of one suite: cases and values, what must hold of them, or the points of curves of time against error."""
    if "must" in rows[0]:
        return _verdicts(suite, rows)
    headings = (
        ("case", "value", "unit", "peer", "ratio") if "case" in rows[0] else ("scene", "layer", "method", "setting", "seconds", *METRICS)
    )
    table = Table(title=suite, title_justify="left")
    for heading in headings:
        table.add_column(heading, justify="left" if heading in ("case", "unit", "scene", "layer", "method", "setting") else "right")
    for row in rows:
        table.add_row(*(_case(row) if "case" in row else (escape(_figure(row[name])) for name in headings)))
    return table


def _verdicts(suite: str, rows: list[dict]) -> Table:
    """Rows of which each says what must hold; the title counts those that do not."""
    failed = sum(not row["pass"] for row in rows)
    table = Table(title=f"{suite}: {len(rows)} cases, {failed} failed", title_justify="left")
    for heading in ("case", "method", "must hold", "measured", "pass"):
        table.add_column(heading, justify="right" if heading == "measured" else "left")
    for row in rows:
        cells = row["case"], row["method"], row["must"], _figure(row["value"]), "yes" if row["pass"] else "NO"
        table.add_row(*map(escape, cells))
    return table


def _case(row: dict) -> tuple[str, ...]:
    """Cells of a row with a value; what is more or less than the value's figure makes the ratio less or more."""
    bound = row.get("bound", "")
    bounds = {"value": bound, "peer_value": row.get("peer_bound", ""), "ratio": row.get("ratio_bound", OPPOSITE.get(bound, bound))}
    value, peer, ratio = (f"{bounds[name]} {_figure(row[name])}".strip() if name in row else "" for name in bounds)
    return escape(row["case"]), value, row["unit"], peer, ratio


def _figure(value) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)


def machine() -> dict:
    """What the figures depend on."""
    return {"system": platform.platform(), "processor": _processor(), "threads": thread_count()}


def versions() -> dict:
    """Versions of this package, Python, what the kernels stand on, and the other renderers that are installed."""
    found = {"lumigate": __version__, "python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
    for name in PEER_PACKAGES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
