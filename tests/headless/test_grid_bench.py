"""`auto` beside a grid of single settings: what counts as the best one, what need not be measured, and that a small run leaves what it says."""

import json
from functools import partial

import numpy as np
import pytest

from lumigate.core.errors import SceneError
from lumigate.core.settings import RenderSettings
from lumigate.headless.bench_report import report
from lumigate.headless.bench_suites import STEPS
from lumigate.headless.cli import main
from lumigate.headless.grid_bench import (
    GRID,
    Candidate,
    Noise,
    Setting,
    best,
    climb,
    grid_steps,
    grid_summary,
    is_unseen,
    ratio_row,
    repeat,
    sized,
)
from lumigate.headless.sources import find_scene

TARGETS = (0.05, 0.02, 0.01)


def setting(method, name="1"):
    return Setting(method, name, RenderSettings())


def candidate(method, seconds, *errors, name="1"):
    """Of one run for each error, in as many seconds each, or in those of a list."""
    seconds = seconds if isinstance(seconds, list) else [seconds] * len(errors)
    return Candidate(setting(method, name), list(seconds), [{"relmse": error} for error in errors])


def measured(figures):
    """A `Measure` that adds runs of (seconds, relMSE) by the setting's name, each list's last one again and again, and notes whose turn it was."""
    turns = []

    def measure(one):
        runs = figures[one.setting.name]
        seconds, error = runs[min(len(one.seconds), len(runs) - 1)]
        one.seconds.append(seconds)
        one.errors.append({"relmse": error})
        turns.append(one.setting.name)

    return measure, turns


def test_the_best_is_the_quickest_that_reaches_the_target():
    quick, right, slow = candidate("a", 1.0, 0.021), candidate("b", 2.0, 0.02), candidate("c", 3.0, 0.001)
    assert best([slow, quick, right], 0.02) is right  # not the quickest, nor the one with the least error
    assert best([slow, quick, right], 0.05) is quick
    assert best([slow, quick, right], 0.01) is slow
    assert best([slow, quick, right], 0.0005) is None


def test_medians_decide():
    lucky, steady = candidate("a", [1.0, 1.0, 1.0], 0.01, 0.03, 0.03), candidate("b", [2.0, 1.0, 9.0], 0.019, 0.019, 0.5)
    assert best([lucky, steady], 0.02) is steady and steady.time == 2.0


def test_a_ladder_is_left_where_all_targets_are_reached():
    measure, turns = measured({"1": [(1.0, 0.03)], "2": [(2.0, 0.009)], "4": [(4.0, 0.0079)], "8": [(8.0, 0.004)]})
    found = []
    reason = climb([setting("a", name) for name in "1248"], found, TARGETS, measure)
    assert turns == ["1", "2", "4"]  # .009 is too near .01 to rest on one run
    assert "left out: 8" in reason and [c.setting.name for c in found] == turns


def test_a_ladder_is_left_where_it_is_slower_than_the_best_of_every_target():
    done = [candidate("a", 1.0, 0.04), candidate("a", 2.0, 0.016), candidate("a", 4.0, 0.008)]
    measure, turns = measured({"1": [(5.9, 0.04)], "2": [(6.1, 0.03)], "4": [(20.0, 0.02)]})
    assert "6.1 s" in climb([setting("b", name) for name in "124"], list(done), TARGETS, measure)
    assert turns == ["1", "2"]  # 5.9 s is within the noise of 4 s
    # Where no setting reaches the smallest target, or one by a hair in its one run, none is too slow.
    for found in (done[:2], [*done[:2], candidate("a", 4.0, 0.0099)]):
        measure, turns = measured({"1": [(5.9, 0.04)], "2": [(60.0, 0.03)], "4": [(200.0, 0.02)]})
        assert climb([setting("b", name) for name in "124"], list(found), TARGETS, measure) is None and turns == ["1", "2", "4"]


