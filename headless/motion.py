"""What moves in a Blender scene, and while the shutter is open."""

from __future__ import annotations

import bpy

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


def exposures(scene: bpy.types.Scene, frame: int, count: int) -> list[float]:
    """Times in frames at which a frame is exposed: the middles of `count` parts of the time that the scene's shutter is open."""
    if count == 1:
        return [float(frame)]
    opened = scene.render.motion_blur_shutter
    begin = frame + {"START": 0.0, "CENTER": -0.5 * opened, "END": -opened}[scene.render.motion_blur_position]
    return [begin + opened * (k + 0.5) / count for k in range(count)]
