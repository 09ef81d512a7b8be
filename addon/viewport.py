"""The rendered viewport: a quick picture while the view moves, a better one with every moment that it rests.

Blender's data is read in its own calls, on the main thread; the light is computed in a job; what is drawn is always
the newest picture there is, however coarse.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d

from ..core.errors import SceneError
from ..core.film import Film
from ..core.scene import Camera, Scene
from ..core.settings import RenderSettings
from .job import Job, loading, render_job
from .region import WHOLE, Part, part_of, region_camera, render_region

_TICK = 0.05  # seconds between two looks at a running job
_REST = 0.3  # seconds without a change before a scene that is slow to read is read again
_QUICK = 0.1  # seconds that reading may take at every change
_REFINEMENTS = 32  # pictures whose mean a view that rests ends with
# Of the steps before the full picture: size of a pixel, and what is computed for it.
_COARSE, _FINE = 4, 1
_MOVING = {"method": "fuzzy-clustering", "vpls": 1024, "vpl_clusters": 200, "point_clusters": 1500, "pixel_samples": 1, "direct_samples": 1,
           "reflections": 1, "denoise": False, "downsampling": 1}  # fmt: skip
_RESTING = {"pixel_samples": 1, "direct_samples": 1, "samples": 4, "gather": 2, "reflections": 1,
            "light_groups": False, "downsampling": 1}  # fmt: skip


class _Eye(NamedTuple):
    """What a region of the screen looks through: matrices by rows, its size in pixels, whether it shows a part of the scene only, and
    what part of it is rendered.
    """

    view: tuple[float, ...]
    window: tuple[float, ...]
    width: int
    height: int
    partly: tuple[bool, bool]
    part: Part


class Viewport:
    """The pictures of one region, for as long as its engine lives."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._settings: RenderSettings | None = None
        self._exposure = 1.0
        self._eye: _Eye | None = None
        self._stale = True
        self._changed = 0.0
        self._reading = 0.0  # seconds that reading the scene took last
        self._job: Job | None = None
        self._late = False  # the job is for a view that is no more
        self._step = 0
        self._picture: np.ndarray | None = None  # (H, W, 4) float32, last row first
        self._part = WHOLE  # of the region, which the picture shows
        self._mean: np.ndarray | None = None
        self._texture: gpu.types.GPUTexture | None = None
        self._timer: Callable[[], None] | None = None
        self.problem = ""

    def update(self) -> None:
        """Something in the scene has changed."""
        self._stale = True
        self._changed = time.perf_counter()

    def draw(self, engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Draw the newest picture, and see to it that a better one comes."""
        if not loading().done:
            engine.update_stats("Lumigate", str(loading().progress))
            self._redraw_soon(engine)
            return
        # Not before `loading`, or the window would wait for Numba.
        from .extract.film import film_exposure

        region, eye = context.region, _looking(context)
        settings, exposure = viewport_settings(depsgraph.scene), film_exposure(depsgraph.scene)
        if self._eye is not None and eye.partly != self._eye.partly:
            self.update()
        if (eye, settings, exposure) != (self._eye, self._settings, self._exposure):
            self._eye, self._settings, self._exposure = eye, settings, exposure
            self._restart()
        if self._stale and (self._reading < _QUICK or time.perf_counter() - self._changed > _REST):
            self._read(depsgraph, context.space_data)
            self._restart()
        self._collect()
        if self._scene is not None and self._job is None and self._step <= _REFINEMENTS + 1:
            self._job = self._begin()
        self._paint(engine, depsgraph.scene, region)
        done = not self._stale and (self._scene is None or self._step > _REFINEMENTS + 1)
        engine.update_stats("Lumigate", self.problem or ("" if done else f"picture {self._step} of {_REFINEMENTS + 2}"))
        if not done:
            self._redraw_soon(engine)

    def _redraw_soon(self, engine: bpy.types.RenderEngine) -> None:
        """Draw again in a moment; by then the engine may be gone, and nobody waits for the job any more."""
        if self._timer is not None and bpy.app.timers.is_registered(self._timer):
            return

        def again() -> float | None:
            if self._waiting():
                return _TICK
            try:
                engine.tag_redraw()
            except ReferenceError:
                if self._job is not None:
                    self._job.cancel()

            return None

        self._timer = again
        bpy.app.timers.register(again, first_interval=_TICK)

    def _waiting(self) -> bool:
        """Whether there is nothing new to draw: to draw the old picture again would take the job's time."""
        if not loading().done:
            return True
        return self._job is not None and not self._job.done and not self._stale

    def _read(self, depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None) -> None:
        from .extract import extract_shown

        self._stale, self.problem = False, ""
        begin = time.perf_counter()
        try:
            self._scene = extract_shown(depsgraph, self._camera(_FINE), space)
            black = [line for line in self._scene.warnings if "is black until" in line]
            self.problem = black[0] if black else ""
        except SceneError as error:
            self._scene, self.problem = None, str(error)
        self._reading = time.perf_counter() - begin

    def _restart(self) -> None:
        """Begin with the coarse picture again; the last one stays on the screen until then.

        A coarse picture under way is finished, though it is late: a view that never rests would else show nothing.
        """
        self._late = self._job is not None and self._step == 0
        if self._job is not None and not self._late:
            self._job.cancel()
            self._job = None
        self._step, self._mean = 0, None

    def _camera(self, pixel: int) -> Camera:
        """What the region looks through, in world space, with pixels that are `pixel` of its own wide."""
        width, height = max(1, self._eye.width // pixel), max(1, self._eye.height // pixel)
        return region_camera(*(np.reshape(rows, (4, 4)) for rows in self._eye[:2]), width, height, self._eye.part)

    def _begin(self) -> Job:
        """The job of the next picture: coarse, then whole ones, each with random numbers of its own."""
        camera = self._camera(_COARSE if self._step == 0 else _FINE)
        camera.matrix[:3, 3] -= self._scene.origin
        scene = replace(self._scene, camera=camera)
        own = _MOVING if self._step == 0 else _RESTING
        settings = replace(
            self._settings,
            **own,
            seed=self._settings.seed + self._step,
            layers=("Combined",),
            time_budget=None,
            target_error=None,
            quality=None,
            debug_layers=False,
        )
        return render_job(scene, settings, exposure=self._exposure, afterwards=lambda result: (result.layers["Combined"], camera))

    def _collect(self) -> None:
        """Take what the job has found: the mean of all whole pictures so far."""
        if self._job is None or not self._job.done:
            return
        job, self._job = self._job, None
        if job.cancelled:
            return
        if job.error is not None:
            self.problem, self._step = str(job.error), _REFINEMENTS + 2
            return
        found, camera = job.result
        found, self._part = found[::-1], part_of(camera.border, camera.width, camera.height)
        if self._step > 0:
            self._mean = found if self._mean is None else self._mean + (found - self._mean) / np.float32(self._step)
            found = self._mean
        self._picture = found if found.shape[2] == 4 else np.concatenate([found, np.ones_like(found[..., :1])], axis=2)
        self._texture = None
        self._step, self._late = (0 if self._late else self._step + 1), False

    def _paint(self, engine: bpy.types.RenderEngine, scene: bpy.types.Scene, region: bpy.types.Region) -> None:
        if self._picture is None:
            return
        if self._texture is None:
            height, width = self._picture.shape[:2]
            pixels = gpu.types.Buffer("FLOAT", width * height * 4, np.ascontiguousarray(self._picture).ravel())
            self._texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=pixels)
        gpu.state.blend_set("ALPHA_PREMULT")
        engine.bind_display_space_shader(scene)
        left, bottom, right, top = self._part
        place = left * region.width, bottom * region.height
        draw_texture_2d(self._texture, place, (right - left) * region.width, (top - bottom) * region.height)
        engine.unbind_display_space_shader()
        gpu.state.blend_set("NONE")


def viewport_settings(scene: bpy.types.Scene) -> RenderSettings:
    """The scene's settings, and what of its film a viewport shows: whether the world is transparent."""
    return replace(scene.lumigate.as_settings(), film=Film(transparent=scene.render.film_transparent))


def _looking(context: bpy.types.Context) -> _Eye:
    view, region = context.region_data, context.region
    flat = (tuple(value for row in matrix for value in row) for matrix in (view.view_matrix, view.window_matrix))
    space = context.space_data
    partly = space.local_view is not None, space.use_local_collections
    return _Eye(*flat, region.width, region.height, partly, render_region(context.scene, space, view, region))
