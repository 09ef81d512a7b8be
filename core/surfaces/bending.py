"""How a ray goes on through glass: bent by Snell's law where it is clear, scattered where it is frosted, and where one ends that is bent."""

from __future__ import annotations

import math

import numpy as np

from ..jit import leaf
from ..rays.offsets import hit_point, offset_origin
from ..rays.trace import ALL, intersect1
from ..sampling.hashing import uniform
from ..scene import ANGLED, GLOSSY, REFRACTIVE, TRANSPARENT
from .arithmetic import normalized
from .frosted import seen_through
from .layout import BEND, FROST, REFRACTION, STRAY, TRANSPARENCY, as_if_whole, largest_kept
from .lobes import sample_lobe, set_lobe, specular_normal
from .normals import mapped_normal, sees_back, shading_normal
from .visibility import MAX_PASSED, OUTSIDE, STRAIGHT_ON, begins_in, bends_most, evaluate_along, is_lens, is_sheet, passed_glass

# Columns of the straight parts of a way (`nearest_reflected`): origin, direction, where along it the part begins and ends (m), and what weighs light
# that is met there.  PARTS: of a way at most.
ORIGIN, ALONG, BEGIN, END, WEIGHT, PART = 0, 3, 6, 7, 8, 11
PARTS = 16
GOES_STRAIGHT, TURNS, LOST = 0, 1, 2  # what glass does to a ray (`bent`)
# Square of the roughness, .31, up to which frosted glass bends what is seen: of rougher glass straight ways carry as much light as Cycles', bent ones up to a third more.
MOST_BENT = np.float32(0.095)
_0 = np.float32(0.0)
_1 = np.float32(1.0)


@leaf
def scattered(materials, geometry, material, triangle, u, v, dx, dy, dz, u1, u2, surface, lobe):
    """How a sample along d goes on through frosted glass, whose `surface` is evaluated: (origin, direction, weight), with weight 0 for nowhere."""
    x, y, z, gx, gy, gz, error = hit_point(geometry.vertices, geometry.triangles, triangle, u, v)
    sx, sy, sz = shading_normal(geometry.corner_normals, triangle, u, v, gx, gy, gz)
    sx, sy, sz = mapped_normal(materials, material, surface, sx, sy, sz)
    if gx * dx + gy * dy + gz * dz < _0:
        gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
    sx, sy, sz = specular_normal(sx, sy, sz, gx, gy, gz, dx, dy, dz)
    wx, wy, wz = seen_through(sx, sy, sz, -dx, -dy, -dz)
    set_lobe(lobe, sx, sy, sz, gx, gy, gz, wx, wy, wz, np.float32(math.sqrt(surface[FROST])), _1, _1, _1, _1, _1, _1)
    dx, dy, dz, w, _, _, _ = sample_lobe(lobe, u1, u2)
    if gx * dx + gy * dy + gz * dz <= _0:
        return x, y, z, dx, dy, dz, _0
    x, y, z = offset_origin(x, y, z, gx, gy, gz, error, dx, dy, dz)
    return x, y, z, dx, dy, dz, w


@leaf
def bent(materials, geometry, material, triangle, u, v, dx, dy, dz, surface, seen):
    """How a sample along d goes on through glass, whose `surface` is evaluated, by Snell's law: (`TURNS`, origin, direction), or `GOES_STRAIGHT`, or `LOST`.

    Only what has a thickness bends it for good; a solid's back bends it the other way.  Lost is what smooth normals would send back to the side from which it comes, as in Cycles
    (kernel/closure/bsdf_microfacet.h): going straight, it showed a lamp in the wall of a tumbler that shares its normals with the rim.  Photons, which are not `seen`, come
    from the other end, for which Cycles' rays have other normals: these are as they are, and nothing is lost.
    """
    x, y, z, gx, gy, gz, error = hit_point(geometry.vertices, geometry.triangles, triangle, u, v)
    sx, sy, sz = shading_normal(geometry.corner_normals, triangle, u, v, gx, gy, gz)
    sx, sy, sz = mapped_normal(materials, material, surface, sx, sy, sz)
    eta = _1 / surface[BEND]
    if gx * dx + gy * dy + gz * dz < _0:
        gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
    else:
        eta = surface[BEND]
    if seen:
        sx, sy, sz = specular_normal(sx, sy, sz, gx, gy, gz, dx, dy, dz)  # of the other side, and so is d
    cosine = sx * dx + sy * dy + sz * dz
    within = _1 - eta * eta * (_1 - cosine * cosine)
    if not (within > _0 and cosine > _0):
        return GOES_STRAIGHT, x, y, z, dx, dy, dz
    along = np.float32(math.sqrt(within)) - eta * cosine
    tx, ty, tz = normalized(eta * dx + along * sx, eta * dy + along * sy, eta * dz + along * sz)
    if gx * tx + gy * ty + gz * tz <= _0:
        return LOST if seen else GOES_STRAIGHT, x, y, z, dx, dy, dz
    x, y, z = offset_origin(x, y, z, gx, gy, gz, error, tx, ty, tz)
    return TURNS, x, y, z, tx, ty, tz


