"""What a user does in Blender's window, run inside of it by `gui_shot.sh`: buttons, F12, Esc, viewport; with screenshots.

Times and findings go to results.json, which test_window.py judges.
"""

import importlib
import json
import statistics
import time

import bpy

OUT = "/run/gui/out"
F12 = "96"  # the key's code: by its name, xdotool presses Alt, too
FRAME = 0.02  # seconds between two looks at the window
PATIENCE = 400.0  # seconds for a first render, which compiles
SOON = 30.0  # seconds for the window to do as it is told


class Session:
    """The window, and what has been found in it."""

    def __init__(self, gui):
        self.gui = gui
        self.found = {"blender": bpy.app.version_string}
        key = next(addon.module for addon in bpy.context.preferences.addons if addon.module.endswith(".lumigate"))
        self.operators = importlib.import_module(key + ".addon.operators")
        unfold(importlib.import_module(key + ".addon.panels").ScenePanel)

    @property
    def scene(self):
        return bpy.context.window_manager.windows[0].scene

    def until(self, done, name, patience=PATIENCE):
        """Wait till `done()`; what it took, and the longest that the window stood still meanwhile."""
        begin = last = time.time()
        still = 0.0
        while not done():
            yield FRAME
            now = time.time()
            still, last = max(still, now - last - FRAME), now
            if now - begin > patience:
                raise TimeoutError(name)
        self.found[name] = {"seconds": time.time() - begin, "window_still": still}

    def show(self, kind, area_type="VIEW_3D"):
        """Turn the big area into an editor of that kind."""
        _, area = self.gui.area(area_type)
        area.type = kind
        return area

    def point_at(self, area):
        """The pointer goes over an area, where keys will be read; a click gives the window the keyboard."""
        self.gui.click(*self.gui.to_screen(area.x + area.width // 4, area.y + area.height // 4))
        yield 0.8

    def press(self, idname):
        """Click the button of an operator in the properties."""
        x, y = yield from self.gui.find_op(idname, "PROPERTIES", "WINDOW", at=0.6)
        self.gui.click(x, y)
        yield 0.8
        return x, y


def unfold(panel):
    """Have a panel open from the start: a header has no operator by which its place could be found."""
    bpy.utils.unregister_class(panel)
    panel.bl_options = set()
    bpy.utils.register_class(panel)


def steps(gui):
    bpy.context.preferences.view.render_display_type = "NONE"
    bpy.ops.wm.open_mainfile(filepath=OUT + "/scene.blend", load_ui=False)
    yield 1.0
    session = Session(gui)
    gui.area("PROPERTIES")[1].spaces.active.context = "RENDER"
    yield 1.0
    gui.shot("panel")
    yield from lamp(session)
    yield from render_by_key(session)
    for step in (indirect_light, compositor, scene_check, escapes, rendered_viewport):
        yield from step(session)
        with open(OUT + "/results.json", "w") as file:
            json.dump(session.found, file, indent=1)


def lamp(session):
    """A lamp's properties."""
    window, area = session.gui.area("PROPERTIES")
    layer, space = window.view_layer, area.spaces.active
    before = layer.objects.active
    layer.objects.active = session.scene.objects["Lamp"]
    yield 0.5
    space.context = "DATA"
    yield 1.0
    session.gui.shot("lamp")
    space.context = "RENDER"
    layer.objects.active = before
    yield 0.5


def rendering():
    return bpy.app.is_job_running("RENDER")


def render_by_key(session):
    """F12, twice: the first one compiles."""
    gui = session.gui
    for name in ("first_render", "render"):
        yield from session.point_at(gui.area("VIEW_3D")[1])
        gui.key(F12)
        yield from session.until(rendering, f"{name}_begins", SOON)
        yield from session.until(lambda: not rendering(), name)
    area = session.show("IMAGE_EDITOR")
    area.spaces.active.image = bpy.data.images["Render Result"]
    yield 0.5
    with bpy.context.temp_override(**gui.override("IMAGE_EDITOR")):
        bpy.ops.image.view_all(fit_view=True)
    yield 0.8
    gui.shot("render")
    session.show("VIEW_3D", "IMAGE_EDITOR")
    yield 0.5


def rendered_viewport(session):
    """Viewport shading Rendered, through the camera."""
    gui = session.gui
    _, area = gui.area("VIEW_3D")
    space = area.spaces.active
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_overlays = False
    with bpy.context.temp_override(**gui.override("VIEW_3D")):
        bpy.ops.view3d.view_center_camera()
    yield 0.5
    module = importlib.import_module(session.operators.__package__ + ".viewport")
    painted = []
    original = module.Viewport._paint

    def noticing(self, *arguments):
        original(self, *arguments)
        if self._picture is not None:
            painted.append((self._step, self._part))

    module.Viewport._paint = noticing
    for name in ("viewport_cold", "viewport"):
        space.shading.type = "SOLID"
        yield 1.0
        painted.clear()
        space.shading.type = "RENDERED"
        yield from session.until(lambda: bool(painted), name + "_first_picture")
        yield from session.until(lambda: painted[-1][0] >= 4, name + "_fourth_picture")
    yield 6.0  # it is refined meanwhile
    gui.shot("viewport")
    yield from render_region(session, painted)
    module.Viewport._paint = original
    space.shading.type = "SOLID"
    space.overlay.show_overlays = True
    yield 0.5


def render_region(session, painted):
    """A part of a view that is not the camera's."""
    space = session.gui.area("VIEW_3D")[1].spaces.active
    space.region_3d.view_perspective = "PERSP"
    space.use_render_border = True
    space.render_border_min_x, space.render_border_max_x, space.render_border_min_y, space.render_border_max_y = 0.25, 0.75, 0.25, 0.5
    yield from session.until(lambda: painted[-1][1] != (0, 0, 1, 1), "render_region")
    session.gui.shot("region")
    session.found["region"] = painted[-1][1]
    space.use_render_border = False


def escapes(session):
    """Esc at many moments of a render that takes long, and what it leaves."""
    gui, scene = session.gui, session.scene
    before = (scene.render.resolution_percentage, scene.lumigate.quality)
    scene.render.resolution_percentage, scene.lumigate.quality = 300, "FINAL"
    took = []
    for moment in (0.3, 0.8, 1.5, 2.5, 4.0, 6.0, 8.0):
        yield from session.point_at(gui.area("VIEW_3D")[1])
        with bpy.context.temp_override(**gui.override("VIEW_3D")):
            bpy.ops.render.render("INVOKE_DEFAULT")
        begin = time.time()
        while time.time() - begin < moment:
            yield FRAME
        if not rendering():
            break
        gui._xdo("key", "Escape")
        pressed = time.time()
        while rendering():
            yield FRAME
        took.append(time.time() - pressed)
    session.found["escape"] = {"median": statistics.median(took), "worst": max(took), "times": took}
    scene.render.resolution_percentage, scene.lumigate.quality = before
    yield 2.0


def indirect_light(session):
    """The button, once cancelled by Esc, once to the end."""
    gui = session.gui
    running = session.operators.JobOperator
    blocks = {image.name for image in bpy.data.images}
    scene = session.scene
    scene.lumigate.quality = "FINAL"
    yield from session.press("lumigate.add_indirect_light")
    yield from session.until(lambda: running.running is not None, "job_begins")
    yield 0.5
    gui.shot("progress")
    gui._xdo("key", "Escape")
    yield from session.until(lambda: running.running is None, "job_escape")
    session.found["left_by_cancel"] = sorted({image.name for image in bpy.data.images} - blocks)
    scene.lumigate.quality = "MEDIUM"
    yield 1.0
    yield from session.press("lumigate.add_indirect_light")
    yield from session.until(lambda: "Lumigate Layers" in bpy.data.images and running.running is None, "job")
    area = session.show("IMAGE_EDITOR")
    area.spaces.active.image = bpy.data.images["Lumigate Layers"]
    yield 0.5
    with bpy.context.temp_override(**gui.override("IMAGE_EDITOR")):
        bpy.ops.image.view_all(fit_view=True)
    yield 0.8
    gui.shot("layers")
    session.show("VIEW_3D", "IMAGE_EDITOR")


def compositor(session):
    """The node group in the tree of the compositor."""
    gui = session.gui
    with bpy.context.temp_override(**gui.override("VIEW_3D")):
        bpy.ops.lumigate.add_indirect_light(wire=True)
    area = session.show("NODE_EDITOR")
    area.ui_type = "CompositorNodeTree"
    yield 0.8
    with bpy.context.temp_override(**gui.override("NODE_EDITOR")):
        bpy.ops.node.view_all()
    yield 1.0
    gui.shot("compositor")
    tree = session.scene.compositing_node_group
    session.found["wired"] = "Lumigate" in tree.nodes
    session.show("VIEW_3D", "NODE_EDITOR")
    yield 0.5


def scene_check(session):
    """The list of what is left out, and the button that selects what a line names."""
    gui = session.gui
    yield from session.press("lumigate.check_scene")
    session.found["remarks"] = [remark.text for remark in bpy.context.window_manager.lumigate.remarks]
    gui.move(*gui.to_screen(400, 400))
    yield 0.8
    yield from session.press("lumigate.select_named")
    session.found["selected"] = [ob.name for ob in bpy.context.view_layer.objects.selected]
    gui.shot("check")
