"""What materials read at the corners, against what Cycles' nodes give at the same points."""

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from lumigate.addon.extract import geometry
from lumigate.addon.extract.evaluation import in_render_depsgraph
from lumigate.addon.extract.tangents import tangents
from lumigate.addon.materials import AttributeRequest, CompiledMaterials
from lumigate.addon.materials import requests as rq

GAIN, OFFSET = 0.1, 0.5  # values may be negative and light may not


def sheet(stage, name="Sheet"):
    """A bumpy grid around the origin with UV maps, colours and other layers, smooth in one half."""
    n = 6
    rng = np.random.default_rng(4)
    x = np.linspace(-0.6, 0.6, n)
    vertices = np.stack([*np.meshgrid(x, x), rng.uniform(-0.1, 0.1, (n, n))], axis=-1).reshape(-1, 3)
    faces = [(i, i + 1, i + n + 1, i + n) for i in range(n * (n - 1)) if i % n < n - 1]
    ob = stage.mesh(name, vertices, faces)
    mesh = ob.data
    mesh.polygons.foreach_set("use_smooth", [i % 2 == 0 for i in range(len(faces))])
    corners = len(mesh.loops)
    turned = vertices[[loop.vertex_index for loop in mesh.loops]][:, [1, 0]] * (1, -0.7)
    for uv, values in (("First", rng.random((corners, 2))), ("Second", turned)):
        mesh.uv_layers.new(name=uv).data.foreach_set("uv", values.astype(np.float32).ravel())
    mesh.uv_layers["Second"].active_render = True
    for color, kind, domain, count in (("Float", "FLOAT_COLOR", "CORNER", corners), ("Byte", "BYTE_COLOR", "POINT", n * n)):
        mesh.color_attributes.new(color, kind, domain).data.foreach_set("color", rng.random(4 * count))
    mesh.color_attributes.render_color_index = 1
    for layer, kind, domain, count in (
        ("weight", "FLOAT", "POINT", n * n),
        ("level", "INT", "FACE", len(faces)),
        ("arrow", "FLOAT_VECTOR", "CORNER", corners),
        ("crease", "FLOAT", "EDGE", len(mesh.edges)),
        ("count", "INT", "EDGE", len(mesh.edges)),
        ("marked", "BOOLEAN", "EDGE", len(mesh.edges)),
    ):
        data = mesh.attributes.new(layer, kind, domain).data
        values = rng.integers(0, 2 if kind == "BOOLEAN" else 4, count * (3 if kind == "FLOAT_VECTOR" else 1))
        data.foreach_set("vector" if kind == "FLOAT_VECTOR" else "value", values.astype(bool) if kind == "BOOLEAN" else values)
    ob.color, ob.pass_index = (0.2, 0.4, 0.6, 0.8), 3
    ob["glow"] = 0.7
    return ob


def emitting(stage, ob, node_type, output, **settings):
    """Make an object emit one output of a node, scaled to positive values."""
    material = bpy.data.materials.new("Reader")
    tree = stage.nodes(material)
    if tree is None:
        material.use_nodes = True
        tree = material.node_tree
    tree.nodes.clear()
    node, scaled, emission, end = (
        tree.nodes.new(name) for name in (node_type, "ShaderNodeVectorMath", "ShaderNodeEmission", "ShaderNodeOutputMaterial")
    )
    for name, value in settings.items():
        setattr(node, name, value)
    scaled.operation = "MULTIPLY_ADD"
    scaled.inputs[1].default_value = GAIN, GAIN, GAIN
    scaled.inputs[2].default_value = OFFSET, OFFSET, OFFSET
    tree.links.new(node.outputs[output], scaled.inputs[0])
    tree.links.new(scaled.outputs[0], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], end.inputs["Surface"])
    ob.data.materials.clear()
    ob.data.materials.append(material)


def interpolated(scene, points):
    """(P, 4) slot 0 at the points of a height field below each of `points`, and which triangles these are."""
    corners = scene.geometry.vertices.astype(float)[scene.geometry.triangles][..., :2] + scene.origin[:2]
    a, b, c = corners.transpose(1, 0, 2)
    p = points[:, None, :2]

    def cross(u, v):
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    whole = cross(b - a, c - a)
    v, w = cross(p - a, c - a) / whole, cross(b - a, p - a) / whole
    inside = np.minimum(np.minimum(v, w), 1 - v - w)
    best = inside.argmax(1)
    pick = np.arange(len(points)), best
    weights = np.stack([1 - v[pick] - w[pick], v[pick], w[pick]], axis=1)
    return np.einsum("pk,pkc->pc", weights, scene.geometry.attributes[0][best])


