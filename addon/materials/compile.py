"""Compiles the materials of a scene into the tables of the jitted evaluator."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ...core import scene
from ...core.surfaces import outlined
from ...core.surfaces import program as ops
from ...core.surfaces.layout import EMISSION, GLOSSY_F0, REFRACTION, SURFACE, TRANSLUCENCY, TRANSPARENCY
from ...core.surfaces.textures import TexturePool
from . import nodes, registry  # noqa: F401  (importing `nodes` fills the registry)
from .bake import Baker
from .builder import ONE, ZERO, Constant, Program, TooComplex, run
from .displacement import displaced_normal
from .lamps import compile_lamp
from .requests import BAKED, CompiledMaterials, LampProgram, LampUse, MaterialUse, Shot
from .tree import Context, Scope

_DEFAULT_GREY = Constant(0.8, 0.8, 0.8)
_GLOSSY = {ops.GLOSSY_CLOSURE, ops.METAL_CLOSURE, ops.GLASS_CLOSURE, ops.DIELECTRIC_CLOSURE, ops.COAT_CLOSURE}
_REFRACTIVE = {ops.REFRACTION_CLOSURE, ops.GLASS_CLOSURE}
_TRANSPARENT = {ops.TRANSPARENT_CLOSURE, *_REFRACTIVE}
# Lobes there are 0 behind the normal to shadow rays, but not to the rays that Cycles draws from them.
_PAST_NORMALS = bpy.app.version < (5, 0)
_ANGLED = {ops.FRESNEL, ops.FACING, ops.BACKFACING}


def compile_materials(
    uses: Sequence[MaterialUse], *, lamps: Sequence[LampUse] = (), may_bake: bool = True, shot: Shot | None = None
) -> CompiledMaterials:
    """Tables of the materials of `uses`, in their order, and after them the programs of `lamps`.

    may_bake: Cycles may run now; else what only it can compute comes from an earlier bake, or is left out with a warning.
    shot: what they may ask of the render, None for nothing of it.
    """
    shot = Shot() if shot is None else shot
    textures = TexturePool()
    warnings: list[str] = []
    baked_uvs: dict[str, dict[str, np.ndarray]] = {}
    programs = [_program(use, textures, warnings, baked_uvs, may_bake, shot) for use in uses]
    names = [use.material.name if use.material else "" for use in uses]
    requests = [list(p.requests) for p in programs]
    known: dict[tuple, int] = {}  # lamps that are alike share their program
    compiled = []
    for use in lamps:
        program, falloff = compile_lamp(use, textures, warnings, shot)
        if program is None:
            compiled.append(LampProgram())
            continue
        number = known.setdefault(tuple(program.instructions), len(programs))
        if number == len(programs):
            programs.append(program)
            names.append(use.name)
        compiled.append(LampProgram(number, falloff))
    tables = _link(programs, names, textures, warnings, ops.OWN_ROWS if known else 1)
    clear = np.zeros(SURFACE, np.float32)
    clear[TRANSPARENCY : TRANSPARENCY + 3] = 1
    unseen = np.flatnonzero(((tables.flags & scene.CONSTANT) > 0) & (tables.constant == clear).all(1)).tolist()
    return CompiledMaterials(scene.Materials(names, tables), requests, warnings, baked_uvs, compiled, unseen)


def _program(use: MaterialUse, textures: TexturePool, warnings: list[str], baked_uvs: dict, may_bake: bool, shot: Shot) -> Program:
    program = Program()
    material = use.material
    if material is None or not uses_nodes(material):
        color = _DEFAULT_GREY if material is None else Constant(*material.diffuse_color)
        program.emit(ops.DIFFUSE_CLOSURE, color, ZERO, ZERO, ONE)
        return program
    baker = Baker(material, use.objects, may_bake)
    context = Context(material, program, textures, warnings, baker, use.objects, shot=shot)
    output = material.node_tree.get_output_node("CYCLES") or material.node_tree.get_output_node("ALL")
    if output is None:
        return program
    try:
        scope = Scope(context, material.node_tree)
        context.normal = displaced_normal(scope, output)
        surface, volume = (scope.source(output.inputs[name]) for name in ("Surface", "Volume"))
        if volume is not None and volume.is_computed:
            context.warn("its volume is left out")
            if surface is None or not surface.is_computed:  # it has no surface, as fog has none
                program.emit(ops.TRANSPARENT_CLOSURE, ONE, ZERO, ZERO, ONE)
        scope.shade(output.inputs["Surface"], ONE)
    except registry.Unsupported as reason:
        context.warn(f"{reason}; the material is shown in its viewport colour")
        return _viewport_color(material)
    if any(r.kind == BAKED for r in program.requests):
        baked_uvs[material.name_full] = baker.uvs()
    return program


def uses_nodes(material) -> bool:
    """Whether a material is what its nodes say, not the colour of the viewport; from Blender 5 on every one is."""
    return material.node_tree is not None and (bpy.app.version >= (5, 0) or material.use_nodes)


def _viewport_color(material) -> Program:
    program = Program()
    program.emit(ops.DIFFUSE_CLOSURE, Constant(*material.diffuse_color), ZERO, ZERO, ONE)
    return program


def _link(programs: list[Program], names: list[str], textures: TexturePool, warnings: list[str], own_rows: int = 1) -> scene.MaterialTables:
    """own_rows: constants that are none (see `program.VIEWER`)."""
    code, constants = [np.array([[ops.END, *[0] * 7]], np.int32)], [np.zeros((own_rows, 4), np.float32)]
    start = np.zeros(len(programs), np.int32)
    flags = np.zeros(len(programs), np.int32)
    constant = np.zeros((len(programs), SURFACE), np.float32)
    for m, program in enumerate(programs):
        operations = program.operations()
        if not program.varies:
            _, constant[m] = run(*program.assemble(0))
            flags[m] = scene.CONSTANT | _constant_flags(constant[m])
        else:
            try:
                instructions, rows = program.assemble(sum(map(len, constants)))
            except TooComplex:
                warnings.append(f"Material '{names[m]}': its node tree is too large; it shows as black")
                flags[m] = scene.CONSTANT
                continue
            start[m] = sum(map(len, code))
            code.append(instructions)
            constants.append(rows)
            flags[m] = (
                scene.EMISSIVE * (ops.EMISSION_CLOSURE in operations)
                | scene.TRANSPARENT * bool(operations & _TRANSPARENT)
                | scene.REFRACTIVE * bool(operations & _REFRACTIVE)
                | scene.FROSTED * _is_frosted(program)
                | scene.COATED * (ops.COAT_CLOSURE in operations)
                | scene.GLOSSY_LOBE * bool(operations & _GLOSSY)
                | scene.TRANSLUCENT * (ops.TRANSLUCENT_CLOSURE in operations)
                | scene.ANGLED * bool(operations & _ANGLED)
                | (scene.TELLING | scene.ANGLED) * _tells_shadow_rays(program)
            )
        bumpy = ops.NORMAL_MAP in operations
        flags[m] |= (scene.NORMAL_MAPPED | scene.PAST_NORMAL * _PAST_NORMALS | scene.SMOOTH_COAT * _has_smooth_coat(program)) * bumpy
    header, texels_u8, texels_f32 = textures.tables()
    instructions = np.concatenate(code)
    functions = outlined.addresses({int(op) for op in instructions[:, 0]})
    return scene.MaterialTables(instructions, np.concatenate(constants), start, flags, constant, header, texels_u8, texels_f32, functions)


def _tells_shadow_rays(program: Program) -> bool:
    """Whether it shows shadow rays something else than diffuse ones."""
    return any(op == ops.VIEWED and bool(p & scene.SHADOW) != bool(p & scene.DIFFUSE) for op, _, p in program.instructions)


def _has_smooth_coat(program: Program) -> bool:
    """Whether all coats in it have the surface's own normal."""
    bent = [not p for op, _, p in program.instructions if op == ops.COAT_CLOSURE]
    return bool(bent) and not any(bent)


def _is_frosted(program: Program) -> bool:
    """Whether glass in it may be rough."""
    lobes = [operands[1] for op, operands, _ in program.instructions if op in _REFRACTIVE]
    return any(not isinstance(lobe, Constant) or lobe.x > 0 for lobe in lobes)


def _constant_flags(surface: np.ndarray) -> int:
    pairs = (
        (scene.EMISSIVE, EMISSION, 3),
        (scene.TRANSPARENT, TRANSPARENCY, 3),
        (scene.REFRACTIVE, REFRACTION, 3),
        (scene.GLOSSY_LOBE, GLOSSY_F0, 6),
        (scene.TRANSLUCENT, TRANSLUCENCY, 3),
    )
    return sum(flag for flag, at, n in pairs if (surface[at : at + n] > 0).any())
