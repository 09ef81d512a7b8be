"""Lightmaps in Blender: UV maps beside those that are there, objects that are refused, materials and the way back, the operators."""

import bpy
import numpy as np
import pytest

import lumigate
from lumigate.addon import lightmap_operators, operators
from lumigate.addon.job import Job, computing
from lumigate.addon.lightmap_atlas import ATLAS_LAYER, placed
from lumigate.addon.lightmap_attributes import ATTRIBUTE, bake_attributes
from lumigate.addon.lightmap_materials import kept_set_up, set_up, take_down
from lumigate.addon.lightmap_operators import chosen_objects
from lumigate.addon.lightmap_uv import LAYER, Unwrap, ensure_uv
from lumigate.addon.lightmaps import LightmapRequest, bake_scene, choose_objects, prepare
from lumigate.core.errors import SceneError
from lumigate.core.lightmaps import check_charts
from lumigate.core.settings import BakeSettings, RenderSettings

QUICK = BakeSettings(RenderSettings(vpls=64, bounces=1, samples=1, gather=1, direct_samples=1), texel_samples=1)


@pytest.fixture
def scene():
    """A lamp over a floor with two boxes that share a mesh; no camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    material = bpy.data.materials.new("Paint")
    if material.node_tree is None:
        material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.2, 0.5, 0.8, 1)
    bpy.ops.mesh.primitive_plane_add(size=4)
    bpy.context.object.name = "Floor"
    bpy.ops.mesh.primitive_cube_add(size=1, location=(-1, 0, 0.5))
    box = bpy.context.object
    box.name = "Box"
    box.data.materials.append(material)
    other = bpy.data.objects.new("Other box", box.data)
    other.location, other.scale = (1, 0, 0.5), (1, 1, 1)
    scene.collection.objects.link(other)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.location, lamp.data.energy = (0, 0, 3), 100
    scene.collection.objects.link(lamp)
    bpy.context.view_layer.update()
    return scene


@pytest.fixture
def registered():
    lumigate.register()
    yield
    lumigate.unregister()
    bpy.ops.wm.read_factory_settings(use_empty=True)  # later tests find no settings of these


def corner_uvs(mesh, layer):
    """(T, 3, 2) of a mesh's triangles."""
    mesh.calc_loop_triangles()
    loops = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("loops", loops.ravel())
    uv = np.empty((len(mesh.loops), 2), np.float32)
    mesh.uv_layers[layer].data.foreach_get("uv", uv.ravel())
    return uv[loops]


@pytest.mark.parametrize("method", ["smart", "pack"])
def test_uv_maps_are_made_beside_those_that_are_there(scene, method):
    box = scene.objects["Box"]
    before = corner_uvs(box.data, "UVMap")
    box.select_set(False)
    bpy.context.view_layer.objects.active = scene.objects["Floor"]
    counts = {name: len(getattr(bpy.data, name)) for name in ("scenes", "objects", "meshes", "materials")}

    made = ensure_uv([box, scene.objects["Other box"]], Unwrap(method=method))

    assert made == [box.data]
    assert [layer.name for layer in box.data.uv_layers] == ["UVMap", LAYER]
    assert box.data.uv_layers.active.name == "UVMap" and box.data.uv_layers["UVMap"].active_render
    assert np.array_equal(corner_uvs(box.data, "UVMap"), before)
    assert bpy.context.view_layer.objects.active.name == "Floor" and not box.select_get() and box.mode == "OBJECT"
    assert {name: len(getattr(bpy.data, name)) for name in counts} == counts
    uv = corner_uvs(box.data, LAYER)
    check_charts(uv, np.zeros(len(uv), int), ["Box"], LAYER)
    assert ensure_uv([box], Unwrap(method=method)) == []


def test_charts_have_the_scale_of_the_object(scene):
    floor = scene.objects["Floor"]
    floor.scale = (1, 0.25, 1)
    bpy.context.view_layer.update()
    ensure_uv([floor], Unwrap())
    extent = np.ptp(corner_uvs(floor.data, LAYER).reshape(-1, 2), axis=0)
    assert max(extent) / min(extent) == pytest.approx(4, rel=0.05)


def test_an_overlapping_map_is_refused_before_any_ray(scene):
    box = scene.objects["Box"]
    layer = box.data.uv_layers.new(name=LAYER)
    layer.data.foreach_set("uv", np.tile([0, 0, 1, 0, 1, 1, 0, 1], 6).astype(np.float32))
    with pytest.raises(SceneError, match="'Box': faces overlap in UV map 'Lightmap'"):
        prepare(scene, [box], LightmapRequest(QUICK))
    layer.data.foreach_set("uv", np.tile([0, 0, 3, 0, 3, 3, 0, 3], 6).astype(np.float32))
    with pytest.raises(SceneError, match=r"'Box': .* outside of 0\.\.1"):
        prepare(scene, [box], LightmapRequest(QUICK))


