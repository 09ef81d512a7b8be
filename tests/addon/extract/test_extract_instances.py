"""What instances have of their instancers, against what Cycles' nodes give at the same points."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from .test_extract_attributes import GAIN, OFFSET, emitting, interpolated

SPAN = 0.9


class Nodes:
    """A geometry node tree, and short ways to fill it."""

    def __init__(self):
        self.tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
        for end in ("INPUT", "OUTPUT"):
            self.tree.interface.new_socket("Geometry", in_out=end, socket_type="NodeSocketGeometry")
        self.end = self.tree.nodes.new("NodeGroupOutput")

    def add(self, kind, *sources, settings=(), **inputs):
        """A node whose first inputs get `sources`; its first output."""
        node = self.tree.nodes.new(kind)
        for name, value in dict(settings).items():
            setattr(node, name, value)
        for source, socket in zip(sources, node.inputs):
            if source is not None:
                self.tree.links.new(source, socket)
        for name, value in inputs.items():
            node.inputs[name.replace("_", " ")].default_value = value
        return node.outputs[0]

    def tinted(self, instances, name="tint", scale=1.0):
        """An attribute of three numbers on the instances, which differs from one to the next."""
        index = self.add("GeometryNodeInputIndex")
        value = self.add("ShaderNodeVectorMath", index, settings={"operation": "MULTIPLY_ADD"})
        value.node.inputs[1].default_value, value.node.inputs[2].default_value = (scale, -scale, 2 * scale), (scale, 1, 3)
        stored = self.add(
            "GeometryNodeStoreNamedAttribute", instances, settings={"data_type": "FLOAT_VECTOR", "domain": "INSTANCE"}, Name=name
        )
        self.tree.links.new(value, stored.node.inputs["Value"])
        return stored

    def points(self, side, numbered=False):
        """2 by 2 points of a square; numbered: with numbers of their own, as scattered points have."""
        grid = self.add("GeometryNodeMeshGrid", Size_X=side, Size_Y=side, Vertices_X=2, Vertices_Y=2)
        points = self.add("GeometryNodeMeshToPoints", grid)
        if not numbered:
            return points
        number = self.add("ShaderNodeMath", self.add("GeometryNodeInputIndex"), settings={"operation": "MULTIPLY_ADD"})
        number.node.inputs[1].default_value, number.node.inputs[2].default_value = -71, 30
        stored = self.add("GeometryNodeStoreNamedAttribute", points, settings={"data_type": "INT", "domain": "POINT"}, Name="id")
        self.tree.links.new(number, stored.node.inputs["Value"])
        return stored

    def on_points(self, points, instance, **settings):
        return self.add("GeometryNodeInstanceOnPoints", points, None, instance, **settings)

    def worn(self, stage, geometry, name="Instancer"):
        """An object whose geometry is that of the tree."""
        self.tree.links.new(geometry, self.end.inputs[0])
        ob = stage.mesh(name, [(0, 0, 5)], [])
        ob.modifiers.new("Scatter", "NODES").node_group = self.tree
        return ob


def leaf(stage, name="Leaf", size=0.1, **reads):
    """A quad that emits an attribute of its instancer, out of sight."""
    ob = stage.mesh(name, [(-size, -size, 0), (size, -size, 0), (size, size, 0), (-size, size, 0)], [(0, 1, 2, 3)])
    emitting(
        stage,
        ob,
        *reads.pop("node", ("ShaderNodeAttribute", "Color")),
        **(reads or dict(attribute_name="tint", attribute_type="INSTANCER")),
    )
    ob.location = 9, 9, 0
    return ob


def of_an_object(stage, numbered=True):
    nodes = Nodes()
    leaves = nodes.add("GeometryNodeObjectInfo", As_Instance=True, Object=leaf(stage)).node.outputs["Geometry"]
    nodes.worn(stage, nodes.tinted(nodes.on_points(nodes.points(0.5, numbered), leaves)))


def of_a_mesh(stage):
    """Instances of a mesh that is in the geometry itself."""
    nodes = Nodes()
    quad = nodes.add("GeometryNodeMeshGrid", Size_X=0.2, Size_Y=0.2, Vertices_X=2, Vertices_Y=2)
    quad = nodes.add("GeometryNodeSetMaterial", quad, Material=leaf(stage).data.materials[0])
    nodes.worn(stage, nodes.tinted(nodes.on_points(nodes.points(0.5), quad)))


def nested(stage, inner="tint", outer="other"):
    """Instances of instances of an object."""
    nodes = Nodes()
    leaves = nodes.add("GeometryNodeObjectInfo", As_Instance=True, Object=leaf(stage, size=0.05)).node.outputs["Geometry"]
    branch = nodes.tinted(nodes.on_points(nodes.points(0.2), leaves), inner, 0.3)
    nodes.worn(stage, nodes.tinted(nodes.on_points(nodes.points(0.5, True), branch), outer))


def picked(stage):
    """Instances of the objects of a collection."""
    collection = bpy.data.collections.new("Leaves")
    for name, size in (("First", 0.1), ("Second", 0.06)):
        collection.objects.link(leaf(stage, name, size))
    nodes = Nodes()
    leaves = nodes.add("GeometryNodeCollectionInfo", Separate_Children=True, Reset_Children=True, Collection=collection)
    instances = nodes.on_points(nodes.points(0.5), leaves, Pick_Instance=True)
    nodes.worn(stage, nodes.tinted(instances))


def in_a_collection(stage):
    """The instancer is in a collection which is instanced itself."""
    of_an_object(stage)
    collection = bpy.data.collections.new("Bed")
    for name in ("Leaf", "Instancer"):
        collection.objects.link(bpy.data.objects[name])
    stage.scene.collection.objects.unlink(bpy.data.objects["Instancer"])
    empty = stage.link("Empty", None, Matrix.Rotation(0.4, 4, "Z"))
    empty.instance_type, empty.instance_collection = "COLLECTION", collection


def of_the_instancer(stage):
    """No instance has the attribute, but their instancer has a property of that name, and the object another one."""
    nested(stage, "one", "other")
    bpy.data.objects["Leaf"]["tint"] = 5.0
    bpy.data.objects["Instancer"]["tint"] = (1.0, 2.0, 4.0)


def of_the_object(stage):
    """No instance: the object itself has it."""
    ob = leaf(stage, size=0.3)
    ob.location, ob["tint"] = (0, 0, 0), (3.0, 1.0, 2.0)


def on_faces(output):
    def build(stage):
        ob = stage.mesh("Faces", [(-0.4, -0.4, 0), (0, -0.4, 0), (0.4, 0, 0), (-0.4, 0.4, 0.1)], [(0, 1, 2), (0, 2, 3)])
        uv = ob.data.uv_layers.new(name="UV")
        uv.data.foreach_set("uv", np.random.default_rng(3).random(2 * len(ob.data.loops)))
        small = leaf(stage, node=("ShaderNodeTexCoord", output), from_instancer=True)
        small.location, small.parent = (0, 0, 0), ob
        ob.instance_type, ob.show_instancer_for_render = "FACES", False

    return build


CASES = {
    "of an object": of_an_object,
    "without numbers": lambda stage: of_an_object(stage, False),
    "of a mesh": of_a_mesh,
    "inner of two": nested,
    "outer of two": lambda stage: nested(stage, "other", "tint"),
    "both of two": lambda stage: nested(stage, "tint", "tint"),
    "picked": picked,
    "in a collection": in_a_collection,
    "of the instancer": of_the_instancer,
    "of the object": of_the_object,
    "place on faces": on_faces("Generated"),
    "uv on faces": on_faces("UV"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_values_are_those_of_cycles(stage, tmp_path, case):
    CASES[case](stage)
    stage.camera.location, stage.camera.data.type, stage.camera.data.ortho_scale = (0, 0, 2), "ORTHO", SPAN
    scene = stage.extract()
    x = ((np.arange(16) + 0.5) / 16 - 0.5) * SPAN
    points = np.stack([np.tile(x, 16), np.repeat(-x, 16)], axis=1)
    shown = stage.radiance(str(tmp_path / "cycles.exr"), 1).reshape(-1, 3)
    seen = shown.any(1)
    assert seen.sum() > 20
    expected = (shown[seen] - OFFSET) / GAIN
    got = interpolated(scene, points[seen])[:, :3]
    if "faces" not in case:
        assert np.abs(expected).max() > 0.9
    wrong = np.abs(got - expected).max(1) > 2e-3 * max(1, np.abs(expected).max())
    assert wrong.mean() < 0.05  # a pixel on an edge may be either leaf's
