"""What a benchmark leaves beside its JSON: all rows as CSV, plots of how it scales, and a report of one page."""

from __future__ import annotations

import csv
import importlib.util
import io
from itertools import cycle
from pathlib import Path

from ..core.layers import write_whole

MARKERS = "osD^v"  # told apart in grey, too


def write_report(folder: Path, suite: str, results: dict) -> None:
    """`rows.csv`, `scaling.png` where there is something to plot, and `report.md`; results: of results.json."""
    rows = results["rows"]
    _write(folder / "rows.csv", table(rows))
    if importlib.util.find_spec("matplotlib") and any(row["suite"] == "scaling" for row in rows):
        plot_scaling(folder / "scaling.png", rows)
    plots = [path.name for path in sorted(folder.glob("*.png")) if path.name.startswith(("curves-", "peers-", "scaling"))]
    _write(folder / "report.md", report(suite, results, plots))


def table(rows: list[dict]) -> str:
    """Rows as CSV: a column for each key of any of them, in the order in which they come."""
    keys = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, keys, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def report(suite: str, results: dict, plots: list[str]) -> str:
    """One page in Markdown: the machine, the plots, and a table a suite."""
    rows = results["rows"]
    facts = {**results["machine"], **results["versions"]}
    lines = [f"# lumigate bench {suite}", "", ", ".join(f"{name} {value}" for name, value in facts.items()), ""]
    lines += [line for name in plots for line in (f"![{name}]({name})", "")]
    for name in dict.fromkeys(row["suite"] for row in rows):
        own = [row for row in rows if row["suite"] == name]
        columns = _OWN.get(name) or (_VERDICTS if "must" in own[0] else _CASES if "case" in own[0] else _CURVES)
        lines += [f"## {name}", "", "| " + " | ".join(columns) + " |", "| " + " | ".join("---" for _ in columns) + " |"]
        lines += ["| " + " | ".join(_cell(row, column) for column in columns) + " |" for row in own]
        lines.append("")
    return "\n".join(lines)


_CASES = ("case", "value", "unit", "peer_value", "ratio")
_VERDICTS = ("case", "method", "must", "value", "pass")
_CURVES = ("scene", "layer", "method", "setting", "seconds", "relmse", "bias", "flip")
# Suites whose cases are more than a line: seconds of `auto` are their value, those of the best setting the peer's.
_OWN = {
    "auto-to-best": ("scene", "unseen", "target", "value", "relmse", "kept", "peer_value", "setting", "setting_relmse", "least", "ratio")
}


_BOUNDS = {"value": "bound", "peer_value": "peer_bound", "ratio": "ratio_bound"}


def _cell(row: dict, column: str) -> str:
    value = row.get(column)
    bound = row.get(_BOUNDS.get(column), "")
    bound = f"{bound} " if bound else ""
    text = f"{value:.3g}" if isinstance(value, float) else "" if value is None else str(value)
    return (bound + text).replace("|", "\\|")


def plot_scaling(path: Path, rows: list[dict]) -> None:
    """Seconds by the value of each axis, relative to its first case, all logarithmic; the dashed line is proportional growth."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 4), layout="constrained")
    axes = figure.add_subplot()
    scaling = [row for row in rows if row["suite"] == "scaling"]
    for axis, marker in zip(dict.fromkeys(row["axis"] for row in scaling), cycle(MARKERS)):
        own = [row for row in scaling if row["axis"] == axis]
        times = [row["x"] / own[0]["x"] for row in own]
        axes.plot(
            times, [row["relative"] for row in own], marker=marker, markersize=4, linewidth=1.2, label=f"{axis} (from {own[0]['x']:,})"
        )
    most = max(row["x"] / next(r["x"] for r in scaling if r["axis"] == row["axis"]) for row in scaling)
    axes.plot([1, most], [1, most], "k--", linewidth=0.8, label="proportional")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="times as many",
        ylabel="seconds, relative",
        ylim=(0.3, 1.5 * max(r["relative"] for r in scaling)),
    )
    axes.grid(True, which="major", linewidth=0.4, color="0.8")
    axes.legend(fontsize=8)
    write_whole(path, lambda partial: figure.savefig(partial, dpi=150))


def _write(path: Path, text: str) -> None:
    write_whole(path, lambda partial: partial.write_text(text, encoding="utf-8"))