def test_modifiers_that_repeat_the_map_are_refused(scene):
    floor = scene.objects["Floor"]
    floor.modifiers.new("Array", "ARRAY")
    with pytest.raises(SceneError, match="'Floor': faces overlap"):
        prepare(scene, [floor], LightmapRequest(QUICK))


def test_objects_are_chosen_by_name_by_selection_or_all(scene):
    assert [ob.name for ob in choose_objects(scene)] == ["Box", "Floor", "Other box"]
    for ob in scene.objects:
        ob.select_set(ob.name == "Floor")
    assert [ob.name for ob in choose_objects(scene, selected=True)] == ["Floor"]
    assert [ob.name for ob in choose_objects(scene, ["Other box"])] == ["Other box"]
    for name, words in (("Chair", "its meshes are: Box, Floor"), ("Lamp", "no faces")):
        with pytest.raises(SceneError, match=words):
            choose_objects(scene, [name])
    scene.objects["Floor"].hide_render = True
    with pytest.raises(SceneError, match="hidden from renders"):
        choose_objects(scene, ["Floor"])


def test_images_have_the_size_that_the_density_asks_for(scene):
    floor, box = scene.objects["Floor"], scene.objects["Box"]
    request = LightmapRequest(QUICK, density=8, densities={"Box": 16})
    prepared = prepare(scene, [floor, box], request)
    density = {}
    for target in prepared.targets:
        corners = prepared.arrays.geometry.vertices[prepared.arrays.geometry.triangles[target.triangles[0]]]
        texels = target.uv[0] * target.size
        density[target.name] = np.linalg.norm(texels[1] - texels[0]) / np.linalg.norm(corners[1] - corners[0])
    assert density["Floor"] == pytest.approx(8, rel=0.15)
    assert density["Box"] == pytest.approx(16, rel=0.15)


def test_an_atlas_holds_every_object_in_a_place_of_its_own(scene):
    baked = bake_scene(scene, choose_objects(scene), LightmapRequest(QUICK, size=96, atlas=True))
    assert [lightmap.name for lightmap in baked.result.lightmaps] == ["Lightmap"]
    assert baked.layer == ATLAS_LAYER and baked.objects == {"Lightmap": ["Box", "Floor", "Other box"]}
    assert scene.objects["Box"].data != scene.objects["Other box"].data  # one place each, so one mesh each
    uv = np.concatenate([corner_uvs(ob.data, ATLAS_LAYER) for ob in choose_objects(scene)])
    check_charts(uv, np.zeros(len(uv), int), ["all"], ATLAS_LAYER)
    image = baked.result.lightmaps[0].image
    assert image.shape == (96, 96, 3) and image[baked.result.lightmaps[0].state == 2].mean() > 0


def test_squares_are_placed_apart_or_not_at_all():
    sides = np.array([4.0, 2.0, 2.0, 1.0, 3.0])
    squares = placed(sides, 5.0, 64, 2)
    for i, (x, y, side) in enumerate(squares):
        assert side == sides[i] * 5 and min(x, y) >= 2 and max(x, y) + side <= 62
        for px, py, other in squares[:i]:
            assert x + side + 2 <= px or px + other + 2 <= x or y + side + 2 <= py or py + other + 2 <= y
    assert placed(sides, 20.0, 64, 2) is None


def test_a_floor_is_lit_as_the_closed_form_says(scene):
    # A point lamp of 100 W: irradiance Phi cos / (4 pi r^2), 3 m below it.
    for name in ("Box", "Other box"):
        scene.objects[name].hide_render = True
    settings = BakeSettings(RenderSettings(vpls=64, bounces=0, direct_samples=16), texel_samples=1)
    scene.objects["Lamp"].data.shadow_soft_size = 0
    lightmap = bake_scene(scene, [scene.objects["Floor"]], LightmapRequest(settings, size=33)).result.lightmaps[0]
    assert lightmap.image[15:18, 15:18].mean() == pytest.approx(100 / (4 * np.pi) / 9 / np.pi * np.pi, rel=0.02)


def state_of(scene):
    """What of the scene's materials a user would miss."""
    return [
        (ob.name, ob.data.name, [(slot.material and slot.material.name, slot.link) for slot in ob.material_slots], len(ob.data.materials))
        for ob in scene.objects
        if ob.type == "MESH"
    ] + sorted(material.name for material in bpy.data.materials)


