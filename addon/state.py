"""What the panel shows of the present session, in the window manager: nothing of it is saved."""

from __future__ import annotations

from collections.abc import Iterator

import bpy


class LumigateRemark(bpy.types.PropertyGroup):
    """One line about the scene: what will be skipped or wrong, and the object that it names."""

    __annotations__ = {
        "text": bpy.props.StringProperty(),
        "named": bpy.props.StringProperty(description="The object, material or lamp that the line names, if any"),
        "wrong": bpy.props.BoolProperty(description="It will look wrong; else it is only left out"),
    }


class LumigateState(bpy.types.PropertyGroup):
    """Progress of the running job and the last report on the scene."""

    __annotations__ = {
        "running": bpy.props.BoolProperty(),
        "fraction": bpy.props.FloatProperty(min=0, max=1),
        "stage": bpy.props.StringProperty(),
        "checked": bpy.props.BoolProperty(description="Whether the scene has been looked at"),
        "remarks": bpy.props.CollectionProperty(type=LumigateRemark),
    }

    def report(self, scene: bpy.types.Scene, skipped: list[str], warnings: list[str]) -> None:
        """Show these lines instead of those that are there."""
        self.checked = True
        self.remarks.clear()
        known = {name for ob in scene.objects for name in (ob.name, *_names(ob))}
        for lines, wrong in ((warnings, True), (skipped, False)):
            for line in lines:
                remark = self.remarks.add()
                remark.text, remark.wrong = line, wrong
                remark.named = next((name for name in _quoted(line) if name in known), "")


def _quoted(line: str) -> Iterator[str]:
    """What stands between any two quotation marks of a line, in order: a name may have some of its own."""
    marks = [at for at, letter in enumerate(line) if letter == "'"]
    return (line[a + 1 : b] for i, a in enumerate(marks) for b in marks[i + 1 :])


def named_objects(scene: bpy.types.Scene, name: str) -> list[bpy.types.Object]:
    """The scene's object of that name, else those whose data, material or collection of instances has it."""
    if name in scene.objects:
        return [scene.objects[name]]
    return [ob for ob in scene.objects if name in _names(ob)]


def _names(ob: bpy.types.Object) -> set[str]:
    parts = [ob.data, ob.instance_collection, *(slot.material for slot in ob.material_slots)]
    return {part.name for part in parts if part is not None}


CLASSES = (LumigateRemark, LumigateState)


def attach() -> None:
    """Give the window manager its state."""
    bpy.types.WindowManager.lumigate = bpy.props.PointerProperty(type=LumigateState)


def detach() -> None:
    """Take it away again."""
    del bpy.types.WindowManager.lumigate
