"""Triangles, normals, materials and visibility of every kind of object."""

import math

import bmesh
import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix

from lumigate.addon.extract import extract_scene
from lumigate.addon.extract import geometry as room
from lumigate.core.errors import SceneError
from lumigate.core.scene import ALL_RAYS, CAMERA, DIFFUSE, GLOSSY, HOLDOUT, SHADOW, TRANSMISSION

POSES = {
    "identity": Matrix.Identity(4),
    "moved": Matrix.Translation((3, -4, 5)) @ Euler((0.3, 0.7, -1.1)).to_matrix().to_4x4(),
    "stretched": Euler((0.3, 0.7, -1.1)).to_matrix().to_4x4() @ Matrix.Diagonal((2, 0.5, 3, 1)),
    "sheared": Matrix(((1, 0.7, 0, 0), (0, 1, 0.2, 0), (0, 0, 1, 0), (0, 0, 0, 1))),
    "mirrored": Matrix.Diagonal((-1, 1, 1, 1)),
    "mirrored and stretched": Matrix.Translation((0, 0, 9)) @ Matrix.Diagonal((-2, 0.5, 1, 1)),
    "inverted": Matrix.Diagonal((-1, -1, -1, 1)),
    "tiny": Matrix.Scale(1e-4, 4),
}


def posed(stage, ob, matrix):
    """An object placed by any matrix, sheared ones included."""
    ob.parent = stage.link("Parent", None)
    ob.matrix_parent_inverse = matrix
    return ob


def world_vertices(scene):
    return scene.geometry.vertices.astype(float) + scene.origin


def geometric_normals(scene):
    v = scene.geometry.vertices.astype(float)[scene.geometry.triangles]
    n = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def area(scene):
    v = scene.geometry.vertices.astype(float)[scene.geometry.triangles]
    return np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1).sum() / 2


def outward(scene):
    """Cosine between each triangle's normal and the way out from the middle of the geometry."""
    centre = scene.geometry.vertices[scene.geometry.triangles].mean(1)
    return np.einsum("tc,tc->t", geometric_normals(scene), centre)


def signed_volume(scene):
    v = scene.geometry.vertices.astype(float)[scene.geometry.triangles]
    return np.einsum("tc,tc->", v[:, 0], np.cross(v[:, 1], v[:, 2])) / 6


@pytest.mark.parametrize("pose", POSES)
def test_cube_in_every_pose(stage, pose):
    cube = posed(stage, stage.cube(), POSES[pose])
    scene = stage.extract()
    g = scene.geometry
    assert g.triangles.shape == (12, 3) and g.vertices.shape == (8, 3)
    assert g.object_names == ["Cube"] and g.object_visibility.tolist() == [ALL_RAYS]
    corners = np.array([POSES[pose] @ v.co for v in cube.data.vertices])
    got = world_vertices(scene)
    assert np.abs(got[np.lexsort(got.T.round(5))] - corners[np.lexsort(corners.T.round(5))]).max() < 1e-5
    # A closed surface stays a closed surface with its front outside, whatever the mirroring.
    assert signed_volume(scene) == pytest.approx(8 * abs(np.linalg.det(np.array(POSES[pose])[:3, :3])), rel=1e-4)
    np.testing.assert_allclose(g.corner_normals, np.repeat(geometric_normals(scene)[:, None], 3, 1), atol=1e-4)


@pytest.mark.parametrize("pose", POSES)
def test_smooth_normals_in_every_pose(stage, pose):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
    bpy.ops.object.shade_smooth()
    posed(stage, bpy.context.object, POSES[pose])
    scene = stage.extract()
    g = scene.geometry
    linear = np.array(POSES[pose])[:3, :3]
    # On the image of the unit sphere, x = M p, the normal is along M^-T p = M^-T M^-1 x.
    x = world_vertices(scene)[g.triangles] - np.array(POSES[pose])[:3, 3]
    expected = x @ np.linalg.inv(linear).T @ np.linalg.inv(linear)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    assert np.einsum("tkc,tkc->tk", g.corner_normals, expected).min() > 0.999
    np.testing.assert_allclose(np.linalg.norm(g.corner_normals, axis=-1), 1, atol=1e-5)


