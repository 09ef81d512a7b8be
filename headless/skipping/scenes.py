"""Four places of which a picture needs little: a house of rooms, a city at night, a hall of lamps and an open landscape."""

from __future__ import annotations

import numpy as np

from ...core import scene as sc
from ..stress import arrays

ROOM, HEIGHT, WALL = 4.0, 2.8, 0.1  # m, of the house
COLUMNS, ROWS = 8, 5
BLOCKS, STREET = 12, 12.0  # of the city: buildings along a side, and the distance of one street to the next (m)
HALL_LAMPS = (50, 40)


def house(width: int = 160, height: int = 90) -> sc.Scene:
    """Forty rooms with a lamp and a table each, their doors shut but for one between the room of the picture and its neighbour."""
    parts, lit = [], []
    for i in range(COLUMNS):
        for j in range(ROWS):
            low = np.array([i * ROOM, j * ROOM, 0.0])
            parts.append((*_room(low, door=(i, j) in ((0, 0), (1, 0)), left=(i, j) == (1, 0)), 0))
            parts.append((*arrays.box(np.add(low, (1.5, 1.5, 0)), np.add(low, (2.5, 2.2, 0.8)), inward=False), 1))
            parts.append((*arrays.icosphere(2, 0.3, inward=False), 1))
            parts[-1] = (parts[-1][0] + np.add(low, (1.0, 3.0, 0.3)), *parts[-1][1:])
            lit.append(arrays.lamp(sc.POINT, 4.0, np.add(low, (2.0, 2.4, 2.4))))
    view = _looking(arrays.camera((0.3, 0.3, 1.6), width, height, angle=1.4), (3.9, 2.2, 1.0))
    return _scene(parts, ((0.7, 0.65, 0.6), (0.4, 0.25, 0.2)), lit, view)


def _room(low: np.ndarray, door: bool, left: bool) -> tuple[np.ndarray, np.ndarray]:
    """A room's six sides, with a doorway in its wall at +x (at -x where `left`)."""
    inner = low + WALL / 2, np.add(low, (ROOM - WALL / 2, ROOM - WALL / 2, HEIGHT))
    if not door:
        return arrays.box(*inner)
    vertices, triangles = arrays.box(*inner)
    side = slice(0, 2) if left else slice(2, 4)
    walls = np.delete(triangles, side, axis=0)
    x = (inner[0] if left else inner[1])[0]
    (_, y0, z0), (_, y1, z1) = inner
    mid, jamb = low[0] + (0.0 if left else ROOM), (low[1] + 1.6, low[1] + 2.4, 2.1)
    panels = [
        [(x, y0, z0), (x, jamb[0], z0), (x, jamb[0], z1), (x, y0, z1)],
        [(x, jamb[1], z0), (x, y1, z0), (x, y1, z1), (x, jamb[1], z1)],
        [(x, jamb[0], jamb[2]), (x, jamb[1], jamb[2]), (x, jamb[1], z1), (x, jamb[0], z1)],
        [(x, jamb[0], z0), (mid, jamb[0], z0), (mid, jamb[0], jamb[2]), (x, jamb[0], jamb[2])],
        [(x, jamb[1], z0), (mid, jamb[1], z0), (mid, jamb[1], jamb[2]), (x, jamb[1], jamb[2])],
        [(x, jamb[0], jamb[2]), (x, jamb[1], jamb[2]), (mid, jamb[1], jamb[2]), (mid, jamb[0], jamb[2])],
        [(x, jamb[0], z0), (x, jamb[1], z0), (mid, jamb[1], z0), (mid, jamb[0], z0)],
    ]
    return arrays.join((vertices, walls, 0), (*arrays.quads(*panels), 0))[:2]


