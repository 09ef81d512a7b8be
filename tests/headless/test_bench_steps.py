"""Benchmarks that were broken off, and what they leave."""

import json

import numpy as np
import pytest

from lumigate.core.pipeline import render
from lumigate.core.settings import RenderSettings
from lumigate.headless.bench_report import report, table, write_report
from lumigate.headless.bench_steps import Step, run_steps
from lumigate.headless.bench_suites import STEPS
from lumigate.headless.scaling_bench import resized, scaling_steps, with_bumps, with_lamps
from lumigate.headless.sources import extract, open_source

ROW = {"suite": "scaling", "case": "lamps 1", "value": 2.0, "unit": "s", "axis": "lamps", "x": 1, "relative": 1.0}


def suite(calls, broken=False):
    """Two steps that count their calls, the second of which breaks off."""

    def work(name):
        if broken and name == "b":
            raise KeyboardInterrupt
        calls.append(name)
        return [ROW | {"case": name}]

    return [Step(name, lambda name=name: work(name)) for name in "ab"]


def test_a_run_that_was_broken_off_goes_on(tmp_path):
    calls, said = [], []
    with pytest.raises(KeyboardInterrupt):
        run_steps(suite(calls, broken=True), tmp_path, {"version": 1})
    rows = run_steps(suite(calls), tmp_path, {"version": 1}, note=said.append)
    assert calls == ["a", "b"]
    assert [row["case"] for row in rows] == ["a", "b"]
    assert len(said) == 1 and said[0].startswith("a: kept")


def test_rows_of_another_machine_or_a_torn_file_are_measured_again(tmp_path):
    calls = []
    run_steps(suite(calls), tmp_path, {"version": 1})
    run_steps(suite(calls), tmp_path, {"version": 2})
    for path in tmp_path.glob("steps/*.json"):
        path.write_text(path.read_text()[:20])
    run_steps(suite(calls), tmp_path, {"version": 2})
    assert calls == ["a", "b"] * 3


def test_progress_is_that_of_the_steps(tmp_path):
    seen = []
    run_steps(suite([]), tmp_path, {}, lambda stage, fraction: seen.append((stage, fraction)) or True)
    assert seen == [("a (1 of 2)", 0.0), ("b (2 of 2)", 0.5)]


@pytest.mark.parametrize("name", ["quick", "full", "papers", "scaling", "auto", "grid"])
def test_steps_have_names_of_their_own(name, tmp_path):
    steps = STEPS[name](tmp_path)
    assert len({step.name for step in steps}) == len(steps) > 1


def test_report_has_a_table_for_each_suite_and_the_plot(tmp_path):
    rows = [ROW, ROW | {"case": "lamps 4", "x": 4, "value": 3.0, "relative": 1.5}]
    rows.append({"suite": "time-to-error", "case": "a | b", "value": 1.0, "unit": "s", "bound": "more than"})
    write_report(tmp_path, "scaling", {"machine": {"threads": 2}, "versions": {"python": "3"}, "rows": rows})
    page = (tmp_path / "report.md").read_text()
    assert "![scaling.png](scaling.png)" in page and (tmp_path / "scaling.png").stat().st_size > 5000
    assert "| lamps 4 | 3 | s |" in page and "| a \\| b | more than 1 | s |" in page
    lines = (tmp_path / "rows.csv").read_text().splitlines()
    assert lines[0].startswith("suite,case,value") and len(lines) == 4


def test_report_of_curves_names_method_and_setting():
    row = {
        "suite": "curves",
        "scene": "cornell",
        "layer": "Indirect",
        "method": "cycles",
        "setting": "4 spp",
        "seconds": 1.0,
        "relmse": 0.5,
    }
    assert "| cornell | Indirect | cycles | 4 spp | 1 | 0.5 |" in report("curves", {"machine": {}, "versions": {}, "rows": [row]}, [])
    assert table([row, {"suite": "x", "more": 1}]).splitlines()[0].endswith(",relmse,more")


@pytest.fixture(scope="module")
def cornell():
    return extract(open_source("cornell"), camera=None, size=(16, 9), frame=None)


def test_scaled_scenes_are_rendered(cornell):
    bumps, lamps = with_bumps(cornell, 5000), with_lamps(cornell, 7)
    assert abs(len(bumps.geometry.triangles) - len(cornell.geometry.triangles) - 5000) < 100
    assert len(lamps.lamps) == 7 and (resized(cornell, 8, 4).camera.border, 8) == ((0, 0, 8, 4), 8)
    settings = RenderSettings(vpls=64, pixel_samples=1, denoise=False)
    plain, bumpy = (render(scene, settings).layers for scene in (cornell, bumps))
    assert not np.array_equal(plain["Depth"], bumpy["Depth"])  # the sheet is in the picture
    assert render(lamps, settings).layers["Indirect"].mean() > 0


def test_scaling_has_a_row_for_each_case():
    steps = {step.name: step for step in scaling_steps(lamps=(1, 3), repeats=1)}
    rows = steps["scaling lamps"].work()
    assert [(row["axis"], row["x"]) for row in rows] == [("lamps", 1), ("lamps", 3)]
    assert rows[0]["relative"] == 1 and all(row["value"] > 0 for row in rows)
    json.dumps(rows)
