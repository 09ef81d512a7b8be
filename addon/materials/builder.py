"""Builds one material's program: values, folding of constants, sharing of equal instructions, registers."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from ...core.surfaces import outlined
from ...core.surfaces import program as ops
from ...core.surfaces.layout import SURFACE
from .requests import DISPLACED, AttributeRequest

_CLOSURES = frozenset(
    {
        ops.DIFFUSE_CLOSURE,
        ops.TRANSLUCENT_CLOSURE,
        ops.EMISSION_CLOSURE,
        ops.TRANSPARENT_CLOSURE,
        ops.REFRACTION_CLOSURE,
        ops.GLOSSY_CLOSURE,
        ops.METAL_CLOSURE,
        ops.GLASS_CLOSURE,
        ops.DIELECTRIC_CLOSURE,
        ops.COAT_CLOSURE,
        ops.SHEEN_CLOSURE,
        ops.NORMAL_MAP,
    }
)
# What depends on the point or the view, and is therefore never folded.
_VARYING = frozenset(
    {ops.ATTRIBUTE, ops.DISPLACED, ops.FOOTPRINT, ops.TEXTURE, ops.TEXTURE_BOX, ops.FRESNEL, ops.FACING, ops.BACKFACING, ops.VIEWED}
)
_VIEW_DEPENDENT = frozenset(
    {ops.FRESNEL, ops.FACING, ops.BACKFACING, ops.VIEWED, ops.GLASS_CLOSURE, ops.REFRACTION_CLOSURE, ops.COAT_CLOSURE, ops.SHEEN_CLOSURE}
)


@dataclass(frozen=True)
class Constant:
    """Four floats known now."""

    x: float
    y: float
    z: float
    w: float = 1.0

    @property
    def rgb(self) -> tuple[float, float, float]:
        return self.x, self.y, self.z


@dataclass(frozen=True)
class Table:
    """Consecutive rows of constants: a colour ramp, a curve, a matrix."""

    rows: tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True)
class Result:
    """What instruction `index` computes."""

    index: int


@dataclass(frozen=True)
class Given:
    """A row that is written before the program runs, one of `program.VIEWER` and those after it."""

    row: int


Value = Constant | Result | Given

ZERO, ONE = Constant(0.0, 0.0, 0.0), Constant(1.0, 1.0, 1.0)


def scalar(x: float) -> Constant:
    """A number, as it is read as a grey colour or vector too."""
    x = float(x)
    return Constant(x, x, x)


class TooComplex(Exception):
    """The program needs more registers than the evaluator has."""


@dataclass
class Program:
    """A program under construction."""

    instructions: list[tuple[int, tuple, int]] = field(default_factory=list)
    requests: list[AttributeRequest] = field(default_factory=list)
    step: Value | None = None
    _known: dict = field(default_factory=dict)

    def attribute(self, kind: str, name: str = "") -> Value:
        """The attribute at the point."""
        request = AttributeRequest(kind, name)
        if request not in self.requests:
            self.requests.append(request)
        slot = self.requests.index(request)
        if self.step is not None and kind in DISPLACED:
            return self.emit(ops.DISPLACED, self.step, p=slot)
        return self.emit(ops.ATTRIBUTE, p=slot)

    @contextmanager
    def displaced(self, step: Value | None):
        """Within it, attributes are those at a point beside the surface's: (u, v) + `step` in barycentric coordinates."""
        before, self.step = self.step, step
        try:
            yield
        finally:
            self.step = before

    def emit(self, op: int, *operands: Value | Table, p: int = 0) -> Value:
        """Adds an instruction; one that was there already is used again, one of constants is computed now."""
        key = (op, operands, p)
        if op not in _CLOSURES:
            if key in self._known:
                return self._known[key]
            if op not in _VARYING and not any(isinstance(o, (Result, Given)) for o in operands):
                self._known[key] = folded = _fold(op, operands, p)
                return folded
        self.instructions.append(key)
        result = Result(len(self.instructions) - 1)
        if op not in _CLOSURES:
            self._known[key] = result
        return result

    def operations(self) -> set[int]:
        """The operations in use."""
        return {op for op, _, _ in self.instructions}

    @property
    def varies(self) -> bool:
        """Whether the surface depends on the point or the view."""
        if self.operations() & (_VARYING | _VIEW_DEPENDENT):
            return True
        return any(isinstance(operand, Given) for _, operands, _ in self.instructions for operand in operands)

    def assemble(self, first_constant: int) -> tuple[np.ndarray, np.ndarray]:
        """((I, 8) int32 code, (C, 4) float32 constants), the constants to lie from row REGISTERS + first_constant.

        Instructions whose result nobody reads are left out.
        """
        needed = self._needed()
        last_use = {}
        for i in needed:
            for operand in self.instructions[i][1]:
                if isinstance(operand, Result):
                    last_use[operand.index] = i
        constants: list[tuple] = []
        rows: dict = {}

        def constant_row(value: Constant | Table | Given) -> int:
            if isinstance(value, Given):
                return ops.REGISTERS + value.row
            if value not in rows:
                rows[value] = len(constants)
                if isinstance(value, Table):
                    constants.extend(value.rows)
                else:
                    constants.append((value.x, value.y, value.z, value.w))
            return ops.REGISTERS + first_constant + rows[value]

        zero = constant_row(ZERO)
        free = list(range(ops.REGISTERS))[::-1]
        register: dict[int, int] = {}
        code = []
        for i in needed:
            op, operands, p = self.instructions[i]
            sources = [register[o.index] if isinstance(o, Result) else constant_row(o) for o in operands]
            for index in {o.index for o in operands if isinstance(o, Result)}:
                if last_use[index] == i:
                    free.append(register[index])
            if not free:
                raise TooComplex
            register[i] = free.pop()
            code.append([op, register[i], *sources, *[zero] * (5 - len(sources)), p])
            if i not in last_use:
                free.append(register[i])
        code.append([ops.END, *[0] * 7])
        return np.array(code, np.int32), np.array(constants, np.float32)

    def _needed(self) -> list[int]:
        marked = set()
        for i in reversed(range(len(self.instructions))):
            op, operands, _ = self.instructions[i]
            if op in _CLOSURES or i in marked:
                marked.add(i)
                marked.update(o.index for o in operands if isinstance(o, Result))
        return sorted(marked)


