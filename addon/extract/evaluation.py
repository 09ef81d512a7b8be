"""A dependency graph in render mode, wherever the code runs.

Python can only ask Blender for the viewport's evaluation, which takes the viewport's subdivision
levels, particle counts and visibility.  A render engine gets the evaluation that Cycles gets, so
outside of a render an engine that draws nothing is run for the moment (1-8 ms in real scenes).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

import bpy

from ...core.errors import SceneError

Result = TypeVar("Result")

# Blender refuses to render less than 16 pixels a side.
_SMALL = {
    "resolution_x": 16,
    "resolution_y": 16,
    "resolution_percentage": 100,
    "use_border": False,
    "use_single_layer": False,
    "use_compositing": False,
    "use_sequencer": False,
}


@contextmanager
def overridden(target: Any, **values: Any) -> Iterator[None]:
    """Attributes of a Blender struct set for the time of a `with` block."""
    before = {name: getattr(target, name) for name in values}
    try:
        for name, value in values.items():
            setattr(target, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(target, name, value)


@contextmanager
def _some_camera(scene: bpy.types.Scene) -> Iterator[None]:
    """A camera for the time of a `with` block: Blender renders nothing without one, whatever the engine would look at."""
    data = bpy.data.cameras.new("Lumigate")
    camera = bpy.data.objects.new("Lumigate", data)
    try:
        with overridden(scene, camera=camera):
            yield
    finally:
        bpy.data.objects.remove(camera)
        bpy.data.cameras.remove(data)


def in_render_depsgraph(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, work: Callable[[bpy.types.Depsgraph], Result]) -> Result:
    """`work(depsgraph)` with the render evaluation of the scene's present frame; its result.

    For the time of it `scene.render` is not the user's: read what is needed of that before.  Not to be called while another render runs (a render engine has its own `depsgraph`).
    """
    results: list[Result] = []
    errors: list[BaseException] = []

    class Probe(bpy.types.RenderEngine):
        bl_idname = "LUMIGATE_PROBE"
        bl_label = "Lumigate scene extraction"
        bl_use_postprocess = False

        def render(self, depsgraph):
            try:
                results.append(work(depsgraph))
            except BaseException as error:
                errors.append(error)  # Blender would print it and go on

    bpy.utils.register_class(Probe)
    try:
        with ExitStack() as stack:
            if scene.camera is None:
                stack.enter_context(_some_camera(scene))
            stack.enter_context(overridden(scene.render, engine=Probe.bl_idname, **_SMALL))
            for layer in scene.view_layers:  # the operator's own argument for this renders the first one too
                stack.enter_context(overridden(layer, use=layer == view_layer))
            bpy.ops.render.render(scene=scene.name)
    except RuntimeError as error:
        raise SceneError(f"Blender cannot evaluate scene '{scene.name}' for a render: {error}") from error
    finally:
        bpy.utils.unregister_class(Probe)
    if errors:
        raise errors[0]
    if not results:
        raise SceneError(
            f"view layer '{view_layer.name}' of scene '{scene.name}' was not rendered: enable 'Use for Rendering' in its properties"
        )
    return results[0]
