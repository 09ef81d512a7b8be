"""The settings of a render, saved with each scene as `scene.lumigate`: made from the one table in `core.settings`."""

from __future__ import annotations

from dataclasses import Field

import bpy

from ..core.settings import QUALITIES, Option, RenderSettings, options

CUSTOM = "CUSTOM"
_GOALS = (
    ("QUALITY", "Quality", "As many samples as a quality needs, or the numbers below"),
    ("TIME", "Time", "As many samples as fit into a time"),
    ("ERROR", "Error", "As many samples as an error needs"),
)
_QUALITY_ITEMS = (
    ("PREVIEW", "Preview", "A first look: relMSE .05, or few samples where the method is not Automatic"),
    ("MEDIUM", "Medium", "For work: relMSE .02, or the usual samples where the method is not Automatic"),
    ("FINAL", "Final", "For the last picture: relMSE .005, or many samples where the method is not Automatic"),
    (CUSTOM, "Custom", "The numbers below, as they are"),
)
_SWITCH = (("AUTO", "Automatic", "As the method needs"), ("ON", "On", "Always"), ("OFF", "Off", "Never"))
_SWITCH_VALUES = {"AUTO": None, "ON": True, "OFF": False}
_AUTOMATIC = -1  # a number that is left to the method
# Blender has threads of its own (Performance), and passes are switched in each view layer.
_ELSEWHERE = {"threads"}
# What the goal decides.
_GOAL_FIELDS = {"TIME": "time_budget", "ERROR": "target_error"}
_GOAL_DEFAULTS = {"time_budget": 10.0, "target_error": 0.01}

SHOWN = {name: f for name, f in options().items() if name not in _ELSEWHERE}


def _property(field: Field):
    """Blender's property of a field of `RenderSettings`."""
    shown: Option = field.metadata["option"]
    words = {"name": shown.label, "description": shown.help}
    kind, _, optional = field.type.partition(" | ")
    if shown.choices:
        return bpy.props.EnumProperty(items=[(c.value, c.label, c.help) for c in shown.choices], default=field.default, **words)
    if kind == "bool" and optional:
        return bpy.props.EnumProperty(items=_SWITCH, default="AUTO", **words)
    if kind == "bool":
        return bpy.props.BoolProperty(default=field.default, **words)
    usual = shown.most if shown.usual is None else shown.usual
    if kind == "float":
        bounds = {"min": shown.least, "max": shown.most, "soft_max": usual, "precision": 2 if shown.unit else 4}
        # Blender's TIME_ABSOLUTE is in seconds; plain numbers have no unit.
        unit = {"s": "TIME_ABSOLUTE", "": "NONE"}[shown.unit]
        return bpy.props.FloatProperty(default=_GOAL_DEFAULTS.get(field.name, field.default), unit=unit, **bounds, **words)
    bounds = {"max": int(shown.most), "soft_max": int(usual)}
    if optional:
        words["description"] += f"; {_AUTOMATIC} leaves it to the method"
        return bpy.props.IntProperty(default=_AUTOMATIC, min=_AUTOMATIC, **bounds, **words)
    return bpy.props.IntProperty(default=field.default, min=int(shown.least), **bounds, **words)


def _value(name: str, stored):
    """What `RenderSettings` calls the stored value of a property."""
    optional = "None" in SHOWN[name].type
    if optional and stored in _SWITCH_VALUES:
        return _SWITCH_VALUES[stored]
    return None if optional and stored == _AUTOMATIC else stored


def _current_quality(settings: LumigateSettings) -> int:
    """Index of the preset whose numbers these are."""
    for index, preset in enumerate(QUALITIES.values()):
        if all(getattr(settings, name) == number for name, number in preset.items()):
            return index
    return len(QUALITIES)


def _set_quality(settings: LumigateSettings, index: int) -> None:
    """Put a preset's numbers in; Custom keeps those that are there."""
    for name, number in dict(enumerate(QUALITIES.values())).get(index, {}).items():
        setattr(settings, name, number)


class LumigateSettings(bpy.types.PropertyGroup):
    """`core.settings.RenderSettings` as Blender's properties, and what they are to reach."""

    __annotations__ = {
        "goal": bpy.props.EnumProperty(name="Aim", description="What a render is to reach", items=_GOALS, default="QUALITY"),
        "quality": bpy.props.EnumProperty(
            name="Quality",
            description="Presets of the numbers below",
            items=[(*item, "NONE", index) for index, item in enumerate(_QUALITY_ITEMS)],
            get=_current_quality,
            set=_set_quality,
        ),
        **{name: _property(field) for name, field in SHOWN.items()},
    }

    def as_settings(self) -> RenderSettings:
        """The request that these properties make, with as many threads as the scene may use."""
        reached = _GOAL_FIELDS.get(self.goal)
        left_out = set(_GOAL_FIELDS.values()) - {reached}
        values = {name: _value(name, getattr(self, name)) for name in SHOWN if name not in left_out}
        if self.goal == "QUALITY" and self.quality != CUSTOM:
            values["quality"] = self.quality.lower()  # what `auto` aims at; the other methods take the preset's numbers
        render = self.id_data.render
        return RenderSettings(threads=render.threads if render.threads_mode == "FIXED" else 0, **values)


CLASSES = (LumigateSettings,)


def attach() -> None:
    """Give every scene its settings."""
    bpy.types.Scene.lumigate = bpy.props.PointerProperty(type=LumigateSettings)


def detach() -> None:
    """Take them away again."""
    del bpy.types.Scene.lumigate
