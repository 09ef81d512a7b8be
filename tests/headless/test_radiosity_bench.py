"""Instant radiosity's table: its rows, its measure of alignment, its picture."""

from dataclasses import replace

import numpy as np
import pytest

from lumigate.headless.radiosity_bench import SETTINGS, displacement, radiosity_steps


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.25, -0.5), (-0.4, 0.1)])
def test_displacement_of_a_shifted_pattern(shift):
    y, x = np.mgrid[:40, :60].astype(float)

    def pattern(x, y):
        return np.stack([np.sin(x / 5) * np.cos(y / 7), np.cos(x / 9 + y / 6), np.sin(y / 4)], axis=-1)

    moved = pattern(x - shift[0], y - shift[1])
    assert displacement(moved, pattern(x, y)) == pytest.approx(shift, abs=0.01)


def test_rows_of_a_small_scene(monkeypatch, tmp_path):
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path))
    small = replace(SETTINGS, vpls=256, pixel_samples=4, bounces=1)
    steps = radiosity_steps(tmp_path, ("cornell", "nowhere"), (32, 18), 32, small, vpls=(64, 256), seeds=(1,))
    rows = {row["case"]: row for step in steps for row in step.work()}
    assert abs(rows["cornell: bias of Direct"]["value"]) < 0.05
    assert rows["cornell: displacement"]["value"] < 0.2
    assert rows["cornell: net relMSE of DiffuseIndirect by 256 VPLs, against 64"]["ratio"] > 0
    assert (tmp_path / "radiosity-cornell.png").stat().st_size > 0
