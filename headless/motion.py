"""What moves in a Blender scene, and while the shutter is open."""

from __future__ import annotations

import bpy

from ..addon.extract.meshes import node_trees

# Modifiers whose result depends on nothing but the mesh and their own (animatable) settings.
_STILL_MODIFIERS = {
    "ARRAY", "BEVEL", "BOOLEAN", "DECIMATE", "EDGE_SPLIT", "MASK", "MIRROR", "MULTIRES", "NORMAL_EDIT", "REMESH", "SCREW", "SIMPLE_DEFORM",
    "SKIN", "SMOOTH", "SOLIDIFY", "SUBSURF", "TRIANGULATE", "UV_PROJECT", "UV_WARP", "WEIGHTED_NORMAL", "WELD", "WIREFRAME",
}  # fmt: skip


def moving_objects(scene: bpy.types.Scene) -> frozenset[str]:
    """Names of the objects that may be elsewhere, or otherwise, at another frame."""
    return frozenset(ob.name for ob in scene.objects if ob.type not in ("CAMERA", "LIGHT") and _moves(ob))


def _moves(ob: bpy.types.Object) -> bool:
    keys = getattr(ob.data, "shape_keys", None)
    own = any(_animated(block) for block in (ob, ob.data, keys))
    pulled = bool(ob.constraints) or ob.rigid_body is not None or any(m.type not in _STILL_MODIFIERS for m in ob.modifiers)
    return own or pulled or (ob.parent is not None and _moves(ob.parent))


def _animated(block: bpy.types.ID | None) -> bool:
    data = getattr(block, "animation_data", None)
    return data is not None and (data.action is not None or bool(data.drivers) or bool(data.nla_tracks))


# Constraints whose result depends on nothing but the transforms of objects.
_PLAIN_CONSTRAINTS = {
    "CHILD_OF", "COPY_LOCATION", "COPY_ROTATION", "COPY_SCALE", "COPY_TRANSFORMS", "DAMPED_TRACK", "LIMIT_DISTANCE", "LIMIT_LOCATION",
    "LIMIT_ROTATION", "LIMIT_SCALE", "LOCKED_TRACK", "PIVOT", "STRETCH_TO", "TRACK_TO", "TRANSFORM",
}  # fmt: skip

_BYSTANDERS = (bpy.types.Scene, bpy.types.Collection, bpy.types.Screen, bpy.types.WindowManager)  # know others, but do not follow them


def only_cameras_and_lamps_move(scene: bpy.types.Scene) -> bool:
    """Whether nothing but cameras, lamps, and what they hang on, can be otherwise at another frame; False where that is not certain.

    What moves is told by what has keys, drivers, physics and modifiers, not by evaluating frames: so it holds for every frame.
    """
    handlers = (bpy.app.handlers.frame_change_pre, bpy.app.handlers.frame_change_post)
    if any(handlers) or bpy.data.cache_files or any(volume.is_sequence for volume in bpy.data.volumes):
        return False
    if any(image.source in ("SEQUENCE", "MOVIE") for image in bpy.data.images):
        return False
    if any(_asks_for_the_camera(node) for tree in node_trees() for node in tree.nodes):
        return False
    chain = {ob for ob in bpy.data.objects if ob.type in ("CAMERA", "LIGHT")}
    for ob in list(chain):
        while ob.parent is not None:
            chain.add(ob := ob.parent)
    # A lamp that hangs on a mesh stays where the mesh does, which has to stand still then.
    chain -= {ob for ob in chain if ob.type not in ("CAMERA", "LIGHT", "EMPTY")}
    if any(constraint.type not in _PLAIN_CONSTRAINTS for ob in chain for constraint in ob.constraints):
        return False
    free = chain | {ob.data for ob in chain if ob.data is not None}
    users = bpy.data.user_map()
    still = (block for block in users if block not in free)
    if any(_animated(block) or _animated(getattr(block, "node_tree", None)) for block in still):
        return False
    if any(ob not in chain and _moves(ob) for ob in bpy.data.objects):
        return False
    # Whatever else looks at one of these, or hangs on it, may follow it.
    others = set().union(*(users[ob] for ob in chain)) - free if chain else set()
    return all(isinstance(block, _BYSTANDERS) for block in others)


def _asks_for_the_camera(node: bpy.types.Node) -> bool:
    names = {"ShaderNodeCameraData": None, "ShaderNodeTexCoord": ("Camera", "Window")}
    if node.bl_idname not in names:
        return False
    wanted = names[node.bl_idname]
    return any(output.is_linked for output in node.outputs if wanted is None or output.name in wanted)


def exposures(scene: bpy.types.Scene, frame: int, count: int) -> list[float]:
    """Times in frames at which a frame is exposed: the middles of `count` parts of the time that the scene's shutter is open."""
    if count == 1:
        return [float(frame)]
    opened = scene.render.motion_blur_shutter
    begin = frame + {"START": 0.0, "CENTER": -0.5 * opened, "END": -opened}[scene.render.motion_blur_position]
    return [begin + opened * (k + 0.5) / count for k in range(count)]
