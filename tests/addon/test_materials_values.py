"""Value nodes against Cycles: each plane emits the output of one node."""

import bpy
import numpy as np
import pytest

from lumigate.core.surfaces.arithmetic import SCALAR_KINDS, VECTOR_KINDS
from lumigate.core.surfaces.colors import BLEND_KINDS


def _uv(tree):
    return _new(tree, "ShaderNodeUVMap", uv_map="UVMap").outputs[0]


def _uv_x(tree):
    separate = tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(_uv(tree), separate.inputs[0])
    return separate.outputs[0]


def _tint(tree):
    return _new(tree, "ShaderNodeVertexColor", layer_name="Tint").outputs[0]


def _weight(tree):
    return _new(tree, "ShaderNodeAttribute", attribute_name="Weight").outputs["Fac"]


def _new(tree, node_type, **settings):
    node = tree.nodes.new(node_type)
    for key, value in settings.items():
        setattr(node, key, value)
    return node


def check(grid, **tolerance):
    for name, got in grid.compare().items():
        # Emission is never negative here; Cycles' is.
        expected = np.maximum(got.passes["Emit"], 0)
        assert np.isfinite(got.emission).all(), name
        np.testing.assert_allclose(got.emission, expected, **({"rtol": 1e-4, "atol": 2e-5} | tolerance), err_msg=name)


def test_inputs(grid):
    grid.emit("value", "ShaderNodeValue")
    grid.emit("rgb", "ShaderNodeRGB")
    for name in ("UVMap", "Second", ""):
        grid.emit(f"uv {name}", "ShaderNodeUVMap", uv_map=name)
    for name in ("UV", "Object", "Normal"):
        grid.emit(f"coordinate {name}", "ShaderNodeTexCoord", output=name)
    for name in ("Tint", "Weight", "UVMap"):
        for output in ("Color", "Vector", "Fac", "Alpha"):
            grid.emit(f"attribute {name} {output}", "ShaderNodeAttribute", output=output, attribute_name=name)
    grid.emit("object attribute", "ShaderNodeAttribute", output="Fac", attribute_name="level", attribute_type="OBJECT")
    for output in ("Color", "Alpha"):
        grid.emit(f"color attribute {output}", "ShaderNodeVertexColor", output=output, layer_name="Tint")
    for output in ("Position", "Normal", "True Normal", "Backfacing"):
        grid.emit(f"geometry {output}", "ShaderNodeNewGeometry", output=output)
    for output in ("Location", "Color", "Alpha", "Object Index"):
        grid.emit(f"object {output}", "ShaderNodeObjectInfo", output=output)
    check(grid)


def test_view_dependent_inputs(grid, node):
    for angle in (0.0, 0.7, 1.2, 2.5):
        for node_type, outputs in (("ShaderNodeFresnel", ("Factor",)), ("ShaderNodeLayerWeight", ("Fresnel", "Facing"))):
            for output in outputs:
                for setting in (0.3, 0.5, 0.8, 1.6):
                    inputs = {0: setting}

                    def build(tree, end, node_type=node_type, output=output, inputs=inputs):
                        made = node(tree, node_type, inputs=inputs)
                        emission = tree.nodes.new("ShaderNodeEmission")
                        tree.links.new(made.outputs[output if output in made.outputs else 0], emission.inputs[0])
                        tree.links.new(emission.outputs[0], end.inputs[0])

                    if setting <= 1 or node_type == "ShaderNodeFresnel":
                        grid.add(f"{node_type} {output} {setting} {angle}", build, angle)
    middle = slice(32, 40)
    for name, got in grid.compare().items():
        np.testing.assert_allclose(got.emission[middle], got.passes["Emit"][middle], atol=1e-4, err_msg=name)


def test_math(grid):
    for kind in SCALAR_KINDS:
        for b in (0.7, 0.0) if kind not in ("SMOOTH_MIN", "SMOOTH_MAX") else (0.7,):
            inputs = {0: _uv_x, 1: b, 2: 0.3}
            grid.emit(f"{kind} {b}", "ShaderNodeMath", operation=kind, inputs=inputs)
    grid.emit("clamped", "ShaderNodeMath", operation="MULTIPLY", use_clamp=True, inputs={0: _uv_x, 1: 3.0})
    check(grid, atol=1e-4)


