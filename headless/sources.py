"""SCENE of the command line, made Blender's open scene, and Blender's scene made arrays."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from .. import sample_scenes
from ..addon.extract import extract_camera_and_lamps, extract_scene
from ..addon.files import open_scene
from ..core.errors import SceneError
from ..core.scene import Scene
from .console import quiet
from .keeping import KEPT

OLDEST_BLENDER = (4, 5)  # as `blender_version_min` in blender_manifest.toml


def open_source(source: str | None, *, detail: str = "full") -> bpy.types.Scene:
    """Open a scene file or build a sample scene, and return it; None is the scene that is open now.

    Raises SceneError where the file cannot be read, or this Blender is too old.
    """
    if bpy.app.version < OLDEST_BLENDER:
        wanted = ".".join(map(str, OLDEST_BLENDER))
        raise SceneError(f"this is Blender {bpy.app.version_string}; version {wanted} or newer is needed")
    KEPT.drop()
    if source is None:
        return bpy.context.scene
    with quiet():
        if source in sample_scenes.NAMES:
            return sample_scenes.build(source, detail=detail)
        return open_scene(Path(source))


def state_of(source: str | None) -> tuple:
    """What tells whether `open_source` would find the same as before: where the file is, and when it was written."""
    try:
        found = os.stat(source) if source is not None and source not in sample_scenes.NAMES else None
    except OSError:  # `open_source` says so
        found = None
    return (source,) if found is None else (os.path.realpath(source), found.st_ino, found.st_size, found.st_mtime_ns)


def find_scene(source: str) -> str | None:
    """What `open_source` opens: a sample scene's name, a file, or the path of a benchmark's scene; None where there is none.

    source: of a benchmark's scene, the file or its folder, under LUMIGATE_SCENES or in shared/scenes beside this clone.
    """
    if source in sample_scenes.NAMES:
        return source
    folder = os.environ.get("LUMIGATE_SCENES")
    shared = Path(folder) if folder else Path(__file__).parents[2] / "shared" / "scenes"
    paths = Path(source), shared / source, shared / source / "scene.blend"
    return next((str(path) for path in paths if path.is_file()), None)


def extract(
    scene: bpy.types.Scene, *, camera: str | None, size: tuple[int, int] | None, frame: float | None, still: Scene | None = None
) -> Scene:
    """The arrays of `scene` as its camera sees it; raises SceneError where it cannot be rendered.

    still: those of another frame, where it is known that nothing but the camera and lamps differs.
    """
    with quiet():
        if still is not None:
            return extract_camera_and_lamps(still, scene, camera=camera, size=size, frame=frame)
        return extract_scene(scene, camera=camera, size=size, frame=frame)
