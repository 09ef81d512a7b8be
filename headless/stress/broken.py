"""Broken geometry: whatever of it is added to a room, its light stays what it was, and walls stay tight."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...core import scene as sc
from ...core.stages import AVAILABLE
from . import arrays
from .outcome import Outcome
from .rooms import bulb, irradiance, light, room, room_mesh
from .scales import near

BLOCK_LIGHT = 0.04  # of the mean irradiance: noise of another order of triangles, or of other rays
SLIVERS = 64
# Radiance that may pass a closed wall, in a room of about 0.1 W/m2/sr: nothing, but for shadow maps, whose texels are wider than a wall.
LEAK = dict.fromkeys(AVAILABLE, 0.0) | {"virtual-area-lights": 1e-3}

CRACKS = (1e-7, 1e-5, 1e-3)  # metres, in a room of 2 m


def _extra_triangles(corners, material: int = 2) -> tuple:
    corners = np.asarray(corners, float).reshape(-1, 3)
    return corners, np.arange(len(corners)).reshape(-1, 3), material


def _slivers(width: float) -> tuple:
    """A strip of floor of aspect 1e7 a triangle, just above the floor: as dark and as bright as the floor itself."""
    x = np.linspace(-0.9, 0.9, SLIVERS)
    strips = np.zeros((SLIVERS, 3, 3))
    strips[:, :, 0] = x[:, None] + np.array([0, width, 0])
    strips[:, :, 1] = np.array([-0.9, 0, 0.9])
    strips[:, :, 2] = -0.9999
    return _extra_triangles(strips)


def additions() -> dict[str, tuple]:
    """Parts that change nothing, by what is wrong with them."""
    vertices, triangles, material = room_mesh()
    line = [(-0.5, 0, 0), (0, 0, 0), (0.5, 0, 0)]
    tiny = np.array([(0, 0, 0), (1e-3, 0, 0), (0, 1e-3, 0)])
    return {
        "triangles of no area": (_extra_triangles([line, [line[0]] * 3]),),
        "a million-fold sliver": (_slivers(1e-7),),
        "slivers thinner than a float": (_slivers(1e-30),),
        "every triangle twice": ((vertices, triangles, material),),
        "every triangle five times": tuple((vertices, triangles, material) for _ in range(4)),
        "a floor within the floor": ((*arrays.quads([(-0.5, -0.5, -1), (0.5, -0.5, -1), (0.5, 0.5, -1), (-0.5, 0.5, -1)]), 2),),
        "a triangle of 1 mm beside one of 1 km": (
            _extra_triangles([np.add(tiny, (0.5, 0.5, -0.99)), 1e3 * np.array([(-1, -1, -1), (1, -1, -1), (0, 1, -1)])]),
        ),
        "a wall that passes through the block": ((*arrays.box((-0.45, -0.35, -1), (0.05, 0.25, -0.35), inward=False), 3),),
        "ten thousand specks outside": (_extra_triangles(np.random.default_rng(1).uniform(2, 3, (10_000, 1, 3)) + tiny),),
    }


def added(method: str) -> Iterator[Outcome]:
    """The room with each addition: the light of the room."""
    whole = irradiance(light(room(), method))
    for what, extra in additions().items():
        yield near(f"{what}: irradiance", method, irradiance(light(room(extra=extra), method)), whole, BLOCK_LIGHT)


def _split(vertices: np.ndarray, triangles: np.ndarray, material: np.ndarray, at: float) -> tuple:
    """Each triangle cut in two on its longest edge, the new corner on no neighbour (T-junctions), `at` along the edge."""
    soup = np.asarray(vertices, float)[triangles]
    middle = soup[:, 1] * (1 - at) + soup[:, 2] * at
    pieces = np.concatenate([np.stack([soup[:, 0], soup[:, 1], middle], 1), np.stack([soup[:, 0], middle, soup[:, 2]], 1)])
    return pieces.reshape(-1, 3), np.arange(len(pieces) * 3).reshape(-1, 3), np.concatenate([material, material])


def meshes(method: str) -> Iterator[Outcome]:
    """The same room from another mesh or with broken normals."""
    whole = irradiance(light(room(), method))
    vertices, triangles, material = room_mesh()

    def lit(v, t, m, normals=None) -> float:
        scene = room()
        scene.geometry = arrays.geometry(v, t, m, normals)
        return irradiance(light(scene, method))

    flat = room().geometry.corner_normals
    turned = np.random.default_rng(2).permutation(len(triangles))
    cases = {
        "T-junctions": _split(vertices, triangles, material, 1 / 3),
        "T-junctions, then slivers": _split(*_split(vertices, triangles, material, 1e-6), 1 / 3),
        "every other triangle inside out": (
            vertices,
            np.where(np.arange(len(triangles))[:, None] % 2, triangles, triangles[:, ::-1]),
            material,
        ),
        "triangles in another order": (vertices, triangles[turned], material[turned]),
        "normals of length 1000": (vertices, triangles, material, flat * 1000),
        "normals of length 1e-3": (vertices, triangles, material, flat * 1e-3),
        "normals that are zero": (vertices, triangles, material, flat * 0),
        "normals that are no number": (vertices, triangles, material, flat * np.nan),
    }
    for what, mesh in cases.items():
        yield near(f"{what}: irradiance", method, lit(*mesh), whole, BLOCK_LIGHT)
    value = lit(vertices, triangles, material, -flat)
    yield Outcome("normals against the geometry (black, as in Cycles): irradiance", method, "0", value, value == 0)


def walls(method: str) -> Iterator[Outcome]:
    """A room cut in two, lit on one side and seen from the other: no light."""
    for what, thickness in (("1e-4 of the room", 1e-4), ("1e-6 of the room", 1e-6), ("nothing", 0.0)):
        if thickness:
            wall = (*arrays.box((-2, -2, -0.5 - thickness), (2, 2, -0.5 + thickness), inward=False), 2)
        else:
            wall = (*arrays.quads([(-2, -2, -0.5), (2, -2, -0.5), (2, 2, -0.5), (-2, 2, -0.5)]), 2)
        for place, height in (("half a room", -0.75), ("5e-5", -0.5 - thickness - 5e-5)):
            scene = room(extra=(wall,), lamps=bulb(position=(0.6, 0.6, height)))
            layers = light(scene, method)
            value = float(sum(np.abs(layers[name]).max() for name in ("Direct", "Indirect")))
            case = f"lamp {place} behind a wall of {what}: light before it"
            yield Outcome(case, method, f"<= {LEAK[method]:g} W/m2/sr", value, value <= LEAK[method])


def cracks(method: str) -> Iterator[Outcome]:
    """A dark room whose walls end just below the ceiling, with a lamp outside that shines into the crack: no more light than it lets in."""
    for width in CRACKS:
        vertices, triangles = arrays.box((-1, -1, -1), (1, 1, 1 - width))
        ceiling = arrays.quads([(-1, -1, 1), (-1, 1, 1), (1, 1, 1), (1, -1, 1)])
        scene = room(lamps=bulb(position=(3, 0, 1 - width / 2)))
        scene.geometry = arrays.geometry(*arrays.join((vertices, triangles[:-2], 2), (*ceiling, 2)))
        layers = light(scene, method)
        value = sum(float(layers[name].mean(dtype=np.float64)) for name in ("Direct", "Indirect"))
        most = 10 * width + LEAK[method]
        yield Outcome(f"crack of {width:g} m in a dark room: light inside", method, f"0 to {most:g} W/m2/sr", value, 0 <= value <= most)


def places(method: str) -> Iterator[Outcome]:
    """Lamps and cameras where they should not be: the picture is made of numbers, and lit or dark as it should be."""
    whole = irradiance(light(room(), method))
    for what, z in (("1e-7 below the ceiling", 1 - 1e-7), ("in the ceiling", 1.0), ("1e-7 above the ceiling", 1 + 1e-7)):
        value = irradiance(light(room(lamps=bulb(position=(0.4, 0.2, z))), method))
        yield Outcome(f"lamp {what}: irradiance", method, f"0 to {10 * whole:.3g}", value, 0 <= value <= 10 * whole)
    for what, position in (
        ("in a corner", (1, 1, 1)),
        ("at a contact edge of the block", (0.1, 0.0, -1.0)),
        ("on a vertex of the block", (0.1, 0.3, -0.3)),
    ):
        value = irradiance(light(room(lamps=bulb(position=position)), method))
        yield Outcome(f"lamp {what}: irradiance", method, f"0 to {10 * whole:.3g}", value, 0 <= value <= 10 * whole)
    for what, position in (
        ("in the floor", (0.5, 0.5, -1)),
        ("in the block", (-0.2, 0, -0.5)),
        ("in a wall's plane", (1, 0, 0)),
        ("1 km away", (0, 0, 1e3)),
    ):
        scene = room()
        scene.camera.matrix[:3, 3] = position
        value = irradiance(light(scene, method))
        yield Outcome(f"camera {what}: irradiance", method, "a number >= 0", value, value >= 0)
    sphere = arrays.lamp(sc.POINT, 1.0, (0.4, 0.2, 0.6), radius=5.0)
    value = irradiance(light(room(lamps=sphere), method))
    yield Outcome("lamp larger than the room: irradiance", method, f"0 to {10 * whole:.3g}", value, 0 <= value <= 10 * whole)
