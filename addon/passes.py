"""The layers of a render as Blender's passes: which there are, and which a view layer wants."""

from __future__ import annotations

import bpy
import numpy as np

from ..core.layers import CONTRACT, GROUP_LAYERS, VECTORS, Layers
from ..core.scene import REMAINDER

COMBINED = "Combined"
_HELP = {
    "Direct": "Light that comes straight from lamps and emitters, reflected once",
    "Indirect": "Light that left another surface before: diffuse and glossy",
    "DiffuseIndirect": "Indirect light that the visible surface scatters",
    "GlossyIndirect": "Indirect light that the visible surface mirrors or transmits",
    "Irradiance": "Indirect light that arrives at the surface, free of its albedo (W/m²)",
    "Albedo": "Colour of the surface: the share of light that it scatters",
    "Emission": "Light of the emitters and of the world, as the camera sees them",
    "Normal": "Shading normal in world space",
    "Position": "Position in world space (m)",
    "Depth": "Distance along the view (m)",
}
# Passes of other renderers that have no counterpart here.
_FOREIGN = {
    "use_pass_mist": "Mist",
    "use_pass_vector": "Vector",
    "use_pass_uv": "UV",
    "use_pass_object_index": "Object Index",
    "use_pass_material_index": "Material Index",
    "use_pass_ambient_occlusion": "Ambient Occlusion",
    "use_pass_shadow": "Shadow",
    "use_pass_cryptomatte_object": "Cryptomatte Object",
    "use_pass_cryptomatte_material": "Cryptomatte Material",
    "use_pass_cryptomatte_asset": "Cryptomatte Asset",
}
LONGEST_GROUP = 63 - len("Combined_")  # bytes, of 63 that a pass may be called
OPTIONAL = tuple(name for name in CONTRACT if name != COMBINED)


def _channels(name: str, count: int = 3) -> tuple[int, str, str]:
    """Number, letters and type of a pass's channels, as Blender wants them; count: of a layer that is for debugging."""
    if name == "Depth" or count == 1:
        return 1, "Z" if name == "Depth" else "X", "VALUE"
    return (3, "XYZ", "VECTOR") if name in VECTORS else (3, "RGB", "COLOR")


def _show_sockets(passes: LumigatePasses, _context: bpy.types.Context) -> None:
    """The compositor shows what sockets a view layer has now, not first after the next render."""
    for layer in passes.id_data.view_layers:
        layer.update_render_passes()


class LumigatePasses(bpy.types.PropertyGroup):
    """The passes that a view layer gives to the compositor."""

    __annotations__ = {
        name: bpy.props.BoolProperty(name=name, description=_HELP[name], default=True, update=_show_sockets) for name in OPTIONAL
    }

    def wanted(self) -> list[str]:
        """Names of the passes that are switched on, besides Combined."""
        return [name for name in OPTIONAL if getattr(self, name)]


def group_names(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> list[str]:
    """Names of the light groups that get passes of their own, that of what has none included; none where they are switched off."""
    settings = scene.lumigate.as_settings().with_defaults()
    if not view_layer.lightgroups or not settings.light_groups or settings.method != "importance-sampling":
        return []
    return list(dict.fromkeys((*(group.name for group in view_layer.lightgroups), REMAINDER)))


def passes_of(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> list[str]:
    """Names of the passes that a view layer gives besides Combined."""
    wanted = view_layer.lumigate.wanted()
    too_long = long_names(group_names(scene, view_layer))
    kinds = [kind for kind in GROUP_LAYERS if kind == COMBINED or kind in wanted]
    return [*wanted, *(f"{kind}_{name}" for name in group_names(scene, view_layer) if name not in too_long for kind in kinds)]


def debug_names(layers: Layers) -> list[str]:
    """The layers that a render gives for debugging: they have no sockets, but are in the picture and its file."""
    known = (*CONTRACT, *(f"{kind}_" for kind in GROUP_LAYERS))
    return [name for name in layers if not name.startswith(known)]


def long_names(groups: list[str]) -> list[str]:
    """The light groups whose passes Blender has no room for: a file with their names cut off cannot be written, or not be read."""
    return [name for name in groups if len(name.encode()) > LONGEST_GROUP]


def long_name(group: str) -> str:
    """A line about one of them."""
    return f"light group '{group}' has no passes: its name is too long for Blender, shorten it to {LONGEST_GROUP} bytes"


def left_out(view_layer: bpy.types.ViewLayer) -> list[str]:
    """A line about passes that the view layer asks for and this engine does not have: the compositor gets nothing from their sockets."""
    missing = [label for name, label in _FOREIGN.items() if getattr(view_layer, name)]
    missing += [f"AOV '{aov.name}'" for aov in view_layer.aovs]
    return [f"view layer '{view_layer.name}' asks for passes that Lumigate leaves out: {', '.join(missing)}"] if missing else []


def register_passes(engine: bpy.types.RenderEngine, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
    """Tell the compositor what sockets the view layer has."""
    engine.register_pass(scene, view_layer, COMBINED, 4, "RGBA", "COLOR")
    for name in passes_of(scene, view_layer):
        engine.register_pass(scene, view_layer, name, *_channels(name))


def hand_over(engine: bpy.types.RenderEngine, layers: Layers, wanted: list[str], view: str = "") -> None:
    """Give the layers of a render to Blender as the passes of its view layer; view: of stereoscopy, one of the scene's render views."""
    for name in wanted:
        channels, letters, _ = _channels(name, layers[name].shape[2] if name in layers else 3)
        engine.add_pass(name, channels, letters, layer=layers.view_layer)
    result = engine.begin_result(0, 0, *layers.size, layer=layers.view_layer, view=view)
    for target in result.layers[0].passes:
        if target.name in layers:
            target.rect.foreach_set(_bottom_up(layers[target.name], target.channels).ravel())
    engine.end_result(result)


def _bottom_up(array: np.ndarray, channels: int) -> np.ndarray:
    """(H, W, C) as Blender orders it, the last row first; a fourth channel is opaque."""
    if channels > array.shape[2]:
        array = np.concatenate([array, np.ones_like(array[..., :1])], axis=2)
    return np.ascontiguousarray(array[::-1])


CLASSES = (LumigatePasses,)


def attach() -> None:
    """Give every view layer its switches."""
    bpy.types.ViewLayer.lumigate = bpy.props.PointerProperty(type=LumigatePasses)


def detach() -> None:
    """Take them away again."""
    del bpy.types.ViewLayer.lumigate
