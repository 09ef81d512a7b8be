"""The rarer instructions of material programs, called by address.

A kernel that calls `program.evaluate` contains a copy of it.  What many scenes never use (arithmetic,
colour models, procedural patterns) is therefore compiled apart, when the first program needs it, and
reached through `MaterialTables.functions`.
"""

from __future__ import annotations

import functools

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..jit import c_function, inlined
from . import arithmetic, bumps, colors, noise, procedural, textures
from .voronoi import FEATURES, METRICS, voronoi

F = np.float32

FIRST = 64
# -- arithmetic and colours --
(
    MATH,  # scalar function p of a.x, b.x, c.x (arithmetic.SCALAR)
    VECTOR_MATH,  # vector function p of a, b, c (arithmetic.VECTOR)
    ROTATE_EULER,  # a turned by the angles b, backwards if p
    ROTATE_AXIS,  # a turned about b by c.x
    BLEND,  # colours b and c by the factor a.x in mode p (colors.BLEND)
    COLOR_MODEL,  # a from one colour model to another, p of colors.convert
    GAMMA,  # a to the power b.x
    RAMP,  # table of rows from b at a.x; p = 4 size + 2 extrapolate + interpolate
    CURVES,  # x, y, z of that table at a.x, a.y, a.z
    PROJECT,  # image coordinates of the direction a - 1/2: p 0 sphere, 1 tube
    # -- bumps (see `bumps`) --
    BUMP_STEP,  # steps (u, v) of length c.x (m) along the first tangent in x, y, along the second in z, w; a, b: edges of the triangle, c.y: its side
    BUMP_GRADIENT,  # of a height that rises by c.x and c.y over steps of length c.z along these tangents; a, b: edges of the triangle, c.w: its side
    BUMP_NORMAL,  # normal a, bumped by the gradient b of the height over a face of normal c; strength in b.w
) = range(FIRST, FIRST + 13)
# -- procedural patterns --
FIRST_PATTERN = 96
(
    CHECKER,  # colours b and c by the cell of a; 1 or 0 in w
    GRADIENT,  # kind p of procedural.GRADIENT_KINDS at a
    WHITE_NOISE,  # in p dimensions at (a.xyz, b.x): colour, value in w
    NOISE,  # at a.xyzw, b (detail, roughness, lacunarity, offset), c (gain, distortion); p of `noise_parameter`
    WAVE,  # at a, b (distortion, detail, its scale, its roughness), c.x phase; p = rings + 2 direction + 8 profile
    MAGIC,  # at a, b (scale, distortion), depth p: colour
    BRICK,  # at a, b (mortar, its smoothness, bias, width), c (height, offset, squash), p = offset + 256 squash frequency: tint, mortar
) = range(FIRST_PATTERN, FIRST_PATTERN + 7)
# -- cells, apart because they are as much code as all other patterns --
FIRST_CELLS = 128
VORONOI = FIRST_CELLS  # at a.xyzw, b (detail, roughness, lacunarity, smoothness), c (exponent, randomness); p of `voronoi_parameter`
VORONOI_OUTPUTS = ("Distance", "Color", "Position", "Radius")


def noise_parameter(kind: str, normalize: bool, dimensions: int, colored: bool) -> int:
    """p of NOISE; `kind` is one of noise.FRACTAL_KINDS, `colored` whether g and b are wanted."""
    return dimensions + 8 * noise.FRACTAL_KINDS.index(kind) + 64 * normalize + 128 * colored


def voronoi_parameter(feature: str, metric: str, dimensions: int, normalize: bool, output: str, old: bool) -> int:
    """p of VORONOI, whose result is one of VORONOI_OUTPUTS; in w of the position is its W.  old: as before Blender 5."""
    return (
        dimensions
        + 8 * FEATURES.index(feature)
        + 64 * METRICS.index(metric)
        + 256 * normalize
        + 512 * VORONOI_OUTPUTS.index(output)
        + 2048 * old
    )


_ROW = types.CPointer(types.float32)
_SIGNATURE = types.void(types.int64, types.int64, _ROW, _ROW, _ROW, _ROW)


def _arithmetic(op, p, pa, pb, pc, result):
    a, b, c = numba.carray(pa, 4), numba.carray(pb, 4), numba.carray(pc, 4)
    x = y = z = F(0)
    w = F(1)
    if op == MATH:
        x = y = z = arithmetic.scalar_math(p, a[0], b[0], c[0])
    elif op == VECTOR_MATH:
        x, y, z = arithmetic.vector_math(p, a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
    elif op == ROTATE_EULER:
        x, y, z = arithmetic.rotate_euler(a[0], a[1], a[2], b[0], b[1], b[2], p != 0)
    elif op == ROTATE_AXIS:
        x, y, z = arithmetic.rotate_axis(a[0], a[1], a[2], b[0], b[1], b[2], c[0])
    elif op == BLEND:
        x, y, z = colors.blend(p, a[0], b[0], b[1], b[2], c[0], c[1], c[2])
    elif op == COLOR_MODEL:
        x, y, z = colors.convert(p, a[0], a[1], a[2])
    elif op == GAMMA:
        x, y, z = colors.gamma(a[0], b[0]), colors.gamma(a[1], b[0]), colors.gamma(a[2], b[0])
    elif op == PROJECT:
        x, y = textures.to_sphere(a[0], a[1], a[2]) if p == 0 else textures.to_tube(a[0], a[1], a[2])
    elif op == BUMP_STEP:
        x, y, z, w = bumps.steps(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1])
    elif op == BUMP_GRADIENT:
        x, y, z = bumps.gradient(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], c[3])
    elif op == BUMP_NORMAL:
        x, y, z = bumps.bumped_normal(a[0], a[1], a[2], b[0], b[1], b[2], b[3], c[0], c[1], c[2])
    else:
        size, extrapolate, interpolate = p >> 2, (p & 2) != 0, (p & 1) != 0
        table = numba.carray(pb, (size, 4))
        x = colors.lookup(table, 0, a[0], interpolate, extrapolate)
        y = colors.lookup(table, 1, a[1] if op == CURVES else a[0], interpolate, extrapolate)
        z = colors.lookup(table, 2, a[2] if op == CURVES else a[0], interpolate, extrapolate)
        w = colors.lookup(table, 3, a[0], interpolate, extrapolate)
    out = numba.carray(result, 4)
    out[0], out[1], out[2], out[3] = x, y, z, w