def run(code: np.ndarray, constants: np.ndarray, **images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rows, surface) after running a program that reads no attribute; images: the fields of `MaterialTables` that textures are in."""
    tables = ops.empty_tables()._replace(
        code=code,
        constants=constants,
        start=np.zeros(1, np.int32),
        flags=np.zeros(1, np.int32),
        constant=np.zeros((1, SURFACE), np.float32),
        functions=outlined.addresses({int(op) for op in code[:, 0]}),
        **images,
    )
    rows, surface = ops.new_registers(tables), np.zeros(SURFACE, np.float32)
    f = np.float32
    attributes = np.zeros((1, 1, 3, 4), np.float32)
    # What `ops.evaluate` inlines: called from Python, that would be compiled anew in every session.
    ops._run(tables, 0, attributes, np.int32(0), f(0), f(0), f(ops.MEAN_VIEW), rows, surface)
    return rows, surface


def _fold(op: int, operands: tuple, p: int) -> Constant:
    constants: list[tuple] = [(0.0,) * 4]
    sources = []
    for operand in operands:
        sources.append(ops.REGISTERS + len(constants))
        constants.extend(operand.rows if isinstance(operand, Table) else [(operand.x, operand.y, operand.z, operand.w)])
    instruction = [op, 0, *sources, *[ops.REGISTERS] * (5 - len(sources)), p]
    rows, _ = run(np.array([instruction, [ops.END, *[0] * 7]], np.int32), np.array(constants, np.float32))
    return Constant(*(float(c) for c in rows[0]))


def warm_up() -> None:
    """Load the compiled code of `run`, which takes a second, at a time of the caller's choice."""
    _fold(ops.AVERAGE, (ZERO,), 0)