NODES = {
    "uv active": ("ShaderNodeUVMap", "UV", {}),
    "uv named": ("ShaderNodeUVMap", "UV", dict(uv_map="First")),
    "uv of coordinates": ("ShaderNodeTexCoord", "UV", {}),
    "uv missing": ("ShaderNodeUVMap", "UV", dict(uv_map="Nowhere")),
    "colour active": ("ShaderNodeVertexColor", "Color", {}),
    "colour named": ("ShaderNodeVertexColor", "Color", dict(layer_name="Float")),
    "attribute float": ("ShaderNodeAttribute", "Color", dict(attribute_name="weight")),
    "attribute int by face": ("ShaderNodeAttribute", "Color", dict(attribute_name="level")),
    "attribute by edge": ("ShaderNodeAttribute", "Color", dict(attribute_name="crease")),
    "attribute int by edge": ("ShaderNodeAttribute", "Color", dict(attribute_name="count")),
    "attribute boolean by edge": ("ShaderNodeAttribute", "Color", dict(attribute_name="marked")),
    "attribute vector": ("ShaderNodeAttribute", "Vector", dict(attribute_name="arrow")),
    "attribute uv": ("ShaderNodeAttribute", "Vector", dict(attribute_name="First")),
    "attribute of the object": ("ShaderNodeAttribute", "Color", dict(attribute_name="glow", attribute_type="OBJECT")),
    "generated": ("ShaderNodeTexCoord", "Generated", {}),
    "object": ("ShaderNodeTexCoord", "Object", {}),
    "normal": ("ShaderNodeTexCoord", "Normal", {}),
    "world position": ("ShaderNodeNewGeometry", "Position", {}),
    "location": ("ShaderNodeObjectInfo", "Location", {}),
    "object colour": ("ShaderNodeObjectInfo", "Color", {}),
    "object index": ("ShaderNodeObjectInfo", "Object Index", {}),
    "random": ("ShaderNodeObjectInfo", "Random", {}),
}  # fmt: skip
POSES = {
    "moved": Matrix.Translation((0.05, -0.05, -0.3)) @ Euler((0, 0, 0.4)).to_matrix().to_4x4(),
    "mirrored": Matrix.Translation((0.05, -0.05, -0.3)) @ Matrix.Diagonal((-1.2, 0.9, 1.5, 1)),
}


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("case", NODES)
def test_values_are_those_of_cycles(stage, tmp_path, case, pose):
    node, output, settings = NODES[case]
    ob = sheet(stage)
    ob.matrix_world = POSES[pose]
    emitting(stage, ob, node, output, **settings)
    stage.camera.location, stage.camera.data.type, stage.camera.data.ortho_scale = (0, 0, 2), "ORTHO", 0.9
    scene = stage.extract()
    x = ((np.arange(16) + 0.5) / 16 - 0.5) * 0.9
    points = np.stack([np.tile(x, 16), np.repeat(-x, 16)], axis=1)
    got = interpolated(scene, points)[:, :3]
    if case == "normal":
        got /= np.linalg.norm(got, axis=1, keepdims=True)
    expected = (stage.radiance(str(tmp_path / "cycles.exr"), 1).reshape(-1, 3) - OFFSET) / GAIN
    wrong = np.abs(got - expected).max(1) > 2e-3 * max(1, np.abs(expected).max())
    assert wrong.mean() < 0.02  # a pixel on an edge may be either face's


def test_generated_coordinates_are_of_the_undeformed_mesh(stage):
    ob = sheet(stage)
    ob.modifiers.new("Triangulate", "TRIANGULATE")  # bending may turn the diagonals of quads
    emitting(stage, ob, "ShaderNodeTexCoord", "Generated")
    before = stage.extract().geometry.attributes[0]
    bend = ob.modifiers.new("Bend", "SIMPLE_DEFORM")
    bend.deform_method, bend.angle = "BEND", 2.0
    after = stage.extract().geometry
    np.testing.assert_allclose(after.attributes[0], before, atol=1e-5)
    assert np.abs(after.vertices - after.vertices.mean(0)).max() > 0.3


def test_each_material_fills_its_own_triangles(stage):
    ob = sheet(stage)
    emitting(stage, ob, "ShaderNodeUVMap", "UV")
    plain = stage.material("Plain")
    ob.data.materials.append(plain)
    ob.data.polygons.foreach_set("material_index", [i % 2 for i in range(len(ob.data.polygons))])
    g = stage.extract().geometry
    used = g.attributes[0].any((1, 2))
    assert used[g.material == 0].all() and not used[g.material == 1].any() and (g.material == 1).any()


def test_object_space_of_another_object(stage):
    ob = sheet(stage)
    other = stage.link("Other", None, Matrix.Translation((1, 2, 3)) @ Matrix.Scale(2, 4))
    emitting(stage, ob, "ShaderNodeTexCoord", "Object", object=other)
    bpy.context.view_layer.update()
    scene = stage.extract()
    world = scene.geometry.vertices.astype(float)[scene.geometry.triangles] + scene.origin
    np.testing.assert_allclose(scene.geometry.attributes[0][..., :3], (world - (1, 2, 3)) / 2, atol=1e-5)