@pytest.mark.parametrize("content", ["full", "irradiance", "indirect"])
def test_materials_are_set_up_and_given_back(scene, content):
    before = state_of(scene)
    image = bpy.data.images.new("Light", 4, 4, float_buffer=True)
    objects = choose_objects(scene)
    for _ in range(2):  # again over the first time
        for ob in objects:
            set_up(ob, image, LAYER, content, 2.0)
    for ob in objects:
        tree = ob.material_slots[0].material.node_tree
        texture = next(node for node in tree.nodes if node.type == "TEX_IMAGE")
        assert texture.image == image and texture.inputs["Vector"].links[0].from_node.uv_map == LAYER
        assert tree.get_output_node("ALL").inputs["Surface"].is_linked
    assert bpy.data.materials["Paint"].users > 0
    assert take_down(scene.objects) == 3
    assert state_of(scene) == before
    assert take_down(scene.objects) == 0


def test_lightmapped_materials_shine_as_baked(scene):
    # An irradiance of pi on albedo (.2, .5, .8) is a radiance of just that.
    image = bpy.data.images.new("Light", 4, 4, float_buffer=True)
    image.pixels.foreach_set(np.full(64, np.pi, np.float32))
    box = scene.objects["Box"]
    ensure_uv([box], Unwrap())
    set_up(box, image, LAYER, "irradiance")
    tree = box.material_slots[0].material.node_tree
    shader = tree.get_output_node("ALL").inputs["Surface"].links[0].from_node
    product = shader.inputs["Emission Color"].links[0].from_node
    assert tuple(product.inputs[1].default_value) == pytest.approx((0.2, 0.5, 0.8))
    assert shader.inputs["Emission Strength"].default_value == pytest.approx(1 / np.pi)


def test_lightmapped_mixes_have_the_colour_of_what_the_output_shows(scene):
    tree = bpy.data.materials["Paint"].node_tree  # whose first node, no longer shown, is (.2, .5, .8)
    mix, add = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeAddShader")
    mix.inputs[0].default_value = 0.25
    for socket, color in ((mix.inputs[1], (0.8, 0.4, 0.0)), (mix.inputs[2], (0.0, 0.4, 0.8))):
        node = tree.nodes.new("ShaderNodeBsdfDiffuse")
        node.inputs["Color"].default_value = (*color, 1)
        tree.links.new(node.outputs[0], socket)
    tree.links.new(mix.outputs[0], add.inputs[0])
    tree.links.new(tree.nodes.new("ShaderNodeEmission").outputs[0], add.inputs[1])
    tree.links.new(add.outputs[0], tree.get_output_node("ALL").inputs["Surface"])
    set_up(scene.objects["Box"], bpy.data.images.new("Light", 4, 4), LAYER, "irradiance")

    def color_of(socket):
        if not socket.is_linked:
            return np.array(socket.default_value[:3])
        node = socket.links[0].from_node
        if node.type == "VECT_MATH":
            assert node.operation == "ADD"
            return color_of(node.inputs[0]) + color_of(node.inputs[1])
        factor, a, b = (next(s for s in node.inputs if s.identifier == name) for name in ("Factor_Float", "A_Color", "B_Color"))
        return (1 - factor.default_value) * color_of(a) + factor.default_value * color_of(b)

    made = scene.objects["Box"].material_slots[0].material.node_tree
    shader = made.get_output_node("ALL").inputs["Surface"].links[0].from_node
    product = shader.inputs["Emission Color"].links[0].from_node
    assert color_of(product.inputs[1]) == pytest.approx((0.6, 0.4, 0.2), abs=1e-6)


def test_set_up_materials_outlast_another_set_up(scene):
    # An export sets up materials of its own, and took down those that were there.
    image, other = (bpy.data.images.new(name, 4, 4) for name in ("Light", "Other"))
    original, objects = state_of(scene), choose_objects(scene)
    for ob in objects:
        set_up(ob, image, LAYER, "full")
    before = state_of(scene)
    with kept_set_up(objects):
        for ob in objects:
            set_up(ob, other, LAYER, "full")
    assert state_of(scene) == before
    assert take_down(objects) == 3
    assert state_of(scene) == original
    with kept_set_up(objects):
        set_up(objects[0], other, LAYER, "full")
    assert state_of(scene) == original


def quick(scene):
    """Settings for a bake of a moment."""
    settings = scene.lumigate_lightmaps
    settings.size, settings.texel_samples, settings.objects = 24, 1, "ALL"
    scene.lumigate.vpls, scene.lumigate.bounces = 64, 1
    return settings


