"""What is left out changes no light: pictures with and without skipping agree, and skipping is the cheaper."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lumigate.core.inspection import savings
from lumigate.core.lamps import build_emitters
from lumigate.core.pipeline import glance, render
from lumigate.core.stages import one_by_one
from lumigate.core.topology import Topologies
from lumigate.headless.skipping.scenes import SCENES
from lumigate.headless.skipping.single import Extent, single_rows
from lumigate.headless.skipping.suite import WITH, lights_that_matter, skipping_rows

SIZE = (32, 18)


@pytest.mark.parametrize("name", ["40-room house", "hall of 2,000 lamps"])
def test_the_light_is_the_same_without_skipping(name):
    scene = SCENES[name](*SIZE)
    everything = replace(WITH, skipping=False, vpls=8192, direct_samples=len(scene.lamps))
    few, many = (render(scene, settings).layers for settings in (replace(WITH, vpls=1024, direct_samples=64), everything))
    for layer, share in (("Direct", 0.03), ("Indirect", 0.08)):
        assert few[layer].mean() == pytest.approx(many[layer].mean(), rel=share)


def test_lamps_looked_at_one_by_one_give_what_the_tree_gives():
    emitters = build_emitters(SCENES["hall of 2,000 lamps"](*SIZE))
    assert list(one_by_one(emitters).groups) == list(range(2000))
    assert list(emitters.groups) == [-1]


def test_few_of_the_lights_of_a_house_matter_to_one_room():
    scene = SCENES["40-room house"](*SIZE)
    settings = replace(WITH, vpls=512)
    assert lights_that_matter(scene, settings) > 4 * lights_that_matter(scene, replace(settings, skipping=False))


def test_savings_are_told_before():
    scene = SCENES["hall of 2,000 lamps"](*SIZE)
    scene.lamps.emission[:500] = 0
    found = {line["stage"]: line["share"] for line in savings(scene, build_emitters(scene), 4)}
    assert found == {"direct": pytest.approx(1 - 4 / 1500), "lamps": 0.25}


def test_rows_of_the_suite():
    rows = skipping_rows({"landscape": SCENES["landscape under the sky"]}, SIZE)
    assert len(rows) == 5
    assert all(row["suite"] == "skipping" and np.isfinite(row["ratio"]) for row in rows)
    assert rows[1]["ratio"] > 1 and rows[4]["ratio"] > 1


def test_what_is_left_out_alone_changes_no_light(monkeypatch, tmp_path):
    for name in ("XDG_CACHE_HOME", "LUMIGATE_CACHE"):
        monkeypatch.setenv(name, str(tmp_path))
    found = single_rows(Extent((32, 18), subdivisions=2, side=64, budget=0.5))
    json.dumps(found, allow_nan=False)
    rows = {row["case"].partition(",")[0]: row for row in found}
    assert len(rows) == 3 * 14 + 2
    for case, share in {
        "layers not asked for: mean Depth": 0,
        "pixels of lamps: mean Indirect": 0.04,  # other points, other VPLs
        "pixels of the sky: mean Indirect": 0.2,  # few pixels
        "lamps that give no light: mean Indirect": 0.01,  # another light is picked here and there
        "objects hidden from every ray: mean Indirect": 1e-5,
        "rooms with no way to the view: mean Indirect": 0.05,
        "frames where nothing changed: mean Indirect": 0.05,  # other rays
        "topology known already: mean Indirect": 0,
        "passes after the error is met: mean Indirect": 0.03,
        "denoising where the error is met: mean DiffuseIndirect": 1e-3,
        "denoising of light without noise: mean DiffuseIndirect": 1e-5,
        "textures of materials on no triangle: mean Indirect": 0,
        "materials baked already: mean Albedo": 0,
    }.items():
        assert rows[case]["value"] == pytest.approx(rows[case]["peer_value"], rel=share) and rows[case]["value"] > 0
    black = rows["light of black surfaces: mean Indirect"]
    assert black["value"] == 0 and black["peer_value"] < 1e-9
    for case, least in {
        "shading of unlit halves: shadow rays": 1.05,
        "rooms with no way to the view: rays of particles": 3,
        "layers not asked for: CPU seconds": 2,
        "light of black surfaces: CPU seconds": 1.5,
        "materials baked already: CPU seconds": 2,
    }.items():
        assert rows[case]["ratio"] > least


def test_a_glance_tells_what_the_render_counts():
    scene = SCENES["landscape under the sky"](160, 90)
    told = {line["stage"]: line["share"] for line in glance(scene, WITH)}
    counted = {line["stage"]: line["share"] for line in render(scene, replace(WITH, vpls=4)).stats["savings"]}
    assert told["pixels"] == pytest.approx(counted["pixels"], abs=0.03) and 0.5 < told["pixels"] < 1


def test_a_glance_with_a_topology_tells_what_is_out_of_reach():
    house = SCENES["40-room house"](*SIZE)
    told = {line["stage"]: line["share"] for line in glance(house, WITH, Topologies().of(house, 96))}
    assert told["lamps"] == pytest.approx(38 / 40)


def test_savings_are_counted_by_a_render():
    scene = SCENES["landscape under the sky"](*SIZE)
    stats = render(scene, replace(WITH, vpls=64)).stats
    found = {line["stage"]: line for line in stats["savings"]}
    sky = found["pixels"]
    assert sky["of"] == SIZE[0] * SIZE[1] and 0 < sky["share"] == sky["left"] / sky["of"] < 1
    assert found["vpls"]["of"] >= 64
    json.dumps(stats["savings"])
