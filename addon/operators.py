"""What an artist starts."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import bpy

from ..core.errors import SceneError
from .compositor import layers_node, wire
from .image_layers import IMAGE_NAME, load_layers, write_layers
from .job import Job, failed, loading, nothing, render_job
from .lasting import by_uid
from .light_mixer import mix_render, wire_mixer
from .passes import group_names, left_out, long_name, long_names
from .preserved import kept_render_result
from .state import named_objects

_TICK = 0.1  # seconds between two looks at a running job


class JobOperator:
    """An operator whose work is a job: the window stays alive, Esc and the panel's button cancel it.

    A subclass gives `begin(context)`, which reads Blender's data and starts the job (None: there is nothing to do), and
    `finish(context)`; `abandon()` takes back what `begin` has changed.
    Run from a script (EXEC_DEFAULT, or in background), it waits for the end.
    """

    running: ClassVar[Job | None] = None  # one at a time, of all operators

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Start, and let Blender go on."""
        if bpy.app.background:
            return self.execute(context)
        if not self._start():
            return {"CANCELLED"}
        self._told = set()  # workspaces whose status bar says how far the job is
        self._timer = context.window_manager.event_timer_add(_TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start, and wait for the end."""
        if not self._start():
            return {"CANCELLED"}
        while not (self._job.wait(_TICK) and self._finished(context)):
            pass
        return self._end(context)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Called by Blender for each event while the job runs."""
        if event.type == "ESC" and event.value == "PRESS":
            self._job.cancel()
        if self._job.cancelled or (self._job.done and self._finished(context)):
            self._hide(context)
            return self._end(context)
        if event.type == "TIMER":
            self._show(context)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Called by Blender where it ends the operator itself: another file is loaded, or the window closed."""
        self._job.cancel()
        JobOperator.running = None
        self._hide(context)
        self.abandon()

    def _start(self) -> bool:
        if JobOperator.running is not None and not JobOperator.running.done:
            self.report({"ERROR"}, "Lumigate is computing already: wait, or cancel it first")
            return False
        self._begun = False
        self._job = JobOperator.running = loading()
        return True

    def _finished(self, context: bpy.types.Context) -> bool:
        """Whether the job that has ended was the last one; if it was the loading of code, the operator's own begins."""
        if self._begun or self._job.error is not None:
            return True
        self._begun = True
        try:
            self._job = JobOperator.running = self.begin(context) or nothing()
        except Exception as error:  # raised at the end, when the progress bar is gone
            self._job = failed(error)
            return True
        return False

    def _end(self, context: bpy.types.Context) -> set[str]:
        JobOperator.running = None
        if self._job.cancelled:
            self.abandon()
            self.report({"INFO"}, "Cancelled: nothing has changed")
            return {"CANCELLED"}
        try:
            if self._job.error is not None:
                raise self._job.error
            self.finish(context)
        except SceneError as error:
            self.abandon()
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except Exception:
            self.abandon()
            raise
        return {"FINISHED"}

    def abandon(self) -> None:
        """Nothing, unless a subclass has something to take back."""

    def _show(self, context: bpy.types.Context) -> None:
        state, progress = context.window_manager.lumigate, self._job.progress
        state.running, state.fraction, state.stage = True, progress.fraction, str(progress)
        self._told.add(context.workspace.session_uid)
        context.workspace.status_text_set(f"Lumigate: {progress.fraction:.0%}, {progress}   (Esc cancels)")
        _redraw(context)

    def _hide(self, context: bpy.types.Context) -> None:
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.lumigate.running = False
        for workspace in bpy.data.workspaces:  # the window may have shown many of them
            if workspace.session_uid in self._told:
                workspace.status_text_set(None)
        _redraw(context)


def _redraw(context: bpy.types.Context) -> None:
    """The panel shows how far the job is."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type in ("PROPERTIES", "IMAGE_EDITOR"):
                area.tag_redraw()


def _extracted(context: bpy.types.Context):
    """The scene's arrays, and the seconds that they took; the last render stays."""
    # NumPy's neighbours take a second to import: that belongs to the first render, not to Blender's start.
    from .extract import extract_scene

    begin = time.perf_counter()
    with kept_render_result():
        arrays = extract_scene(context.scene, view_layer=context.view_layer)
    return arrays, time.perf_counter() - begin


class NoRender:
    """For operators that evaluate the scene as a render sees it, which is a render to Blender."""

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        """No render may be under way."""
        if bpy.app.is_job_running("RENDER"):
            cls.poll_message_set("A render is running")
            return False
        return True


class NeedsCamera(NoRender):
    """For operators that look through the scene's camera."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A camera is needed."""
        if context.scene.camera is None:
            cls.poll_message_set("The scene has no camera")
            return False
        return super().poll(context)


class AddIndirectLight(NeedsCamera, JobOperator, bpy.types.Operator):
    """Compute the indirect light that the camera sees, whatever renderer the scene uses, into the image 'Lumigate Layers'"""

    bl_idname = "lumigate.add_indirect_light"
    bl_label = "Add Indirect Light"
    bl_options = {"REGISTER", "UNDO"}

    __annotations__ = {
        "wire": bpy.props.BoolProperty(
            name="Add to Compositor", description="Add the indirect light to the render by a node group", options={"SKIP_SAVE"}
        )
    }

    def begin(self, context: bpy.types.Context) -> Job:
        """Read the scene and start the render, which ends with the layers in a file."""
        from .extract.film import extract_film, film_exposure

        arrays, seconds = _extracted(context)
        self._scene, self._layer = context.scene.session_uid, context.view_layer.name
        folder = Path(bpy.app.tempdir)
        return render_job(
            arrays,
            replace(context.scene.lumigate.as_settings(), film=extract_film(context.scene)),
            extraction_seconds=seconds,
            exposure=film_exposure(context.scene),
            afterwards=lambda result: (write_layers(folder, result.layers), result.stats),
        )

    def finish(self, context: bpy.types.Context) -> None:
        """Load the file; what was wrong is reported."""
        path, stats = self._job.result
        image = load_layers(path)
        scene = by_uid(bpy.data.scenes).get(self._scene)  # the window may show another one by now
        if self.wire and scene is not None:
            _wire_layers(scene, self._layer, image)
        left_out = [f"{found['stage']}: {found['reason']}" for found in stats["skipped"]]
        if scene is not None:
            context.window_manager.lumigate.report(scene, left_out, stats["warnings"])
        for warning in stats["warnings"]:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"{IMAGE_NAME}: {stats['method']}, {stats['seconds_total']:.1f} s")


