"""Where the settings are shown."""

from __future__ import annotations

import textwrap

import bpy
from bl_ui.properties_view_layer import ViewLayerLightgroupsPanelHelper

from ..core.settings import options
from . import operators as ops
from .engine import LumigateEngine
from .light_mixer import controls, mixer
from .passes import OPTIONAL

_WIDTH = 34  # characters of a line in a panel of usual width
# Shown first, or by what is aimed at.
_ELSEWHERE = {"method", "time_budget", "target_error", "threads"}


class _RenderPanel:
    """A panel of the render properties."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    def columns(self) -> bpy.types.UILayout:
        """The layout with labels to the left."""
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        return self.layout


class RenderPanel(_RenderPanel, bpy.types.Panel):
    """What matters first: method, quality, the buttons."""

    bl_idname = "LUMIGATE_PT_render"
    bl_label = "Lumigate"
    bl_order = -1  # above Simplify

    def draw(self, context: bpy.types.Context) -> None:
        """Method and aim, then what can be started."""
        layout = self.columns()
        settings, state = context.scene.lumigate, context.window_manager.lumigate
        layout.prop(settings, "method")
        aims = layout.row()
        aims.use_property_split = False  # beside a label there is no room for their names
        aims.prop(settings, "goal", expand=True)
        layout.prop(settings, {"QUALITY": "quality", "TIME": "time_budget", "ERROR": "target_error"}[settings.goal])
        layout.separator()
        if state.running:
            layout.progress(factor=state.fraction, text=state.stage)
            layout.operator(ops.Cancel.bl_idname, icon="CANCEL")
            return
        if context.engine == LumigateEngine.bl_idname:
            layout.operator("render.render", text="Render Image", icon="RENDER_STILL")
        else:
            layout.label(text=f"For a render by {context.engine.replace('_', ' ').title()}:")
        column = layout.column(align=True)
        column.operator_context = "INVOKE_DEFAULT"
        column.operator(ops.AddIndirectLight.bl_idname, icon="LIGHT").wire = False
        column.operator(ops.AddIndirectLight.bl_idname, text="Add Indirect Light to Compositor", icon="NODETREE").wire = True


class NumbersPanel(_RenderPanel, bpy.types.Panel):
    """The numbers behind the quality, folded."""

    bl_idname = "LUMIGATE_PT_numbers"
    bl_parent_id = RenderPanel.bl_idname
    bl_label = "Numbers"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Those of every method, then the chosen method's own."""
        layout = self.columns()
        settings = context.scene.lumigate
        method = settings.as_settings().with_defaults().method
        shown = {name: field.metadata["option"] for name, field in options().items() if name not in _ELSEWHERE}
        for name in (name for name, option in shown.items() if option.method is None):
            layout.prop(settings, name)
        own = [name for name, option in shown.items() if option.method == method]
        if own:
            layout.separator()
        for name in own:
            layout.prop(settings, name)
        render = context.scene.render
        layout.separator()
        layout.prop(render, "threads_mode")
        row = layout.row()
        row.active = render.threads_mode == "FIXED"
        row.prop(render, "threads")


