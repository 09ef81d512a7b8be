"""Instant radiosity (Keller 1997) with bias compensation (Kollig & Keller 2004): the reference of all methods.

Every VPL lights every shading point through a shadow ray.  The geometry term is clamped at G_max, and what
that removes is given back by gather rays that reach just so far as G can exceed G_max: weight
(G - G_max) / G times the light that leaves the surface they meet.
"""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from ..particles import Vpls, is_ahead
from ..rays.offsets import hit_point, offset_origin, shadow_segment
from ..rays.packet import T_FAR, WIDTH, disable_ray, hit_triangle, hit_u, hit_v, new_packet, set_ray
from ..rays.trace import ALL, intersect_packet
from ..sampling.maps import cosine_hemisphere, to_world
from ..sampling.sequences import r2
from ..scene import DIFFUSE, TRANSPARENT
from ..surfaces.layout import SURFACE
from ..surfaces.lobes import LOBE
from ..surfaces.normals import mapped_normal, shading_normal
from ..surfaces.program import new_registers
from ..surfaces.visibility import OUTSIDE, evaluate_along, nearest_surface, shadow_packet
from ..threads import Progress, run_chunks
from ..transport import Transport
from ..view.points import ShadingPoints
from .light_cache import NEAR, no_cache
from .tails import path_light

CHUNK = 256  # points a chunk: neighbours in the picture, so that a VPL's rays to them are coherent
_0 = np.float32(0.0)
_1 = np.float32(1.0)
_INV_PI = np.float32(1.0 / np.pi)


@kernel
def geometry_terms(position, ns, ng, begin, end, x, y, z, nx, ny, nz, g):
    """G of one VPL at the points begin..end-1 into g; 0 where either looks away."""
    for i in range(begin, end):
        dx, dy, dz = x - position[i, 0], y - position[i, 1], z - position[i, 2]
        r2 = max(dx * dx + dy * dy + dz * dz, np.float32(1e-30))
        at_point = max(_0, ns[i, 0] * dx + ns[i, 1] * dy + ns[i, 2] * dz)
        above = ng[i, 0] * dx + ng[i, 1] * dy + ng[i, 2] * dz
        at_light = max(_0, -(nx * dx + ny * dy + nz * dz))
        g[i - begin] = at_point * at_light / (r2 * r2) if above > 0 else _0


@kernel
def _shade(scene, vpls, points, begin, end, g_max, visibility, cutouts, out):
    """Irradiance of all VPLs on the points begin..end-1 into out (N, 3); the shadow rays traced."""
    n = end - begin
    g = np.empty(n, np.float32)
    lane_of = np.empty(WIDTH, np.int32)
    through = np.ones((WIDTH, 3), np.float32)
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    rows = new_registers(scene.materials)
    rays = 0
    # Sums of sums: the error of adding thousands of VPLs stays that of hundreds.
    part = np.zeros((n, 3), np.float32)
    for j in range(len(vpls.bounce)):
        if j % 256 == 0:
            for i in range(n):
                for c in range(3):
                    out[begin + i, c] += part[i, c]
                    part[i, c] = _0
        x, y, z = vpls.position[j, 0], vpls.position[j, 1], vpls.position[j, 2]
        nx, ny, nz = vpls.normal[j, 0], vpls.normal[j, 1], vpls.normal[j, 2]
        geometry_terms(points.position, points.ns, points.ng, begin, end, x, y, z, nx, ny, nz, g)
        r, gr, b = vpls.flux[j, 0] * _INV_PI, vpls.flux[j, 1] * _INV_PI, vpls.flux[j, 2] * _INV_PI
        i = 0
        while i < n:
            lanes = 0
            while i < n and lanes < WIDTH:
                if g[i] > 0:
                    lane_of[lanes] = i
                    lanes += 1
                i += 1
            if lanes == 0:
                break
            if visibility:
                for lane in range(lanes):
                    k = begin + lane_of[lane]
                    px, py, pz = points.position[k, 0], points.position[k, 1], points.position[k, 2]
                    gx, gy, gz = points.ng[k, 0], points.ng[k, 1], points.ng[k, 2]
                    ox, oy, oz, dx, dy, dz = shadow_segment(px, py, pz, gx, gy, gz, points.error[k], x, y, z, nx, ny, nz, vpls.error[j])
                    set_ray(packet, lane, ox, oy, oz, dx, dy, dz, _0, _1, DIFFUSE)
                shadow_packet(scene, packet, rows, surface, lanes, DIFFUSE, cutouts, through)
                rays += lanes
            for lane in range(lanes):
                k = lane_of[lane]
                f = min(g[k], g_max)
                tr, tg, tb = through[lane, 0], through[lane, 1], through[lane, 2]
                at = points.position[begin + k]
                if cutouts and not is_ahead(vpls, j, at[0], at[1], at[2]):
                    continue
                part[k, 0] += f * r * tr
                part[k, 1] += f * gr * tg
                part[k, 2] += f * b * tb
    for i in range(n):
        for c in range(3):
            out[begin + i, c] += part[i, c]
    return rays


