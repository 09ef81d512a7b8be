"""The benchmark of fuzzy clustering runs, and what it measures is what it says."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.headless.fuzzy_bench import CONFIGURATIONS, border_energy, brute_force, displayed, fuzzy_rows, lit_view, mse
from lumigate.headless.sources import extract, find_scene, open_source

CORNELL = replace(CONFIGURATIONS[0], vpl_clusters=50, point_clusters=30)


@pytest.fixture(scope="module")
def lit():
    with lit_view(extract(open_source("cornell"), camera=None, size=(48, 32), frame=None), 128) as view:
        yield view


def test_rows_of_a_small_view():
    rows = fuzzy_rows((CORNELL,), (48, 32), 128, 1, (20, 50), (1, 6))
    cases = [row["case"] for row in rows]
    assert len(set(cases)) == len(cases) == 2 * 6 + 1
    assert all(row["suite"] == "fuzzy" and np.isfinite(row["value"]) for row in rows)
    times = [row for row in rows if row["unit"] == "CPU s"]
    assert all(row["ratio"] == pytest.approx(row["peer_value"] / row["value"]) for row in times)
    errors = [row["value"] for row in rows if "MSE" in row["case"]]
    assert 0 < max(errors) < 0.01


def test_brute_force_has_no_error_against_itself(lit):
    brute = brute_force(lit)
    assert len(brute.at) == len(np.unique(brute.at)) and brute.seconds > 0
    irradiance = np.zeros((len(lit.points.pixel), 3), np.float32)
    irradiance[brute.at] = brute.irradiance
    assert mse(lit, brute, irradiance) == 0
    shown = displayed(lit, brute, irradiance[brute.at])
    assert shown.min() >= 0 and shown.max() <= 1 and np.percentile(shown, 95) > 0.5


def test_border_energy_counts_steps_at_borders_only(lit):
    x = lit.points.position[:, [0, 0, 0]]
    cluster = np.floor(x[:, 0] * 4).astype(int)  # bands several pixels wide
    assert border_energy(lit, cluster[:, None] + np.full((1, 3), 100.0), cluster) > 1e-5
    assert abs(border_energy(lit, x + 100.0, cluster)) < 1e-7  # slopes are no steps


def test_scenes_that_are_not_there_are_left_out(monkeypatch, tmp_path):
    monkeypatch.setenv("LUMIGATE_SCENES", str(tmp_path))
    assert find_scene("nowhere/scene.blend") is None
    assert find_scene("atrium") == "atrium"
    assert fuzzy_rows((replace(CORNELL, source="nowhere/scene.blend"),)) == []
