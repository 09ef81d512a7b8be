"""Material programs: the instruction set and the jitted evaluator that runs one at a hit point.

A program is a straight list of instructions over rows of four floats.  An instruction is eight integers
(operation, destination row, operand rows a b c d e, parameter p).  Rows 0..REGISTERS-1 are registers,
the rows after them are the constants of all materials, the first of which says
where the viewer is to programs with FOOTPRINT (see `footprint`); where lamps have programs, the next three are for what
these are told of a ray (see `lamps.textured`).  A scalar fills x, y and z of its row, so that it
reads as a grey colour or vector as it is.  Operations on closures add to the surface (see `layout`).
The rarer operations are in `outlined` and are called by address, so that kernels which evaluate
materials stay small and compile fast.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel, leaf
from ..scene import CONSTANT, COVERED, GLOSSY, SHADOW, TRANSMISSION, MaterialTables, Scene
from . import bumps, closures, footprint, outlined, textures
from .colors import luminance
from .covers import blacken, is_covered
from .layout import EMISSION, NORMAL, SURFACE, TILT, TRANSPARENCY
from .rough_glass import MULTIPLE, SINGLE

F = np.float32

REGISTERS = 64
# A view cosine above 1 asks for the mean over the views from the front, below -1 from the back.
MEAN_VIEW = 2.0
# Rows after the registers that are no constants: of the viewer, and in a lamp's own axes of its normal where a ray leaves it, the
# direction in which its light leaves, and the place relative to its position (m).  OWN_ROWS: their number where lamps have programs.
VIEWER, LAMP_NORMAL, LAMP_INCOMING, LAMP_PLACE, OWN_ROWS = range(5)

# Operations.  "rgb" are x, y, z of a row; p is the instruction's last integer.
(
    END,  # end of the program
    # -- sources --
    ATTRIBUTE,  # attribute slot p
    TEXTURE,  # texture p at (a.x, a.y): rgb, alpha in w
    TEXTURE_BOX,  # texture p by box projection of the point a, object-space normal b, blend c.x
    # -- rows --
    SPLAT,  # component p of a, in x, y, z
    PACK,  # (a.x, b.x, c.x, d.x)
    SCALE,  # a b, per component
    CLAMP,  # a between b and c, per component
    MIX,  # b + a (c - b), per component
    MATRIX,  # rows b, b + 1, b + 2 (translation in w) times a
    LUMINANCE,  # of a
    AVERAGE,  # of a.xyz
    # -- the view --
    FRESNEL,  # dielectric Fresnel term for the index of refraction a.x
    FACING,  # 1 - |cosine| ** a.x
    BACKFACING,  # 1 where the back is seen
    VIEWED,  # 1 for a view of one of the kinds of rays p, else 0
    # -- closures; d is the weight --
    DIFFUSE_CLOSURE,  # colour a, roughness b.x
    EMISSION_CLOSURE,  # radiance a
    TRANSPARENT_CLOSURE,  # colour a
    REFRACTION_CLOSURE,  # colour a, (roughness, ior) b
    GLOSSY_CLOSURE,  # colour a, roughness b.x, p: distribution, see `closures.glossy`
    METAL_CLOSURE,  # colour a, roughness b.x, tint at 82 degrees c, p: multiple scattering
    GLASS_CLOSURE,  # colour a, (roughness, ior) b, tint of the reflection c, p: `THIN_WALL`, `SCATTERED_ONCE`
    DIELECTRIC_CLOSURE,  # base colour a, (roughness, ior, specular level, diffuse roughness) b, tint c, p: multiple scattering
    SHEEN_CLOSURE,  # (weight, roughness) a, tint b, p: a velvet; the result is the weight of what lies below
    COAT_CLOSURE,  # (weight, roughness, ior) a, tint b; the result is the weight of what lies below
    NORMAL_MAP,  # world-space normal a; p: as for bumps on a surface of normal b, diffuse light is shadowed
    # -- bumps --
    DISPLACED,  # attribute slot p at (u + a.x, v + a.y)
    FOOTPRINT,  # size of a pixel at the world position a (m)
    # -- light from behind --
    TRANSLUCENT_CLOSURE,  # colour a, p: under the dielectric lobe; d is the weight
    # -- a program by itself, of materials that are COVERED --
    COVERED_PARTS,  # material p, but black where one of the coverers from a to b - 1 is (see `covers`)
) = range(31)
THIN_WALL, SCATTERED_ONCE = 1, 2  # p of a GLASS_CLOSURE


@kernel
def new_registers(tables):
    """Scratch rows for `evaluate`: one array per chunk of work, never shared by threads."""
    rows = np.empty((REGISTERS + tables.constants.shape[0], 4), np.float32)
    for i in range(tables.constants.shape[0]):  # an array assignment would compile its broadcasting errors as well
        for k in range(4):
            rows[REGISTERS + i, k] = tables.constants[i, k]
    return rows


@leaf
def _box(tables, texture, x, y, z, nx, ny, nz, mix):
    wx, wy, wz = textures.box_weights(abs(nx), abs(ny), abs(nz), mix)
    r = g = b = a = F(0)
    for side in range(3):
        weight = wx if side == 0 else wy if side == 1 else wz
        if weight > F(0):
            u, v = textures.box_side(side, x, y, z, nx, ny, nz)
            tr, tg, tb, ta = textures.sample(tables.texture_header, tables.texels_u8, tables.texels_f32, texture, u, v)
            r, g, b, a = r + weight * tr, g + weight * tg, b + weight * tb, a + weight * ta
    return r, g, b, a


@leaf
def _attribute(attributes, slot, triangle, u, v):
    w = F(1) - u - v
    a = attributes[slot, triangle]
    return (
        w * a[0, 0] + u * a[1, 0] + v * a[2, 0],
        w * a[0, 1] + u * a[1, 1] + v * a[2, 1],
        w * a[0, 2] + u * a[1, 2] + v * a[2, 2],
        w * a[0, 3] + u * a[1, 3] + v * a[2, 3],
    )


@inlined
def reflected_view(cosine):
    """What `evaluate` takes for a view that is not the camera's: materials may show it something else."""
    return cosine - closures.REFLECTED if cosine < F(0) else cosine + closures.REFLECTED


