"""Colour nodes, ramps and curves, and the conversions between colours, numbers and vectors."""

from __future__ import annotations

import numpy as np

from ....core.surfaces import outlined
from ....core.surfaces import program as ops
from ....core.surfaces.colors import BLEND, HSL_TO_RGB, HSV_TO_RGB, RGB_TO_HSL, RGB_TO_HSV
from ..builder import ONE, ZERO, Constant, Table, Value, scalar
from ..registry import value
from ..tree import NodeInput

_TABLE = 257  # rows of a ramp or curve: Cycles uses 256 steps


def _mixed(node: NodeInput, kind: str, factor: Value, a: Value, b: Value) -> Value:
    if isinstance(factor, Constant) and factor == ZERO and kind not in ("EXCLUSION",):
        return a
    if kind == "MIX":
        return b if factor == ONE else node.emit(ops.MIX, factor, a, b)
    return node.emit(outlined.BLEND, factor, a, b, p=BLEND[kind])


@value("ShaderNodeMix")
def mix(node: NodeInput, output: str) -> Value:
    """Mix, of numbers, vectors and colours."""
    kind = node.node.data_type
    if kind == "RGBA":
        factor, a, b = node["Factor_Float"], node["A_Color"], node["B_Color"]
    elif kind == "VECTOR":
        uniform = node.node.factor_mode == "UNIFORM"
        factor = node["Factor_Float"] if uniform else node["Factor_Vector"]
        a, b = node["A_Vector"], node["B_Vector"]
    else:
        factor, a, b = node["Factor_Float"], node["A_Float"], node["B_Float"]
    if node.node.clamp_factor:
        factor = node.clamp(factor)
    if kind != "RGBA":
        return _mixed(node, "MIX", factor, a, b)
    result = _mixed(node, node.node.blend_type, factor, a, b)
    return node.clamp(result) if node.node.clamp_result else result


@value("ShaderNodeMixRGB")
def mix_rgb(node: NodeInput, output: str) -> Value:
    """The MixRGB node of older files."""
    result = _mixed(node, node.node.blend_type, node.clamp(node[0]), node[1], node[2])
    return node.clamp(result) if node.node.use_clamp else result


def _rows(columns: np.ndarray) -> Table:
    return Table(tuple(tuple(float(x) for x in row) for row in columns))


@value("ShaderNodeValToRGB")
def color_ramp(node: NodeInput, output: str) -> Value:
    """Color Ramp."""
    ramp = node.node.color_ramp
    size = _TABLE - 1
    rows = _rows(np.array([ramp.evaluate(i / (size - 1)) for i in range(size)]))
    interpolate = ramp.interpolation != "CONSTANT"
    read = node.emit(outlined.RAMP, node["Fac"], rows, p=size * 4 + interpolate)
    return node.splat(read, 3) if output == "Alpha" else read


def _curve_range(curves) -> tuple[float, float]:
    """Range of the curves' points on x, at least 0..1 (Cycles: curvemapping_minmax)."""
    xs = [p.location[0] for c in curves for p in c.points]
    return min(0.0, *xs), max(1.0, *xs)


def _curves(node: NodeInput, at: Value, columns: int) -> Value:
    mapping = node.node.mapping
    mapping.update()
    curves = list(mapping.curves)
    low, high = _curve_range(curves)
    size = _TABLE - 1
    steps = low + np.arange(size) / (size - 1) * (high - low)
    if columns == 1:
        values = np.array([mapping.evaluate(curves[0], float(x)) for x in steps])
        table = np.repeat(values[:, None], 4, 1)
    elif len(curves) == 4:  # RGB curves: the combined curve lies below each channel's
        combined = np.array([mapping.evaluate(curves[3], float(x)) for x in steps])
        table = np.array([[*(mapping.evaluate(curves[c], float(x)) for c in range(3)), 1.0] for x in combined])
    else:
        table = np.array([[*(mapping.evaluate(curves[c], float(x)) for c in range(3)), 1.0] for x in steps])
    if (low, high) != (0.0, 1.0):
        at = node.vector("DIVIDE", node.vector("SUBTRACT", at, scalar(low)), scalar(high - low))
    extrapolate = mapping.extend == "EXTRAPOLATED"
    return node.emit(outlined.CURVES, at, _rows(table), p=size * 4 + 2 * extrapolate + 1)


@value("ShaderNodeRGBCurve")
def rgb_curves(node: NodeInput, output: str) -> Value:
    """RGB Curves."""
    color = node["Color"]
    return _mixed(node, "MIX", node["Fac"], color, _curves(node, color, 3))