@kernel
def compensate(scene, cache, points, begin, end, g_max, samples, bounces, seed, out):
    """Adds what the clamp took from the points begin..end-1, by `samples` gather rays each; the rays traced.

    cache: where paths may end; `no_cache()` knows nothing.

    Kollig & Keller 2004, "Illumination in the Presence of Weak Singularities", Eq. 5.
    """
    packet = new_packet()
    surface = np.zeros(SURFACE, np.float32)
    lobe = np.zeros(LOBE, np.float32)
    rows = new_registers(scene.materials)
    direction = np.empty((WIDTH, 3), np.float32)
    found = np.empty(WIDTH, np.int32)
    hit_uv = np.empty((WIDTH, 2), np.float32)
    share = _1 / np.float32(samples)
    near = np.float32(NEAR) * cache.size if len(cache.share) > 0 else np.float32(np.inf)
    rays = 0
    for base in range(begin, end, WIDTH):
        lanes = min(WIDTH, end - base)
        for s in range(samples):
            for lane in range(lanes):
                k = base + lane
                u1, u2 = r2(s, np.uint32(seed) ^ np.uint32(np.uint32(k) * np.uint32(2654435761)))
                lx, ly, lz = cosine_hemisphere(u1, u2)
                dx, dy, dz = to_world(lx, ly, lz, points.ns[k, 0], points.ns[k, 1], points.ns[k, 2])
                direction[lane, 0], direction[lane, 1], direction[lane, 2] = dx, dy, dz
                gx, gy, gz = points.ng[k, 0], points.ng[k, 1], points.ng[k, 2]
                if dx * gx + dy * gy + dz * gz <= 0:
                    disable_ray(packet, lane)
                    continue
                # Farther away than this, G <= cos / r^2 is below the clamp.
                reach = np.sqrt(lz / g_max)
                ox, oy, oz = offset_origin(
                    points.position[k, 0], points.position[k, 1], points.position[k, 2], gx, gy, gz, points.error[k], dx, dy, dz
                )
                set_ray(packet, lane, ox, oy, oz, dx, dy, dz, _0, reach, DIFFUSE)
                rays += 1
            intersect_packet(scene.rays, ALL, packet, lanes)
            for lane in range(lanes):
                found[lane] = hit_triangle(packet, lane)
                hit_uv[lane, 0], hit_uv[lane, 1] = hit_u(packet, lane), hit_v(packet, lane)
                if packet.f[T_FAR * WIDTH + lane] < 0:
                    found[lane] = -1
            for lane in range(lanes):
                triangle = found[lane]
                if triangle < 0:
                    continue
                k = base + lane
                dx, dy, dz = direction[lane, 0], direction[lane, 1], direction[lane, 2]
                px, py, pz = points.position[k, 0], points.position[k, 1], points.position[k, 2]
                path = np.uint32(k * samples + s)
                u, v = hit_uv[lane, 0], hit_uv[lane, 1]
                wr = wg = wb = _1
                entered = OUTSIDE
                veiled = scene.materials.flags[scene.material[triangle]] & TRANSPARENT != 0
                if veiled:
                    cosine = points.ns[k, 0] * dx + points.ns[k, 1] * dy + points.ns[k, 2] * dz
                    ox, oy, oz = offset_origin(px, py, pz, points.ng[k, 0], points.ng[k, 1], points.ng[k, 2], points.error[k], dx, dy, dz)
                    triangle, u, v, _, wr, wg, wb, _, entered = nearest_surface(
                        scene, packet, rows, surface, ox, oy, oz, dx, dy, dz, np.sqrt(cosine / g_max), DIFFUSE, seed, path, 60, OUTSIDE
                    )
                    if triangle < 0:
                        continue
                x, y, z, gx, gy, gz, error = hit_point(scene.vertices, scene.triangles, triangle, u, v)
                cos_y = -(gx * dx + gy * dy + gz * dz)
                ex, ey, ez = x - px, y - py, z - pz
                r2_ = max(ex * ex + ey * ey + ez * ez, np.float32(1e-30))
                cos_x = points.ns[k, 0] * dx + points.ns[k, 1] * dy + points.ns[k, 2] * dz
                g = cos_x * abs(cos_y) / r2_
                if g <= g_max or not max(wr, wg, wb) > 0:
                    continue
                if not veiled:  # not before: of half of the hits nothing was taken, and to shade one costs as much as its ray
                    evaluate_along(scene, triangle, u, v, dx, dy, dz, DIFFUSE, OUTSIDE, rows, surface)
                sx, sy, sz = shading_normal(scene.corner_normals, triangle, u, v, gx, gy, gz)
                sx, sy, sz = mapped_normal(scene.materials, scene.material[triangle], surface, sx, sy, sz)
                if cos_y < 0:
                    gx, gy, gz, sx, sy, sz = -gx, -gy, -gz, -sx, -sy, -sz
                w = (g - g_max) / g * share
                path_light(
                    scene, packet, rows, surface, lobe, cache, near, triangle, x, y, z, error, gx, gy, gz, sx, sy, sz, -dx, -dy, -dz, entered,
                    bounces, False, seed, path, out, k, w * wr, w * wg, w * wb, _1, _1, _1, _1, _0, _1, False, _1,
                )  # fmt: skip
    return rays


