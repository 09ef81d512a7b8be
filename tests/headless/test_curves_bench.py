"""The time-error curves: the numbers drawn from them, and that a small run leaves what it says."""

import json
from functools import partial

import numpy as np
import OpenImageIO as oiio
import pytest

from lumigate.core.errors import SceneError
from lumigate.headless import curves_bench
from lumigate.headless.bench_suites import STEPS
from lumigate.headless.cli import main
from lumigate.headless.curves_bench import (
    DENOISED_PEERS,
    LAYERS,
    PEERS,
    Point,
    Time,
    curves_rows,
    curves_steps,
    fitting_peer,
    fitting_samples,
    geometric_means,
    time_rows,
    time_to_error,
)

OURS = curves_bench.OURS.method


def point(method, amount, seconds, *relmse):
    errors = [{"relmse": error, "flip": None} for error in relmse]
    return Point(method, str(amount), amount, [seconds] * len(errors), {name: errors for name in LAYERS})


def test_time_at_an_error_is_read_off_a_power_law():
    seconds = np.array([8.0, 1.0, 2.0, 4.0])
    time = time_to_error(seconds, 0.3 * seconds**-0.8, 0.3 * 3.0**-0.8)
    assert time.seconds == pytest.approx(3.0) and time.bound is None
    assert time_to_error((1.0, 2.0), (0.4, 0.1), 0.4) == Time(1.0)
    assert time_to_error((1.0, 2.0), (0.4, 0.1), 0.1) == Time(2.0)


def test_time_beyond_the_curve_is_a_bound():
    assert time_to_error((1.0, 2.0), (0.4, 0.1), 0.05) == Time(2.0, "more than")
    assert time_to_error((1.0, 2.0), (0.4, 0.1), 0.5) == Time(1.0, "less than")
    assert time_to_error((1.0, 2.0), (0.4, -0.01), 0.2) == Time(2.0, "less than")  # the reference cannot tell the second from 0


def test_the_first_crossing_counts_where_a_curve_rises_again():
    assert time_to_error((1.0, 2.0, 4.0, 8.0), (0.4, 0.1, 0.3, 0.05), 0.2).seconds == pytest.approx(2.0**0.5)


def test_equal_error_is_the_better_denoised_cycles_at_16_samples():
    raw, oidn, guides, *_ = PEERS
    cycles = [point(raw, 16, 1.5, 0.001), point(oidn, 16, 2.0, 0.2), point(guides, 16, 3.0, 0.1, 0.1, 9.0), point(oidn, 64, 9.0, 0.01)]
    row = time_rows("room", "Indirect", [point(OURS, 1.0, 0.5, 0.2), point(OURS, 4.0, 2.0, 0.05), *cycles], 0.005)[0]
    assert (row["relmse"], row["peer_value"]) == (0.1, 3.0)
    assert row["value"] == pytest.approx(1.0) and row["ratio"] == pytest.approx(3.0) and "bound" not in row
    assert "noise of the reference" not in row["case"]
    assert time_rows("room", "Indirect", [point(OURS, 1.0, 0.5, 0.2), point(oidn, 16, 2.0, -0.001)], 0.005) == []


def test_a_reference_too_noisy_to_tell_is_named():
    (row,) = time_rows("room", "Indirect", [point(OURS, 1.0, 0.5, 0.2), point("cycles+oidn", 16, 2.0, 0.1)], 0.02)
    assert "noise of the reference: 2.0e-02" in row["case"] and row["bound"] == "more than"


def test_a_mean_of_bounds_is_a_bound():
    def mean(*times):
        rows = [{"suite": "curves", "scene": f"{k}"} for k in range(5)]
        for k, (ratio, bound) in enumerate(times):
            row = {"suite": "time-to-error", "layer": "Indirect", "scene": f"{k}", "ratio": ratio}
            rows.append(row | ({"bound": bound} if bound else {}))
        (row,) = geometric_means(rows)
        assert f"{len(times)} of 5 scenes" in row["case"]
        return row["value"], row.get("bound")

    assert mean((2.0, None), (8.0, None)) == (pytest.approx(4.0), None)
    assert mean((2.0, None), (8.0, "less than")) == (pytest.approx(4.0), "more than")  # less time, a higher ratio
    assert mean((2.0, "more than"), (8.0, None)) == (pytest.approx(4.0), "less than")
    assert mean((2.0, "more than"), (8.0, "less than"))[1] == "uncertain"


