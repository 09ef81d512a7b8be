"""Where the settings are shown."""

from __future__ import annotations

import bpy

from .operators import RenderLayers


class RenderPanel(bpy.types.Panel):
    """Lumigate's settings in the render properties."""

    bl_idname = "LUMIGATE_PT_render"
    bl_label = "Lumigate"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """The numbers, then the button."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.lumigate
        for name in ("vpls", "bounces", "pixel_samples", "seed"):
            layout.prop(settings, name)
        layout.operator(RenderLayers.bl_idname)


CLASSES = (RenderPanel,)
