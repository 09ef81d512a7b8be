"""The topology as a user sees it: what `inspect` says, what it writes, what is kept from run to run."""

import json

import numpy as np
import pytest

from lumigate.core.layers import read_exr
from lumigate.core.topology import build_topology
from lumigate.headless.cli import main
from lumigate.headless.topology_files import KEPT, StoredTopologies


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """A cache of this test alone."""
    monkeypatch.setenv("LUMIGATE_CACHE", str(tmp_path / "cache"))


def test_inspect_prints_and_writes_the_topology(tmp_path, capsys):
    command = [
        "inspect",
        "corridor",
        "--topology",
        "--voxels",
        "48",
        "--json",
        str(tmp_path / "r.json"),
        "--skeleton",
        str(tmp_path / "s.obj"),
    ]
    assert main(command) == 0
    told = capsys.readouterr().out
    assert all(word in told for word in ("rooms", "visibility clusters", "visibility gates"))
    report = json.loads((tmp_path / "r.json").read_text())["topology"]
    assert max(report["voxels"]) == 48 and report["rooms"] >= 1 and report["visibility_clusters"] >= report["rooms"]
    lines = (tmp_path / "s.obj").read_text().splitlines()
    vertices = sum(line.startswith("v ") for line in lines)
    used = [int(n) for line in lines if line[:2] in ("l ", "f ") for n in line.split()[1:]]
    assert min(used) == 1 and max(used) == vertices
    assert sum(line.startswith("l ") for line in lines) >= report["skeleton"]["arcs"]
    assert sum(line.startswith("o balls_of_cluster_") for line in lines) == report["visibility_clusters"]
    assert sum(line.startswith("f ") for line in lines) == sum(report["gates"].values()) + 20 * report["skeleton"]["segmented_nodes"]


def test_a_render_by_gates_shows_its_clusters(tmp_path):
    small = ["--size", "32x24", "--vpls", "64", "--pixel-samples", "1", "--bounces", "1", "--voxels", "32", "--debug-layers"]
    for gates in ("disks", "polygons", "off", "guided"):
        out = tmp_path / f"{gates}.exr"
        gate_options = ["--gates", gates, "--gate-size", "1.2", "--gate-filter", "2", "--outside", "open", "--cutouts", "--sheets", "open"]
        assert main(["render", "cornell", "-o", str(out), "--method", "visibility-gates", *gate_options, *small]) == 0
        layers = read_exr(out)
        assert layers["Indirect"].mean() > 0 and layers["VisibilityClusters"].max() >= 1
        assert (tmp_path / f"{gates}-VisibilityClusters.png").is_file()


def test_topologies_are_kept_and_damaged_files_are_not_believed(tmp_path):
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 1], [2, 1, 0]], np.float32)
    topology = build_topology(vertices, np.array([[0, 1, 2], [1, 2, 3]], np.int32), 16)
    stored = StoredTopologies(tmp_path)
    for number in range(KEPT + 3):
        stored.save(f"{number}", topology)
    assert len(list(tmp_path.glob("*.npz"))) == KEPT
    again = StoredTopologies(tmp_path).load(f"{KEPT + 2}")
    assert np.array_equal(again.node_of, topology.node_of) and again.grid.shape == topology.grid.shape
    (tmp_path / "damaged.npz").write_bytes(b"no zip")
    assert StoredTopologies(tmp_path).load("damaged") is None
    assert StoredTopologies(tmp_path / "nowhere").load("1") is None