def city(width: int = 160, height: int = 90) -> sc.Scene:
    """Blocks of buildings with a lamp every few metres of every street; the picture shows one street, with its windows dark."""
    size = BLOCKS * STREET
    parts = [(*arrays.quads([(0, 0, 0), (size, 0, 0), (size, size, 0), (0, size, 0)]), 0)]
    lit = []
    rng = np.random.default_rng(4)
    for i in range(BLOCKS):
        for j in range(BLOCKS):
            low = np.array([i * STREET + 3, j * STREET + 3, 0.0])
            parts.append((*arrays.box(low, np.add(low, (STREET - 3.01, STREET - 3.01, rng.uniform(9, 25))), inward=False), 1 + (i + j) % 2))
            lit += [arrays.lamp(sc.POINT, 6.0, (i * STREET + 1.5, j * STREET + k, 4.0)) for k in (2.0, 6.0, 10.0)]
    view = _looking(arrays.camera((5 * STREET + 1.5, 0.2, 1.7), width, height, angle=1.1), (5 * STREET + 1.5, 20.0, 3.0))
    return _scene(parts, ((0.25, 0.25, 0.27), (0.5, 0.4, 0.35), (0.45, 0.45, 0.42)), lit, view)


def hall(width: int = 160, height: int = 90) -> sc.Scene:
    """An exhibition hall with two thousand lamps under its ceiling, and stands between."""
    x, y = HALL_LAMPS
    parts = [(*arrays.box((0, 0, 0), (2.0 * x, 2.0 * y, 8.0)), 0)]
    rng = np.random.default_rng(5)
    for _ in range(150):
        low = np.append(rng.uniform(4, (2 * x - 8, 2 * y - 8)), 0.0)
        parts.append((*arrays.box(low, low + rng.uniform(1, 4, 3), inward=False), 1))
    places = np.stack(np.meshgrid(1 + 2.0 * np.arange(x), 1 + 2.0 * np.arange(y), [7.0], indexing="ij"), -1).reshape(-1, 3)
    lit = [arrays.lamp(sc.POINT, 1.0, place) for place in places]
    view = _looking(arrays.camera((2.0, 2.0, 1.7), width, height, angle=1.2), (50.0, 35.0, 2.0))
    return _scene(parts, ((0.6, 0.6, 0.6), (0.5, 0.3, 0.2)), lit, view)


def landscape(width: int = 160, height: int = 90) -> sc.Scene:
    """A house on a plain under a bright sky that fills four fifths of the picture."""
    ground = arrays.quads([(-500, -500, 0), (500, -500, 0), (500, 500, 0), (-500, 500, 0)])
    parts = [(*ground, 0), (*arrays.box((-4, 8, 0), (4, 14, 4), inward=False), 1)]
    sky = np.full((64, 128, 3), 0.5, np.float32) * np.linspace(1.5, 0.5, 64, dtype=np.float32)[:, None, None]
    view = _looking(arrays.camera((0, -10, 1.7), width, height, angle=1.2), (0, 20, 12.0))
    return _scene(parts, ((0.3, 0.35, 0.2), (0.6, 0.5, 0.4)), [arrays.lamp(sc.SUN, 3.0, axes=_axes((0.4, -0.5, 0.8)))], view, world=sky)


def _axes(backward) -> np.ndarray:
    """(3, 3) rows x, y, z of a frame whose z axis is `backward`, with z up where it can be."""
    z = np.asarray(backward, float) / np.linalg.norm(backward)
    x = np.cross((0, 0, 1), z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _looking(camera: sc.Camera, at) -> sc.Camera:
    """`camera`, turned to a point."""
    camera.matrix[:3, :3] = _axes(camera.matrix[:3, 3] - at).T
    return camera


def _scene(parts, albedos, lit, view, world=(0, 0, 0)) -> sc.Scene:
    vertices, triangles, material = arrays.join(*parts)
    geometry = arrays.geometry(vertices, triangles, material)
    return arrays.scene(geometry, arrays.materials(*((a, 0.0) for a in albedos)), lamps=arrays.lamps(*lit), world=world, camera=view)


SCENES = {"40-room house": house, "city with one lit street": city, "hall of 2,000 lamps": hall, "landscape under the sky": landscape}