@value("ShaderNodeVectorCurve")
def vector_curves(node: NodeInput, output: str) -> Value:
    """Vector Curves."""
    vector = node["Vector"]
    return _mixed(node, "MIX", node["Fac"], vector, _curves(node, vector, 3))


@value("ShaderNodeFloatCurve")
def float_curve(node: NodeInput, output: str) -> Value:
    """Float Curve."""
    number = node["Value"]
    return _mixed(node, "MIX", node["Factor"], number, _curves(node, number, 1))


@value("ShaderNodeHueSaturation")
def hue_saturation(node: NodeInput, output: str) -> Value:
    """Hue/Saturation/Value."""
    color = node["Color"]
    hsv = node.emit(outlined.COLOR_MODEL, color, p=RGB_TO_HSV)
    hue = node.math("FRACT", node.math("ADD", node.math("ADD", node.splat(hsv, 0), node["Hue"]), scalar(0.5)))
    saturation = node.clamp(node.math("MULTIPLY", node.splat(hsv, 1), node["Saturation"]))
    brightness = node.math("MULTIPLY", node.splat(hsv, 2), node["Value"])
    changed = node.emit(outlined.COLOR_MODEL, node.pack(hue, saturation, brightness), p=HSV_TO_RGB)
    return node.vector("MAXIMUM", _mixed(node, "MIX", node["Fac"], color, changed), ZERO)


@value("ShaderNodeBrightContrast")
def brightness_contrast(node: NodeInput, output: str) -> Value:
    """Brightness/Contrast."""
    contrast = node["Contrast"]
    offset = node.math("SUBTRACT", node["Bright"], node.math("MULTIPLY", contrast, scalar(0.5)))
    changed = node.vector("MULTIPLY_ADD", node["Color"], node.math("ADD", ONE, contrast), offset)
    return node.vector("MAXIMUM", changed, ZERO)


@value("ShaderNodeGamma")
def gamma(node: NodeInput, output: str) -> Value:
    """Gamma."""
    return node.emit(outlined.GAMMA, node["Color"], node["Gamma"])


@value("ShaderNodeInvert")
def invert(node: NodeInput, output: str) -> Value:
    """Invert Color."""
    color = node["Color"]
    return _mixed(node, "MIX", node["Fac"], color, node.complement(color))


@value("ShaderNodeRGBToBW")
def rgb_to_bw(node: NodeInput, output: str) -> Value:
    """RGB to BW."""
    return node.emit(ops.LUMINANCE, node["Color"])


_TO_MODEL = {"HSV": RGB_TO_HSV, "HSL": RGB_TO_HSL}
_FROM_MODEL = {"HSV": HSV_TO_RGB, "HSL": HSL_TO_RGB}


@value("ShaderNodeSeparateColor")
def separate_color(node: NodeInput, output: str) -> Value:
    """Separate Color."""
    color = node["Color"]
    if node.node.mode in _TO_MODEL:
        color = node.emit(outlined.COLOR_MODEL, color, p=_TO_MODEL[node.node.mode])
    return node.splat(color, ["Red", "Green", "Blue"].index(output))


@value("ShaderNodeCombineColor")
def combine_color(node: NodeInput, output: str) -> Value:
    """Combine Color."""
    packed = node.pack(node["Red"], node["Green"], node["Blue"], ONE)
    mode = node.node.mode
    return node.emit(outlined.COLOR_MODEL, packed, p=_FROM_MODEL[mode]) if mode in _FROM_MODEL else packed


@value("ShaderNodeSeparateRGB", "ShaderNodeSeparateXYZ", "ShaderNodeSeparateHSV")
def separate(node: NodeInput, output: str) -> Value:
    """Separate XYZ, and the RGB and HSV ones of older files."""
    whole = node[0]
    if node.node.bl_idname == "ShaderNodeSeparateHSV":
        whole = node.emit(outlined.COLOR_MODEL, whole, p=RGB_TO_HSV)
    return node.splat(whole, [s.identifier for s in node.node.outputs].index(output))


@value("ShaderNodeCombineRGB", "ShaderNodeCombineXYZ", "ShaderNodeCombineHSV")
def combine(node: NodeInput, output: str) -> Value:
    """Combine XYZ, and the RGB and HSV ones of older files."""
    packed = node.pack(node[0], node[1], node[2], ONE)
    if node.node.bl_idname == "ShaderNodeCombineHSV":
        packed = node.emit(outlined.COLOR_MODEL, packed, p=HSV_TO_RGB)
    return packed