def test_operator_bakes_loads_and_restores(registered, scene):
    before = state_of(scene)
    settings = quick(scene)
    assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    image = bpy.data.images["Lightmap Floor"]
    assert image.packed_file is not None and tuple(image.size) == (24, 24)
    pixels = np.empty(24 * 24 * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    assert pixels.reshape(24, 24, -1)[12, 12, 0] > 0.1
    assert scene.objects["Floor"].material_slots[0].material.name.startswith("Material lightmap")
    settings.objects = "CHANGED"
    assert chosen_objects(scene) == []
    assert bpy.ops.lumigate.bake_lightmaps() == {"CANCELLED"}
    scene.objects["Box"].location.x -= 0.1
    bpy.context.view_layer.update()
    assert [ob.name for ob in chosen_objects(scene)] == ["Box"]
    assert bpy.ops.lumigate.restore_materials() == {"FINISHED"}
    assert state_of(scene) == before


def meshes_of(scene):
    """Mesh of each object, and the coordinates of its UV maps."""
    return {
        ob.name: (ob.data.name, {layer.name: [tuple(corner.uv) for corner in layer.data] for layer in ob.data.uv_layers})
        for ob in scene.objects
        if ob.type == "MESH"
    }


@pytest.mark.parametrize("atlas", [False, True])
def test_cancelled_bake_leaves_the_scene_as_it_was(registered, scene, monkeypatch, atlas):
    quick(scene).atlas = atlas
    if atlas:  # the lightmap of an earlier bake keeps its place
        ensure_uv([scene.objects["Floor"]], Unwrap(layer=ATLAS_LAYER))
    before, meshes = state_of(scene), meshes_of(scene)
    begun = []

    def cancelled_at_once(work):
        job = computing(work)
        begun.append(job)
        job.cancel()
        return job

    monkeypatch.setattr(lightmap_operators, "computing", cancelled_at_once)
    assert bpy.ops.lumigate.bake_lightmaps() == {"CANCELLED"}
    assert begun and begun[0].cancelled
    assert state_of(scene) == before
    assert meshes_of(scene) == meshes
    assert not [image for image in bpy.data.images if image.name.startswith("Lightmap")]


def test_operator_writes_to_disk(registered, scene, tmp_path):
    settings = quick(scene)
    settings.packed, settings.folder, settings.format, settings.atlas, settings.content = False, str(tmp_path / "maps"), "png", True, "full"
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "Lightmap.png").write_text("another's")
    for _ in range(2):  # again in the place of the first time, not of a stranger's file
        assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
        assert sorted(path.name for path in (tmp_path / "maps").iterdir()) == ["Lightmap-2.png", "Lightmap.png"]
    assert (tmp_path / "maps" / "Lightmap.png").read_text() == "another's"
    image = bpy.data.images["Lightmap Lightmap"]
    assert image.packed_file is None and image.colorspace_settings.name == "sRGB"


def test_operator_reports_what_is_wrong_in_one_line(registered, scene):
    quick(scene).objects = "SELECTED"
    for ob in scene.objects:
        ob.select_set(False)
    with pytest.raises(RuntimeError, match="no mesh object is selected"):
        bpy.ops.lumigate.bake_lightmaps()
    settings = quick(scene)
    settings.packed, settings.folder = False, "//maps"
    with pytest.raises(RuntimeError, match="not saved yet"):
        bpy.ops.lumigate.bake_lightmaps()


def test_light_at_corners_becomes_a_colour_attribute(registered, scene):
    # A point lamp of 100 W, 3 m above the middle of a floor of 4 m in 8 x 8 faces: irradiance 100 cos^3 / (4 pi^2 9) at its vertices.
    for name in ("Box", "Other box"):
        bpy.data.objects.remove(scene.objects[name])
    bpy.data.objects.remove(scene.objects["Floor"])
    bpy.ops.mesh.primitive_grid_add(size=4, x_subdivisions=8, y_subdivisions=8)
    floor = bpy.context.object
    floor.scale.x = -1
    floor.data.color_attributes.new("Painted", "BYTE_COLOR", "POINT")
    scene.objects["Lamp"].data.shadow_soft_size = 0
    settings = quick(scene)
    settings.texel_samples, scene.lumigate.bounces = 4, 0

    assert bpy.ops.lumigate.bake_attributes() == {"FINISHED"}

    colors = floor.data.color_attributes
    assert [(layer.name, layer.domain) for layer in colors] == [("Painted", "POINT"), (ATTRIBUTE, "CORNER")]
    assert colors[colors.render_color_index].name == "Painted"
    values = np.empty((len(floor.data.loops), 4), np.float32)
    colors[ATTRIBUTE].data.foreach_get("color", values.ravel())
    places = np.array([floor.data.vertices[loop.vertex_index].co for loop in floor.data.loops])
    inside = np.abs(places).max(axis=1) < 1.9
    expected = 100 / (4 * np.pi) * 3 / (9 + (places**2).sum(axis=1)) ** 1.5
    np.testing.assert_allclose(values[inside, 0], expected[inside], rtol=0.05)


