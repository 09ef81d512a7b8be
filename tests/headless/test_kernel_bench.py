"""The ray benchmark on a small product: what it reports, and that its contestants trace the same rays."""

import numpy as np
import pytest

from lumigate.headless import kernel_bench


@pytest.fixture(scope="module")
def rows():
    return kernel_bench.ray_rows(points=2048, lights=64, repeats=1)


def test_rows_have_the_fields_of_results(rows):
    for row in rows:
        assert row["suite"] == "kernels" and row["case"] and row["unit"]
        assert np.isfinite(row["value"])
        assert ("peer_value" in row) == ("ratio" in row)
        if "ratio" in row:
            assert row["value"] > 0 and row["peer_value"] > 0
            assert row["ratio"] == pytest.approx(row["value"] / row["peer_value"])
    assert len({row["case"] for row in rows}) == len(rows)


def test_embreex_sees_the_same_shadows(rows):
    shares = [row["value"] for row in rows if row["case"].endswith("share that differs from embreex")]
    assert len(shares) == 3
    assert max(shares) < 1e-3


@pytest.mark.parametrize("order", [kernel_bench.PER_POINT, kernel_bench.LIGHT_MAJOR, kernel_bench.TILES])
def test_each_order_holds_every_pair_once(order):
    pairs = {kernel_bench._pair(k, 32, 5, order) for k in range(160)}
    assert pairs == {(a, b) for a in range(32) for b in range(5)}