def _wire_layers(scene: bpy.types.Scene, view_layer: str, image: bpy.types.Image) -> None:
    """Add the image's indirect light to the compositor, through a mixer where there are light groups."""
    adder = wire(scene, image, view_layer)
    names = group_names(scene, scene.view_layers[view_layer]) if view_layer in scene.view_layers else []
    if names and not long_names(names):
        source = layers_node(scene)
        mixed = wire_mixer(scene, source, "Indirect", names)
        adder.id_data.links.new(mixed.outputs["Image"], adder.inputs["Indirect"])


class MixLightGroups(bpy.types.Operator):
    """Put a node group into the compositor in which each light group of the render is dimmed and coloured"""

    bl_idname = "lumigate.mix_light_groups"
    bl_label = "Mix Light Groups in Compositor"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The view layer needs light groups, and the render is Lumigate's: others name their passes otherwise."""
        if context.engine != "LUMIGATE" or not group_names(context.scene, context.view_layer):
            cls.poll_message_set("For renders by Lumigate's automatic method of view layers with light groups")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Wire it."""
        names = group_names(context.scene, context.view_layer)
        if too_long := long_names(names):
            self.report({"ERROR"}, long_name(too_long[0]))
            return {"CANCELLED"}
        mix_render(context.scene, context.view_layer, names)
        return {"FINISHED"}


class Cancel(bpy.types.Operator):
    """Stop what Lumigate is computing; nothing in the file has changed"""

    bl_idname = "lumigate.cancel"
    bl_label = "Cancel"
    bl_options = {"INTERNAL"}

    def execute(self, _context: bpy.types.Context) -> set[str]:
        """The running operator sees it at its next tick."""
        if JobOperator.running is not None:
            JobOperator.running.cancel()
        return {"FINISHED"}


class CheckScene(NeedsCamera, bpy.types.Operator):
    """List what a render will leave out, and what will look wrong; bakes procedural materials and the sky, which are kept for the render"""

    bl_idname = "lumigate.check_scene"
    bl_label = "Check and Prepare Scene"
    bl_options = {"REGISTER"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Extract the scene and ask the core what it foresees."""
        from ..core.inspection import foresee
        from ..core.lamps import build_emitters
        from ..core.soundness import sound

        try:
            arrays, _ = _extracted(context)
        except SceneError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        arrays = sound(arrays)
        skipped, warnings = foresee(arrays, build_emitters(arrays))
        lines = [f"{found.stage}: {found.reason}" for found in (*arrays.skipped, *skipped)]
        passes = left_out(context.view_layer) if context.engine == "LUMIGATE" else []
        context.window_manager.lumigate.report(context.scene, lines, [*arrays.warnings, *warnings, *passes])
        return {"FINISHED"}


class SelectNamed(bpy.types.Operator):
    """Select the object that this line names, and make it active"""

    bl_idname = "lumigate.select_named"
    bl_label = "Select"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    __annotations__ = {"name": bpy.props.StringProperty(name="Name", options={"SKIP_SAVE"})}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Deselect the others."""
        layer = context.view_layer
        found = [ob for ob in named_objects(context.scene, self.name) if ob.name in layer.objects]
        if not found:
            self.report({"WARNING"}, f"'{self.name}' is not in view layer '{layer.name}'")
            return {"CANCELLED"}
        for ob in list(layer.objects.selected):
            ob.select_set(False)
        for ob in found:
            ob.select_set(True)
        layer.objects.active = found[0]
        return {"FINISHED"}


class ClearCache(bpy.types.Operator):
    """Delete the baked materials and skies that are kept for later renders; the next render makes them again"""

    bl_idname = "lumigate.clear_cache"
    bl_label = "Clear Cache"
    bl_options = {"REGISTER"}

    def execute(self, _context: bpy.types.Context) -> set[str]:
        """Delete the folders."""
        freed = sum(_remove(folder()) for folder in _cache_folders())
        self.report({"INFO"}, f"{freed / 2**20:.1f} MiB freed")
        return {"FINISHED"}


def _cache_folders() -> tuple[Callable[[], Path], ...]:
    from .extract.world import cache_folder as worlds
    from .materials.bake import cache_folder as bakes

    return worlds, bakes


def _remove(folder: Path) -> int:
    """Delete a folder; bytes that were in it."""
    size = sum(file.stat().st_size for file in folder.glob("*") if file.is_file())
    shutil.rmtree(folder, ignore_errors=True)
    return size


CLASSES = (AddIndirectLight, MixLightGroups, Cancel, CheckScene, SelectNamed, ClearCache)