def test_attributes_are_refused_where_a_mesh_is_shared_or_modified(scene):
    with pytest.raises(SceneError, match="'Box' shares its mesh"):
        bake_attributes(scene, [scene.objects["Box"]], QUICK)
    scene.objects["Floor"].modifiers.new("Array", "ARRAY")
    with pytest.raises(SceneError, match="'Floor' has other faces"):
        bake_attributes(scene, [scene.objects["Floor"]], QUICK)
    assert not scene.objects["Floor"].data.color_attributes


def test_all_leaves_out_what_collections_hide_from_the_render(scene):
    # "All" refused the whole scene for one object in an excluded collection.
    for name, ob in (("Excluded", "Box"), ("Disabled", "Other box")):
        collection = bpy.data.collections.new(name)
        scene.collection.children.link(collection)
        collection.objects.link(scene.objects[ob])
        scene.collection.objects.unlink(scene.objects[ob])
    scene.view_layers[0].layer_collection.children["Excluded"].exclude = True
    bpy.data.collections["Disabled"].hide_render = True
    assert [ob.name for ob in choose_objects(scene)] == ["Floor"]


def test_selection_is_that_of_the_view_layer(registered, scene):
    quick(scene).objects = "SELECTED"
    second = scene.view_layers.new("Second")
    for layer, name in ((scene.view_layers[0], "Floor"), (second, "Box")):
        for ob in layer.objects:
            ob.select_set(ob.name == name, view_layer=layer)
    assert [ob.name for ob in chosen_objects(scene, second)] == ["Box"]


def test_one_changed_object_takes_the_whole_atlas_along(registered, scene):
    # The atlas is replaced: an object that was left out of it showed the light of others.
    settings = quick(scene)
    settings.atlas, settings.objects = True, "CHANGED"
    assert len(chosen_objects(scene)) == 3
    for ob in scene.objects:
        if ob.type == "MESH" and ob.name != "Box":
            ob.lumigate_lightmap.stamp = lightmap_operators.stamp_of(ob, settings)
    assert [ob.name for ob in chosen_objects(scene)] == ["Box", "Floor", "Other box"]


def test_folder_is_looked_at_before_the_work(registered, scene, tmp_path, monkeypatch):
    settings = quick(scene)
    (tmp_path / "file").write_text("")
    settings.packed, settings.folder = False, str(tmp_path / "file" / "maps")
    monkeypatch.setattr(lightmap_operators, "computing", lambda work: pytest.fail("the bake began"))
    with pytest.raises(RuntimeError, match="cannot write into the folder"):
        bpy.ops.lumigate.bake_lightmaps()


def test_fault_leaves_no_uv_maps(registered, scene, monkeypatch):
    quick(scene)
    meshes = meshes_of(scene)

    def broken(*_):
        raise ValueError("broken")

    monkeypatch.setattr(lightmap_operators, "load_lightmaps", broken)
    with pytest.raises(RuntimeError, match="broken"):
        bpy.ops.lumigate.bake_lightmaps()
    assert meshes_of(scene) == meshes


def test_objects_that_a_new_atlas_leaves_out_keep_the_old_one(registered, scene):
    # Their material showed the new atlas, in which their charts lie over others'.
    settings = quick(scene)
    settings.atlas, settings.content = True, "full"
    assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    settings.objects = "SELECTED"
    for ob in scene.objects:
        ob.select_set(ob.name == "Box")

    def shown(name):
        tree = scene.objects[name].material_slots[0].material.node_tree
        return next(node for node in tree.nodes if node.type == "TEX_IMAGE").image

    first = shown("Floor")
    for _ in range(2):
        assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
        assert shown("Floor") == first == shown("Other box")
        assert shown("Box") != first and shown("Box").name == "Lightmap Lightmap"
    assert len([image for image in bpy.data.images if image.name.startswith("Lightmap")]) == 2