def test_samples_fit_a_time_with_the_start_of_a_render_paid():
    points = [point("cycles", n, 0.5 + 0.1 * n, 1.0) for n in (4, 16, 64)]
    assert fitting_samples(points, 2.05) == 15
    assert fitting_samples(points, 0.1) == 1
    assert fitting_samples(points[1:2], 4.3) == 32
    assert fitting_samples([point("cycles", n, 0.5, 1.0) for n in (4, 16)], 0.4) in (1, 16)  # a start and nothing else


def test_the_peer_at_equal_time_is_the_better_one_that_keeps_it():
    errors = {"as they are": 0.2, "denoised": 0.1}
    assert fitting_peer(errors, {"as they are": 2.0, "denoised": 2.1}, 2.0) == "denoised"
    assert fitting_peer(errors, {"as they are": 2.0, "denoised": 3.4}, 2.0) == "as they are"
    assert fitting_peer(errors, {"as they are": 2.9, "denoised": 2.8}, 1.0) == "denoised"


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A small run by the command line: its folder, and the rows."""
    folder = tmp_path_factory.mktemp("curves")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LUMIGATE_CACHE", str(folder / "cache"))
        patch.setitem(STEPS, "curves", partial(curves_steps, qualities=(0.25, 0.5), budgets=(0.2,)))
        options = ["--scenes", "cornell", "--size", "32x18", "--spp", "2", "--reference-samples", "32", "--repeats", "1"]
        assert main(["bench", "curves", "-o", str(folder), *options]) == 0
    return folder, json.loads((folder / "results.json").read_text())["rows"]


@pytest.mark.slow
def test_points_are_those_of_the_contract(small):
    rows = [row for row in small[1] if row["suite"] == "curves"]
    settings = [("quality 0.25", {OURS}), ("quality 0.5", {OURS}), ("2 spp", set(PEERS)), ("16 spp", set(PEERS))]
    for layer in LAYERS:
        for setting, methods in settings:
            assert {row["method"] for row in rows if (row["layer"], row["setting"]) == (layer, setting)} == methods
    assert len(rows) == 2 * (2 + 2 * len(PEERS))
    for row in rows:
        assert {"scene", "size", "relmse", "rmse", "bias", "flip"} <= set(row)
        assert row["peer"] == (row["method"] != OURS) and row["seconds"] > 0 and row["invalid"] == 0
        assert row["reference_noise"] > 0 and np.isfinite(row["relmse"])
    raw = {row["setting"]: row["relmse"] for row in rows if row["method"] == "cycles" and row["layer"] == "Indirect"}
    assert raw["16 spp"] < 0.5 * raw["2 spp"]  # an eighth, if nothing of the reference's noise were in it


@pytest.mark.slow
def test_denoising_costs_time_and_lowers_the_error(small):
    at = {row["method"]: row for row in small[1] if row.get("setting") == "2 spp" and row["layer"] == "DiffuseIndirect"}
    for method in DENOISED_PEERS:
        raw = at[method.split("+")[0]]
        assert at[method]["seconds"] > raw["seconds"] and at[method]["relmse"] < raw["relmse"]


@pytest.mark.slow
def test_pictures_lie_beside_plots(small):
    folder, rows = small
    assert all((folder / f"curves-{layer}.png").stat().st_size > 5000 for layer in LAYERS)
    equal = [row for row in rows if row["suite"] == "equal-time"]
    assert [row["layer"] for row in equal] == list(LAYERS)
    picture = oiio.ImageInput.open(str(folder / equal[0]["picture"]))
    assert (picture.spec().width, picture.spec().height) == (3 * 32, 2 * 18)
    panels = picture.read_image().reshape(2, 18, 3, 32, 3).mean(axis=(1, 3))
    picture.close()
    assert np.abs(panels - panels[:, 2:]).max() < 0.1 * panels[:, 2:].min()  # ours, Cycles' and the reference, exposed alike


@pytest.mark.slow
def test_times_to_the_error_are_there(small):
    cases = [row["case"] for row in small[1] if row["suite"] == "time-to-error"]
    assert any("geometric mean" in case and "1 of 1 scenes" in case for case in cases)


def test_scenes_that_are_not_there_are_named(tmp_path):
    with pytest.raises(SceneError, match="nowhere"):
        curves_rows(tmp_path, scenes=("cornell", "nowhere"))


def test_options_belong_to_the_suite(tmp_path, capsys):
    assert main(["bench", "kernels", "-o", str(tmp_path), "--spp", "4"]) == 2
    assert "--spp belongs to bench curves" in capsys.readouterr().err
