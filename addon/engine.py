"""The render engine: F12, animations, and the rendered viewport."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import bpy

from ..core.errors import SceneError
from .job import Job, loading, render_job
from .passes import COMBINED, debug_names, group_names, hand_over, left_out, long_name, long_names, passes_of, register_passes

if TYPE_CHECKING:
    from ..core.scene import Camera, Scene
    from ..core.settings import RenderSettings
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
            scene, settings, seconds = self._read(depsgraph)
            eyes = self._eyes(depsgraph, scene)
            for number, (view, camera) in enumerate(eyes):
                seen = replace(scene, camera=camera)
                job = render_job(seen, settings, extraction_seconds=seconds, exposure=_exposure(depsgraph.scene))
                if not self._watch(job, number / len(eyes), 1 / len(eyes)):
                    return
                if job.error is not None:
                    raise job.error
                layers = job.result.layers
                hand_over(self, layers, [*passes_of(depsgraph.scene, depsgraph.view_layer), *debug_names(layers)], view)
            self._tell(job.result.stats, depsgraph)
        except SceneError as error:
            self._refuse(error)

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

    def _read(self, depsgraph: bpy.types.Depsgraph) -> tuple[Scene, RenderSettings, float]:
        """Blender's data, here, where it may be read; the request; seconds that it took."""
        from .extract import extract_scene
        from .extract.film import extract_film

        self.update_stats("", "Lumigate: reading the scene")
        begin = time.perf_counter()
        camera = self.camera_override
        scene = extract_scene(depsgraph.scene, camera=camera and camera.name, depsgraph=depsgraph)
        wanted = (COMBINED, *depsgraph.view_layer.lumigate.wanted())
        settings = replace(depsgraph.scene_eval.lumigate.as_settings(), layers=wanted, film=extract_film(depsgraph.scene))
        return scene, settings, time.perf_counter() - begin

    def _eyes(self, depsgraph: bpy.types.Depsgraph, scene: Scene) -> list[tuple[str, Camera]]:
        """Name and camera of each view to render: of several only with stereoscopy, else one of no name."""
        from .extract.camera import extract_camera, image_frame

        render = depsgraph.scene.render
        if not render.use_multiview:
            return [("", scene.camera)]
        found = []
        for view in (view.name for view in render.views if view.use):
            self.active_view_set(view)
            eye = self.camera_override or depsgraph.scene_eval.camera
            camera = extract_camera(
                eye, image_frame(depsgraph.scene), matrix=self.camera_model_matrix(eye), shift_x=self.camera_shift_x(eye)
            )
            camera.matrix[:3, 3] -= scene.origin
            found.append((view, camera))
        return found

    def _watch(self, job: Job, begin: float = 0.0, share: float = 1.0) -> bool:
        """Show how far the job is until it ends; False where the user has cancelled it.

        begin, share: where in the whole work it begins, and its part of it, 0 to 1.
        """
        shown = ""
        while not job.wait(_POLL):
            if self.test_break():
                job.cancel()
                return False
            if shown != str(job.progress):
                shown = str(job.progress)
                self.update_stats("", f"Lumigate: {shown}")
            self.update_progress(begin + share * job.progress.fraction)
        return not job.cancelled

    def _tell(self, stats: dict, depsgraph: bpy.types.Depsgraph) -> None:
        """What of the picture is wrong, and what it took."""
        too_long = long_names(group_names(depsgraph.scene, depsgraph.view_layer))
        for warning in (*stats["warnings"], *(long_name(name) for name in too_long), *left_out(depsgraph.view_layer)):
            self.report({"WARNING"}, warning)
        self.update_progress(1.0)
        self.update_stats("", f"Lumigate: {stats['method']}, {stats['seconds_total']:.1f} s")

    def _refuse(self, error: SceneError) -> None:
        """Say what is wrong with the scene: to whoever has started the render, and above the picture that there is not."""
        self.report({"ERROR"}, str(error))
        self.error_set(str(error))


def _exposure(scene: bpy.types.Scene) -> float:
    from .extract.film import film_exposure

    return film_exposure(scene)


CLASSES = (LumigateEngine,)
