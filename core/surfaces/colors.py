"""Colour functions of the node trees: models, blend modes (Cycles: kernel/svm/color_util.h, util/color.h)."""

from __future__ import annotations

import numpy as np

from ..jit import inlined, leaf

F = np.float32

# Kinds of `blend`, named as the Mix node's blending modes.
BLEND_KINDS = (
    "MIX", "DARKEN", "MULTIPLY", "BURN", "LIGHTEN", "SCREEN", "DODGE", "ADD", "OVERLAY", "SOFT_LIGHT", "LINEAR_LIGHT",
    "DIFFERENCE", "EXCLUSION", "SUBTRACT", "DIVIDE", "HUE", "SATURATION", "COLOR", "VALUE",
)  # fmt: skip
BLEND = {name: i for i, name in enumerate(BLEND_KINDS)}
(
    _MIX, _DARKEN, _MULTIPLY, _BURN, _LIGHTEN, _SCREEN, _DODGE, _ADD, _OVERLAY, _SOFT, _LINEAR,
    _DIFFERENCE, _EXCLUSION, _SUBTRACT, _DIVIDE, _HUE, _SATURATION, _COLOR, _VALUE,
) = range(len(BLEND_KINDS))  # fmt: skip

# Kinds of `convert`.
RGB_TO_HSV, HSV_TO_RGB, RGB_TO_HSL, HSL_TO_RGB = range(4)


@inlined
def luminance(r, g, b):
    """Rec. 709 luminance, as Cycles reads a colour where a number is wanted."""
    return F(0.2126) * r + F(0.7152) * g + F(0.0722) * b


@leaf
def rgb_to_hsv(r, g, b):
    """Hue 0..1, saturation, value."""
    high, low = max(r, max(g, b)), min(r, min(g, b))
    delta = high - low
    s = delta / high if high != F(0) else F(0)
    if s == F(0):
        return F(0), s, high
    cr, cg, cb = (high - r) / delta, (high - g) / delta, (high - b) / delta
    if r == high:
        h = cb - cg
    elif g == high:
        h = F(2) + cr - cb
    else:
        h = F(4) + cg - cr
    h /= F(6)
    return (h + F(1) if h < F(0) else h), s, high


@leaf
def hsv_to_rgb(h, s, v):
    """Inverse of `rgb_to_hsv`; hue 1 is hue 0."""
    if s == F(0):
        return v, v, v
    h = F(0) if h == F(1) else h * F(6)
    i = np.floor(h)
    f = h - i
    p, q, t = v * (F(1) - s), v * (F(1) - s * f), v * (F(1) - s * (F(1) - f))
    if i == F(0):
        return v, t, p
    if i == F(1):
        return q, v, p
    if i == F(2):
        return p, v, t
    if i == F(3):
        return p, q, v
    if i == F(4):
        return t, p, v
    return v, p, q


@inlined
def _rgb_to_hsl(r, g, b):
    high, low = max(r, max(g, b)), min(r, min(g, b))
    lightness = min(F(1), (high + low) / F(2))
    if high == low:
        return F(0), F(0), lightness
    delta = high - low
    s = delta / (F(2) - high - low) if lightness > F(0.5) else delta / (high + low)
    if high == r:
        h = (g - b) / delta + (F(6) if g < b else F(0))
    elif high == g:
        h = (b - r) / delta + F(2)
    else:
        h = (r - g) / delta + F(4)
    return h / F(6), s, lightness


@inlined
def _unit(x):
    return min(max(x, F(0)), F(1))


@inlined
def _hsl_to_rgb(h, s, lightness):
    chroma = (F(1) - abs(F(2) * lightness - F(1))) * s
    r, g, b = _unit(abs(h * F(6) - F(3)) - F(1)), _unit(F(2) - abs(h * F(6) - F(2))), _unit(F(2) - abs(h * F(6) - F(4)))
    return (r - F(0.5)) * chroma + lightness, (g - F(0.5)) * chroma + lightness, (b - F(0.5)) * chroma + lightness