def test_custom_and_mixed_normals(stage):
    sheet = stage.mesh("Sheet", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2, 3)], smooth=True)
    wanted = np.array([(0.6, 0, 0.8), (0, 0.6, 0.8), (-0.6, 0, 0.8), (0, -0.6, 0.8)])
    sheet.data.normals_split_custom_set([tuple(n) for n in wanted])
    g = stage.extract().geometry
    by_vertex = {tuple(v.round(3)): n for v, n in zip(np.array([v.co for v in sheet.data.vertices]), wanted)}
    shifted = g.vertices + np.float32(0.5) * np.array([1, 1, 0], np.float32)
    for triangle, normals in zip(g.triangles, g.corner_normals):
        for corner, normal in zip(triangle, normals):
            np.testing.assert_allclose(normal, by_vertex[tuple(shifted[corner].round(3))], atol=1e-3)


def test_flat_faces_that_are_not_planar_shade_as_their_triangles(stage):
    stage.mesh("Saddle", [(0, 0, 0), (1, 0, 1), (1, 1, 0), (0, 1, 1)], [(0, 1, 2, 3)])
    scene = stage.extract()
    np.testing.assert_allclose(scene.geometry.corner_normals[:, 0], geometric_normals(scene), atol=1e-6)


def test_broken_normals_are_replaced(stage):
    ball = stage.cube()
    ball.data.polygons.foreach_set("use_smooth", [True] * 6)
    ball.data.vertices[0].co = ball.data.vertices[1].co  # triangles without area beside good ones
    ball.data.update()
    g = stage.extract().geometry
    np.testing.assert_allclose(np.linalg.norm(g.corner_normals, axis=-1), 1, atol=1e-5)


def test_far_from_the_origin_keeps_its_precision(stage):
    fine = stage.mesh("Fine", [(0, 0, 0), (1e-3, 0, 0), (0, 1e-3, 0)], [(0, 1, 2)])
    fine.location = 2**16, -(2**16), 2**10
    g = stage.extract().geometry
    edges = np.linalg.norm(g.vertices[g.triangles[0]] - np.roll(g.vertices[g.triangles[0]], 1, axis=0), axis=1)
    np.testing.assert_allclose(np.sort(edges), (1e-3, 1e-3, math.sqrt(2) * 1e-3), rtol=1e-5)


@pytest.mark.parametrize("distance", [3e4, 3e6])
def test_a_thing_left_far_away_costs_the_others_no_precision(stage, distance):
    near = np.array([(0.37 * k, 0.1, -0.3) for k in range(20)])
    for k, place in enumerate(near):
        stage.cube(f"Near {k}").matrix_world = Matrix.Translation(place)
    stage.cube("Left").matrix_world = Matrix.Translation((distance, -distance / 3, 0))
    vertices = world_vertices(stage.extract())
    vertices = vertices[vertices[:, 0] < 100].reshape(20, 8, 3)
    offsets = np.abs(vertices - np.float32(near).astype(float)[:, None])
    np.testing.assert_allclose(offsets, np.broadcast_to(offsets.round(1), offsets.shape), atol=1e-5)


def test_origin_is_the_middle_and_loose_vertices_do_not_count(stage):
    stage.mesh("Sheet", [(10, 0, 0), (12, 0, 0), (12, 4, 0), (1000, 0, 0)], [(0, 1, 2)])
    scene = stage.extract()
    np.testing.assert_allclose(scene.origin, (11, 2, 0))
    assert scene.geometry.vertices.shape == (3, 3)


