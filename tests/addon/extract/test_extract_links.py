"""Light linking: which objects the sets of receivers and blockers hold."""

import bpy
import pytest
from mathutils import Matrix

from lumigate.core.scene import ALL_RAYS, FIRST_BLOCKER_SET, SHADOW


def collection(name, **included):
    """A collection of objects (or collections) of these names, each included or excluded."""
    made = bpy.data.collections.new(name)
    for member in included:
        (made.children if member in bpy.data.collections else made.objects).link(
            bpy.data.collections[member] if member in bpy.data.collections else bpy.data.objects[member]
        )
    for members, links in ((made.objects, made.collection_objects), (made.children, made.collection_children)):
        for member, link in zip(members, links):
            link.light_linking.link_state = "INCLUDE" if included[member.name] else "EXCLUDE"
    return made


@pytest.fixture
def linked(stage):
    """A stage with the objects A, B and C, and a lamp."""
    for name in "ABC":
        stage.cube(name)
    stage.light = stage.lamp("POINT", Matrix.Translation((3, 0, 0)), energy=10)
    return stage


def members(scene, sets):
    return {name: bool(held) for name, held in zip(scene.geometry.object_names, sets)}


@pytest.mark.parametrize(
    ("states", "lit"),
    [
        (dict(A=True), "A"),
        (dict(A=False), "BC"),
        (dict(A=True, B=False), "A"),
        (dict(A=True, B=True, C=False), "AB"),
    ],
)
def test_receivers(linked, states, lit):
    linked.light.light_linking.receiver_collection = collection("Lit", **states)
    scene = linked.extract()
    assert not scene.warnings
    assert scene.lamps.receivers.tolist() == [0]
    assert scene.lamps.blockers.tolist() == [-1]
    assert members(scene, scene.geometry.receiver_sets[0]) == {name: name in lit for name in "ABC"}
    assert (scene.geometry.object_visibility == ALL_RAYS).all()


def test_blockers(linked):
    linked.light.light_linking.blocker_collection = collection("Hiding", B=False)
    bpy.data.objects["C"].visible_shadow = False
    scene = linked.extract()
    assert scene.lamps.blockers.tolist() == [0]
    assert scene.lamps.receivers.tolist() == [-1]
    assert members(scene, scene.geometry.object_visibility & FIRST_BLOCKER_SET) == {"A": True, "B": False, "C": False}
    assert members(scene, scene.geometry.object_visibility & SHADOW) == {"A": True, "B": True, "C": False}


def test_nothing_is_linked(linked):
    for empty in (False, True):
        if empty:  # lights all
            linked.light.light_linking.receiver_collection = bpy.data.collections.new("Empty")
        scene = linked.extract()
        assert scene.lamps.receivers.tolist() == [-1]
        assert scene.lamps.blockers.tolist() == [-1]
        assert scene.geometry.receiver_sets is None or not len(scene.geometry.receiver_sets)


def test_collections_within_are_linked_as_the_outermost(linked):
    inner = collection("Inner", A=True)
    outer = collection("Outer", B=True)
    outer.children.link(inner)
    linked.light.light_linking.receiver_collection = collection("Lit", Outer=False)
    scene = linked.extract()
    assert members(scene, scene.geometry.receiver_sets[0]) == {"A": False, "B": False, "C": True}


def test_emitters_share_sets_and_shining_objects_have_them(linked):
    lit, hiding = collection("Lit", A=True), collection("Hiding", A=True)
    second = linked.lamp("POINT", Matrix.Translation((0, 3, 0)), energy=10)
    linked.light.light_linking.receiver_collection = second.light_linking.receiver_collection = lit
    bpy.data.objects["B"].light_linking.receiver_collection = lit
    bpy.data.objects["B"].light_linking.blocker_collection = hiding
    scene = linked.extract()
    assert scene.lamps.receivers.tolist() == [0, 0]
    assert dict(zip(scene.geometry.object_names, scene.geometry.object_receivers.tolist())) == {"A": -1, "B": 0, "C": -1}
    assert dict(zip(scene.geometry.object_names, scene.geometry.object_blockers.tolist())) == {"A": -1, "B": 0, "C": -1}
    assert len(scene.geometry.receiver_sets) == 1


def test_instances_go_by_what_instances_them(linked):
    inside = bpy.data.collections.new("Inside")
    inside.objects.link(bpy.data.objects["A"])
    instancer = linked.link("Instancer", None, Matrix.Translation((5, 0, 0)))
    instancer.instance_type, instancer.instance_collection = "COLLECTION", inside
    linked.light.light_linking.receiver_collection = collection("Lit", B=True, Instancer=True)
    scene = linked.extract()
    held = scene.geometry.receiver_sets[0].tolist()
    assert [held[k] for k, name in enumerate(scene.geometry.object_names) if name == "A"] in ([0, 1], [1, 0])  # itself, and the instance
    assert members(scene, held)["B"]


def test_more_sets_of_blockers_than_there_is_room_for(linked):
    for k in range(24):
        one = linked.lamp("POINT", Matrix.Translation((3, k, 0)), energy=10)
        one.light_linking.blocker_collection = collection(f"Hiding {k}", A=True)
    scene = linked.extract()
    assert len([line for line in scene.warnings if "sets of blockers" in line]) == 2
    assert sorted(scene.lamps.blockers.tolist())[:3] == [-1, -1, -1]
