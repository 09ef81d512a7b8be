"""The Cornell box, as measured at Cornell University's Program of Computer Graphics.

Dimensions, camera and reflectances: https://www.graphics.cornell.edu/online/box/data.html.  The measured spectra are given here as
the linear RGB that the literature uses for them.
"""

from __future__ import annotations

import numpy as np

from .materials import emitter, principled
from .primitives import mesh, place, polygons
from .stage import Detail, area, camera, empty_scene

WHITE = (0.725, 0.71, 0.68)
RED = (0.63, 0.065, 0.05)
GREEN = (0.14, 0.45, 0.091)
RADIANCE = (17.0, 12.0, 4.0)  # of the lamp, W/m^2/sr
DEPTH = 0.5592
HEIGHT = 0.5488
LAMP_GAP = 0.002  # the lamp hangs this far below the ceiling, so that rays from either are never in doubt


def _metres(points: list[tuple[float, float, float]]) -> np.ndarray:
    """The measured millimetres (x to the left, y up, z away from the camera) in metres (x to the right, y away, z up)."""
    x, y, z = np.array(points, float).T / 1000
    return np.column_stack([0.556 - x, z, y])


def _room() -> np.ndarray:
    """(16, 3) corners: the inside (front, then back; floor before ceiling), then the outside."""
    inside = _metres(
        [
            (552.8, 0, 0), (0, 0, 0), (0, 548.8, 0), (556, 548.8, 0),
            (549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2),
        ]
    )  # fmt: skip
    wall = 0.01
    side = np.array([-1, 1, 1, -1, -1, 1, 1, -1]) * wall
    back = np.array([0, 0, 0, 0, 1, 1, 1, 1]) * wall
    up = np.array([-1, -1, 1, 1, -1, -1, 1, 1]) * wall
    return np.concatenate([inside, inside + np.column_stack([side, back, up])])


def _block(name: str, top: list[tuple[float, float]], height: float, surface) -> None:
    """A block by the measured corners of its top (x, z)."""
    corners = _metres([(x, h, z) for h in (0, height) for x, z in top])
    faces = [[3, 2, 1, 0], [4, 5, 6, 7]] + [[i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4] for i in range(4)]
    corners[:4, 2] = 0.0002  # it stands on the floor without sharing a plane with it
    place(name, mesh(name, polygons(corners, faces), surface))


def build(detail: Detail, *, lamp: str = "area"):
    """lamp: `area` for an area lamp, `mesh` for an emissive quad of the same radiance (which shines on both sides)."""
    scene = empty_scene(512, 512, exposure=1.0)
    white, red, green = (principled(name, colour, specular=0.0) for name, colour in (("White", WHITE), ("Red", RED), ("Green", GREEN)))
    # Inside: floor, ceiling, back, left, right; outside the same, facing out; then the rim round the opening.
    inner = [[0, 1, 5, 4], [2, 3, 7, 6], [4, 5, 6, 7], [0, 4, 7, 3], [5, 1, 2, 6]]
    outer = [[corner + 8 for corner in face[::-1]] for face in inner]
    rim = [[i, i + 8, (i + 1) % 4 + 8, (i + 1) % 4] for i in range(4)]
    slots = [0, 0, 0, 1, 2] + [0] * 9
    place("Room", mesh("Room", polygons(_room(), inner + outer + rim, slots=slots), [white, red, green]))
    _block("Short block", [(130, 65), (82, 225), (240, 272), (290, 114)], 165, white)
    _block("Tall block", [(423, 247), (265, 296), (314, 456), (472, 406)], 330, white)
    _lamp(lamp)
    camera((0.278, -0.8, 0.273), (0.278, 0.0, 0.273), lens=35.0).data.sensor_width = 25.0
    return scene


def _lamp(kind: str) -> None:
    """The lamp of the ceiling."""
    corners = _metres([(343, 548.8, 227), (343, 548.8, 332), (213, 548.8, 332), (213, 548.8, 227)]) - [0, 0, LAMP_GAP]
    strength = max(RADIANCE)
    colour = tuple(channel / strength for channel in RADIANCE)
    if kind == "mesh":
        place("Lamp", mesh("Lamp", polygons(corners, [[0, 1, 2, 3]]), emitter("Lamp", colour, strength)))
        return
    size = corners.max(axis=0) - corners.min(axis=0)
    area("Lamp", corners.mean(axis=0), (0, 0, -1), size[:2], np.pi * size[0] * size[1] * strength, colour)