def test_vector_math(grid):
    for kind in (*VECTOR_KINDS, "SCALE"):
        inputs = {0: _uv, 1: (0.4, -0.3, 0.8), 2: (0.2, 0.1, 0.9), "Scale": 1.3}
        if kind == "MULTIPLY_ADD":
            inputs[0] = _tint
        output = 1 if kind in ("DOT_PRODUCT", "DISTANCE", "LENGTH") else 0
        grid.emit(kind, "ShaderNodeVectorMath", output=output, operation=kind, inputs=inputs)
    check(grid, atol=1e-4)


def test_mix(grid):
    for kind in BLEND_KINDS:
        for factor in (0.35, 1.0):
            inputs = {"Factor_Float": factor, "A_Color": _tint, "B_Color": (0.7, 0.2, 0.45, 1)}
            grid.emit(f"{kind} {factor}", "ShaderNodeMix", output="Result_Color", data_type="RGBA", blend_type=kind, inputs=inputs)
            inputs = {0: factor, 1: (0.1, 0.8, 0.45, 1), 2: _tint}
            grid.emit(f"legacy {kind} {factor}", "ShaderNodeMixRGB", blend_type=kind, inputs=inputs)
    for clamp_factor in (False, True):
        for clamp_result in (False, True):
            inputs = {"Factor_Float": _uv_x, "A_Color": (0.9, 0.2, 0.1, 1), "B_Color": (0.1, 1.8, 0.5, 1)}
            settings = {"clamp_factor": clamp_factor, "clamp_result": clamp_result, "data_type": "RGBA"}
            grid.emit(f"color clamped {clamp_factor} {clamp_result}", "ShaderNodeMix", output="Result_Color", inputs=inputs, **settings)
    grid.emit("float", "ShaderNodeMix", output="Result_Float", inputs={"Factor_Float": _weight, "A_Float": 0.2, "B_Float": 3.0})
    uniform = {"Factor_Float": _weight, "A_Vector": (1, 2, 3), "B_Vector": _uv}
    grid.emit("vector", "ShaderNodeMix", output="Result_Vector", data_type="VECTOR", inputs=uniform)
    varying = {"Factor_Vector": _uv, "A_Vector": (1, 2, 3), "B_Vector": (0.1, 0.5, 0.2)}
    grid.emit("vector by vector", "ShaderNodeMix", output="Result_Vector", data_type="VECTOR", factor_mode="NON_UNIFORM", inputs=varying)
    check(grid)


def test_color_nodes(grid):
    for fac in (1.0, 0.4):
        inputs = {"Hue": 0.3, "Saturation": 1.4, "Value": 0.8, "Fac": fac, "Color": _tint}
        grid.emit(f"hsv {fac}", "ShaderNodeHueSaturation", inputs=inputs)
        grid.emit(f"invert {fac}", "ShaderNodeInvert", inputs={"Fac": fac, "Color": _tint})
    grid.emit("bright", "ShaderNodeBrightContrast", inputs={0: _tint, 1: 0.2, 2: 0.5})
    for gamma in (2.2, 0.0):
        grid.emit(f"gamma {gamma}", "ShaderNodeGamma", inputs={0: _tint, 1: gamma})
    grid.emit("bw", "ShaderNodeRGBToBW", inputs={0: _tint})
    for mode in ("RGB", "HSV", "HSL"):
        for k in range(3):
            grid.emit(f"separate {mode} {k}", "ShaderNodeSeparateColor", output=k, mode=mode, inputs={0: _tint})
        grid.emit(f"combine {mode}", "ShaderNodeCombineColor", mode=mode, inputs={0: _weight, 1: 0.6, 2: 0.7})
    grid.emit("combine xyz", "ShaderNodeCombineXYZ", inputs={0: _weight, 1: 0.6, 2: 0.7})
    check(grid, atol=2e-4, rtol=1e-3)


def test_spectra(grid):
    for kelvin in (700, 1000, 3000, 6500, 9000, 15000):
        grid.emit(f"blackbody {kelvin}", "ShaderNodeBlackbody", inputs={0: kelvin})
    for length in (300, 450.0, 537.0, 650.0):
        grid.emit(f"wavelength {length}", "ShaderNodeWavelength", inputs={0: length})
    check(grid, atol=5e-3, rtol=5e-3)


