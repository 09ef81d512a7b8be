"""The benchmark of the topology, as small as it goes: rows of the contract, and pictures."""

import numpy as np
import pytest

from lumigate.core.lamps import build_emitters
from lumigate.core.topology import Topologies, blocking_triangles, build_topology
from lumigate.headless import topology_bench as bench
from lumigate.headless.sources import extract
from lumigate.headless.topology_pictures import draw, plot_thinning, project
from lumigate.headless.topology_scenes import Outlook, house, look_at


@pytest.fixture(scope="module")
def small_house():
    """A house of two rooms."""
    return extract(house(2, 1), camera=None, size=(32, 24), frame=None)


def test_the_house_has_closed_rooms(small_house):
    topology = build_topology(small_house.geometry.vertices, blocking_triangles(small_house), 64)
    large = np.bincount(topology.room[topology.node_of[topology.node_of >= 0]]) * topology.grid.size**3 > 10
    assert large.sum() == 2


def test_rows_of_errors_stages_and_guided_rays(small_house):
    topology = Topologies().of(small_house, 48)
    rows = bench.stage_rows(small_house, topology, (64,)) + bench.guided_rows("house", small_house, topology, 64)
    assert all({"suite", "case", "value", "unit"} <= set(row) for row in rows)
    assert all(row["ratio"] == pytest.approx(row["value"] / row["peer_value"]) for row in rows if row.get("peer_value"))
    relmse = next(row["value"] for row in rows if "relMSE" in row["case"])
    assert 0 <= relmse < 0.02


def test_thinning_rows_and_their_plot(small_house, tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "_dgtal_seconds", lambda empty: None)
    rows = bench.thinning_rows(small_house, (24, 48))
    assert [row["value"] > 0 for row in rows] == [True] * 4
    plot_thinning(tmp_path / "plot.png", rows)
    assert (tmp_path / "plot.png").stat().st_size > 1000


def test_the_picture_shows_skeleton_and_clusters(small_house, tmp_path):
    draw(small_house, tmp_path / "picture.png", 48, Topologies())
    assert (tmp_path / "picture.png").stat().st_size > 300


def test_a_camera_sees_what_it_looks_at(small_house):
    camera = small_house.camera
    camera.matrix = look_at((1.0, 2.0, 1.5), (3.0, 1.0, 1.2))
    column, row, away = project(camera, np.array([[3.0, 1.0, 1.2], [-1.0, 3.0, 1.8]]))
    left, right, bottom, top = camera.window
    assert column[0] == pytest.approx(-left / (right - left) * 32) and row[0] == pytest.approx(top / (top - bottom) * 24)
    assert away[0] == pytest.approx(np.sqrt(5.09)) and away[1] == 0


def test_the_lamp_of_an_outlook_shines(small_house):
    outlook = Outlook("by a lamp", (1.0, 2.0, 1.5), (3.0, 1.0, 1.2), (2.0, 2.0, 2.0))
    assert build_emitters(outlook.of(small_house)).flux.sum() > 0
