"""The command line as a user calls it: what it prints, what it leaves on disk, and how it ends."""

import json
import os
import pty
import signal
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import bpy
import numpy as np
import pytest

import lumigate
from lumigate import sample_scenes
from lumigate.addon.files import SUPPORTED
from lumigate.core.layers import CONTRACT, read_exr
from lumigate.headless import arguments
from lumigate.headless.bench_steps import Step
from lumigate.headless.bench_suites import STEPS
from lumigate.headless.cli import main, program
from lumigate.headless.frames import numbered
from lumigate.headless.sources import OLDEST_BLENDER

ROOT = Path(lumigate.__file__).parent
SMALL = ["--size", "16x12", "--vpls", "8", "--pixel-samples", "2", "--bounces", "2"]
STATS = {"method", "size", "vpls", "bounces", "threads", "seconds", "seconds_total", "rays", "pairs_shaded", "skipped", "warnings"}


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """A small picture of cornell with its statistics."""
    folder = tmp_path_factory.mktemp("rendered")
    assert main(["render", "cornell", "-o", str(folder / "out.exr"), "--stats", str(folder / "stats.json"), *SMALL]) == 0
    return folder


def test_render_leaves_the_layers_of_the_contract(rendered):
    layers = read_exr(rendered / "out.exr")
    assert set(layers) == set(CONTRACT)
    assert layers.size == (16, 12)
    whole = layers["Direct"] + layers["Indirect"] + layers["Emission"]
    np.testing.assert_allclose(layers["Combined"], whole, rtol=1e-6, atol=1e-7)
    assert layers["Indirect"].mean() > 0


def test_a_picture_of_which_fewer_pixels_are_lit_is_as_large(tmp_path):
    command = ["render", "cornell", "-o", str(tmp_path / "out.exr"), "--stats", str(tmp_path / "stats.json"), "--downsampling", "2"]
    assert main([*command, *SMALL, "--size", "64x48"]) == 0
    assert read_exr(tmp_path / "out.exr").size == (64, 48)
    assert json.loads((tmp_path / "stats.json").read_text())["auto"]["lit"] == [32, 24]


def test_film_is_the_scenes_only_where_asked_for(tmp_path):
    scene = sample_scenes.build("cornell", detail="low")
    scene.render.film_transparent = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "box.blend"), check_existing=False)
    for options, channels in (([], 3), (["--film"], 4)):
        assert main(["render", str(tmp_path / "box.blend"), "-o", str(tmp_path / "out.exr"), *options, *SMALL]) == 0
        assert read_exr(tmp_path / "out.exr")["Combined"].shape[2] == channels


def test_render_leaves_no_other_file(rendered):
    assert names(rendered) == ["out.exr", "stats.json"]


def test_statistics_are_those_of_the_contract(rendered):
    stats = json.loads((rendered / "stats.json").read_text())
    assert set(stats) >= STATS
    assert stats["size"] == [16, 12]
    assert stats["bounces"] == 2
    assert set(stats["rays"]) == {"primary", "light", "shadow"}
    assert stats["rays"]["primary"] > 0
    stages = {name: seconds for name, seconds in stats["seconds"].items() if name != "jit"}
    assert 0 < sum(stages.values()) <= stats["seconds_total"] * 1.001


def test_warm_start_compiles_nothing(rendered, tmp_path):
    assert main(["render", "cornell", "-o", str(tmp_path / "out.exr"), "--stats", str(tmp_path / "stats.json"), *SMALL]) == 0
    assert json.loads((tmp_path / "stats.json").read_text())["seconds"]["jit"] == 0


def test_result_goes_to_stdout_and_nothing_of_blenders(rendered, tmp_path, capfd):
    assert main(["render", "cornell", "-o", str(tmp_path / "out.exr"), *SMALL]) == 0
    out, err = capfd.readouterr()
    assert out.count("\n") == 1
    assert out.startswith(f"{tmp_path / 'out.exr'}: 16x12, importance-sampling, ")
    assert err == ""


def test_the_plan_is_in_the_statistics_and_on_the_console(rendered, tmp_path, capfd):
    argv = ["render", "cornell", "-o", str(tmp_path / "out.exr"), "--stats", str(tmp_path / "stats.json"), "--quality", "preview", *SMALL]
    assert main(argv) == 0
    plan = json.loads((tmp_path / "stats.json").read_text())["auto"]
    assert plan["goal"] == {"target_error": 0.05}
    out, _ = capfd.readouterr()
    assert [line.removeprefix("  auto: ") for line in out.splitlines()[1:]] == plan["reasons"]


