"""What a user asks of a render, method by method (design.md, section 3)."""

from __future__ import annotations

from dataclasses import Field, dataclass, field, fields, replace
from typing import Any

from .film import SQUARE, Film

METHODS = (
    "auto",
    "instant-radiosity",
    "fuzzy-clustering",
    "virtual-area-lights",
    "visibility-gates",
    "importance-sampling",
)

# What a lightmap's texel holds: W/m^2, or W/m^2/sr that the surface sends out.
CONTENTS = {
    "irradiance": "direct and indirect irradiance, W/m^2",
    "indirect": "indirect irradiance, W/m^2",
    "full": "radiance of the diffuse surface with its colour and its own emission, W/m^2/sr",
}


@dataclass(frozen=True)
class Choice:
    """One value of an option: what a menu says, and what it means in a line."""

    value: str
    label: str
    help: str


@dataclass(frozen=True)
class Option:
    """How a field of `RenderSettings` is offered to a user.

    least, most: bounds of a number;  usual: where a slider ends.  unit: 's' for seconds, '' for plain numbers.
    choices: the values of a menu.  method: the only method that reads it.
    """

    label: str
    help: str
    least: float = 0
    most: float = 2**31 - 1
    usual: float | None = None
    unit: str = ""
    choices: tuple[Choice, ...] = ()
    method: str | None = None


def option(default: Any, label: str, help: str, **more: Any) -> Any:
    """A field with its `Option`."""
    return field(default=default, metadata={"option": Option(label, help, **more)})


# relMSE that `auto` aims at for the name of a quality: for a first look, for work, and for the last picture.
QUALITY_ERRORS = {"preview": 0.05, "medium": 0.02, "final": 0.005}

METHOD_CHOICES = (
    Choice("auto", "Automatic", "Method and numbers by what is aimed at: a quality, a time or an error"),
    Choice(
        "importance-sampling",
        "Importance Sampling",
        "Shadow rays to the lights that matter and gather rays into a cache of light, denoised",
    ),
    Choice("fuzzy-clustering", "Fuzzy Clustering", "A smooth preview: visibility is computed between clusters only, and blended"),
    Choice(
        "virtual-area-lights",
        "Virtual Area Lights",
        "Soft shadow maps of a few clusters of lights: for scenes that change, nothing is precomputed",
    ),
    Choice("visibility-gates", "Visibility Gates", "The topology of the rooms tells what is seen, shadow rays the rest"),
    Choice(
        "instant-radiosity",
        "Instant Radiosity",
        "Shadow rays from every point to every virtual point light: slow, the measure of the others",
    ),
)


LEAST_DIRECT = 2  # direct rays of a point that the quickest picture takes


