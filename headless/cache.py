"""References kept from run to run, found again by a hash of everything that decides their pixels."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from pathlib import Path

import bpy
import platformdirs

from .. import sample_scenes
from ..core.errors import SceneError
from ..core.layers import Layers, read_exr
from .reference import REFERENCE_VERSION, ReferenceSettings, render_reference
from .results import write_json


def cache_folder() -> Path:
    """LUMIGATE_CACHE, else the user's cache folder."""
    asked = os.environ.get("LUMIGATE_CACHE")
    return (Path(asked) if asked else Path(platformdirs.user_cache_dir("lumigate"))) / "references"


def scene_identity(source: str | os.PathLike, parameters: dict | None = None) -> dict:
    """What decides the scene, as values of JSON.

    source: a scene file, hashed by its content, or a sample scene's name, hashed by the code that builds scenes.
    parameters: of the sample scene.  Textures and libraries outside the file are not read: after a change of one
    of them, empty the cache.
    """
    path = Path(source)
    if str(source) in sample_scenes.NAMES:
        code = hashlib.sha256()
        for module in sorted(Path(sample_scenes.__file__).parent.glob("*.py")):
            code.update(module.name.encode() + b"\0" + module.read_bytes())
        return {"sample": str(source), "parameters": parameters or {}, "code": code.hexdigest()}
    if not path.is_file():
        raise SceneError(f"there is no scene file {str(path)!r} and no sample scene of that name; check the path")
    with path.open("rb") as file:
        return {"file": hashlib.file_digest(file, "sha256").hexdigest()}


def cached_path(identity: dict, settings: ReferenceSettings, folder: Path | None = None) -> Path:
    """Where the reference of this scene and these settings lies, or would."""
    key = {
        "scene": identity,
        "settings": dataclasses.asdict(settings),
        "blender": bpy.app.version_string,
        "version": REFERENCE_VERSION,
    }
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    return (folder or cache_folder()) / f"{digest[:32]}.exr"


def cached_reference(scene: bpy.types.Scene, identity: dict, *, threads: int = 0, folder: Path | None = None, **settings) -> Path:
    """The file of a reference, rendered first where it is not in the cache; its statistics lie beside it as .json.

    scene: the open scene that `identity` (see `scene_identity`) describes.  settings: fields of `ReferenceSettings`.
    """
    path = cached_path(identity, ReferenceSettings(**settings), folder)
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        stats = render_reference(scene, path, threads=threads, **settings)
        write_json(path.with_suffix(".json"), stats)
    return path


def cached_halves(
    scene: bpy.types.Scene, identity: dict, *, threads: int = 0, folder: Path | None = None, seed: int = 0, **settings
) -> tuple[Layers, Layers]:
    """Two independent references (seeds `seed` and `seed` + 1) for `core.metrics.net_relmse`."""
    return tuple(
        read_exr(cached_reference(scene, identity, threads=threads, folder=folder, seed=seed + half, **settings)) for half in (0, 1)
    )