def _pattern(op, p, pa, pb, pc, result):
    a, b, c = numba.carray(pa, 4), numba.carray(pb, 4), numba.carray(pc, 4)
    x = y = z = F(0)
    w = F(1)
    if op == CHECKER:
        w = procedural.checker(a[0], a[1], a[2])
        x, y, z = (b[0], b[1], b[2]) if w == F(1) else (c[0], c[1], c[2])
    elif op == GRADIENT:
        x = y = z = procedural.gradient(p, a[0], a[1], a[2])
    elif op == WHITE_NOISE:
        x, y, z, w = procedural.white_noise(p, a[0], a[1], a[2], b[0])
    elif op == NOISE:
        normalize, colored = (p & 64) != 0, (p & 128) != 0
        kind, dimensions = (p >> 3) & 7, p & 7
        x, y, z = noise.noise_texture(kind, normalize, dimensions, a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3], c[0], c[1], colored)
    elif op == WAVE:
        x = y = z = procedural.wave(p & 1, (p >> 1) & 3, p >> 3, a[0], a[1], a[2], b[0], b[1], b[2], b[3], c[0])
    elif op == MAGIC:
        x, y, z = procedural.magic(p, a[0], a[1], a[2], b[0], b[1])
    else:
        x, y = procedural.brick(a[0], a[1], b[0], b[1], b[2], b[3], c[0], c[1], p & 255, c[2], p >> 8)
    out = numba.carray(result, 4)
    out[0], out[1], out[2], out[3] = x, y, z, w


def _cells(op, p, pa, pb, pc, result):
    a, b, c = numba.carray(pa, 4), numba.carray(pb, 4), numba.carray(pc, 4)
    feature, metric, dimensions, normalize, output = (p >> 3) & 7, (p >> 6) & 3, p & 7, (p & 256) != 0, (p >> 9) & 3
    # One dimension is W's, which `voronoi` has in x.
    x, w = (a[3], F(0)) if dimensions == 1 else (a[0], a[3])
    d, red, green, blue, px, py, pz, pw = voronoi(
        p >> 11 != 0, feature, metric, dimensions, normalize, x, a[1], a[2], w, b[0], b[1], b[2], b[3], c[0], c[1]
    )
    out = numba.carray(result, 4)
    if output == 1:
        out[0], out[1], out[2], out[3] = red, green, blue, F(1)
    elif output == 2:
        out[0], out[1], out[2], out[3] = (F(0), F(0), F(0), px) if dimensions == 1 else (px, py, pz, pw)
    else:
        out[0], out[1], out[2], out[3] = d, d, d, F(1)


@functools.cache
def _compiled(function):
    # The object has to live as long as its address is used: the cache keeps it.
    return c_function(_SIGNATURE)(function)


def addresses(operations: set[int]) -> np.ndarray:
    """`MaterialTables.functions` for programs that use these operations; compiles what they need."""
    needed = (
        any(FIRST <= op < FIRST_PATTERN for op in operations),
        any(FIRST_PATTERN <= op < FIRST_CELLS for op in operations),
        any(op >= FIRST_CELLS for op in operations),
    )
    return np.array([_compiled(f).address if use else 0 for f, use in zip((_arithmetic, _pattern, _cells), needed)], np.uint64)


@intrinsic
def _call(typingctx, address, op, p, a, b, c, result):
    """address(op, p, a, b, c, result), rows by their addresses."""

    def codegen(context, builder, signature, args):
        word, row = ir.IntType(64), ir.FloatType().as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [word, word, row, row, row, row])
        function = builder.inttoptr(args[0], kind.as_pointer())
        builder.call(function, [args[1], args[2], *(builder.inttoptr(k, row) for k in args[3:])])
        return context.get_dummy_value()

    return types.void(types.uint64, types.int64, types.int64, *[types.uint64] * 4), codegen


@inlined
def call(functions, op, p, rows, a, b, c, result):
    """Runs one outlined operation on rows a, b, c of `rows` into row `result`."""
    base = np.uint64(rows.ctypes.data)
    stride = np.uint64(16)
    address = functions[2] if op >= FIRST_CELLS else functions[1] if op >= FIRST_PATTERN else functions[0]
    _call(
        address,
        np.int64(op),
        np.int64(p),
        base + stride * np.uint64(a),
        base + stride * np.uint64(b),
        base + stride * np.uint64(c),
        base + stride * np.uint64(result),
    )
