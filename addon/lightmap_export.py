"""Export of a scene with its lightmaps: glTF knows none, so that their light shines from the materials on a second UV map."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy

from ..core.errors import SceneError
from .lightmap_files import write_lightmap
from .lightmap_materials import kept_set_up, set_up
from .lightmaps import SceneLightmaps


def export_gltf(scene: bpy.types.Scene, baked: SceneLightmaps, path: Path) -> Path:
    """Write the scene as binary glTF with lightmaps of the content `full`; lamps are left out, for their light is in the maps.

    Images have 8 bits with the sRGB curve, brighter ones than 1 by the extension KHR_materials_emissive_strength.  The scene's materials
    are as before afterwards, lightmaps that they show among them.

    Raises:
        SceneError: the lightmaps hold something else than `full`, or the exporter fails.
    """
    content = baked.result.stats["content"]
    if content != "full":
        raise SceneError(f"glTF shows lightmaps as light of the materials: bake the content 'full', not {content!r}")
    images = []
    objects = [scene.objects[name] for names in baked.objects.values() for name in names]
    with tempfile.TemporaryDirectory() as folder:
        try:
            with kept_set_up(objects):
                for lightmap in baked.result.lightmaps:
                    written = write_lightmap(Path(folder), lightmap, content, "png")
                    image = bpy.data.images.load(str(Path(folder) / written["file"]))
                    images.append(image)
                    for name in baked.objects[lightmap.name]:
                        set_up(scene.objects[name], image, baked.layer, content, written["scale"])
                _export(path)
        finally:
            for image in images:
                bpy.data.images.remove(image)
    return path


def _export(path: Path) -> None:
    try:
        done = bpy.ops.export_scene.gltf(
            filepath=str(path), export_format="GLB", export_apply=True, export_cameras=True, export_lights=False, use_active_scene=True
        )
    except Exception as error:  # the exporter raises whatever a scene provokes
        raise SceneError(f"Blender cannot export '{path.name}': {' '.join(str(error).split())}") from error
    if "FINISHED" not in done:
        raise SceneError(f"Blender cannot export '{path.name}'")