@dataclass
class RenderSettings:
    """The request of one render; every field has the default of the command line.

    vpls: virtual point lights that the view uses.  bounces: diffuse bounces of the indirect light.
    pixel_samples: primary samples a pixel, half as many where all is even and up to twice as many elsewhere.
    downsampling: how many times smaller along each side the picture is that is lit (`core.enlarged`); a time, an error and sequences do without.  direct_samples: shadow rays a shading point for `Direct`.
    reflections: most rays drawn from the glossy lobe of a shading point.
    direct_samples, reflections, denoise: None lets the method choose (see `with_defaults`).  time_budget: seconds;
    target_error: relMSE.  quality: a key of `QUALITY_ERRORS`, which `auto` takes for its target error where neither is given.
    layers: names of the layers wanted (None: all of the contract); those of light groups come with the layer that they are of.
    film: the pixel filter, and whether the world is transparent to the camera.
    skipping: False samples every lamp at every point and keeps every VPL, whatever the view needs: `bench skipping` compares.
    """

    method: str = option("auto", "Method", "How the indirect light is gathered", choices=METHOD_CHOICES)
    vpls: int = option(4096, "VPLs", "Virtual point lights that carry the indirect light", least=1, usual=65536)
    bounces: int = option(
        4, "Bounces", "Diffuse bounces of the indirect light: 1 is light that left one surface before the visible one", usual=32
    )
    seed: int = option(0, "Seed", "Seed of all random sequences: another one gives other noise")
    threads: int = option(0, "Threads", "Threads that compute, 0 for all cores", usual=64)
    pixel_samples: int = option(
        16,
        "Pixel Samples",
        "Primary samples of a pixel, for its edges and textures: half as many where all is even, up to twice as many elsewhere",
        least=1,
        usual=64,
    )
    downsampling: int = option(
        1,
        "Downsampling",
        "Light a picture so many times smaller along each side, and spread its light by what every pixel sees; shadows of small lamps stay sharp. "
        "For previews; 1 lights every pixel. A quality, a time or an error to reach decides by itself",
        least=1,
        usual=8,
    )
    direct_samples: int | None = option(None, "Direct Samples", "Shadow rays of a shading point to the lamps", least=1, usual=64)
    reflections: int | None = option(None, "Reflections", "Most rays drawn from the glossy lobe of a shading point, 0 for none", usual=32)
    denoise: bool | None = option(
        None, "Denoise", "Take the noise out of the light by Open Image Denoise; albedo and edges stay as they are"
    )
    time_budget: float | None = option(None, "Time", "Compute for this long, with as many samples as fit", least=0.1, usual=600, unit="s")
    target_error: float | None = option(
        None,
        "Error",
        "Compute until the estimated relative error (relMSE) of the indirect light is below this",
        least=1e-5,
        most=1,
        usual=0.1,
    )
    quality: str | None = None
    debug_layers: bool = option(False, "Debug Layers", "Also give clusters and the light of single VPLs, one layer each")
    layers: tuple[str, ...] | None = None
    skipping: bool = True

    # instant radiosity
    visibility: str = option(
        "rays",
        "Visibility",
        "How a VPL is tested for sight of a point",
        choices=(
            Choice("rays", "Shadow Rays", "Exact"),
            Choice("shadow-maps", "Shadow Maps", "Cube shadow maps: fast, with an error of their own at edges"),
            Choice("none", "None", "No shadows at all"),
        ),
        method="instant-radiosity",
    )
    compensation: bool = option(
        True,
        "Bias Compensation",
        "Give back by gather rays the light of corners that the clamped geometry term loses",
        method="instant-radiosity",
    )

    # fuzzy clustering
    vpl_clusters: int = option(1000, "VPL Clusters", "Clusters of virtual point lights", least=1, usual=10000, method="fuzzy-clustering")
    point_clusters: int = option(8000, "Point Clusters", "Clusters of shading points", least=1, usual=100000, method="fuzzy-clustering")
    fuzziness: int = option(
        6, "Fuzziness", "Clusters whose visibility a point blends, 1 for its own alone", least=1, usual=32, method="fuzzy-clustering"
    )
    weighting: str = option(
        "smooth",
        "Weighting",
        "How the blended clusters are weighted",
        choices=(
            Choice("smooth", "Smooth", "By distance, without a seam where the clusters change"),
            Choice("distance", "Distance", "By inverse distance"),
            Choice("plain", "Plain", "All alike"),
        ),
        method="fuzzy-clustering",
    )
    shade_with: str = option(
        "clusters",
        "Shade With",
        "What shines on a point",
        choices=(
            Choice("clusters", "Clusters", "One light a cluster: fast"),
            Choice("vpls", "VPLs", "Every VPL, with the visibility of its cluster"),
        ),
        method="fuzzy-clustering",
    )

    # virtual area lights
    vals: int | None = option(None, "Area Lights", "Virtual area lights", least=1, usual=300, method="virtual-area-lights")
    interleave: int = option(
        8, "Interleaving", "Pixels of a window that share the lights, 1 for no sharing", least=1, usual=16, method="virtual-area-lights"
    )
    soft_shadows: bool = option(
        False, "Soft Shadow Maps", "Direct light of area lamps by convolution soft shadow maps", method="virtual-area-lights"
    )

    # visibility gates
    voxels: int = option(128, "Voxels", "Along the scene's longest side", least=8, most=1024, usual=512, method="visibility-gates")
    outside: str = option(
        "closed",
        "Outside",
        "What the topology takes to be beyond the scene's bounding box",
        choices=(
            Choice("closed", "Closed", "Solid: the box is the last wall"),
            Choice("open", "Open", "Empty space that goes on"),
        ),
        method="visibility-gates",
    )
    cutouts: bool = option(
        False,
        "Cut-outs as Walls",
        "What lets light through, as leaves cut out of pictures and glass, is a wall to the topology",
        method="visibility-gates",
    )
    sheets: str = option(
        "walls",
        "Thin Sheets",
        "What surfaces without thickness that hang in a room, as curtains and leaves, are to the topology",
        choices=(
            Choice("walls", "Walls", "As all surfaces are"),
            Choice("open", "Open", "Nothing: one can walk round them"),
        ),
        method="visibility-gates",
    )
    gates: str = option(
        "guided",
        "Gates",
        "What is seen between visibility clusters",
        choices=(
            Choice("guided", "Guided", "Shadow rays where topology and a few probes leave doubt"),
            Choice("polygons", "Polygons", "Through the openings' outlines"),
            Choice("disks", "Disks", "Through disks, as in the paper"),
            Choice("off", "Off", "Within each cluster, everything; beyond it, nothing"),
        ),
        method="visibility-gates",
    )
    gate_size: float = option(
        1.0,
        "Gate Size",
        "Factor on the size of disks and polygons: more than 1 lets in light that disks are too small for, and some that is hidden",
        least=0.1,
        most=10,
        usual=2,
        method="visibility-gates",
    )
    gate_filter: int = option(
        4,
        "Gate Filter",
        "Voxels over which light is blended along surfaces where visibility clusters meet, 0 for none; guided rays need none",
        most=64,
        usual=16,
        method="visibility-gates",
    )

    # importance sampling; gather: of the compensation, too
    samples: int = option(
        8, "Shadow Rays", "Shadow rays of a shading point to the lights that matter", least=1, usual=128, method="importance-sampling"
    )
    gather: int = option(
        8, "Gather Rays", "Rays of a shading point into the cache of light, and of the bias compensation", least=1, usual=128
    )
    light_groups: bool = option(
        True,
        "Light Groups",
        "Give each light group of the view layer direct and indirect light of its own, to be dimmed and coloured after the render",
        method="importance-sampling",
    )

    film: Film = SQUARE
    extra: dict = field(default_factory=dict)

    def with_defaults(self) -> RenderSettings:
        """The same request with nothing left open: a denoised picture needs fewer samples than one that is not."""
        method = "importance-sampling" if self.method == "auto" else self.method
        goal, numbers = self.target_error, {}
        if self.method == "auto" and self.time_budget is None and goal is None and self.quality is not None:
            goal, preset = QUALITY_ERRORS[self.quality], QUALITIES[self.quality]
            if all(getattr(self, name) == number for name, number in preset.items()):
                numbers = QUALITIES["medium"]  # passes are planned in units of the usual numbers
        sampled = method in ("importance-sampling", "fuzzy-clustering")
        denoise = sampled if self.denoise is None else self.denoise
        choice = {
            "direct_samples": (16 if method == "importance-sampling" else 8, 16),
            "reflections": (6 if method == "importance-sampling" else 2, 8),
        }
        open_ = {name: few if sampled else many for name, (few, many) in choice.items() if getattr(self, name) is None}
        return replace(self, method=method, denoise=denoise, target_error=goal, **numbers, **open_)

    @property
    def smooth(self) -> bool:
        """Whether the method's diffuse indirect light has no noise: a denoiser then has direct light and reflections to clean."""
        return self.method == "fuzzy-clustering"

    def wants(self, *names: str) -> bool:
        """Whether any of these layers is asked for."""
        return self.layers is None or any(name in self.layers for name in names)

    def scaled(self, quality: float, number: int) -> RenderSettings:
        """The request for one pass that takes about `quality` of the time of one, with random numbers of its own."""
        if quality == 1.0 and number == 0:
            return self
        # What a quick picture begins with (view, cache, denoiser) costs more than its few rays: it takes more of them.
        # Reflections are what is noisiest in it, and cheap.
        rays, reflected = (quality ** (2 / 3), quality**0.5) if quality < 1 else (quality, quality)
        # What few lights there are all points have in common: no denoiser sees that noise.  More of them cost other methods rays.
        lights = quality ** (0.5 if quality > 1 or self.method == "importance-sampling" else 0.75)
        # Lamps that no ray is aimed at are noise that no network takes for light; two rays cost next to nothing beside the view.
        parts = dict.fromkeys(("samples", "gather", "direct_samples"), rays) | {"reflections": reflected}
        fewer = {name: max(1, round(part * n)) for name, part in parts.items() if (n := getattr(self, name)) > 0}
        if "direct_samples" in fewer:
            fewer["direct_samples"] = max(fewer["direct_samples"], min(LEAST_DIRECT, self.direct_samples))
        # Primary samples are cheap, and no denoiser mends an edge that few of them have drawn.
        pixel_samples = max(1, round(quality**0.25 * self.pixel_samples))
        vpls = max(min(self.vpls, 256), round(lights * self.vpls))
        return replace(self, seed=self.seed + 15485863 * number, pixel_samples=pixel_samples, vpls=vpls, **fewer)