def test_ramps_and_curves(grid):
    def ramp(interpolation, mode="RGB"):
        def build(tree, end):
            made = _new(tree, "ShaderNodeValToRGB")
            made.color_ramp.color_mode = mode
            if mode == "RGB":
                made.color_ramp.interpolation = interpolation
            first, last = made.color_ramp.elements
            first.position, first.color = 0.2, (0.9, 0.1, 0.3, 1)
            last.position, last.color = 0.8, (0.2, 0.4, 1.5, 0.5)
            made.color_ramp.elements.new(0.45).color = (0.1, 0.8, 0.2, 0.2)
            tree.links.new(_uv_x(tree), made.inputs[0])
            emission = tree.nodes.new("ShaderNodeEmission")
            tree.links.new(made.outputs[0], emission.inputs[0])
            tree.links.new(emission.outputs[0], end.inputs[0])

        return build

    for interpolation in ("LINEAR", "EASE", "CONSTANT", "CARDINAL", "B_SPLINE"):
        grid.add(f"ramp {interpolation}", ramp(interpolation))
    grid.add("ramp HSV", ramp("", "HSV"))
    for node_type, source, key in (
        ("ShaderNodeRGBCurve", _tint, "Color"),
        ("ShaderNodeVectorCurve", _uv, "Vector"),
        ("ShaderNodeFloatCurve", _uv_x, "Value"),
    ):
        for extend in ("HORIZONTAL", "EXTRAPOLATED"):

            def build(tree, end, node_type=node_type, source=source, key=key, extend=extend):
                made = _new(tree, node_type)
                made.mapping.extend = extend
                for k, curve in enumerate(made.mapping.curves):
                    curve.points[0].location = (curve.points[0].location[0], 0.1 + 0.05 * k)
                    curve.points.new(0.4, 0.7)
                made.mapping.update()
                made.inputs[0].default_value = 0.8
                tree.links.new(source(tree), made.inputs[key])
                emission = tree.nodes.new("ShaderNodeEmission")
                tree.links.new(made.outputs[0], emission.inputs[0])
                tree.links.new(emission.outputs[0], end.inputs[0])

            grid.add(f"{node_type} {extend}", build)
    check(grid, atol=3e-3)


def test_vector_nodes(grid):
    for kind in ("POINT", "TEXTURE", "VECTOR", "NORMAL"):
        inputs = {"Vector": _uv, "Rotation": (0.3, -0.5, 0.9), "Scale": (2, 0.5, 1.5)}
        if kind in ("POINT", "TEXTURE"):
            inputs["Location"] = (0.1, 0.4, -0.3)
        grid.emit(f"mapping {kind}", "ShaderNodeMapping", vector_type=kind, inputs=inputs)
        grid.emit(f"varying mapping {kind}", "ShaderNodeMapping", vector_type=kind, inputs=inputs | {"Rotation": _tint})
        grid.emit(f"flat mapping {kind}", "ShaderNodeMapping", vector_type=kind, inputs=inputs | {"Scale": (2, 0, 1)})
    for kind in ("AXIS_ANGLE", "X_AXIS", "Y_AXIS", "Z_AXIS", "EULER_XYZ"):
        for invert in (False, True):
            inputs = {"Vector": _tint, "Center": (0.2, 0.1, 0.3), "Axis": (0.3, 0.5, 1), "Angle": 0.8, "Rotation": (0.3, 0.2, 1)}
            grid.emit(f"rotate {kind} {invert}", "ShaderNodeVectorRotate", rotation_type=kind, invert=invert, inputs=inputs)
    for kind in ("LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP"):
        for clamp in (False, True):
            floats = {"Value": _uv_x, "From Min": 0.2, "From Max": 0.9, "To Min": 0.3, "To Max": 2.0, "Steps": 3.0}
            grid.emit(f"range {kind} {clamp}", "ShaderNodeMapRange", interpolation_type=kind, clamp=clamp, inputs=floats)
            swapped = floats | {"From Min": 0.9, "From Max": 0.2, "To Min": 2.0, "To Max": 0.3}
            grid.emit(f"swapped range {kind} {clamp}", "ShaderNodeMapRange", interpolation_type=kind, clamp=clamp, inputs=swapped)
            vectors = {"Vector": _uv, "From_Max_FLOAT3": (0.5, 2, 1), "To_Max_FLOAT3": (1, 3, 0.2)}
            settings = {"data_type": "FLOAT_VECTOR", "interpolation_type": kind, "clamp": clamp}
            grid.emit(f"vector range {kind} {clamp}", "ShaderNodeMapRange", output="Vector", inputs=vectors, **settings)
    for kind in ("MINMAX", "RANGE"):
        grid.emit(f"clamp {kind}", "ShaderNodeClamp", clamp_type=kind, inputs={0: _uv_x, 1: 0.8, 2: 0.3})
    for output in (0, 1):
        grid.emit(f"normal {output}", "ShaderNodeNormal", output=output, inputs={0: _tint})
    check(grid, atol=1e-4)


