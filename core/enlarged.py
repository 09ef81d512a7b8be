"""Light of a small picture in a large one: what is next to smooth comes from few pixels, what is sharp from the view itself.

Where there is no time to light every pixel, a smaller picture of the same view is lit, and what the camera sees is traced at full size.  A pixel's
light is the mean of what pixels around it in the small picture have, by how near they lie and how alike their normals and planes are (joint
bilateral upsampling, Kopf, Cohen, Lischinski & Uyttendaele 2007), by the ratio to what surfaces reflect there.  Albedo, emission, normals, depth
and all their edges are those of the view.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .denoise import mean_factor
from .jit import inlined, kernel, leaf
from .picture import GroupLight, Picture, denoising_guides, splat
from .scene import Camera
from .threads import run_chunks
from .view.points import glossy_albedos
from .view.primary import View

LINES = 8  # of pixels a chunk
REACH = 1  # pixels of the small picture, to each side of the nearest one
AWAY = np.float32(REACH + 0.5)  # where a pixel counts no more: farther than any that is looked at, so that none comes in with a step
OFF_PLANE = np.float32(1.0)  # widths of them off the plane that count a quarter
UNLIKE = np.float32(0.3)  # difference of albedo and emission that counts half
REGARDLESS = np.float32(1e-4)  # of the weight goes by nearness alone: a thin thing may show in no small pixel
BEYOND = np.float32(1e9)  # depth (m) of nothing
_0 = np.float32(0)
_1 = np.float32(1)


class Guides(NamedTuple):
    """What tells which pixels of two pictures are alike, (H, W, 3) float32 but for depth (H, W).

    normal: mean of the samples.  position (m), depth: of the nearest one.  look: albedo and, of what shines, how much (0..1 and more).
    """

    normal: np.ndarray
    position: np.ndarray
    depth: np.ndarray
    look: np.ndarray

    @staticmethod
    def of(normal: np.ndarray, position: np.ndarray, depth: np.ndarray, albedo: np.ndarray, emission: np.ndarray) -> Guides:
        """By albedo and emission; a lamp's own light differs from what it is set into."""
        return Guides(*(np.ascontiguousarray(part) for part in (normal, position, depth, albedo + emission / (_1 + emission))))


class Whole(NamedTuple):
    """What the camera sees of a picture whose light comes from a smaller one, (H, W, 3) float32 each but for `seen`.

    gloss: what lobes reflect.  guide_albedo, guide_normal: of `denoising_guides`.  sharp: radiance of diffuse surfaces by lamps with sharp
    shadows, as in `Picture`; None where it comes from the smaller picture, too.
    """

    seen: View
    gloss: np.ndarray
    guide_albedo: np.ndarray
    guide_normal: np.ndarray
    sharp: np.ndarray | None

    @staticmethod
    def of(seen: View, sharp: np.ndarray | None) -> Whole:
        """sharp: irradiance (N, 3) at the points."""
        points = seen.points
        if sharp is not None:
            sharp = splat(points, (points.behind_glass == 0)[:, None] * points.albedo * np.float32(1 / np.pi) * sharp, seen.shape)
        return Whole(seen, splat(points, glossy_albedos(points), seen.shape), *denoising_guides(seen), sharp)


@inlined
def _near(distance):
    """Biweight kernel of a distance (pixels)."""
    x = distance / AWAY
    y = max(_0, _1 - x * x)
    return y * y


@leaf
def _weight(own, small, y, x, row, column, near, width):
    """How much a pixel (row, column) of the `small` picture tells of the pixel (y, x), which counts as `near`."""
    if small.depth[row, column] >= BEYOND or own.depth[y, x] >= BEYOND:
        return near * REGARDLESS
    cosine = off = unlike = _0
    for c in range(3):
        cosine += own.normal[y, x, c] * small.normal[row, column, c]
        off += own.normal[y, x, c] * (small.position[row, column, c] - own.position[y, x, c])
        unlike += abs(own.look[y, x, c] - small.look[row, column, c])
    cosine = max(cosine, _0)
    cosine *= cosine
    cosine *= cosine
    off /= OFF_PLANE * width
    unlike /= UNLIKE
    alike = cosine * cosine / ((_1 + off * off) * (_1 + off * off) * (_1 + unlike * unlike))
    return near * (REGARDLESS + alike)


@kernel
def _interpolate(own, small, values, place, width, top, bottom, out):
    """Means `out` (H, W, C) of the values (h, w, C) of a small picture around the pixels of the rows top..bottom-1.

    own, small: `Guides` of both.  place: (4,) float32, small pixels a pixel down and across, and where the middle of the first one lies.  width: (H, W) float32, of a small pixel (m).
    """
    rows, columns, channels = values.shape
    for y in range(top, bottom):
        cy = place[0] * np.float32(y) + place[2]
        for x in range(own.depth.shape[1]):
            cx = place[1] * np.float32(x) + place[3]
            ny, nx = np.int64(math.floor(cy + np.float32(0.5))), np.int64(math.floor(cx + np.float32(0.5)))
            whole = _0
            for row in range(max(0, ny - REACH), min(rows, ny + REACH + 1)):
                for column in range(max(0, nx - REACH), min(columns, nx + REACH + 1)):
                    dy, dx = np.float32(row) - cy, np.float32(column) - cx
                    w = _weight(own, small, y, x, row, column, _near(dy) * _near(dx), width[y, x])
                    whole += w
                    for c in range(channels):
                        out[y, x, c] += w * values[row, column, c]
            if whole > _0:
                for c in range(channels):
                    out[y, x, c] /= whole


