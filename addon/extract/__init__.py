"""From Blender's evaluated scene to the arrays of `core.scene`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.scene import Camera, Scene
from ..files import import_remarks
from ..materials import MaterialUse, Shot, compile_materials
from .camera import camera_warnings, extract_camera, find_camera, image_frame
from .evaluation import in_render_depsgraph
from .geometry import Collected, assemble, collect
from .lamps import CollectedLamps, collect_lamps, to_arrays, with_programs
from .links import Links
from .world import SUN_OF_SKY, Cycles, extract_world

__all__ = ["extract_camera_and_lamps", "extract_scene", "extract_shown"]


def extract_scene(
    scene: bpy.types.Scene,
    *,
    camera: str | None = None,
    size: tuple[int, int] | None = None,
    frame: float | None = None,
    view_layer: bpy.types.ViewLayer | str | None = None,
    depsgraph: bpy.types.Depsgraph | None = None,
    lightmaps: Mapping[str, str] | None = None,
) -> Scene:
    """A scene as a render sees it, in arrays.

    camera: name of a camera object, else the scene's active one.  size: width and height of the full
    frame, else the scene's.  frame: sets the scene to it first; a fraction is a sub-frame.  view_layer: else the first one that
    is used for rendering.
    depsgraph: the evaluation to read.  A render engine passes its own and must pass one; elsewhere
    leave it out, and the scene is evaluated as for a render.
    lightmaps: for a bake, the UV map of each object by name; the result then has no camera, and none is needed.

    Raises:
        SceneError: no camera, one that cannot be rendered from, no pixels, or too much geometry.
    """
    _go_to(scene, frame)
    eye = find_camera(scene, camera) if lightmaps is None else None
    pixels = eye and image_frame(scene, size)
    warnings = camera_warnings(eye, scene, views=depsgraph is not None) if eye else []
    layer = _view_layer(scene, view_layer, depsgraph)

    def read(graph: bpy.types.Depsgraph):
        links = Links.of(graph)
        return collect(graph, lightmaps, links), collect_lamps(graph, links), eye and extract_camera(eye.evaluated_get(graph), pixels)

    found: Collected
    lamps: CollectedLamps
    if depsgraph is None:
        _flush_edits(scene)
    found, lamps, view = in_render_depsgraph(scene, layer, read) if depsgraph is None else read(depsgraph)
    if depsgraph is None:
        layer.update()
    graph = depsgraph if depsgraph is not None else layer.depsgraph
    extracted = _assembled(scene, layer, graph, found, lamps, view, "apart" if depsgraph is not None else "here")
    extracted.warnings[:0] = warnings
    return extracted


def extract_camera_and_lamps(
    before: Scene, scene: bpy.types.Scene, *, camera: str | None, size: tuple[int, int] | None, frame: float
) -> Scene:
    """The arrays of another frame in which nothing but the camera and lamps has moved, on those of the scene `before`.

    Raises what `extract_scene` does of cameras.  The viewport's evaluation is asked, which costs next to nothing; where it lacks the
    camera, or shows other lamps than a render, the whole scene is read.
    """
    _go_to(scene, frame)
    layer = scene.view_layers[before.view_layer]
    layer.update()
    eye = find_camera(scene, camera).evaluated_get(layer.depsgraph)
    links = Links.of(layer.depsgraph)
    found = collect_lamps(layer.depsgraph, links)
    lamps = to_arrays(found.lamps, before.origin)
    suns = before.lamps.take(np.array([name.endswith(SUN_OF_SKY) for name in before.lamps.names], bool))
    uneven = any(lamp.use is not None for lamp in found.lamps)  # their programs hold where they are
    if not eye.is_evaluated or uneven or links or lamps.names + suns.names != before.lamps.names:
        return extract_scene(scene, camera=camera, size=size, view_layer=layer)
    view = extract_camera(eye, image_frame(scene, size))
    view.matrix[:3, 3] -= before.origin
    return replace(before, camera=view, lamps=lamps.joined(suns), frame=scene.frame_current)


def _flush_edits(scene: bpy.types.Scene) -> None:
    """What is being edited goes to its data-block, as before a render of Blender's own: Cycles bakes what stands there."""
    for ob in scene.objects:
        if ob.mode == "EDIT":
            ob.update_from_editmode()


