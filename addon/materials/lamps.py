"""Lamps' node trees as programs that are run for each ray which leaves a lamp.

What Cycles' nodes ask of a lamp is made of three vectors in the lamp's own axes: its normal where a ray leaves it, the direction in which
the light goes, and the place (kernel/light/*.h and shader_setup_from_sample say what they are).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.surfaces import outlined
from ...core.surfaces import program as ops
from ...core.surfaces.arithmetic import VECTOR
from ...core.surfaces.layout import EMISSION
from ...core.surfaces.textures import TexturePool
from . import requests as rq
from .builder import ONE, ZERO, Constant, Given, Program, Table, TooComplex, Value, run, scalar
from .registry import Unsupported
from .requests import LampUse, Shot
from .tree import Context, Fading, Scope

_NORMAL, _INCOMING, _PLACE = Given(ops.LAMP_NORMAL), Given(ops.LAMP_INCOMING), Given(ops.LAMP_PLACE)
_HALF = scalar(0.5)
_LOOKS = 32  # rays by which trees of several strengths are compared
_DIGITS = 9  # of a matrix's numbers: lamps that differ by rounding alone share a program


class _NoBaker:
    """Lamps have no surface to bake on."""

    def bake(self, scope: Scope, socket: bpy.types.NodeSocket) -> np.ndarray:
        raise Unsupported("a lamp has no surface to bake on")


@dataclass
class _Program(Program):
    """A program whose attributes are those of a lamp."""

    use: LampUse | None = None

    def attribute(self, kind: str, name: str = "") -> Value:
        """The attribute where a ray leaves the lamp; zeros for what lamps have none of, as in Cycles."""
        matrix, axes = self.use.matrix, self.use.axes
        if kind == rq.NORMAL:
            return self._unit(self._turned(matrix[:3, :3].T @ axes.T, _NORMAL))
        if kind in (rq.WORLD_NORMAL, rq.FACE_NORMAL):
            return self._turned(axes.T, _NORMAL)
        if kind == rq.INCOMING:
            return self._turned(axes.T, _INCOMING)
        if kind == rq.LOCAL_INCOMING:
            return self._unit(self._turned(matrix[:3, :3].T @ axes.T, _INCOMING))
        if kind == rq.WORLD_POSITION:
            return self._placed(np.eye(4))
        if kind == rq.GENERATED or (kind == rq.OBJECT and not name):
            return self._placed(np.linalg.inv(matrix))
        if kind == rq.OBJECT:
            if name not in self.use.places:
                raise Unsupported(f"the object '{name}' is not in the scene")
            return self._placed(np.linalg.inv(self.use.places[name]))
        if kind == rq.PARAMETRIC or (kind == rq.UV and not name):
            return _UVS[self.use.light.type](self)
        if kind == rq.OBJECT_LOCATION:
            return Constant(*matrix[:3, 3])
        if kind in (rq.UV, rq.ATTRIBUTE, rq.COLOR):
            return ZERO
        raise Unsupported(f"'{kind}' of a lamp is not known")

    def _turned(self, matrix: np.ndarray, vector: Value) -> Value:
        return self.emit(ops.MATRIX, vector, Table(_rows(matrix, np.zeros(3))))

    def _placed(self, into: np.ndarray) -> Value:
        """The place in the space that `into` (4, 4) leads to from the world's."""
        if self.use.light.type == "SUN":  # as far as its unit direction
            return self.emit(ops.MATRIX, _NORMAL, Table(_rows(into[:3, :3] @ self.use.axes.T, into[:3, 3])))
        origin = into @ self.use.matrix[:, 3]
        return self.emit(ops.MATRIX, _PLACE, Table(_rows(into[:3, :3] @ self.use.axes.T, origin[:3])))

    def _unit(self, vector: Value) -> Value:
        return self.emit(outlined.VECTOR_MATH, vector, ZERO, ZERO, p=VECTOR["NORMALIZE"])


def _rows(matrix: np.ndarray, offset: np.ndarray) -> tuple:
    rows = np.round(np.column_stack([matrix, offset]), _DIGITS) + 0.0  # without negative zeros
    return tuple(tuple(float(x) for x in row) for row in rows)


def _sphere_uv(program: _Program) -> Value:
    """Of a point lamp: its normal on a map of the sphere."""
    normal = program.attribute(rq.NORMAL)
    centred = program.emit(outlined.VECTOR_MATH, normal, _HALF, _HALF, p=VECTOR["MULTIPLY_ADD"])
    return program.emit(outlined.PROJECT, centred, p=0)


def _spot_uv(program: _Program) -> Value:
    """Of a spot: where the direction passes a square before it that the cone just fits into."""
    use = program.use
    scale = np.linalg.norm(use.matrix[:3, :3], axis=0)
    factor = 0.5 / math.tan(0.5 * use.light.spot_size)
    rows = np.diag(1 / scale) * np.array([factor, factor, -1.0])[:, None]
    local = program._turned(rows, _INCOMING)
    depth = program.emit(ops.SPLAT, local, p=2)
    ratio = program.emit(outlined.VECTOR_MATH, local, depth, p=VECTOR["DIVIDE"])
    return program.emit(outlined.VECTOR_MATH, ratio, Constant(1.0, 1.0, 0.0), Constant(0.5, 0.5, 0.0), p=VECTOR["MULTIPLY_ADD"])