def _place(small: Camera, camera: Camera) -> np.ndarray:
    """Where the pixels of a camera's border lie among those of the same camera's smaller picture, as `_interpolate` has it."""
    scale = small.height / camera.height, small.width / camera.width
    begins = [(0.5 + camera.border[1 - k]) * scale[k] - small.border[1 - k] - 0.5 for k in range(2)]
    return np.array([*scale, *begins], np.float32)


def _pixel_width(camera: Camera, small: Camera, depth: np.ndarray) -> np.ndarray:
    """Of a pixel of the small picture where each pixel's surface lies, (H, W) float32 m."""
    across = np.float32(abs(camera.window[1] - camera.window[0]) / small.width)
    return np.full_like(depth, across) if camera.orthographic else across * depth


def enlarged(picture: Picture, whole: Whole, small: Camera, camera: Camera, threads: int = 0) -> Picture:
    """The light of a denoised `picture` of the camera `small` in what the same `camera` sees of the `whole`.

    picture: without what shines behind glass.  Light of lamps with sharp shadows is that of the `whole`, where that knows it; else the means of the
    picture's layers stay.  Guides and what passes alone know are gone: the result is to be looked at, not to be denoised or averaged.
    """
    seen, gloss = whole.seen, whole.gloss
    small_gloss = np.zeros_like(picture.albedo) if picture.glossy_albedo is None else picture.glossy_albedo
    own = [seen.albedo + gloss, seen.albedo, gloss + whole.guide_albedo - seen.albedo]  # the last is what glass lets through
    by = [picture.albedo + small_gloss, picture.albedo, small_gloss + picture.guide_albedo - picture.albedo]
    own_shadows = whole.sharp is not None and picture.sharp is not None
    lights = [picture.direct - picture.sharp if own_shadows else picture.direct, picture.diffuse_indirect, picture.glossy_indirect]
    parts = lights + by
    parts += [part for light in picture.groups.values() for part in (light.direct, light.diffuse_indirect + light.glossy_indirect)]
    values = np.concatenate(parts, axis=2)
    found = np.zeros((*seen.shape, values.shape[2]), np.float32)
    width = _pixel_width(camera, small, seen.depth)
    normal = picture.guide_normal if picture.own_normal is None else picture.own_normal
    guides = Guides.of(seen.mean_normal, seen.position, seen.depth, seen.albedo, seen.emission)
    small_guides = Guides.of(normal, picture.position, picture.depth, picture.albedo, picture.emission)
    tables = guides, small_guides, values, _place(small, camera), width
    run_chunks(lambda top, bottom: _interpolate(*tables, top, bottom, found), seen.shape[0], LINES, threads)
    found = [np.ascontiguousarray(found[..., k : k + 3]) for k in range(0, found.shape[2], 3)]

    def modulated(k: int) -> np.ndarray:
        light = own[k] * np.divide(found[k], found[3 + k], out=np.zeros_like(found[k]), where=found[3 + k] > 0)
        return light * mean_factor(lights[k], light, threads)

    direct, diffuse, glossy = (modulated(k) for k in range(3))
    if own_shadows:
        direct += whole.sharp
    # Lamps and skies behind glass are as sharp as what is in front of it.
    direct, glossy = direct + seen.emission_behind_one, glossy + seen.emission_behind_more
    return replace(
        picture,
        direct=direct,
        diffuse_indirect=diffuse,
        glossy_indirect=glossy,
        albedo=seen.albedo,
        emission=seen.emission,
        normal=seen.normal,
        guide_albedo=whole.guide_albedo,
        guide_normal=whole.guide_normal,
        foreseen=np.zeros_like(diffuse),
        position=seen.position,
        depth=seen.depth,
        alpha=None if picture.alpha is None else _1 - seen.clear,
        smooth=None,
        glossy_albedo=None,
        own_normal=None,
        mirrored_albedo=None,
        sharp=None,
        shine=None,
        points=(),
        groups=_groups(picture.groups, found[2 * len(lights) :], direct, diffuse + glossy, seen),
    )


def _groups(
    groups: dict[str, GroupLight], shares: list[np.ndarray], direct: np.ndarray, indirect: np.ndarray, seen: View
) -> dict[str, GroupLight]:
    """Each group's share of direct and of indirect light, by what interpolation has found of them, `shares` (two a group)."""
    found = {}
    sums = [np.maximum(sum(shares[k::2]), np.float32(1e-30)) for k in range(2)] if groups else []
    for k, name in enumerate(groups):
        own = [light * (part / whole) for light, part, whole in zip((direct, indirect), shares[2 * k : 2 * k + 2], sums, strict=True)]
        emission = seen.emitted[k, 0] if k < len(seen.emitted) else np.zeros_like(direct)  # groups without light come last
        found[name] = GroupLight(*own, np.zeros_like(direct), np.ascontiguousarray(emission))
    return found
