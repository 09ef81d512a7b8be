"""Scalar and vector functions of the node trees, with Cycles' conventions for the undefined cases.

Division by zero gives 0, roots and logarithms of negative numbers give 0 (Cycles: util/math_base.h,
kernel/svm/math_util.h).
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, leaf

F = np.float32

# Kinds of `scalar_math`, named as the Math node's operations.
SCALAR_KINDS = (
    "ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "MULTIPLY_ADD", "POWER", "LOGARITHM", "SQRT", "INVERSE_SQRT", "ABSOLUTE",
    "EXPONENT", "MINIMUM", "MAXIMUM", "LESS_THAN", "GREATER_THAN", "SIGN", "COMPARE", "SMOOTH_MIN", "SMOOTH_MAX",
    "ROUND", "FLOOR", "CEIL", "TRUNC", "FRACT", "MODULO", "FLOORED_MODULO", "WRAP", "SNAP", "PINGPONG",
    "SINE", "COSINE", "TANGENT", "ARCSINE", "ARCCOSINE", "ARCTANGENT", "ARCTAN2", "SINH", "COSH", "TANH",
    "RADIANS", "DEGREES",
)  # fmt: skip
SCALAR = {name: i for i, name in enumerate(SCALAR_KINDS)}

# Kinds of `vector_math`, named as the Vector Math node's operations.
VECTOR_KINDS = (
    "ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "MULTIPLY_ADD", "CROSS_PRODUCT", "PROJECT", "REFLECT", "REFRACT", "FACEFORWARD",
    "DOT_PRODUCT", "DISTANCE", "LENGTH", "NORMALIZE", "ABSOLUTE", "POWER", "SIGN", "MINIMUM", "MAXIMUM", "FLOOR", "CEIL",
    "FRACTION", "MODULO", "WRAP", "SNAP", "SINE", "COSINE", "TANGENT",
)  # fmt: skip
VECTOR = {name: i for i, name in enumerate(VECTOR_KINDS)}

_S = SCALAR
_ADD, _SUBTRACT, _MULTIPLY, _DIVIDE, _MULTIPLY_ADD = (_S[k] for k in ("ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "MULTIPLY_ADD"))
_POWER, _LOGARITHM, _SQRT, _INVERSE_SQRT, _ABSOLUTE = (_S[k] for k in ("POWER", "LOGARITHM", "SQRT", "INVERSE_SQRT", "ABSOLUTE"))
_EXPONENT, _MINIMUM, _MAXIMUM, _LESS, _GREATER = (_S[k] for k in ("EXPONENT", "MINIMUM", "MAXIMUM", "LESS_THAN", "GREATER_THAN"))
_SIGN, _COMPARE, _SMOOTH_MIN, _SMOOTH_MAX, _ROUND = (_S[k] for k in ("SIGN", "COMPARE", "SMOOTH_MIN", "SMOOTH_MAX", "ROUND"))
_FLOOR, _CEIL, _TRUNC, _FRACT, _MODULO = (_S[k] for k in ("FLOOR", "CEIL", "TRUNC", "FRACT", "MODULO"))
_FLOORED_MODULO, _WRAP, _SNAP, _PINGPONG, _SINE = (_S[k] for k in ("FLOORED_MODULO", "WRAP", "SNAP", "PINGPONG", "SINE"))
_COSINE, _TANGENT, _ARCSINE, _ARCCOSINE = (_S[k] for k in ("COSINE", "TANGENT", "ARCSINE", "ARCCOSINE"))
_ARCTANGENT, _ARCTAN2, _SINH, _COSH, _TANH = (_S[k] for k in ("ARCTANGENT", "ARCTAN2", "SINH", "COSH", "TANH"))
_RADIANS = _S["RADIANS"]

_V = VECTOR
_V_CROSS, _V_PROJECT, _V_REFLECT, _V_REFRACT = (_V[k] for k in ("CROSS_PRODUCT", "PROJECT", "REFLECT", "REFRACT"))
_V_FACEFORWARD, _V_DOT, _V_DISTANCE, _V_LENGTH = (_V[k] for k in ("FACEFORWARD", "DOT_PRODUCT", "DISTANCE", "LENGTH"))
_V_NORMALIZE = _V["NORMALIZE"]
# The componentwise kinds as scalar kinds, -1 for the others.
_AS_SCALAR = np.array([_S.get({"FRACTION": "FRACT"}.get(k, k), -1) for k in VECTOR_KINDS], np.int32)


@inlined
def safe_divide(a, b):
    """a / b, 0 where b is 0."""
    return a / b if b != F(0) else F(0)


@inlined
def sign(x):
    """-1, 0 or 1."""
    return F(0) if x == F(0) else F(-1) if x < F(0) else F(1)


@inlined
def fraction(x):
    """x - floor(x)."""
    return x - np.floor(x)


@inlined
def _smooth_minimum(a, b, k):
    if k == F(0):
        return min(a, b)
    h = max(k - abs(a - b), F(0)) / k
    return min(a, b) - h * h * h * k * F(1 / 6)


@leaf(fast=False)
def power(a, b):
    """a ** b; 0 for a negative base with a fractional exponent."""
    if a < F(0) and b != np.floor(b):
        return F(0)
    return a**b


@leaf(fast=False)
def scalar_math(kind, a, b, c):
    """The Math node: `kind` indexes SCALAR_KINDS."""
    if kind == _ADD:
        return a + b
    if kind == _SUBTRACT:
        return a - b
    if kind == _MULTIPLY:
        return a * b
    if kind == _DIVIDE:
        return safe_divide(a, b)
    if kind == _MULTIPLY_ADD:
        return a * b + c
    if kind == _POWER:
        return power(a, b)
    if kind == _LOGARITHM:
        return safe_divide(np.log(a), np.log(b)) if a > F(0) and b > F(0) else F(0)
    if kind == _SQRT:
        return np.sqrt(max(a, F(0)))
    if kind == _INVERSE_SQRT:
        return F(1) / np.sqrt(a) if a > F(0) else F(0)
    if kind == _ABSOLUTE:
        return abs(a)
    if kind == _EXPONENT:
        return np.exp(a)
    if kind == _MINIMUM:
        return min(a, b)
    if kind == _MAXIMUM:
        return max(a, b)
    if kind == _LESS:
        return F(1) if a < b else F(0)
    if kind == _GREATER:
        return F(1) if a > b else F(0)
    if kind == _SIGN:
        return sign(a)
    if kind == _COMPARE:
        return F(1) if a == b or abs(a - b) <= max(c, F(1.1920929e-7)) else F(0)
    if kind == _SMOOTH_MIN:
        return _smooth_minimum(a, b, c)
    if kind == _SMOOTH_MAX:
        return -_smooth_minimum(-a, -b, c)
    if kind == _ROUND:
        return np.floor(a + F(0.5))
    if kind == _FLOOR:
        return np.floor(a)
    if kind == _CEIL:
        return np.ceil(a)
    if kind == _TRUNC:
        return np.floor(a) if a >= F(0) else np.ceil(a)
    if kind == _FRACT:
        return fraction(a)
    if kind == _MODULO:
        return np.fmod(a, b) if b != F(0) else F(0)
    if kind == _FLOORED_MODULO:
        return a - np.floor(a / b) * b if b != F(0) else F(0)
    if kind == _WRAP:
        return a - (b - c) * np.floor((a - c) / (b - c)) if b != c else c
    if kind == _SNAP:
        return np.floor(safe_divide(a, b)) * b
    if kind == _PINGPONG:
        return abs(fraction((a - b) / (b * F(2))) * b * F(2) - b) if b != F(0) else F(0)
    if kind == _SINE:
        return np.sin(a)
    if kind == _COSINE:
        return np.cos(a)
    if kind == _TANGENT:
        return np.tan(a)
    if kind == _ARCSINE:
        return np.arcsin(min(max(a, F(-1)), F(1)))
    if kind == _ARCCOSINE:
        return np.arccos(min(max(a, F(-1)), F(1)))
    if kind == _ARCTANGENT:
        return np.arctan(a)
    if kind == _ARCTAN2:
        return np.arctan2(a, b) if a != F(0) or b != F(0) else F(0)
    if kind == _SINH:
        return np.sinh(a)
    if kind == _COSH:
        return np.cosh(a)
    if kind == _TANH:
        return np.tanh(a)
    if kind == _RADIANS:
        return a * F(np.pi / 180)
    return a * F(180 / np.pi)


@inlined
def normalized(x, y, z):
    """The unit vector; zeros stay zeros."""
    length = np.sqrt(x * x + y * y + z * z)
    if length == F(0):
        return x, y, z
    k = F(1) / length
    return x * k, y * k, z * k


@leaf(fast=False)
def vector_math(kind, ax, ay, az, bx, by, bz, cx, cy, cz):
    """The Vector Math node: `kind` indexes VECTOR_KINDS; a scalar result fills all three components."""
    scalar = _AS_SCALAR[kind]
    if scalar >= 0:
        return scalar_math(scalar, ax, bx, cx), scalar_math(scalar, ay, by, cy), scalar_math(scalar, az, bz, cz)
    if kind == _V_CROSS:
        return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    if kind == _V_PROJECT:
        k = safe_divide(ax * bx + ay * by + az * bz, bx * bx + by * by + bz * bz)
        return k * bx, k * by, k * bz
    if kind == _V_REFLECT:
        nx, ny, nz = normalized(bx, by, bz)
        k = F(2) * (ax * nx + ay * ny + az * nz)
        return ax - k * nx, ay - k * ny, az - k * nz
    if kind == _V_REFRACT:
        nx, ny, nz = normalized(bx, by, bz)
        cosine = ax * nx + ay * ny + az * nz
        k = F(1) - cx * cx * (F(1) - cosine * cosine)
        if k < F(0):
            return F(0), F(0), F(0)
        t = cx * cosine + np.sqrt(k)
        return cx * ax - t * nx, cx * ay - t * ny, cx * az - t * nz
    if kind == _V_FACEFORWARD:
        s = F(1) if cx * bx + cy * by + cz * bz < F(0) else F(-1)
        return s * ax, s * ay, s * az
    if kind == _V_DOT:
        s = ax * bx + ay * by + az * bz
    elif kind == _V_DISTANCE:
        s = np.sqrt((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2)
    elif kind == _V_LENGTH:
        s = np.sqrt(ax * ax + ay * ay + az * az)
    else:
        return normalized(ax, ay, az)
    return s, s, s


@leaf
def rotate_euler(x, y, z, rx, ry, rz, inverse):
    """(x, y, z) turned by the XYZ Euler angles (radians), or back again."""
    sx, cx, sy, cy, sz, cz = np.sin(rx), np.cos(rx), np.sin(ry), np.cos(ry), np.sin(rz), np.cos(rz)
    m00, m10, m20 = cy * cz, cy * sz, -sy
    m01, m11, m21 = sy * sx * cz - cx * sz, sy * sx * sz + cx * cz, cy * sx
    m02, m12, m22 = sy * cx * cz + sx * sz, sy * cx * sz - sx * cz, cy * cx
    if inverse:
        return m00 * x + m10 * y + m20 * z, m01 * x + m11 * y + m21 * z, m02 * x + m12 * y + m22 * z
    return m00 * x + m01 * y + m02 * z, m10 * x + m11 * y + m12 * z, m20 * x + m21 * y + m22 * z


@leaf
def rotate_axis(x, y, z, ux, uy, uz, angle):
    """(x, y, z) turned about the axis (ux, uy, uz), of any length, by `angle` (Rodrigues)."""
    ux, uy, uz = normalized(ux, uy, uz)
    s, c = np.sin(angle), np.cos(angle)
    k = (F(1) - c) * (ux * x + uy * y + uz * z)
    if ux == F(0) and uy == F(0) and uz == F(0):
        return x, y, z
    return c * x + s * (uy * z - uz * y) + k * ux, c * y + s * (uz * x - ux * z) + k * uy, c * z + s * (ux * y - uy * x) + k * uz