def _some(rng: np.random.Generator, n: int, most: int) -> np.ndarray:
    """Indices of `most` out of n things, drawn at random; of all of them where they are not more."""
    return rng.integers(0, n, most) if n > most else np.arange(n)


@kernel
def _unshadowed(position, ns, lights, normals, flux):
    """Light of M lights of given flux (M,) that reaches each of P points (P, 3) if nothing is in its way: (P,) float64."""
    light = np.zeros(len(position))
    for i in range(len(position)):
        x, y, z = np.float64(position[i, 0]), np.float64(position[i, 1]), np.float64(position[i, 2])
        for j in range(len(lights)):
            dx, dy, dz = lights[j, 0] - x, lights[j, 1] - y, lights[j, 2] - z
            here = ns[i, 0] * dx + ns[i, 1] * dy + ns[i, 2] * dz
            there = -(normals[j, 0] * dx + normals[j, 1] * dy + normals[j, 2] * dz)
            if here > 0 and there > 0:
                r2 = max(dx * dx + dy * dy + dz * dz, 1e-30)
                light[i] += here * there / (r2 * r2) * flux[j]
    return light


def clamp_of(vpls: Vpls, points: ShadingPoints, share: float = 0.05, subset: int = 256, seed: int = 0) -> float:
    """G_max at which one mean VPL gives at most `share` of the mean irradiance of the points (unshadowed).

    The light of a single VPL is then never seen as a spot, and gather rays stay a few VPL distances short.
    """
    if len(vpls.bounce) == 0 or len(points.pixel) == 0:
        return np.inf
    rng = np.random.default_rng(seed)
    at, by = _some(rng, len(points.pixel), subset), _some(rng, len(vpls.bounce), 1024)
    flux = vpls.flux[by].astype(np.float64).mean(-1)
    # The mean over the points of each point's mean, or of what three quarters of them have less than: single close pairs do not decide,
    # nor does a floor of which no point sees the patch of sun on it.
    light = _unshadowed(points.position[at], points.ns[at], vpls.position[by], vpls.normal[by], flux) / len(by)
    mean = light.mean()
    light = np.minimum(light, np.quantile(light, 0.75)).mean() * len(vpls.bounce)
    mean_flux = vpls.flux.astype(np.float64).mean()
    if not (light > 0 and mean_flux > 0):
        light = max(mean * len(vpls.bounce), 1e-30)
    return float(share * light / max(mean_flux, 1e-30))


class InstantRadiosity:
    """All VPLs on all shading points.

    visibility: 'rays' or 'none'.  compensation: gather rays a point that give back the clamped light (0: none).
    """

    def __init__(self, *, visibility: str = "rays", compensation: int = 16, bounces: int = 4, seed: int = 0, threads: int = 0):
        self.visibility = visibility
        self.compensation = compensation
        self.bounces = bounces
        self.seed = seed
        self.threads = threads
        self.rays = 0
        self.pairs = 0

    def prepare(self, scene: Transport, vpls: Vpls, points: ShadingPoints) -> None:
        """Takes the scene and its VPLs; `points` only sets the scale of the clamp."""
        self.scene = scene
        self.vpls = vpls
        self.g_max = np.float32(clamp_of(vpls, points))

    def irradiance(self, points: ShadingPoints, progress: Progress | None = None) -> np.ndarray:
        """Indirect irradiance at N points, (N, 3) float32, W/m^2."""
        n = len(points.pixel)
        out = np.zeros((n, 3), np.float32)
        cutouts = bool((self.scene.materials.flags & TRANSPARENT).any())

        def work(begin, end):
            rays = _shade(self.scene, self.vpls, points, begin, end, self.g_max, self.visibility == "rays", cutouts, out)
            if self.compensation and np.isfinite(self.g_max):
                rays += compensate(
                    self.scene, no_cache(), points, begin, end, self.g_max, self.compensation, self.bounces, np.uint32(self.seed + 1), out
                )
            return rays

        self.rays += sum(run_chunks(work, n, CHUNK, self.threads, progress))
        self.pairs += n * len(self.vpls.bounce)
        return out
