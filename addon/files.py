"""Opening of scene files: Blender's own, and glTF and OBJ by import."""

from __future__ import annotations

import math
import mmap
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ..core.errors import SceneError

SUPPORTED = (".blend", ".glb", ".gltf", ".obj")
_REMARKS = "lumigate_import"  # of a scene: lines about what its file lacked


def open_scene(path: str | Path) -> bpy.types.Scene:
    """Load a file in place of the open one; its scene.

    Scripts in .blend files do not run.  An imported model that brings no camera gets one that frames it; one that brings no light is lit
    by an even white sky.

    Raises:
        SceneError: the file is missing, unreadable, empty or of an unsupported type.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUPPORTED:
        raise SceneError(f"cannot open '{path}': use one of {', '.join(SUPPORTED)}")
    if not path.is_file():
        raise SceneError(f"no such file: '{path}'")
    if suffix == ".blend":
        _checked(path, lambda: bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), use_scripts=False, load_ui=False))
        return bpy.context.scene
    bpy.ops.wm.read_factory_settings(use_empty=True)
    operator = bpy.ops.wm.obj_import if suffix == ".obj" else bpy.ops.import_scene.gltf
    _checked(path, lambda: operator(filepath=str(path.resolve())))
    meshes = [ob for ob in bpy.context.scene.objects if ob.type == "MESH" and len(ob.data.polygons)]
    if not meshes:
        raise SceneError(f"'{path}' holds no faces: there is nothing to render")
    scene = bpy.context.scene
    remarks = _lacking(path) if suffix == ".obj" else []
    if not any(ob.type == "LIGHT" for ob in scene.objects) and not any(map(_shines, bpy.data.materials)):
        _light_evenly(scene)
        remarks.append(f"'{path.name}' brings no light: an even white sky of radiance 1 lights it")
    scene[_REMARKS] = "\n".join(remarks)
    scene.camera = next((ob for ob in scene.objects if ob.type == "CAMERA"), None) or _framing_camera(scene, meshes)
    return scene


def import_remarks(scene: bpy.types.Scene) -> list[str]:
    """What was missing when `open_scene` imported this scene, a line each."""
    return str(scene.get(_REMARKS, "")).splitlines()


def _lacking(path: Path) -> list[str]:
    """A line for each material library that an OBJ file names and that is not there: Blender's importer says nothing of them."""
    names = []
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:
        at = text.find(b"mtllib")
        while at >= 0:
            text.seek(at)
            line = text.readline().decode(errors="replace").split(maxsplit=1)
            if (at == 0 or text[at - 1 : at] in b"\r\n") and len(line) == 2:
                names.append(line[1].strip())
            at = text.find(b"mtllib", at + 1)
    missing = [name for name in dict.fromkeys(names) if not (path.parent / name.replace("\\", "/")).is_file()]
    return [f"'{path.name}' names the material library '{name}', which is not beside it: its materials are grey" for name in missing]


def _shines(material: bpy.types.Material) -> bool:
    """Whether an importer has made a material that may emit light."""
    nodes = material.node_tree.nodes if material.node_tree else ()
    return any(node.type == "EMISSION" or (node.type == "BSDF_PRINCIPLED" and _emits(node)) for node in nodes)


def _emits(principled: bpy.types.Node) -> bool:
    color, strength = principled.inputs["Emission Color"], principled.inputs["Emission Strength"]
    return (color.is_linked or any(color.default_value[:3])) and (strength.is_linked or strength.default_value > 0)


def _light_evenly(scene: bpy.types.Scene) -> None:
    """A white sky of radiance 1."""
    scene.world = bpy.data.worlds.new("Sky")
    if scene.world.node_tree is None:  # before Blender 5
        scene.world.use_nodes = True
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (1, 1, 1, 1), 1.0


def _checked(path: Path, load) -> None:
    """Run a loading operator; its failure in one line."""
    try:
        done = "FINISHED" in load()
    except Exception as error:  # importers raise whatever a broken file provokes
        reason = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(f"cannot read '{path}', is it damaged? {reason}") from error
    if not done:
        raise SceneError(f"cannot read '{path}', is it damaged?")


def _framing_camera(scene: bpy.types.Scene, meshes: list[bpy.types.Object]) -> bpy.types.Object:
    """A camera that looks at everything, obliquely from above."""
    bpy.context.view_layer.update()
    corners = np.array([ob.matrix_world @ Vector(corner) for ob in meshes for corner in ob.bound_box])
    low, high = corners.min(0), corners.max(0)
    radius = max(0.5 * float(np.linalg.norm(high - low)), 1e-6)
    data = bpy.data.cameras.new("Camera")
    camera = bpy.data.objects.new("Camera", data)
    scene.collection.objects.link(camera)
    render = scene.render
    narrow = min(render.resolution_x, render.resolution_y) / max(render.resolution_x, render.resolution_y)
    half_angle = math.atan(math.tan(0.5 * data.angle) * narrow)
    direction = Vector((0.6, -0.7, 0.4)).normalized()
    distance = radius / math.sin(half_angle)
    camera.location = Vector(0.5 * (low + high)) + direction * distance
    camera.rotation_euler = direction.to_track_quat("Z", "Y").to_euler()
    data.clip_start, data.clip_end = 1e-3 * distance, 10 * distance
    return camera
