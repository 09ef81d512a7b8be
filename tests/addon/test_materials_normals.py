"""Normal maps and bumps against Cycles' Normal pass."""

import bpy
import numpy as np

from lumigate.addon.materials import MaterialUse, compile_materials
from lumigate.core import scene as sc
from lumigate.core.surfaces import layout


def _diffuse_with(node_type, node, **settings):
    def build(tree, end):
        made = node(tree, node_type, **settings)
        shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
        tree.links.new(made.outputs[0], shader.inputs["Normal"])
        tree.links.new(shader.outputs[0], end.inputs[0])

    return build


def _tint(tree):
    made = tree.nodes.new("ShaderNodeVertexColor")
    made.layer_name = "Tint"
    return made.outputs[0]


def _upward(tree):
    """Encoded directions that stay above the surface."""
    made = tree.nodes.new("ShaderNodeMix")
    made.data_type = "RGBA"
    next(s for s in made.inputs if s.identifier == "Factor_Float").default_value = 0.3
    next(s for s in made.inputs if s.identifier == "A_Color").default_value = (0.5, 0.5, 1, 1)
    tree.links.new(_tint(tree), next(s for s in made.inputs if s.identifier == "B_Color"))
    return next(s for s in made.outputs if s.identifier == "Result_Color")


def test_normal_map(grid, node):
    for space in ("TANGENT", "WORLD"):
        for strength in (0.0, 0.6, 1.0, 1.8):
            for uv in ("UVMap", "Second") if space == "TANGENT" else ("UVMap",):
                inputs = {"Strength": strength, "Color": _upward}
                build = _diffuse_with("ShaderNodeNormalMap", node, space=space, uv_map=uv, inputs=inputs)
                grid.add(f"{space} {strength} {uv}", build)
    for name, got in grid.compare().items():
        np.testing.assert_allclose(got.normal, got.passes["Normal"], atol=2e-3, err_msg=name)
    assert all(f & sc.NORMAL_MAPPED for f in grid.flags)


def _height(node, kind="ShaderNodeTexNoise", coordinates="Object", **settings):
    """Makes the height of a bump: a texture over coordinates."""

    def make(tree):
        made = node(tree, kind, **settings)
        source = tree.nodes.new("ShaderNodeTexCoord")
        tree.links.new(source.outputs[coordinates], made.inputs["Vector"])
        return made.outputs[0]

    return make