@dataclass(frozen=True)
class SequenceSettings:
    """What the frames of a sequence share.

    history: earlier frames whose light is reprojected and averaged into a frame, 0 for independent frames.
    share: part of the rays of a picture by itself that a frame with history takes.
    edges: how many times the primary samples of a picture by itself it takes: history knows nothing of those.
    motion_blur: sub-frames a frame while the shutter is open, 1 for none.
    """

    history: int = 7
    share: float = 0.5
    edges: float = 1.5
    motion_blur: int = 1

    @property
    def frame_share(self) -> float:
        """Part of the rays of a picture by itself that each exposure takes."""
        return self.share / self.motion_blur if self.history else 1.0

    def frame(self, settings: RenderSettings) -> RenderSettings:
        """The request for one frame: fewer rays for what noise the frames before it take out, more for edges.

        Sub-frames have edges of their own, as many as ever.
        """
        settings = settings.with_defaults()
        if not self.history or settings.time_budget is not None or settings.target_error is not None:
            return settings
        if settings.method != "importance-sampling":
            return settings
        edges = self.edges if self.motion_blur == 1 else 1.0
        shares = dict.fromkeys(("samples", "gather", "reflections"), self.frame_share) | {"pixel_samples": edges}
        return replace(settings, **{name: max(1, round(share * n)) for name, share in shares.items() if (n := getattr(settings, name)) > 0})


@dataclass(frozen=True)
class BakeSettings:
    """How lightmaps are made; `render` says how their light is computed.

    content: a key of `CONTENTS`.  texel_samples: 1 to 16 shading points a texel.  margin: texels around each chart that are filled, too.
    stitch: whether both sides of a UV seam are made to show the same light.
    """

    render: RenderSettings = field(default_factory=RenderSettings)
    content: str = "irradiance"
    texel_samples: int = 4
    margin: int = 4
    stitch: bool = True


# Values of the numbers for a first look, for work, and for the last picture.
QUALITIES: dict[str, dict[str, int]] = {
    "preview": {"vpls": 2048, "pixel_samples": 4, "samples": 4, "gather": 4},
    "medium": {name: getattr(RenderSettings(), name) for name in ("vpls", "pixel_samples", "samples", "gather")},
    "final": {"vpls": 16384, "pixel_samples": 32, "samples": 32, "gather": 32},
}


def options() -> dict[str, Field]:
    """The fields of `RenderSettings` that a user sets one by one: name to field, whose `metadata["option"]` is the `Option`."""
    return {f.name: f for f in fields(RenderSettings) if "option" in f.metadata}
