"""What an artist starts."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.errors import SceneError

if TYPE_CHECKING:
    from ..core.layers import Layers

IMAGE_NAME = "Lumigate Layers"


class RenderLayers(bpy.types.Operator):
    """Compute the scene's indirect light and load its layers as an image"""

    bl_idname = "lumigate.render_layers"
    bl_label = "Render Indirect Layers"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A camera is needed."""
        if context.scene.camera is None:
            cls.poll_message_set("The scene has no camera")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Extract, render, load; what is wrong with the scene is reported in one line."""
        # Numba takes a second to import: that belongs to the first render, not to Blender's start.
        from ..core.pipeline import render
        from .extract import extract_scene

        window = context.window_manager
        window.progress_begin(0, 100)

        def progress(_stage: str, fraction: float) -> bool:
            window.progress_update(100 * fraction)
            return True

        try:
            scene = extract_scene(context.scene)
            result = render(scene, context.scene.lumigate.as_settings(), progress)
            load_layers(result.layers)
        except SceneError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            window.progress_end()
        for warning in result.stats["warnings"]:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"{IMAGE_NAME}: {result.stats['seconds_total']:.1f} s")
        return {"FINISHED"}


def load_layers(layers: Layers) -> bpy.types.Image:
    """The multilayer image `IMAGE_NAME` of this file with `layers` in it, packed, so that no file on disk is needed."""
    from ..core.layers import write_exr

    with tempfile.TemporaryDirectory(dir=bpy.app.tempdir) as folder:
        path = write_exr(Path(folder) / "layers.exr", layers)
        image = bpy.data.images.load(str(path))
        image.pack()
        len(image.pixels)  # reads the file: only then Blender knows that it is multilayer
    before = bpy.data.images.get(IMAGE_NAME)
    if before is not None:
        before.user_remap(image)
        bpy.data.images.remove(before)
    image.name = IMAGE_NAME
    return image


CLASSES = (RenderLayers,)