def _relief():
    """A rough image of heights."""
    image = bpy.data.images.new("relief", 6, 5, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.random.default_rng(3).random((30, 4), np.float32)
    image.pixels.foreach_set(pixels.ravel())
    return image


def _bump(node, height, invert=False, **inputs):
    return _diffuse_with("ShaderNodeBump", node, invert=invert, inputs={"Height": height, "Distance": 0.1, **inputs})


def test_bump(grid, node):
    """Cycles' Normal pass, to the rounding: the steps over which heights are compared are the same."""
    relief = _relief()
    heights = {f"noise {c}": _height(node, coordinates=c) for c in ("UV", "Generated", "Object")}
    heights["image"] = _height(node, "ShaderNodeTexImage", "UV", image=relief)
    for name, height in heights.items():
        for strength, distance, width, invert in ((1, 0.1, 0.1, False), (0.4, 0.3, 0.1, True), (1.7, 0.05, 1.0, False)):
            inputs = {"Strength": strength, "Distance": distance, "Filter Width": width}
            grid.add(f"{name} {strength} {width} {invert}", _bump(node, height, invert, **inputs))
    noise = heights["noise Object"]
    grid.add("scaled", _bump(node, noise), scale=(3, 0.4))
    grid.add("scaled, turned", _bump(node, noise), angle=-0.8, scale=(0.5, 2))
    grid.add("from behind", _bump(node, noise), angle=2.6)
    grid.add("chained", _bump(node, heights["image"], Normal=lambda tree: _socket(tree, node, _bump_node(noise), "Normal")))
    grid.add(
        "on a normal map",
        _bump(node, noise, Normal=lambda tree: _socket(tree, node, ("ShaderNodeNormalMap", {"Color": _upward}), "Normal")),
    )
    for name, got in grid.compare().items():
        found = got.normal if got.cosine > 0 else -got.normal  # the core turns them to the viewer later
        covered = got.passes["Normal"].any(axis=1)
        assert covered.sum() >= 32, name
        np.testing.assert_allclose(found[covered], got.passes["Normal"][covered], atol=2e-4, err_msg=name)
        assert np.ptp(got.normal[:, :2], axis=0).min() > 0.01, name
    assert all(f & sc.NORMAL_MAPPED for f in grid.flags)
    assert not grid.warnings


def _bump_node(height):
    return "ShaderNodeBump", {"Height": height, "Distance": 0.2}


def _socket(tree, node, made, output):
    kind, inputs = made
    return node(tree, kind, inputs=inputs).outputs[output]


def test_bump_of_a_wave_has_the_slope_of_a_cosine(grid, node):
    """Height 0.02 sin(7 x) over an object: the normal is (-0.14 cos(7 x), 0, 1), normalised."""

    def sine(tree):
        place, axis = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeSeparateXYZ")
        tree.links.new(place.outputs["Object"], axis.inputs[0])
        turned = node(tree, "ShaderNodeMath", operation="MULTIPLY", inputs={1: 7.0})
        tree.links.new(axis.outputs["X"], turned.inputs[0])
        wave = node(tree, "ShaderNodeMath", operation="SINE")
        tree.links.new(turned.outputs[0], wave.inputs[0])
        return wave.outputs[0]

    grid.add("sine", _bump(node, sine, Distance=0.02, **{"Filter Width": 0.002}))
    got = grid.compare()["sine"]
    x = got.passes["Position"][:, 0]
    expected = np.stack([-0.14 * np.cos(7 * x), 0 * x, 1 + 0 * x], axis=1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(got.normal, expected, atol=1e-3)
    np.testing.assert_allclose(got.surfaces[:, layout.TILT], expected[:, 2], atol=1e-3)


def test_bump_without_effect_leaves_the_surface_as_it_is(grid, node):
    grid.add("no height", _diffuse_with("ShaderNodeBump", node, inputs={"Strength": 1.0}))
    grid.add("no strength", _bump(node, _height(node), Strength=0.0))
    grid.add("level", _bump(node, lambda tree: node(tree, "ShaderNodeValue").outputs[0]))
    for name, got in grid.compare().items():
        np.testing.assert_allclose(got.normal, np.tile((0, 0, 1), (64, 1)), atol=1e-6, err_msg=name)
    assert not grid.warnings


def test_bump_of_what_cannot_be_computed_is_left_out_with_a_warning(grid, node):
    grid.add("it", _bump(node, lambda tree: tree.nodes.new("ShaderNodeAmbientOcclusion").outputs["AO"]))
    found = compile_materials([MaterialUse(grid.materials["it"][0])], may_bake=False)
    assert len(found.warnings) == 1
    assert "'it'" in found.warnings[0] and "bump is left out" in found.warnings[0]
    assert found.materials.tables.flags[0] & sc.NORMAL_MAPPED


def test_bump_map_correction_is_the_materials_choice(grid, node):
    for name, corrected in (("on", True), ("off", False)):
        grid.add(name, _bump(node, _height(node)))
        grid.materials[name][0].cycles.use_bump_map_correction = corrected
    found = grid.compare()
    assert (found["on"].surfaces[:, layout.TILT] > 0.5).all()
    assert not found["off"].surfaces[:, layout.TILT].any()


def test_linked_but_plain_normal(grid):
    def geometry(tree, end):
        made, shader = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeBsdfDiffuse")
        tree.links.new(made.outputs["Normal"], shader.inputs["Normal"])
        tree.links.new(shader.outputs[0], end.inputs[0])

    grid.add("plain", geometry)
    np.testing.assert_allclose(grid.compare()["plain"].normal, np.tile((0, 0, 1), (64, 1)), atol=1e-6)


def test_normals_of_any_length(grid, node):
    """As in Cycles they are made unit ones, and the surface's own where they are none."""
    for name, normal in (("short", (0.2, 0.1, 0.3)), ("long", (0.5, -1.0, 2.0)), ("none", (0.0, 0.0, 0.0))):
        grid.add(name, _diffuse_with("ShaderNodeCombineXYZ", node, inputs=dict(enumerate(normal))))
    for name, got in grid.compare().items():
        np.testing.assert_allclose(got.normal, got.passes["Normal"], atol=1e-5, err_msg=name)
        np.testing.assert_allclose(np.linalg.norm(got.normal, axis=1), 1, rtol=1e-5)


def test_a_group_s_normal_that_nothing_feeds_is_the_surface_s(grid, node):
    def build(tree, end):
        group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
        group.interface.new_socket("Normal", in_out="INPUT", socket_type="NodeSocketVector")
        group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
        begin, inner = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
        shader = group.nodes.new("ShaderNodeBsdfDiffuse")
        group.links.new(begin.outputs[0], shader.inputs["Normal"])
        group.links.new(shader.outputs[0], inner.inputs[0])
        tree.links.new(node(tree, "ShaderNodeGroup", node_tree=group).outputs[0], end.inputs[0])

    grid.add("unlinked", build)
    found = grid.compare()["unlinked"]
    np.testing.assert_allclose(found.passes["Normal"], np.tile((0, 0, 1), (64, 1)), atol=1e-6)
    if grid.flags[0] & sc.NORMAL_MAPPED:
        np.testing.assert_allclose(found.normal, found.passes["Normal"], atol=1e-6)


def _displaced(node, height, normal=None, space="OBJECT", **inputs):
    """A diffuse surface whose material has a displacement."""

    def build(tree, end):
        made = node(tree, "ShaderNodeDisplacement", space=space, inputs={"Height": height, "Scale": 0.1, **inputs})
        shader = node(tree, "ShaderNodeBsdfDiffuse", inputs={} if normal is None else {"Normal": normal})
        tree.links.new(made.outputs[0], end.inputs["Displacement"])
        tree.links.new(shader.outputs[0], end.inputs["Surface"])

    return build


def test_displacement_bumps(grid, node):
    """Cycles' Normal pass, as of bumps; a normal map of a shader's own hides them, a bump adds to them."""
    noise, image = _height(node), _height(node, "ShaderNodeTexImage", "UV", image=_relief())
    grid.add("noise", _displaced(node, noise))
    grid.add("image", _displaced(node, image, Midlevel=0.2))
    grid.add("large", _displaced(node, noise), scale=(3, 3))
    grid.add("in world space", _displaced(node, noise, space="WORLD"), scale=(0.5, 2), angle=-0.8)
    grid.add("from behind", _displaced(node, noise), angle=2.6)
    grid.add("level", _displaced(node, lambda tree: node(tree, "ShaderNodeValue").outputs[0]))
    grid.add("below a bump", _displaced(node, noise, lambda tree: _socket(tree, node, _bump_node(image), "Normal")))
    mapped = "ShaderNodeNormalMap", {"Color": _upward}
    grid.add("below a normal map", _displaced(node, noise, lambda tree: _socket(tree, node, mapped, "Normal")))
    for name, got in grid.compare().items():
        found = got.normal if got.cosine > 0 else -got.normal
        covered = got.passes["Normal"].any(axis=1)
        assert covered.sum() >= 32, name
        np.testing.assert_allclose(found[covered], got.passes["Normal"][covered], atol=2e-3 if "map" in name else 2e-4, err_msg=name)
        assert name == "level" or np.ptp(got.normal[:, :2], axis=0).min() > 0.01, name
    assert not grid.warnings


def test_displacement_that_bumps_do_not_show_is_named(grid, node):
    def by_vectors(tree, end):
        made = node(tree, "ShaderNodeVectorDisplacement")
        tree.links.new(made.outputs[0], end.inputs["Displacement"])
        tree.links.new(tree.nodes.new("ShaderNodeBsdfDiffuse").outputs[0], end.inputs["Surface"])

    grid.add("vectors", by_vectors)
    grid.compare()
    assert not grid.flags[0] & sc.NORMAL_MAPPED
    assert [line.split(": ")[1] for line in grid.warnings] == ["its displacement by vectors is left out"]