@leaf
def nearest_reflected(scene, packet, rows, surface, bends, whole, ox, oy, oz, dx, dy, dz, seed, path, dimension, entered, parts):
    """`nearest_surface` to a ray from a glossy lobe, which clear glass turns where it `bends`: what a polished table shows of a bottle.

    parts: (PARTS, PART) float32, where what lies between two surfaces is written, beyond lenses and sheets, or all of it if `whole`.  Of what shines there and hides
    nothing all must be counted, by the weight of the way so far: whether the way ends or passes at the next surface has no say in it.
    Returns what that does, t being the length of the whole way (m), and then by how much the surface is brighter that was made `as_if_whole` (1: it was not), whether a lens is on it, beyond which no shadow ray finds anything (2), or a sheet,
    beyond which none finds lamps (1; 0 for neither), the direction of its last part, and the number of parts.  Bent by Snell's law, as `bent` has it; what is frosted more than a little
    is passed straight.
    """
    r = g = b = clear = _1
    ex, ey, ez = dx, dy, dz
    start = before = x = y = z = _0
    glasses = sheets = fronts = n_parts = 0
    begun = entered
    for layer in range(MAX_PASSED):
        triangle, t, u, v = intersect1(scene.rays, ALL, packet, ox, oy, oz, ex, ey, ez, start, np.float32(np.inf), GLOSSY)
        turned = np.int64(1) if is_sheet(sheets) else np.int64(0)
        if is_lens(glasses, x, y, z, dx, dy, dz):
            turned = np.int64(2)
        if (whole or turned > 0) and n_parts < PARTS:
            part = parts[n_parts]
            part[ORIGIN], part[ORIGIN + 1], part[ORIGIN + 2] = ox, oy, oz
            part[ALONG], part[ALONG + 1], part[ALONG + 2] = ex, ey, ez
            part[BEGIN], part[END] = start, t if triangle >= 0 else np.float32(np.inf)
            part[WEIGHT], part[WEIGHT + 1], part[WEIGHT + 2] = r, g, b
            n_parts += 1
        if triangle < 0:
            return -1, _0, _0, np.float32(np.inf), r, g, b, clear, entered, _1, turned, ex, ey, ez, n_parts
        evaluate_along(scene, triangle, u, v, ex, ey, ez, GLOSSY, entered, rows, surface)
        flags = scene.materials.flags[scene.material[triangle]]
        behind = flags & REFRACTIVE != 0 and sees_back(scene.vertices, scene.triangles, triangle, ex, ey, ez)
        within = entered if behind else OUTSIDE
        chance = _0
        if flags & TRANSPARENT:  # in proportion, for what is reflected once more may be as bright: no path is worth more than others
            through = max(surface[TRANSPARENCY], surface[TRANSPARENCY + 1], surface[TRANSPARENCY + 2])
            chance = through / (through + largest_kept(surface)) if through > _0 else _0
        if uniform(seed, path, dimension, layer) >= chance:
            rest, brighter = _1 / (_1 - chance), _1
            if flags & TRANSPARENT and not flags & (REFRACTIVE | ANGLED):
                as_if_whole(surface, rest)
                rest, brighter = brighter, rest
            return triangle, u, v, before + t, r * rest, g * rest, b * rest, clear, within, brighter, turned, ex, ey, ez, n_parts
        tr, tg, tb = surface[TRANSPARENCY], surface[TRANSPARENCY + 1], surface[TRANSPARENCY + 2]
        r, g, b = r * tr / chance, g * tg / chance, b * tb / chance
        start = t + np.float32(1e-5) * abs(t)
        refracted = surface[REFRACTION] + surface[REFRACTION + 1] + surface[REFRACTION + 2]
        if not refracted > _0:
            continue
        clear *= max(_0, _1 - refracted / (tr + tg + tb))
        glasses += 1
        own = fronts == 0 and begins_in(surface, behind, begun)
        if own:
            begun -= 1
        else:
            sheets += bends_most(surface)
        fronts = max(fronts - 1, 0) if behind else fronts + 1
        nx, ny, nz = shading_normal(scene.corner_normals, triangle, u, v, _0, _0, _0)
        x, y, z = x + nx, y + ny, z + nz
        turn = GOES_STRAIGHT
        if bends and not own and surface[STRAY] <= MOST_BENT and abs(surface[BEND] - _1) > STRAIGHT_ON:
            turn, px, py, pz, fx, fy, fz = bent(scene.materials, scene, scene.material[triangle], triangle, u, v, ex, ey, ez, surface, True)
        if turn == LOST:
            break
        if turn == TURNS:  # it meets the back at the angle at which it is within
            ox, oy, oz, ex, ey, ez = px, py, pz, fx, fy, fz
            before, start = before + t, _0
        else:
            entered = passed_glass(entered, behind)
    return -1, _0, _0, np.float32(np.inf), _0, _0, _0, clear, entered, _1, np.int64(0), ex, ey, ez, n_parts
