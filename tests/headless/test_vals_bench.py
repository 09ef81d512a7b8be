"""Virtual area lights in a Blender scene against the same VPLs with shadow rays, and the benchmark that measures them."""

import numpy as np
import pytest

from lumigate.core.layers import read_exr
from lumigate.core.methods.instant_radiosity import InstantRadiosity
from lumigate.core.methods.virtual_area_lights import VirtualAreaLights
from lumigate.core.metrics import relmse
from lumigate.core.picture import splat
from lumigate.headless.cli import main
from lumigate.headless.fuzzy_bench import lit_view
from lumigate.headless.sources import extract, open_source
from lumigate.headless.vals_bench import vals_rows


@pytest.mark.parametrize("interleave, bound", [(1, 0.02), (4, 0.05)])
def test_cornell_box_against_shadow_rays(interleave, bound):
    with lit_view(extract(open_source("cornell"), camera=None, size=(64, 64), frame=None), 512) as lit:
        exact = InstantRadiosity(compensation=0)
        exact.prepare(lit.tables, lit.vpls, lit.points)
        solver = VirtualAreaLights(vals=30, interleave=interleave, width=lit.shape[1], compensation=0)
        solver.prepare(lit.tables, lit.vpls, lit.points)
        pictures = [splat(lit.points, lit.points.albedo * s.irradiance(lit.points), lit.shape) for s in (solver, exact)]
    assert relmse(*pictures) < bound
    assert pictures[0].mean() == pytest.approx(pictures[1].mean(), rel=0.03)


def test_rows_of_a_small_view():
    rows = vals_rows((("Cornell box", "cornell"),), (32, 32), (24, 24), 64, (4, 16), 1, 2, 128)
    cases = [row["case"] for row in rows]
    assert len(set(cases)) == len(cases) == 4 + 7 + 2 + 3
    assert all(row["suite"] == "vals" and np.isfinite(row["value"]) for row in rows)
    assert vals_rows((("nowhere", "nowhere/scene.blend"),), frames=0)[0]["case"].startswith("area lamp")


def test_debug_layers_show_the_area_lights(tmp_path):
    small = ["--size", "32x24", "--vpls", "64", "--pixel-samples", "1", "--bounces", "1"]
    options = ["--method", "virtual-area-lights", "--vals", "8", "--interleave", "2", "--soft-shadows", "--debug-layers"]
    assert main(["render", "cornell", "-o", str(tmp_path / "out.exr"), *small, *options]) == 0
    layers = read_exr(tmp_path / "out.exr")
    assert len(np.unique(layers["AreaLights"])) > 3
    for rank in range(4):
        shadow, depth = layers[f"AreaLightShadow{rank}"], layers[f"AreaLightDepth{rank}"]
        assert 0 <= shadow.min() and shadow.max() <= 1 and shadow.max() > 0.5
        assert depth.max() > 0.1
        assert (tmp_path / f"out-AreaLightShadow{rank}.png").is_file()