def test_frames_are_numbered(rendered, tmp_path):
    argv = ["render", "cornell", "-o", str(tmp_path / "out.exr"), "--stats", str(tmp_path / "s.json"), "--frames", "9-10", *SMALL]
    assert main(argv) == 0
    assert names(tmp_path) == ["out0009.exr", "out0010.exr", "s0009.json", "s0010.json"]


@pytest.mark.parametrize(
    ("name", "frame", "expected"),
    [("a.exr", 7, "a0007.exr"), ("a_##.exr", 123, "a_123.exr"), ("#b#.exr", -4, "-4b#.exr"), ("a.exr", -4, "a-0004.exr")],
)
def test_numbers_of_frames(name, frame, expected):
    assert numbered(Path(name), frame).name == expected


def test_every_scene_format_is_offered():
    assert arguments.SCENE_SUFFIXES == SUPPORTED


def test_oldest_blender_is_that_of_the_manifest():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["blender_version_min"] == ".".join(map(str, (*OLDEST_BLENDER, 0)))


def test_method_options_reach_the_settings():
    parsed = arguments.parse(
        ["render", "cornell", "-o", "x.exr", "--visibility", "none", "--no-compensation", "--vpls", "7", "--no-denoise"]
    )
    settings = parsed.settings
    assert (settings.visibility, settings.compensation, settings.vpls, settings.denoise) == ("none", False, 7, False)
    assert settings.method == "instant-radiosity"  # which alone reads them
    assert settings.seed == 0


def test_inspect_says_what_the_scene_holds(tmp_path, capsys):
    assert main(["inspect", "cornell", "--json", str(tmp_path / "report.json")]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["triangles"] > 10
    assert report["camera"]["kind"] == "perspective"
    assert report["warnings"] == []
    out = capsys.readouterr().out
    assert f"{report['triangles']:,}" in out
    assert "will be wrong: nothing" in out


def test_picture_equals_itself(rendered, tmp_path, capsys):
    out = rendered / "out.exr"
    assert main(["compare", str(out), str(out), "--json", str(tmp_path / "c.json"), "--error-map", str(tmp_path / "map.png")]) == 0
    figures = json.loads((tmp_path / "c.json").read_text())
    assert [figures[name] for name in ("relmse", "rmse", "bias", "flip", "invalid")] == [0, 0, 0, 0, 0]
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    assert "relmse" in capsys.readouterr().out


def test_reference_has_the_same_layers(rendered, tmp_path):
    assert main(["reference", "cornell", "-o", str(tmp_path / "ref.exr"), "--spp", "4", "--size", "16x12", "--bounces", "2"]) == 0
    reference, ours = read_exr(tmp_path / "ref.exr"), read_exr(rendered / "out.exr")
    assert set(reference) == set(ours)
    assert reference.size == ours.size
    np.testing.assert_allclose(ours["Albedo"].mean(), reference["Albedo"].mean(), rtol=0.1)


def test_every_suite_has_rows():
    assert tuple(STEPS) == arguments.SUITES


def test_bench_leaves_machine_versions_and_rows(tmp_path, monkeypatch, capsys):
    rows = [{"suite": "kernels", "case": "shadow rays", "value": 2.0, "unit": "Mrays/s/core", "peer_value": 1.0, "ratio": 2.0}]
    monkeypatch.setitem(STEPS, "kernels", lambda folder: [Step("kernels", lambda: rows)])
    assert main(["bench", "-o", str(tmp_path / "bench")]) == 0
    results = json.loads((tmp_path / "bench" / "results.json").read_text())
    assert results["rows"] == rows
    assert results["versions"]["lumigate"] == lumigate.__version__
    assert {"system", "processor", "threads"} <= set(results["machine"])
    assert "shadow rays" in capsys.readouterr().out


@pytest.mark.slow
def test_demo_leaves_layers_pictures_and_figures(tmp_path, capsys):
    assert main(["demo", "-o", str(tmp_path / "demo"), "--size", "32x18"]) == 0
    assert names(tmp_path / "demo") == [
        *(f"atrium-{name}.png" for name in ("Albedo", "Combined", "Direct", "Indirect", "Irradiance")),
        "atrium.exr",
        "atrium.json",
    ]
    assert read_exr(tmp_path / "demo" / "atrium.exr").size == (32, 18)
    assert "shadow rays" in capsys.readouterr().out


def test_console_script_is_this_program():
    (script,) = entry_points(group="console_scripts", name="lumigate")
    assert script.load() is program


# `blender -b FILE --python headless/cli.py -- ARGS`, from a checkout in a folder of any name.

AS_BLENDER_DOES = """
import runpy, sys
import bpy
scene, script, *argv = sys.argv[1:]
bpy.ops.wm.open_mainfile(filepath=scene)
sys.argv = ["blender", "-b", scene, "--python", script, "--", *argv]
runpy.run_path(script, run_name="__main__")
"""


def test_script_of_blender_takes_the_open_file(tmp_path):
    sample_scenes.build("cornell", detail="low")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "open.blend"))
    checkout = tmp_path / "any name"
    checkout.symlink_to(ROOT)
    command = [
        sys.executable,
        "-c",
        AS_BLENDER_DOES,
        tmp_path / "open.blend",
        checkout / "headless" / "cli.py",
        "reference",  # for which no kernel has to be compiled that another folder's has
        "-o",
        tmp_path / "reference.exr",
        "--size=16x16",
        "--spp=4",
    ]
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    red, green = read_exr(tmp_path / "reference.exr")["Albedo"][:, [1, -2]].mean(axis=0)
    assert red[0] > 1.5 * red[1] and green[1] > 1.5 * green[0]  # the walls of the box