def test_material_slots_by_data_and_by_object(stage):
    first = stage.cube("First", "Red", "Green", None)
    second = stage.link("Second", first.data)
    second.material_slots[1].link = "OBJECT"
    second.material_slots[1].material = stage.material("Blue")
    for i, polygon in enumerate(first.data.polygons):
        polygon.material_index = i % 3
    scene = stage.extract()
    g = scene.geometry
    worn = [[scene.materials.names[m] for m in g.material[g.object == i]] for i in range(2)]
    assert sorted(worn[0]) == sorted(["Red", "Green", ""] * 4)
    assert sorted(worn[1]) == sorted(["Red", "Blue", ""] * 4)


def test_material_index_beyond_the_slots_is_the_last_slot(stage):
    cube = stage.cube("Cube", "Red", "Green")
    cube.data.polygons.foreach_set("material_index", [7] * 6)
    scene = stage.extract()
    assert {scene.materials.names[m] for m in scene.geometry.material} == {"Green"}


def test_materials_on_no_triangle_are_not_compiled_and_their_images_not_loaded(stage):
    cube = stage.cube("Cube", "Spare", "Worn", None)
    cube.data.polygons.foreach_set("material_index", [1] * 6)
    image = bpy.data.images.new("Large", 64, 64)
    tree = stage.nodes(stage.material("Spare"))
    tree.nodes.clear()
    texture, diffuse, output = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexImage", "BsdfDiffuse", "OutputMaterial"))
    texture.image = image
    tree.links.new(texture.outputs["Color"], diffuse.inputs["Color"])
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    scene = stage.extract()
    assert scene.materials.names == ["Worn"] and not scene.geometry.material.any()
    assert scene.materials.tables.texels_u8.nbytes < 64 * 64
    assert [(s.stage, s.reason) for s in scene.skipped] == [("materials", "material 'Spare' is on no triangle")]
    cube.data.polygons[0].material_index = 0  # the same material, worn: now all of it is there
    scene = stage.extract()
    assert scene.materials.names == ["Spare", "Worn"] and scene.skipped == []
    assert scene.materials.tables.texels_u8.nbytes >= 3 * 64 * 64


def test_an_object_hidden_from_every_ray_is_not_read(stage):
    stage.cube("Shown", "Red")
    hidden = stage.cube("Hidden", "Green")
    for kind in ("camera", "diffuse", "glossy", "transmission", "shadow"):
        setattr(hidden, f"visible_{kind}", False)
    scene = stage.extract()
    assert scene.geometry.object_names == ["Shown"] and scene.materials.names == ["Red"]
    assert [(s.stage, s.reason) for s in scene.skipped] == [("objects", "object 'Hidden' is hidden from every ray")]


def test_no_slot_is_the_default_material(stage):
    stage.cube()
    assert stage.extract().materials.names == [""]


def test_material_override_of_the_view_layer(stage):
    stage.cube("Cube", "Red")
    stage.scene.view_layers[0].material_override = stage.material("Clay")
    assert stage.extract().materials.names == ["Clay"]


def test_modifiers_are_evaluated_as_for_a_render(stage):
    cube = stage.cube()
    modifier = cube.modifiers.new("Subdivision", "SUBSURF")
    modifier.subdivision_type = "SIMPLE"
    modifier.levels, modifier.render_levels = 1, 2
    assert len(stage.extract().geometry.triangles) == 12 * 4**2
    modifier.show_render = False
    assert len(stage.extract().geometry.triangles) == 12


def test_one_mesh_under_two_modifiers(stage):
    plain = stage.cube("Plain")
    stage.link("Divided", plain.data).modifiers.new("Triangulate", "SUBSURF").render_levels = 1
    g = stage.extract().geometry
    assert np.bincount(g.object).tolist() == [12, 48]
    assert g.object_names == ["Plain", "Divided"]


def test_curves_text_metaballs_and_surfaces_become_triangles(stage):
    bpy.ops.curve.primitive_bezier_circle_add()
    bpy.context.object.data.bevel_depth = 0.1
    bpy.ops.object.text_add()
    bpy.ops.object.metaball_add()
    bpy.ops.surface.primitive_nurbs_surface_sphere_add()
    for ob in bpy.context.scene.objects:
        if ob.type != "CAMERA":
            ob.data.materials.append(stage.material(ob.type))
    scene = stage.extract()
    g = scene.geometry
    worn = {(g.object_names[o], scene.materials.names[m]) for o, m in zip(g.object.tolist(), g.material.tolist())}
    assert worn == {("BézierCircle", "CURVE"), ("Text", "FONT"), ("Mball", "META"), ("SurfSphere", "SURFACE")}
    assert np.bincount(g.object).min() > 10


