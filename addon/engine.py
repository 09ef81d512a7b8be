"""The render engine: F12, animations, and the rendered viewport."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import bpy

from ..core.errors import SceneError
from .job import Job, loading, render_job
from .passes import COMBINED, group_names, hand_over, left_out, long_name, long_names, passes_of, register_passes

if TYPE_CHECKING:
    from .viewport import Viewport

_POLL = 0.03  # seconds between two looks at Esc


class LumigateEngine(bpy.types.RenderEngine):
    """Direct and indirect light by virtual point lights, as Blender's renderer."""

    bl_idname = "LUMIGATE"
    bl_label = "Lumigate"
    bl_use_preview = False  # material icons stay Blender's
    bl_use_eevee_viewport = True  # so does Material Preview
    bl_use_shading_nodes_custom = False

    def update_render_passes(self, scene: bpy.types.Scene | None = None, renderlayer: bpy.types.ViewLayer | None = None) -> None:
        """Called by Blender to know the view layer's sockets."""
        register_passes(self, scene, renderlayer)

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Called by Blender for one frame of one view layer, in the thread of its render job."""
        if not self._watch(loading()):
            return
        try:
            job = self._begin(depsgraph)
        except SceneError as error:
            self._refuse(error)
            return
        if not self._watch(job):
            return
        if isinstance(job.error, SceneError):
            self._refuse(job.error)
        elif job.error is not None:
            raise job.error
        else:
            self._deliver(job, depsgraph)

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Called by Blender when what a rendered viewport shows has changed."""
        self._shown().update()

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Called by Blender to draw a rendered viewport."""
        self._shown().draw(self, context, depsgraph)

    def _shown(self) -> Viewport:
        """The pictures of this engine's region."""
        if "viewport" not in self.__dict__:
            # Drawing needs a window, which not every Blender has.
            from .viewport import Viewport

            self.viewport = Viewport()
        return self.viewport

    def _begin(self, depsgraph: bpy.types.Depsgraph) -> Job:
        """Read Blender's data here, where it may be read, and start the rest."""
        from .extract import extract_scene
        from .extract.film import extract_film, film_exposure

        self.update_stats("", "Lumigate: reading the scene")
        begin = time.perf_counter()
        camera = self.camera_override
        arrays = extract_scene(depsgraph.scene, camera=camera and camera.name, depsgraph=depsgraph)
        wanted = (COMBINED, *depsgraph.view_layer.lumigate.wanted())
        settings = replace(depsgraph.scene_eval.lumigate.as_settings(), layers=wanted, film=extract_film(depsgraph.scene))
        seconds, exposure = time.perf_counter() - begin, film_exposure(depsgraph.scene)
        return render_job(arrays, settings, extraction_seconds=seconds, exposure=exposure)

    def _watch(self, job: Job) -> bool:
        """Show how far the job is until it ends; False where the user has cancelled it."""
        shown = ""
        while not job.wait(_POLL):
            if self.test_break():
                job.cancel()
                return False
            if shown != str(job.progress):
                shown = str(job.progress)
                self.update_stats("", f"Lumigate: {shown}")
            self.update_progress(job.progress.fraction)
        return not job.cancelled

    def _deliver(self, job: Job, depsgraph: bpy.types.Depsgraph) -> None:
        layers, stats = job.result.layers, job.result.stats
        hand_over(self, layers, passes_of(depsgraph.scene, depsgraph.view_layer))
        too_long = long_names(group_names(depsgraph.scene, depsgraph.view_layer))
        for warning in (*stats["warnings"], *(long_name(name) for name in too_long), *left_out(depsgraph.view_layer)):
            self.report({"WARNING"}, warning)
        self.update_progress(1.0)
        self.update_stats("", f"Lumigate: {stats['method']}, {stats['seconds_total']:.1f} s")

    def _refuse(self, error: SceneError) -> None:
        """Say what is wrong with the scene: to whoever has started the render, and above the picture that there is not."""
        self.report({"ERROR"}, str(error))
        self.error_set(str(error))


CLASSES = (LumigateEngine,)
