"""Build the extension's zip, with wheels, by Blender's own tool: `python -m lumigate.addon.build_extension -o dist`.

The repository lists no wheels, for they are no sources: they are fetched here for the Pythons of the
Blenders that we support, and written into the manifest of a staged copy.
"""

from __future__ import annotations

import argparse
import importlib.util
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
CONTENT = ("__init__.py", "blender_manifest.toml", "LICENSE", "README.md", "addon", "core", "headless", "sample_scenes")
PYTHONS = ("3.11", "3.13")  # of Blender 4.5 LTS and 5.2 LTS
# Blender brings these itself; FLIP serves `lumigate compare`, which is no work for an extension.
NOT_PACKED = {"bpy", "numpy", "openimageio", "flip-evaluator"}
PLATFORM_TAGS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_11_0_arm64", "macosx_12_0_arm64", "macosx_14_0_arm64"),
}


def blender_tool() -> Path:
    """Blender's own command for extensions, inside the installed bpy."""
    bpy_folder = Path(importlib.util.find_spec("bpy").origin).parent
    return next(bpy_folder.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))


def requirements(python: str) -> list[str]:
    """What pyproject.toml asks of `python`, less what Blender has."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    environment = {"python_version": python, "python_full_version": f"{python}.0", "platform_machine": "x86_64"}
    wanted = [Requirement(line) for line in project["dependencies"]]
    return [
        f"{need.name}{need.specifier}"
        for need in wanted
        if need.name.lower() not in NOT_PACKED and (need.marker is None or need.marker.evaluate(environment))
    ]


def fetch_wheels(folder: Path, platform: str) -> None:
    """Download the wheels of `platform` for every supported Python into `folder`."""
    for python in PYTHONS:
        abi = "cp" + python.replace(".", "")
        tags = [word for tag in PLATFORM_TAGS[platform] for word in ("--platform", tag)]
        target = [
            "--only-binary=:all:",
            "--implementation",
            "cp",
            "--python-version",
            python,
            "--abi",
            abi,
            "--abi",
            "abi3",
            "--abi",
            "none",
        ]
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--dest", str(folder), *target, *tags, *requirements(python)]
        subprocess.run(command, check=True)
    for wheel in folder.glob("*.whl"):
        if wheel.name.split("-")[0].replace("_", "-").lower() in NOT_PACKED:
            wheel.unlink()


def stage(folder: Path, platforms: list[str]) -> None:
    """Copy what belongs into the zip to `folder`, fetch the wheels of `platforms`, and list them in the manifest."""
    for name in CONTENT:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__", Path(__file__).name))
        else:
            shutil.copy2(source, folder / name)
    if not platforms:
        return
    wheels = folder / "wheels"
    wheels.mkdir()
    for platform in platforms:
        fetch_wheels(wheels, platform)
    lines = [f"platforms = {platforms}", "wheels = [", *(f'  "./wheels/{wheel.name}",' for wheel in sorted(wheels.glob("*.whl"))), "]", ""]
    manifest = folder / "blender_manifest.toml"
    top, permissions = manifest.read_text(encoding="utf-8").split("[permissions]")
    manifest.write_text(top + "\n".join(lines).replace("'", '"') + "\n[permissions]" + permissions, encoding="utf-8")


def build(output: Path, platforms: list[str]) -> None:
    """Build the zips into `output`, one a platform, and have Blender's tool validate each."""
    output.mkdir(parents=True, exist_ok=True)
    tool = [sys.executable, str(blender_tool())]
    with tempfile.TemporaryDirectory() as staged:
        stage(Path(staged), platforms)
        split = ["--split-platforms"] if len(platforms) > 1 else []
        subprocess.run([*tool, "build", "--source-dir", staged, "--output-dir", str(output.resolve()), *split], check=True)
    for package in sorted(output.glob("lumigate-*.zip")):
        subprocess.run([*tool, "validate", str(package)], check=True)
        print(f"{package}: {package.stat().st_size / 1e6:.1f} MB")


def main() -> None:
    """The command line of this script."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("dist"), help="folder of the zips (default: dist)")
    parser.add_argument("--platform", action="append", choices=tuple(PLATFORM_TAGS), help="repeat for several (default: linux-x64)")
    parser.add_argument("--no-wheels", action="store_true", help="sources only, for a Blender that has the packages already")
    arguments = parser.parse_args()
    build(arguments.output, [] if arguments.no_wheels else arguments.platform or ["linux-x64"])


if __name__ == "__main__":
    main()