def test_collection_instances(stage):
    collection = bpy.data.collections.new("Trees")
    tree = stage.cube("Tree", "Leaf")
    stage.scene.collection.objects.unlink(tree)
    collection.objects.link(tree)
    for x in (0, 10):
        instancer = stage.link("Place", None, Matrix.Translation((x, 0, 0)))
        instancer.instance_type, instancer.instance_collection = "COLLECTION", collection
    scene = stage.extract()
    assert scene.geometry.object_names == ["Tree", "Tree"]
    middles = [world_vertices(scene)[np.unique(scene.geometry.triangles[scene.geometry.object == i])].mean(0)[0] for i in (0, 1)]
    np.testing.assert_allclose(sorted(middles), (0, 10), atol=1e-5)


def test_geometry_nodes_instances_and_their_materials(stage):
    points = stage.mesh("Points", [(0, 0, 0), (5, 0, 0), (0, 5, 0)], [(0, 1, 2)], "Ground")
    group = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    names = (
        "NodeGroupInput",
        "NodeGroupOutput",
        "GeometryNodeMeshCube",
        "GeometryNodeSetMaterial",
        "GeometryNodeInstanceOnPoints",
        "GeometryNodeJoinGeometry",
    )
    source, sink, box, paint, scatter, join = (group.nodes.new(name) for name in names)
    paint.inputs["Material"].default_value = stage.material("Paint")
    for a, b in (
        (source.outputs[0], scatter.inputs["Points"]), (box.outputs[0], paint.inputs[0]), (paint.outputs[0], scatter.inputs["Instance"]),
        (scatter.outputs[0], join.inputs[0]), (source.outputs[0], join.inputs[0]), (join.outputs[0], sink.inputs[0]),
    ):  # fmt: skip
        group.links.new(a, b)
    points.modifiers.new("Scatter", "NODES").node_group = group
    scene = stage.extract()
    g = scene.geometry
    assert g.object_names == ["Points"] * 4
    count = {scene.materials.names[m]: int(n) for m, n in enumerate(np.bincount(g.material))}
    assert count == {"Ground": 1, "": 0, "Paint": 36} or count == {"Ground": 1, "Paint": 36}


