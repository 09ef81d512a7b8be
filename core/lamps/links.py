"""Light linking: emitters that light some objects only, or that some objects only hide (Blender's receivers and blockers)."""

from __future__ import annotations

import numpy as np

from ..jit import inlined
from ..scene import DIFFUSE, FIRST_BLOCKER_SET, SHADOW, Geometry, Lamps, Scene
from .tables import GLOSSY_ONLY, LINKED, Emitters


@inlined
def in_set(sets, number, objects, triangle):
    """Whether the object of a triangle (-1: none) is in a set (-1: that of all) of `sets` (K, O); objects: (T,), of each triangle."""
    return number < 0 or triangle < 0 or sets[number, objects[triangle]] != 0


@inlined
def lights(emitters, e, objects, triangle):
    """Whether emitter e lights the object of a triangle (-1: of none, which all emitters light); objects: (T,), of each triangle."""
    return not emitters.flags[e] & LINKED or in_set(emitters.receiver_sets, emitters.receivers[e], objects, triangle)


@inlined
def parts_rays(visibility):
    """Whether an object of these kinds of rays is met by shadow rays but not by diffuse ones, or the other way round."""
    hides = visibility & (SHADOW | DIFFUSE)
    return hides == SHADOW or hides == DIFFUSE


@inlined
def is_hidden_alike(emitters, e):
    """Whether what hides emitter e from other rays hides it from shadow rays, too."""
    return emitters.shadow_kinds[e] == SHADOW


def shadow_kinds(blockers: np.ndarray, geometry: Geometry, even_sky: np.ndarray) -> np.ndarray:
    """(E,) int64: kinds of the shadow rays to emitters of these sets of blockers (-1: all that hides anything).

    even_sky: (E,) bool, which of them are a sky of one colour.  Cycles has no shadow rays to it: what diffuse rays meet hides it.
    """
    kinds = np.where(blockers < 0, SHADOW, FIRST_BLOCKER_SET << np.maximum(blockers, 0)).astype(np.int64)
    if is_parted(geometry):
        kinds[even_sky & (blockers < 0)] = DIFFUSE
    return kinds


def is_parted(geometry: Geometry) -> bool:
    """Whether any object is met by shadow rays but not by diffuse ones, or the other way round."""
    hides = geometry.object_visibility & (SHADOW | DIFFUSE)
    return bool(((hides == SHADOW) | (hides == DIFFUSE)).any())


def object_links(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Sets of receivers and of blockers (O,) int32 of the objects, for those that shine."""
    g = scene.geometry
    none = np.full(len(g.object_names), -1, np.int32)
    return (none if g.object_receivers is None else g.object_receivers), (none if g.object_blockers is None else g.object_blockers)


def receiver_sets(geometry: Geometry) -> np.ndarray:
    """(K, O) uint8, which objects are in each set of receivers."""
    return np.zeros((0, 0), np.uint8) if geometry.receiver_sets is None else geometry.receiver_sets


def is_linked(lamps: Lamps) -> np.ndarray:
    """(L,) bool: lamps that light some objects only, or that some objects only hide."""
    return (lamps.receivers >= 0) | (lamps.blockers >= 0)


def is_unlinked(emitters: Emitters) -> np.ndarray:
    """(E,) bool: emitters that light all objects, diffuse ones, too, and that all objects hide."""
    return ((emitters.flags & (LINKED | GLOSSY_ONLY)) == 0) & (emitters.shadow_kinds == SHADOW)
