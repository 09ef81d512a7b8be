"""A room with one window in a wide sunlit land: what lights it comes in by way of the ground outside, or as one patch of sun.

Nearly all of the sun's light falls where nobody looks, and of the rest nearly all leaves by no window: hard for every method
that sends particles from the lamps.  The window is in the wall at x = 5 m; the camera looks towards it from beside the right wall.
"""

from __future__ import annotations

import numpy as np

from . import textures
from .furnishings import SMOOTH, curtain, frame, palm, pot, rectangle, upright
from .furniture import bookcase, chair, floor_lamp, lampshade, picture, table, vase
from .materials import Surface, principled
from .primitives import box, joined, mesh, place, prism
from .stage import Detail, camera, empty_scene, sun, world

LENGTH, WIDTH, HEIGHT = 5.0, 4.2, 2.8  # along x, y, z (m)
WALL, SILL, LAND = 0.3, 0.9, 400.0
TO_SUN = (0.72, 0.2, 0.66)


def _materials() -> dict[str, Surface]:
    return {
        "wall": principled("Plaster", textures.plaster(201, (0.74, 0.71, 0.66)), tile=3.0, roughness=0.85, specular=0.1),
        "ceiling": principled("Ceiling", (0.78, 0.77, 0.75), roughness=0.9, specular=0.05),
        "parquet": principled("Parquet", textures.wood(202, (0.42, 0.26, 0.15), 8), tile=1.2, roughness=0.4, specular=0.35),
        "meadow": principled("Meadow", (0.22, 0.28, 0.12), roughness=0.95, specular=0.05),
        "white": principled("White lacquer", (0.76, 0.75, 0.72), roughness=0.35, specular=0.4),
        "oak": principled("Oak", textures.wood(203, (0.32, 0.20, 0.11)), tile=1.4, roughness=0.5, specular=0.3),
        "walnut": principled("Walnut", textures.wood(204, (0.14, 0.08, 0.045)), tile=1.4, roughness=0.45, specular=0.35),
        "rug": principled("Rug", textures.fabric(205, (0.36, 0.09, 0.07), (0.62, 0.50, 0.32)), tile=0.8, roughness=0.95, specular=0.0),
        "cloth": principled("Curtain", textures.fabric(206, (0.68, 0.62, 0.50)), tile=0.5, roughness=0.9, specular=0.0),
        "blue": principled("Blue cloth", textures.fabric(207, (0.12, 0.20, 0.36)), tile=0.5, roughness=0.9, specular=0.0),
        "brass": principled("Brass", (0.72, 0.50, 0.22), roughness=0.3, specular=0.5, metallic=1.0),
        "celadon": principled("Celadon", (0.35, 0.50, 0.42), roughness=0.2, specular=0.5),
        "terracotta": principled("Terracotta", (0.48, 0.21, 0.12), roughness=0.8, specular=0.1),
        "earth": principled("Earth", (0.06, 0.04, 0.03), roughness=0.9, specular=0.0),
        "frond": principled("Palm frond", textures.frond(208, (0.10, 0.26, 0.05)), roughness=0.5, specular=0.2),
        "red book": principled("Red books", (0.36, 0.05, 0.04), roughness=0.6, specular=0.2),
        "green book": principled("Green books", (0.07, 0.20, 0.10), roughness=0.6, specular=0.2),
        "tan book": principled("Tan books", (0.50, 0.36, 0.20), roughness=0.6, specular=0.2),
        "blue book": principled("Blue books", (0.06, 0.12, 0.28), roughness=0.6, specular=0.2),
    }


def build(detail: Detail, width: float = 1.6, height: float = 1.3, sky: float = 0.6):
    """width, height: of the window (m).  sky: times (.6, .75, 1) W/m^2/sr, its radiance.

    Raises ValueError for a window that does not fit into its wall.
    """
    if not (0 < width < WIDTH - 0.4 and 0 < height < HEIGHT - SILL - 0.1):
        raise ValueError(f"a window of {width:g} x {height:g} m does not fit; choose less than {WIDTH - 0.4:g} x {HEIGHT - SILL - 0.1:g} m")
    scene = empty_scene(exposure=1.5)
    look = _materials()
    _house(detail, look, width, height)
    _furnish(detail, look)
    sun(-np.array(TO_SUN), 4.0, (1.0, 0.95, 0.88))
    world(sky * np.array([0.6, 0.75, 1.0]))
    camera((0.35, 0.5, 1.55), (5.0, 2.6, 1.2), lens=19.0)
    return scene


