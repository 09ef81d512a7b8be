"""The white furnace: inside a closed surface of one albedo and one emission the light is known in closed form.

Every point receives the same radiance from everywhere, so the radiance after infinitely many bounces is
emission / (1 - rho); after B diffuse bounces it is emission (1 + rho + ... + rho^(B + 1)), where the surface that
the camera sees counts as the first reflection.
"""

from __future__ import annotations

from .materials import principled
from .primitives import mesh, place, sphere
from .stage import Detail, camera, empty_scene


def indirect_radiance(rho: float, emission: float, bounces: int) -> float:
    """Radiance (W/m^2/sr) of the layer `Indirect` with this many diffuse bounces: direct light has left its emitter at once."""
    return emission * sum(rho ** (bounce + 1) for bounce in range(1, bounces + 1))


def build(detail: Detail, *, rho: float = 0.5, emission: float = 0.5):
    """rho: albedo, 0 to 1.  emission: radiance, W/m^2/sr.  All of the sphere (radius 1 m) has both."""
    scene = empty_scene(960, 540)
    surface = principled("Furnace", (rho,) * 3, specular=0.0, emission=(1, 1, 1), strength=emission)
    shape = sphere(1.0, detail.segments(64, 24), detail.segments(32, 12)).flipped()
    place("Furnace", mesh("Furnace", shape, surface))
    camera((0.0, -0.5, 0.0), (0.0, 0.5, 0.0), lens=18.0)
    return scene