@leaf
def convert(kind, x, y, z):
    """Between colour models; see the kinds above."""
    if kind == RGB_TO_HSV:
        return rgb_to_hsv(x, y, z)
    if kind == HSV_TO_RGB:
        return hsv_to_rgb(x, y, z)
    if kind == RGB_TO_HSL:
        return _rgb_to_hsl(x, y, z)
    return _hsl_to_rgb(x, y, z)


@inlined
def _blend_channel(kind, t, a, b):
    """The blending modes that treat each channel alone."""
    if kind == _MIX:
        return a + t * (b - a)
    if kind == _DARKEN:
        return a + t * (min(a, b) - a)
    if kind == _MULTIPLY:
        return a + t * (a * b - a)
    if kind == _LIGHTEN:
        return a + t * (max(a, b) - a)
    if kind == _SCREEN:
        return F(1) - (F(1) - t + t * (F(1) - b)) * (F(1) - a)
    if kind == _ADD:
        return a + t * b
    if kind == _SUBTRACT:
        return a - t * b
    if kind == _DIFFERENCE:
        return a + t * (abs(a - b) - a)
    if kind == _EXCLUSION:
        return max(a + t * (b - F(2) * a * b), F(0))
    if kind == _DIVIDE:
        return (F(1) - t) * a + t * a / b if b != F(0) else a
    if kind == _LINEAR:
        return a + t * (F(2) * b - F(1))
    if kind == _SOFT:
        screen = F(1) - (F(1) - b) * (F(1) - a)
        return (F(1) - t) * a + t * ((F(1) - a) * b * a + a * screen)
    if kind == _OVERLAY:
        if a < F(0.5):
            return a * (F(1) - t + F(2) * t * b)
        return F(1) - (F(1) - t + F(2) * t * (F(1) - b)) * (F(1) - a)
    if kind == _DODGE:
        if a == F(0):
            return a
        k = F(1) - t * b
        return F(1) if k <= F(0) else min(a / k, F(1))
    k = F(1) - t + t * b  # BURN
    return F(0) if k <= F(0) else _unit(F(1) - (F(1) - a) / k)


@leaf
def blend(kind, t, ar, ag, ab, br, bg, bb):
    """Colour a mixed with b by the factor t (not clamped); `kind` indexes BLEND_KINDS."""
    if kind < _HUE:
        return _blend_channel(kind, t, ar, br), _blend_channel(kind, t, ag, bg), _blend_channel(kind, t, ab, bb)
    h, s, v = rgb_to_hsv(ar, ag, ab)
    bh, bs, bv = rgb_to_hsv(br, bg, bb)
    if kind == _VALUE:
        return hsv_to_rgb(h, s, (F(1) - t) * v + t * bv)
    if kind == _SATURATION:
        if s == F(0):
            return ar, ag, ab
        return hsv_to_rgb(h, (F(1) - t) * s + t * bs, v)
    if bs == F(0):
        return ar, ag, ab
    r, g, b = hsv_to_rgb(bh, bs if kind == _COLOR else s, v)
    return ar + t * (r - ar), ag + t * (g - ag), ab + t * (b - ab)


@inlined
def gamma(x, exponent):
    """The Gamma node on one channel."""
    if exponent == F(0):
        return F(1)
    return x**exponent if x > F(0) else x


@inlined
def lookup(table, channel, x, interpolate, extrapolate):
    """Column `channel` of a table of equidistant rows, at x in 0..1 (Cycles: rgb_ramp_lookup)."""
    size = table.shape[0]
    last = size - 1
    if extrapolate and x < F(0):
        return table[0, channel] + (table[0, channel] - table[1, channel]) * -x * F(last)
    if extrapolate and x > F(1):
        return table[last, channel] + (table[last, channel] - table[last - 1, channel]) * (x - F(1)) * F(last)
    x = min(max(x, F(0)), F(1)) * F(last)
    i = min(max(np.int32(x), 0), last)
    value = table[i, channel]
    t = x - F(i)
    if interpolate and t > F(0) and i < last:
        value = (F(1) - t) * value + t * table[i + 1, channel]
    return value
