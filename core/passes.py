"""The passes of a picture, and the error of their mean as they tell it themselves.

Passes are independent of each other, and are dealt to three groups.  With A a denoised group, B and C the others as they are,

    relMSE(A) = mean over pixels of (A - B) (A - C) / (D^2 + 0.01 mean(D)^2),

in expectation, whatever the denoiser blurs away: the noise of B and C cancels, what is wrong with A stays.  D is the denoised mean of all.
Pixels of B and C far brighter than D are cut: that changes the mean of the product little, and its noise much.  Of two passes, A and B as they are
and A' and B' denoised,

    relMSE(A') = relMSE(B') = mean over pixels of ((A' - B)^2 + (B' - A)^2 - (A - B)^2) / 2 / (D^2 + 0.01 mean(D)^2).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .denoise import QUALITIES, Denoiser
from .metrics import FLOOR
from .picture import Picture
from .settings import RenderSettings

GROUPS = 3
# relMSE falls with samples to the power of -SLOPE (of nine scenes: -0.29 to -0.83), raw noise by -1.
SLOPE = 0.5
# What all passes have in common, as the resolution of their caches, they cannot see: the error of nine scenes is so much larger (median).
UNSEEN = 1.36
BRIGHTEST, DARK = 6.0, 0.2  # times D and its mean: where B and C are cut
UNSEEN_NOISE = 1e-4  # relMSE of noise that nobody sees: a hundredth of the light
MANY_RAYS = 16  # a shading point: the default of the accurate method
SMALL_PICTURE = 100_000  # pixels below which each group is A in turn, for one alone is not certain enough
# relMSE of one denoised pass by that of its noise (eight scenes, quality .125 to 2, 57,600 pixels: within 1.5 times in half of the cases).
BY_NOISE, NOISE_SLOPE = 0.046, 0.65


@dataclass
class Passes:
    """The passes of one picture, dealt to three groups; threads: of the denoiser.

    estimate: the last result of `error`.  as_it_is: whether that is the error of the picture without denoising.  clean: the picture with its
    indirect light denoised, at the quality "fast", if that had to be known.
    """

    threads: int
    groups: list[Picture | None] = field(default_factory=lambda: [None] * GROUPS)
    count: int = 0
    estimate: float | None = None
    as_it_is: bool = False
    clean: Picture | None = None

    def add(self, picture: Picture) -> None:
        """Deal one more pass to the next group."""
        self.clean = None
        k = self.count % GROUPS
        self.groups[k] = picture if self.groups[k] is None else self.groups[k].blend(picture)
        self.count += 1

    @property
    def picture(self) -> Picture:
        """The mean of all passes."""
        parts = [group for group in self.groups if group is not None]
        whole = parts[0]
        for part in parts[1:]:
            whole = whole.blend(part)
        return whole

    @property
    def weight(self) -> float:
        """Of all passes."""
        return sum(group.weight for group in self.groups if group is not None)

    def error(self, denoiser: Denoiser | None, enough: float = 0.0) -> float:
        """Estimated relMSE of the indirect light of `picture`; NaN with less than three passes.

        It is the denoised picture's if there is a denoiser, unless that makes the error no less, or `enough` is met without it.
        """
        if any(group is None for group in self.groups):
            return float("nan")
        self.estimate = self._error(denoiser)
        if denoiser:
            raw = self._error(None)
            self.as_it_is = raw <= max(enough, self.estimate)
            self.estimate = raw if self.as_it_is else self.estimate
        return self.estimate

    def error_of_one(self, denoiser: Denoiser | None) -> float:
        """Estimated relMSE of the indirect light of one of two passes of the same quality, denoised if there is a denoiser."""
        scale, limit = self._scale(denoiser)
        raw, clean = (
            [np.minimum(self.groups[k].indirect, limit) for k in range(2)],
            [self._clean(self.groups[k], denoiser) for k in range(2)],
        )
        squares = (clean[0] - raw[1]) ** 2 + (clean[1] - raw[0]) ** 2 - (raw[0] - raw[1]) ** 2
        return max(0.0, 0.5 * _relative(squares, scale)) * (UNSEEN if denoiser else 1)

    def error_of_two(self, one: float, enough: float) -> float:
        """As `error` of the mean of two passes, of each of which the denoised light has the error `one`."""
        scale, limit = _scales(self.picture.indirect.astype(np.float64))
        a, b = (np.minimum(group.indirect, limit) for group in self.groups[:2])
        raw, clean = _relative((a - b) ** 2, scale) / 4, one * share_of_error(1 / 2, True)
        self.as_it_is = raw <= max(enough, clean)
        self.estimate = raw if self.as_it_is else clean
        return self.estimate

    def error_by_noise(self, denoiser: Denoiser) -> float:
        """About the relMSE of the denoised indirect light of a single pass of a middling picture, by how much the denoiser has changed."""
        self.clean = self._denoised(self.picture, denoiser, "fast")
        clean = self.clean.indirect.astype(np.float64)
        scale, limit = _scales(clean)
        noise = _relative((np.minimum(self.picture.indirect, limit) - clean) ** 2, scale)
        return BY_NOISE * noise**NOISE_SLOPE

    def _scale(self, denoiser: Denoiser | None) -> tuple[np.ndarray, np.ndarray | float]:
        """What squared errors are taken relative to, and where light is cut, by the mean of all passes."""
        scale, limit = _scales(self._clean(self.picture, denoiser))
        return scale, limit if denoiser else np.inf

    def _error(self, denoiser: Denoiser | None) -> float:
        scale, limit = self._scale(denoiser)
        errors = []
        for k in range(GROUPS if scale.shape[0] * scale.shape[1] < SMALL_PICTURE else 1):
            a = self._clean(self.groups[k], denoiser)
            b, c = (np.minimum(self.groups[j].indirect, limit) for j in (k - 1, k - 2))
            share = self.groups[k].weight / self.weight
            product = _relative((a - b) * (a - c), scale)
            errors.append(product * (UNSEEN if denoiser else 1) * share_of_error(share, denoiser is not None))
        return max(0.0, float(np.mean(errors)))

    def _clean(self, picture: Picture, denoiser: Denoiser | None, quality: str = "balanced") -> np.ndarray:
        """Its indirect light (H, W, 3), denoised if there is a denoiser, in double precision."""
        clean = self._denoised(picture, denoiser, quality) if denoiser else picture
        return clean.indirect.astype(np.float64)

    def _denoised(self, picture: Picture, denoiser: Denoiser, quality: str) -> Picture:
        return replace(picture, points=()).denoised(denoiser, self.threads, direct=False, quality=quality)


def _scales(light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What squared errors of light (H, W, 3) are relative to, and where noisy light is cut."""
    return light**2 + FLOOR * light.mean() ** 2, BRIGHTEST * (light + DARK * light.mean())