def test_edits_change_what_is_baked(registered, scene):
    settings, box = quick(scene), scene.objects["Box"]
    ensure_uv([box], Unwrap())

    def painted():
        bpy.data.materials["Paint"].node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.9, 0.5, 0.8, 1)

    def bevelled():
        box.modifiers.new("Bevel", "BEVEL")

    def wider():
        box.modifiers["Bevel"].width = 0.2

    def shaped():
        box.shape_key_add(name="Basis")
        box.shape_key_add(name="Tall").data[0].co.z += 1
        box.data.shape_keys.key_blocks["Tall"].value = 0.5

    def moved():
        box.data.uv_layers[LAYER].data[0].uv.x += 0.01

    def asked():
        settings.content = "full" if settings.content != "full" else "irradiance"

    stamps = [lightmap_operators.stamp_of(box, settings)]
    for edit in (painted, bevelled, wider, shaped, moved, asked):
        assert lightmap_operators.stamp_of(box, settings) == stamps[-1]
        edit()
        box.data.update()
        bpy.context.view_layer.update()
        stamps.append(lightmap_operators.stamp_of(box, settings))
    assert len(set(stamps)) == len(stamps)


def meanwhile(monkeypatch, kind, edit):
    """What the user does while an operator of this kind computes: `edit(scene)`, after the scene has been read."""
    begin = kind.begin

    def edited(self, context):
        job = begin(self, context)
        edit(context.scene)
        return job

    monkeypatch.setattr(kind, "begin", edited)


def renamed(scene):
    scene.objects["Box"].name, scene.name = "Kiste", "Room"


def removed(scene):
    bpy.data.objects.remove(scene.objects["Box"])


def unlinked(scene):
    scene.collection.objects.unlink(scene.objects["Box"])


def undone(scene):
    scene.objects["Box"].data.uv_layers.remove(scene.objects["Box"].data.uv_layers[LAYER])


def remodelled(scene):
    mesh = scene.objects["Box"].data
    mesh.clear_geometry()
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])


def in_edit_mode(scene):
    bpy.context.view_layer.objects.active = scene.objects["Box"]
    bpy.ops.object.mode_set(mode="EDIT")


def wears(ob):
    return ob.material_slots and ob.material_slots[0].material.name.endswith(f"lightmap {ob.name}")


@pytest.mark.parametrize("edit", [renamed, removed, unlinked, undone, remodelled, in_edit_mode])
def test_work_done_during_a_bake_does_not_lose_it(registered, scene, monkeypatch, edit):
    # Objects and the scene were looked up by their names of before: a KeyError at the end, and all light was lost.
    quick(scene)
    floor, box = scene.objects["Floor"], scene.objects["Box"]
    meanwhile(monkeypatch, lightmap_operators.BakeLightmaps, edit)
    try:
        assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    finally:
        if edit is in_edit_mode:
            bpy.ops.object.mode_set(mode="OBJECT")
    assert wears(floor) and "Lightmap Other box" in bpy.data.images
    assert ("Lightmap Box" in bpy.data.images) == (edit is not removed)
    if edit is undone:
        assert LAYER in box.data.uv_layers
    if edit is remodelled:  # its charts have gone: the image is there, but nothing would place it on the new faces
        assert not wears(box)
    if edit in (renamed, unlinked, undone, in_edit_mode):
        assert any(node.type == "TEX_IMAGE" for node in box.material_slots[0].material.node_tree.nodes)


@pytest.mark.parametrize("edit", [renamed, removed, remodelled, in_edit_mode])
def test_work_done_during_a_bake_of_attributes_does_not_lose_it(registered, scene, monkeypatch, edit):
    quick(scene)
    floor, box = scene.objects["Floor"], scene.objects["Box"]
    bpy.data.objects.remove(scene.objects["Other box"])
    meanwhile(monkeypatch, lightmap_operators.BakeAttributes, edit)
    try:
        assert bpy.ops.lumigate.bake_attributes() == {"FINISHED"}
    finally:
        if edit is in_edit_mode:
            bpy.ops.object.mode_set(mode="OBJECT")
    assert ATTRIBUTE in floor.data.color_attributes
    if edit in (renamed, in_edit_mode):
        colors = np.empty((len(box.data.loops), 4), np.float32)
        box.data.color_attributes[ATTRIBUTE].data.foreach_get("color", colors.ravel())
        assert colors[:, :3].max() > 0.1
    elif edit is remodelled:
        assert ATTRIBUTE not in box.data.color_attributes


def test_settings_of_the_beginning_count(registered, scene, monkeypatch, tmp_path):
    # Irradiance was shown as radiance, and "Changed" did not see what was edited while the light was computed.
    settings = quick(scene)
    settings.objects = "CHANGED"

    def edit(_scene):
        settings.content, settings.packed, settings.folder = "full", False, str(tmp_path / "none" / "maps")
        scene.objects["Box"].location.x -= 0.1
        bpy.context.view_layer.update()

    with monkeypatch.context() as patch:
        meanwhile(patch, lightmap_operators.BakeLightmaps, edit)
        assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    settings.content = "irradiance"
    assert bpy.data.images["Lightmap Floor"].packed_file is not None
    tree = scene.objects["Floor"].material_slots[0].material.node_tree
    strengths = [node.inputs["Emission Strength"].default_value for node in tree.nodes if node.type == "BSDF_PRINCIPLED"]
    assert pytest.approx(1 / np.pi) in strengths
    assert [ob.name for ob in chosen_objects(scene)] == ["Box"]


