"""What a user asks of a render, method by method (design.md, section 3)."""

from __future__ import annotations

from dataclasses import dataclass, field

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
    denoise: None lets the method choose.  time_budget: seconds; target_error: relMSE.
    layers: names of the layers wanted (None: all of the contract).
    """

    method: str = "auto"
    vpls: int = 4096
    bounces: int = 4
    seed: int = 0
    threads: int = 0
    pixel_samples: int = 16
    direct_samples: int = 16
    reflections: int = 8
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

    # importance sampling
    samples: int = 32
    gather: int = 8

    extra: dict = field(default_factory=dict)
