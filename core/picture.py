"""What one or more passes have found of a view, pixel by pixel, and the layers that it makes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from .denoise import ROWS, Denoiser, channel_means, mean_factor, pull_push
from .group_shares import shares_of
from .jit import kernel
from .lamps import LightGroups
from .layers import GROUP_LAYERS, Layers
from .scene import Scene
from .sharp_shadows import SharpLight, doubt_of, give_shadows_back
from .subpixel import PointLight, give_back, joined
from .surfaces.lobes import NEGLIGIBLE
from .threads import run_chunks
from .view.points import BEHIND, GRAZING, SCATTERED, ShadingPoints, glossy_albedos
from .view.primary import View

MIRRORED, MIRRORED_PIXELS = 0.1, 0.01  # albedo in a mirror that a denoiser goes by, and the least share of the pixels
MOSTLY_MIRRORED = 0.04  # share of the pixels from which on a quick picture's guide is worth a denoising, too
SHOWN, MOSTLY = 0.8, 0.98  # what the strongest lobes of a picture but for a few are to the denoiser
AROUND = 5  # pixels along a side of what takes back light that was smeared
MARGIN = 16  # pixels around what is denoised of a picture, which a denoiser sees, too
LEAST_FORESEEN = np.float32(1e-6)  # of its mean: what is darker has no light to be told from noise
LEAST_SOFT = np.float32(1e-3)  # of the mean of what has sharp shadows: less is rounding
QUICKER = {"high": "balanced", "balanced": "fast"}  # of OIDN's qualities, for layers that gain little by the better one
LIGHT = ("direct", "diffuse_indirect", "glossy_indirect", "emission")
# What passes average; position and depth are the first one's.
_MEANS = (*LIGHT, "albedo", "normal", "guide_albedo", "guide_normal", "foreseen")
_MEANS_IF_THERE = ("alpha", "smooth", "glossy_albedo", "mirrored_albedo", "own_normal", "sharp", "unshadowed")


class GroupLight(NamedTuple):
    """Light of one group, (H, W, 3) float32 radiance each (W/m^2/sr); the fields are those of `Picture`."""

    direct: np.ndarray
    diffuse_indirect: np.ndarray
    glossy_indirect: np.ndarray
    emission: np.ndarray

    @staticmethod
    def compose(
        seen: View, direct: np.ndarray, indirect: np.ndarray, glossy_direct: np.ndarray, glossy_indirect: np.ndarray, emitted: np.ndarray
    ) -> GroupLight:
        """Irradiances and glossy radiances (N, 3) at the shading points as images; emitted: as in `View`, of the group.

        Glass is a bounce, as in Cycles: all light of the surfaces behind it is indirect, and specular, whatever it is to
        them.  What shines behind it is direct light after one surface of glass, indirect light after more.
        """
        emission, behind_one, behind_more = emitted
        layers = behind_one.copy(), np.zeros_like(behind_one), behind_more.copy()
        light = (np.ascontiguousarray(part) for part in (direct, indirect, glossy_direct, glossy_indirect))
        _add_light(seen.points, *light, *(layer.reshape(-1, 3) for layer in layers))
        return GroupLight(*layers, emission)


@dataclass(frozen=True)
class Picture:
    """Light and guides of a view, (H, W, 3) float32 each but for depth (H, W).

    direct, diffuse_indirect, glossy_indirect, emission: radiance (W/m^2/sr).  guide_albedo, guide_normal: tell a denoiser
    where edges are.  foreseen: what diffuse indirect light is about in proportion to, without noise (`methods.foreseen`).
    weight: how many samples it stands for, on any scale.  triangle: (H, W) int32, of `position`, where it is asked for.
    smooth: what of the diffuse indirect light comes from a method without noise, and is left as it is by `denoised`; None for nothing.
    alpha: (H, W) float32, the part of each pixel that is not the world, None where the film is opaque.
    glossy_albedo: (H, W, 3) float32, what glossy lobes reflect, which tells the denoiser where there are any; None for nothing known.
    own_normal: (H, W, 3) float32, `guide_normal` without what lies behind glass and in mirrors; None for the same.
    mirrored_albedo: (H, W, 3) float32, albedo of what rays from narrow lobes have met, with their noise; None for nothing.
    sharp: (H, W, 3) float32, what diffuse surfaces send of the light of lamps with sharp shadows, part of `direct`; None where it is not told apart.
    unshadowed: (H, W, 3) float32, what `sharp` would be with nothing in its way; doubt: (H, W, 3) float32, that by the number of rays
    that have told: of several points each by its share.
    shine: (H, W, 3) float32, `highlights` of small things, part of `direct`, too thin for a denoiser to leave them; None for none.
    groups: the light alone of each light group by its name, which add up to the whole; empty where light is not told apart.
    points: diffuse indirect light of the passes' shading points, which knows more than that of pixels; empty where it is not kept.
    """

    direct: np.ndarray
    diffuse_indirect: np.ndarray
    glossy_indirect: np.ndarray
    albedo: np.ndarray
    emission: np.ndarray
    normal: np.ndarray
    guide_albedo: np.ndarray
    guide_normal: np.ndarray
    foreseen: np.ndarray
    position: np.ndarray
    depth: np.ndarray
    weight: float = 1.0
    triangle: np.ndarray | None = None
    smooth: np.ndarray | None = None
    alpha: np.ndarray | None = None
    glossy_albedo: np.ndarray | None = None
    own_normal: np.ndarray | None = None
    mirrored_albedo: np.ndarray | None = None
    sharp: np.ndarray | None = None
    unshadowed: np.ndarray | None = None
    doubt: np.ndarray | None = None
    shine: np.ndarray | None = None
    groups: dict[str, GroupLight] = field(default_factory=dict)
    points: tuple[PointLight, ...] = ()

    @staticmethod
    def compose(
        seen: View, direct: np.ndarray, indirect: np.ndarray, glossy_direct: np.ndarray, glossy_indirect: np.ndarray,
        mirrored_albedo: np.ndarray, weight: float = 1.0, groups: LightGroups | None = None, foreseen: np.ndarray | None = None,
        sharp: np.ndarray | None = None, unshadowed: np.ndarray | None = None, sharp_rays: np.ndarray | None = None,
        shine: np.ndarray | None = None,
    ) -> Picture:  # fmt: skip
        """The picture of irradiances and glossy radiances (N, 3 G) at the shading points.

        mirrored_albedo: (N, 3), of what mirrors show, for the denoiser.  groups: the G light groups, None for none.
        foreseen: (N,) irradiance, None for the same everywhere.  sharp: the part of `direct` that has sharp shadows; unshadowed, sharp_rays: as of `DirectLight`.
        shine: the part of `glossy_direct` that are highlights.
        """
        columns = [np.s_[:, 3 * k : 3 * k + 3] for k in range(len(seen.emitted))]
        parts = [
            GroupLight.compose(seen, direct[of], indirect[of], glossy_direct[of], glossy_indirect[of], emitted)
            for of, emitted in zip(columns, seen.emitted, strict=True)
        ]
        whole = parts[0] if len(parts) == 1 else GroupLight(*(sum(layers) for layers in zip(*parts)))
        guide_albedo, guide_normal = denoising_guides(seen)
        clear = (seen.points.behind_glass == 0)[:, None]
        doubt = None
        if sharp is not None:
            sharp = sharp.reshape(len(sharp), sharp.shape[1] // 3, 3).sum(axis=1)
            reflected = np.float32(1 / np.pi) * clear * seen.points.albedo
            parts_lit = reflected * unshadowed
            sharp, unshadowed = (splat(seen.points, light, seen.shape) for light in (reflected * sharp, parts_lit))
            doubt = splat(seen.points, doubt_of(parts_lit, unshadowed.reshape(-1, 3)[seen.points.pixel], sharp_rays), seen.shape)
        if shine is not None:
            shine = splat(seen.points, clear * shine.reshape(len(shine), shine.shape[1] // 3, 3).sum(axis=1), seen.shape)
        expected = seen.points.albedo * clear
        if foreseen is not None:
            expected *= foreseen[:, None]
        return Picture(
            **whole._asdict(),
            albedo=seen.albedo,
            normal=seen.normal,
            guide_albedo=guide_albedo,
            guide_normal=guide_normal,
            own_normal=None if guide_normal is seen.mean_normal else seen.mean_normal,
            foreseen=splat(seen.points, expected, seen.shape),
            position=seen.position,
            depth=seen.depth,
            weight=weight,
            glossy_albedo=_without_chance(seen.points, glossy_albedos(seen.points), seen.shape),
            mirrored_albedo=splat(seen.points, mirrored_albedo, seen.shape) if mirrored_albedo.any() else None,
            sharp=sharp,
            unshadowed=unshadowed,
            doubt=doubt,
            shine=shine,
            groups={} if groups is None else groups.told_apart(parts, GroupLight(*(np.zeros_like(seen.albedo) for _ in LIGHT))),
        )

    def blend(self, other: Picture) -> Picture:
        """The mean of both by their weights."""
        whole = self.weight + other.weight
        a, b = np.float32(self.weight / whole), np.float32(other.weight / whole)
        groups = {
            name: GroupLight(*(a * mine + b * its for mine, its in zip(light, other.groups[name]))) for name, light in self.groups.items()
        }
        means = {name: a * getattr(self, name) + b * getattr(other, name) for name in _MEANS}
        for name in _MEANS_IF_THERE:
            mine, its = getattr(self, name), getattr(other, name)
            means[name] = None if mine is None or its is None else a * mine + b * its
        if self.doubt is not None and other.doubt is not None:  # as variances
            means["doubt"] = a * a * self.doubt + b * b * other.doubt
        if self.shine is not None or other.shine is not None:  # a pass may have none
            mine, its = (np.zeros_like(self.direct) if part is None else part for part in (self.shine, other.shine))
            means["shine"] = a * mine + b * its
        return replace(self, weight=whole, groups=groups, points=joined(self.points, other.points), **means)

    @property
    def indirect(self) -> np.ndarray:
        """Diffuse and glossy indirect light."""
        return self.diffuse_indirect + self.glossy_indirect

    @property
    def irradiance(self) -> np.ndarray:
        """pi times diffuse indirect light / albedo, W/m^2; 0 where the albedo is."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.albedo > 0, np.float32(np.pi) * self.diffuse_indirect / self.albedo, np.float32(0))

    def denoised(
        self, denoiser: Denoiser, threads: int, *, direct: bool = True, indirect: bool = True, quality: str | None = None, few: bool = False,
        clean: Picture | None = None,
    ) -> Picture:  # fmt: skip
        """Without noise.  The guides have next to none themselves, and what they show stays as sharp as it is.

        direct, indirect: which light.  quality: as `Denoiser.denoise` has it.  few: as `subpixel.give_back` has it.  clean: the same picture
        without `points`, its indirect light denoised already.
        """

        own = self.guide_normal if self.own_normal is None else self.own_normal

        def cleaned(
            image: np.ndarray, guide: np.ndarray | None, quality: str | None = quality, preserve_mean: bool = True, normal=own, **options
        ) -> np.ndarray:
            return denoiser.denoise(
                image, guide, normal, position=self.position, quality=quality, threads=threads, preserve_mean=preserve_mean,
                **options,
            )  # fmt: skip

        found = {}
        if indirect and self.smooth is not None:
            noisy = self.diffuse_indirect - self.smooth
            lit = noisy.any(axis=2)
            if lit.any():  # what lenses throw, as a rule: on a few pixels
                part = _around(lit)
                light = self.diffuse_indirect.copy()
                light[part] = self.smooth[part] + denoiser.denoise(
                    noisy[part], self.albedo[part], own[part], position=self.position[part], clean_aux=True, preserve_mean=True,
                    quality=quality, threads=threads,
                )  # fmt: skip
                found["diffuse_indirect"] = light
        elif indirect and self.diffuse_indirect.any():
            light = clean.diffuse_indirect if clean else self._diffuse_cleaned(denoiser, cleaned, threads)
            if self.points:
                light = give_back(light, self.foreseen, self.points, threads, few=few)
                light *= mean_factor(self.diffuse_indirect, light, threads)
            found["diffuse_indirect"] = light
        if indirect and clean:
            found["glossy_indirect"] = clean.glossy_indirect
        elif indirect and self.glossy_indirect.any():
            guide, is_clean = self._mirrored_guide(denoiser, threads, quality)
            light = cleaned(self.glossy_indirect, self._glossy_guide(guide), clean_aux=is_clean, normal=self.guide_normal)
            found["glossy_indirect"] = light if self.glossy_albedo is None else _taken_off(light, self.glossy_indirect, self.glossy_albedo)
        if direct and self.direct.any():
            found["direct"], found["sharp"] = self._direct_cleaned(cleaned, QUICKER.get(quality, quality), threads)
        return replace(self, **found)

    def _direct_cleaned(
        self, cleaned: Callable[..., np.ndarray], quality: str | None, threads: int
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """The direct light without noise, and what of it has sharp shadows: it is denoised apart, for they go with the noise of other lamps."""
        if self.shine is not None:
            matt = replace(self, direct=self.direct - self.shine, shine=None)
            clean, sharp = matt._direct_cleaned(cleaned, quality, threads) if matt.direct.any() else (matt.direct, matt.sharp)
            return self.shine + clean, sharp
        if self.sharp is None:
            return self._off_lamps(cleaned(self.direct, self.albedo, quality, highlights=True)), None
        soft = self.direct - self.sharp
        if not largest(soft).max() <= LEAST_SOFT * self.sharp.mean():  # nor where that is no number
            soft = cleaned(soft, self.albedo, quality, highlights=True)
        sharp = cleaned(self.sharp, self.albedo, quality, highlights=True)
        if self.unshadowed is not None:
            give_shadows_back(sharp, SharpLight(self.sharp, self.unshadowed, self.doubt), threads)
        return self._off_lamps(soft + sharp), self._off_lamps(sharp)

    def _off_lamps(self, light: np.ndarray) -> np.ndarray:
        """Denoised direct light without what lies on pixels that reflect none: on bulbs right before a wall, whose light there is thousands of times what is left of it elsewhere, and on the sky."""
        reflected = self.albedo if self.glossy_albedo is None else np.maximum(self.albedo, self.glossy_albedo)
        return _taken_off(light, self.direct, reflected)

    def _mirrored_guide(self, denoiser: Denoiser, threads: int, quality: str | None) -> tuple[np.ndarray, bool]:
        """The albedo with what narrow lobes show, of which few rays have told, and whether it is free of noise."""
        if self.mirrored_albedo is None:
            return self.guide_albedo, True
        marked = largest(self.mirrored_albedo) > MIRRORED
        if marked.mean() <= MIRRORED_PIXELS:
            return self.guide_albedo + self.mirrored_albedo, True
        if quality == "fast" and marked.mean() < MOSTLY_MIRRORED:
            return self.guide_albedo + self.mirrored_albedo, False
        rows, columns = _around(marked)
        guide = self.guide_albedo + self.mirrored_albedo
        guide[rows, columns] = self.guide_albedo[rows, columns] + denoiser.prefilter(
            "albedo", self.mirrored_albedo[rows, columns], quality="fast", threads=threads
        )
        return guide, True

    def _glossy_guide(self, guide: np.ndarray) -> np.ndarray:
        """Half `guide`, half what lobes reflect, on a scale on which it can be seen: a white frame on a white wall may be all that shines."""
        if self.glossy_albedo is None:
            return guide
        shown = largest(self.glossy_albedo)
        glossy = shown[shown > NEGLIGIBLE]
        if not len(glossy):
            return guide
        scale = np.float32(SHOWN / np.quantile(glossy, MOSTLY))
        return np.float32(0.5) * (guide + np.minimum(scale * self.glossy_albedo, np.float32(1)))

    def _diffuse_cleaned(self, denoiser: Denoiser, cleaned: Callable[..., np.ndarray], threads: int) -> np.ndarray:
        """The diffuse indirect light without noise: the mean of two ways to denoise it, whose errors have little in common.

        One sees the light as it is, and the albedo beside it.  A blur would take textures away, and is left out.
        """
        ratio = self._by_ratio(cleaned, threads)
        known = (self.foreseen > 0) | (self.albedo <= 0)
        if not denoiser.available and known.all():
            return ratio
        radiance = cleaned(self.diffuse_indirect, self.albedo, clean_aux=True) * (self.albedo > 0)
        # Where nothing was foreseen, as of light that comes by few ways, there is no ratio.
        filled = np.where(known, ratio, radiance)
        return np.float32(0.5) * (filled + radiance) if denoiser.available else filled

    def _by_ratio(self, cleaned: Callable[..., np.ndarray], threads: int) -> np.ndarray:
        """The diffuse indirect light without noise, by its ratio to what is foreseen.

        The ratio has no holes where nothing is diffuse, and none of the edges of textures and surfaces that the denoiser would have to find.
        """
        least = np.float32(LEAST_FORESEEN * channel_means(self.foreseen, threads).mean())
        height = len(self.foreseen)
        known, ratio, rows = np.empty(self.foreseen.shape[:2], bool), np.empty_like(self.foreseen), np.zeros(height)
        tables = self.diffuse_indirect, self.foreseen, least, known, ratio
        run_chunks(lambda begin, end: _ratios(*tables, rows, begin, end), height, ROWS, threads)
        count = np.count_nonzero(known)
        if not count:
            return np.zeros_like(self.diffuse_indirect)
        scale = np.float32(2) * max(np.float32(rows.sum() / (3 * count)), np.float32(1e-30))
        ratio *= np.float32(1) / scale
        clean = cleaned(pull_push(ratio, known), None, preserve_mean=False) * (scale * self.foreseen)
        # What counts is the mean of the picture, not of the ratio.
        return mean_factor(np.where(known[..., None], self.diffuse_indirect, clean), clean, threads) * clean

    def shared_out(self, denoiser: Denoiser, threads: int) -> Picture:
        """With the groups' light as free of noise as the whole, which they add up to still.

        To be called on a picture whose groups have the noise that it had before it was denoised.  A group's indirect light is
        told apart as one: all of it is in `diffuse_indirect`, `glossy_indirect` is zero.
        """
        lit = self.groups.values()
        guides = self.guide_albedo, self.guide_normal, self.position, denoiser, threads
        direct = shares_of(np.stack([light.direct for light in lit]), self.direct, *guides)
        indirect = shares_of(np.stack([light.diffuse_indirect + light.glossy_indirect for light in lit]), self.indirect, *guides)
        none = np.zeros_like(self.direct)
        groups = {name: GroupLight(direct[k], indirect[k], none, light.emission) for k, (name, light) in enumerate(self.groups.items())}
        return replace(self, groups=groups)

    def group_layers(self) -> dict[str, np.ndarray]:
        """Three layers a light group, the first named as Cycles names it; each kind adds up to the layer of the whole."""
        found = {}
        for name, (direct, diffuse, glossy, emission) in self.groups.items():
            indirect = diffuse + glossy
            images = (direct + indirect + emission, direct, indirect)
            found |= {f"{kind}_{name}": image for kind, image in zip(GROUP_LAYERS, images, strict=True)}
        return found

    def layers(self, scene: Scene) -> Layers:
        """The layers of the contract (design.md, section 3)."""
        camera = scene.camera
        combined = self.direct + self.indirect + self.emission
        return Layers(
            {
                "Combined": combined if self.alpha is None else np.dstack([combined, self.alpha]),
                "Direct": self.direct,
                "Indirect": self.indirect,
                "DiffuseIndirect": self.diffuse_indirect,
                "GlossyIndirect": self.glossy_indirect,
                "Irradiance": self.irradiance,
                "Albedo": self.albedo,
                "Emission": self.emission,
                "Normal": self.normal,
                "Position": np.where(self.depth[..., None] < 1e9, self.position + scene.origin.astype(np.float32), np.float32(0)),
                "Depth": self.depth,
                **self.group_layers(),
            },
            view_layer=scene.view_layer,
            offset=(camera.border[0], camera.border[1]),
            full_size=(camera.width, camera.height),
        )


@kernel(fast=False)  # it tells what is finite
def _ratios(light, foreseen, least, known, ratio, rows, begin, end):
    """The ratio (H, W, 3) of light to what is foreseen, where it is `known`, else 0; its sums by rows (H,).

    A channel of which too little is foreseen has the ratio of all three together.
    """
    for y in range(begin, end):
        for x in range(light.shape[1]):
            r, g, b = foreseen[y, x, 0], foreseen[y, x, 1], foreseen[y, x, 2]
            whole = light[y, x, 0] + light[y, x, 1] + light[y, x, 2]
            known[y, x] = max(r, g, b) > least and np.isfinite(whole + r + g + b)
            for c in range(3):
                own = np.float32(0)
                if known[y, x]:
                    own = light[y, x, c] / foreseen[y, x, c] if foreseen[y, x, c] > least else whole / (r + g + b)
                ratio[y, x, c] = own
                rows[y] += own


def _taken_off(light: np.ndarray, noisy: np.ndarray, reflected: np.ndarray) -> np.ndarray:
    """Denoised light (H, W, 3) without what lies on pixels that have none in `noisy` and reflect none: their neighbours get back what the denoiser has smeared there.

    A pattern of metal and of what is none has one guide where what either reflects is alike, and a lamp's guide is a shadow's.
    """
    matt = (largest(reflected) <= NEGLIGIBLE) & ~noisy.any(axis=2)
    if not matt.any():
        return light
    around = partial(uniform_filter, size=(AROUND, AROUND, 1), mode="constant")
    kept = np.where(matt[..., None], np.float32(0), light)
    taken = light - kept
    others = around(kept)
    near = others > 1e-6 * light.mean()
    share = around(np.divide(taken, others, out=np.zeros_like(light), where=near))
    return kept * (1 + share) + np.where(near, np.float32(0), taken)


def _around(marked: np.ndarray) -> tuple[slice, slice]:
    """The rows and columns that hold all marked pixels, and a margin."""
    rows, columns = (np.flatnonzero(marked.any(axis=axis)) for axis in (1, 0))
    return tuple(slice(max(0, at[0] - MARGIN), at[-1] + 1 + MARGIN) for at in (rows, columns))


def largest(image: np.ndarray) -> np.ndarray:
    """The largest channel (H, W) of each pixel, NaN where one is: ten times as fast as `image.max(axis=2)`."""
    return np.maximum(np.maximum(image[..., 0], image[..., 1]), image[..., 2])


def splat(points: ShadingPoints, radiance: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Sum of the radiance (N, 3) of each pixel's points, (H, W, 3)."""
    out = np.zeros((shape[0] * shape[1], 3), np.float32)
    _splat(points.pixel, radiance, out)
    return out.reshape(*shape, 3)


@kernel
def _splat(pixel, radiance, out):
    for i in range(len(pixel)):
        for c in range(3):
            out[pixel[i], c] += radiance[i, c]


@kernel
def _add_light(points, direct, indirect, glossy_direct, glossy_indirect, to_direct, to_diffuse, to_glossy):
    """Adds the light (N, 3) of points to layers (H * W, 3); of points behind glass all of it to the last one."""
    for i in range(len(points.pixel)):
        pixel = points.pixel[i]
        for c in range(3):
            diffuse = points.albedo[i, c] * np.float32(1 / np.pi)
            first, later = diffuse * direct[i, c] + glossy_direct[i, c], diffuse * indirect[i, c]
            if points.behind_glass[i]:
                to_glossy[pixel, c] += glossy_indirect[i, c] + first + later
            else:
                to_direct[pixel, c] += first
                to_diffuse[pixel, c] += later
                to_glossy[pixel, c] += glossy_indirect[i, c]


def nearest_triangles(seen: View) -> np.ndarray:
    """(H, W) int32: the triangle of the shading point that lies nearest to each pixel's position, -1 where there is none."""
    points = seen.points
    away = points.position - seen.position.reshape(-1, 3)[points.pixel]
    farthest_first = np.argsort(-np.einsum("nc,nc->n", away, away), kind="stable")
    found = np.full(seen.depth.size, -1, np.int32)
    found[points.pixel[farthest_first]] = points.triangle[farthest_first]
    return found.reshape(seen.shape)


def denoising_guides(seen: View) -> tuple[np.ndarray, np.ndarray]:
    """Albedo and mean normal (H, W, 3) that tell the denoiser where edges are: where there is glass, those of what it shows.

    What frosted glass shows by a ray or two of each pixel is noise, which the denoiser would leave as it is: it gets the mean around, and the pane's normal.
    """
    behind = seen.points.take(seen.points.behind_glass > 0)
    if len(behind.pixel) == 0:
        return seen.albedo, seen.mean_normal
    clear = behind.behind_glass == BEHIND
    through = splat(behind, behind.albedo * clear[:, None], seen.shape)
    shown = behind.albedo.mean(axis=1, keepdims=True) * clear[:, None]
    shown = np.where((behind.ng * behind.wo).sum(axis=1, keepdims=True) < GRAZING, -shown, shown)  # of what is lit from its other side
    normal = seen.albedo.mean(axis=2, keepdims=True) * seen.mean_normal + splat(behind, shown * behind.ns, seen.shape)
    length = np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), np.float32(1e-9))
    normal = np.where(through.any(axis=2, keepdims=True), normal / length, seen.mean_normal)
    return seen.albedo + _without_chance(seen.points, (seen.points.behind_glass > 0)[:, None] * seen.points.albedo, seen.shape), normal


def _without_chance(points: ShadingPoints, albedo: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The sum of the albedo (N, 3) of each pixel's points, (H, W, 3): of what frosted glass shows the mean around, black or not."""
    scattered = points.behind_glass == SCATTERED
    if not scattered.any():
        return splat(points, albedo, shape)
    found, noisy = (splat(points, albedo * part[:, None], shape) for part in (~scattered, scattered))
    frosted = np.zeros(shape, bool)
    frosted.reshape(-1)[points.pixel[scattered | (points.shown == SCATTERED)]] = True
    part = _around(frosted)
    around = partial(uniform_filter, size=(AROUND, AROUND, 1), mode="constant")
    pixels = frosted[part][..., None].astype(np.float32)
    found[part] += pixels * around(noisy[part]) / np.maximum(around(pixels), np.float32(1e-3))
    return found
