"""The clustering benchmark runs, and what it times is right."""

from lumigate.headless.clustering_bench import clustering_rows


def test_rows_hold_rates_and_exact_assignments():
    rows = clustering_rows(points=3000, centres=100, repeats=1, threads=2)
    cases = {row["case"]: row for row in rows}
    assert len(cases) == len(rows) == 11
    assert all(row["suite"] == "clustering" and row["unit"] in ("1", "Mpoints/s", "Mpoints/s/core") for row in rows)
    assert cases["assignment pass: share of points that differ from brute force"]["value"] == 0
    peers = [row for row in rows if "cKDTree" in row["case"]]
    assert len(peers) == 6
    assert all(row["value"] > 0 and abs(row["ratio"] * row["peer_value"] / row["value"] - 1) < 1e-6 for row in peers)