@inlined
def specular_view(cosine, kind):
    """What `evaluate` takes for a view of the camera's by way of a mirror (`kind` GLOSSY) or through glass (TRANSMISSION), or a lamp's (SHADOW); else the cosine."""
    offset = closures.TRANSMITTED if kind == TRANSMISSION else closures.MIRRORED if kind == GLOSSY else F(0)
    offset = closures.SHADOWED if kind == SHADOW else offset
    return cosine - offset if cosine < F(0) else cosine + offset


@inlined
def from_within(cosine):
    """What `evaluate` takes for a view (cosine below 0, or `reflected_view` or `specular_view` of it) of the back of glass that it did not enter by a front.

    To Cycles it comes from within a solid, the medium that the index of refraction is of: it is reflected totally beyond the critical angle.
    """
    return cosine - closures.WITHIN


@inlined
def evaluate(tables, material, attributes, triangle, u, v, cosine, rows, surface):
    """Writes the surface of `material` at a point of a triangle into `surface`, (SURFACE,) float32.

    tables: MaterialTables.  attributes: (K, T, 3, 4).  (u, v): barycentric, weights of corners 1 and 2.
    cosine: of the camera's view with the shading normal, below 0 where the back of the triangle is seen;
        `specular_view` of it by way of mirrors and glass and for shadow rays, `reflected_view` for any other view; MEAN_VIEW for the mean over those of the
        front, -MEAN_VIEW of the back; see also `from_within`.
    rows: from `new_registers`.
    """
    black = False
    if tables.flags[material] & COVERED:
        at = tables.start[material]
        black = is_covered(tables.covers, tables.code[at, 2], tables.code[at, 3], u, v)
        material = tables.code[at, 7]
    if tables.flags[material] & CONSTANT:
        for k in range(SURFACE):
            surface[k] = tables.constant[material, k]
    else:
        _run(tables, tables.start[material], attributes, triangle, u, v, cosine, rows, surface)
    if black:
        blacken(surface)