def _area_uv(program: _Program) -> Value:
    """Of an area lamp: the place on its rectangle."""
    use, light = program.use, program.use.light
    scale = np.linalg.norm(use.matrix[:3, :3], axis=0)
    size_y = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
    extent = np.maximum([light.size * scale[0], size_y * scale[1]], 1e-12)
    return program.emit(ops.MATRIX, _PLACE, Table(_rows(np.diag([1 / extent[0], 1 / extent[1], 0.0]), np.array([0.5, 0.5, 0.0]))))


def _sun_uv(program: _Program) -> Value:
    """Of a sun: the place on its disk."""
    angle = program.use.light.angle
    factor = 0.5 / math.sin(0.25 * angle) if angle > 0 else 0.0
    # Over |d + z|, which is 2 cos of half the angle between them, for d = -incoming.
    lowered = program.emit(outlined.VECTOR_MATH, Constant(0.0, 0.0, 1.0), _INCOMING, p=VECTOR["SUBTRACT"])
    length = program.emit(outlined.VECTOR_MATH, lowered, p=VECTOR["LENGTH"])
    across = program._turned(np.diag([-factor, -factor, 0.0]), _INCOMING)
    ratio = program.emit(outlined.VECTOR_MATH, across, length, p=VECTOR["DIVIDE"])
    return program.emit(outlined.VECTOR_MATH, ratio, ONE, Constant(0.5, 0.5, 0.0), p=VECTOR["MULTIPLY_ADD"])


_UVS = {"POINT": _sphere_uv, "SPOT": _spot_uv, "AREA": _area_uv, "SUN": _sun_uv}


def compile_lamp(use: LampUse, textures: TexturePool, warnings: list[str], shot: Shot) -> tuple[Program | None, tuple[float, float]]:
    """The program of a lamp's tree and its falloff as `core.scene.Lamps` has it; None, with a warning, where there is none."""
    fading = Fading()
    try:
        program = _built(use, textures, warnings, fading, shot)
        falloff = next(iter(fading.found), (0.0, 0.0))
        if fading.found != {(0.0, 0.0)} and fading.found:
            if use.light.type == "SUN":
                falloff = (falloff[0], 0.0)  # infinitely far away, where nothing is smoothed
                if falloff[0]:
                    raise Unsupported("Light Falloff makes a sun depend on the distance")
            if len(fading.found) > 1 or not _is_proportional(use, program, textures, warnings, shot):
                raise Unsupported("its light is not in proportion to one Light Falloff")
    except (Unsupported, TooComplex) as reason:
        reason = "there are too many" if isinstance(reason, TooComplex) else reason
        warnings.append(
            f"the nodes of lamp '{use.name}' vary or are not understood ({reason}): it shines evenly, with its own power and colour"
        )
        return None, (0.0, 0.0)
    return program, falloff


def _built(use: LampUse, textures: TexturePool, warnings: list[str], fading: Fading, shot: Shot) -> _Program:
    program = _Program(use=use)
    output = use.light.node_tree.get_output_node("CYCLES") or use.light.node_tree.get_output_node("ALL")
    context = Context(use.light, program, textures, warnings, _NoBaker(), fading=fading, is_lamp=True, shot=shot)
    if output is not None:
        Scope(context, use.light.node_tree).shade(output.inputs["Surface"], ONE)
    program.assemble(ops.OWN_ROWS)  # a tree that is too complex is found here
    return program


def _is_proportional(use: LampUse, program: _Program, textures: TexturePool, warnings: list[str], shot: Shot) -> bool:
    """Whether a lamp's light is in proportion to its Light Falloff nodes, as far as some rays show."""
    none, double = (_values(_built(use, textures, warnings, Fading(strength), shot), textures) for strength in (0.0, 2.0))
    return not none.any() and np.allclose(double, 2 * _values(program, textures), rtol=1e-4)


def _values(program: _Program, textures: TexturePool) -> np.ndarray:
    """(_LOOKS, 3) what a lamp shows of itself, to rays as they are drawn."""
    code, constants = program.assemble(ops.OWN_ROWS)
    header, texels_u8, texels_f32 = textures.tables()
    drawn = np.random.default_rng(0).normal(size=(_LOOKS, ops.OWN_ROWS, 4)).astype(np.float32)
    drawn[..., :3] /= np.linalg.norm(drawn[..., :3], axis=-1, keepdims=True)
    images = {"texture_header": header, "texels_u8": texels_u8, "texels_f32": texels_f32}
    return np.array([run(code, np.concatenate([own, constants]), **images)[1][EMISSION : EMISSION + 3] for own in drawn])
