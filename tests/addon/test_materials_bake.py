"""What the core cannot compute is baked by Cycles, on copies, and kept."""

import bpy
import numpy as np
import pytest

from lumigate.addon.materials import MaterialUse, atlas, bake, compile_materials
from lumigate.addon.materials import requests as rq
from lumigate.core.surfaces import layout
from lumigate.core.surfaces.batch import evaluate_batch


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    """A cache folder of the test's own, and small textures."""
    monkeypatch.setattr(bake, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(bake, "_SIDE", 256)


def scene_with(material_of):
    """A subdivided plane, a cube and a half-dressed second plane in one material."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    material = bpy.data.materials.new("Odd")
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output, emission = tree.nodes.new("ShaderNodeOutputMaterial"), tree.nodes.new("ShaderNodeEmission")
    tree.links.new(emission.outputs[0], output.inputs[0])
    tree.links.new(material_of(tree), emission.inputs[0])
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=4, y_subdivisions=3, location=(0, 0, 0))
    bpy.ops.mesh.primitive_cube_add(location=(3, 0, 0))
    bpy.ops.mesh.primitive_circle_add(vertices=7, fill_type="NGON", location=(0, 4, 1))
    objects = list(bpy.context.scene.objects)
    for ob in objects:
        ob.data.materials.append(material)
    other = bpy.data.materials.new("Other")
    objects[1].data.materials.append(other)
    objects[1].data.polygons[2].material_index = 1
    return material, tuple(objects)


def gabor(tree):
    """A texture without a counterpart in the core, over world positions."""
    node = tree.nodes.new("ShaderNodeTexGabor")
    node.inputs["Scale"].default_value = 0.7
    tree.links.new(tree.nodes.new("ShaderNodeNewGeometry").outputs["Position"], node.inputs["Vector"])
    return node.outputs["Value"]


def compiled(material, objects):
    graph = bpy.context.evaluated_depsgraph_get()
    return compile_materials([MaterialUse(material.evaluated_get(graph), tuple(o.evaluated_get(graph) for o in objects))])


def radiance(found, ob, material_index=0):
    """Emission at the middle of every triangle of the object that wears the material, and those middles."""
    mesh = ob.data
    mesh.calc_loop_triangles()
    uv = found.baked_uvs["Odd"][ob.name]
    keep = np.array([t.material_index == material_index for t in mesh.loop_triangles])
    n = len(uv)
    attributes = np.zeros((1, n, 3, 4), np.float32)
    attributes[0, :, :, :2] = uv
    third = np.full(n, 1 / 3, np.float32)
    surfaces = evaluate_batch(found.materials.tables, np.zeros(n, np.int32), attributes, np.arange(n), third, third, 1.0, 1)
    middles = np.array([np.mean([(ob.matrix_world @ mesh.vertices[v].co)[:] for v in t.vertices], 0) for t in mesh.loop_triangles])
    return surfaces[keep, layout.EMISSION], middles[keep]


def position(tree):
    """World position through a node the core refuses: what must come out is known everywhere."""
    wire = tree.nodes.new("ShaderNodeWireframe")
    wire.inputs[0].default_value = 0.0
    add = tree.nodes.new("ShaderNodeVectorMath")
    tree.links.new(tree.nodes.new("ShaderNodeNewGeometry").outputs["Position"], add.inputs[0])
    tree.links.new(wire.outputs[0], add.inputs[1])
    return add.outputs[0]


def test_atlas_cells_do_not_overlap():
    rng = np.random.default_rng(1)
    areas = rng.random(700) ** 4
    sizes = atlas.cell_sizes(areas, 1024)
    corners = atlas.pack(sizes, 1024)
    taken = np.zeros((1024, 1024), int)
    for (x, y), size in zip(corners, sizes):
        taken[y : y + size, x : x + size] += 1
    assert taken.max() == 1 and taken.sum() == (sizes**2).sum()
    assert taken.mean() > 0.2


def test_atlas_refuses_what_does_not_fit():
    with pytest.raises(ValueError, match="too many"):
        atlas.cell_sizes(np.ones(100), 64)


def test_unknown_node_is_baked_with_a_warning():
    material, objects = scene_with(gabor)
    found = compiled(material, objects)
    assert [r.kind for r in found.requests[0]] == [rq.BAKED]
    (warning,) = found.warnings
    assert "'Odd'" in warning and "Gabor" in warning and "baked" in warning
    values = np.concatenate([radiance(found, ob)[0] for ob in objects])
    assert values.std() > 0.02


def test_known_positions_come_back_from_the_bake():
    """Wireframe is the unknown node; only its own output is baked, and it is zero, so that what is around it stays exact."""
    material, objects = scene_with(position)
    found = compiled(material, objects)
    kinds = {r.kind for r in found.requests[0]}
    assert kinds == {rq.BAKED, rq.WORLD_POSITION}


def test_bake_of_a_whole_position(monkeypatch):
    from lumigate.addon.materials import registry

    def through(tree):
        node = tree.nodes.new("ShaderNodeVectorMath")
        node.operation = "ABSOLUTE"
        tree.links.new(tree.nodes.new("ShaderNodeNewGeometry").outputs["Position"], node.inputs[0])
        return node.outputs[0]

    monkeypatch.delitem(registry.VALUES, "ShaderNodeVectorMath")
    material, objects = scene_with(through)
    found = compiled(material, objects)
    for ob in objects:
        values, middles = radiance(found, ob)
        np.testing.assert_allclose(values, np.abs(middles[:, 0]), atol=0.02)


def test_inside_groups_and_nothing_is_left_behind():
    def grouped(tree):
        group = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
        group.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketColor")
        end = group.nodes.new("NodeGroupOutput")
        group.links.new(gabor(group), end.inputs[0])
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        return node.outputs[0]

    material, objects = scene_with(grouped)
    before = {name: len(getattr(bpy.data, name)) for name in bake._COLLECTIONS}
    found = compiled(material, objects)
    assert {name: len(getattr(bpy.data, name)) for name in bake._COLLECTIONS} == before
    assert radiance(found, objects[0])[0].std() > 0.02


def test_second_time_comes_from_the_cache(monkeypatch):
    material, objects = scene_with(gabor)
    first = compiled(material, objects)
    monkeypatch.setattr(bake, "_bake_object", lambda *_, **__: pytest.fail("baked again"))
    second = compiled(material, objects)
    np.testing.assert_array_equal(first.materials.tables.texels_f32, second.materials.tables.texels_f32)


def test_changed_tree_is_another_bake():
    material, objects = scene_with(gabor)
    first = compiled(material, objects)
    node = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeTexGabor")
    node.inputs["Scale"].default_value = 2.0
    second = compiled(material, objects)
    assert np.abs(first.materials.tables.texels_f32 - second.materials.tables.texels_f32).max() > 0.05


def test_without_objects_the_viewport_colour_shows():
    material, _ = scene_with(gabor)
    material.diffuse_color = (0.1, 0.2, 0.3, 1)
    found = compile_materials([MaterialUse(material)])
    np.testing.assert_allclose(found.materials.tables.constant[0, :3], (0.1, 0.2, 0.3), rtol=1e-6)
    assert "viewport colour" in found.warnings[0]