def test_particles_are_instances(stage):
    ground = stage.mesh("Ground", [(-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)], [(0, 1, 2, 3)])
    seed = stage.cube("Seed")
    ground.modifiers.new("Grow", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.count, settings.frame_end, settings.lifetime = 7, 1, 100
    settings.render_type, settings.instance_object = "OBJECT", seed
    settings.physics_type = "NO"
    stage.scene.frame_set(2)
    assert stage.extract().geometry.object_names.count("Seed") == 1 + 7


def test_hidden_and_excluded_objects_are_left_out(stage):
    stage.cube("Seen")
    stage.cube("Hidden").hide_render = True
    stage.cube("Hidden in viewport only").hide_viewport = True
    collection = bpy.data.collections.new("Excluded")
    stage.scene.collection.children.link(collection)
    excluded = stage.cube("Excluded")
    stage.scene.collection.objects.unlink(excluded)
    collection.objects.link(excluded)
    stage.scene.view_layers[0].layer_collection.children["Excluded"].exclude = True
    assert sorted(stage.extract().geometry.object_names) == ["Hidden in viewport only", "Seen"]


def test_ray_visibility(stage):
    bits = dict(
        visible_camera=CAMERA, visible_diffuse=DIFFUSE, visible_glossy=GLOSSY, visible_transmission=TRANSMISSION, visible_shadow=SHADOW
    )
    for name in bits:
        setattr(stage.cube(name), name, False)
    ghost = stage.cube("Ghost")
    for name in bits:
        setattr(ghost, name, False)
    g = stage.extract().geometry
    assert dict(zip(g.object_names, g.object_visibility.tolist())) == {name: ALL_RAYS & ~bit for name, bit in bits.items()}


def test_indirect_only_and_holdout_collections(stage):
    layers = stage.scene.view_layers[0].layer_collection
    for name in ("Indirect", "Holdout"):
        collection = bpy.data.collections.new(name)
        stage.scene.collection.children.link(collection)
        cube = stage.cube(name)
        stage.scene.collection.objects.unlink(cube)
        collection.objects.link(cube)
    layers.children["Indirect"].indirect_only = True
    layers.children["Holdout"].holdout = True
    scene = stage.extract()
    visible = dict(zip(scene.geometry.object_names, scene.geometry.object_visibility.tolist()))
    assert visible == {"Indirect": ALL_RAYS & ~CAMERA, "Holdout": ALL_RAYS | HOLDOUT}
    assert not scene.warnings


@pytest.mark.parametrize("within", ["material", "group"])
def test_what_only_holds_a_volume_has_no_surface(stage, within):
    stage.cube("Thing", "Red")
    stage.cube("Fog", "Fog").scale = 500, 500, 500
    tree = stage.nodes(stage.material("Fog"))
    tree.nodes.clear()
    end, place = tree.nodes.new("ShaderNodeOutputMaterial"), tree
    if within == "group":
        place = bpy.data.node_groups.new("Fog", "ShaderNodeTree")
        place.interface.new_socket("Volume", in_out="OUTPUT", socket_type="NodeSocketShader")
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = place
        tree.links.new(node.outputs[0], end.inputs["Volume"])
        end = place.nodes.new("NodeGroupOutput")
    place.links.new(place.nodes.new("ShaderNodeVolumeScatter").outputs[0], end.inputs["Volume"])
    scene = stage.extract()
    g = scene.geometry
    assert len(g.triangles) == 12 and g.object_names[g.object[0]] == "Thing" and len(set(g.object)) == 1
    assert np.abs(g.vertices).max() < 4, "it does not stretch the scene's bounds"
    assert [line for line in scene.warnings if "'Fog'" in line and "volume is left out" in line]


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e30])
def test_invalid_vertices_cost_their_triangles_only(stage, value):
    bad = stage.cube("Bad")
    bad.data.vertices[0].co.x = value
    stage.cube("Good").location.x = 4
    scene = stage.extract()
    g = scene.geometry
    assert np.isfinite(g.vertices).all() and np.isfinite(g.corner_normals).all() and np.isfinite(scene.origin).all()
    left = np.bincount(g.object, minlength=2)
    assert 0 < left[0] < 12 and left[1] == 12
    assert len(g.material) == len(g.object) == len(g.corner_normals) == g.attributes.shape[1] == len(g.triangles)
    assert [w for w in scene.warnings if "'Bad'" in w and f"{12 - left[0]} triangles" in w]
    assert np.abs(g.vertices).max() < 10


@pytest.mark.parametrize(("scale", "kept"), [((0, 0, 0), 0), ((1, 0, 0), 0), ((1, 1, 0), 12)])
def test_objects_without_volume(stage, scale, kept):
    stage.cube("Flat").scale = scale
    stage.cube("Good").location.x = 4
    scene = stage.extract()
    g = scene.geometry
    assert np.bincount(g.object, minlength=2).tolist() == [kept, 12]
    assert np.isfinite(g.corner_normals).all()
    np.testing.assert_allclose(np.linalg.norm(g.corner_normals, axis=-1), 1, atol=1e-5)
    assert any("'Flat'" in w and "scale" in w for w in scene.warnings) == (kept == 0)


def test_what_triangles_cannot_hold_is_named(stage):
    stage.cube()
    stage.link("Smoke", bpy.data.volumes.new("Smoke"))
    assert "volume 'Smoke'" in "\n".join(stage.extract().warnings)


