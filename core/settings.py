"""What a user asks of a render, method by method (design.md, section 3)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

METHODS = (
    "auto",
    "instant-radiosity",
    "fuzzy-clustering",
    "virtual-area-lights",
    "visibility-gates",
    "importance-sampling",
)


@dataclass
class RenderSettings:
    """The request of one render; every field has the default of the command line.

    vpls: virtual point lights that the view uses.  bounces: diffuse bounces of the indirect light.
    pixel_samples: primary samples a pixel.  direct_samples: shadow rays a shading point for `Direct`.
    reflections: most rays drawn from the glossy lobe of a shading point.
    direct_samples, reflections, denoise: None lets the method choose (see `with_defaults`).  time_budget: seconds;
    target_error: relMSE.
    layers: names of the layers wanted (None: all of the contract).
    """

    method: str = "auto"
    vpls: int = 4096
    bounces: int = 4
    seed: int = 0
    threads: int = 0
    pixel_samples: int = 16
    direct_samples: int | None = None
    reflections: int | None = None
    denoise: bool | None = None
    time_budget: float | None = None
    target_error: float | None = None
    debug_layers: bool = False
    layers: tuple[str, ...] | None = None

    # instant radiosity
    visibility: str = "rays"  # rays | shadow-maps | none
    compensation: bool = True

    # fuzzy clustering
    vpl_clusters: int = 1000
    point_clusters: int = 8000
    fuzziness: int = 6
    weighting: str = "smooth"  # smooth | distance | plain
    shade_with: str = "clusters"  # clusters | vpls

    # visibility gates; voxels: along the scene's longest side
    voxels: int = 128
    gates: str = "guided"  # disks | polygons | off | guided

    # importance sampling; gather: of the compensation, too
    samples: int = 8
    gather: int = 8

    extra: dict = field(default_factory=dict)

    def with_defaults(self) -> RenderSettings:
        """The same request with nothing left open: a denoised picture needs fewer samples than one that is not."""
        method = "importance-sampling" if self.method == "auto" else self.method
        sampled = method == "importance-sampling"
        denoise = sampled if self.denoise is None else self.denoise
        choice = {"direct_samples": (4, 16), "reflections": (2, 8)}
        open_ = {name: few if sampled else many for name, (few, many) in choice.items() if getattr(self, name) is None}
        return replace(self, method=method, denoise=denoise, **open_)

    def wants(self, *names: str) -> bool:
        """Whether any of these layers is asked for."""
        return self.layers is None or any(name in self.layers for name in names)

    def scaled(self, quality: float, number: int) -> RenderSettings:
        """The request for one pass that takes about `quality` of the time of one, with random numbers of its own."""
        if quality == 1.0 and number == 0:
            return self
        fewer = {
            name: max(1, round(quality * getattr(self, name)))
            for name in ("pixel_samples", "direct_samples", "samples", "gather", "reflections")
            if getattr(self, name) > 0
        }
        vpls = max(min(self.vpls, 256), round(quality**0.5 * self.vpls))
        return replace(self, seed=self.seed + 15485863 * number, vpls=vpls, **fewer)
