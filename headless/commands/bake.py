"""`lumigate bake`: lightmaps of a scene's objects into a folder."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path

import bpy

from ...addon.lightmap_attributes import ATTRIBUTE, bake_attributes
from ...addon.lightmap_export import export_gltf
from ...addon.lightmap_files import write_lightmap
from ...addon.lightmap_uv import Unwrap
from ...addon.lightmaps import LightmapRequest, SceneLightmaps, bake_scene, choose_objects
from ...core.settings import CONTENTS, BakeSettings
from ..console import Terminal, quiet
from ..outputs import whole_folder
from ..results import write_json
from ..sources import open_source

LIST = "lightmaps.json"
SCENE = "scene.blend"
EXPORT = "scene.glb"


def run(arguments: Namespace, terminal: Terminal) -> None:
    """Bake, and leave the images, a list of them, and the scene with the UV maps that had to be made; or the scene with its attributes."""
    scene = open_source(arguments.scene)
    request = request_of(arguments)
    objects = choose_objects(scene, arguments.objects, selected=arguments.selected)
    if arguments.attributes:
        _bake_attributes(scene, objects, request.bake, arguments.output, terminal)
        return
    with terminal.progress() as progress, quiet():
        baked = bake_scene(scene, objects, request, progress)
    stats = baked.result.stats
    for warning in stats["warnings"]:
        terminal.warn(warning)
    with whole_folder(arguments.output) as folder:
        written = _write(folder, scene, baked, request, arguments.format)
        if arguments.gltf:
            with quiet():
                export_gltf(scene, baked, folder / EXPORT)
            written.append(EXPORT)
    if arguments.stats is not None:
        write_json(arguments.stats, stats)
    texels, count = stats["texels"]["lit"], len(baked.result.lightmaps)
    terminal.out.print(
        f"{arguments.output}: {count} lightmap{'s' * (count > 1)} of {len(objects)} object{'s' * (len(objects) > 1)}, {texels:,} texels, "
        f"{stats['method']}, {stats['seconds_total']:.2f} s; {', '.join(written)}",
        markup=False,
        soft_wrap=True,
    )


def _bake_attributes(
    scene: bpy.types.Scene, objects: list[bpy.types.Object], settings: BakeSettings, output: Path, terminal: Terminal
) -> None:
    """Leave the scene, whose meshes hold their light."""
    with terminal.progress() as progress, quiet():
        warnings = bake_attributes(scene, objects, settings, progress)
    for warning in warnings:
        terminal.warn(warning)
    with whole_folder(output) as folder, quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / SCENE), copy=True, compress=True)
    count = len(objects)
    terminal.out.print(
        f"{output}: the light of {count} object{'s' * (count > 1)} in the colour attribute '{ATTRIBUTE}'; {SCENE}",
        markup=False,
        soft_wrap=True,
    )


def request_of(arguments: Namespace) -> LightmapRequest:
    """The request that the command line makes."""
    return LightmapRequest(
        bake=BakeSettings(
            render=arguments.settings,
            content=arguments.content,
            texel_samples=arguments.texel_samples,
            margin=arguments.margin,
            stitch=arguments.stitch,
        ),
        unwrap=Unwrap(arguments.uv_map, arguments.unwrap),
        size=arguments.size,
        density=arguments.texel_density,
        atlas=arguments.atlas,
    )


def _write(folder: Path, scene: bpy.types.Scene, baked: SceneLightmaps, request: LightmapRequest, kind: str) -> list[str]:
    """Everything that a bake leaves, into `folder`; names of the files other than images."""
    content = request.bake.content
    images = [
        {"objects": baked.objects[lightmap.name], "uv_map": baked.layer, **write_lightmap(folder, lightmap, content, kind)}
        for lightmap in baked.result.lightmaps
    ]
    listed = {"content": content, "unit": CONTENTS[content], "images": images}
    (folder / LIST).write_text(json.dumps(listed, indent=2) + "\n", encoding="utf-8")
    if not baked.made and not request.atlas:
        return [LIST]
    with quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / SCENE), copy=True, compress=True)
    return [LIST, SCENE]