def test_a_ladder_is_left_where_no_more_samples_reach_the_largest_target():
    measure, turns = measured({"1": [(1.0, 3.1)], "2": [(2.0, 0.41)], "4": [(4.0, 0.3)]})
    assert "too far" in climb([setting("b", name) for name in "124"], [], TARGETS, measure)
    assert turns == ["1", "2"]
    measure, turns = measured({"1": [(1.0, 0.39)], "2": [(2.0, 0.04)]})
    assert climb([setting("b", name) for name in "12"], [], TARGETS, measure) is None and turns == ["1", "2"]  # it did


def test_only_what_may_win_is_measured_again():
    figures = {
        "auto": [(3.0, 0.01)],
        "near": [(1.0, 0.0124), (1.0, 0.009)],  # reaches .01 from the second run on
        "best": [(2.0, 0.009)],
        "far": [(1.0, 0.06)],
        "slow": [(3.1, 0.001)],
        "close": [(2.9, 0.001)],
    }
    measure, turns = measured(figures)
    auto, *found = [Candidate(setting("auto" if name == "auto" else "a", name)) for name in figures]
    for one in (auto, *found):
        measure(one)
    turns.clear()
    repeat([auto], found, (0.01,), 3, measure)
    assert turns[:4] == ["auto", "near", "best", "close"]  # in turns
    assert "far" not in turns and "slow" not in turns
    runs = {one.setting.name: len(one.seconds) for one in found}
    assert runs["near"] == 3 and best(found, 0.01).setting.name == "near"


def test_what_becomes_the_best_late_has_all_its_runs():
    figures = {"lucky": [(1.0, 0.009), (1.0, 0.02)], "true": [(4.0, 0.008)]}
    measure, _ = measured(figures)
    found = [Candidate(setting("a", name)) for name in figures]
    for one in found:
        measure(one)
    repeat([], found, (0.01,), 3, measure)
    won = best(found, 0.01)
    assert won.setting.name == "true" and len(won.seconds) == 3


def test_auto_is_measured_again_only_where_a_ratio_may_come_of_it():
    figures = {"0.05": [(1.0, 0.03)], "0.02": [(2.0, 0.04)], "0.01": [(9.0, 0.011)], "1": [(1.0, 0.018)]}
    measure, turns = measured(figures)
    autos = [Candidate(setting("auto", name)) for name in ("0.05", "0.02", "0.01")]
    found = [Candidate(setting("a"))]
    for one in (*autos, *found):
        measure(one)
    turns.clear()
    repeat(autos, found, TARGETS, 3, measure)
    assert turns == ["0.05", "1"] * 2  # .04 is twice its target; no setting is near .01


def test_auto_is_held_against_the_best():
    found = [candidate("importance-sampling", 2.0, 0.019, name="quality 0.25"), candidate("fuzzy-clustering", 1.5, 0.03)]
    row = ratio_row("shop", True, 0.02, candidate("auto", 3.0, 0.029), found, [], Noise(0.5, 0.001))
    assert row["ratio"] == 1.5 and row["kept"] and row["setting"] == "importance-sampling, quality 0.25"
    assert "unseen" in row["case"] and "by the noise" not in row["case"] and not row["least"]
    lost = ratio_row("shop", True, 0.02, candidate("auto", 1.0, 0.031), found, [found[0].setting], Noise(0.5, 0.003))
    assert "ratio" not in lost and lost["peer_value"] == 2.0 and not lost["kept"]  # a target missed is no time won
    assert "more than 1.5 times" in lost["case"] and "+- 0.003 by the noise" in lost["case"] and "the least of its numbers" in lost["case"]
    none = ratio_row("shop", False, 0.01, candidate("auto", 9.0, 0.009), found, [], Noise(0.0, 0.0))
    assert (
        "peer_value" not in none
        and "ratio" not in none
        and "no setting reaches it (importance-sampling, quality 0.25: 0.019" in none["case"]
    )


