"""The shading benchmark: its peak is one, and its kernel shades."""

import numpy as np
import pytest

from lumigate.headless import shading_bench


def test_multiply_adds_add_up():
    # x -> x / 2 + 1 goes to 2 from everywhere.
    assert shading_bench.multiply_adds(100) == pytest.approx(2 * shading_bench.CHAINS)


def test_rows():
    peak, shading = shading_bench.shading_rows(points=64, lights=512, steps=20_000, repeats=1)
    assert peak["value"] > 0 and peak["unit"] == "G/s/core"
    assert shading["peer_value"] == pytest.approx(peak["value"] / shading_bench.OPERATIONS)
    assert np.isfinite(shading["ratio"]) and shading["ratio"] > 0
