"""Random small scenes: rooms, open places and heaps of triangles, at any scale, with any lamps, some of them broken."""

from __future__ import annotations

import numpy as np

from ...core import scene as sc
from . import arrays

# What a random scene is, and the share of each.
KINDS = ("room", "dark room", "open", "heap")
_SHARES = (0.45, 0.1, 0.25, 0.2)


def random_scene(seed: int) -> tuple[sc.Scene, str]:
    """The scene of number `seed`, and its kind of `KINDS`.

    All are about two units wide before they are scaled by 1e-3 to 1e3.  A dark room is closed, and every lamp is outside.
    """
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(KINDS, p=_SHARES))
    scale = 10.0 ** rng.uniform(-3, 3)
    parts = [*_shell(rng, kind), *_things(rng, kind)]
    albedos = rng.choice([0.0, 1.0, *rng.random(8)], (8, 1)) * rng.uniform(0.5, 1, (8, 3))
    glowing = kind != "dark room" and rng.random() < 0.4
    emission = np.where(np.arange(8) == 7, glowing * rng.uniform(0.5, 3), 0.0)
    vertices, triangles, material = arrays.join(*parts)
    if glowing:
        material[rng.choice(len(material), 2)] = 7
    lit = [_lamp(rng, scale, outside=kind == "dark room") for _ in range(rng.integers(0 if glowing else 1, 4))]
    world = rng.random(3) * (rng.random() < (0.5 if kind != "room" else 0.1))
    scene = arrays.scene(
        arrays.geometry(vertices * scale, triangles, material),
        arrays.materials(*zip(albedos, emission)),
        lamps=arrays.lamps(*lit),
        world=world,
        camera=_camera(rng, scale, inside=kind == "dark room"),
    )
    return scene, kind


def _shell(rng: np.random.Generator, kind: str) -> list:
    """Walls: a closed box whose corners are shaken, a box without some of its sides, or none."""
    if kind == "heap":
        return []
    vertices, triangles = arrays.box((-1, -1, -1), (1, 1, 1))
    corners, which = np.unique(vertices, axis=0, return_inverse=True)
    vertices = (corners + rng.uniform(-0.08, 0.08, corners.shape))[which.ravel()]
    material = np.repeat(rng.integers(0, 7, 6), 2)
    if kind == "open":
        stays = np.repeat(rng.random(6) < 0.6, 2)
        stays[8:10] = True
        triangles, material = triangles[stays], material[stays]
    return [(vertices, triangles, material)]


def _things(rng: np.random.Generator, kind: str) -> list:
    """Boxes, loose triangles, slivers, triangles of no area and doubled ones."""
    parts = []
    for _ in range(rng.integers(0, 3)):
        low = rng.uniform(-0.8, 0.3, 3)
        parts.append((*arrays.box(low, low + rng.uniform(0.05, 0.5, 3), inward=False), int(rng.integers(0, 7))))
    loose = rng.uniform(-0.8, 0.8, (rng.integers(8, 16) if kind == "heap" else rng.integers(0, 5), 3, 3))
    if len(loose) and rng.random() < 0.3:
        loose[0, 2] = loose[0, 0] + 0.5 * (loose[0, 1] - loose[0, 0]) + rng.choice([0, 1e-7, 1e-4])  # a sliver, or no area
    if len(loose):
        parts.append((loose.reshape(-1, 3), np.arange(3 * len(loose)).reshape(-1, 3), rng.integers(0, 7, len(loose))))
        if rng.random() < 0.2:
            parts.append(parts[-1])
    if not parts:
        parts.append((*arrays.quads([(-1, -1, -0.9), (1, -1, -0.9), (1, 1, -0.9), (-1, 1, -0.9)]), 0))
    return parts


def _turned(rng: np.random.Generator) -> np.ndarray:
    """(3, 3) a random rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[::-1]


def _lamp(rng: np.random.Generator, scale: float, outside: bool) -> sc.Lamps:
    """A lamp without radius whose light does not depend on the scale."""
    kind = int(rng.choice([sc.POINT, sc.SPOT, sc.SUN, sc.AREA], p=(0.4, 0.2, 0.1, 0.3)))
    position = rng.uniform(-0.8, 0.8, 3)
    if outside:
        position = 1.5 * position / np.abs(position).max()
    colour = rng.uniform(0.2, 1, 3) * (scale**2 if kind in (sc.POINT, sc.SPOT) else 1.0)
    angle = {sc.SPOT: rng.uniform(0.5, 2.5), sc.SUN: 0.0}.get(kind, np.pi)
    size = rng.uniform(0.1, 0.6, 2) * scale
    return arrays.lamp(kind, colour, position * scale, _turned(rng), angle=angle, blend=rng.random(), size=size)


def _camera(rng: np.random.Generator, scale: float, inside: bool) -> sc.Camera:
    """Six by four pixels from inside, looking anywhere; the film of an orthographic one may reach outside."""
    view = arrays.camera(width=6, height=4, angle=rng.uniform(0.7, 2.0), near=1e-4 * scale, far=100 * scale)
    view.matrix[:3, :3] = _turned(rng)
    view.matrix[:3, 3] = rng.uniform(-0.7, 0.7, 3) * scale
    if rng.random() < 0.15 and not inside:
        view.orthographic = True
        view.window = tuple(scale * side for side in view.window)
    return view