def test_script_of_blender_refuses_in_one_line(tmp_path):
    command = [
        sys.executable,
        "-c",
        "import bpy, runpy, sys; runpy.run_path(sys.argv[1], run_name='__main__')",
        ROOT / "headless" / "cli.py",
        "--",
        "paint",
    ]
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "Traceback" not in result.stderr


CANCELLED = {
    "render": (["--stats", "stats.json", "--size", "512x512", "--vpls", "100000"], b"direct"),
    "reference": (["--size", "256x256", "--spp", "1000000"], b"0:00:02"),  # Cycles hears nothing, and would take hours
}


@pytest.mark.parametrize("command", CANCELLED)
def test_ctrl_c_leaves_nothing_and_says_so(rendered, tmp_path, command):
    """On a terminal of its own, so that the progress bar tells when the light is being gathered."""
    options, awaited = CANCELLED[command]
    leader, follower = pty.openpty()
    run = [sys.executable, "-m", "lumigate.headless.cli", command, "cornell", "-o", str(tmp_path / "out.exr"), *options]
    with subprocess.Popen(run, stdout=subprocess.DEVNULL, stderr=follower, cwd=tmp_path) as process:
        os.close(follower)
        seen = b""
        while awaited not in seen:
            seen += os.read(leader, 4096)
        process.send_signal(signal.SIGINT)
        try:
            while chunk := os.read(leader, 4096):
                seen += chunk
        except OSError:  # Linux says that the other end is closed by an error
            pass
    os.close(leader)
    assert process.returncode == 130
    assert b"lumigate: cancelled" in seen
    assert b"Traceback" not in seen
    assert names(tmp_path) == []


def test_missing_package_is_named():
    code = "import sys; sys.modules['rich'] = None; from lumigate.headless.cli import main; sys.exit(main(['inspect', 'cornell']))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert "'rich'" in result.stderr


def test_help_needs_no_blender():
    """`--help` answers at once: neither bpy nor Numba is imported."""
    code = "import sys; from lumigate.headless.cli import main; status = main(['render', '--help']); print(status, {'bpy', 'numba'} & set(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.endswith("0 set()\n")


def test_modules_are_compiled_once_where_nothing_may_be_written_beside_them(tmp_path):
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "LUMIGATE_CACHE": str(tmp_path)}
    environment.pop("PYTHONPYCACHEPREFIX", None)
    code = "from lumigate.headless.cli import program; program()"
    for found in (0, 1):
        assert bool(list(tmp_path.rglob("errors.*.pyc"))) == found
        subprocess.run(
            [sys.executable, "-c", code, "compare", "a.exr", "b.exr"], env=environment, cwd=tmp_path, capture_output=True, check=False
        )
