"""Normal maps against Cycles' Normal pass."""

import numpy as np

from lumigate.core import scene as sc


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


def test_bump_is_left_out_with_a_warning(grid, node):
    grid.add("it", _diffuse_with("ShaderNodeBump", node, inputs={"Height": _tint}))
    np.testing.assert_allclose(grid.compare()["it"].normal, np.tile((0, 0, 1), (64, 1)), atol=1e-6)
    assert len(grid.warnings) == 1 and "bump" in grid.warnings[0]


def test_linked_but_plain_normal(grid):
    def geometry(tree, end):
        made, shader = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeBsdfDiffuse")
        tree.links.new(made.outputs["Normal"], shader.inputs["Normal"])
        tree.links.new(shader.outputs[0], end.inputs[0])

    grid.add("plain", geometry)
    np.testing.assert_allclose(grid.compare()["plain"].normal, np.tile((0, 0, 1), (64, 1)), atol=1e-6)