def test_lightmaps_whose_folder_has_gone_are_packed(registered, scene, tmp_path, monkeypatch):
    settings = quick(scene)
    settings.packed, settings.folder = False, str(tmp_path / "maps")
    meanwhile(monkeypatch, lightmap_operators.BakeLightmaps, lambda _scene: (tmp_path / "maps").rmdir())
    assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    assert bpy.data.images["Lightmap Floor"].packed_file is not None


def test_cancel_while_a_mesh_is_edited_leaves_the_scene_as_it_was(registered, scene, monkeypatch):
    settings = quick(scene)
    settings.atlas = True
    ensure_uv([scene.objects["Floor"]], Unwrap(layer=ATLAS_LAYER))
    before = meshes_of(scene)

    def edit(scene):
        bpy.context.view_layer.objects.active = scene.objects["Floor"]
        for ob in scene.objects:
            ob.select_set(False)
        bpy.ops.object.mode_set(mode="EDIT")
        operators.JobOperator.running.cancel()

    def begun(work):
        job = Job(lambda advance: None)
        operators.JobOperator.running = job
        edit(scene)
        return job

    monkeypatch.setattr(lightmap_operators, "computing", begun)
    assert bpy.ops.lumigate.bake_lightmaps() == {"CANCELLED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    assert meshes_of(scene) == before


def test_a_bake_that_blender_ends_leaves_the_scene_as_it_was(registered, scene):
    # The window in which it began is closed: Blender calls `cancel`, and the UV maps stayed.
    quick(scene)
    before = meshes_of(scene)

    class Ended(operators.JobOperator):
        begin, abandon = lightmap_operators.BakeLightmaps.begin, lightmap_operators.BakeLightmaps.abandon
        _prepared = None

        def _hide(self, _context):
            pass

    ended = Ended()
    ended._job = ended.begin(bpy.context)
    assert meshes_of(scene) != before
    ended.cancel(bpy.context)
    assert ended._job.wait(60) and meshes_of(scene) == before


def test_maps_and_attributes_go_together(registered, scene):
    # UV maps and colour attributes share their names: each bake added another 'Lightmap.001', and a UV map of that name was not found.
    quick(scene)
    bpy.data.objects.remove(scene.objects["Other box"])
    for _ in range(2):
        assert bpy.ops.lumigate.bake_attributes() == {"FINISHED"}
        assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    mesh = scene.objects["Box"].data
    assert [layer.name for layer in mesh.color_attributes] == [ATTRIBUTE]
    assert sorted(layer.name for layer in mesh.uv_layers) == [LAYER, "UVMap"]


@pytest.mark.parametrize(("name", "words"), [("", "choose a name"), ("x" * 80, "shorter"), ("Taken", "'Taken' that is no UV map")])
def test_names_that_no_uv_map_can_have_are_refused(scene, name, words):
    if words == "shorter" and bpy.app.version >= (5, 0):
        pytest.skip("from Blender 5 on they may be that long")
    mesh = scene.objects["Floor"].data
    mesh.attributes.new("Taken", "FLOAT", "POINT")
    maps = [layer.name for layer in mesh.uv_layers]
    with pytest.raises(SceneError, match=words):
        prepare(scene, [scene.objects["Floor"]], LightmapRequest(QUICK, Unwrap(layer=name), size=24))
    assert [layer.name for layer in mesh.uv_layers] == maps


def test_meshes_in_edit_mode_are_refused_by_name(scene):
    box = scene.objects["Box"]
    ensure_uv([box], Unwrap())
    box.data = box.data.copy()
    bpy.context.view_layer.objects.active = box
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        for bake in (lambda: prepare(scene, [box], LightmapRequest(QUICK, size=24)), lambda: bake_attributes(scene, [box], QUICK)):
            with pytest.raises(SceneError, match="'Box' is being edited"):
                bake()
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")


@pytest.fixture
def linked(registered, scene, tmp_path):
    """The scene with its objects linked from another file, in which Box has a UV map for lightmaps and a mesh of its own."""
    box = scene.objects["Box"]
    box.data = box.data.copy()
    ensure_uv([box], Unwrap())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, there):
        there.objects = ["Box", "Floor", "Lamp"]
    for ob in there.objects:
        scene.collection.objects.link(ob)
    bpy.context.view_layer.update()
    return scene