def _relative(squares: np.ndarray, scale: np.ndarray) -> float:
    """Mean of squares (H, W, 3) by `scale`, of what is black none."""
    return float(np.divide(squares, scale, out=np.zeros_like(scale), where=scale > 0).mean())


def share_of_error(share: float, denoised: bool) -> float:
    """relMSE of all passes by that of a share of them: of a denoised picture it falls more slowly than noise."""
    return share**SLOPE if denoised else share


def denoising_quality(settings: RenderSettings, weight: float, least: str = "fast") -> str:
    """What OIDN is to spend on a picture of passes of so much weight: in a quick one more of its time is better spent on rays.

    least: what it spends at least, but for a method whose light has no noise.
    """
    if settings.smooth:
        return "fast"
    rays = _rays(settings, weight)
    quality = "fast" if rays < MANY_RAYS else "balanced" if rays <= MANY_RAYS else "high"
    return max(quality, least, key=QUALITIES.__getitem__)


def has_few_rays(settings: RenderSettings, weight: float) -> bool:
    """Whether passes of so much weight have so few rays that their noise is most of what they tell of single points."""
    return _rays(settings, weight) < MANY_RAYS


def _rays(settings: RenderSettings, weight: float) -> float:
    """Of a shading point; of methods that know no number of their own, as many as make a usual picture."""
    return weight * (settings.samples + settings.gather) if settings.method == "importance-sampling" else MANY_RAYS
