"""Light linking and shadow linking of an evaluated scene, as Blender's depsgraph makes sets of them (depsgraph_light_linking.cc)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.scene import BLOCKER_SETS, FIRST_BLOCKER_SET, SHADOW

RECEIVERS, BLOCKERS = _KINDS = ("receiver_collection", "blocker_collection")


def _states(collection: bpy.types.Collection) -> Iterator[tuple[bpy.types.Object, bool]]:
    """Objects that a collection links, and whether it includes them, else it excludes them; the last word on an object counts.

    What lies in collections within it is linked as the outermost of these are.
    """

    def inner(child: bpy.types.Collection, included: bool) -> Iterator[tuple[bpy.types.Object, bool]]:
        for further in child.children:
            yield from inner(further, included)
        for ob in child.objects:
            yield ob, included

    for child, link in zip(collection.children, collection.collection_children):
        yield from inner(child, link.light_linking.link_state == "INCLUDE")
    for ob, link in zip(collection.objects, collection.collection_objects):
        yield ob, link.light_linking.link_state == "INCLUDE"


def collection_of(ob: bpy.types.Object, kind: str) -> bpy.types.Collection | None:
    """The receivers or the blockers of an evaluated object."""
    linking = ob.original.light_linking
    return linking and getattr(linking, kind)


@dataclass
class Links:
    """The sets of objects that emitters are linked to, in the order in which emitters ask for them.

    states: for each kind of link, the collections in use, by name, with the state of each object in it.  sets: names of those asked for.
    """

    states: dict[str, dict[str, dict[bpy.types.Object, bool]]] = field(default_factory=lambda: {kind: {} for kind in _KINDS})
    sets: dict[str, dict[str, int]] = field(default_factory=lambda: {kind: {} for kind in _KINDS})
    warnings: list[str] = field(default_factory=list)

    def __bool__(self) -> bool:
        return any(self.states.values())

    @staticmethod
    def of(depsgraph: bpy.types.Depsgraph) -> Links:
        """The links of all that an evaluation holds."""
        links = Links()
        for ob in depsgraph.objects:
            for kind in _KINDS:
                collection = collection_of(ob, kind)
                if collection is not None and collection.name not in links.states[kind]:
                    links.states[kind][collection.name] = {linked.original: state for linked, state in _states(collection)}
        return links

    def number(self, ob: bpy.types.Object, kind: str) -> int:
        """Number of the set of an evaluated emitter, -1 where it is linked to all."""
        collection = collection_of(ob, kind)
        if collection is None or not self.states[kind][collection.name]:
            return -1
        known = self.sets[kind]
        if kind == BLOCKERS and len(known) == BLOCKER_SETS and collection.name not in known:
            self.warnings.append(f"shadow linking of '{ob.name}' is ignored: there are more than {BLOCKER_SETS} sets of blockers")
            return -1
        return known.setdefault(collection.name, len(known))

    def key(self, ob: bpy.types.Object, parent: bpy.types.Object | None, kind: str) -> bpy.types.Object:
        """The original object by whose links an instance goes: that which instances it, where this is linked at all."""
        if parent is not None and any(parent.original in states for states in self.states[kind].values()):
            return parent.original
        return ob.original

    def members(self, kind: str, keys: list[bpy.types.Object]) -> np.ndarray:
        """(K, O) uint8: which of the objects (by `key`) are in each set: those included, or where none is, those not excluded."""
        members = np.zeros((len(self.sets[kind]), len(keys)), np.uint8)
        for name, number in self.sets[kind].items():
            states = self.states[kind][name]
            members[number] = [states.get(key, not any(states.values())) for key in keys]
        return members


def blocker_bits(visibility: np.ndarray, blockers: np.ndarray) -> np.ndarray:
    """(O,) uint32: `visibility` with a bit for each of the sets of blockers (S, O) that an object is in and that shadow rays meet."""
    visibility = visibility.astype(np.uint32)
    for number, members in enumerate(blockers):
        visibility |= np.uint32(FIRST_BLOCKER_SET << number) * (members & ((visibility & SHADOW) > 0)).astype(np.uint32)
    return visibility
