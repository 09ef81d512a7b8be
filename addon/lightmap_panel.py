"""Where lightmaps are baked from."""

from __future__ import annotations

import bpy

from .lightmap_operators import BakeAttributes, BakeLightmaps, RestoreMaterials


class LightmapPanel(bpy.types.Panel):
    """Lightmaps of the scene's objects."""

    bl_idname = "LUMIGATE_PT_lightmaps"
    bl_label = "Lightmaps"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_parent_id = "LUMIGATE_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """What and how large, then the details, then the buttons."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        settings = context.scene.lumigate_lightmaps
        for name in ("objects", "content", "atlas", "use_density", "density" if settings.use_density else "size"):
            layout.prop(settings, name)
        ob = context.object
        if settings.use_density and ob is not None and ob.type == "MESH":
            layout.prop(ob.lumigate_lightmap, "density", text=f"of {ob.name}")
        column = layout.column()
        for name in ("margin", "texel_samples", "stitch", "layer", "unwrap", "format", "packed"):
            column.prop(settings, name)
        if not settings.packed:
            column.prop(settings, "folder")
        column.prop(settings, "materials")
        layout.operator_context = "INVOKE_DEFAULT"  # as jobs, whose progress and Cancel the panel above shows
        layout.operator(BakeLightmaps.bl_idname, icon="RENDER_STILL")
        layout.operator(BakeAttributes.bl_idname, icon="GROUP_VCOL")
        layout.operator(RestoreMaterials.bl_idname, icon="LOOP_BACK")


CLASSES = (LightmapPanel,)