def test_linked_objects_keep_what_is_theirs(linked):
    # Light in a linked mesh went when the file was saved; materials of a linked object cannot be changed, and the bake ended with a fault.
    scene, settings = linked, quick(linked)
    with pytest.raises(RuntimeError, match="'Box' is linked"):
        bpy.ops.lumigate.bake_attributes()
    with pytest.raises(RuntimeError, match="'Floor' is linked"):
        bpy.ops.lumigate.bake_lightmaps()
    settings.objects = "SELECTED"
    for ob in scene.objects:
        ob.select_set(ob.name == "Box")
    settings.atlas = True
    with pytest.raises(RuntimeError, match="'Box' is linked"):
        bpy.ops.lumigate.bake_lightmaps()
    settings.atlas = False
    assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    assert "Lightmap Box" in bpy.data.images and not wears(scene.objects["Box"])
    assert bpy.ops.lumigate.restore_materials() == {"FINISHED"}
    override = scene.objects["Box"].override_create(remap_local_usages=True)
    override.select_set(True)
    assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    assert wears(override)


def test_a_linked_object_of_the_same_name_is_told(linked):
    twin = bpy.data.objects.new("Box", bpy.data.meshes.new_from_object(linked.objects["Box"]))
    linked.collection.objects.link(twin)
    with pytest.raises(SceneError, match="2 objects called 'Box'"):
        prepare(linked, [twin], LightmapRequest(QUICK, size=24))


def test_a_material_without_nodes_is_its_colour(scene):
    material = bpy.data.materials.new("Plain")
    if material.node_tree is not None:
        pytest.skip("from Blender 5 on every material uses its nodes")
    material.diffuse_color = (0.1, 0.6, 0.3, 1)
    floor = scene.objects["Floor"]
    floor.data.materials.append(material)
    set_up(floor, bpy.data.images.new("Light", 4, 4), LAYER, "irradiance")
    multiply = next(node for node in floor.material_slots[0].material.node_tree.nodes if node.type == "VECT_MATH")
    np.testing.assert_allclose(multiply.inputs[1].default_value, (0.1, 0.6, 0.3), rtol=1e-5)
    assert take_down([floor]) == 1 and floor.material_slots[0].material == material


def test_long_names_are_baked_again_in_their_place(registered, scene):
    quick(scene)
    scene.objects["Floor"].name, scene.objects["Box"].name = "x" * 60 + "1", "x" * 60 + "2"
    for _ in range(2):
        assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
        assert len([image for image in bpy.data.images if image.name.startswith("Lightmap")]) == 3


def light_of(name):
    """(texels, 3) of an object's lightmap."""
    image = bpy.data.images[f"Lightmap {name}"]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(-1, image.channels)[:, :3]


@pytest.mark.parametrize("content", ["irradiance", "indirect", "full"])
def test_a_second_bake_is_lit_by_lamps_not_by_the_first(registered, scene, content):
    # What the first lightmaps shine with was light of the scene: `indirect` grew threefold from bake to bake, and lamps hardly counted.
    quick(scene).content = content
    assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    first, worn = light_of("Floor"), scene.objects["Floor"].material_slots[0].material
    scene.objects["Lamp"].data.energy /= 4
    assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    np.testing.assert_allclose(light_of("Floor"), first / 4, rtol=1e-3, atol=1e-4 * first.max())
    assert bpy.ops.lumigate.bake_attributes.poll()
    prepared = prepare(scene, [scene.objects["Floor"]], LightmapRequest(QUICK, size=24))
    assert wears(scene.objects["Floor"]) and wears(scene.objects["Box"]) and worn != scene.objects["Floor"].material_slots[0].material
    assert not prepared.arrays.materials.names or not [name for name in prepared.arrays.materials.names if "lightmap" in name]


def test_objects_that_share_a_mesh_without_slots_all_show_their_lightmaps(registered, scene):
    # The slot that the mesh had been given was taken away again with the next object's.
    scene.objects["Box"].data.materials.clear()
    quick(scene)
    materials = len(bpy.data.materials)
    assert bpy.ops.lumigate.bake_lightmaps() == {"FINISHED"}
    assert all(wears(scene.objects[name]) for name in ("Box", "Other box", "Floor"))
    assert bpy.ops.lumigate.restore_materials() == {"FINISHED"}
    assert not any(scene.objects[name].material_slots for name in ("Box", "Other box", "Floor"))
    assert len(bpy.data.materials) == materials
