"""Blender's light groups: which group everything that shines belongs to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene import EMISSIVE, REMAINDER, Scene


@dataclass(frozen=True)
class LightGroups:
    """G groups, whose light is told apart.

    names: of the groups; one without a name is all light.  lamps: (L,) int32, groups of the scene's lamps.
    objects: (O,) int32, groups of the objects, for those that shine.  world: its group.
    dark: names of groups to which nothing that shines belongs, and which are not among the G.
    """

    names: tuple[str, ...]
    lamps: np.ndarray
    objects: np.ndarray
    world: int
    dark: tuple[str, ...] = ()

    def told_apart(self, parts: list, nothing) -> dict:
        """The light of each group by its name, `nothing` for dark ones; empty where light is not told apart."""
        if self.names == ("",):
            return {}
        return dict(zip(self.names, parts, strict=True)) | dict.fromkeys(self.dark, nothing)

    @staticmethod
    def one(scene: Scene) -> LightGroups:
        """All light in one group."""
        return LightGroups(("",), np.zeros(len(scene.lamps), np.int32), np.zeros(len(scene.geometry.object_names), np.int32), 0)

    @staticmethod
    def of(scene: Scene) -> LightGroups:
        """The groups of the scene's view layer, and the remainder as the last one; all light in one where it has none."""
        if not scene.light_groups:
            return LightGroups.one(scene)
        known = tuple(dict.fromkeys((*scene.light_groups, REMAINDER)))
        lamps, objects, (world,) = (
            [name if name in known else REMAINDER for name in names]
            for names in (scene.lamps.groups, scene.geometry.object_groups or [""] * len(scene.geometry.object_names), [scene.world.group])
        )
        shining = {objects[k] for k in _shining_objects(scene)} | set(lamps) | ({world} if scene.world.radiance.any() else set())
        number = {name: k for k, name in enumerate(name for name in known if name in shining)} or {REMAINDER: 0}

        def index(names: list[str]) -> np.ndarray:
            return np.array([number.get(name, 0) for name in names], np.int32)

        dark = tuple(name for name in known if name not in number)
        return LightGroups(tuple(number), index(lamps), index(objects), number.get(world, 0), dark)


def _shining_objects(scene: Scene) -> np.ndarray:
    """Indices of the objects that have a material which shines."""
    geometry = scene.geometry
    emissive = (scene.materials.tables.flags & EMISSIVE) != 0
    return np.unique(geometry.object[emissive[geometry.material]])