def _go_to(scene: bpy.types.Scene, frame: float | None) -> None:
    if frame is not None and frame != scene.frame_current + scene.frame_subframe:  # `frame_current_final` is remapped
        scene.frame_set(math.floor(frame), subframe=frame % 1.0)


def extract_shown(depsgraph: bpy.types.Depsgraph, camera: Camera, space: bpy.types.SpaceView3D | None = None) -> Scene:
    """What a viewport's evaluation shows, seen by `camera` (in world space): nothing is baked or rendered for it.

    space: the viewport, of which the local view and local collections count.

    Raises:
        SceneError: too much geometry.
    """
    scene = depsgraph.scene
    layer = scene.view_layers[depsgraph.view_layer_eval.name]
    links = Links.of(depsgraph)
    found, lamps = collect(depsgraph, links=links, space=space), collect_lamps(depsgraph, links, space)
    return _assembled(scene, layer, depsgraph, found, lamps, camera, "not")


def _assembled(
    scene: bpy.types.Scene,
    layer: bpy.types.ViewLayer,
    graph: bpy.types.Depsgraph,
    found: Collected,
    lamps: CollectedLamps,
    view: Camera | None,
    cycles: Cycles,
) -> Scene:
    """The arrays of what was collected from an evaluation.

    cycles: where it may compute what only it can: in this file, in a process of its own, or not now.
    """
    uneven = [replace(lamp.use, light=lamp.use.light.evaluated_get(graph)) for lamp in lamps.lamps if lamp.use is not None]
    compiled = compile_materials(_uses(found, graph), lamps=uneven, may_bake=cycles == "here", shot=_shot(scene, layer, view))
    with_programs(lamps.lamps, compiled.lamps)
    geometry, origin, dropped = assemble(found, compiled)
    world = extract_world(scene, layer, graph, cycles)
    if lamps.portals:
        world.world.portals = (np.array(lamps.portals) - np.outer((1, 0, 0), origin)).astype(np.float32)
    if view is not None:
        view.matrix[:3, 3] -= origin
    return Scene(
        geometry=geometry,
        materials=compiled.materials,
        lamps=to_arrays(lamps.lamps + world.suns, origin),
        world=world.world,
        camera=view,
        origin=origin,
        frame=scene.frame_current,
        view_layer=layer.name,
        light_groups=tuple(group.name for group in layer.lightgroups),
        warnings=[
            *import_remarks(scene),
            *found.warnings,
            *found.links.warnings,
            *dropped,
            *lamps.warnings,
            *world.warnings,
            *compiled.warnings,
        ],
        skipped=[*found.skipped, *lamps.skipped],
    )


def _shot(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, view: Camera | None) -> Shot:
    owners = tuple(owner for owner in (layer, scene, scene.world) if owner is not None)
    if view is None or view.panorama or view.name not in scene.objects:
        return Shot(scene.frame_current, owners=owners)
    return Shot(scene.frame_current, view.name, view.window, view.orthographic, owners)


def _view_layer(
    scene: bpy.types.Scene, asked: bpy.types.ViewLayer | str | None, depsgraph: bpy.types.Depsgraph | None
) -> bpy.types.ViewLayer:
    if depsgraph is not None:
        return scene.view_layers[depsgraph.view_layer_eval.name]
    if isinstance(asked, bpy.types.ViewLayer):
        return asked
    if asked is not None:
        if asked not in scene.view_layers:
            raise SceneError(f"no view layer '{asked}' in scene '{scene.name}'; it has: {', '.join(scene.view_layers.keys())}")
        return scene.view_layers[asked]
    return next((layer for layer in scene.view_layers if layer.use), scene.view_layers[0])


def _uses(found: Collected, graph: bpy.types.Depsgraph) -> list[MaterialUse]:
    """Each material with the objects that wear it, as evaluated (drivers, animation) in `graph`."""
    wearers: dict[bpy.types.Material | None, dict[bpy.types.Object, None]] = {material: {} for material in found.materials}
    for members in found.batches:
        for material in found.parts[members[0]].worn:
            wearers[material].update((found.parts[i].original, None) for i in members)
    return [
        MaterialUse(material and material.evaluated_get(graph), tuple(ob.evaluated_get(graph) for ob in objects))
        for material, objects in wearers.items()
    ]
