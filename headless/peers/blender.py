"""The neutral scene as Blender's open scene, for Lumigate and Cycles."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ...core.scene import AREA, ELLIPSE, POINT, SPOT, SUN, Lamps
from ..console import quiet
from ..keeping import KEPT
from .neutral import Neutral, Sheet, Surface

_KINDS = {POINT: "POINT", SPOT: "SPOT", SUN: "SUN", AREA: "AREA"}
_SENSOR = 36.0  # mm


def build(neutral: Neutral) -> bpy.types.Scene:
    """A new, empty file that holds the neutral scene and nothing else."""
    KEPT.drop()
    with quiet():
        bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = neutral.camera.width, neutral.camera.height
    scene.render.resolution_percentage = 100
    for sheet in neutral.sheets:
        _place(sheet.surface.name, _mesh(sheet))
    for number in range(len(neutral.lamps)):
        _lamp(neutral.lamps, number)
    _world(neutral.world, scene)
    _camera(neutral, scene)
    return scene


def _place(name: str, data: bpy.types.ID) -> bpy.types.Object:
    thing = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def _mesh(sheet: Sheet) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new(sheet.surface.name)
    count = 3 * len(sheet.positions)
    mesh.vertices.add(count)
    mesh.loops.add(count)
    mesh.polygons.add(len(sheet.positions))
    mesh.vertices.foreach_set("co", sheet.positions.ravel())
    mesh.loops.foreach_set("vertex_index", np.arange(count, dtype=np.int32))
    mesh.polygons.foreach_set("loop_start", np.arange(0, count, 3, dtype=np.int32))
    mesh.uv_layers.new(name="UV").data.foreach_set("uv", sheet.uv.ravel())
    mesh.update(calc_edges=True)
    mesh.normals_split_custom_set(sheet.normals.reshape(-1, 3))
    mesh.materials.append(_material(sheet.surface))
    return mesh


def _image(name: str, values: np.ndarray) -> bpy.types.Image:
    """values: (H, W) or (H, W, 3) in 0..1, row 0 at the bottom; linear, in 8 bits."""
    height, width = values.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=False)
    image.colorspace_settings.name = "Non-Color"
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = values if values.ndim == 3 else values[..., None]
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    return image


def _new_tree(owner: bpy.types.ID, output: str) -> tuple[bpy.types.NodeTree, bpy.types.Node]:
    if owner.node_tree is None:
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree, owner.node_tree.nodes.new(output)


def _value(tree: bpy.types.NodeTree, socket: bpy.types.NodeSocket, name: str, value: np.ndarray) -> None:
    """The constant or the image at a socket."""
    if value.ndim in (2, 3):
        texture = tree.nodes.new("ShaderNodeTexImage")
        texture.image = _image(name, value)
        tree.links.new(texture.outputs["Color"], socket)
    else:
        socket.default_value = (*map(float, value), 1.0) if value.ndim else float(value)


def _material(surface: Surface) -> bpy.types.Material:
    material = bpy.data.materials.new(surface.name)
    tree, output = _new_tree(material, "ShaderNodeOutputMaterial")
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    _value(tree, shader.inputs["Color"], f"{surface.name} albedo", surface.albedo)
    result = shader.outputs[0]
    if surface.shines:
        emission, total = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeAddShader")
        strength = float(surface.emission.max())
        emission.inputs["Color"].default_value = (*(surface.emission / strength).tolist(), 1)
        emission.inputs["Strength"].default_value = strength
        tree.links.new(result, total.inputs[0])
        tree.links.new(emission.outputs[0], total.inputs[1])
        result = total.outputs[0]
    if not surface.is_opaque:
        mix, through = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
        _value(tree, mix.inputs[0], f"{surface.name} opacity", surface.opacity)
        tree.links.new(through.outputs[0], mix.inputs[1])
        tree.links.new(result, mix.inputs[2])
        result = mix.outputs[0]
    tree.links.new(result, output.inputs["Surface"])
    return material


def _lamp(lamps: Lamps, number: int) -> None:
    """The inverse of `addon.extract.lamps`."""
    kind, emission = int(lamps.kind[number]), lamps.emission[number].astype(float)
    strength = emission.max() or 1.0  # a dark one has no colour
    light = bpy.data.lights.new(lamps.names[number], _KINDS[kind])
    light.color = emission / strength
    if kind == AREA:
        width, height = map(float, lamps.size[number])
        is_ellipse = lamps.shape[number] == ELLIPSE
        light.shape, light.size, light.size_y = "ELLIPSE" if is_ellipse else "RECTANGLE", width, height
        light.spread = np.pi
        light.energy = np.pi * strength * width * height * (0.25 * np.pi if is_ellipse else 1)
    elif kind == SUN:
        light.energy, light.angle = strength, 0.0
    else:
        light.energy, light.shadow_soft_size = 4 * np.pi * strength, 0.0
    if kind == SPOT:
        light.spot_size, light.spot_blend = float(lamps.angle[number]), 0.0
    thing = _place(lamps.names[number], light)
    thing.visible_camera = kind == AREA
    placed = np.eye(4)
    placed[:3, :3], placed[:3, 3] = lamps.axes[number].T, lamps.position[number]
    thing.matrix_world = Matrix(placed.tolist())


def _world(radiance: np.ndarray, scene: bpy.types.Scene) -> None:
    world = scene.world = bpy.data.worlds.new("World")
    tree, output = _new_tree(world, "ShaderNodeOutputWorld")
    background = tree.nodes.new("ShaderNodeBackground")
    background.inputs["Strength"].default_value = 1.0
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    if radiance.ndim == 1:
        background.inputs["Color"].default_value = (*map(float, radiance), 1)
        return
    height, width = radiance.shape[:2]
    image = bpy.data.images.new("World", width, height, alpha=False, float_buffer=True)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = radiance[::-1]
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])


def _camera(neutral: Neutral, scene: bpy.types.Scene) -> None:
    camera = neutral.camera
    left, right, bottom, top = camera.window
    data = bpy.data.cameras.new(camera.name or "Camera")
    data.sensor_fit, data.sensor_width, data.lens = "HORIZONTAL", _SENSOR, _SENSOR / (right - left)
    data.shift_x, data.shift_y = 0.5 * (left + right) / (right - left), 0.5 * (bottom + top) / (right - left)
    data.clip_start, data.clip_end = camera.near, camera.far
    scene.camera = _place(data.name, data)
    scene.camera.matrix_world = Matrix(camera.matrix.tolist())