def _house(detail: Detail, look: dict[str, Surface], width: float, height: float) -> None:
    """Land, slabs, walls and the window.  All walls end inside the slabs, each at its own height, so that no two faces coincide."""
    middle = (LENGTH / 2, WIDTH / 2)
    place("Land", mesh("Land", prism(rectangle(LAND / 2, LAND / 2, middle), 2.0).moved(z=-2.4), look["meadow"]))
    slab = rectangle(LENGTH / 2 + WALL - 0.02, WIDTH / 2 + WALL - 0.02, middle)
    place("Floor", mesh("Floor", prism(slab, 0.5).moved(z=-0.5), look["parquet"]))
    place("Ceiling", mesh("Ceiling", prism(slab, 0.25).moved(z=HEIGHT), look["ceiling"]))
    for name, y in (("Right wall", -WALL / 2), ("Left wall", WIDTH + WALL / 2)):
        place(name, mesh(name, box((LENGTH + 2 * WALL, WALL, HEIGHT + 0.3), (LENGTH / 2, y, HEIGHT / 2)), look["wall"]))
    place("Back wall", mesh("Back wall", box((WALL, WIDTH + 0.2, HEIGHT + 0.24), (-WALL / 2, WIDTH / 2, HEIGHT / 2)), look["wall"]))
    low = WIDTH / 2 - width / 2
    opening = np.array([(low, SILL), (low + width, SILL), (low + width, SILL + height), (low, SILL + height)])
    outline = np.array([(-0.1, -0.12), (WIDTH + 0.1, -0.12), (WIDTH + 0.1, HEIGHT + 0.12), (-0.1, HEIGHT + 0.12)])
    front = upright(prism(outline, WALL, [opening])).turned(np.pi / 2)
    place("Window wall", mesh("Window wall", front, look["wall"]), (LENGTH, 0, 0))
    bar = 0.06
    lining = frame(width - 2 * bar + 0.02, height - 2 * bar + 0.02, bar, 0.07).moved(low + bar - 0.01, 0, SILL + bar - 0.01)
    cross = [
        box((0.045, 0.05, height - bar), (WIDTH / 2, 0, SILL + height / 2)),
        box((width - bar, 0.044, 0.045), (WIDTH / 2, 0, SILL + 0.62 * height)),
    ]
    place("Window frame", mesh("Window frame", joined([lining, *cross]).turned(np.pi / 2), look["white"]), (LENGTH + 0.2, 0, 0))
    board = box((0.2, width + 0.2, 0.035), (LENGTH - 0.05, WIDTH / 2, SILL - 0.01), detail.chamfer(0.006))
    place("Sill", mesh("Sill", board, look["white"]))
    for y, turn in ((low - 0.35, np.pi / 2), (low + width + 0.35, -np.pi / 2)):
        hanging = curtain(detail, 210, 0.5, HEIGHT - 0.45, 1.1, 0.3).turned(turn)
        place("Curtain", mesh("Open curtain", hanging, look["cloth"], SMOOTH), (LENGTH - 0.12, y, 0.15))


def _furnish(detail: Detail, look: dict[str, Surface]) -> None:
    """What stands and hangs in the room, away from the camera in the corner of back and right wall."""
    books = [look[key] for key in ("oak", "red book", "green book", "tan book", "blue book")]
    for index, x in enumerate((2.2, 3.65)):
        shelf = mesh("Bookcase", bookcase(detail, 220 + index, 1.4, 2.1, 6, 4), books)
        place("Bookcase", shelf, (x, WIDTH - 0.19, 0.001))
    place("Rug", mesh("Rug", box((2.4, 1.7, 0.014), (3.0, 1.9, 0.005)), look["rug"]))
    place("Table", mesh("Table", table(detail, 1.3, 0.8, 0.74), look["walnut"]), (3.1, 1.9, 0.012))
    seat = mesh("Chair", chair(detail), [look["walnut"], look["blue"]])
    for x, y, turn in ((2.8, 2.55, 0.15), (3.45, 1.25, np.pi - 0.2), (2.15, 1.85, np.pi / 2 + 0.3)):
        place("Chair", seat, (x, y, 0.012), turn)
    place("Vase", mesh("Vase", vase(detail, 0.3, 0.1), look["celadon"], SMOOTH), (3.2, 1.95, 0.752))
    place("Lamp", mesh("Lamp", floor_lamp(detail, 1.5), look["brass"], SMOOTH), (4.5, 0.45, 0.001))
    place("Shade", mesh("Shade", lampshade(detail, 0.22, 0.14, 0.26), look["cloth"], SMOOTH), (4.5, 0.45, 1.45))
    place("Pot", mesh("Pot", pot(detail, 0.4, 0.22), [look["terracotta"], look["earth"]], SMOOTH), (4.6, 3.4, 0.001))
    place("Palm", mesh("Open palm", palm(detail, 211, 0.8, 12), look["frond"], SMOOTH), (4.6, 3.4, 0.36))
    canvas = principled("Painting", textures.painting(212), roughness=0.5, specular=0.2)
    place("Picture", mesh("Picture", picture(detail, 1.1, 0.75), [look["walnut"], canvas]), (3.0, 0.03, 1.6), np.pi)