def test_verdicts_are_of_median_worst_and_missed_targets():
    def row(scene, ratio, unseen):
        return {
            "suite": "auto-to-best",
            "scene": scene,
            "unseen": "unseen" if unseen else "seen",
            "kept": True,
            "peer_value": 1.0,
            "ratio": ratio,
        }

    rows = [row("a", 1.0, False), row("a", 1.1, False), row("b", 1.2, True), row("b", 2.1, True)]
    missed = {key: value for key, value in row("b", 0.0, True).items() if key != "ratio"} | {"kept": False}
    verdicts = {v["case"]: (v["value"], v["pass"]) for v in grid_summary([*rows, missed])}
    assert verdicts["all: 2 scenes, median of 4 ratios"] == (pytest.approx(1.15), True)
    assert verdicts["all: 2 scenes, worst of 4 ratios"] == (2.1, False)
    assert verdicts["unseen: 1 scenes, median of 2 ratios"] == (pytest.approx(1.65), False)
    assert verdicts["seen: 1 scenes, worst of 2 ratios"] == (1.1, True)
    assert [value for case, value in verdicts.items() if "misses" in case] == [(1, False), (1, False), (0, True)]
    assert grid_summary([{"suite": "curves"}]) == []


def test_scenes_have_sizes_of_their_own(tmp_path):
    assert sized("cornell@18x12", (32, 18)) == ("cornell", (18, 12)) and sized("a@b.blend", (32, 18)) == ("a@b.blend", (32, 18))
    with pytest.raises(SceneError, match="nowhere"):
        grid_steps(("cornell", "nowhere@8x8"))
    own = tmp_path / "shop.blend"
    own.touch()
    assert is_unseen(str(own)) and not is_unseen("cornell")
    shared = find_scene("living-room-greywhite")
    assert shared is None or not is_unseen(shared)


def test_the_grid_has_all_methods_from_the_least_numbers_up():
    assert [ladder[0].method for ladder in GRID] == [
        "importance-sampling",
        "fuzzy-clustering",
        "virtual-area-lights",
        "visibility-gates",
        "instant-radiosity",
    ]
    for ladder in GRID:
        assert len({rung.name for rung in ladder}) == len(ladder) and all(rung.settings.method == rung.method for rung in ladder)
        costs = [rung.settings.vpls * rung.settings.pixel_samples / rung.settings.interleave**2 for rung in ladder]
        assert costs == sorted(costs) and all(rung.settings.denoise for rung in ladder)


def test_a_small_run_leaves_rows_and_tables(monkeypatch, tmp_path):
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path / "cache"))
    small = [[GRID[0][0], GRID[0][1]], GRID[1][:1]]
    monkeypatch.setitem(STEPS, "grid", lambda folder, **options: partial(grid_steps, grid=small)(**options))
    options = ["--scenes", "cornell@18x18", "--size", "32x18", "--targets", "0.5", "0.00001", "--reference-samples", "16", "--repeats", "1"]
    # A target of a hundred-thousandth would have auto take all passes there are.
    monkeypatch.setattr("lumigate.core.planning.planner.MOST_PASSES", 3)
    assert main(["bench", "grid", "-o", str(tmp_path), *options]) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    points = [row for row in results["rows"] if row["suite"] == "grid"]
    assert [row["method"] for row in points[:3]] == ["auto", "auto", "importance-sampling"] and points[0]["size"] == [18, 18]
    assert all(row["seconds"] > 0 and np.isfinite(row["relmse"]) for row in points)
    ratios = [row for row in results["rows"] if row["suite"] == "auto-to-best"]
    assert [(row["scene"], row["target"], row["unseen"]) for row in ratios] == [("cornell", 0.5, "seen"), ("cornell", 1e-5, "seen")]
    assert ratios[0]["peer_value"] > 0 and ratios[0]["ratio"] == pytest.approx(ratios[0]["value"] / ratios[0]["peer_value"])
    assert any(row["suite"] == "grid-verdict" for row in results["rows"])
    page = report("grid", results, [])
    assert "| scene | unseen | target |" in page and "| cornell | seen | 0.5 |" in page
    assert len((tmp_path / "rows.csv").read_text().splitlines()) == len(results["rows"]) + 1