def test_tangents_are_blenders_own(stage):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12)
    bpy.ops.object.shade_smooth()
    mesh = bpy.context.object.data
    mesh.uv_layers.active.data.foreach_set("uv", np.random.default_rng(2).random(2 * len(mesh.loops)).astype(np.float32))
    mesh.calc_tangents()
    loops = np.array([t.loops[:] for t in mesh.loop_triangles])
    # Triangles of quads: Blender's operator averages quads, so only the poles' own triangles are compared.
    whole = np.array([mesh.polygons[t.polygon_index].loop_total == 3 for t in mesh.loop_triangles])
    expected = np.array([loop.tangent for loop in mesh.loops])[loops][whole]
    signs = np.array([loop.bitangent_sign for loop in mesh.loops])[loops][whole]
    normals = np.array([loop.normal for loop in mesh.loops])[loops]
    uv = np.array([item.uv for item in mesh.uv_layers.active.data])[loops]
    positions = np.array([mesh.vertices[loop.vertex_index].co for loop in mesh.loops])[loops]
    got = tangents(positions, normals, uv)[whole]
    np.testing.assert_array_equal(got[..., 3], signs)
    assert np.einsum("tkc,tkc->tk", got[..., :3], expected).min() > 0.999


def test_mirroring_turns_the_bitangent(stage):
    ob = sheet(stage)
    batch = {}
    for name, scale in (("plain", 1), ("mirrored", -1)):
        ob.scale = scale, 1, 1
        batch[name] = tangent_attribute(stage)
    # Corners 1 and 2 of a mirrored triangle are swapped.
    mirrored = batch["mirrored"][:, [0, 2, 1]]
    np.testing.assert_allclose(mirrored[..., 3], -batch["plain"][..., 3])
    np.testing.assert_allclose(mirrored[..., :3] * (-1, 1, 1), batch["plain"][..., :3], atol=1e-5)


def tangent_attribute(stage):
    """Slot 0 with the tangents of the active UV map, asked for directly."""
    return assembled(stage, rq.TANGENT)[0].attributes[0]


def assembled(stage, kind, name="", baked=None):
    """`assemble` of the one material in the scene, which reads one attribute."""
    found = in_render_depsgraph(stage.scene, stage.scene.view_layers[0], geometry.collect)
    compiled = CompiledMaterials(materials=None, requests=[[AttributeRequest(kind, name)]], baked_uvs=baked or {})
    return geometry.assemble(found, compiled)


def test_baked_uvs_are_of_each_object(stage):
    first = stage.cube("First")
    stage.link("Second", first.data)
    stage.link("Third", first.data)
    baked = {name: np.random.default_rng(i).random((12, 3, 2)).astype(np.float32) for i, name in enumerate(("First", "Second"))}
    baked["Third"] = np.ones((48, 3, 2), np.float32)  # of a subdivided viewport
    g, _, warnings = assembled(stage, rq.BAKED, "bake", {"bake": baked})
    for i, name in enumerate(("First", "Second")):
        np.testing.assert_array_equal(g.attributes[0][g.object == i][..., :2], baked[name])
    assert not g.attributes[0][g.object == 2][..., :2].any()
    assert [w for w in warnings if "'Third'" in w and "viewport" in w]


@pytest.mark.parametrize("kind", [rq.WORLD_NORMAL, rq.FACE_NORMAL])
def test_normals_in_the_world(stage, kind):
    ob = sheet(stage)
    ob.scale, ob.rotation_euler = (-1, 2, 0.5), (0.2, 0.3, 0.4)
    g = assembled(stage, kind)[0]
    if kind == rq.WORLD_NORMAL:
        expected = g.corner_normals
    else:
        a, b, c = g.vertices.astype(float)[g.triangles].transpose(1, 0, 2)
        faces = np.cross(b - a, c - a)
        expected = np.repeat((faces / np.linalg.norm(faces, axis=1, keepdims=True))[:, None], 3, axis=1)
    np.testing.assert_allclose(g.attributes[0][..., :3], expected, atol=1e-4)
    assert (g.attributes[0][..., 3] == 1).all()


def test_a_step_along_the_object_s_normal_in_the_world(stage):
    ob = sheet(stage)
    ob.scale, ob.rotation_euler = (-1, 2, 0.5), (0.2, 0.3, 0.4)
    g = assembled(stage, rq.RAISED)[0]
    matrix = np.array(ob.matrix_world, float)[:3, :3]
    local = np.linalg.inv(matrix) @ g.attributes[0].reshape(-1, 4)[:, :3].T
    np.testing.assert_allclose(np.linalg.norm(local, axis=0), 1, atol=1e-5)
    expected = matrix.T @ g.corner_normals.reshape(-1, 3).T
    np.testing.assert_allclose(local, expected / np.linalg.norm(expected, axis=0), atol=1e-4)