class LightGroupsPanel(_RenderPanel, bpy.types.Panel):
    """The mixer of the light groups: what it shows are the sockets of its node."""

    bl_idname = "LUMIGATE_PT_light_groups"
    bl_parent_id = RenderPanel.bl_idname
    bl_label = "Light Groups"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There are light groups."""
        return len(context.view_layer.lightgroups) > 0

    def draw(self, context: bpy.types.Context) -> None:
        """Gain and colour of each group, once the compositor has a mixer."""
        layout = self.layout
        node = mixer(context.scene)
        if node is not None:
            for name, gain, color in controls(node):
                row = layout.row(align=True)
                row.label(text=name)
                row.prop(gain, "default_value", text="Gain")
                row.prop(color, "default_value", text="")
        if context.engine == LumigateEngine.bl_idname:
            layout.operator(ops.MixLightGroups.bl_idname, icon="NODETREE")
        elif node is None:
            layout.label(text="Add Indirect Light to Compositor sets the mixer up", icon="INFO")


class FilmPanel(_RenderPanel, bpy.types.Panel):
    """The film of a render inside Blender, which is Cycles'."""

    bl_idname = "LUMIGATE_PT_film"
    bl_parent_id = RenderPanel.bl_idname
    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Other renderers have a panel of their own."""
        return context.engine == LumigateEngine.bl_idname

    def draw(self, context: bpy.types.Context) -> None:
        """Transparency and pixel filter, as `extract_film` reads them."""
        layout = self.columns()
        render, cycles = context.scene.render, getattr(context.scene, "cycles", None)
        layout.prop(render, "film_transparent", text="Transparent")
        if cycles is None:
            layout.prop(render, "filter_size")
            return
        layout.prop(cycles, "film_exposure", text="Exposure")
        layout.prop(cycles, "pixel_filter_type", text="Pixel Filter")
        if cycles.pixel_filter_type != "BOX":
            layout.prop(cycles, "filter_width", text="Width")


class ScenePanel(_RenderPanel, bpy.types.Panel):
    """What of the scene will be skipped, and what will look wrong."""

    bl_idname = "LUMIGATE_PT_scene"
    bl_parent_id = RenderPanel.bl_idname
    bl_label = "Scene Check"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """The button, the lines of the last check, and the cache."""
        layout = self.layout
        state = context.window_manager.lumigate
        layout.operator(ops.CheckScene.bl_idname, icon="VIEWZOOM")
        for remark in state.remarks:
            _draw_remark(layout.box(), remark)
        if state.checked and not state.remarks:
            layout.label(text="Everything in the scene will be rendered", icon="CHECKMARK")
        layout.operator(ops.ClearCache.bl_idname, icon="TRASH")


def _draw_remark(box: bpy.types.UILayout, remark: bpy.types.PropertyGroup) -> None:
    """One line of the check in as many rows as it needs; its button selects what it names."""
    column = box.column(align=True)
    for number, line in enumerate(textwrap.wrap(remark.text, _WIDTH)):
        column.label(text=line, icon=("ERROR" if remark.wrong else "INFO") if number == 0 else "BLANK1")
    if remark.named:
        column.operator(ops.SelectNamed.bl_idname, text=f"Select {remark.named}", icon="RESTRICT_SELECT_OFF").name = remark.named


class PassesPanel(bpy.types.Panel):
    """The passes of a view layer."""

    bl_idname = "LUMIGATE_PT_passes"
    bl_label = "Passes"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "view_layer"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Other renderers have passes of their own."""
        return context.engine == LumigateEngine.bl_idname

    def draw(self, context: bpy.types.Context) -> None:
        """A switch for each."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        column = layout.column(heading="Include")
        for name in OPTIONAL:
            column.prop(context.view_layer.lumigate, name)


class LightGroupListPanel(ViewLayerLightgroupsPanelHelper, bpy.types.Panel):
    """The light groups of a view layer, as Cycles lists them."""

    bl_idname = "LUMIGATE_PT_light_group_list"
    bl_parent_id = PassesPanel.bl_idname
    COMPAT_ENGINES = {LumigateEngine.bl_idname}


class PanoramaPanel(bpy.types.Panel):
    """What of a panoramic camera counts: Blender's own panel shows it for Cycles alone."""

    bl_idname = "LUMIGATE_PT_panorama"
    bl_parent_id = "DATA_PT_lens"
    bl_label = "Panorama"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "data"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only panoramic cameras have one."""
        return context.engine == LumigateEngine.bl_idname and context.camera is not None and context.camera.type == "PANO"

    def draw(self, context: bpy.types.Context) -> None:
        """The type, and how far the picture reaches."""
        layout, camera = self.layout, context.camera
        layout.use_property_split = True
        layout.prop(camera, "panorama_type")
        if camera.panorama_type != "EQUIRECTANGULAR":
            layout.label(text="Only Equirectangular is rendered", icon="ERROR")
            return
        for axis in ("latitude", "longitude"):
            column = layout.column(align=True)
            column.prop(camera, f"{axis}_min", text=f"{axis.title()} Min")
            column.prop(camera, f"{axis}_max", text="Max")


CLASSES = (RenderPanel, NumbersPanel, LightGroupsPanel, FilmPanel, ScenePanel, PassesPanel, LightGroupListPanel, PanoramaPanel)