@leaf
def _run(tables, at, attributes, triangle, u, v, cosine, rows, surface):
    """Runs the program that starts at instruction `at`."""
    for k in range(SURFACE):
        surface[k] = F(0)
    code = tables.code
    w0 = F(1) - u - v
    while True:
        op = code[at, 0]
        if op == END:
            break
        ia, ib, ic, id_ = code[at, 2], code[at, 3], code[at, 4], code[at, 5]
        p = code[at, 7]
        ax, ay, az = rows[ia, 0], rows[ia, 1], rows[ia, 2]
        bx, by, bz = rows[ib, 0], rows[ib, 1], rows[ib, 2]
        cx, cy, cz = rows[ic, 0], rows[ic, 1], rows[ic, 2]
        dx, dy, dz = rows[id_, 0], rows[id_, 1], rows[id_, 2]
        x = y = z = F(0)
        w = F(1)
        destination = code[at, 1]
        if op >= outlined.FIRST:
            at += 1
            outlined.call(tables.functions, op, p, rows, ia, ib, ic, destination)
            continue
        if op == ATTRIBUTE:
            x = w0 * attributes[p, triangle, 0, 0] + u * attributes[p, triangle, 1, 0] + v * attributes[p, triangle, 2, 0]
            y = w0 * attributes[p, triangle, 0, 1] + u * attributes[p, triangle, 1, 1] + v * attributes[p, triangle, 2, 1]
            z = w0 * attributes[p, triangle, 0, 2] + u * attributes[p, triangle, 1, 2] + v * attributes[p, triangle, 2, 2]
            w = w0 * attributes[p, triangle, 0, 3] + u * attributes[p, triangle, 1, 3] + v * attributes[p, triangle, 2, 3]
        elif op == TEXTURE:
            x, y, z, w = textures.sample(tables.texture_header, tables.texels_u8, tables.texels_f32, p, ax, ay)
        elif op == TEXTURE_BOX:
            x, y, z, w = _box(tables, p, ax, ay, az, bx, by, bz, cx)
        elif op == SPLAT:
            x = y = z = rows[ia, p]
        elif op == PACK:
            x, y, z, w = ax, bx, cx, dx
        elif op == SCALE:
            x, y, z = ax * bx, ay * by, az * bz
        elif op == CLAMP:
            x, y, z = min(max(ax, bx), cx), min(max(ay, by), cy), min(max(az, bz), cz)
        elif op == MIX:
            x, y, z = bx + ax * (cx - bx), by + ay * (cy - by), bz + az * (cz - bz)
        elif op == MATRIX:
            x = bx * ax + by * ay + bz * az + rows[ib, 3]
            y = rows[ib + 1, 0] * ax + rows[ib + 1, 1] * ay + rows[ib + 1, 2] * az + rows[ib + 1, 3]
            z = rows[ib + 2, 0] * ax + rows[ib + 2, 1] * ay + rows[ib + 2, 2] * az + rows[ib + 2, 3]
        elif op == LUMINANCE:
            x = y = z = luminance(ax, ay, az)
        elif op == AVERAGE:
            x = y = z = (ax + ay + az) * F(1 / 3)
        elif op == FRESNEL:
            x = y = z = closures.dielectric_fresnel(cosine, ax)
        elif op == FACING:
            x = y = z = F(1) - closures.view_cosine(cosine) ** ax
        elif op == BACKFACING:
            x = y = z = F(1) if cosine < F(0) else F(0)
        elif op == VIEWED:
            x = y = z = F(1) if closures.view_rays(cosine) & p else F(0)
        elif op == DIFFUSE_CLOSURE:
            closures.diffuse(surface, ax, ay, az, bx, dx, dy, dz)
        elif op == EMISSION_CLOSURE:
            closures.add(surface, EMISSION, dx, dy, dz, ax, ay, az)
        elif op == TRANSPARENT_CLOSURE:
            closures.add(surface, TRANSPARENCY, dx, dy, dz, ax, ay, az)
        elif op == REFRACTION_CLOSURE:
            closures.refraction(surface, ax, ay, az, bx, by, dx, dy, dz, cosine)
        elif op == GLOSSY_CLOSURE:
            closures.glossy(surface, ax, ay, az, bx, p, dx, dy, dz)
        elif op == METAL_CLOSURE:
            closures.metal(surface, ax, ay, az, bx, p, cx, cy, cz, dx, dy, dz)
        elif op == GLASS_CLOSURE:
            closures.glass(
                surface, ax, ay, az, bx, by, p & THIN_WALL, SINGLE if p & SCATTERED_ONCE else MULTIPLE, cx, cy, cz, dx, dy, dz, cosine
            )
        elif op == DIELECTRIC_CLOSURE:
            closures.dielectric_over_diffuse(surface, ax, ay, az, bx, by, bz, rows[ib, 3], p, cx, cy, cz, dx, dy, dz)
        elif op == SHEEN_CLOSURE:
            x, y, z = closures.sheen(surface, ax, ay, p, bx, by, bz, dx, dy, dz, cosine)
        elif op == COAT_CLOSURE:
            x, y, z = closures.coat(surface, ax, ay, az, bx, by, bz, dx, dy, dz, cosine)
        elif op == NORMAL_MAP:
            surface[NORMAL], surface[NORMAL + 1], surface[NORMAL + 2] = ax, ay, az
            surface[TILT] = bumps.tilt_of(ax, ay, az, bx, by, bz) if p != 0 else F(0)
        elif op == DISPLACED:
            x, y, z, w = _attribute(attributes, p, triangle, u + ax, v + ay)
        elif op == FOOTPRINT:
            x = y = z = footprint.pixel_size(rows[REGISTERS, 0], rows[REGISTERS, 1], rows[REGISTERS, 2], rows[REGISTERS, 3], ax, ay, az)
        elif op == TRANSLUCENT_CLOSURE:
            closures.translucent(surface, ax, ay, az, p, dx, dy, dz)
        rows[destination, 0], rows[destination, 1], rows[destination, 2], rows[destination, 3] = x, y, z, w
        at += 1
    closures.finish(surface)


