"""Views for the benchmark of the topology: Sponza by other lights, and a house of closed rooms."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields, replace

import numpy as np

from ..core.scene import ALL_RAYS, POINT, Lamps, Scene, World
from ..sample_scenes.materials import principled
from ..sample_scenes.primitives import box, joined, mesh, place
from ..sample_scenes.stage import camera, empty_scene, point

COLUMNS, ROWS = 8, 5  # rooms of the house
SIDE, HEIGHT, WALL = 4.0, 2.8, 0.25  # m


@dataclass(frozen=True)
class Outlook:
    """A view of a scene by a lamp of its own.

    eye, target, lamp: (3,) m in the scene's arrays; without a lamp the scene's own light stays.
    """

    name: str
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    lamp: tuple[float, float, float] | None = None

    def of(self, scene: Scene) -> Scene:
        """`scene` as it is seen from here."""
        seen = replace(scene, camera=replace(scene.camera, matrix=look_at(self.eye, self.target)))
        if self.lamp is None:
            return seen
        return replace(seen, lamps=point_lamp(self.lamp, 500.0), world=World(np.zeros((1, 1, 3), np.float32)))


# Sponza's court lies along x, its aisles between |y| = 1.5 and 3.5; the floor is at z = -4.07 of the arrays.
_COURT, _AISLE = ((-5.9, 0.0, -2.87), (0.0, 0.0, -2.2)), ((-6.0, -2.6, -2.8), (2.0, -2.2, -2.6))
SPONZA = (
    Outlook("court, sun and sky", *_COURT),
    Outlook("court, lamp in an aisle (mostly indirect)", *_COURT, (1.0, 2.7, -2.6)),
    Outlook("aisle, sun and sky", *_AISLE),
    Outlook("aisle, lamp in the court (mostly indirect)", *_AISLE, (2.0, 0.3, -2.6)),
)


def look_at(eye, target) -> np.ndarray:
    """(4, 4) camera matrix with its -z axis towards the target, and z of the world upwards."""
    back = np.subtract(eye, target).astype(np.float64)
    back /= np.linalg.norm(back)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(back, right), back, np.asarray(eye, np.float64)], axis=1)
    return matrix


def point_lamp(position, intensity: float) -> Lamps:
    """One point lamp of a radiant intensity (W/sr)."""
    one = vars(Lamps.empty())
    # What may be None stands for no program and no set of objects: zeros would name the first of each.
    required = [field.name for field in fields(Lamps) if field.default is MISSING and isinstance(one[field.name], np.ndarray)]
    lamp = Lamps(**{name: np.zeros((1, *one[name].shape[1:]), one[name].dtype) for name in required}, names=["lamp"], groups=[""])
    lamp.kind[:], lamp.position[:], lamp.axes[:] = POINT, position, np.eye(3)
    lamp.emission[:], lamp.visibility[:], lamp.cast_shadow[:] = intensity, ALL_RAYS, 1
    return lamp


def house(columns: int = COLUMNS, rows: int = ROWS):
    """A `bpy.types.Scene`: rooms with a lamp and furniture each, and no door open; the camera is in the first one."""
    scene = empty_scene(480, 270)
    plaster, wood = principled("Plaster", (0.7, 0.68, 0.62)), principled("Wood", (0.35, 0.22, 0.12))
    step = SIDE + WALL
    wide, deep = columns * step + WALL, rows * step + WALL
    shell = [box((wide, deep, WALL), (wide / 2, deep / 2, z)) for z in (-WALL / 2, HEIGHT + WALL / 2)]
    shell += [box((WALL, deep, HEIGHT), (k * step + WALL / 2, deep / 2, HEIGHT / 2)) for k in range(columns + 1)]
    shell += [box((wide, WALL, HEIGHT), (wide / 2, k * step + WALL / 2, HEIGHT / 2)) for k in range(rows + 1)]
    place("House", mesh("House", joined(shell), plaster))
    table = mesh("Table", joined([box((1.2, 0.7, 0.06), (0, 0, 0.72)), box((0.1, 0.1, 0.7), (0, 0, 0.35))]), wood)
    for column in range(columns):
        for row in range(rows):
            x, y = WALL + SIDE / 2 + column * step, WALL + SIDE / 2 + row * step
            place("Table", table, (x, y, 0))
            point("Lamp", (x + 0.6, y + 0.4, HEIGHT - 0.5), 60.0)
    camera((WALL + 0.4, WALL + 0.4, 1.5), (WALL + 2.4, WALL + 2.2, 1.2), lens=20.0)
    return scene
