"""Method and numbers of one render, by what is asked for: a time, an error, or neither.

A budget is spent on few large passes, of which the first tells what the others cost.  A target is reached by one pass, where it is so coarse that
the fewest samples do, or a pilot foresees its error.  Small pictures, in which a pilot costs as much as they do, begin with two passes that tell it
and count.  What needs more than one large pass is made in rounds of three, whose own estimate (`core.passes`) tells how many more samples are
missing.  Nothing there depends on the clock, so that the same seed gives the same picture.  A pilot is the same scene in a picture so small that it
costs little.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from ..denoise import Denoiser
from ..passes import GROUPS, MANY_RAYS, SLOPE, UNSEEN_NOISE, Passes, denoising_quality, share_of_error
from ..picture import Picture
from ..scene import Camera
from ..settings import RenderSettings
from .cost import MIDDLING, PassCost
from .machine import Machine

# Quality of a pass: 1 is that of a picture without budget; its samples and its time go with it.
LEAST, MOST = 0.125, 8.0
# Where time is too short for LEAST: a quarter of its rays takes .7 to .85 of its time, at 1.3 to 1.8 times its error; fewer pixels err more.
QUICKEST = LEAST / 4
LARGE = 4.0  # of a pass of a budget, at most: beyond it two passes, of lights and caches of their own, have a smaller error than one
LARGE_PICTURE = 500_000  # pixels above which passes are not made larger than 1, for their memory
MOST_PASSES = 256
BLIND = 0.4  # of a budget, for the first pass where only the machine is known
UNSURE = 0.65  # where no second pass would fit behind it
INFORMED = 0.93  # where there was a pilot
FULL = 0.97  # of a budget is planned: predictions are not exact
LEAP = 4.0  # most by which a pass is better than the one before: what it costs is not known further ahead
# Time of the layers' denoising by that of as many pictures of `Machine.denoising`, for the qualities that pictures get.
DENOISING = {"fast": 0.8, "balanced": 1.1, "high": 1.8}
PILOT_PIXELS, PILOT_QUALITY = 8_000, 0.25
PILOT_SHARE = 0.1  # of a budget, at most
# A target's pilot: what a pass begins with costs more than these pixels, and two tell the error nearly as well as three of twice as many (ten scenes).
AIMING_PIXELS, AIMING = 4_000, 2
SMALLER = 6  # times as many pixels as the pilot has make it worth while
# relMSE that a picture of so many pixels has at most with the fewest samples (about; nine of ten scenes): coarser targets are not worth a pilot.
COARSE, COARSE_PIXELS = 0.04, 57_600
COARSEST = 0.075  # the same of the quickest pass
# Where not even the quickest pass fits, a smaller picture is lit, and enlarged by what the camera sees at full size (`core.enlarged`), at about
# so much of the cost of a pixel (480x270: .07 in the living room, .12 in the atrium) and with so many primary samples.
ENLARGING, ENLARGED_SAMPLES = 0.1, 4
ENLARGING_ITSELF = 0.3  # of that, apart from the view
LIT_SHARE = 0.93  # of what is left of a budget for the pass of the smaller picture and its denoising: predictions are not exact
MUCH_LARGER = 2.0  # times the pixels make it worth while to light a picture again
OVERTIME = 1.1  # times a budget that a whole picture may take by the prediction
STEP, SMALLEST, FEWEST = (
    2**0.25,
    8.0,
    24,
)  # by how much the picture shrinks along each side, how much at most, and to how many pixels a side
# relMSE of a denoised picture by that of one of fewer pixels and as many samples in each: the denoiser has more to go by.
SIZE_SLOPE = 0.35
# relMSE of one denoised pass falls with its quality to the power of -ALONE_SLOPE (six scenes, .125 to 2: -.29 to -.66), without denoising of
# -SLOPE.
ALONE_SLOPE = 0.37
ALONE = 4.0  # largest quality of a pass made by the pilot's word: three smaller ones have the same error in as much time, and tell it
NEAR_ENOUGH = 1.15  # times the target
HIDDEN = 1.15  # times what its pilot says, the error of a picture made by it (median of eight scenes, 320x180)
GROWTH = 6.0  # most by which the samples grow in a round: the slope is not exact


@dataclass
class Planner:
    """Decides the passes of one render, and keeps what it saw and why it chose.

    settings: with nothing left open.  pixels: of the picture.  images: that the denoiser is given in the end.
    cold: this process has still to load the kernels.  triangles: of the scene.
    """

    settings: RenderSettings
    pixels: int
    machine: Machine | None
    images: int = 2
    cold: bool = False
    triangles: int = MIDDLING
    cost: PassCost | None = None
    passes: list[dict] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    pilot: dict | None = None
    foreseen: float | None = None  # relMSE of a pass that is made alone, by the pilot's word; None where passes come in threes
    lit: tuple[int, int] | None = None  # size of the smaller picture that is lit, None for the whole one
    whole: int = 0  # pixels of the picture itself, where a smaller one is lit

    def __post_init__(self) -> None:
        if self.machine is not None:
            self.cost = PassCost.of(self.machine, self.cold, self.triangles)

    @property
    def most(self) -> float:
        """Largest quality of a pass."""
        return MOST if self.pixels < LARGE_PICTURE else 1.0

    def finishing(self, weight: float) -> float:
        """Seconds from the last of passes of so much quality in all to the layers."""
        denoising = self.denoising_seconds(denoising_quality(self.settings, weight)) if self.settings.denoise else 0.0
        return denoising + self._enlarging

    @property
    def _enlarging(self) -> float:
        """Seconds of the last step, where a smaller picture is lit."""
        return ENLARGING_ITSELF * ENLARGING * self.cost.each * self.whole if self.lit else 0.0

    def denoising_seconds(self, quality: str) -> float:
        """Seconds of the denoiser, by what the machine's file says."""
        return DENOISING[quality] * self.machine.denoising(self.pixels, self.images)

    def denoising_quality(self, weight: float, elapsed: float, least: str) -> str:
        """As `passes.denoising_quality` has it; within a budget, the best for which there is time."""
        wanted = denoising_quality(self.settings, weight, least)
        if self.settings.time_budget is None or self.settings.smooth:
            return wanted
        left = self.settings.time_budget - elapsed - self._enlarging
        fitting = (quality for quality in DENOISING if self.denoising_seconds(quality) <= left)
        return max((least, *fitting), key=DENOISING.__getitem__)

    def _for_passes(self, left: float) -> float:
        """Seconds for further passes, of those that are left of the budget: the denoiser takes longer for more rays."""
        made = sum(done["quality"] for done in self.passes)
        quick, many = (left - self.finishing(weight) for weight in (0.0, 2.0))
        if made > 1 or made + self.cost.quality(self.pixels, many) > 1:
            return many
        # With so few rays the denoiser is quick.
        return min(quick, self.cost.seconds(self.pixels, 1 - made))

    @property
    def coarse(self) -> bool:
        """Whether the fewest samples are known to meet the target, in scenes as they usually are."""
        settings = self.settings
        if settings.target_error is None or not settings.denoise or settings.method != "importance-sampling":
            return False
        return settings.samples + settings.gather >= MANY_RAYS and self._usual(COARSE) <= settings.target_error

    def _usual(self, error: float) -> float:
        """The relMSE that a picture of this size has where one of `COARSE_PIXELS` has `error`."""
        return error * self._by_size(COARSE_PIXELS)

    def _by_size(self, pixels: int) -> float:
        """relMSE of a denoised picture by that of one of so many pixels."""
        return (self.pixels / pixels) ** -SIZE_SLOPE

    def pilot_passes(self) -> int:
        """How many passes of a pilot are worth their time: one tells the cost, two the error, none where the picture is small itself."""
        if self.settings.target_error is not None:
            return 0 if self.pixels < SMALLER * AIMING_PIXELS or self.coarse else AIMING
        if self.pixels < SMALLER * PILOT_PIXELS:
            return 0
        budget = self.settings.time_budget
        fits = budget is not None and self.cost.seconds(PILOT_PIXELS, PILOT_QUALITY) <= PILOT_SHARE * budget
        return int(fits)

    def fly(self, camera: Camera, run: Callable[[Camera, RenderSettings], Picture], denoiser: Denoiser | None, clock: Callable[[], float]):
        """Run the pilot: `run` renders a smaller picture of the view.  Seconds are those of `clock`."""
        count = self.pilot_passes()
        if not count:
            return
        size, quality = (PILOT_PIXELS, PILOT_QUALITY) if self.settings.target_error is None else (AIMING_PIXELS, LEAST)
        small = reduced(camera, (self.pixels / size) ** 0.5)
        found, begin = Passes(self.settings.threads), clock()
        for k in range(count):
            start = clock()
            picture = run(small, self.settings.scaled(quality, MOST_PASSES + k))
            found.add(replace(picture, weight=quality))
            if self.cost:
                self.cost.observe(picture.depth.size, quality, clock() - start, pilot=True)
        height, width = picture.depth.shape
        self.pilot = {"size": [width, height], "quality": quality, "passes": count}
        if count == AIMING:
            self.pilot["error"] = found.error_of_one(denoiser)
        self.pilot["seconds"] = clock() - begin

    def lit_camera(self, camera: Camera, elapsed: float) -> Camera:
        """The camera of the picture that is lit: a smaller one where that is asked for, or even the smallest pass of the whole would take longer than the budget."""
        budget = self.settings.time_budget
        if self.settings.downsampling > 1 and budget is None and self.settings.target_error is None:
            small = reduced(camera, max(1.0, min(self.settings.downsampling, min(sides(camera)) / FEWEST)))
            if sides(small) != sides(camera):
                self.whole = self.pixels
                self._light(small)
                self.reasons.append(f"{self.lit[0]}x{self.lit[1]} pixels are lit, as was asked for, and enlarged by what the camera sees")
            return small
        if budget is None or elapsed + self._seconds_of(self.pixels, QUICKEST) <= OVERTIME * budget:
            return camera
        self.whole, whole = self.pixels, self._seconds_of(self.pixels, QUICKEST)
        small = self._fitting(camera, budget - elapsed - ENLARGING * self.cost.each * self.whole)
        if small is not camera:
            self._light(small)
            self.reasons.append(
                f"the quickest pass of the whole picture would take about {whole:.2g} s: {self.lit[0]}x{self.lit[1]} pixels are lit, and "
                "enlarged by what the camera sees"
            )
        return small

    def larger_camera(self, camera: Camera, elapsed: float) -> Camera | None:
        """The camera of a much larger picture that fits into what is left, now that the smaller one's pass shows what this scene costs.

        camera: of the whole picture.  None where there is none, or none is asked for.
        """
        if not self.lit or self.settings.time_budget is None:
            return None
        left = self.settings.time_budget - elapsed - self._enlarging
        larger = camera if self._seconds_of(math.prod(sides(camera)), QUICKEST) <= left else self._fitting(camera, left)
        if math.prod(sides(larger)) < MUCH_LARGER * self.pixels:
            return None
        self._light(larger)
        if larger is camera:
            self.lit = None
        self.reasons.append(
            f"that took less time than foreseen: {math.prod(sides(larger)) / math.prod(sides(camera)):.0%} of the pixels are lit"
        )
        return larger

    def _light(self, camera: Camera) -> None:
        self.lit, self.pixels = sides(camera), math.prod(sides(camera))

    def _fitting(self, camera: Camera, seconds: float) -> Camera:
        """The largest picture of a few whose smallest pass fits, or the smallest of them."""
        small, factor = camera, 1.0
        while factor < SMALLEST and min(sides(reduced(camera, factor * STEP))) >= FEWEST:
            factor *= STEP
            small = reduced(camera, factor)
            if self._seconds_of(math.prod(sides(small))) <= LIT_SHARE * seconds:
                break
        return small

    def _seconds_of(self, pixels: int, quality: float = LEAST) -> float:
        """Of a pass of a picture, and its denoising."""
        denoising = DENOISING["fast"] * self.machine.denoising(pixels, self.images) if self.settings.denoise else 0.0
        return self.cost.seconds(pixels, quality) + denoising

    def first(self, elapsed: float) -> float:
        """Quality of the first pass."""
        settings = self.settings
        if settings.time_budget is not None:
            return self._first_of_budget(self._for_passes(settings.time_budget - elapsed))
        if settings.target_error is None:
            self.reasons.append("neither a time nor an error was asked for: one pass with the numbers as they are")
            return 1.0
        if self.coarse:
            self.reasons.append("the target is coarse: the fewest samples usually have a smaller error")
            return QUICKEST if self._usual(COARSEST) <= settings.target_error else LEAST
        if not self._flown:
            passes = "two passes" if settings.denoise else "three passes"
            self.reasons.append(f"the picture is small: {passes} with the fewest samples tell its error")
            return LEAST
        found = self.pilot["error"]
        error = found * (self._by_size(math.prod(self.pilot["size"])) if settings.denoise else 1.0)
        return self._by_one(HIDDEN * error, 0.0, f"the pilot's relMSE is {found:.2g}")

    @property
    def _flown(self) -> bool:
        """Whether a pilot tells the error."""
        return bool(self.pilot and self.pilot["error"] > 0)

    def _by_one(self, one: float, made: float, known: str) -> float:
        """Quality of the next pass, by the relMSE of one with the fewest samples.

        made: the quality of all passes so far.  known: by what it is known, for `reasons`.
        """
        target, fewest = self.settings.target_error, self.passes[0]["quality"] if made and self.passes else LEAST
        slope = ALONE_SLOPE if self.settings.denoise else SLOPE
        three = one * share_of_error(1 / GROUPS, self.settings.denoise)

        def wanted(error: float) -> float:
            return fewest * (error / target) ** (1 / slope)

        more = "more " if made else ""
        quality = self._bounded(wanted(one) - made, up=True)
        self.foreseen = one * ((made + quality) / fewest) ** -slope
        if quality <= ALONE and self.foreseen <= target * (1 + 1e-6):
            self.reasons.append(f"{known}: one {more}pass of quality {quality:.3g} should have {self.foreseen:.2g}")
            self._say_when_better(self.foreseen, made + quality)
            return quality
        self.foreseen = None
        quality = self._bounded(wanted(three) - made / GROUPS, up=True)  # a second round costs more than a step
        self.reasons.append(f"{known}: three {more}passes of quality {quality:.3g} should have {target:.2g}")
        return quality

    def _first_of_budget(self, left: float) -> float:
        if self.lit:  # more time would have been better spent on more pixels
            return LEAST
        least = self.cost.seconds(self.pixels, LEAST)
        whole = self.cost.quality(self.pixels, left)
        if least > left:
            quickest = self.cost.seconds(self.pixels, QUICKEST)
            quality = QUICKEST * max(1, math.floor(min(whole, LEAST) / QUICKEST))
            self.reasons.append(
                f"the smallest usual pass takes about {least:.2g} s, the quickest {quickest:.2g} s, and {max(left, 0):.2g} s of the time are left: "
                f"one of quality {quality:.3g} alone"
            )
            return quality
        if self.pilot:
            share = INFORMED / self._parts(whole)
        else:
            share = BLIND if (1 - BLIND) * left > least else UNSURE
        quality = self._bounded(min(self.cost.quality(self.pixels, share * left), LARGE))
        known = "the pilot" if self.pilot else "the machine"
        self.reasons.append(f"by {known}, passes of quality {max(whole, LEAST):.2g} in all fit; the first of {quality:.3g} tells more")
        return quality

    def observe(self, quality: float, seconds: float) -> None:
        """Note a pass that was made."""
        done = {"quality": quality, "seconds": seconds}
        if self.cost:
            done["predicted"] = self.cost.seconds(self.pixels, quality)
            self.cost.observe(self.pixels, quality, seconds)
        self.passes.append(done)

    def next(self, elapsed: float, passes: Passes, denoiser: Denoiser | None) -> float | None:
        """Quality of the next pass, None where no more is wanted; elapsed: seconds since the render began."""
        if passes.count >= MOST_PASSES:
            return None
        if self.settings.time_budget is not None:
            return self._next_of_budget(self._for_passes(FULL * self.settings.time_budget - elapsed))
        if self.settings.target_error is None:
            return None
        if self.foreseen is not None:
            passes.estimate = self.foreseen
            return None
        if self.coarse and passes.count == 1 and self._met_by_one(passes, denoiser):
            return None
        begun = AIMING if denoiser and not self._flown else 0
        if passes.count == begun:
            return self._after_two(passes, denoiser)
        if passes.count < begun or (passes.count - begun) % GROUPS:
            return self.passes[-1]["quality"]
        return self._next_round(passes, passes.error(denoiser, min(UNSEEN_NOISE, self.settings.target_error)))

    def _after_two(self, passes: Passes, denoiser: Denoiser) -> float | None:
        """As `next`, where the first two passes, of the picture itself, tell its error."""
        target = self.settings.target_error
        found = passes.error_of_one(denoiser)
        both = passes.error_of_two(found, min(UNSEEN_NOISE, target))
        if not both > target:
            self._say_when_better(both, passes.weight / passes.count)
            return None
        passes.as_it_is = False
        return self._by_one(found, passes.weight, f"two passes tell a relMSE of {found:.2g} each")

    def _met_by_one(self, passes: Passes, denoiser: Denoiser | None) -> bool:
        """Whether the only pass has no more noise than is usual for such an error."""
        error = self._usual(passes.error_by_noise(denoiser))
        if error > NEAR_ENOUGH * self.settings.target_error:
            self.reasons.append(f"by its noise the picture's relMSE is about {error:.2g}: two passes tell it")
            return False
        passes.estimate = error
        self._say_when_better(error, passes.weight / passes.count)
        return True

    def _next_of_budget(self, left: float) -> float | None:
        whole = self.cost.quality(self.pixels, left)
        if whole < LEAST:
            self._say_when_over(left)
            return None
        return self._bounded(min(self.cost.quality(self.pixels, left / self._parts(whole)), LEAP * self.passes[-1]["quality"]))

    def _parts(self, whole: float) -> int:
        """As how many passes quality `whole` is made: equal ones, rather than a last one that is too small to be worth its fixed costs."""
        return max(1, math.ceil(whole / min(self.most, LARGE)))

    def _say_when_over(self, left: float) -> None:
        if left < -(1 - FULL) * self.settings.time_budget and len(self.passes) == 1 and self.passes[0]["quality"] == QUICKEST:
            self.reasons.append("even the quickest picture takes longer than the time given: ask for fewer pixels")

    def _next_round(self, passes: Passes, error: float) -> float | None:
        target = self.settings.target_error
        if error <= NEAR_ENOUGH * target:
            if passes.count == GROUPS:
                self._say_when_better(error, passes.weight / passes.count)
            return None
        more = min(GROWTH, (error / target) ** (1 / SLOPE)) - 1
        quality = self._bounded(more * passes.weight / GROUPS)
        self.reasons.append(f"after {passes.count} passes the estimate is {error:.2g}: three more of quality {quality:.3g}")
        return quality

    def _say_when_better(self, error: float, quality: float) -> None:
        if quality <= LEAST and error < self.settings.target_error / 1.5:
            self.reasons.append("the smallest possible picture has a smaller error than asked for")

    def _bounded(self, quality: float, up: bool = False) -> float:
        """Steps of LEAST, between the bounds: rays are whole."""
        steps = quality / LEAST
        return min(self.most, max(LEAST, LEAST * (math.ceil(steps - 1e-6) if up else math.floor(steps + 1e-6))))

    def stats(self) -> dict:
        """What was chosen and why, for `--stats`."""
        goals = {name: getattr(self.settings, name) for name in ("time_budget", "target_error")}
        machine = None if self.machine is None else vars(self.machine)
        return {
            "method": self.settings.method,
            "goal": {name: value for name, value in goals.items() if value is not None},
            "machine": machine,
            "pilot": self.pilot,
            "lit": None if self.lit is None else list(self.lit),
            "passes": self.passes,
            "reasons": self.reasons,
        }


def sides(camera: Camera) -> tuple[int, int]:
    """Width and height of the part that is rendered, in pixels."""
    x0, y0, x1, y1 = camera.border
    return x1 - x0, y1 - y0


def reduced(camera: Camera, factor: float) -> Camera:
    """The same view in a picture with `factor` times fewer pixels along each side, one at least."""
    width, height = (max(1, round(side / factor)) for side in (camera.width, camera.height))
    scale = width / camera.width, height / camera.height
    x0, y0, x1, y1 = (round(value * scale[k % 2]) for k, value in enumerate(camera.border))
    x0, y0 = min(x0, width - 1), min(y0, height - 1)
    return replace(camera, width=width, height=height, border=(x0, y0, max(x1, x0 + 1), max(y1, y0 + 1)))