@kernel
def evaluate_range(tables, materials, attributes, triangle, u, v, cosine, begin, end, surfaces):
    """`evaluate` for hits begin..end; triangle < 0 (no hit) leaves zeros.  See `batch.evaluate_batch`."""
    rows = new_registers(tables)
    surface = np.zeros(SURFACE, np.float32)
    for i in range(begin, end):
        if triangle[i] < 0:
            for k in range(SURFACE):
                surfaces[i, k] = F(0)
        else:
            evaluate(tables, materials[triangle[i]], attributes, triangle[i], u[i], v[i], cosine[i], rows, surface)
            for k in range(SURFACE):
                surfaces[i, k] = surface[k]


def with_viewer(scene: Scene, *, directly: bool) -> MaterialTables:
    """The scene's material tables; where a program asks for the size of a pixel, they know where its viewer is, and whether it sees them `directly`."""
    tables = scene.materials.tables
    if not (tables.code[:, 0] == FOOTPRINT).any():
        return tables
    constants = tables.constants.copy()
    constants[0] = footprint.viewer_row(scene, directly=directly)
    return tables._replace(constants=constants)


def empty_tables() -> MaterialTables:
    """Tables of no material."""
    return MaterialTables(
        code=np.zeros((1, 8), np.int32),
        constants=np.zeros((1, 4), F),
        start=np.zeros(0, np.int32),
        flags=np.zeros(0, np.int32),
        constant=np.zeros((0, SURFACE), F),
        texture_header=np.zeros((1, textures.HEADER), np.int32),
        texels_u8=np.zeros(4, np.uint8),
        texels_f32=np.zeros(4, F),
        functions=np.zeros(3, np.uint64),
    )
