"""Light through cut-outs: what share of it passes the transparent surfaces between two points, and where a ray ends.

Glass is the surface of a solid, as in Cycles: a ray that meets its back without having entered a front began within the solid, and may be
reflected totally.  Sheets without thickness are such surfaces, and water, and what lies inside of panes is in them.  `entered` counts the
fronts that a ray has passed since its path was last scattered, less the backs.

Materials whose nodes ask for the side or the angle of the view are seen by each ray as it meets them, as in Cycles, where a ray goes from
the eye's side to the light's.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, kernel, leaf
from ..rays.packet import DIR_X, DIR_Y, DIR_Z, OCCLUDED, ORG_X, ORG_Y, ORG_Z, T_FAR, T_NEAR, WIDTH
from ..rays.trace import ALL, COHERENT, CUTOUT, OPAQUE, intersect1, occluded_packet
from ..sampling.hashing import uniform
from ..scene import ANGLED, DIFFUSE, GLOSSY, REFRACTIVE, TRANSPARENT
from .layout import BEND, FROST, REFRACTION, STRAY, TRANSPARENCY, as_if_whole, passing_chance
from .lobes import seen_cosine
from .normals import geometric_normal, sees_back, shading_normal
from .program import MEAN_VIEW, evaluate, from_within, reflected_view, specular_view

STRAIGHT_ON = np.float32(1e-3)  # distance of an index of refraction from 1 up to which glass bends nothing
_BENDING = 0.2  # of the sum of normals across a ray: a tenth of a radian in glass
# Square of the roughness from which on glass scatters light: a pane of a roughness of .2 by about two degrees.
SCATTERING = np.float32(0.2 * 0.2)
# Instead of the share of light that passed no glass: a lens throws it elsewhere, or frosted glass scatters it, of which lobes know nothing.
BY_LENS, BY_FROST = np.float32(-1.0), np.float32(-2.0)
MAX_PASSED = 128  # transparent surfaces on one segment; what lies behind more counts as dark
_0 = np.float32(0.0)
_1 = np.float32(1.0)
OUTSIDE = np.int64(0)  # solids that a path has entered which was scattered just now


@inlined
def _evaluate_along(scene, triangle, u, v, dx, dy, dz, kind, entered, rows, surface):
    """`evaluate_along`, which also returns the shading normal (unit; 0 where the view does not matter) and whether the back of glass is seen."""
    material = scene.material[triangle]
    flags = scene.materials.flags[material]
    cosine = np.float32(MEAN_VIEW)
    nx = ny = nz = _0
    behind = False
    if flags & (REFRACTIVE | ANGLED):
        nx, ny, nz = shading_normal(scene.corner_normals, triangle, u, v, _0, _0, _0)
        length = np.float32(math.sqrt(dx * dx + dy * dy + dz * dz))
        gx = gy = gz = _0
        if flags & REFRACTIVE:
            gx, gy, gz = geometric_normal(scene.vertices, scene.triangles, triangle)
        cosine = seen_cosine(flags, nx, ny, nz, gx, gy, gz, dx / length, dy / length, dz / length)
        behind = sees_back(scene.vertices, scene.triangles, triangle, dx, dy, dz)
        cosine = -cosine if behind else cosine
        cosine = reflected_view(cosine) if kind == DIFFUSE else specular_view(cosine, kind)
        behind = behind and flags & REFRACTIVE != 0
        if behind and entered == 0:
            cosine = from_within(cosine)
    evaluate(scene.materials, material, scene.attributes, triangle, u, v, cosine, rows, surface)
    return nx, ny, nz, behind


@leaf
def evaluate_along(scene, triangle, u, v, dx, dy, dz, kind, entered, rows, surface):
    """The surface that a ray meets, into `surface`: glass and ANGLED materials at the ray's angle, all others as the mean over the views.

    kind: what the ray is to the material: DIFFUSE, GLOSSY or SHADOW.  entered: how many solids of glass it has entered.
    """
    _evaluate_along(scene, triangle, u, v, dx, dy, dz, kind, entered, rows, surface)


@leaf
def evaluate_from(scene, triangle, u, v, behind, x, rows, surface):
    """An ANGLED surface, into `surface`, as a view of its front or its back sees it that x, uniform in [0, 1), draws by the cosine.

    Light that is scattered diffusely leaves by such angles: the mean of what it carries is right, whatever the nodes make of the angle.
    """
    cosine = np.float32(math.sqrt(x))
    view = reflected_view(-cosine if behind else cosine)
    evaluate(scene.materials, scene.material[triangle], scene.attributes, triangle, u, v, view, rows, surface)


@inlined
def encloses(flags, behind):
    """Whether a surface is the inner side of a pane that reflects by the angle: what lamps send in there is not what it mirrors to a view.

    `tails` spreads the lamps' light that a mirror reflects as if it were dull; beyond the critical angle, where all is reflected and nothing
    comes in, a pane would shine by that.
    """
    return behind and flags & (ANGLED | TRANSPARENT | REFRACTIVE) == ANGLED | TRANSPARENT


@inlined
def passed_glass(entered, behind):
    """`entered` after one more surface of glass."""
    return max(entered - 1, OUTSIDE) if behind else entered + 1


@inlined
def is_lens(glasses, x, y, z, dx, dy, dz):
    """Whether so many surfaces of glass, whose outward normals add up to (x, y, z), turn a ray along d aside.

    One side alone, as a pool's surface or a pane without thickness, is no lens (but see `is_sheet`).  A ray turns by about (IOR - 1) times what that sum has across it: nothing in panes, little in the walls of bulbs and bottles.
    """
    along = (x * dx + y * dy + z * dz) / (dx * dx + dy * dy + dz * dz)
    x, y, z = x - along * dx, y - along * dy, z - along * dz
    return glasses % 2 == 0 and x * x + y * y + z * z > np.float32(_BENDING * _BENDING)


@inlined
def bends_most(surface):
    """Whether most of what a surface lets through is bent by glass."""
    refracted = surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2]
    through = surface[TRANSPARENCY] + surface[TRANSPARENCY + 1] + surface[TRANSPARENCY + 2]
    return refracted > np.float32(0.5) * through and abs(surface[BEND] - _1) > STRAIGHT_ON


@inlined
def stray(surface):
    """Square of the roughness of the glass by which most of what a surface lets through is scattered, 0 for none.

    Seen from where it arrives, a lamp behind frosted glass is blurred in proportion to this and to the part of its way that lies behind the glass: not by its own
    shade, but as a sun is by a skylight.  From `SCATTERING` on its light is photons', and casts no shadows as if it went straight.
    """
    refracted = surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2]
    through = surface[TRANSPARENCY] + surface[TRANSPARENCY + 1] + surface[TRANSPARENCY + 2]
    return surface[STRAY] if refracted > np.float32(0.5) * through else _0


@inlined
def begins_in(surface, behind, begun):
    """Whether a way that began within so many solids (`begun`) leaves one by its frosted side: a pane whose front the camera has passed shows in its
    lobe what lies beyond its back, and is no sheet to that.
    """
    return behind and begun > 0 and surface[FROST] > _0


@inlined
def is_sheet(bends):
    """Whether so many surfaces at which glass bends a ray (`bends_most`) leave one of its ends in glass: then a sheet without thickness is on its way, or a pool's surface.

    What comes from all around shines through that as if it went straight: it is as bright beyond.  A lamp sends the square of the index as much light
    to what lies out of the glass, and that part of it to what lies within, and no light beyond the critical angle.
    """
    return bends % 2 == 1


@leaf
def transmittance1(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, t_near, t_far, kinds, kind, entered, lamp):
    """Transmittance (r, g, b) of the transparent triangles along one segment, and the share of it that passed no glass: `BY_LENS` where a lens is in the
    way, `BY_FROST` where frosted glass is that scatters a lamp's light.

    For segments that the OPAQUE set does not block.  packet, rows, surface: scratch (`new_packet`,
    `new_registers`, (SURFACE,) float32); the packet's lanes stay as they are.  The segment begins where the light arrives.
    kinds: of rays, as bits, that what is in the way must be seen by.  kind: what the ray is to materials (see `evaluate_along`).
    entered: solids of glass that the path has entered before.  lamp: whether the light is a lamp's, to which a sheet (`is_sheet`) is a lens.
    """
    r = g = b = clear = _1
    x = y = z = _0
    glasses = bends = fronts = 0
    begun = entered
    owed = _1
    frosted = False
    start = t_near
    for _ in range(MAX_PASSED):
        triangle, t, u, v = intersect1(scene.rays, CUTOUT, packet, ox, oy, oz, dx, dy, dz, start, t_far, kinds)
        if triangle < 0:
            if lamp and is_sheet(bends):
                return owed * r, owed * g, owed * b, BY_LENS
            if is_lens(glasses, x, y, z, dx, dy, dz):
                return r, g, b, BY_LENS
            return r, g, b, BY_FROST if frosted else clear
        nx, ny, nz, behind = _evaluate_along(scene, triangle, u, v, dx, dy, dz, kind, entered, rows, surface)
        out = lamp and behind and entered == 0
        if out:  # as its front lets the lamp's light in
            evaluate_along(scene, triangle, u, v, -dx, -dy, -dz, kind, entered, rows, surface)
        r *= surface[TRANSPARENCY]
        g *= surface[TRANSPARENCY + 1]
        b *= surface[TRANSPARENCY + 2]
        if not max(r, g, b) > np.float32(1e-4):
            break
        through = surface[TRANSPARENCY] + surface[TRANSPARENCY + 1] + surface[TRANSPARENCY + 2]
        refracted = (surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2]) / through
        if refracted > _0:
            clear *= max(_0, _1 - refracted)
            glasses += 1
            own = lamp and fronts == 0 and begins_in(surface, behind, begun)
            frosted |= lamp and not own and stray(surface) * (_1 - t / t_far) >= SCATTERING
            if own:
                begun -= 1
            elif lamp and bends_most(surface):
                bends += 1
                square = surface[BEND] * surface[BEND]
                if out:
                    owed = _1 / square
                elif not behind:
                    cosine = (nx * dx + ny * dy + nz * dz) ** 2 / (dx * dx + dy * dy + dz * dz)
                    owed = square if square * (_1 - cosine) < _1 else _0
            fronts = max(fronts - 1, 0) if behind else fronts + 1
            entered = passed_glass(entered, behind)
            x, y, z = x + nx, y + ny, z + nz
        start = t + np.float32(1e-5) * abs(t)
    return _0, _0, _0, _1


@kernel
def shadow_packet(scene, packet, rows, surface, count, kinds, cutouts, transmitted):
    """Trace the shadow rays in lanes 0..count-1, which go much the same way, and write what they let through into `transmitted` (16, 3).

    cutouts: whether the scene has transparent triangles at all.  Only the rays that meet one are walked singly.
    """
    occluded_packet(scene.rays, OPAQUE | COHERENT, packet, count)
    waiting = False
    for lane in range(count):
        open_ = _0 if packet.f[T_FAR * WIDTH + lane] == OCCLUDED else _1
        transmitted[lane, 0] = transmitted[lane, 1] = transmitted[lane, 2] = open_
        waiting |= open_ > 0
    if not cutouts or not waiting:
        return
    # Lanes that are blocked already have an empty range and cost nothing here.
    f = packet.f
    end = np.empty(WIDTH, np.float32)
    for lane in range(count):
        end[lane] = f[T_FAR * WIDTH + lane]
    occluded_packet(scene.rays, CUTOUT, packet, count)
    for lane in range(count):
        if end[lane] != OCCLUDED and f[T_FAR * WIDTH + lane] == OCCLUDED:
            transmitted[lane, 0], transmitted[lane, 1], transmitted[lane, 2], _ = transmittance1(
                scene, packet, rows, surface,
                f[ORG_X * WIDTH + lane], f[ORG_Y * WIDTH + lane], f[ORG_Z * WIDTH + lane],
                f[DIR_X * WIDTH + lane], f[DIR_Y * WIDTH + lane], f[DIR_Z * WIDTH + lane],
                f[T_NEAR * WIDTH + lane], end[lane], kinds, DIFFUSE, OUTSIDE, False,
            )  # fmt: skip


@leaf
def nearest_surface(scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, reach, kinds, seed, path, dimension, entered):
    """The nearest surface along a ray that does not let it through, its material evaluated into `surface` (`as_if_whole`, where it lets others through).

    entered: solids of glass that the path has entered before.
    Returns (triangle or -1, u, v, t, r, g, b, clear, entered): (r, g, b) weighs what is seen, or what lies beyond all surfaces, for
    what was passed; clear is the share of it that passed no glass; entered, where the surface is the back of glass: solids that the path is in, else 0.
    """
    r = g = b = clear = _1
    start = _0
    for layer in range(MAX_PASSED):
        triangle, t, u, v = intersect1(scene.rays, ALL, packet, ox, oy, oz, dx, dy, dz, start, reach, kinds)
        if triangle < 0:
            return -1, _0, _0, reach, r, g, b, clear, entered
        _, _, _, behind = _evaluate_along(scene, triangle, u, v, dx, dy, dz, GLOSSY if kinds == GLOSSY else DIFFUSE, entered, rows, surface)
        within = entered if behind else OUTSIDE
        flags = scene.materials.flags[scene.material[triangle]]
        if not flags & TRANSPARENT:
            return triangle, u, v, t, r, g, b, clear, within
        tr, tg, tb = surface[TRANSPARENCY], surface[TRANSPARENCY + 1], surface[TRANSPARENCY + 2]
        chance = passing_chance(surface, flags & ANGLED != 0)
        if uniform(seed, path, dimension, layer) >= chance:
            rest = _1 / (_1 - chance)
            if not flags & (REFRACTIVE | ANGLED):
                as_if_whole(surface, rest)
                rest = _1
            return triangle, u, v, t, r * rest, g * rest, b * rest, clear, within
        refracted = surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2]
        if refracted > _0:
            clear *= max(_0, _1 - refracted / (tr + tg + tb))
            entered = passed_glass(entered, behind)
        r, g, b = r * tr / chance, g * tg / chance, b * tb / chance
        start = t + np.float32(1e-5) * abs(t)
    return -1, _0, _0, reach, _0, _0, _0, clear, entered
