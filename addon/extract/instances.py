"""What geometry nodes write on instances: Attribute nodes of type Instancer read it.

Blender gives an instance the numbers under which each level of instancing lists it (`persistent_id`), and each level's geometry has its instances
as points with attributes.  An inner level counts before those around it, as in BKE_object_dupli_find_rgba_attribute of Blender's object_dupli.cc.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import bpy
import numpy as np

from .meshes import READABLE, layer, node_trees, read

_NO_NUMBER = 0x7FFFFFFF  # fills the levels that an instance has not


def asked_of_instancers() -> tuple[set[str], bool]:
    """The attributes that shader nodes of the file read from instancers, and whether any node asks for these at all."""
    nodes = [node for tree in node_trees() for node in tree.nodes]
    names = {n.attribute_name for n in nodes if n.bl_idname == "ShaderNodeAttribute" and n.attribute_type == "INSTANCER"} - {""}
    return names, bool(names) or any(getattr(node, "from_instancer", False) for node in nodes)


@dataclass
class _Level:
    """The n instances of one geometry: row by number, what each row instances, and (n, 4) values by attribute name."""

    rows: dict[int, int]
    references: list[bpy.types.Object | bpy.types.Collection | bpy.types.GeometrySet]
    reference: np.ndarray
    values: dict[str, np.ndarray]


class InstanceAttributes:
    """Attributes of the instances of one evaluation; nothing is read where no names are wanted."""

    def __init__(self, names: Collection[str]):
        self._names = names
        self._levels: dict[tuple, _Level | None] = {}

    def of(self, instance: bpy.types.DepsgraphObjectInstance) -> dict[str, tuple[float, ...]]:
        """RGBA by name of what an instance and those that it lies in have."""
        if not self._names or not instance.is_instance:
            return {}
        numbers = list(instance.persistent_id)[::-1]  # from the outermost level on
        while numbers and numbers[0] == _NO_NUMBER:
            del numbers[0]
        found: dict[str, tuple[float, ...]] = {}
        owner, holder, path = instance.parent, instance.parent, (instance.parent.as_pointer(),)
        while numbers:
            if isinstance(holder, bpy.types.Object):
                owner = holder
                holder = holder.instance_collection if holder.instance_type == "COLLECTION" else holder
            number = numbers.pop(0)
            if isinstance(holder, bpy.types.Collection):
                objects = holder.all_objects
                if not 0 <= number < len(objects):
                    break
                holder = objects[number]
                path = (holder.as_pointer(),)
                continue
            if not numbers and path[1:] and instance.object.original == owner.original:
                break  # the last number is that of a mesh of the owner's geometry
            if path not in self._levels:
                self._levels[path] = self._level(holder)
            level = self._levels[path]
            row = None if level is None else level.rows.get(number)
            if row is None:
                break
            found.update({name: tuple(map(float, values[row])) for name, values in level.values.items()})
            which = int(level.reference[row])
            holder = level.references[which]
            path = (*path, which) if isinstance(holder, bpy.types.GeometrySet) else (holder.as_pointer(),)
        return found

    def _level(self, holder: bpy.types.Object | bpy.types.GeometrySet) -> _Level | None:
        geometry = holder.evaluated_geometry() if isinstance(holder, bpy.types.Object) else holder
        points = geometry.instances_pointcloud()
        if points is None:
            return None
        count = len(points.points)
        numbers = points.attributes.get("id")
        numbers = range(count) if numbers is None else read(numbers.data, "value", (count,), np.int32).tolist()
        rows: dict[int, int] = {}
        for row, number in enumerate(numbers):
            rows.setdefault(number, row)
        found = {name: points.attributes.get(name) for name in self._names}
        return _Level(
            rows=rows,
            references=list(geometry.instance_references()),
            reference=read(points.attributes[".reference_index"].data, "value", (count,), np.int32),
            values={name: layer(a, np.arange(count)) for name, a in found.items() if a is not None and a.data_type in READABLE},
        )