@pytest.mark.parametrize("how", ["group", "nested", "muted", "reroute", "muted link", "unlinked group input"])
def test_tree_structure(grid, how):
    """Groups, muting and reroutes lead to the same value as Cycles' own flattening."""

    def build(tree, end):
        emission = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(emission.outputs[0], end.inputs[0])
        if how in ("group", "nested", "unlinked group input"):
            group = _group(how == "nested")
            node = tree.nodes.new("ShaderNodeGroup")
            node.node_tree = group
            if how == "unlinked group input":
                node.inputs[0].default_value = (0.3, 0.9, 0.2, 1)
            else:
                tree.links.new(_tint(tree), node.inputs[0])
            tree.links.new(node.outputs[0], emission.inputs[0])
        elif how == "reroute":
            node = tree.nodes.new("NodeReroute")
            tree.links.new(_tint(tree), node.inputs[0])
            tree.links.new(node.outputs[0], emission.inputs[0])
        else:
            node = _new(tree, "ShaderNodeInvert", mute=how == "muted")
            tree.links.new(_tint(tree), node.inputs["Color"])
            link = tree.links.new(node.outputs[0], emission.inputs[0])
            link.is_muted = how == "muted link"

    grid.add("it", build)
    check(grid)


def _group(nested):
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("In", in_out="INPUT", socket_type="NodeSocketColor")
    group.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketColor")
    begin, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    if nested:
        middle = group.nodes.new("ShaderNodeGroup")
        middle.node_tree = _group(False)
    else:
        middle = group.nodes.new("ShaderNodeGamma")
        middle.inputs["Gamma"].default_value = 1.7
    group.links.new(begin.outputs[0], middle.inputs[0])
    group.links.new(middle.outputs[0], end.inputs[0])
    return group


def _passed_through(kind, give, ask, into="NodeSocketColor", value=None):
    """A group whose one input, of some type and value, `ask(tree, socket)` reads; `give(tree)` feeds it."""

    def build(tree, end):
        group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
        group.interface.new_socket("In", in_out="INPUT", socket_type=kind)
        group.interface.new_socket("Out", in_out="OUTPUT", socket_type=into)
        begin, inner = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
        group.links.new(ask(group, begin.outputs[0]), inner.inputs[0])
        used, emission = _new(tree, "ShaderNodeGroup", node_tree=group), tree.nodes.new("ShaderNodeEmission")
        if value is not None:
            used.inputs[0].default_value = value
        if give is not None:
            tree.links.new(give(tree), used.inputs[0])
        tree.links.new(used.outputs[0], emission.inputs[0])
        tree.links.new(emission.outputs[0], end.inputs[0])

    return build


def _as_it_is(tree, socket):
    return socket


def _checked(tree, socket):
    """A texture at a place."""
    node = _new(tree, "ShaderNodeTexChecker")
    node.inputs["Scale"].default_value = 3.1
    tree.links.new(socket, node.inputs["Vector"])
    return node.outputs[0]


def _scaled(tree):
    node = _new(tree, "ShaderNodeMath", operation="MULTIPLY")
    node.inputs[1].default_value = 2.7
    tree.links.new(_uv_x(tree), node.inputs[0])
    return node.outputs[0]


def test_sockets_of_groups_convert_what_passes_them(grid):
    grid.add("colour to number", _passed_through("NodeSocketFloat", _tint, _as_it_is))
    grid.add("vector to number", _passed_through("NodeSocketFloat", _uv, _as_it_is))
    grid.add("number to whole number", _passed_through("NodeSocketInt", _scaled, _as_it_is))
    grid.add("number to truth", _passed_through("NodeSocketBool", _scaled, _as_it_is))
    grid.add("colour to number on its way out", _passed_through("NodeSocketColor", _tint, _as_it_is, into="NodeSocketFloat"))
    check(grid)