@pytest.mark.parametrize("kind", ["hair_curves", "pointclouds"])
def test_hair_and_clouds_without_a_point_are_nothing(stage, kind):
    stage.cube()
    stage.link("Nothing", getattr(bpy.data, kind).new("Nothing"))
    scene = stage.extract()
    assert len(scene.geometry.triangles) == 12 and not scene.warnings


def test_empty_scene_has_a_warning(stage):
    scene = stage.extract()
    assert scene.geometry.triangles.shape == (0, 3)
    assert any("no meshes" in warning for warning in scene.warnings)


def test_too_many_triangles_are_refused_by_name(stage, monkeypatch):
    monkeypatch.setattr(room, "_MAX_TRIANGLES", 20)
    stage.cube("Small")
    stage.cube("Big").modifiers.new("Subdivision", "SUBSURF").render_levels = 2
    with pytest.raises(SceneError, match="'Big'"):
        stage.extract()


def test_evaluation_leaves_the_scene_as_it_was(stage):
    stage.cube()
    render = stage.scene.render
    before = {
        p.identifier: getattr(render, p.identifier) for p in render.bl_rna.properties if p.type in ("INT", "FLOAT", "ENUM", "BOOLEAN")
    }
    stage.extract()
    assert {name: getattr(render, name) for name in before} == before


def test_render_engine_hands_in_its_own_evaluation(stage):
    from lumigate.addon.extract.evaluation import in_render_depsgraph

    cube = stage.cube()
    cube.modifiers.new("Subdivision", "SUBSURF").render_levels = 1
    found = in_render_depsgraph(stage.scene, stage.scene.view_layers[0], lambda graph: stage.extract(depsgraph=graph))
    assert len(found.geometry.triangles) == 48


def test_a_scene_that_is_not_the_open_one(stage):
    other = bpy.data.scenes.new("Other")
    cube = stage.cube("Elsewhere", "Red")
    stage.scene.collection.objects.unlink(cube)
    other.collection.objects.link(cube)
    other.collection.objects.link(stage.camera)
    other.camera = stage.camera
    scene = extract_scene(other)
    assert scene.geometry.object_names == ["Elsewhere"] and scene.materials.names == ["Red"]
    assert bpy.context.scene == stage.scene


def test_a_view_layer_by_name(stage):
    stage.cube()
    layer = stage.scene.view_layers.new("Clay")
    layer.material_override, layer.use = stage.material("Clay"), False
    scene = stage.extract(view_layer="Clay")
    assert (scene.view_layer, scene.materials.names) == ("Clay", ["Clay"])
    assert not layer.use
    scene = stage.extract()
    assert (scene.view_layer, scene.materials.names) == ("ViewLayer", [""])


def test_what_is_being_edited_is_there(stage):
    # A mesh in Edit Mode is empty for all but the editor: the object, what shares its mesh, and its instances were missing from every render.
    box = stage.cube()
    box.data.uv_layers.new(name="Map")
    twin = bpy.data.objects.new("Twin", box.data)
    twin.modifiers.new("Array", "ARRAY")
    parts = bpy.data.collections.new("Parts")
    parts.objects.link(box)
    instancer = bpy.data.objects.new("Instancer", None)
    instancer.instance_type, instancer.instance_collection = "COLLECTION", parts
    for ob in (twin, instancer):
        stage.scene.collection.objects.link(ob)

    def triangles():
        arrays = stage.extract()
        counts = np.bincount(arrays.geometry.object, minlength=len(arrays.geometry.object_names))
        return sorted(zip(arrays.geometry.object_names, counts.tolist()))

    before = triangles()
    bpy.context.view_layer.objects.active = box
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        assert triangles() == before
        edited = bmesh.from_edit_mesh(box.data)
        bmesh.ops.delete(edited, geom=list(edited.faces)[:1], context="FACES")
        bmesh.update_edit_mesh(box.data)
        assert sum(count for _, count in triangles()) == sum(count for _, count in before) * 5 // 6
        assert box.mode == "EDIT"
        assert len(box.data.polygons) == 5  # where Cycles bakes from
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
