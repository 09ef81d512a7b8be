"""The preview's benchmark measures both contestants against one reference."""

from dataclasses import replace

import pytest

from lumigate.headless.preview_bench import PREVIEW, preview_rows


def test_rows_of_a_small_preview(monkeypatch, tmp_path):
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path))
    small = replace(PREVIEW, vpls=128, vpl_clusters=32, point_clusters=100, pixel_samples=1, bounces=1)
    rows = preview_rows((("Cornell box", "cornell"), ("gone", "nowhere/scene.blend")), (48, 27), small, 16, 1)
    assert [row["case"].split(":")[1].split()[0] for row in rows] == ["seconds"] + 3 * ["flip", "bias"]
    assert all(row["ratio"] == pytest.approx(row["value"] / row["peer_value"]) for row in rows)
    assert 0 < rows[1]["value"] < 0.5 and abs(rows[2]["value"]) < 0.3