def test_what_nothing_feeds_leaves_textures_their_own_coordinates(grid):
    """A number on a group's socket is not where a texture is read."""
    grid.add("vector", _passed_through("NodeSocketVector", None, _checked, value=(0.2, 0.3, 0.1)))
    grid.add("number", _passed_through("NodeSocketFloat", None, _checked, value=0.4))
    grid.add("colour", _passed_through("NodeSocketColor", None, _checked, value=(0.4, 0.2, 0.1, 1)))

    def mapped(tree, socket):
        node = tree.nodes.new("ShaderNodeMapping")
        tree.links.new(socket, node.inputs["Vector"])
        return _checked(tree, node.outputs[0])

    grid.add("vector that is moved", _passed_through("NodeSocketVector", None, mapped, value=(0.2, 0.3, 0.1)))

    def nested(tree, socket):
        inner = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
        inner.interface.new_socket("In", in_out="INPUT", socket_type="NodeSocketVector")
        inner.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketColor")
        begin, end = inner.nodes.new("NodeGroupInput"), inner.nodes.new("NodeGroupOutput")
        inner.links.new(_checked(inner, begin.outputs[0]), end.inputs[0])
        node = _new(tree, "ShaderNodeGroup", node_tree=inner)
        tree.links.new(socket, node.inputs[0])
        return node.outputs[0]

    grid.add("vector of the group within", _passed_through("NodeSocketVector", None, nested, value=(0.2, 0.3, 0.1)))
    grid.add("number of the group within", _passed_through("NodeSocketFloat", None, nested, value=0.4))
    check(grid)


def test_muted_nodes_and_ends_without_a_link(grid):
    def emitting(make):
        def build(tree, end):
            emission = tree.nodes.new("ShaderNodeEmission")
            tree.links.new(make(tree), emission.inputs[0])
            tree.links.new(emission.outputs[0], end.inputs[0])

        return build

    def muted(node_type, feed=None, output=0, **settings):
        def make(tree):
            node = _new(tree, node_type, **settings)
            if feed is not None:
                tree.links.new(feed(tree), next(s for s in node.inputs if s.enabled and s.type in ("VECTOR", "RGBA", "VALUE")))
            node.mute = True
            return node.outputs[output]

        return make

    grid.add("unlinked", emitting(muted("ShaderNodeGamma")))
    grid.add("linked", emitting(muted("ShaderNodeGamma", _tint)))
    grid.add("to a number", emitting(muted("ShaderNodeMath", _tint)))
    grid.add("two outputs", emitting(muted("ShaderNodeSeparateXYZ", _uv, output=1)))
    grid.add("without an input", emitting(muted("ShaderNodeTexMagic")))
    grid.add("reroute", emitting(lambda tree: tree.nodes.new("NodeReroute").outputs[0]))
    grid.add("moved texture", emitting(lambda tree: _checked(tree, muted("ShaderNodeMapping")(tree))))
    group = bpy.data.node_groups.new("Without", "ShaderNodeTree")
    group.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketColor")
    grid.add("group without an output", emitting(lambda tree: _new(tree, "ShaderNodeGroup", node_tree=group).outputs[0]))
    check(grid)


def test_what_eevee_alone_knows_feeds_nothing(grid):
    grid.add("colour", lambda tree, end: _linked(tree, "ShaderNodeShaderToRGB", "ShaderNodeEmission", end))
    grid.add("shader", lambda tree, end: tree.links.new(tree.nodes.new("ShaderNodeEeveeSpecular").outputs[0], end.inputs[0]))
    found = grid.compare()
    for name, got in found.items():
        np.testing.assert_allclose(got.emission, got.passes["Emit"], atol=1e-6, err_msg=name)
        assert not got.diffuse.any()
    assert (found["colour"].emission == 1).all()
    assert len([line for line in grid.warnings if "EEVEE alone knows it" in line]) == 2


def _linked(tree, first, second, end):
    a, b = tree.nodes.new(first), tree.nodes.new(second)
    tree.links.new(a.outputs[0], b.inputs[0])
    tree.links.new(b.outputs[0], end.inputs[0])
