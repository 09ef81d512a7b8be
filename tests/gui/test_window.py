"""Lumigate in a real Blender window: the zip is installed, its buttons are pressed, the screenshots are there.

Runs with LUMIGATE_GUI=1, where the shared tools and a Blender that they have installed are (`BLENDER_SUITE=sid
gui_blender.sh`, 2 minutes); elsewhere it says so.  The pictures of docs/user-guide.md are its screenshots.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import bpy
import pytest

import lumigate
from lumigate import sample_scenes

ROOT = Path(lumigate.__file__).resolve().parent
TOOLS = Path(os.environ.get("LUMIGATE_GUI_TOOLS", ROOT.parent / "shared" / "tools"))
CHROOT = Path(os.environ.get("BLENDER_ROOT", Path(tempfile.gettempdir()) / "blender-gui")) / "chroot-sid"
SHOTS = ("panel", "render", "viewport", "progress", "layers", "compositor", "check", "lamp", "region")
MINUTES = 9  # the first time, which compiles

pytestmark = pytest.mark.gui


def obstacle() -> str | None:
    """Why there is no window to drive, None where there is one."""
    if "LUMIGATE_GUI" not in os.environ:
        return "it takes five to nine minutes, most of them to compile: set LUMIGATE_GUI=1 to drive a window"
    if sys.version_info < (3, 13):
        return "the window is driven once, by the run with Python 3.13"
    if not (TOOLS / "gui_shot.sh").is_file():
        return f"{TOOLS}/gui_shot.sh is not there: set LUMIGATE_GUI_TOOLS to the folder of the tools that drive a window"
    if not list(CHROOT.glob(".gui-blender-ready*")):
        return f"no Blender with a window in {CHROOT}: BLENDER_SUITE=sid {TOOLS}/gui_blender.sh installs one in two minutes"
    return None


def packages() -> Path:
    """The Python packages of the zip's wheels, for that Blender's own Python."""
    python = next(path for path in sorted(CHROOT.glob("usr/bin/python3.*")) if path.name.count(".") == 1 and path.name[8:].isdigit())
    version = python.name.removeprefix("python")
    folder = CHROOT.parent / f"lumigate-packages-{version}"
    if not folder.is_dir():
        abi = "cp" + version.replace(".", "")
        target = ["--target", str(folder), "--only-binary=:all:", "--python-version", version, "--implementation", "cp"]
        tags = [word for tag in ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux2014_x86_64") for word in ("--platform", tag)]
        abis = ["--abi", abi, "--abi", "abi3", "--abi", "none"]
        needs = ["numba>=0.68,<0.69", "scipy>=1.15", "embreex>=4.4,<5", "platformdirs>=4", "pyoidn"]  # Debian's Blender brings no denoiser
        subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", *target, *tags, *abis, *needs], check=True)
        for numpy in folder.glob("numpy*"):  # Blender's own
            shutil.rmtree(numpy)
    return folder


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    """The folder of screenshots, and what the driver has found."""
    reason = obstacle()
    if reason:
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("window")
    build_scene(folder / "scene.blend")
    subprocess.run([sys.executable, "-m", "lumigate.addon.build_extension", "-o", str(folder), "--no-wheels"], check=True)
    package = next(folder.glob("lumigate-*.zip"))
    command = ["bash", str(TOOLS / "gui_shot.sh"), "-r", str(CHROOT), "-o", str(folder), "-t", str(MINUTES * 60), "-p", str(packages())]
    run = subprocess.run([*command, str(package), str(Path(__file__).with_name("driver.py"))], capture_output=True, text=True)
    log = folder / "blender.log"
    assert run.returncode == 0, f"{run.stdout[-2000:]}\n{log.read_text(errors='replace')[-3000:] if log.exists() else run.stderr}"
    return folder, json.loads((folder / "results.json").read_text())


def build_scene(path: Path) -> None:
    """The Cornell box, with one object that cannot be rendered."""
    scene = sample_scenes.build("cornell")
    scene.collection.objects.link(bpy.data.objects.new("Smoke", bpy.data.volumes.new("Smoke")))
    scene.render.resolution_x = scene.render.resolution_y = 480
    scene.render.resolution_percentage = 100
    lumigate.register()
    scene.render.engine = "LUMIGATE"
    lumigate.unregister()
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


def test_the_zip_installs_and_its_pictures_are_there(window):
    folder, found = window
    for name in SHOTS:
        assert (folder / f"{name}.png").stat().st_size > 10_000
    assert found["blender"].startswith("5.")


def test_the_viewport_keeps_to_its_render_region(window):
    _, found = window
    assert found["region"] == pytest.approx([0.25, 0.25, 0.75, 0.5], abs=0.02)  # whole pixels of the coarse picture


def test_the_window_stays_alive_while_it_renders(window):
    _, found = window
    assert found["render"]["window_still"] < 2.0


def test_esc_is_heard_at_any_moment(window):
    _, found = window
    assert len(found["escape"]["times"]) >= 3
    assert found["escape"]["worst"] < 3.0


def test_a_cancelled_job_leaves_no_image(window):
    _, found = window
    assert found["left_by_cancel"] == []


def test_the_compositor_is_wired(window):
    _, found = window
    assert found["wired"]


def test_the_check_names_what_is_left_out_and_selects_it(window):
    _, found = window
    assert any("'Smoke'" in remark for remark in found["remarks"])
    assert found["selected"] == ["Smoke"]
